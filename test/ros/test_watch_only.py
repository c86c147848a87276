# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``sim_view --no-commands``: whatever comes over the socket, nothing goes to the node."""

from __future__ import annotations

import asyncio
import re
import time

from harness import START_S
from hostile_node import HostileNode, NAME
import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

import msgspec  # noqa: E402
from test_viewer import end, start_viewer  # noqa: E402
import viser  # noqa: E402
import websockets  # noqa: E402
import zstandard  # noqa: E402

CAMERA = 'front/color/image_raw'
#: What every node publishes, and a viewer that only watches too.
OF_EVERY_NODE = {'/rosout', '/parameter_events'}


class Browser:
    """A client of the socket that knows the token, and keeps what it is sent."""

    def __init__(self, socket):
        self._socket, self.inputs, self.targets = socket, {}, set()

    async def read_until(self, condition):
        unpack, end_s = zstandard.ZstdDecompressor(), time.monotonic() + START_S
        while not condition():
            assert time.monotonic() < end_s
            try:
                data = await asyncio.wait_for(self._socket.recv(), 0.1)
            except asyncio.TimeoutError:
                continue
            size = int.from_bytes(data[8:16], 'little')
            for message in msgspec.msgpack.decode(unpack.decompress(
                    data[16:16 + size], max_output_size=1 << 28))['messages']:
                self._take(message)

    def _take(self, message):
        if message['type'] == 'ResetGuiMessage':
            self.inputs.clear()
        if message['type'] == 'TransformControlsMessage':
            self.targets.add(message['name'])
        if 'uuid' in message and isinstance(message.get('props'), dict):
            self.inputs[message['uuid']] = message['type'], message['props'].get('label')

    async def send(self, kind, **fields):
        await self._socket.send(msgspec.msgpack.encode({'type': kind, **fields}))

    async def use(self, label_or_all):
        """Give all inputs some of the values that they may have."""
        for uuid, (kind, label) in list(self.inputs.items()):
            if (label == 'Show') != (label_or_all == 'Show'):
                continue
            values = {'GuiSliderMessage': (0.3,), 'GuiCheckboxMessage': (True,),
                      'GuiButtonMessage': (True,), 'GuiButtonGroupMessage': (
                          'Pause', 'Step', 'Reset', 'Tare', 'Open', 'Close', 'Resume')}
            for value in values.get(kind, ()):
                await self.send('GuiUpdateMessage', uuid=uuid, updates={'value': value})


async def use_everything(address, hostile):
    """Use all that the page has, and what it would have if people could command the node."""
    origin = re.match(r'http://[^/]*', address).group()
    async with websockets.connect(
            'ws' + address.removeprefix('http').rstrip('/'), origin=origin, proxy=None,
            subprotocols=[f'viser-v{viser.__version__}'], max_size=None) as socket:
        browser = Browser(socket)
        await browser.send('ViewerCameraMessage', wxyz=[1.0, 0.0, 0.0, 0.0], fov=1.0, near=0.1,
                           position=[1.0, 1.0, 1.0], far=100.0, image_height=400,
                           image_width=800, look_at=[0.0, 0.0, 0.0], up_direction=[0.0, 0.0, 1.0])
        await browser.read_until(
            lambda: {'Names', 'front'} <= {label for _, label in browser.inputs.values()})
        # The sliders come when the control modes are known, from the next diagnostics.
        begin_s = time.monotonic()
        await browser.read_until(lambda: time.monotonic() > begin_s + 1.0)
        await browser.use('all')
        for name in {'/targets/right', *browser.targets}:
            await browser.send('TransformControlsDragStartMessage', name=name, owner='')
            await browser.send('TransformControlsUpdateMessage', name=name, owner='',
                               wxyz=[1.0, 0.0, 0.0, 0.0], position=[0.1, 0.2, 0.3])
        # What is used last is done last: the viewer listens to the camera.
        await browser.use('Show')
        await browser.read_until(
            lambda: hostile.publishers[CAMERA].get_subscription_count() > 0)
        begin_s = time.monotonic()
        await browser.read_until(lambda: time.monotonic() > begin_s + 0.5)
        return {label for _, label in browser.inputs.values()}


@pytest.mark.parametrize('options', [['--no-commands'], []], ids=['watch', 'drive'])
def test_a_page_that_only_watches_can_send_nothing(client, options):
    hostile = HostileNode(lambda what: what)
    process, address = start_viewer('--node', NAME, *options)
    try:
        labels = asyncio.run(use_everything(address, hostile))
        publishers, clients = (
            {name for name, _ in found('sim_view', '/')} for found in (
                client.node.get_publisher_names_and_types_by_node,
                client.node.get_client_names_and_types_by_node))
        if options:
            assert hostile.taken == []
            assert publishers <= OF_EVERY_NODE
            assert clients == set()
            assert not labels & {'Simulation', 'Start again', 'Target right', 'joint'}
        else:  # The same does a lot where it may.
            assert {type(taken).__name__ for taken in hostile.taken} == {
                'JointState', 'PoseStamped', 'SetBool_Request', 'Trigger_Request'}
            assert publishers > {'/arm/joint_command', '/right/target_pose'}
            assert len(clients) == 4
    finally:
        hostile.close()
        _, errors = end(process)
    assert (process.returncode, errors) == (0, '')
