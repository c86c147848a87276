# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The viewer beside a hostile node: nothing that comes over ROS runs, is fetched or is read."""

from __future__ import annotations

import base64
import os
import re

from hostile_node import HostileNode, NAME
import pytest

pytestmark = pytest.mark.full

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from page_client import messages_of  # noqa: E402
from test_viewer import browser, end, PATIENCE_MS, SLOWLY, start_viewer  # noqa: E402, F401

from manip_sim.viewer.page.latest import plain  # noqa: E402

#: What a browser would run, and what viser's Markdown would read: a picture of the host.
HARM = '<img src=x onerror=hit("{}")>![p](p.png)'
#: Where texts of messages are shown, as the hostile node calls them: by the tab of the page.
SHOWN = {
    'Control': ('joint',), 'View': ('body',), 'Plots': (),
    'Health': ('name', 'message', 'key', 'value', 'accepted', 'dropped', 'rate', 'camera',
               'camera rate', 'factor', 'state', 'defect', 'failed'), 'Cameras': ()}
#: Texts that are nowhere shown, or not on the page all the time.
UNSEEN = ('site', 'model', 'robot', 'frame', 'hardware', 'answer')
PIXEL = base64.b64decode('iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAE'
                         'hQGAhKmMIQAAAABJRU5ErkJggg==')


def harm(what):
    return HARM.format(re.sub(r'\W', '', what))


class Visit:
    """What a browser saw: the texts of each tab, what ran, what it asked for and received."""

    def __init__(self):
        self.texts, self.requests, self.received = {}, [], []
        self.ran, self.images, self.errors = [], 0, []

    def take(self, frame):
        if isinstance(frame, bytes):
            self.received += messages_of(frame)


@pytest.fixture(scope='module')
def hostile():
    node = HostileNode(harm)
    yield node
    node.close()


@pytest.fixture(scope='module')
def visit(hostile, browser, tmp_path_factory):  # noqa: F811
    """Visit all tabs of the page, press its buttons, and show names, plots and pictures."""
    folder = tmp_path_factory.mktemp('host')
    (folder / 'p.png').write_bytes(PIXEL)
    here = os.getcwd()
    os.chdir(folder)
    process, address = start_viewer('--node', NAME)
    os.chdir(here)
    page, found = browser.new_page(viewport={'width': 1000, 'height': 900}), Visit()
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script(SLOWLY.format(500))  # These tests are about texts.
    page.expose_function('hit', lambda what: found.ran.append(what))
    page.on('pageerror', lambda error: found.errors.append(str(error)))
    page.on('request', lambda request: found.requests.append(request.url))
    page.on('websocket', lambda socket: socket.on('framereceived', found.take))
    try:
        page.goto(address)
        page.get_by_text('arm [rad]').wait_for()
        for tab, sources in SHOWN.items():
            page.get_by_role('tab', name=tab).press('Enter')
            if tab == 'View':
                page.get_by_label('Names').press('Space')
            if tab == 'Plots':
                page.get_by_text('position [rad]').wait_for()
            for source in sources if tab in ('Health', 'Control') else ():
                page.get_by_text(f'({source_text(source)})').first.wait_for(state='attached')
            if tab == 'Cameras':
                page.get_by_label('Show', exact=True).last.press('Space')
                page.locator('img:visible').first.wait_for()
            # An image that cannot be fetched fails a moment later.
            page.wait_for_timeout(500)
            found.texts[tab] = page.locator('body').inner_text()
            found.images += page.locator('img[src=x], img[alt=p], iframe').count()
        page.get_by_role('button', name='Reset').dispatch_event('click')
        page.get_by_text('Command failed').first.wait_for()
        found.texts['notification'] = page.locator('body').inner_text()
        page.get_by_role('tab', name='Control').press('Enter')
        # A hint is written when the mouse is over its element.
        page.get_by_text('img src').first.hover()
        page.wait_for_timeout(500)
        found.images += page.locator('img[src=x], img[alt=p], iframe').count()
        yield found
    finally:
        page.close()
        _, errors = end(process)
        assert (process.returncode, errors) == (0, '')


def source_text(source):
    return '"' + re.sub(r'\W', '', source) + '"'


@pytest.mark.parametrize(('tab', 'source'), [
    (tab, source) for tab, sources in SHOWN.items() for source in sources if tab != 'View'])
def test_a_text_of_a_message_is_shown_as_it_is(visit, tab, source):
    shown = re.sub(r'\s', '', visit.texts[tab])
    assert re.sub(r'\s', '', harm(source))[:30] in shown


def test_the_answer_of_a_service_is_shown_as_it_is(visit):
    assert harm('answer')[:30] in visit.texts['notification']


@pytest.mark.parametrize('source', [*(s for sources in SHOWN.values() for s in sources), *UNSEEN])
def test_no_text_of_a_message_runs(visit, source):
    assert re.sub(r'\W', '', source) not in visit.ran


def test_no_text_of_a_message_becomes_an_element_or_a_request(visit, address_of):
    assert visit.images == 0
    assert visit.ran == []
    # The policy for the content of the page forbids nothing that the page itself needs.
    assert visit.errors == []
    assert [url for url in visit.requests
            if not url.startswith((address_of, 'data:', 'blob:'))] == []
    assert not any(url.endswith('/x') for url in visit.requests)


@pytest.fixture
def address_of(visit):
    """Return the address of the page."""
    return re.match(r'http://[^/]*', visit.requests[0]).group()


def test_no_file_of_the_host_is_sent_to_the_browser(visit):
    messages = str(visit.received)
    assert 'p.png' in messages  # The text has come, and no picture in its place.
    assert base64.b64encode(PIXEL)[:40].decode() not in messages
    assert 'data:image' not in messages
    # Names of bodies are written in the scene, which is no element of the page.
    assert {message['props']['text'] for message in visit.received
            if message['type'] == 'LabelMessage'} == {'cube', plain(harm('body'))}
