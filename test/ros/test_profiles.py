# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Nodes with the names of drivers, and a client in another process that knows no others."""

from types import SimpleNamespace as Plain

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import WrenchStamped
import pytest
from rclpy.action import get_action_names_and_types
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.errors import ModelError, ParameterError, UnknownNameError
from manip_sim.interface.profiles import load_profile, profiles_folder
from manip_sim.models import compose
from manip_sim.ros import sim_node
from manip_sim.ros.action_servers import ActionServers, messages_of, TrajectoryMessages
from manip_sim.ros.messages import CONTROLLER_TYPE, message_class
from manip_sim.simulation import Simulation

#: By profile: robot, joints of its arm and of its gripper, topic of trajectories, topics of joint
#: states, as the sources that the profile names have them.
VENDORS = {
    'ur': ('UR5e', ['shoulder_pan_joint', 'shoulder_lift_joint', 'elbow_joint', 'wrist_1_joint',
                    'wrist_2_joint', 'wrist_3_joint'], [],
           '/scaled_joint_trajectory_controller/joint_trajectory', ['/joint_states']),
    'franka': ('FR3', [f'fr3_joint{n}' for n in range(1, 8)],
               ['fr3_finger_joint1', 'fr3_finger_joint2'], '/fr3_arm_controller/joint_trajectory',
               ['/joint_states', '/franka/joint_states', '/franka_gripper/joint_states']),
    'xarm': ('XArm7', [f'joint{n}' for n in range(1, 8)],
             ['drive_joint', 'left_finger_joint', 'left_inner_knuckle_joint',
              'right_outer_knuckle_joint', 'right_finger_joint', 'right_inner_knuckle_joint'],
             '/xarm7_traj_controller/joint_trajectory', ['/joint_states', '/xarm/joint_states']),
    'kortex': ('Kinova3', [f'joint_{n}' for n in range(1, 8)],
               ['robotiq_85_left_knuckle_joint', 'robotiq_85_right_knuckle_joint',
                'robotiq_85_left_inner_knuckle_joint', 'robotiq_85_right_inner_knuckle_joint',
                'robotiq_85_left_finger_tip_joint', 'robotiq_85_right_finger_tip_joint'],
               '/joint_trajectory_controller/joint_trajectory', ['/joint_states'])}


@pytest.fixture
def profile(tmp_path):
    """Return a function that writes a file of a profile and returns its path."""
    def write(text):
        path = tmp_path / 'own.yaml'
        path.write_text(text)
        return str(path)
    return write


@pytest.mark.parametrize('vendor', [
    'ur', *(pytest.param(name, marks=pytest.mark.full) for name in VENDORS if name != 'ur')])
def test_a_client_of_the_real_arm_moves_the_simulated_one(vendor, sim_process, client):
    robot, arm, gripper, topic, states = VENDORS[vendor]
    sim_process(f'profile:={vendor}', f'robot:={robot}',
                *([] if gripper else ['gripper:=NullGripper']))
    for name in states:
        found = set(client.state(name).name)
        assert found == set(arm if 'arm' in name or name == '/franka/joint_states' else
                            gripper if 'gripper' in name else [*arm, *gripper]), name
    before = dict(zip((state := client.state()).name, state.position))
    goals = [before[joint] + 0.05 * (index + 1) for index, joint in enumerate(arm)]
    message = JointTrajectory(joint_names=arm, points=[JointTrajectoryPoint(
        positions=goals, time_from_start=Duration(sec=1))])
    client.publish(topic, message)

    def positions():
        now = client.state()
        return [dict(zip(now.name, now.position))[joint] for joint in arm]
    client.spin_until(lambda: positions() == pytest.approx(goals, abs=2e-3))
    assert client.node.count_subscribers('/arm/joint_trajectory') == 0
    # The stack of the real arm publishes its own.
    assert client.node.count_publishers('/robot_description') == 0


@pytest.mark.full
def test_services_and_wrenches_have_the_names_of_the_driver(sim_process, client):
    sim_process('profile:=ur', 'robot:=UR5e')
    wrenches = client.listen(WrenchStamped, '/force_torque_sensor_broadcaster/wrench')
    client.spin_until(lambda: wrenches)
    for service in ('/io_and_status_controller/zero_ftsensor',
                    '/dashboard_client/unlock_protective_stop'):
        assert client.call(Trigger, service).success
    names = dict(client.node.get_service_names_and_types())
    assert '/manip_sim/reset' in names and '/manip_sim/tare_wrench' not in names


def test_commands_with_the_names_of_the_driver_or_the_model_are_taken(serve, client):
    serve(profile='kortex', robot='Kinova3')
    for joint, goal in (('joint_1', 0.1), ('robot0_Actuator1', -0.1)):
        command = JointState(name=[joint], position=[goal])

        def near(command=command, goal=goal):
            client.publish('joint_command', command)
            return client.state().position[0] == pytest.approx(goal, abs=0.02)
        client.spin_until(near)
    states = client.listen(message_class(CONTROLLER_TYPE),
                           '/joint_trajectory_controller/controller_state')
    client.spin_until(lambda: states)
    assert states[0].joint_names == [f'joint_{n}' for n in range(1, 8)]


@pytest.mark.full
def test_actions_have_the_names_of_the_driver(serve, client, monkeypatch):
    actions = pytest.importorskip('test_msgs.action', reason='test_msgs is not installed')
    # There are no wheels of control_msgs; the names do not depend on the type.
    monkeypatch.setattr(sim_node, 'offer_actions', lambda context, commands: ActionServers(
        context, commands, lambda robot: messages_of(
            Plain(FollowJointTrajectory=actions.Fibonacci, GripperCommand=actions.Fibonacci,
                  ParallelGripperCommand=actions.Fibonacci), robot, lambda: 0)))
    for vendor, robot, names in (
            ('franka', 'FR3', ['/fr3_arm_controller/follow_joint_trajectory',
                               '/franka_gripper/gripper_action']),
            ('kortex', 'Kinova3', ['/joint_trajectory_controller/follow_joint_trajectory',
                                   '/robotiq_gripper_controller/gripper_cmd'])):
        serve(profile=vendor, robot=robot)
        client.spin_until(lambda names=names: {*names} <= {
            name for name, _ in get_action_names_and_types(client.node)})


def test_messages_of_actions_have_the_names_of_the_driver():
    simulation = Simulation(compose('FR3'))
    names = load_profile('franka').joint_names(simulation.robot)
    messages = TrajectoryMessages(
        Plain(Feedback=lambda: Plain(header=Header())), simulation.robot, 'arm', lambda: 0, names)
    tolerance = Plain(name='fr3_joint2', position=0.1, velocity=0.0, acceleration=0.0)
    goal = messages.goal_of(Plain(
        trajectory=JointTrajectory(joint_names=['fr3_joint2'], points=[JointTrajectoryPoint(
            positions=[0.3], time_from_start=Duration(sec=1))]),
        multi_dof_trajectory=Plain(joint_names=[], points=[]), path_tolerance=[tolerance],
        goal_tolerance=[], goal_time_tolerance=Duration()))
    assert list(goal.names) == ['robot0_joint2']
    assert messages.feedback_of(goal).joint_names == ['fr3_joint2']


def test_a_profile_of_ones_own_renames_what_it_names(serve, client, profile):
    serve(profile=profile('topics: {right/eef_pose: tool/pose}\njoints: {joint1: axis_1}'))
    assert client.state().name[:2] == ['axis_1', 'robot0_joint2']
    client.spin_until(lambda: client.node.count_publishers('/tool/pose') == 1)
    assert client.node.count_publishers('/right/eef_pose') == 0


@pytest.mark.parametrize('given, error, text', [
    ('u', UnknownNameError, "unknown profile 'u': did you mean 'ur'"),
    ('no.yaml', ModelError, 'no.yaml: No such file'),
    ('topic: {}', UnknownNameError, "unknown section of .* 'topic': did you mean 'topics'"),
    ('topics: {arm/joint_states: /abs}', ModelError, "'/abs' is no relative or private name"),
    ('topics: {arm/joint_state: x}', UnknownNameError, 'unknown name in topics of'),
    ('actions: {arm/gripper_cmd: x}', UnknownNameError, 'unknown name in actions of'),
    ('topics: {arm/joint_states: x, right/joint_states: x}', ModelError, "'x' is there twice"),
    ('topics: {arm/joint_states: odom, odom: o}', ModelError, "'odom' is a name of the node"),
    ('joints: {joint1: a b}', ModelError, "'a b' is no name of a joint"),
    ('joints: [joint1]', ModelError, 'joints must hold names by names')])
def test_profiles_that_cannot_be_used_are_told(given, error, text, profile):
    with pytest.raises(error, match=text):
        load_profile(profile(given) if ':' in given else given)


def test_a_profile_for_another_robot_or_for_several_is_told(serve):
    with pytest.raises(ModelError, match="'profile': ur is for another robot than Panda, which "
                                         "has no joints 'shoulder_pan_joint', "):
        serve(profile='ur')
    with pytest.raises(ParameterError, match="'profile' needs a node with one robot"):
        serve(profile='ur', robots=['one', 'two'])
    with pytest.raises(ParameterError, match="'profile' cannot be used with ros2_control_tag"):
        serve(profile='ur', robot='UR5e', ros2_control_tag=True)


def test_each_profile_says_where_its_names_are_from():
    files = list(profiles_folder().glob('*.yaml'))
    assert {file.stem for file in files} == {*VENDORS}
    for file in files:
        assert 'source: github.com/' in file.read_text() and 'commit' in file.read_text()
