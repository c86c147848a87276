# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controller manager of Jazzy with the hardware component, against a node of manip_sim."""

from pathlib import Path
import sys
from uuid import uuid4

from action_msgs.msg import GoalStatus, GoalStatusArray
from ament_index_python.packages import get_package_prefix
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory, GripperCommand
from controller_manager_msgs.srv import SwitchController
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.qos import qos_profile_action_status_default
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
import yaml

from manip_sim.cli.main import main
from manip_sim.ros.messages import nanoseconds_of
from manip_sim.testing.simulation_under_test import SimulationStalled

OWN = Path(__file__).parent / 'controllers.yaml'
JOINTS = [f'robot0_joint{n}' for n in range(1, 8)]
MOVE = np.array([0.3, -0.2, 0.1, 0.2, -0.1, 0.2, 0.3])
NODE = {'stepping': 'lockstep', 'ros2_control_plugin': 'manip_sim_hardware/ManipSimSystem'}
FROM_APT = {
    'ros2_control_plugin': 'joint_state_topic_hardware_interface/JointStateTopicSystem'}


@pytest.fixture(scope='module')
def written(tmp_path_factory):
    """Return the controllers that "manip_sim export --ros2-control" writes for the node."""
    folder = tmp_path_factory.mktemp('written')
    parameters = folder / 'node.yaml'
    parameters.write_text(yaml.safe_dump({'/**': {'ros__parameters': NODE}}))
    assert main(['export', '--ros2-control', str(folder / 'panda_control'),
                 '--params-file', str(parameters)]) == 0
    return folder / 'panda_control' / 'config' / 'controllers.yaml'


@pytest.fixture
def controlled(sim_node, written):
    """Return a function that starts a node and a controller manager, and those two."""
    def start(update_rate=100, **parameters):
        sim = sim_node(**{**NODE, 'ros2_control_tag': True, **parameters})
        return sim, manager(sim, written, update_rate)
    return start


def executable(name):
    return str(Path(get_package_prefix('controller_manager'), 'lib', 'controller_manager', name))


def manager(sim, written, update_rate=100):
    return sim.start([executable('ros2_control_node'), '--ros-args', '-p', 'use_sim_time:=true',
                      '--params-file', str(written), '--params-file', str(OWN),
                      '-p', f'update_rate:={update_rate}'])


def spawn(sim, *arguments):
    """Activate controllers; simulated time passes meanwhile."""
    spawner = sim.start([sys.executable, executable('spawner'), *arguments,
                         '--controller-manager-timeout', '100'])
    sim.wait_for(lambda: spawner.poll() is not None, limit_s=600.0)
    assert spawner.returncode == 0


def switch(sim, activated, deactivated):
    client = sim.node.create_client(SwitchController, 'controller_manager/switch_controller')
    sim.wait_for(client.service_is_ready)
    answer = client.call_async(SwitchController.Request(
        activate_controllers=[activated], deactivate_controllers=[deactivated],
        strictness=SwitchController.Request.STRICT, timeout=Duration(sec=60)))
    sim.wait_for(answer.done, limit_s=60.0)
    assert answer.result().ok


def mode_of_the_arm(sim):
    return sim.call(GetParameters, 'manip_sim/get_parameters', GetParameters.Request(
        names=['control_mode.arm'])).values[0].string_value


def send(sim, goal, controller):
    """
    Give a controller a trajectory of 1 s, from the next cycle on.

    Simulated time stands. The loop has answered the present state before, and the controller has
    the goal afterwards.
    """
    while nanoseconds_of(sim.receive(JointState, 'joint_command').header.stamp) < round(
            1e9 * sim.time_s):
        pass
    name = f'{controller}/follow_joint_trajectory/_action'
    request = FollowJointTrajectory.Impl.SendGoalService.Request()
    request.goal_id.uuid = np.frombuffer(uuid4().bytes, np.uint8)
    request.goal.trajectory = JointTrajectory(joint_names=JOINTS, points=[JointTrajectoryPoint(
        positions=goal.tolist(), time_from_start=Duration(sec=1))])
    assert sim.call(FollowJointTrajectory.Impl.SendGoalService, f'{name}/send_goal',
                    request).accepted
    while not any(status.status == GoalStatus.STATUS_EXECUTING for status in sim.receive(
            GoalStatusArray, f'{name}/status', qos_profile_action_status_default).status_list):
        pass


def move(sim, controller='arm_position_controller'):
    """Send a trajectory, let it be done, and return its goal."""
    goal = sim.states('arm/joint_states').position[-1] + MOVE
    send(sim, goal, controller)
    sim.run_for(2.0)
    return goal


def rest_at(sim, goal):
    sim.wait_for(lambda: np.abs(sim.states('arm/joint_states').position[-1] - goal).max() < 5e-3)


def turn(sim):
    """Let the first joint turn at 0.2 rad/s."""
    def turns():
        sim.publish('velocity_forward/commands', Float64MultiArray(data=[0.2, *[0.0] * 6]))
        return abs(sim.states().velocity[-1, 0] - 0.2) < 1e-4
    sim.wait_for(turns)


@pytest.mark.parametrize('rate, update_rate', [(100.0, 100), (500.0, 500), (500.0, 100)])
def test_a_trajectory_is_followed_in_lock_step(rate, update_rate, controlled):
    sim, _ = controlled(update_rate, publish_rate=rate)
    spawn(sim, 'arm_position_controller')
    goal = move(sim)
    states = sim.states('arm/joint_states')
    assert np.abs(states.position[-1] - goal).max() < 1e-3
    # Every state once, in order: nothing was lost, nothing came twice.
    assert np.ptp(np.round(np.diff(states.time_s), 9)) == 0.0


@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
def test_runs_from_the_same_start_are_equal_to_the_last_bit(mode, controlled):
    def run():
        sim, process = controlled()
        goal = sim.states('arm/joint_states').position[0] + MOVE
        spawn(sim, f'arm_{mode}_controller')
        send(sim, goal, f'arm_{mode}_controller')
        sim.run_for(2.0)
        sim.reset()
        start = len(sim.states().time_s)
        sim.run_for(1.0)
        send(sim, goal, f'arm_{mode}_controller')
        sim.run_for(2.0)
        states = sim.states()
        process.kill()
        process.wait()
        assert np.ptp(states.position[start:, 0]) > 0.25
        return [field[start:].tobytes() for field in (
            states.position, states.velocity, states.effort)]
    assert run() == run()


def test_a_controller_that_claims_velocities_changes_the_mode(controlled):
    sim, _ = controlled()
    spawn(sim, 'velocity_forward')
    turn(sim)
    assert mode_of_the_arm(sim) == 'velocity'


@pytest.mark.parametrize('lost', [1, 100])
def test_a_mode_is_asked_for_again_until_the_node_answers(lost, controlled, capfd):
    sim, process = controlled()
    spawn(sim, 'velocity_forward', '--inactive')
    service = next(service for service in sim.server.node.services
                   if service.srv_name.endswith('/set_parameters'))
    answer, asked = service.callback, []

    def lose(request, response):
        asked.append(request)
        if len(asked) <= lost:
            raise RuntimeError('lost')
        return answer(request, response)
    service.callback = lose
    client = sim.node.create_client(SwitchController, 'controller_manager/switch_controller')
    sim.wait_for(client.service_is_ready)
    answered = client.call_async(SwitchController.Request(
        activate_controllers=['velocity_forward'], strictness=SwitchController.Request.STRICT,
        timeout=Duration(sec=60)))
    sim.wait_for(answered.done, limit_s=6000.0)
    assert len(asked) == min(lost + 1, 5)
    assert answered.result().ok == (lost == 1)
    assert mode_of_the_arm(sim) == ('velocity' if lost == 1 else 'position')
    process.kill()
    process.wait()
    assert ('no answer to 5 requests' in capfd.readouterr().err) == (lost == 100)


def test_controllers_of_other_modes_take_over_from_each_other(controlled):
    sim, _ = controlled()
    spawn(sim, 'arm_position_controller')
    spawn(sim, 'arm_velocity_controller', 'arm_effort_controller', '--inactive')
    start, active = sim.states('arm/joint_states').position[-1], 'arm_position_controller'
    for mode in ('velocity', 'effort', 'position', 'effort', 'velocity', 'position'):
        before, active = active, f'arm_{mode}_controller'
        switch(sim, active, before)
        assert mode_of_the_arm(sim) == mode
        sim.run_for(1.0)
        # What takes over holds the arm where it is.
        assert np.abs(sim.states('arm/joint_states').position[-1] - start).max() < 5e-3
    for mode in ('velocity', 'effort'):
        before, active = active, f'arm_{mode}_controller'
        switch(sim, active, before)
        rest_at(sim, move(sim, active))


def test_the_gripper_controller_reaches_its_goal(controlled):
    sim, _ = controlled()
    spawn(sim, 'right_gripper_controller')
    client = ActionClient(sim.node, GripperCommand, 'right_gripper_controller/gripper_cmd')
    sim.wait_for(client.server_is_ready)
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = 0.03, 20.0
    accepted = client.send_goal_async(goal)
    sim.wait_for(accepted.done)
    result = accepted.result().get_result_async()
    sim.wait_for(result.done)
    assert result.result().result.reached_goal
    assert result.result().result.position == pytest.approx(0.03, abs=0.011)
    client.destroy()


@pytest.mark.parametrize('parameters', [{}, FROM_APT], ids=['own', 'from apt'])
def test_a_pushed_arm_stops_after_the_manager_was_killed(controlled, parameters):
    sim, process = controlled(stepping='free', control_mode__arm='effort', **parameters)
    spawn(sim, 'effort_forward')

    def turns():
        # [N m]
        sim.publish('effort_forward/commands', Float64MultiArray(data=[*[0.0] * 6, 0.3]))
        return sim.states('arm/joint_states').velocity[-1, 6] > 0.15
    sim.wait_for(turns)
    process.kill()
    process.wait()
    killed = len(sim.states('arm/joint_states').time_s)
    sim.run_for(2.0)
    states = sim.states('arm/joint_states')
    assert states.velocity[killed - 1, 6] > 0.15
    assert np.abs(states.velocity[-20:]).max() < 2e-3


@pytest.mark.parametrize('parameters', [{}, FROM_APT], ids=['own', 'from apt'])
def test_the_arm_stops_after_the_manager_was_killed_while_it_moved(controlled, parameters):
    sim, process = controlled(stepping='free', control_mode__arm='velocity', **parameters)
    spawn(sim, 'velocity_forward')
    turn(sim)
    process.kill()
    process.wait()
    killed = len(sim.states('arm/joint_states').time_s)
    sim.run_for(2.0)
    states = sim.states('arm/joint_states')
    assert states.velocity[killed - 1, 0] == pytest.approx(0.2, abs=1e-3)
    assert abs(states.velocity[-1, 0]) < 1e-4
    # At most 0.2 s at full speed by the default of command_timeout, and the ramp; less if the
    # manager was some cycles behind the time when it was killed.
    assert states.position[-1, 0] - states.position[killed - 1, 0] < 0.08


def test_the_broadcaster_publishes_the_wrench_of_the_node(controlled):
    sim, _ = controlled()
    received = []
    sim.node.create_subscription(WrenchStamped, 'right_external_wrench_broadcaster/wrench',
                                 received.append, 100)
    spawn(sim, 'right_external_wrench_broadcaster')
    sim.wait_for(lambda: len(received) > 20)
    wrenches = sim.wrenches()
    for message in received[-10:]:
        time_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        row = np.argmin(np.abs(wrenches.time_s - time_s))
        assert message.wrench.force.z == wrenches.force[row, 2]


def test_the_broadcaster_publishes_what_the_imu_of_the_hand_measures(controlled):
    sim, _ = controlled()
    received, measured = [], {}
    sim.node.create_subscription(Imu, 'robot0_right_imu_broadcaster/imu', received.append, 100)
    sim.node.create_subscription(Imu, 'sensors/robot0_right_imu/imu', lambda imu: measured.update(
        {(imu.header.stamp.sec, imu.header.stamp.nanosec): imu}), 100)
    spawn(sim, 'robot0_right_imu_broadcaster')
    sim.wait_for(lambda: len(received) > 20)
    for message in received[-10:]:
        imu = measured[message.header.stamp.sec, message.header.stamp.nanosec]
        assert message.linear_acceleration == imu.linear_acceleration
        assert message.orientation == imu.orientation


def test_cycles_do_not_wait_for_a_sensor_with_a_lower_rate(controlled):
    pytest.importorskip('pydantic', '2', reason='descriptions of sensors need pydantic 2')
    sim, _ = controlled(sensors=['{name: robot0_right_imu, rate: 20.0}'])
    received, measured = [], {}
    sim.node.create_subscription(Imu, 'robot0_right_imu_broadcaster/imu', received.append, 1000)
    sim.node.create_subscription(
        Imu, 'sensors/robot0_right_imu/imu',
        lambda imu: measured.update({nanoseconds_of(imu.header.stamp): imu}), 1000)
    spawn(sim, 'robot0_right_imu_broadcaster', 'arm_position_controller')
    received.clear()
    move(sim)
    # Where time stands, the node publishes the instants between two measurements too.
    assert any(stamp % 50_000_000 for stamp in measured)
    assert len(received) > 100
    for message in received:
        stamp = nanoseconds_of(message.header.stamp)
        imu = measured[stamp - stamp % 50_000_000]
        assert message.linear_acceleration == imu.linear_acceleration
        assert message.angular_velocity == imu.angular_velocity


def test_the_admittance_controller_gives_way_to_what_its_sensor_measures(controlled):
    sim, _ = controlled()
    height = sim.messages('right/eef_pose')[-1].pose.position.z
    spawn(sim, 'admittance')
    sim.run_for(8.0)
    risen = sim.messages('right/eef_pose')[-1].pose.position.z - height
    # 200 N/m; this sensor measures the force that holds the gripper.
    assert risen == pytest.approx(
        np.linalg.norm(sim.wrenches('right/wrench').force[-1]) / 200.0, rel=0.03)


def test_time_stands_while_the_manager_is_gone_and_another_one_goes_on(
        controlled, written):
    sim, process = controlled(patience=3.0)
    spawn(sim, 'arm_position_controller')
    process.kill()
    process.wait()
    with pytest.raises(SimulationStalled):
        sim.run_for(5.0)
    manager(sim, written)
    spawn(sim, 'arm_position_controller')
    goal = move(sim)
    assert np.abs(sim.states('arm/joint_states').position[-1] - goal).max() < 1e-3


def test_the_node_is_killed_and_another_one_is_controlled_by_the_same_manager(
        sim_node, written):
    sim = sim_node(as_process=True, **NODE, ros2_control_tag=True)
    manager(sim, written)
    spawn(sim, 'arm_velocity_controller')
    move(sim, 'arm_velocity_controller')
    known_s = sim.time_s
    sim.crash()
    assert sim.time_s < 0.1
    start = sim.states('arm/joint_states').position[-1]
    # The manager sleeps until the time that it knew.
    sim.run_for(known_s + 1.0)
    assert mode_of_the_arm(sim) == 'velocity'
    rest_at(sim, move(sim, 'arm_velocity_controller'))
    states = sim.states('arm/joint_states')
    assert np.ptp(np.round(np.diff(states.time_s), 9)) == 0.0
    assert np.abs(states.position[-1] - start).max() > 0.25


def test_a_reset_is_not_undone_by_the_controller_that_is_active(controlled):
    sim, _ = controlled()
    spawn(sim, 'arm_position_controller')
    start = sim.states('arm/joint_states').position[-1]
    move(sim)
    sim.reset()
    sim.run_for(1.0)
    assert np.abs(sim.states('arm/joint_states').position[-1] - start).max() < 1e-2
