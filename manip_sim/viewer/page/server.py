# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The server of the page: where it listens, whom it admits, and the theme of the page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass
import hmac
from http import HTTPStatus
import io
import ipaddress
import logging
import math
import re
import secrets
import socket
from typing import Any

import msgspec
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from manip_sim.errors import ManipSimError
from manip_sim.quoting import one_line, quoted

#: Environment variable with a token that stays the same.
TOKEN_VARIABLE = 'SIM_VIEW_TOKEN'
_TOKEN = re.compile(r'[A-Za-z0-9_-]{16,128}')
_TOKEN_BYTES = 16
#: Size of a message of a browser at most [bytes].
_MAX_BYTES = 2**16
_MAX_TEXT = 200
#: Levels of a message at most; a list in a camera is the second one.
_MAX_DEPTH = 4
_LOGGER = logging.getLogger(__name__)
#: The header Host: a name or an address, and a port.
_HOST = re.compile(r'(?P<name>[a-z0-9._-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?')
#: Messages of browsers: inputs, cameras, and targets and bodies that are dragged.
_TAKEN = {'GuiUpdateMessage', 'ViewerCameraMessage', 'TransformControlsUpdateMessage',
          'TransformControlsDragStartMessage', 'TransformControlsDragEndMessage',
          'SceneNodeDragMessage'}
#: The page is one file, whose script is written in it and makes functions of text; it needs
#: nothing from elsewhere.
_POLICY = ("default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; "
           "style-src 'unsafe-inline'; img-src data: blob:; font-src data: blob:; "
           "media-src data: blob:; worker-src data: blob:; connect-src {} data: blob:; "
           "frame-ancestors 'none'; base-uri 'none'; form-action 'none'")


@dataclass(frozen=True)
class Access:
    """
    Permissions to open the page.

    :ivar token: the first part of the path of the page and of its socket
    :ivar names: under which a browser may reach this machine, beside any address
    """

    token: str
    names: frozenset[str]

    @staticmethod
    def of(environment: Mapping[str, str], names: Iterable[str] = ()) -> Access:
        """
        Return the access by the token of the environment, or by a new one.

        :param environment: may have ``SIM_VIEW_TOKEN``
        :param names: beside ``localhost`` and the name of this machine
        :raises ManipSimError: if the token is too short to be secret, or fits in no address
        """
        token = environment.get(TOKEN_VARIABLE) or secrets.token_urlsafe(_TOKEN_BYTES)
        if not _TOKEN.fullmatch(token):
            raise ManipSimError(f'{TOKEN_VARIABLE} must have 16 to 128 of the characters A-Z, '
                                'a-z, 0-9, _ and -')
        host = socket.gethostname()
        return Access(token, frozenset(name.lower() for name in (
            'localhost', host, f'{host}.local', *names)))

    def reason_against(self, path: str, headers: Sequence[tuple[str, str]]) -> str:
        """
        Return why a request is rejected; empty if it is not.

        A page of another site cannot read the token, and its name in ``Origin`` is another. An
        address cannot be rebound to another machine by who owns a name, so all are accepted.

        :param path: begins with the token, ``/<token>/``
        """
        hosts, origins, upgrades = (
            [value.lower() for name, value in headers if name.lower() == header]
            for header in ('host', 'origin', 'upgrade'))
        match = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
        name = '' if match is None else match['name']
        try:
            ipaddress.ip_address(name.strip('[]'))
        except ValueError:
            if name not in self.names:
                return (f'the host {quoted(" ".join(hosts))} is unknown; sim_view --allow-host '
                        'NAME allows a name')
        # A browser sends the origin of the page that opens a socket.
        own_origins = f'http://{hosts[0]}', f'https://{hosts[0]}'
        if any(origin not in own_origins for origin in origins) or len(origins) < len(upgrades):
            return f'the origin {quoted(" ".join(origins))} is another'
        first = path.partition('?')[0].lstrip('/').partition('/')[0]
        if not hmac.compare_digest(first.encode(errors='replace'), self.token.encode()):
            return 'open the address that sim_view has printed, with the token at its end'
        return ''


def _is_of_interest(record: logging.LogRecord) -> bool:
    """Keep invalid requests of clients out of the log, and make other errors a line."""
    if record.getMessage() == 'opening handshake failed':
        return False
    if record.exc_info and record.exc_info[1] is not None:
        error, record.exc_info = record.exc_info[1], None
        record.msg, record.args = 'sim_view: what a browser sent failed: %s: %s', (
            type(error).__name__, one_line(str(error)))
    return True


@contextlib.contextmanager
def guarding(access: Access) -> Iterator[type[CheckedConnection]]:
    """
    Let servers of websockets that are started within this block check what comes.

    :returns: the class of their connections
    :raises ManipSimError: at the end, if none was started; it would be open to everybody
    """
    serve: Callable[..., Any] = websockets.asyncio.server.serve
    guarded = False

    class Connection(CheckedConnection):
        """A connection of this server."""

    def serve_guarded(handler: Any, *arguments: Any, process_request: Any, **options: Any) -> Any:
        nonlocal guarded
        guarded = True
        options.update(create_connection=Connection, max_size=_MAX_BYTES)
        # A filter that is there already is not added again.
        for name in ('websockets.server', 'asyncio'):
            logging.getLogger(name).addFilter(_is_of_interest)
        return serve(handler, *arguments, process_request=_check(access, process_request),
                     **options)

    vars(websockets.asyncio.server)['serve'] = serve_guarded
    try:
        yield Connection
    finally:
        vars(websockets.asyncio.server)['serve'] = serve
    if not guarded:
        raise ManipSimError('this release of viser serves the page in another way, without the '
                            'check of the token; install viser 1.1')


def _check(access: Access, answer: Any) -> Any:
    """Return what answers requests: with an error if they are rejected, else as before."""
    def process_request(connection: ServerConnection, request: Request) -> Response | None:
        reason = access.reason_against(request.path, list(request.headers.raw_items()))
        if reason:
            return connection.respond(HTTPStatus.FORBIDDEN, f'sim_view: {reason}\n')
        stripped = Request(request.path.replace(access.token, '', 1).replace('//', '/', 1),
                           request.headers)
        response: Response | None = answer(connection, stripped)
        if response is not None:
            host = request.headers['Host']
            response.headers['Content-Security-Policy'] = _POLICY.format(
                f'ws://{host} wss://{host}')
            response.headers['Referrer-Policy'] = 'no-referrer'
            response.headers['X-Content-Type-Options'] = 'nosniff'
            response.headers['Cache-Control'] = 'no-store'
        return response
    return process_request


class CheckedConnection(ServerConnection):
    """A connection to a browser; messages that the page does not send are ignored, logged once."""

    #: The inputs of the page, set when the server has started.
    gui: Any = None
    _reported = False

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message that the page may have sent."""
        while True:
            data = await super().recv(decode)
            message = page_message(data) if isinstance(data, bytes) else None
            if message is not None:
                if _is_possible(self.gui, message):
                    return data
            elif not self._reported:
                self._reported = True
                _LOGGER.warning('sim_view: messages of %s that the page does not send are ignored',
                                self.remote_address[0])


def page_message(data: bytes) -> Any:
    """
    Return a message that the page may have sent, as viser reads it, or None.

    viser would also share the page with the whole internet, take files, and change any attribute
    of an element for all browsers.
    """
    from viser import _messages
    try:
        content = msgspec.msgpack.decode(data, type=dict[str, Any])
        kind = content.pop('type', None)
        if kind not in _TAKEN or not _is_plain(content, _MAX_DEPTH):
            return None
        message = msgspec.convert(content, getattr(_messages, kind))
    except (msgspec.DecodeError, UnicodeDecodeError, TypeError, RecursionError):
        return None
    possible = (content.keys() <= vars(message).keys()
                and getattr(message, 'updates', {'value': 0}).keys() == {'value'}
                and min(getattr(message, side, 1) for side in ('image_width', 'image_height')) > 0)
    return message if possible else None


def _is_possible(gui: Any, message: Any) -> bool:
    """Return whether an input may have the value that a message gives it, if it gives any."""
    handle = getattr(gui, '_gui_input_handle_from_uuid', {}).get(getattr(message, 'uuid', None))
    if handle is None:
        return True
    value, present = message.updates['value'], handle.value
    if isinstance(present, bool) or isinstance(value, bool):
        return type(value) is type(present)
    if isinstance(present, (int, float)):
        return isinstance(value, (int, float))
    return isinstance(value, str) and value in getattr(handle, 'options', (value,))


def _is_plain(value: Any, depth: int) -> bool:
    """Return whether a value has finite numbers and short texts only, and few levels."""
    if isinstance(value, (dict, list)):
        items = value if isinstance(value, list) else [*value, *value.values()]
        return depth > 0 and all(_is_plain(item, depth - 1) for item in items)
    if isinstance(value, (int, float)):
        return math.isfinite(value) and abs(value) < 1e12
    return value is None or isinstance(value, str) and len(value) <= _MAX_TEXT


_LAST_PORT = 65535
#: Colour of buttons and sliders.
_BRAND = (40, 110, 180)
#: Colour of the light from below, strength of that from above, and the turn that makes it so.
_GROUND, _SKY = (150, 145, 140), 2.5
_Y_TO_Z = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)


def open_server(host: str, port: int, access: Access) -> Any:
    """
    Return a ``viser.ViserServer`` that listens at the name or address of an interface.

    :param port: 0 takes one that is free
    :raises ManipSimError: if it cannot listen there
    """
    _check_free(host, port)
    import viser
    _set_events_from_any_thread()
    # It prints its address in a frame.
    with contextlib.redirect_stdout(io.StringIO()), guarding(access) as connections:
        server = viser.ViserServer(host=host, port=port, verbose=False)
        connections.gui = server.gui
    if port and server.get_port() != port:
        close_server(server)
        raise ManipSimError(f'cannot listen on {host}:{port}: another process has just taken it')
    server.gui.set_panel_label('manip_sim')
    # A browser fades the scene in when it has loaded the environment map that viser has by
    # default. With viser 1.1 it stops halfway for good if another map comes meanwhile, which
    # happens where it draws slowly; without a map there is nothing to wait for.
    server.scene.configure_environment_map(None)
    server.scene.add_light_hemisphere('/sky', ground_color=_GROUND, intensity=_SKY, wxyz=_Y_TO_Z)
    return server


class _Event(asyncio.Event):
    """
    An event that threads without an event loop may set too.

    viser 1.1 sets it in the calling thread, and then once more in the loop of the server; only
    the latter may touch those who wait: a set of both at once raises a RuntimeError.
    """

    def set(self) -> None:
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            self._value = True
        else:
            self._value = False  # Whoever waits has to be woken although another thread set it.
            super().set()


def _set_events_from_any_thread() -> None:
    """Let the servers of viser be told of messages by :class:`_Event`."""
    import viser.infra._infra as infra
    buffer: Any = infra.AsyncMessageBuffer

    class Buffer(buffer):  # type: ignore[misc]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self.message_event = _Event()
    if buffer.__name__ != Buffer.__name__:
        vars(infra)['AsyncMessageBuffer'] = Buffer


def page_address(server: Any, host: str, access: Access) -> str:
    """Return the address to open: that of this machine by its name if it listens on all."""
    if host in ('', '0.0.0.0', '::'):
        host = socket.gethostname()
    return f'http://{f"[{host}]" if ":" in host else host}:{server.get_port()}/{access.token}/'


def close_server(server: Any) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


#: Saves what the canvas of the scene shows as a file of the browser.
_SAVE_PICTURE = """document.querySelector('canvas[data-engine]').toBlob(picture => {
const link = document.createElement('a');
link.href = URL.createObjectURL(picture);
link.download = 'manip_sim_' + new Date().toISOString().slice(0, 19).replace(/:/g, '') + '.png';
link.click();
URL.revokeObjectURL(link.href);
});"""


def save_picture(server: Any, number: int | None) -> None:
    """Let a browser, by its number, save the scene as it shows it; one that is gone is ignored."""
    from viser import _messages
    client = server.get_clients().get(number)
    if client is not None:
        client._websock_connection.queue_message(
            _messages.RunJavascriptMessage(source=_SAVE_PICTURE))


def set_theme(server: Any, dark: bool) -> None:
    server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False,
                               brand_color=_BRAND, control_width='large')


def _check_free(host: str, port: int) -> None:
    """Try to listen, because the server would silently take the next port."""
    if not 0 <= port <= _LAST_PORT:
        raise ManipSimError(f'there is no port {port}: choose one from 0 to {_LAST_PORT} with '
                            '--port')
    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(
                host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE):
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                probe.bind(address)
                probe.listen()
    except OSError as error:
        reason = error.strerror or error
        raise ManipSimError(f'cannot listen on {host}:{port}: {reason}; choose another port with '
                            '--port, or another address with --listen') from error
