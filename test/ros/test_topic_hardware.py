# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node as the robot of ros2_control's topic hardware."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from test_robot_description import description
from topic_hardware import Mimic, tag, TagJoint, TopicHardware

from manip_sim.models import compose
from manip_sim.models.urdf_writer import Hardware, urdf_of

NAN, INF = math.nan, math.inf
ARM = [f'panda_joint{n}' for n in range(1, 8)]
FINGERS = [f'panda_gripper_finger_joint{n}' for n in (1, 2)]
BASE = [f'panda_base_joint_mobile_{word}' for word in ('forward', 'side', 'yaw')]
CONFIG = Path(__file__).parents[2] / 'config' / 'topic_based_ros2_control.yaml'
ARM_TOLERANCE, FINGER_TOLERANCE = 2e-3, 5e-4


@pytest.fixture
def connect(client):
    """Return a function that makes the hardware of a tag, and waits until it is connected."""
    def make(joints, **topics):
        hardware = TopicHardware(client.node, joints, **topics)
        client.spin_until(lambda: hardware.connected)
        hardware.read()
        return hardware
    return make


@pytest.fixture
def until(client):
    """Return a function that lets a hardware run its cycles until a condition holds."""
    def run(hardware, condition):
        def cycle():
            hardware.cycle()
            return condition()
        client.spin_until(cycle)
    return run


def positions(hardware, names):
    return {name: hardware.states[name, 'position'] for name in names}


def shifted(hardware, names, by):
    return {name: value + by for name, value in positions(hardware, names).items()}


def reaches(hardware, goal, tolerance=ARM_TOLERANCE):
    return lambda: all(abs(hardware.states[name, 'position'] - value) < tolerance
                       for name, value in goal.items())


def rejected(node):
    return sum(statistics.rejected for statistics in node.commands.robots[0].statistics.values())


# What the hardware sends.

@pytest.mark.parametrize('kind', ['position', 'velocity', 'effort'])
def test_the_hardware_fills_the_field_of_the_only_command_interface(kind, client):
    hardware = TopicHardware(client.node, tag(['joint1', 'joint2'], kind))
    hardware.claim(kind, {'joint1': 0.12, 'joint2': 0.14})
    message = hardware.write()
    assert list(message.name) == ['joint1', 'joint2']
    assert list(getattr(message, kind)) == [0.12, 0.14]
    assert sum(len(getattr(message, f)) for f in ('position', 'velocity', 'effort')) == 2


def test_the_hardware_names_joints_that_it_has_no_values_for(client):
    hardware = TopicHardware(client.node, [
        TagJoint('observed', ()), TagJoint('finger'), TagJoint('follower', (),
                                                               mimic=Mimic('finger'))])
    hardware.claim('position', {'finger': 0.3})
    message = hardware.write()
    assert list(message.name) == ['observed', 'finger', 'follower']
    assert list(message.position) == [0.3]


def test_the_hardware_is_silent_where_it_has_arrived_and_never_with_a_nan(client):
    hardware = TopicHardware(client.node, tag(['joint1', 'joint2'], 'position'))
    hardware._receive(JointState(name=['joint2', 'joint1'], position=[0.2, 0.1]))
    hardware.read()
    hardware.claim('position', {'joint1': 0.1})
    assert math.isnan(hardware.write().position[1])
    hardware.claim('position', {'joint2': 0.2 + 9e-6})
    assert hardware.write() is None
    hardware.claim('position', {'joint1': 0.1 + 9e-6})
    assert list(hardware.write().position) == [0.1 + 9e-6, 0.2 + 9e-6]


def test_the_hardware_computes_the_state_of_a_mimic_joint(client):
    hardware = TopicHardware(client.node, [
        TagJoint('joint1'), TagJoint('joint2', (), mimic=Mimic('joint1', -2.0, 0.5))])
    hardware._receive(JointState(name=['joint1', 'joint2'], position=[0.21, 9.0],
                                 velocity=[0.22, 9.0]))
    hardware.read()
    assert hardware.states['joint2', 'position'] == pytest.approx(0.08)
    assert hardware.states['joint2', 'velocity'] == pytest.approx(-0.44)


def test_the_hardware_rejects_what_ros2_control_rejects(client):
    with pytest.raises(ValueError, match="mimic joint 'a' cannot have command interfaces"):
        TopicHardware(client.node, [TagJoint('a', mimic=Mimic('b'))])
    hardware = TopicHardware(client.node, [TagJoint('a', ('effort',), ('position',))])
    with pytest.raises(LookupError, match="joint 'a' has no state interface 'effort'"):
        hardware.write()
    with pytest.raises(LookupError, match="joint 'a' has no command interface 'position'"):
        hardware.claim('position', {'a': 0.0})
    hardware._receive(JointState(name=['b', 'a'], velocity=[0.1, 0.2]))
    with pytest.raises(LookupError, match="joint 'a' has no state interface 'velocity'"):
        hardware.read()
    hardware._receive(JointState(name=['b', 'a'], position=[0.1]))
    with pytest.raises(IndexError):
        hardware.read()


# What the node does with it.

def test_the_hardware_reads_every_state_of_every_joint(serve, connect):
    serve(prefix='panda_')
    hardware = connect(tag(ARM + FINGERS, 'position'))
    assert np.isfinite(list(hardware.states.values())).all()


def test_an_arm_follows_its_commands_and_the_hardware_falls_silent(serve, connect, until):
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM, 'position'))
    goal = shifted(hardware, ARM, 0.05)
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal))
    assert all(message.header.stamp.sec for message in hardware.sent)
    until(hardware, lambda: hardware.write() is None)
    hardware.read()
    assert reaches(hardware, goal)()
    assert rejected(node) == 0


@pytest.mark.full
def test_before_any_controller_is_active_nothing_moves(serve, client, connect, until):
    log = client.log()
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM + FINGERS, 'position'))
    start = positions(hardware, ARM + FINGERS)
    until(hardware, lambda: len(hardware.sent) > 20)
    assert all(np.isnan(message.position).all() for message in hardware.sent)
    assert reaches(hardware, start, FINGER_TOLERANCE)()
    # An idle controller manager is no error.
    assert rejected(node) == 0 and not any('rejected' in line for line in log)
    goal = shifted(hardware, ARM, 0.05)
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal))


def test_joints_that_no_controller_has_claimed_stay(serve, connect, until):
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM + FINGERS, 'position'))
    fingers = positions(hardware, FINGERS)
    goal = shifted(hardware, ARM, 0.05)
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal))
    assert np.isnan(hardware.sent[-1].position[-2:]).all()
    assert reaches(hardware, fingers, FINGER_TOLERANCE)()
    assert rejected(node) == 0


def test_a_joint_without_a_command_goes_on_to_its_earlier_goal(serve, client, connect, until):
    serve(prefix='panda_')
    hardware = connect(tag(ARM, 'position'))
    first, second = shifted(hardware, ARM[:1], 0.3), shifted(hardware, ARM[6:], 0.1)
    client.publish('joint_command', JointState(
        name=ARM, position=[*first.values(), *[NAN] * 6]))
    client.publish('joint_command', JointState(
        name=ARM, position=[*[NAN] * 6, *second.values()]))

    def read_and_compare():
        hardware.read()
        return reaches(hardware, first | second)()
    client.spin_until(read_and_compare)


@pytest.mark.full
def test_a_mimic_finger_is_named_without_a_value_and_follows(serve, client, connect, until):
    node = serve(prefix='panda_')
    hardware = connect([*tag(ARM, 'position'), TagJoint(FINGERS[0]),
                        TagJoint(FINGERS[1], (), mimic=Mimic(FINGERS[0], -1.0))])
    goal = shifted(hardware, ARM, 0.05) | {FINGERS[0]: 0.03}
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal, FINGER_TOLERANCE))
    assert (len(hardware.sent[-1].name), len(hardware.sent[-1].position)) == (9, 8)
    state = client.state()
    follower = state.position[list(state.name).index(FINGERS[1])]
    assert abs(follower + 0.03) < FINGER_TOLERANCE
    assert rejected(node) == 0


def test_fingers_that_are_only_observed_are_named_without_values(serve, connect, until):
    node = serve(prefix='panda_')
    hardware = connect([*tag(ARM, 'position'), *tag(FINGERS)])
    fingers = positions(hardware, FINGERS)
    goal = shifted(hardware, ARM, 0.05)
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal))
    assert (len(hardware.sent[-1].name), len(hardware.sent[-1].position)) == (9, 7)
    assert reaches(hardware, fingers, FINGER_TOLERANCE)()
    assert rejected(node) == 0


def test_fingers_have_the_prefix_of_the_robot(serve, connect, until):
    serve(prefix='panda_')
    hardware = connect(tag(FINGERS, 'position'))
    goal = {FINGERS[0]: 0.01, FINGERS[1]: -0.01}
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal, FINGER_TOLERANCE))


@pytest.mark.full
@pytest.mark.parametrize('base_first', [False, True])
def test_arm_positions_and_base_velocities_come_in_one_message(base_first, serve, connect, until):
    node = serve(robot='PandaOmron', prefix='panda_')
    parts = [tag(ARM, 'position'), tag(BASE, 'velocity')]
    hardware = connect([joint for part in (reversed(parts) if base_first else parts)
                        for joint in part])
    goal = shifted(hardware, ARM, 0.05)
    start = hardware.states[BASE[0], 'position']
    hardware.claim('position', goal)
    hardware.claim('velocity', dict(zip(BASE, (0.1, 0.0, 0.0))))
    until(hardware, lambda: reaches(hardware, goal)()
          and hardware.states[BASE[0], 'position'] > start + 0.05)
    message = hardware.sent[-1]
    assert (len(message.name), len(message.position), len(message.velocity)) == (10, 7, 3)
    assert abs(hardware.states[BASE[1], 'position']) < 0.01
    assert rejected(node) == 0


@pytest.mark.full
@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_an_arm_in_another_mode_takes_the_field_of_that_mode(mode, serve, connect, until):
    node = serve(prefix='panda_', control_mode__arm=mode)
    hardware = connect(tag(ARM, mode))
    start = hardware.states[ARM[6], 'position']
    hardware.claim(mode, dict.fromkeys(ARM[:6], 0.0) | {ARM[6]: 0.2})
    until(hardware, lambda: hardware.states[ARM[6], 'position'] > start + 0.05)
    assert rejected(node) == 0


def test_a_velocity_interface_that_nobody_claims_does_not_matter(serve, connect, until):
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM, 'position', 'velocity'))
    goal = shifted(hardware, ARM, 0.05)
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal))
    assert np.isnan(hardware.sent[-1].velocity).all()
    assert rejected(node) == 0


def test_a_velocity_in_position_mode_is_rejected_with_the_reason(serve, client, connect, until):
    log = client.log()
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM, 'position', 'velocity'))
    start = positions(hardware, ARM)
    hardware.claim('position', shifted(hardware, ARM, 0.05))
    hardware.claim('velocity', dict.fromkeys(ARM, 0.0))
    until(hardware, lambda: node.commands.robots[0].statistics['joint_command'].rejected > 5)
    client.spin_until(lambda: any('joint_command' in line and 'velocity' in line for line in log))
    hardware.read()
    assert reaches(hardware, start, FINGER_TOLERANCE)()


@pytest.mark.full
@pytest.mark.parametrize('infinity', [INF, -INF])
def test_an_infinite_command_is_rejected_as_a_whole(infinity, serve, client, connect, until):
    log = client.log()
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM, 'position'))
    start = positions(hardware, ARM)
    hardware.claim('position', shifted(hardware, ARM, 0.05) | {ARM[3]: infinity})
    until(hardware, lambda: node.commands.robots[0].statistics['joint_command'].rejected > 5)
    client.spin_until(lambda: any('must be finite' in line for line in log))
    hardware.read()
    assert reaches(hardware, start, FINGER_TOLERANCE)()


@pytest.mark.full
@pytest.mark.parametrize('names, position', [
    (ARM[:3], [0.0] * 4), ([], [0.0]), (ARM[:1], [0.0, 0.0])])
def test_a_message_that_cannot_be_matched_is_rejected(names, position, serve, client):
    node = serve(prefix='panda_')
    client.publish('joint_command', JointState(name=names, position=position))
    client.spin_until(lambda: node.commands.robots[0].statistics['joint_command'].rejected == 1)


# What happens when the controller manager is silent, ends, or meets lock-step.

@pytest.fixture
def controlled(sim_node):
    """Return a function that serves an arm, paused, and its hardware; the loop runs in periods."""
    def make(kind, **options):
        sim = sim_node(prefix='panda_', control_mode__arm=kind)
        hardware = TopicHardware(sim.node, tag(ARM, kind), '/joint_command', **options)
        while not hardware.connected:
            sim.run_for(0.01)
        hardware.read()

        def loop(seconds):
            for _ in range(round(seconds / 0.01)):
                hardware.cycle()
                hardware.acknowledged()
                sim.run_for(0.01)
        return sim, hardware, loop
    return make


@pytest.mark.full
def test_with_the_threshold_of_the_tag_a_constant_velocity_is_kept(controlled):
    (threshold,) = (float(p.text) for p in ElementTree.fromstring(urdf_of(
        compose('Panda'), hardware=Hardware({})).xml).iter('param')
        if p.get('name') == 'trigger_joint_command_threshold')
    sim, hardware, loop = controlled('velocity', threshold=threshold)
    hardware.claim('velocity', dict.fromkeys(ARM, 0.0) | {ARM[0]: 0.2})
    loop(1.0)
    velocity = sim.states('arm/joint_states').velocity[-50:, 0]
    assert np.abs(velocity - 0.2).max() < 1e-4


@pytest.mark.full
def test_with_the_threshold_of_the_plugin_the_timeout_starves_a_constant_velocity(controlled):
    sim, hardware, loop = controlled('velocity')
    hardware.claim('velocity', dict.fromkeys(ARM, 0.0) | {ARM[0]: 0.2})
    loop(2.0)
    assert sim.states('arm/joint_states').velocity[-150:, 0].min() < 0.15


@pytest.mark.full
@pytest.mark.parametrize('kind, command', [('velocity', 0.2), ('effort', 1.0)])
def test_an_arm_stops_when_the_controller_manager_dies(kind, command, controlled):
    sim, hardware, loop = controlled(kind, threshold=-1.0)
    hardware.claim(kind, dict.fromkeys(ARM, 0.0) | {ARM[6]: command})
    loop(0.5)
    assert sim.states('arm/joint_states').velocity[-1, 6] > 0.15
    # No cycle from here on.
    sim.run_for(1.5)
    velocity = sim.states('arm/joint_states').velocity
    last = len(velocity) - 150
    # The timeout has not passed yet, and then the arm rests.
    assert velocity[last + 15, 6] > 0.15
    assert np.abs(velocity[-20:]).max() < 2e-3


@pytest.mark.full
def test_an_arm_in_position_mode_keeps_its_goal_when_the_controller_manager_dies(controlled):
    sim, hardware, loop = controlled('position', threshold=-1.0)
    goal = shifted(hardware, ARM, 0.1)
    hardware.claim('position', goal)
    loop(0.05)
    sim.run_for(2.0)
    assert sim.states('arm/joint_states').position[-1] == pytest.approx(
        [*goal.values()], abs=ARM_TOLERANCE)


def test_lock_step_stands_still_with_this_hardware_and_the_node_says_so(
        serve, client, connect, until):
    log = client.log()
    serve(prefix='panda_', stepping='lockstep', ros2_control_tag=True)
    client.spin_until(lambda: any('simulated time stands still; set ros2_control_plugin to '
                                  'manip_sim_hardware/ManipSimSystem' in line for line in log))
    states = client.listen(JointState, 'joint_states')
    hardware = connect(tag(ARM, 'position'), threshold=-1.0)
    hardware.claim('position', shifted(hardware, ARM, 0.05))
    until(hardware, lambda: len(hardware.sent) > 50 and len(states) > 10)
    assert {stamp(state) for state in states} == {0.01}


@pytest.mark.full
def test_a_moving_command_is_followed_at_the_rate_of_the_hardware(serve, client, connect, until):
    node = serve(prefix='panda_')
    hardware = connect(tag(ARM + FINGERS, 'position'))
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: bool(states))

    def mean_velocity():
        """Return the velocity in the middle of a move of 0.4 rad in 1 s."""
        start, begin = hardware.states[ARM[0], 'position'], stamp(states[-1])

        def follow():
            goal = min(0.4 * (stamp(states[-1]) - begin), 0.4)
            hardware.claim('position', {ARM[0]: start + goal})
            return hardware.states[ARM[0], 'position'] > start + 0.398
        follow()  # Without a goal the first message would be rejected.
        until(hardware, follow)
        moved = np.array([(stamp(m), m.velocity[list(m.name).index(ARM[0])]) for m in states])
        return moved[(moved[:, 0] > begin + 0.3) & (moved[:, 0] < begin + 0.8), 1].mean()

    # Other processes may slow the machine for a while; a wrong velocity would be wrong every time.
    velocities = []
    while not any(abs(velocity - 0.4) < 0.02 for velocity in velocities):
        assert len(velocities) < 6, velocities
        velocities.append(mean_velocity())
    assert rejected(node) == 0


def stamp(message):
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


@pytest.mark.full
def test_the_shipped_configuration_fits_the_hardware_as_it_is(process, connect, until):
    process('--ros-args', '--params-file', str(CONFIG), '-r',
            'joint_states:=robot_joint_states', '-r', 'joint_command:=robot_joint_commands')
    hardware = connect(tag(ARM + FINGERS, 'position'), command_topic='/robot_joint_commands',
                       state_topic='/robot_joint_states')
    goal = shifted(hardware, ARM, 0.05) | {FINGERS[0]: 0.02, FINGERS[1]: -0.02}
    hardware.claim('position', goal)
    until(hardware, reaches(hardware, goal, FINGER_TOLERANCE))


def test_lock_step_goes_on_with_a_hardware_that_answers_each_state_as_the_own_plugin_does(
        serve, client):
    node = serve(prefix='panda_', stepping='lockstep')
    publisher = client.publisher(JointState, 'joint_command')
    states, velocity = [], [NAN] * len(ARM)

    def answer(state):
        if states and stamp(state) <= stamp(states[-1]):
            return
        states.append(state)
        # All joints, all fields; without a controller there is no number.
        nothing = [NAN] * len(ARM)
        command = JointState(name=ARM, position=nothing, velocity=velocity, effort=nothing)
        command.header.stamp = state.header.stamp
        publisher.publish(command)
    client.node.create_subscription(JointState, 'joint_states', answer, 10)
    client.spin_until(lambda: len(states) > 20)
    # A controller claims velocities while the physics waits for answers.
    result = client.call(SetParameters, 'manip_sim/set_parameters', SetParameters.Request(
        parameters=[Parameter('control_mode.arm', value='velocity').to_parameter_msg()]))
    assert result.results[0].successful
    velocity[:] = [0.2, *[0.0] * 6]
    client.spin_until(lambda: abs(states[-1].velocity[0] - 0.2) < 1e-6)
    assert [round(stamp(state) * 100.0) for state in states] == list(range(1, len(states) + 1))
    assert rejected(node) == 0


def test_lock_step_goes_on_with_a_hardware_that_waits_for_the_sensors_that_the_tag_says_are_due(
        serve, client):
    serve(stepping='lockstep', ros2_control_tag=True,
          ros2_control_plugin='manip_sim_hardware/ManipSimSystem',
          sensors=['{name: robot0_right_imu, rate: 20.0}'])
    (sensor,) = (s for s in description(client, 'robot_description').iter('sensor')
                 if s.get('name') == 'robot0_right_imu')
    told = {param.get('name'): param.text for param in sensor.findall('param')}
    interval = round(1000.0 / float(told['rate']))  # [ms]
    publisher = client.publisher(JointState, 'joint_command')
    states, imus, answered = [], [], []

    def answer(message):
        (imus if isinstance(message, Imu) else states).append(round(1000.0 * stamp(message)))
        due = states and states[-1] // interval * interval
        if states and states[-1] not in answered and (due == 0 or due in imus):
            answered.append(states[-1])
            command = JointState(name=['robot0_joint1'], position=[NAN])
            command.header.stamp.nanosec = states[-1] * 1_000_000
            publisher.publish(command)
    client.node.create_subscription(Imu, told['topic'], answer, 10)
    client.node.create_subscription(JointState, 'joint_states', answer, 10)
    client.spin_until(lambda: answered and answered[-1] >= 300)
    assert answered[:30] == list(range(10, 310, 10))
    # Between two measurements nothing comes but the state at the start.
    assert {imu for imu in imus if imu % interval} <= {10}
