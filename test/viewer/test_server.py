# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The server of the page, told of messages by another thread than its own."""

import asyncio
import sys

import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.viewer.page.server import Access  # noqa: E402
from manip_sim.viewer.page.server import close_server, open_server  # noqa: E402


@pytest.fixture(scope='module')
def buffer():
    """Return the buffer of messages to all browsers."""
    server = open_server('127.0.0.1', 0, Access.of({}, []))
    yield server._websock_server._broadcast_buffer
    close_server(server)


@pytest.fixture
def eager_threads():
    """Let threads take turns as often as can be."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before_s)


@pytest.mark.full
def test_messages_come_while_browsers_come_and_go(buffer, eager_threads):
    event = buffer.message_event

    async def come_and_go():
        for _ in range(300):
            waiting = [asyncio.create_task(event.wait()) for _ in range(100)]
            await asyncio.sleep(0.0)
            for task in waiting:
                task.cancel()
            await asyncio.gather(*waiting, return_exceptions=True)
    coming = asyncio.run_coroutine_threadsafe(come_and_go(), buffer.event_loop)
    while not coming.done():
        event.clear()
        event.set()
    coming.result()


def test_who_waits_is_woken_after_another_thread_has_set_the_event(buffer):
    event = buffer.message_event

    async def wait():
        event.clear()
        await event.wait()
    waiting = [asyncio.run_coroutine_threadsafe(wait(), buffer.event_loop) for _ in range(3)]
    asyncio.run_coroutine_threadsafe(asyncio.sleep(0.0), buffer.event_loop).result()
    event.set()
    assert event.is_set()
    buffer.event_loop.call_soon_threadsafe(event.set)
    for task in waiting:
        task.result(timeout=300.0)


def test_buffers_of_all_servers_have_such_an_event_and_it_is_put_in_once(buffer):
    from viser.infra import _infra
    again = open_server('127.0.0.1', 0, Access.of({}, []))
    try:
        kinds = type(again._websock_server._broadcast_buffer).__mro__
        assert kinds[0] is type(buffer) is _infra.AsyncMessageBuffer
        assert [kind.__name__ for kind in kinds].count('Buffer') == 1
        assert type(buffer.message_event).__module__ == 'manip_sim.viewer.page.server'
    finally:
        close_server(again)
