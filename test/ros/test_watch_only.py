# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``sim_view --no-commands``: whatever comes over the socket, nothing goes to the node."""

from __future__ import annotations

import asyncio
import time

from hostile_node import HostileNode, NAME
import pytest
from rclpy.node import NodeNameNonExistentError

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from page_client import page_client  # noqa: E402
from test_viewer import end, start_viewer  # noqa: E402

CAMERA = 'front/color/image_raw'
COMMANDS = {'/arm/joint_command', '/right/target_pose'}
#: What every node publishes, and a viewer that only watches too.
OF_EVERY_NODE = {'/rosout', '/parameter_events'}


async def use_everything(address, hostile):
    """Use all that the page has, and what it would have if people could command the node."""
    async with page_client(address) as page:
        def passed(duration_s):
            begin_s = time.monotonic()
            return lambda: time.monotonic() > begin_s + duration_s
        await page.read_until(
            lambda: {'Names', 'front'} <= {label for _, label in page.inputs.values()})
        # The sliders come when the control modes are known, from the next diagnostics.
        await page.read_until(passed(1.0))
        await page.use(lambda kind, label: label != 'Show')
        for name in {'/targets/right', *page.targets}:
            await page.send('TransformControlsDragStartMessage', name=name, owner='')
            await page.send('TransformControlsUpdateMessage', name=name, owner='',
                            wxyz=[1.0, 0.0, 0.0, 0.0], position=[0.1, 0.2, 0.3])
        await page.read_until(passed(1.0))  # Until bodies can be dragged.
        for phase in ('start', 'update'):
            for name in page.shapes:
                await page.send(
                    'SceneNodeDragMessage', name=name, owner='', phase=phase, instance_index=None,
                    button='left', modifier=None, start_position=[0.3, 0.0, 0.0],
                    start_screen_pos=[0.5, 0.5], end_position=[0.3, 0.0, 0.5],
                    end_screen_pos=[0.5, 0.2])
        # What is used last is done last: the viewer listens to the camera.
        await page.use(lambda kind, label: label == 'Show')
        await page.read_until(lambda: hostile.publishers[CAMERA].get_subscription_count() > 0)
        await page.read_until(passed(0.5))
        return {label for _, label in page.inputs.values()}


def names_at_the_viewer(names_and_types_by_node):
    """Return the names of one kind that the viewer has, none as long as it is not discovered."""
    try:
        return {name for name, _ in names_and_types_by_node('sim_view', '/')}
    except NodeNameNonExistentError:
        return set()


@pytest.mark.full
@pytest.mark.parametrize('options', [['--no-commands'], []], ids=['watch', 'drive'])
def test_a_page_that_only_watches_can_send_nothing(client, options):
    hostile = HostileNode(lambda what: what)
    process, address = start_viewer('--node', NAME, *options)
    try:
        labels = asyncio.run(use_everything(address, hostile))
        node = client.node
        # Our node discovers the viewer by itself; what it listens to last is known last.
        client.spin_until(lambda: f'/{CAMERA}' in names_at_the_viewer(
            node.get_subscriber_names_and_types_by_node))
        if not options:
            client.spin_until(lambda: len(names_at_the_viewer(
                node.get_client_names_and_types_by_node)) >= 6 and names_at_the_viewer(
                    node.get_publisher_names_and_types_by_node) > COMMANDS)
        publishers, clients = (names_at_the_viewer(found) for found in (
            node.get_publisher_names_and_types_by_node, node.get_client_names_and_types_by_node))
        if options:
            assert hostile.taken == []
            assert publishers <= OF_EVERY_NODE
            assert clients == set()
            assert not labels & {
                'Simulation', 'Sensors', 'Target right', 'Pull', 'joint'}
        else:  # The same does a lot where it may.
            client.spin_until(lambda: {type(taken).__name__ for taken in list(hostile.taken)} == {
                'JointState', 'Marker', 'PoseStamped', 'SetBool_Request', 'Trigger_Request'})
            assert publishers > COMMANDS
            assert len(clients) == 6
    finally:
        hostile.close()
        _, errors = end(process)
    assert (process.returncode, errors) == (0, '')
