# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Who may open the page and its socket, and what may be sent there."""

import asyncio
import contextlib
import http.client
import itertools
import logging
import socket

import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')
pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, strategies as st  # noqa: E402
import msgspec  # noqa: E402
import viser  # noqa: E402
import websockets  # noqa: E402

from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.viewer.page import server as server_module  # noqa: E402
from manip_sim.viewer.page.server import (  # noqa: E402
    Access, guarding, page_message, TOKEN_VARIABLE)
from manip_sim.viewer.page.server import close_server, open_server, page_address  # noqa: E402

TOKEN = 'a-token-of-this-test'


@pytest.fixture(scope='module')
def server():
    server = open_server('127.0.0.1', 0, Access.of({TOKEN_VARIABLE: TOKEN}, ['robot.example']))
    server.gui.add_slider('slider', 0.0, 1.0, 0.1, 0.5)
    yield server
    close_server(server)


def get(server, path, headers):
    connection = http.client.HTTPConnection('127.0.0.1', server.get_port(), timeout=300.0)
    try:
        connection.putrequest('GET', path, skip_host=True)
        for name, value in headers:
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        return response.status, response.read().decode(), dict(response.getheaders())
    finally:
        connection.close()


def own(server, name='127.0.0.1'):
    return f'{name}:{server.get_port()}'


@pytest.mark.parametrize('host', ['127.0.0.1', 'localhost', 'LOCALHOST', '192.168.7.7', '[::1]',
                                  'robot.example', socket.gethostname()])
@pytest.mark.parametrize('path', [f'/{TOKEN}/', f'/{TOKEN}', f'/{TOKEN}/?websocket=ws://x'])
def test_the_page_is_served_to_who_knows_the_token(server, host, path):
    status, text, headers = get(server, path, [('Host', own(server, host))])
    assert status == 200
    assert '<div id="root">' in text
    policy = headers['Content-Security-Policy']
    assert "default-src 'none'" in policy
    assert f'connect-src ws://{own(server, host)} ' in policy
    assert headers['Referrer-Policy'] == 'no-referrer'


@pytest.mark.parametrize('path', [
    '/', f'/x{TOKEN}/', f'/{TOKEN}x/', f'/{TOKEN[:-1]}/', f'/?token={TOKEN}', f'/x/{TOKEN}/',
    '/index.html', '//', '/%2e%2e/etc/passwd', f'/{TOKEN.upper()}/'])
def test_without_the_token_there_is_one_line_that_says_where_it_is(server, path):
    status, text, _ = get(server, path, [('Host', own(server))])
    assert (status, text) == (403, 'sim_view: open the address that sim_view has printed, with '
                                   'the token at its end\n')


@pytest.mark.parametrize('headers', [
    [('Host', 'evil.example')], [('Host', 'localhost.evil.example')], [('Host', '')], [],
    [('Host', '127.0.0.1'), ('Host', '127.0.0.1')], [('Host', 'localhost;x')],
    [('Host', 'localhost@evil.example')], [('Host', '127.0.0.1.evil.example')]])
def test_a_name_that_may_lead_here_from_another_site_is_rejected(server, headers):
    status, text, _ = get(server, f'/{TOKEN}/', headers)
    assert status == 403
    assert 'is unknown; sim_view --allow-host NAME' in text


@pytest.mark.parametrize('path', [f'/{TOKEN}/../../etc/passwd', f'/{TOKEN}/%2e%2e/x',
                                  f'/{TOKEN}/..%5c..%5cx', f'/{TOKEN}//etc/passwd'])
def test_nothing_is_served_but_the_page(server, path):
    assert get(server, path, [('Host', own(server))])[0] == 404


async def first_message(server, path, origin, host='127.0.0.1'):
    async with websockets.connect(
            f'ws://{own(server, host)}{path}', origin=origin, proxy=None,
            subprotocols=[f'viser-v{viser.__version__}']) as opened:
        return await asyncio.wait_for(opened.recv(), 300.0)


def test_the_socket_is_opened_by_the_page_alone(server, capfd):
    path, origin = f'/{TOKEN}', f'http://{own(server)}'
    assert asyncio.run(first_message(server, path, origin))
    # A proxy may speak TLS to the browser.
    assert asyncio.run(first_message(server, path, f'https://{own(server)}'))
    for where, other in (('', origin), ('/x', origin), (path, 'https://evil.example'),
                         (path, 'null'), (path, None), (path, 'http://127.0.0.1:1'),
                         (path, f'http://localhost:{server.get_port()}'),
                         (path, f'http://127.0.0.1.evil.example:{server.get_port()}')):
        with pytest.raises(websockets.exceptions.InvalidStatus) as error:
            asyncio.run(first_message(server, where, other))
        assert error.value.response.status_code == 403
    # Who comes and goes is not printed.
    assert capfd.readouterr().out == ''


def test_what_the_page_does_not_send_is_ignored(server):
    """As a request to share the page with everybody, or to change an attribute of an element."""
    slider, = (handle for handle in server.gui._gui_input_handle_from_uuid.values())
    seen = []
    server._websock_server.register_handler(viser._messages.ShareUrlRequest,
                                            lambda *_: seen.append('share'))

    async def send():
        async with websockets.connect(
                f'ws://{own(server)}/{TOKEN}', origin=f'http://{own(server)}', proxy=None,
                subprotocols=[f'viser-v{viser.__version__}'], max_size=None) as opened:
            for message in (
                    {'type': 'ShareUrlRequest'}, 'text', b'\xc1', {'type': 'x'}, [], {},
                    {'type': 'GuiUpdateMessage', 'uuid': slider._impl.uuid,
                     'updates': {'removed': True, 'value': 0.9}},
                    {'type': 'GuiUpdateMessage', 'uuid': slider._impl.uuid,
                     'updates': {'value': float('nan')}},
                    {'type': 'GuiUpdateMessage', 'uuid': slider._impl.uuid,
                     'updates': {'value': 0.7}}):
                await opened.send(message if isinstance(message, (str, bytes))
                                  else msgspec.msgpack.encode(message))
            end = asyncio.get_running_loop().time() + 20.0
            while slider.value != 0.7 and asyncio.get_running_loop().time() < end:
                await asyncio.sleep(0.01)
    asyncio.run(send())
    assert (slider.value, slider._impl.removed, seen) == (0.7, False, [])


CAMERA = {'wxyz': [1.0, 0.0, 0.0, 0.0], 'position': [1.0, 1.0, 1.0], 'fov': 1.0, 'near': 0.1,
          'far': 100.0, 'image_height': 400, 'image_width': 800, 'look_at': [0.0, 0.0, 0.0],
          'up_direction': [0.0, 0.0, 1.0]}
POSE = {'name': '/t', 'owner': '', 'wxyz': [1.0, 0.0, 0.0, 0.0], 'position': [0.0, 0.0, 0.0]}


def hostile_frames(inputs):
    """Yield messages of the page with nested, unknown, missing and wrong content."""
    for depth in (3, 100, 950, 1000, 5000, 60_000):
        nested = b'\x91' * depth + b'\xc0'
        yield b'\x82\xa4type\xb0GuiUpdateMessage\xa1x' + nested
        yield b'\x81\xa4type' + nested
        yield b'\x82\xa4type\xb0GuiUpdateMessage\xa7updates\x81\xa5value' + nested
    values = [None, True, -1, 0, 'x', '', [], ['a'] * 4, [0.0], {}, {'a': 1}]
    for kind in sorted(server_module._TAKEN):
        for more in ({}, {'x': 1}, {'name': None}, {'uuid': 1, 'updates': {'value': 1}}):
            yield {'type': kind, **more}
    for whole, kind in ((CAMERA, 'ViewerCameraMessage'), (POSE, 'TransformControlsUpdateMessage')):
        for key, value in itertools.product(whole, values):
            yield {'type': kind, **whole, key: value}
        yield {'type': kind, **whole, 'unknown': 1}
    for uuid, value in itertools.product([*inputs, 'nobody'], values):
        yield {'type': 'GuiUpdateMessage', 'uuid': uuid, 'updates': {'value': value}}


def test_whatever_a_client_with_the_token_sends_is_a_line_at_most(server, caplog, capfd):
    gui = server.gui
    slider = gui.add_slider('a', 0.0, 1.0, 0.1, 0.5)
    choice, box = gui.add_dropdown('b', ('x', 'y'), initial_value='y'), gui.add_checkbox('c', True)
    group, text = gui.add_button_group('d', ('p', 'q')), gui.add_text('e', 'z')
    server.scene.add_transform_controls('/t')
    handles = (slider, choice, box, group, text)
    for handle in handles[:3]:
        handle.on_update(lambda event: None)
    frames = [*hostile_frames([handle._impl.uuid for handle in handles])]

    async def send():
        async with websockets.connect(
                f'ws://{own(server)}/{TOKEN}', origin=f'http://{own(server)}', proxy=None,
                subprotocols=[f'viser-v{viser.__version__}'], max_size=None) as opened:
            await opened.send(msgspec.msgpack.encode({'type': 'ViewerCameraMessage', **CAMERA}))
            for frame in frames:
                await opened.send(
                    frame if isinstance(frame, bytes) else msgspec.msgpack.encode(frame))
            await opened.send(msgspec.msgpack.encode({
                'type': 'GuiUpdateMessage', 'uuid': slider._impl.uuid,
                'updates': {'value': 0.7}}))
            end = asyncio.get_running_loop().time() + 60.0
            while slider.value != 0.7 and asyncio.get_running_loop().time() < end:
                await asyncio.sleep(0.01)
    asyncio.run(send())
    assert slider.value == 0.7  # The connection is still there.
    assert choice.value == 'x' and isinstance(box.value, bool) and group.value in ('p', 'q')
    assert not [record for record in caplog.records if record.exc_info]
    assert len([record for record in caplog.records if record.name == server_module.__name__]) == 1
    assert 'Traceback' not in capfd.readouterr().err


@pytest.mark.parametrize('logger', ['websockets.server', 'asyncio'])
def test_what_else_fails_for_a_browser_is_logged_in_a_line(server, caplog, logger):
    try:
        raise ValueError('two\nlines')
    except ValueError:
        logging.getLogger(logger).exception('connection handler failed')
    (record,) = caplog.records
    assert record.exc_info is None
    assert record.getMessage() == (
        r'sim_view: what a browser sent failed: ValueError: two\nlines')


@given(st.binary(max_size=60) | st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-2**63, 2**63) | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(['type', 'updates', 'value', 'image_width']) | st.text(max_size=2), inner,
        max_size=4), max_leaves=8).map(msgspec.msgpack.encode))
def test_any_bytes_are_taken_or_ignored(data):
    page_message(data)


@pytest.mark.parametrize(('change', 'taken'), [
    ({}, True), ({'image_width': 0}, False), ({'image_width': 1}, True),
    ({'position': [0.0, 1.0]}, False), ({'position': [float('inf'), 0.0, 0.0]}, False),
    ({'fov': 1e30}, False), ({'fov': 1}, True), ({'far': '1'}, False), ({'unknown': 1}, False),
    ({'type': ['x']}, False), ({'type': 'ShareUrlRequest'}, False)])
def test_a_camera_of_a_browser_is_complete_and_plain(change, taken):
    data = msgspec.msgpack.encode({'type': 'ViewerCameraMessage', **CAMERA, **change})
    assert (page_message(data) is not None) == taken


@pytest.mark.parametrize(('updates', 'taken'), [
    ({'value': 'Pause'}, True), ({'value': 'x' * 201}, False), ([], False), ({}, False),
    ({'value': 1, 'removed': True}, False), ({'value': [[[[[1]]]]]}, False)])
def test_an_update_of_a_browser_is_of_a_plain_value(updates, taken):
    data = msgspec.msgpack.encode({'type': 'GuiUpdateMessage', 'uuid': 'x', 'updates': updates})
    assert (page_message(data) is not None) == taken


def test_a_token_is_new_each_time_or_that_of_the_environment():
    assert Access.of({}).token != Access.of({}).token
    assert len(Access.of({}).token) >= 22
    assert Access.of({TOKEN_VARIABLE: TOKEN}).token == TOKEN
    for bad in ('short', 'x' * 129, 'with a space in it', 'umlaut-äöü-umlaut', '/' * 20):
        with pytest.raises(ManipSimError, match='SIM_VIEW_TOKEN must have 16 to 128'):
            Access.of({TOKEN_VARIABLE: bad})


def test_a_server_without_the_check_is_not_used():
    with pytest.raises(ManipSimError, match='without the check of the token'), guarding(
            Access.of({})):
        pass
    assert websockets.asyncio.server.serve is websockets.asyncio.server.__dict__['serve']
    assert websockets.asyncio.server.serve.__module__ == 'websockets.asyncio.server'


@pytest.mark.parametrize(('host', 'begin'), [
    ('127.0.0.1', 'http://127.0.0.1:'), ('::1', 'http://[::1]:'),
    ('0.0.0.0', f'http://{socket.gethostname()}:')])
def test_the_address_can_be_opened_as_it_is_printed(server, host, begin):
    address = page_address(server, host, Access.of({TOKEN_VARIABLE: TOKEN}))
    assert address == f'{begin}{server.get_port()}/{TOKEN}/'


def test_what_is_no_request_does_not_fill_the_log(server, caplog):
    for data in (b'\0' * 100 + b'\r\n\r\n', b'GET\r\n\r\n', b'POST / HTTP/1.1\r\n\r\n', b''):
        with socket.create_connection(('127.0.0.1', server.get_port()), 20.0) as opened:
            opened.sendall(data)
            opened.shutdown(socket.SHUT_WR)
            with contextlib.suppress(ConnectionError):
                while opened.recv(4096):
                    pass
    assert get(server, f'/{TOKEN}/', [('Host', own(server))])[0] == 200
    assert caplog.records == []


def test_another_server_adds_nothing_to_the_log(server):
    filters = logging.getLogger('websockets.server').filters
    before = [*filters]
    close_server(open_server('127.0.0.1', 0, Access.of({}, [])))
    assert filters == before
