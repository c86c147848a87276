# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that come and go while a node runs."""

from dataclasses import replace
import gc
import json
import os
from pathlib import Path
import subprocess
import sys
import threading

from action_msgs.msg import GoalStatus
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from spawning_node import ask, SpawningByParameters
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from manip_sim.interface.topics import topics_of
from manip_sim.ros import sim_node
from manip_sim.ros.action_servers import ActionMessages, ActionServers
from manip_sim.ros.executor import BACKGROUND_THREAD
from manip_sim.runtime.trajectory_goal import TrajectoryGoal, TrajectoryRequest
from manip_sim.viewer.discovery import layout_of

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
UR5E = '{robot: UR5e}'


@pytest.fixture
def spawning(serve, tmp_path):
    """Return a function that starts a node with the services of spawning."""
    def start(**parameters):
        node = serve(**{'real_time_factor': 2.0, 'arena': 'table', **parameters})
        SpawningByParameters(node, tmp_path)
        return node
    return start


def come(client, name='left', text=UR5E, y=2.0, **more):
    answer = ask(client, 'spawn_entity', name=name, resource_string=text,
                 position=[0.0, y, 0.0], **more)
    assert answer.successful, answer.reason
    return answer.reason


def go(client, name='left'):
    answer = ask(client, 'delete_entity', entity=name)
    assert answer.successful, answer.reason


def topics_below(node, name):
    return {topic for topic, _ in node.get_topic_names_and_types()
            if topic.startswith(f'/{name}/')}


def entities_of(node):
    """Return how many entities of ROS the node has, and parameters."""
    return {kind: len(list(getattr(node, kind))) for kind in (
        'publishers', 'subscriptions', 'services', 'timers', 'guards', 'waitables')} | {
            'parameters': len(node._parameters), 'table': len(node.table),
            # The thread that loads the laws ends some time after the start.
            'threads': sum(
                thread.name != BACKGROUND_THREAD for thread in threading.enumerate()),
            'observers': len(node.thread.observers._all),
            'group': len(node.shared.inbox.group.entities)}


@pytest.mark.full
def test_a_robot_comes_is_commanded_and_goes(spawning, client):
    node = spawning()
    own = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: own)  # The thread that publishes starts with the first message.
    before = entities_of(node)
    assert come(client) == 'left'
    robot = node.simulation.robots['left']
    twist = robot.joints.twist_indices is not None
    expected = {f'/left/{row.name}' for row in topics_of(robot.parts, twist)
                if not row.name.startswith(('/', '~'))}
    optional = {'planning_scene_world', 'collision_object', 'attached_collision_object', 'odom'}
    assert {name for name in expected if name.rpartition('/')[2] not in optional} <= topics_below(
        node, 'left')
    states = client.listen(JointState, 'left/joint_states')
    client.spin_until(lambda: states)
    assert states[-1].name[0].startswith('left_')
    names, start = list(states[-1].name[:6]), np.array(states[-1].position[:6])
    np.testing.assert_allclose(node.simulation.data.body('left_base').xpos[:2], [0.0, 2.0])
    goal = start + 0.1
    client.publish('left/arm/joint_command', JointState(name=names, position=goal.tolist()))
    client.spin_until(lambda: np.abs(np.array(states[-1].position[:6]) - goal).max() < 1e-3)
    client.publish('left/right/gripper/command', Float64MultiArray(data=[1.0]))
    client.spin_until(lambda: abs(states[-1].position[6]) > 0.1)
    at = own[-1].position[0] + 0.2
    client.publish('arm/joint_command', JointState(name=[own[-1].name[0]], position=[at]))
    client.spin_until(lambda: abs(own[-1].position[0] - at) < 1e-3)
    go(client)
    assert list(node.simulation.robots) == ['robot0']
    client.spin_until(lambda: not client.node.count_publishers('left/joint_states'))
    client.spin_until(lambda: not client.node.count_subscribers('left/arm/joint_command'))
    assert entities_of(node) == before
    count = len(own)
    client.spin_until(lambda: len(own) > count + 3)


@pytest.mark.full
def test_it_has_parameters_a_description_and_is_in_the_model(spawning, client):
    spawning()
    urdfs = []
    come(client)
    client.node.create_subscription(
        String, 'left/robot_description', urdfs.append, LATCHED)
    client.spin_until(lambda: urdfs)
    assert 'left_' in urdfs[0].data
    models, dynamics = [], []
    client.node.create_subscription(String, 'manip_sim/mjcf', models.append, LATCHED)
    client.node.create_subscription(String, 'manip_sim/dynamics', dynamics.append, LATCHED)
    client.spin_until(lambda: models and dynamics)
    assert 'name="left_base"' in models[-1].data
    assert any(name.startswith('left_') for name in json.loads(dynamics[-1].data)['joints'])
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    assert {'left.control_mode.arm', 'left.command_timeout.arm', 'left.noise.joint_position'
            } <= set(names)
    value = Parameter('left.control_mode.arm', value='velocity').to_parameter_msg()
    (result,) = client.call(SetParameters, 'manip_sim/set_parameters',
                            SetParameters.Request(parameters=[value])).results
    assert result.successful
    (mode,) = client.call(GetParameters, 'manip_sim/get_parameters', GetParameters.Request(
        names=['left.control_mode.right'])).values
    assert mode.string_value == 'velocity'
    noise = Parameter('left.noise.joint_position', value=0.01).to_parameter_msg()
    client.call(SetParameters, 'manip_sim/set_parameters',
                SetParameters.Request(parameters=[noise]))
    truth = client.listen(JointState, 'left/truth/joint_states')
    client.spin_until(lambda: truth)
    go(client)
    client.spin_until(lambda: 'left_base' not in models[-1].data)
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    assert not [name for name in names if 'left' in name]
    client.spin_until(lambda: not client.node.count_publishers('left/truth/joint_states'))
    client.spin_until(lambda: not client.node.count_publishers('left/robot_description'))


@pytest.mark.full
def test_noise_of_a_robot_goes_with_it(spawning, client):
    node = spawning()
    for noise in (0.01, 0.0):
        come(client, text='{robot: Panda}')
        node.set_parameters([Parameter('left.noise.joint_position', value=noise)])
        exact = {row.name for row in node.table if row.name.startswith('left/truth/')}
        assert exact.issuperset(
            {'left/truth/joint_states', 'left/truth/sensors/left_right_imu/imu'}) or not noise
        assert not exact or noise
        go(client)


@pytest.mark.full
def test_a_trajectory_ends_with_its_robot_and_those_of_others_go_on(spawning, client):
    node = spawning(stepping='realtime')
    for name, y in (('first', 2.0), ('second', -2.0)):
        come(client, name, y=y)
    states = client.listen(JointState, 'second/joint_states')
    client.spin_until(lambda: states)
    for name in ('first', 'second'):
        state = client.state(f'{name}/joint_states')
        point = JointTrajectoryPoint(positions=[p + 0.15 for p in state.position[:6]])
        point.time_from_start.sec = 3
        client.publish(f'{name}/arm/joint_trajectory', JointTrajectory(
            joint_names=list(state.name[:6]), points=[point]))
    first = node.simulation.robots['first']
    client.spin_until(lambda: first.busy_parts and node.simulation.robots['second'].busy_parts)
    goal = np.array(states[0].position[:6]) + 0.15
    go(client, 'first')
    client.spin_until(lambda: np.abs(np.array(states[-1].position[:6]) - goal).max() < 0.01)
    assert list(node.simulation.robots) == ['robot0', 'second']


@pytest.mark.full
def test_many_come_and_go_and_leave_nothing_behind(spawning, client):
    node = spawning()
    counts, sizes = [], []
    for number in range(6):
        name = f'arm{number}' if number % 2 else 'left'
        come(client, name)
        states = client.listen(JointState, f'{name}/joint_states')
        client.spin_until(lambda: states)  # noqa: B023
        go(client, name)
        gc.collect()
        counts.append(entities_of(node))
        sizes.append(len([found for found in gc.get_objects()
                          if str(type(found).__module__).startswith('manip_sim.')]))
    assert counts == counts[:1] * 6
    assert sizes[-1] <= sizes[1] + 20


@pytest.mark.full
def test_a_reset_keeps_it_and_a_saved_state_wants_the_same_robots(spawning, client):
    node = spawning()
    save, restore = 'manip_sim/save_state', 'manip_sim/restore_state'
    assert client.call(Trigger, save).success
    come(client)
    answer = client.call(Trigger, restore)
    assert not answer.success and 'saved with the robots robot0, now there are robot0, left' in (
        answer.message)
    assert client.call(Trigger, 'manip_sim/reset').success
    assert list(node.simulation.robots) == ['robot0', 'left']
    assert client.call(Trigger, save).success and client.call(Trigger, restore).success
    go(client)
    assert not client.call(Trigger, restore).success


@pytest.mark.full
def test_lockstep_does_not_wait_for_it(spawning, client):
    node = spawning(stepping='lockstep')
    own = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: own)
    come(client)
    states = client.listen(JointState, 'left/joint_states')
    client.spin_until(lambda: states)
    begin, goal = node.simulation.time_ns, states[-1].position[0] + 0.05
    client.publish('left/arm/joint_command', JointState(
        name=[states[-1].name[0]], position=[goal]))
    hold = client.publisher(JointState, 'arm/joint_command')
    for _ in range(30):
        state = own[-1]
        answer = JointState(name=[state.name[0]], position=[state.position[0]])
        answer.header.stamp = state.header.stamp
        hold.publish(answer)
        client.spin_until(lambda: own[-1].header.stamp != state.header.stamp)  # noqa: B023
    assert node.simulation.time_ns == begin + 30 * 10_000_000
    client.spin_until(lambda: abs(states[-1].position[0] - goal) < 0.01)


REJECTED = [
    ({'name': 'robot0'}, "'robot0' is taken"), ({'name': 'arm'}, "'arm' is taken"),
    ({'name': 'cube'}, "'cube' is taken"), ({'name': 'control_mode'}, 'is taken'),
    ({'name': 'objects'}, "'objects'"), ({'name': '1st'}, "'1st' cannot be the name of a robot"),
    ({'name': 'a/b'}, "'a/b' cannot be"), ({'name': 'x' * 61}, 'cannot be'),
    ({'entity_namespace': 'elsewhere'}, "the namespace of a robot is its name, 'left'"),
    ({'resource_string': '{robot: UR5}'}, "did you mean 'UR5e'"),
    ({'resource_string': '{robot: /etc/passwd}'}, 'must not be read: only files below'),
    ({'resource_string': '{robot: [UR5e]}'}, 'robot: expected a name'),
    ({'resource_string': '{robot: UR5e, gripper: x.xml}'}, "unknown gripper 'x.xml'"),
    ({'resource_string': '{robot: UR5e, grip: none}'}, "unknown key 'grip'"),
    ({'orientation': [0.0] * 4}, ''), ({'position': [float('nan'), 0.0, 0.0]}, ''),
    ({'frame': 'table'}, "write 'world'"), ({'uri': 'no.yaml'}, 'no.yaml')]


@pytest.mark.full
def test_requests_that_cannot_be_served_change_nothing(spawning, client):
    node = spawning(arena='table')
    before = entities_of(node)
    for fields, text in REJECTED:
        answer = ask(client, 'spawn_entity', **{'name': 'left', 'resource_string': UR5E, **fields})
        assert not answer.successful and text in answer.reason and answer.reason, fields
        assert '\n' not in answer.reason
        assert entities_of(node) == before and list(node.simulation.robots) == ['robot0'], fields


@pytest.mark.full
def test_to_a_simulation_that_has_diverged_a_robot_comes_after_a_reset_only(spawning, client):
    node = spawning()
    node.thread.call(lambda: node.simulation.data.qvel.fill(1e9))
    client.spin_until(lambda: node.simulation.diverged is not None)
    answer = ask(client, 'spawn_entity', name='left', resource_string=UR5E,
                 position=[0.0, 2.0, 0.0])
    assert not answer.successful and answer.reason.endswith('; reset it first')
    assert list(node.simulation.robots) == ['robot0'] and not topics_below(node, 'left')
    assert client.call(Trigger, 'manip_sim/reset').success
    come(client)
    assert list(node.simulation.robots) == ['robot0', 'left']


@pytest.mark.full
def test_names_and_files(spawning, client, tmp_path):
    node = spawning()
    (tmp_path / 'ur.yaml').write_text('{robot: UR5e, gripper: none, name: mine}')
    assert come(client, '', '', uri='ur.yaml') == 'mine'
    assert node.simulation.robots['mine'].grippers == {}
    answer = ask(client, 'spawn_entity', uri='ur.yaml')
    assert not answer.successful and "'mine' is taken" in answer.reason
    assert come(client, '', '', uri='ur.yaml', allow_renaming=True, y=-2.0) == 'mine_1'
    for name in ('robot0_base', 'mine_base'):
        assert not ask(client, 'delete_entity', entity=name).successful
    assert 'mine' in node.simulation.entities.names
    go(client, 'mine')
    go(client, 'mine_1')


@pytest.mark.full
def test_streams_to_two_robots_of_a_node_in_another_process(client, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', str(Path(__file__).parent), prepend=os.pathsep)
    with subprocess.Popen([sys.executable, '-m', 'spawning_node'], stdin=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as running:
        own = client.listen(JointState, 'joint_states')
        client.spin_until(lambda: own)
        for name in ('left', 'first', 'second'):
            come(client, name)
            states = client.listen(JointState, f'{name}/joint_states')
            client.spin_until(lambda: states)  # noqa: B023
            senders = {topic: client.publisher(JointState, topic) for topic in (
                'arm/joint_command', f'{name}/arm/joint_command')}
            goals = own[-1].position[0] + 0.1, states[-1].position[0] + 0.1
            for part in np.linspace(0.0, 0.1, 50):
                for sender, state, goal in zip(senders.values(), (own[-1], states[-1]), goals):
                    sender.publish(JointState(
                        name=[state.name[0]], position=[goal - 0.1 + part]))
                client.executor.spin_once(timeout_sec=0.05)
            client.spin_until(lambda: abs(own[-1].position[0] - goals[0]) < 1e-3  # noqa: B023
                              and abs(states[-1].position[0] - goals[1]) < 1e-3)  # noqa: B023
            go(client, name)
            client.spin_until(lambda topic=f'{name}/joint_states': (
                not client.node.count_publishers(topic)))
        running.stdin.close()
        errors = running.stderr.read()
    assert running.returncode == 0 and 'Traceback' not in errors and 'ERROR' not in errors


@pytest.mark.full
def test_a_goal_of_a_robot_ends_with_it_and_its_client_hears_why(spawning, client, monkeypatch):
    action = pytest.importorskip('test_msgs.action', reason='test_msgs is not installed')

    class Swing(ActionMessages):
        name = 'swing'

        def goal_of(self, request):
            return TrajectoryGoal(self.robot, self.part, TrajectoryRequest(
                [self.robot.joint_names[0]], [float(request.order)], [[0.3]]), self._now_ns())

        def feedback_of(self, goal):
            return action.Fibonacci.Feedback(sequence=[0])

        def result_of(self, goal):
            assert goal.outcome.reason == "robot 'left' was deleted"
            return action.Fibonacci.Result(sequence=[7])

    monkeypatch.setattr(sim_node, 'offer_actions', lambda context, commands: ActionServers(
        context, commands, lambda robot: [Swing(action.Fibonacci, robot, 'arm',
                                                lambda: context.thread.progress.time_ns)]))
    node = spawning(stepping='realtime')
    before = entities_of(node)
    for _ in range(2):
        come(client)
        swinging = ActionClient(client.node, action.Fibonacci, 'left/arm/swing')
        client.spin_until(swinging.server_is_ready)
        sent = swinging.send_goal_async(action.Fibonacci.Goal(order=1000))
        client.spin_until(sent.done)
        result = sent.result().get_result_async()
        client.spin_until(lambda: node.simulation.robots['left'].busy_parts)
        go(client)
        client.spin_until(result.done)  # noqa: B023
        assert result.result().status == GoalStatus.STATUS_ABORTED
        assert list(result.result().result.sequence) == [7]
        client.spin_until(lambda: not swinging.server_is_ready())  # noqa: B023
        swinging.destroy()
    after = entities_of(node)
    assert {**after, 'threads': 0} == {**before, 'threads': 0}


@pytest.mark.full
def test_the_viewer_sees_both_robots_apart(spawning, client):
    node = spawning()
    name, space = node.get_name(), node.get_namespace()

    def seen():
        published, subscribed = ([topic for topic, _ in of_node(name, space)] for of_node in (
            client.node.get_publisher_names_and_types_by_node,
            client.node.get_subscriber_names_and_types_by_node))
        return layout_of('/', published, subscribed).robots
    client.spin_until(lambda: name in client.node.get_node_names())
    (alone,) = client.settled(seen)
    come(client)
    both = client.settled(seen)
    assert both == (alone, replace(alone, space='/left/'))
    assert alone.parts == ('arm', 'right/gripper') and alone.end_effectors == ('right',)
    go(client)
    client.spin_until(lambda: seen() == (alone,))


@pytest.mark.full
def test_odometry_and_markers_follow_a_mobile_robot(spawning, client):
    spawning()
    markers = client.listen(MarkerArray, 'manip_sim/markers')
    come(client, text='{robot: PandaOmron}')
    odometry = client.listen(Odometry, 'left/odom')
    client.spin_until(lambda: odometry and markers)
    assert odometry[-1].header.frame_id == 'left_odom'
    go(client)
    client.spin_until(lambda: not client.node.count_publishers('left/odom'))
    count = len(markers)
    client.spin_until(lambda: len(markers) > count + 5)
