# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Markers of contacts and wrenches: forces add up to a weight, what went is gone."""

from types import SimpleNamespace

import numpy as np
import pytest
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.physics.poses_and_twists import Pose
from manip_sim.ros import visualization_topics
from manip_sim.ros.executor import RejectionLog
from manip_sim.ros.messages import nanoseconds_of
from manip_sim.ros.visualization_topics import FORCE_SCALE, MarkerPublisher, TORQUE_SCALE

WEIGHT_N = 0.1 * 9.81


def point(message):
    return np.array([message.x, message.y, message.z])


def arrows(array, namespace):
    """Return where the arrows of a namespace begin and what they span, shapes (n, 3)."""
    found = [m for m in array.markers if m.ns == namespace and m.type == Marker.ARROW]
    assert [m.id for m in found] == list(range(len(found)))
    starts = np.array([point(m.points[0]) for m in found]).reshape(-1, 3)
    return starts, np.array([point(m.points[1]) for m in found]).reshape(-1, 3) - starts


@pytest.fixture
def shown(serve, client):
    """Return a node with a cube on a table, and the markers that it publishes."""
    node = serve(arena='table')
    return node, client.listen(MarkerArray, 'manip_sim/markers')


def test_forces_on_a_cube_add_up_to_its_weight_and_go_with_it(shown, client):
    node, arrays = shown

    def weight():
        return arrows(arrays[-1], 'contact_forces')[1].sum(axis=0)[2] / FORCE_SCALE
    client.spin_until(lambda: len(arrays) > 5 and abs(weight() - WEIGHT_N) < 1e-3)
    starts, vectors = arrows(arrays[-1], 'contact_forces')
    assert len(starts) == 4
    np.testing.assert_allclose(vectors.sum(axis=0)[:2] / FORCE_SCALE, [0.0, 0.0], atol=1e-3)
    points = next(m for m in arrays[-1].markers if m.ns == 'contact_points')
    np.testing.assert_allclose([point(p) for p in points.points], starts)
    np.testing.assert_allclose(starts[:, 2], 0.8, atol=1e-3)
    assert {m.header.frame_id for m in arrays[-1].markers} == {'world'}
    # The length of an arrow's head is that of the type.
    assert {m.scale.z for m in arrays[-1].markers if m.type == Marker.ARROW} == {0.0}
    # Each message replaces the one before.
    assert all(a.markers[0].action == Marker.DELETEALL for a in arrays)
    stamps = [nanoseconds_of(a.markers[0].header.stamp) for a in arrays]
    # The first one may be that of the start.
    assert len(stamps) > 5 and min(np.diff(stamps[1:])) == 20_000_000
    simulation = node.simulation
    node.thread.call(lambda: simulation.entities.place(
        simulation.data, 'cube', Pose(np.array([0.5, 0.5, 1.5]), np.array([0, 0, 0, 1.0])), None))
    client.spin_until(lambda: not any(m.ns.startswith('contact') for m in arrays[-1].markers))


def test_an_arrow_shows_the_push_on_a_tool_in_world(shown, client):
    node, arrays = shown
    client.spin_until(lambda: bool(arrays))
    assert len(arrows(arrays[-1], 'right/external_force')[0]) == 0
    data, push = node.simulation.data, np.array([3.0, -4.0, 5.0])
    gripper = data.body('gripper0_right_right_gripper').id

    def push_there():
        # At the gripper's centre of mass, so the torque is that of a lever.
        data.xfrc_applied[gripper, :3] = push
    node.thread.call(push_there)

    def force():
        return arrows(arrays[-1], 'right/external_force')[1].sum(axis=0) / FORCE_SCALE
    client.spin_until(lambda: np.abs(force() - push).max() < 0.05)
    origin, torque = arrows(arrays[-1], 'right/external_torque')
    frame = data.site('gripper0_right_ft_frame').xpos
    np.testing.assert_allclose(origin, [frame], atol=1e-3)
    np.testing.assert_allclose(torque[0] / TORQUE_SCALE,
                               np.cross(data.xipos[gripper] - frame, push), atol=0.02)


def test_a_newton_is_a_centimetre_and_a_newton_metre_a_decimetre():
    assert (FORCE_SCALE, TORQUE_SCALE) == (0.01, 0.1)


@pytest.fixture
def markers_of(client, monkeypatch):
    """Return a function that returns the message of contacts at a time."""
    node = client.node
    publisher = MarkerPublisher(SimpleNamespace(
        node=node, log=RejectionLog(node.get_logger()), inbox=None, publishing=None,
        frame_prefix='', is_built=False), {})
    received = client.listen(MarkerArray, 'client/markers')
    client.spin_until(publisher.look)
    forces = visualization_topics._CONTACT_FORCES
    assert publisher._messages(2, (forces, forces._replace(namespace='a'))).patches

    def publish(positions, forces, time_ns=0):
        monkeypatch.setattr(visualization_topics, 'read_contacts',
                            lambda *_: SimpleNamespace(position=positions, force=forces))
        received.clear()
        publisher.publish(SimpleNamespace(time_ns=time_ns, model=None, data=None))
        client.spin_until(lambda: bool(received))
        return received[0]
    return publish


def test_a_force_of_no_direction_has_no_arrow_and_leaves_those_of_others(markers_of):
    positions, forces = np.eye(3), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    starts, vectors = arrows(markers_of(positions, forces), 'contact_forces')
    np.testing.assert_allclose(starts, positions[[0, 2]])
    np.testing.assert_allclose(vectors, FORCE_SCALE * forces[[0, 2]])


def test_messages_with_as_many_markers_as_one_before_have_stamps_and_numbers_of_their_own(
        markers_of):
    random = np.random.default_rng(0)
    for number, count in enumerate((3, 3, 0, 1, 3, 0, 1)):
        positions, forces = random.normal(size=(2, count, 3))
        array = markers_of(positions, forces, 10**9 * number + 7)
        starts, vectors = arrows(array, 'contact_forces')
        np.testing.assert_allclose(starts, positions)
        np.testing.assert_allclose(vectors, FORCE_SCALE * forces, atol=1e-12)
        points = [point(p) for m in array.markers if m.ns == 'contact_points' for p in m.points]
        np.testing.assert_array_equal(np.reshape(points, (-1, 3)), positions)
        assert {nanoseconds_of(m.header.stamp) for m in array.markers} == {10**9 * number + 7}
