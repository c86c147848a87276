# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Random and damaged messages to the viewer, from ROS and over the socket of its page."""

from __future__ import annotations

import asyncio
import random
import re
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hostile_node import archive, HostileNode, NAME, TOPICS
import msgspec
from page_client import page_client, PageClient
from random_messages import damaged, mutate, random_message, TEXTS
from rclpy.serialization import serialize_message
from std_msgs.msg import String, UInt8MultiArray
from target import Row, SoakError, Watched

#: Messages between two looks at the viewer, and how many before growth counts.
_BURST = 20
_WARM = 20


class Viewer(Watched):
    """The viewer as a process, beside a hostile node."""

    def __init__(self) -> None:
        super().__init__('manip_sim.viewer', '--node', NAME, '--port', '0')
        self.address = ''

    def wait_until_ready(self) -> None:
        """Wait until it has printed its address."""
        def printed() -> bool:
            self.check_alive()
            _, _, line = self.output().partition('sim_view: ')
            self.address = line.split()[0] if '\n' in line else ''
            return bool(self.address)
        self.client.spin_until(printed)


def viewer(count: int, seed: int) -> Row:
    """Send the viewer anything on all topics that it reads, and over the socket of its page."""
    rng = random.Random(seed)
    with Viewer() as target:
        hostile = HostileNode(lambda what: what)
        try:
            begin = time.monotonic()
            sent, used, rejected = asyncio.run(_load(target, hostile, rng, count))
            rate = sent / (time.monotonic() - begin)
        finally:
            hostile.close()
        growth = target.checked_growth()
        target.check_alive()
        output = target.output(10**9)
        # As RejectionLog writes what nobody expected; what is rejected has no name of a class.
        unexpected = re.findall(r'\]: [^:]*: \w+(?:Error|Exception|Warning): .*', output)
        if unexpected or 'Traceback' in output:
            raise SoakError(f'the viewer has not checked: {unexpected[:5]} {output[-2000:]}')
        target.stop()
    return {'load': 'malformed messages to the viewer',
            'amount': f'{sent} messages, {used} over the socket',
            'result': f'{rate:.0f}/s, {rejected} of them rejected; alive, shows what is right',
            'growth': growth}


async def _load(target: Viewer, hostile: HostileNode, rng: random.Random, count: int
                ) -> tuple[int, int, int]:
    """Return how many messages were sent by ROS and by the socket, and how many were rejected."""
    sent = used = 0
    async with page_client(target.address) as page:
        def labels() -> set[str | None]:
            return {label for _, label in page.inputs.values()}
        await page.read_until(lambda: {'front', 'arm [rad]'} <= labels())
        await page.use(lambda kind, label: kind == 'GuiCheckboxMessage')
        while sent < count:
            for _ in range(min(_BURST, count - sent)):
                _send(hostile, rng)
                sent += 1
            for _ in range(4):
                await _use(page, rng)
                used += 1
            await _see(page, hostile, f'{sent} messages')
            target.check_alive()
            if sent == _WARM * _BURST:
                target.mark()
        # After all this, it shows what is right.
        hostile.send_world()
        await _see(page, hostile, 'the end')
        await page.read_until(lambda: 'arm [rad]' in labels())
        return sent, used, _rejected(page)


async def _see(page: PageClient, hostile: HostileNode, text: str) -> None:
    """Publish a status until the page shows it: then the viewer has taken what came before."""
    status = DiagnosticArray(status=[DiagnosticStatus(
        name=f'{NAME}: load', level=b'\1', message=text)])

    def is_shown() -> bool:
        hostile.publishers['/diagnostics'].publish(status)
        return any(f'{text}</div>' in found for found in page.texts.values())
    await page.read_until(is_shown)


def _rejected(page: PageClient) -> int:
    for text in page.texts.values():
        head, found, _ = text.partition(' rejected, see its log')
        if found:
            return int(head.rpartition('</b>: ')[2].split()[0])
    raise SoakError('the page does not tell that messages were rejected')


def _send(hostile: HostileNode, rng: random.Random) -> None:
    """Publish a message that is right, random or damaged on a topic that the viewer reads."""
    chance = rng.random()
    if chance < 0.02:
        xml = (f'<mujoco><worldbody><body name="{rng.randrange(9)}"><joint name="joint" '
               f'range="-{rng.choice((0.1, 1, 1e9))} 1"/><geom size="{rng.choice((0.1, 1e9))}"/>'
               '</body></worldbody></mujoco>')
        data = archive(xml)
        hostile.model.publish(UInt8MultiArray(
            data=data if rng.random() < 0.5 else damaged(rng, data)))
    elif chance < 0.03:
        hostile.urdf.publish(String(data=rng.choice(('', '<robot/>', '<robot>', *TEXTS))))
    topic = rng.choice(sorted(TOPICS))
    message: Any = hostile.states()[topic] if chance < 0.8 else random_message(
        rng, TOPICS[topic])
    for _ in range(rng.choice((0, 1, 1, 2))):
        mutate(rng, message)
    if topic == '/diagnostics':
        for status in message.status:
            if not status.name.startswith(NAME) and rng.random() < 0.9:
                status.name = f'{NAME}: {status.name}'
    hostile.publishers[topic].publish(
        message if rng.random() < 0.8 else damaged(rng, serialize_message(message)))


async def _use(page: PageClient, rng: random.Random) -> None:
    """Send what a page sends, or what none does."""
    values = {'GuiSliderMessage': (0.3, -1e9, 1e300, float('nan')),
              'GuiCheckboxMessage': (True, False), 'GuiDropdownMessage': ('arm', '', '<b>'),
              'GuiButtonGroupMessage': ('Pause', 'Step', 'Reset', 'Tare wrench', 'x')}
    uuid, (kind, _) = rng.choice(sorted(page.inputs.items()))
    await page.send(rng.choice(('GuiUpdateMessage', 'ShareUrlRequest', 'x')), uuid=uuid, updates={
        rng.choice(('value', 'value', 'value', 'removed')): rng.choice(values.get(kind, (0,)))})
    await page.send('ViewerCameraMessage', wxyz=[rng.choice((0.0, 1.0, float('inf')))] * 4,
                    position=[rng.choice((0.0, 1.0, 1e11))] * 3, fov=1.0, near=0.1, far=100.0,
                    image_height=rng.choice((-1, 0, 1, 400)), image_width=rng.choice((1, 10**9)),
                    look_at=[0.0, 0.0, 0.0], up_direction=[0.0, 0.0, 1.0])
    await page.send_data(msgspec.msgpack.encode(rng.choice(([], {}, 'x', None, {'type': []})))
                         if rng.random() < 0.5 else rng.randbytes(rng.randint(0, 40)))
