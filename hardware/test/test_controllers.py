# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controller manager of Jazzy with the hardware component, against a node of manip_sim."""

from pathlib import Path

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.testing.simulation_under_test import SimulationStalled

CONTROLLERS = Path(__file__).parent / 'controllers.yaml'
JOINTS = [f'robot0_joint{n}' for n in range(1, 8)]
MOVE = np.array([0.3, -0.2, 0.1, 0.2, -0.1, 0.2, 0.3])


@pytest.fixture
def controlled(sim_node):
    """Return a function that starts a node in lock-step and a controller manager."""
    def start(update_rate=100, **parameters):
        sim = sim_node(stepping='lockstep', ros2_control_tag=True,
                       ros2_control_plugin='manip_sim_hardware/ManipSimSystem', **parameters)
        return sim, manager(sim, update_rate)
    return start


def manager(sim, update_rate=100):
    return sim.start(['ros2', 'run', 'controller_manager', 'ros2_control_node', '--ros-args',
                      '-p', 'use_sim_time:=true', '--params-file', str(CONTROLLERS),
                      '-p', f'update_rate:={update_rate}'])


def spawn(sim, *names):
    """Activate controllers; simulated time passes meanwhile."""
    spawner = sim.start(['ros2', 'run', 'controller_manager', 'spawner', *names,
                         '--param-file', str(CONTROLLERS),
                         '--controller-manager-timeout', '100'])
    sim.wait_for(lambda: spawner.poll() is not None, limit_s=600.0)
    assert spawner.returncode == 0


def move(sim, start):
    """Send a trajectory that begins at a given time, and let it be done."""
    goal = sim.states('arm/joint_states').position[-1] + MOVE
    begin = JointTrajectory(joint_names=JOINTS, points=[JointTrajectoryPoint(
        positions=goal.tolist(), time_from_start=Duration(sec=1))])
    begin.header.stamp.sec = start
    sim.publish('position_trajectory/joint_trajectory', begin)
    sim.run_for(start + 2.0 - sim.time_s)
    return goal


@pytest.mark.parametrize('rate, update_rate', [(100.0, 100), (500.0, 500), (500.0, 100)])
def test_a_trajectory_is_followed_in_lock_step(rate, update_rate, controlled):
    sim, _ = controlled(update_rate, publish_rate=rate)
    spawn(sim, 'position_trajectory')
    goal = move(sim, int(sim.time_s) + 2)
    states = sim.states('arm/joint_states')
    assert np.abs(states.position[-1] - goal).max() < 1e-3
    # Every state once, in order: nothing was lost, nothing came twice.
    assert np.ptp(np.round(np.diff(states.time_s), 9)) == 0.0


def test_runs_from_the_same_start_are_equal_to_the_last_bit(controlled):
    def run():
        sim, process = controlled()
        spawn(sim, 'position_trajectory')
        start = int(sim.time_s) + 2
        move(sim, start)
        states = sim.states('arm/joint_states')
        process.kill()
        process.wait()
        moved = states.time_s >= start
        return states.position[moved].tobytes(), states.velocity[moved].tobytes()
    assert run() == run()


def test_a_controller_that_claims_velocities_changes_the_mode(controlled):
    sim, _ = controlled()
    spawn(sim, 'velocity_forward')
    sim.publish('velocity_forward/commands', Float64MultiArray(data=[0.2, *[0.0] * 6]))
    sim.run_for(1.0)
    assert sim.states('arm/joint_states').velocity[-1, 0] == pytest.approx(0.2, abs=1e-4)


def test_the_broadcaster_publishes_the_wrench_of_the_node(controlled):
    sim, _ = controlled()
    received = []
    sim.node.create_subscription(WrenchStamped, 'wrench_broadcaster/wrench', received.append, 100)
    spawn(sim, 'wrench_broadcaster')
    sim.wait_for(lambda: len(received) > 20)
    wrenches = sim.wrenches()
    for message in received[-10:]:
        time_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        row = np.argmin(np.abs(wrenches.time_s - time_s))
        assert message.wrench.force.z == wrenches.force[row, 2]


def test_the_broadcaster_publishes_what_the_imu_of_the_hand_measures(controlled):
    sim, _ = controlled()
    received, measured = [], {}
    sim.node.create_subscription(Imu, 'imu_broadcaster/imu', received.append, 100)
    sim.node.create_subscription(Imu, 'sensors/robot0_right_imu/imu', lambda imu: measured.update(
        {(imu.header.stamp.sec, imu.header.stamp.nanosec): imu}), 100)
    spawn(sim, 'imu_broadcaster')
    sim.wait_for(lambda: len(received) > 20)
    for message in received[-10:]:
        imu = measured[message.header.stamp.sec, message.header.stamp.nanosec]
        assert message.linear_acceleration == imu.linear_acceleration
        assert message.orientation == imu.orientation


def test_the_admittance_controller_keeps_the_arm_where_nothing_pushes(controlled):
    sim, _ = controlled()
    spawn(sim, 'admittance')
    before = sim.states('arm/joint_states').position[-1]
    sim.run_for(2.0)
    assert np.abs(sim.states('arm/joint_states').position[-1] - before).max() < 0.01


def test_time_stands_while_the_manager_is_gone_and_another_one_goes_on(controlled, monkeypatch):
    from manip_sim.testing import simulation_under_test
    sim, process = controlled()
    spawn(sim, 'position_trajectory')
    process.kill()
    process.wait()
    monkeypatch.setattr(simulation_under_test, '_PATIENCE', 30)
    with pytest.raises(SimulationStalled):
        sim.run_for(5.0)
    monkeypatch.undo()
    manager(sim)
    spawn(sim, 'position_trajectory')
    goal = move(sim, int(sim.time_s) + 2)
    assert np.abs(sim.states('arm/joint_states').position[-1] - goal).max() < 1e-3


def test_a_reset_is_not_undone_by_the_controller_that_is_active(controlled):
    sim, _ = controlled()
    spawn(sim, 'position_trajectory')
    start = sim.states('arm/joint_states').position[-1]
    move(sim, int(sim.time_s) + 2)
    sim.reset()
    sim.run_for(1.0)
    assert np.abs(sim.states('arm/joint_states').position[-1] - start).max() < 1e-2
