# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Noise and latency on topics, with the truth beside them."""

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState

from manip_sim.errors import ManipSimError
from manip_sim.models import compose
from manip_sim.ros.messages import nanoseconds_of
from manip_sim.simulation import Simulation

NOISE = {'noise.joint_position': 0.01, 'noise.wrench_force': 2.0, 'noise.imu_gyro': 0.1}


def by_stamp(messages):
    return {nanoseconds_of(message.header.stamp): message for message in messages}


def paired(measured, true):
    """Return pairs of messages of one stamp."""
    one, other = by_stamp(measured), by_stamp(true)
    return [(one[stamp], other[stamp]) for stamp in sorted(one.keys() & other.keys())]


def test_noise_is_on_the_topics_and_the_truth_beside_them_with_the_same_stamps(serve, client):
    node = serve(start_paused=True, **{k.replace('.', '__'): v for k, v in NOISE.items()})
    joints, true = (client.listen(JointState, f'{p}joint_states') for p in ('', 'truth/'))
    wrench, true_wrench = (client.listen(WrenchStamped, f'{p}right/wrench')
                           for p in ('', 'truth/'))
    imu, true_imu = (client.listen(Imu, f'{p}sensors/robot0_right_imu/imu')
                     for p in ('', 'truth/'))
    lists = (joints, true, wrench, true_wrench, imu, true_imu)
    client.spin_until(lambda: all(lists))
    for _ in range(30):
        node.thread.step()
    last = node.simulation.time_ns
    client.spin_until(lambda: all(last in by_stamp(found) for found in lists))
    pairs = paired(joints, true)
    assert len(pairs) > 25
    noise = np.array([np.array(a.position) - np.array(b.position) for a, b in pairs])
    assert 0.008 < noise.std() < 0.012
    assert all(a.velocity == b.velocity and a.effort == b.effort for a, b in pairs)
    force = np.array([[a.wrench.force.x - b.wrench.force.x, a.wrench.torque.x - b.wrench.torque.x]
                      for a, b in paired(wrench, true_wrench)])
    assert 1.0 < force[:, 0].std() < 3.0 and not force[:, 1].any()
    turn = [(a.angular_velocity.z - b.angular_velocity.z, a.linear_acceleration == (
        b.linear_acceleration)) for a, b in paired(imu, true_imu)]
    assert all(same and difference for difference, same in turn)


def test_a_node_measures_the_same_bits_as_a_simulation_in_python_with_its_seed(serve, client):
    settings = {'noise.joint_position': 0.01, 'noise.joint_velocity': 0.1, 'latency.state': 0.033,
                'latency.state_jitter': 0.01}
    node = serve(seed=11, start_paused=True, **{
        name.replace('.', '__'): value for name, value in settings.items()})
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: states != [])
    first = node.simulation.time_ns
    for _ in range(20):
        node.thread.step()
    last = node.simulation.time_ns
    client.spin_until(lambda: last in by_stamp(states))
    simulation = Simulation(compose('Panda', seed=11))
    for name, value in settings.items():
        simulation.robot.sensing.set(name, value)
    found = by_stamp(states)
    for number in range(1, 21):
        simulation.advance(5)
        message = found.get(first + number * 10_000_000)
        if message is not None:
            expected = simulation.robot.state()
            assert list(message.position) == expected.position.tolist()
            assert list(message.velocity) == expected.velocity.tolist()
    assert found[last].position.tolist() == simulation.robot.state().position.tolist()


def test_latency_in_lockstep_is_repeated_to_the_bit_and_the_truth_is_ahead(serve, client):
    node = serve(stepping='lockstep', latency__state=0.05)
    states, true = (client.listen(JointState, f'{p}joint_states') for p in ('', 'truth/'))
    client.spin_until(lambda: bool(states and true))
    for _ in range(20):
        stamp = node.simulation.time_ns
        command = JointState(name=['robot0_joint1'], position=[0.3])
        client.publish('arm/joint_command', command)
        client.spin_until(lambda stamp=stamp: node.simulation.time_ns > stamp)
    last = node.simulation.time_ns
    client.spin_until(lambda: last in by_stamp(states) and last in by_stamp(true))
    late, exact = by_stamp(states), by_stamp(true)
    stamps = sorted(late.keys() & exact.keys())
    period = 10_000_000
    checked = 0
    for stamp in stamps:
        if stamp - 5 * period in exact:
            assert late[stamp].position == exact[stamp - 5 * period].position
            checked += 1
    assert checked >= 14
    assert exact[last].position != late[last].position


def test_noise_is_live_and_garbage_is_rejected_with_the_range(serve, client):
    node = serve(start_paused=True)
    assert not any(row.name.startswith('truth/') for row in node.table)

    def set_to(name, value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return client.call(SetParameters, 'manip_sim/set_parameters', request).results[0]
    for value in (-1.0, float('nan'), float('inf'), 1e9, 'much'):
        assert not set_to('noise.joint_position', value).successful
    assert 'noise.joint_velocity' in set_to('noise.joint_velocty', 1.0).reason
    assert set_to('noise.joint_position', 0.01).successful
    measured, true = (client.listen(JointState, f'{p}joint_states') for p in ('', 'truth/'))
    client.spin_until(lambda: bool(paired(measured, true)))
    one, other = paired(measured, true)[-1]
    assert one.position != other.position
    assert set_to('noise.joint_position', 0.0).successful
    node.thread.step()
    last = node.simulation.time_ns
    client.spin_until(lambda: last in by_stamp(measured) and last in by_stamp(true))
    assert by_stamp(measured)[last].position == by_stamp(true)[last].position


@pytest.mark.full
def test_each_robot_has_its_own_noise(serve, client):
    node = serve(robots=['a', 'b'], start_paused=True, a__noise__joint_position=0.01)
    names = {row.name for row in node.table if 'truth/' in row.name}
    assert 'a/truth/joint_states' in names
    assert not any(name.startswith(('b/', 'truth/')) for name in names)
    states = client.listen(JointState, 'b/joint_states')
    client.spin_until(lambda: states != [])
    other = node.simulation.robots['b']
    np.testing.assert_array_equal(states[-1].position, other.true_state().position)


@pytest.mark.parametrize('name', ['noise.joint_position', 'latency.state', 'latency.command'])
def test_a_start_with_a_value_that_cannot_be_is_rejected(name, serve):
    with pytest.raises(ManipSimError, match=f"parameter '{name}' must be from 0 to"):
        serve(**{name.replace('.', '__'): -0.1})
