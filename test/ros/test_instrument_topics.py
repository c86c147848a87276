# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The sensors of the model on topics, as another process would see them."""

import math

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from sensor_msgs.msg import Imu, JointState, MagneticField, Range
from std_msgs.msg import Float64MultiArray

from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without

OBJECT = """
<mujoco>
  <worldbody>
    <body name="probe">
      <freejoint name="probe"/>
      <geom size="0.05" mass="1"/>
      <site name="eye" pos="0 0 -0.06" euler="180 0 0"/>
      <site name="up" pos="0 0 0.06"/>
      <site name="flange"/>
    </body>
  </worldbody>
  <sensor>
    <rangefinder name="down" site="eye"/>
    <rangefinder name="sky" site="up"/>
    <rangefinder name="near" site="eye" cutoff="0.2"/>
    <rangefinder name="far" site="eye" cutoff="5"/>
    <magnetometer name="compass" site="eye"/>
    <force name="force" site="flange"/>
    <torque name="torque" site="flange"/>
    <framelinvel name="velocity" objtype="site" objname="eye"/>
  </sensor>
</mujoco>
"""


@pytest.fixture
def probe(tmp_path):
    """Return a description of an object with sensors of its own, half a metre above the floor."""
    path = tmp_path / 'probe.xml'
    path.write_text(OBJECT)
    return f'{{name: probe, file: {path}, position: [1.0, 1.0, 0.5]}}'


def test_imus_and_pads_are_published_with_the_stamp_of_the_states_in_frames_of_the_tree(
        serve, client):
    node = serve(start_paused=True)
    hand, base = (client.listen(Imu, f'sensors/{site}/imu')
                  for site in ('robot0_right_imu', 'fixed_mount0_imu'))
    pad = client.listen(Float64MultiArray, 'sensors/gripper0_right_finger1_pad_touch/values')
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: all((hand, base, pad, states)))
    assert hand[-1].header.stamp == states[-1].header.stamp == base[-1].header.stamp
    assert hand[-1].header.frame_id == 'robot0_right_imu'
    assert hand[-1].orientation_covariance[0] == 0.0
    force = base[-1].linear_acceleration
    np.testing.assert_allclose([force.x, force.y, force.z], [0, 0, 9.81], atol=1e-9)
    assert [d.label for d in pad[-1].layout.dim] == ['touch of gripper0_right_finger1_pad_touch']
    assert pad[-1].layout.dim[0].size == pad[-1].layout.dim[0].stride == 1 == len(pad[-1].data)
    node.thread.step()
    client.spin_until(lambda: hand[-1].header.stamp != hand[0].header.stamp)
    np.testing.assert_allclose(
        [getattr(hand[-1].linear_acceleration, axis) for axis in 'xyz'],
        node.simulation.sensors['robot0_right_imu_accelerometer'])


def test_sensors_of_objects_of_the_user_are_published_too(probe, serve, client):
    node = serve(start_paused=True, objects=[probe])
    down, sky = (client.listen(Range, f'sensors/{name}/range')
                 for name in ('probe_down', 'probe_sky'))
    compass = client.listen(MagneticField, 'sensors/probe_compass/magnetic_field')
    flange = client.listen(WrenchStamped, 'sensors/probe_flange/wrench')
    speed = client.listen(Float64MultiArray, 'sensors/probe_velocity/values')
    client.spin_until(lambda: all((down, sky, compass, flange, speed)))
    found = node.simulation.sensors
    assert down[-1].range == pytest.approx(float(found['probe_down'][0]), abs=1e-6)
    assert down[-1].header.frame_id == 'probe_eye'
    assert math.isinf(sky[-1].range) and sky[-1].range > 0.0
    np.testing.assert_allclose(
        [compass[-1].magnetic_field.y], found['probe_compass'][1:2])
    np.testing.assert_allclose(
        [flange[-1].wrench.force.z], found['probe_force'][2:], atol=1e-12)
    assert len(speed[-1].data) == 3


def test_a_rangefinder_sees_nothing_beyond_its_cutoff_with_noise_or_without(probe, serve, client):
    node = serve(start_paused=True, objects=[probe], **{'noise.range': 0.05})
    near, true, far = (client.listen(Range, f'{name}/range') for name in (
        'sensors/probe_near', 'truth/sensors/probe_near', 'sensors/probe_far'))
    client.spin_until(lambda: all((near, true, far)))
    assert node.simulation.sensors['probe_down'][0] > 0.2
    assert (near[-1].max_range, far[-1].max_range) == (pytest.approx(0.2), 5.0)
    for _ in range(5):
        node.thread.step()
    client.spin_until(lambda: len({m.header.stamp.nanosec for m in (*near, *true)}) >= 6)
    assert all(message.range == math.inf for message in (*near, *true))
    assert all(0.0 < message.range < 5.0 for message in far)


@pytest.mark.full
def test_each_robot_has_its_sensors_in_its_namespace(serve, client):
    node = serve(robots=['a', 'b'], start_paused=True)
    names = {row.name for row in node.table if '/imu' in row.name}
    assert names == {'a/sensors/a_right_imu/imu', 'a/sensors/a_base_imu/imu',
                     'b/sensors/b_right_imu/imu', 'b/sensors/b_base_imu/imu'}
    messages = client.listen(Imu, 'b/sensors/b_base_imu/imu')
    client.spin_until(lambda: messages != [])
    assert messages[-1].header.frame_id == 'b_base_imu'


def test_pads_of_fingers_tell_by_points_how_deep_each_is_pressed(serve, client):
    serve(tactile=True, stepping='free')
    pads = [client.listen(Float64MultiArray,
                          f'sensors/gripper0_right_{finger}_pad_tactile/values')
            for finger in ('finger1', 'finger2')]
    client.spin_until(lambda: all(pads))
    assert not any(pads[0][-1].data)
    assert [(row.size, row.stride) for row in pads[0][-1].layout.dim] == [(3, 48), (16, 16)]
    assert pads[0][-1].layout.dim[0].label == (
        'tactile of gripper0_right_finger1_pad_tactile: depth, slip, slip')
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    client.spin_until(lambda: all(min(pad[-1].data[:16]) > 0.0 for pad in pads))


def test_sensors_of_objects_come_and_go_with_them_and_the_others_stay(
        probe, serve, client, tmp_path):
    node = serve(start_paused=True, objects=[probe])
    ranges = client.listen(Range, 'sensors/probe_down/range')
    client.spin_until(lambda: ranges and ranges[-1].header.frame_id == 'probe_eye')

    def publishers():
        return {topic.topic_name: topic for topic in node.publishers
                if topic.topic_name.startswith('/sensors/')}

    def change(plan):
        node.thread.call(lambda: node.simulation.change_objects(plan))
        node.executor.create_task(node.shared.world_changed)

    before, plan = publishers(), node.simulation.plan
    other = tmp_path / 'other.xml'
    other.write_text(OBJECT.replace('"eye"', '"lens"'))
    without = plan_without(plan, 'probe')
    change(plan_with(without, create_object({'name': 'probe', 'file': str(other)})))
    client.spin_until(lambda: ranges[-1].header.frame_id == 'probe_lens')
    change(without)
    client.spin_until(lambda: not any('probe' in name for name in publishers()))
    found = publishers()
    assert found and all(found[name] is before[name] for name in found)
    assert found.keys() == {name for name in before if 'probe' not in name}
