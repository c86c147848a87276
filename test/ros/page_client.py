# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A client of the viewer's socket that knows the token: it uses the page without a browser."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
import re
import time
from typing import Any

import msgspec
import viser
import websockets
import zstandard

#: How long to wait for something on the page [s].
_PATIENCE_S = 300.0


class PageClient:
    """
    A client of the page.

    :ivar inputs: kind and label of each element that it was sent, by id
    :ivar targets: names of the targets of end effectors in the scene
    :ivar shapes: names of the shapes of bodies in the scene
    :ivar texts: the last content of each element of text, by id
    """

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self.inputs: dict[str, tuple[str, str | None]] = {}
        self.targets: set[str] = set()
        self.shapes: set[str] = set()
        self.texts: dict[str, str] = {}

    async def read_until(self, condition: Callable[[], bool]) -> None:
        """Take what the viewer sends until a condition holds."""
        end_s = time.monotonic() + _PATIENCE_S
        while not condition():
            assert time.monotonic() < end_s, 'timed out'
            try:
                for message in messages_of(await asyncio.wait_for(self._socket.recv(), 0.1)):
                    self._take(message)
            except asyncio.TimeoutError:
                continue

    def _take(self, message: dict[str, Any]) -> None:
        kind, props = message['type'], message.get('props')
        if kind == 'ResetGuiMessage':
            self.inputs.clear()
            self.texts.clear()
        elif kind == 'TransformControlsMessage':
            self.targets.add(message['name'])
        elif kind == 'MeshMessage':
            self.shapes.add(message['name'])
        elif kind == 'GuiUpdateMessage' and 'content' in message['updates']:
            self.texts[message['uuid']] = message['updates']['content']
        elif 'uuid' in message and isinstance(props, dict):
            self.inputs[message['uuid']] = kind, props.get('label')
            if 'content' in props:
                self.texts[message['uuid']] = props['content']

    async def send(self, kind: str, **fields: Any) -> None:
        """Send a message of the page."""
        await self.send_data(msgspec.msgpack.encode({'type': kind, **fields}))

    async def send_data(self, data: bytes) -> None:
        """Send bytes, which may be no message."""
        await self._socket.send(data)

    async def use(self, chosen: Callable[[str, str | None], bool]) -> None:
        """Give those inputs that are chosen by kind and label the values that they may have."""
        values = {'GuiSliderMessage': (0.3,), 'GuiCheckboxMessage': (True,),
                  'GuiButtonMessage': (True,), 'GuiButtonGroupMessage': (
                      'Pause', 'Step', 'Reset', 'Tare wrench', 'Open', 'Close', 'Resume')}
        for uuid, (kind, label) in list(self.inputs.items()):
            for value in values.get(kind, ()) if chosen(kind, label) else ():
                await self.send('GuiUpdateMessage', uuid=uuid, updates={'value': value})


def messages_of(data: bytes) -> Iterator[dict[str, Any]]:
    """Return the messages of a frame that the viewer sent."""
    size = int.from_bytes(data[8:16], 'little')
    unpacked = zstandard.ZstdDecompressor().decompress(data[16:16 + size],
                                                       max_output_size=1 << 28)
    yield from msgspec.msgpack.decode(unpacked)['messages']


@asynccontextmanager
async def page_client(address: str) -> AsyncIterator[PageClient]:
    """Open the page at the address that ``sim_view`` has printed."""
    origin = re.match(r'http://[^/]*', address)
    assert origin is not None
    async with websockets.connect(
            'ws' + address.removeprefix('http').rstrip('/'),
            origin=origin.group(), proxy=None, max_size=None,  # type: ignore[arg-type]
            subprotocols=[f'viser-v{viser.__version__}']) as socket:  # type: ignore[list-item]
        client = PageClient(socket)
        await client.send(
            'ViewerCameraMessage', wxyz=[1.0, 0.0, 0.0, 0.0], position=[1.0, 1.0, 1.0], fov=1.0,
            near=0.1, far=100.0, image_height=400, image_width=800, look_at=[0.0, 0.0, 0.0],
            up_direction=[0.0, 0.0, 1.0])
        yield client
