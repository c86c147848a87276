# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The server of the page: where it listens, and the theme of the page."""

from __future__ import annotations

import asyncio
import contextlib
import io
import math
import socket
from typing import Any

from manip_sim.errors import ManipSimError
from manip_sim.viewer.page.access import Access, guarding

_LAST_PORT = 65535
#: Colour of buttons and sliders.
_BRAND = (40, 110, 180)
#: Colour of the light from below, strength of that from above, and the turn that makes it so.
_GROUND, _SKY = (150, 145, 140), 2.5
_Y_TO_Z = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)


def open_server(host: str, port: int, access: Access) -> Any:
    """
    Return a ``viser.ViserServer``.

    :param host: name or address of the interface to listen on
    :param port: 0 takes one that is free
    :param access: who may open the page
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
    _light(server.scene)
    return server


def _light(scene: Any) -> None:
    """
    Light the scene from above and, less, from below, beside the lights that viser has.

    A browser fades the scene in when it has loaded the environment map that viser has by default.
    With viser 1.1 it stops halfway for good if another map comes meanwhile, which happens where
    it draws slowly; without a map there is nothing to wait for.
    """
    scene.configure_environment_map(None)
    scene.add_light_hemisphere('/sky', ground_color=_GROUND, intensity=_SKY, wxyz=_Y_TO_Z)


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
        what = error.strerror or error
        raise ManipSimError(f'cannot listen on {host}:{port}: {what}; choose another port with '
                            '--port, or another address with --listen') from error
