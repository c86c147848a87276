# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Of every live parameter, get, dump and what acts agree, whatever has changed it."""

from functools import partial
import json

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from spawning_node import ask, SpawningByParameters
from std_msgs.msg import String

from manip_sim.errors import ParameterError
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.models.object_creation import create_object
from manip_sim.models.user_files import AllowedRoots
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.ros.spawning_services import add_robot
from manip_sim.simulation.robot_spawning import plan_with_robot, RequestedRobot

#: Live parameters of the node that are no settings of a robot.
OF_NODE = {'seed', 'keyframe', 'pause_at', 'real_time_factor', 'expected_command_rate'}


def live(node):
    """Return the specifications of all live parameters, by name."""
    return {name: spec for name, spec in node.declared._specs.items() if spec.live}


def another(spec, number):
    """Return a value of a parameter that is not its default; another one for each number."""
    if spec.choices:
        return [choice for choice in spec.choices if choice != spec.default][number % 2]
    if isinstance(spec.default, bool):
        return not spec.default
    if spec.name.endswith('.collision'):
        return ('default', '[20]')[number]
    low, high = spec.minimum or 0.0, min(spec.maximum, 3.0)
    value = low + (high - low) * (0.3 + 0.1 * number)
    if spec.name.endswith('.inertia'):  # Of a ball.
        return [1.0 + number, 0.0, 0.0, 1.0 + number, 0.0, 1.0 + number]
    return [value] * spec.length if spec.length else value


def assert_agree(node):
    """Check every live parameter of the only robot; for parts of several, where those agree."""
    robot, get = node.simulation.robot, node.declared.value
    acting = robot.settings
    joints = {name: tuple(sorted(part.atomic)) for name, part in robot.parts.items()}
    for name in live(node).keys() - OF_NODE:
        head, part, *rest = [*name.split('.'), '']
        parts = joints.get(part, (part,)) if name not in acting else (part,)
        first, *others = [
            acting['.'.join(filter(None, (head, own, *rest)))] if name not in acting
            else acting[name] for own in parts]
        if all(value == first for value in others):
            assert get(name) == first, name


def set_live(node, **values):
    for result in node.set_parameters([Parameter(name.replace('__', '.'), value=value)
                                       for name, value in values.items()]):
        assert result.successful, result.reason


def number_of(node):
    return [name for name in live(node) if name not in OF_NODE
            and not name.startswith(('control_mode', 'null_space_posture'))]


@pytest.mark.full
@pytest.mark.parametrize('robot', ['Panda', 'Baxter', 'PandaOmron'])
def test_get_and_what_acts_agree_for_every_live_parameter(robot, serve):
    node = serve(robot=robot, start_paused=True)
    assert_agree(node)
    for number in (0, 1):
        for name in number_of(node):
            value = another(live(node)[name], number)
            set_live(node, **{name: value})
            assert node.declared.value(name) == value
        assert_agree(node)
        if number == 0:
            node.thread.change('save')
            saved = {name: node.declared.value(name) for name in number_of(node)}
    for name in [name for name in live(node) if name.startswith('control_mode')]:
        set_live(node, **{name: 'effort'})
        assert_agree(node)
    node.thread.reset()
    assert_agree(node)
    node.thread.restore()
    assert_agree(node)
    assert {name: node.declared.value(name) for name in number_of(node)} == saved
    assert node.declared.value('control_mode.arm') == 'position'


def test_a_posture_of_the_null_space_acts_and_one_out_of_range_is_rejected(serve):
    node = serve(start_paused=True, null_space_posture__right='[0, 0.1, 0, -2, 0, 2, 0]')
    assert_agree(node)
    set_live(node, null_space_posture__right='0.1, 0.1, 0.0, -2.0, 0.0, 2.0, 0.0')
    assert_agree(node)
    for text, reason in (('[0, 0, 0, 0, 0, 0, 0]', "joint 'robot0_joint4' must be from"),
                         ('home', "must be 'initial'"), ('[1, 2]', 'must have 7 numbers')):
        result = node.set_parameters_atomically(
            [Parameter('null_space_posture.right', value=text)])
        assert not result.successful and reason in result.reason
        assert_agree(node)
    node.thread.reset()
    assert_agree(node)
    assert node.declared.value('null_space_posture.right').startswith('0.1, 0.1')
    set_live(node, null_space_posture__right='initial')
    assert_agree(node)


def test_numbers_that_came_over_ros_are_in_the_journal(serve, client):
    node, texts = serve(stepping='free'), []
    client.node.create_subscription(
        String, 'manip_sim/journal', lambda message: texts.append(message.data), 100)
    client.spin_until(lambda: texts)
    values = {name: another(spec, 0) for name, spec in live(node).items() if spec.length}
    assert values
    for name, value in values.items():
        (result,) = client.call(SetParameters, 'manip_sim/set_parameters', SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])).results
        assert result.successful, result.reason

    def noted():
        return [entry[2][-1] for text in texts for entry in json.loads(text)['entries']
                if entry[0] == 'operation']
    client.spin_until(lambda: all(value in noted() for value in values.values()))


@pytest.mark.full
def test_in_one_change_the_parameter_of_fewer_parts_acts_and_then_the_last_one(serve):
    baxter = serve(robot='Baxter', start_paused=True)
    for order in (1, -1):
        changes = [Parameter('control_mode.right', value='velocity'),
                   Parameter('control_mode.arm', value='effort')][::order]
        assert baxter.set_parameters_atomically(changes).successful
        assert [baxter.declared.value(f'control_mode.{part}') for part in ('right', 'left')] == [
            'velocity', 'effort']
        assert_agree(baxter)
    # Where each arm is named, what the part of both is given does not act.
    assert baxter.set_parameters_atomically([
        Parameter(f'control_mode.{part}', value=mode)
        for part, mode in (('left', 'velocity'), ('arm', 'effort'), ('right', 'velocity'))]
    ).successful
    assert baxter.declared.value('control_mode.arm') == 'velocity'
    assert_agree(baxter)
    result = baxter.set_parameters_atomically([
        Parameter(f'control_mode.{part}', value=mode)
        for part, mode in (('left', 'effort'), ('arm', 'efort'), ('right', 'effort'))])
    assert not result.successful and 'efort' in result.reason
    assert_agree(baxter)
    # The part of both arms has the values that the arms share.
    set_live(baxter, reflex__right__velocity=0.5)
    assert baxter.declared.value('reflex.arm.velocity') == 0.0
    set_live(baxter, reflex__left__velocity=0.5)
    assert baxter.declared.value('reflex.arm.velocity') == 0.5
    panda = serve(robot='Panda', start_paused=True)
    for names in (('arm', 'right'), ('right', 'arm')):
        assert panda.set_parameters_atomically(
            [Parameter(f'reflex.{part}.velocity', value=value)
             for part, value in zip(names, (0.4, 0.6))]).successful
        assert panda.declared.value('reflex.arm.velocity') == 0.6
        assert_agree(panda)


def test_a_timeout_that_was_set_for_one_arm_stays_when_the_mode_of_both_changes(serve):
    node = serve(robot='Baxter', start_paused=True)
    set_live(node, command_timeout__right=0.7)
    set_live(node, control_mode__arm='velocity')
    assert_agree(node)
    assert [node.declared.value(f'command_timeout.{part}') for part in ('right', 'left')] == [
        0.7, 0.2]


def test_a_restored_timeout_follows_the_mode_as_it_did_when_it_was_saved(serve):
    node = serve(robot='Panda', start_paused=True)
    set_live(node, control_mode__arm='effort')
    node.thread.change('save')
    set_live(node, command_timeout__arm=0.7)
    node.thread.restore()
    assert node.declared.value('command_timeout.right') == 0.2
    set_live(node, control_mode__arm='position')
    assert node.declared.value('command_timeout.arm') == 0.0
    assert_agree(node)


def test_a_timeout_that_was_set_to_its_default_stays_set_in_dumps_and_saved_states(serve):
    def modes_then_timeouts(node):
        return [(set_live(node, control_mode__arm=mode),
                 node.declared.value('command_timeout.arm'))[1]
                for mode in ('velocity', 'position', 'effort')]

    node = serve(robot='Panda', start_paused=True)
    set_live(node, command_timeout__right=0.0)
    assert not node.declared.value('timeout_follows_mode.arm')
    dumped = {name.replace('.', '__'): value for name, value in node.declared.values.items()}
    assert modes_then_timeouts(serve(**dumped)) == [0.0] * 3
    node.thread.change('save')
    set_live(node, timeout_follows_mode__arm=True)
    assert modes_then_timeouts(node) == [0.2, 0.0, 0.2]
    node.thread.restore()
    assert_agree(node)
    assert modes_then_timeouts(node) == [0.0] * 3
    # The default of the mode in the same change.
    assert node.set_parameters_atomically([
        Parameter('control_mode.arm', value='velocity'),
        Parameter('timeout_follows_mode.arm', value=True)]).successful
    assert node.declared.value('command_timeout.right') == 0.2
    assert_agree(node)


def test_a_mode_that_cannot_be_used_leaves_all_parameters_at_what_acts(serve, monkeypatch):
    node = serve(robot='Baxter', start_paused=True)
    monkeypatch.setattr(node.simulation.robot.joints, 'set_mode', lambda *_: 1 / 0)
    result = node.set_parameters_atomically([Parameter('control_mode.arm', value='effort')])
    assert (result.successful, result.reason) == (False, 'division by zero')
    assert_agree(node)
    assert node.declared.value('control_mode.arm') == 'position'


@pytest.mark.parametrize('order', [1, -1])
def test_a_change_that_is_rejected_half_way_changes_nothing(order, serve):
    node = serve(robot='Baxter', start_paused=True)
    set_live(node, command_timeout__left=0.3, stream_hold__arm=0.2)
    before, acting = node.declared.values, node.simulation.robot.settings
    result = node.set_parameters_atomically([Parameter(name, value=value) for name, value in (
        ('noise.joint_position', 0.1), ('real_time_factor', 0.5), ('control_mode.arm', 'velocity'),
        ('command_timeout.right', 0.7), ('reflex.left.collision', 'always'),
        ('stream_hold.right', 0.4), ('expected_command_rate', 50.0), ('seed', 9))][::order])
    assert not result.successful and "got 'always'" in result.reason
    assert node.declared.values == before
    assert node.simulation.robot.settings == acting
    assert (node.thread.real_time_factor, node.thread.next_seed) == (1.0, None)
    # Timeouts follow the control mode as before.
    set_live(node, control_mode__arm='velocity')
    assert [node.declared.value(f'command_timeout.{part}') for part in ('right', 'left')] == [
        0.2, 0.3]
    assert_agree(node)


def test_what_is_drawn_is_what_get_says(serve, tmp_path):
    file = tmp_path / 'drawn.yaml'
    file.write_text('parameters:\n  noise.joint_position: {uniform: [0.001, 0.01]}\n')
    node = serve(robot='UR5e', randomization=str(file), start_paused=True,
                 noise__joint_position=0.5, seed=3)
    values = []
    for seed in (3, 4, 5):
        set_live(node, seed=seed)
        node.thread.reset()
        assert_agree(node)
        drawn = node.simulation.randomized.drawn['parameters/noise.joint_position']
        values.append(node.declared.value('noise.joint_position'))
        assert values[-1] == drawn
        node.thread.change('save')
    assert len(set(values)) == 3 and max(values) <= 0.01
    # A value that is set by hand replaces a drawn one until the next draw.
    set_live(node, noise__joint_position=0.2, seed=9)
    assert node.simulation.randomized.drawn['parameters/noise.joint_position'] == 0.2
    node.thread.restore()
    assert_agree(node)
    assert node.declared.value('noise.joint_position') == values[-1]


@pytest.mark.full
@pytest.mark.parametrize('robot', ['Panda', 'Baxter', 'PandaOmron'])
def test_a_dump_starts_an_identical_node(robot, serve):
    first = serve(robot=robot, start_paused=True)
    set_live(first, control_mode__arm='velocity', reflex__right__velocity=0.9,
             cartesian__right__stiffness=99.0, latency__command=0.02, stream_hold__right=0.3)
    dumped = {name.replace('.', '__'): value for name, value in first.declared.values.items()}
    second = serve(**dumped)
    assert second.declared.values == first.declared.values
    assert second.simulation.robot.settings == first.simulation.robot.settings
    digests = []
    for node in (first, second):
        assert_agree(node)
        node.thread.reset()
        digests.append(node.thread.call(node.simulation.digest))
    assert digests[0] == digests[1]


BOX = '{shape: box, size: [0.05, 0.05, 0.05], mass: 0.2}'
#: With a sensor and an actuator, which have topics and commands of their own.
MECHANISM = ('<mujoco><worldbody><body name="top"><freejoint/><geom size="0.05" mass="0.1"/>'
             '<site name="s"/><body><joint name="h"/><geom size="0.02" mass="0.01"/></body></body>'
             '</worldbody><actuator><motor name="m" joint="h"/></actuator><sensor><gyro name="g" '
             'site="s"/></sensor></mujoco>')


def ledger(node):
    """Return how much the node has for objects."""
    return (sorted(node._parameters), sorted(row.name for row in node.table),
            sorted(node.surroundings.statistics), len(list(node.publishers)),
            len(list(node.subscriptions)))


def all_values(node):
    """Return all parameters as a dump has them, those of QoS too."""
    return {name: parameter.value for name, parameter in node._parameters.items()
            if parameter.value is not None}


@pytest.mark.full
def test_objects_that_came_and_went_leave_nothing_and_dumps_start_identical_nodes(
        serve, client, tmp_path):
    node = serve(robot='UR5e', arena='table', start_paused=True)
    SpawningByParameters(node, tmp_path)

    def come_and_go(number):
        for text in (BOX, MECHANISM):
            name = f'thing{number}'
            answer = ask(client, 'spawn_entity', name=name, resource_string=text)
            assert answer.successful, answer.reason
            if text == BOX and number == 0:
                assert all_values(node).keys() == before.keys()
            assert ask(client, 'delete_entity', entity=name).successful

    before = all_values(node)
    come_and_go(0)
    first = ledger(node)  # Commands of loose actuators stay subscribed to.
    assert first[0] == sorted(before)
    for number in range(1, 4):
        come_and_go(number)
    assert ledger(node) == first
    assert ask(client, 'spawn_entity', name='stays', resource_string=BOX).successful
    assert ask(client, 'delete_entity', entity='cube').successful
    again = serve(**all_values(node))
    assert all_values(again) == before


@pytest.mark.full
def test_50_objects_that_came_and_went_leave_nothing(serve, tmp_path):
    (tmp_path / 'mechanism.xml').write_text(MECHANISM)
    node = serve(robot='UR5e', gripper='none', start_paused=True)

    def change(plan, *operation):
        node.thread.call(partial(node.thread.change, *operation, using=plan))
        node.shared.world_changed()

    def come_and_go(number):
        name = f'thing{number}'
        more = {'file': str(tmp_path / 'mechanism.xml')} if number % 2 else {
            'shape': 'box', 'size': [0.05, 0.05, 0.05], 'mass': 0.2}
        item = create_object({'name': name, 'position': [1.0, 0.0, 0.5], **more})
        change(plan_with(node.simulation.plan, item), 'spawn', name, None, [1.0, 0.0, 0.5],
               [1.0, 0.0, 0.0, 0.0])
        assert any(name in topic for topic, _ in node.get_publisher_names_and_types_by_node(
            node.get_name(), node.get_namespace()))
        change(plan_without(node.simulation.plan, name), 'delete', name)

    come_and_go(0)
    come_and_go(1)
    first = *ledger(node), len(list(node.waitables)), len(list(node.guards)), len(
        node.thread.observers._all)
    for number in range(2, 50):
        come_and_go(number)
    assert (*ledger(node), len(list(node.waitables)), len(list(node.guards)), len(
        node.thread.observers._all)) == first
    assert not [name for name in str(first).split() if 'thing' in name]


@pytest.mark.full
def test_a_dump_starts_a_node_after_noise_was_switched_off(serve):
    first = serve(robot='UR5e', start_paused=True, noise__joint_position=0.1)
    set_live(first, noise__joint_position=0.0)
    second = serve(**all_values(first))
    assert second.declared.values == first.declared.values


def come(node, folder):
    """Let a robot with the name left come."""
    add_robot(node.shared, 'left', plan_with_robot(node.simulation, RequestedRobot(
        {'robot': 'Panda'}, 'here', AllowedRoots([folder], 'here')).create('left', Pose(
            np.array([0.0, 2.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])))))


def test_a_timeout_that_was_set_to_its_default_stays_when_a_robot_comes(serve, tmp_path):
    node = serve(robot='UR5e', start_paused=True)
    set_live(node, control_mode__arm='velocity')
    set_live(node, command_timeout__arm=0.2)
    come(node, tmp_path)
    set_live(node, control_mode__arm='position')
    assert node.declared.value('command_timeout.arm') == 0.2


@pytest.mark.full
@pytest.mark.parametrize('text', ['{robot: UR5e}', '{robot: PandaOmron}'])
def test_a_dump_with_a_spawned_robot_starts_an_identical_node_without_it(
        text, serve, client, tmp_path):
    node = serve(robot='UR5e', arena='table', start_paused=True)
    SpawningByParameters(node, tmp_path)
    set_live(node, reflex__right__velocity=0.9)
    before = all_values(node)

    answer = ask(client, 'spawn_entity', name='left', resource_string=text,
                 position=[0.0, 2.0, 0.0])
    assert answer.successful, answer.reason
    set_live(node, left__control_mode__arm='velocity', left__noise__joint_position=0.1)
    dump = all_values(node)
    assert dump.keys() > before.keys() and dump['left.control_mode.arm'] == 'velocity'
    given = GivenParameters({name: value for name, value in dump.items() if name not in before})
    given.check_names()  # Of the commands without ROS.
    assert not given.given
    again = serve(**dump)
    assert all_values(again) == before
    assert ask(client, 'delete_entity', entity='left').successful
    assert all_values(node) == before
    # A robot of that name that comes to the new node has settings of its own.
    come(again, tmp_path)
    assert again.declared.value('left.control_mode.arm') == 'position'


def test_parameters_of_a_robot_that_is_not_told_as_spawned_are_unknown(serve):
    for given in ({'left.control_mode.arm': 'velocity'},
                  {'robots': ['left'], 'left.robot': 'UR5e', 'left.spawned': True},
                  {'left.arm.spawned': True, 'left.arm.mode': 1}):
        with pytest.raises(ParameterError, match="unknown parameter 'left"):
            serve(**given)
