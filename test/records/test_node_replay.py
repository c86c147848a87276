# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records of nodes are repeated to the bit, and whatever was changed in one is found."""

import json
import re
import shutil

from hostile_records import encoded, rewrite
from mcap.records import Message
import numpy as np
import pytest
from robot_kinds import KINDS

from manip_sim.cli.main import main
from manip_sim.control.modes import LAWS
from manip_sim.interface.composition import compose_world, with_contents
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.laws import law
from manip_sim.models import compose_robot
from manip_sim.models.grippers import gripper_names
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with
from manip_sim.records.record_file import decoder, definition, full_name, RecordFile
from manip_sim.records.recorder import NODE
from manip_sim.runtime import SimulationThread
from manip_sim.runtime.action_goals import GoalTracker, GripperGoal, GripperRequest
from manip_sim.runtime.trajectory_goal import TrajectoryGoal, TrajectoryRequest
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot_spawning import plan_with_robot

TEXT, TOPIC = 'std_msgs/String', '/manip_sim/journal'


class Session:
    """A simulation that is stepped as a node steps it, and recorded."""

    def __init__(self, path, **given):
        self.given = given
        composition = compose_world(GivenParameters(given))
        self.simulation = Simulation(composition.world)
        self.thread = SimulationThread(self.simulation, composition.steps, paused=True)
        self.goals = GoalTracker(self.thread, self.simulation, lambda goal: None)
        self.thread.start()
        self._file = RecordFile(path)
        self._file.describe(NODE, {'node': '/manip_sim'})
        self._channel = self._file.channel(TOPIC, full_name(TEXT), definition(TEXT))
        self._number = 0

    def write(self, entries):
        """Write entries as the node publishes them."""
        self._file.write(self._channel, self.simulation.time_ns, encoded(TEXT, data=json.dumps(
            {'number': self._number, 'entries': entries})))
        self._number += 1

    def begin(self):
        """Begin, or begin again, as for a new subscriber."""
        about = {'parameters': self.given, 'task_seed': None}
        self.thread.call(lambda: self.thread.changes.journal.begin(
            {**about, 'objects': self.thread.changes.operations.objects}, self.write))

    def step(self, count):
        """Advance by some control periods; each is a message."""
        for _ in range(count):
            self.thread.step()
            self.thread.call(self.thread.changes.journal.flush)

    def act(self, periods, robot=None):
        """Let all parts follow sines."""
        robot = robot or self.simulation.robot
        for k in range(periods):
            for name, part in robot.parts.items():
                if part.actuators and part.atomic == (name,):
                    count = (robot.robot_model.grippers[name.split('/')[0]].dof
                             if part.gripper is not None else len(part.actuators))
                    self.thread.submit([robot.parse.action(
                        name, 0.3 * np.sin(0.1 * k + np.arange(count)))], robot=robot.name)
            self.step(1)

    def close(self):
        """Complete the file."""
        self.thread.stop()
        self.thread.changes.journal.end()
        self._file.close()


@pytest.fixture
def session(tmp_path):
    """Return a function that starts a session, whose record is ``record.mcap``."""
    open_ones = []

    def start(**given):
        open_ones.append(Session(tmp_path / 'record.mcap', **given))
        return open_ones[-1]
    yield start
    for one in open_ones:
        one.thread.stop()


@pytest.fixture
def verify(capsys, tmp_path):
    """Return a function that verifies a record, and returns the exit code and the lines."""
    def run(path=tmp_path / 'record.mcap'):
        code = main(['replay', str(path), '--verify'])
        out, errors = capsys.readouterr()
        return code, (out + errors).replace(f'{path}: ', '').splitlines()
    return run


@pytest.mark.full
@pytest.mark.parametrize('robot', KINDS)
def test_the_commands_of_a_robot_of_each_kind_are_repeated(robot, session, verify):
    node = session(robot=robot, arena='table')
    node.act(10)
    node.begin()  # While everything moves.
    node.act(110)
    node.close()
    code, lines = verify()
    assert lines[-1] == '1 of 1 equal' and code == 0
    assert lines[0].startswith('110 control periods repeated, with ')


@pytest.mark.parametrize('gripper', [
    pytest.param(name, marks=[] if name == 'VacuumGripper' else pytest.mark.full)
    for name in gripper_names()])
def test_the_commands_of_each_gripper_are_repeated(gripper, session, verify):
    node = session(robot='UR5e', gripper=gripper)
    node.act(3)
    node.begin()
    node.act(20)
    node.close()
    code, lines = verify()
    assert lines[-1] == '1 of 1 equal' and code == 0, lines


def trajectory(node, seconds=0.5):
    """Return a goal for the arm."""
    robot = node.simulation.robot
    names = robot.robot_model.arm_joints
    place = [[node.simulation.data.joint(name).qpos[0] - 0.1 for name in names]]
    return TrajectoryGoal(robot, 'arm', TrajectoryRequest(names, [seconds], place),
                          node.simulation.time_ns)


@pytest.mark.full
def test_goals_operations_and_restored_states_are_repeated(session, verify):
    node = session(robot='Panda', arena='table')
    thread, simulation, name = node.thread, node.simulation, node.simulation.robot.name
    early = trajectory(node)
    node.goals.start(early)
    node.step(5)
    node.begin()
    node.step(5)
    assert node.goals.cancel(early)
    node.step(5)
    for goal, periods in ((trajectory(node, 0.3), 10), (GripperGoal(
            simulation.robot, 'right/gripper', GripperRequest(0.0)), 3)):
        node.goals.start(goal)
        node.step(periods)
        assert node.goals.cancel(goal)
    assert thread.change('tare') is None
    for operation in (
            ('mode', name, 'arm', 'velocity'), ('timeout', name, 'arm', 0.1, True),
            ('sensing', name, 'latency.command', 0.02), ('sensing', name, 'latency.state', 0.01),
            ('sensing', name, 'noise.joint_position', 0.001), ('wrench_cutoff', name, 'right', 9.),
            ('payload', name, 'right', 'mass', 0.3), ('integral_gain', name, 'arm', 2.0),
            ('set_payload', name, 'right', 0.2, [0.0, 0.0, 0.1], [0.0] * 6),
            ('reflex', name, 'arm', 'velocity', 0.9), ('stream_hold', name, 'arm', 0.1),
            ('reflex', name, 'arm', 'collision', 'default'),
            ('place', 'cube', [[0.5, 0.1, 1.0], [0.0, 0.0, 0.0, 1.0]], None),
            ('fault', {'what': 'limp', 'part': 'arm', 'until': 0.03}),
            ('fault', {'what': 'lost_commands', 'part': 'arm', 'value': 0.5, 'until': 0.2})):
        thread.change(*operation)
        node.act(5)
    thread.change('mode', name, 'arm', 'position')
    thread.change('save')
    thread.changes.at_next_period('pull', 'pull', 'cube', [0.5, 0.1, 1.0], [0.5, 0.0, 1.2], 1)
    node.act(10)
    thread.restore()
    node.act(10)
    thread.next_seed = 7
    thread.reset()
    node.act(10)
    node.goals.start(trajectory(node))
    node.step(60)
    assert not node.goals.goals
    node.close()
    code, lines = verify()
    assert (code, lines[-1]) == (0, '1 of 1 equal')
    assert lines[0].startswith('188 control periods repeated, with ')


@pytest.mark.full
@pytest.mark.parametrize('setting', [
    ('cartesian', 'robot0', 'right', 'twist_timeout', 1.0),
    ('reflex', 'robot0', 'arm', 'velocity', 0.01),
    ('fault', {'what': 'limp', 'part': 'arm', 'from': 0.1, 'until': 0.2})], ids=lambda s: s[0])
def test_settings_of_before_the_record_act_in_its_repetition(setting, session, verify):
    node = session(robot='UR5e')
    node.thread.change(*setting)
    node.begin()
    robot = node.simulation.robot
    node.thread.submit([robot.parse_cartesian.twist('right', [0.1, 0.0, 0.0], [0.0, 0.0, 0.0])])
    node.step(50)
    node.close()
    assert verify() == (0, [
        '50 control periods repeated, with 1 change from outside', '1 of 1 equal'])


@law(parameters={'stiffness': 200.0}, memory=1)
def counting(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    memory[0] += 1.0
    for i in range(len(q)):
        effort[i] = bias[i] + parameters[0] * (setpoint[i, 0] - q[i]) - 20.0 * v[i]


@pytest.fixture
def counted(session, monkeypatch):
    """Return a session in which a law has moved the arm when the record begins."""
    monkeypatch.setattr(LAWS, '_laws', {'counting': counting})
    node = session(robot='Panda')
    node.thread.change('mode', 'robot0', 'arm', 'law:counting')
    node.act(5)
    node.begin()
    node.thread.change('law', 'robot0', 'arm', 'stiffness', 300.0)
    node.act(105)
    node.close()
    return node


def test_laws_with_parameters_and_memory_are_repeated(counted, verify):
    code, lines = verify()
    assert (code, lines[-1]) == (0, '1 of 1 equal')
    assert lines[0].startswith('105 control periods repeated, with ')


@pytest.mark.parametrize(('change', 'text'), [
    (lambda state: state['law'].__setitem__(1, 'other'), "law that is not here: .*'other'"),
    *[(lambda state, name=name: state.__setitem__(name, ['a', '<f8', [0], '']),
       "saved with another law 'counting'") for name in ('parameters', 'memory', 'wrench')]],
    ids=['law', 'parameters', 'memory', 'wrench'])
def test_states_of_other_laws_are_rejected(change, text, counted, verify, tmp_path):
    def find(value):
        """Yield the states of laws in JSON."""
        if isinstance(value, list) and value[:1] == ['o'] and value[1].endswith(':SeatState'):
            yield value[2]
        for item in value.values() if isinstance(value, dict) else (
                value if isinstance(value, list) else ()):
            yield from find(item)

    def at_the_begin(message):
        if message['number'] == 0:
            for state in find(message):
                change(state)
        return message
    code, lines = verify(changed(tmp_path, at_the_begin))
    assert code == 1 and re.search(text, lines[0])


def changed(tmp_path, change):
    """Write a record in which a function has changed the messages of the journal, or dropped."""
    decode = decoder(TEXT)

    def of(item, topic):
        if not isinstance(item, Message):
            return item
        found = change(json.loads(decode(item.data).data))
        return [] if found is None else Message(
            item.channel_id, item.log_time, encoded(TEXT, data=json.dumps(found)),
            item.publish_time, item.sequence)
    return rewrite(tmp_path / 'record.mcap', tmp_path / 'changed.mcap', of)


@pytest.fixture(scope='module')
def thirty_periods(tmp_path_factory):
    """Return the record of thirty periods."""
    path = tmp_path_factory.mktemp('recorded') / 'record.mcap'
    node = Session(path, robot='UR5e')
    node.begin()
    node.act(15)
    node.thread.reset()
    node.act(15)
    node.close()
    return path


@pytest.fixture
def recorded(thirty_periods, tmp_path):
    """Copy the record of thirty periods to where a session would write it."""
    shutil.copy(thirty_periods, tmp_path)


def test_a_dropped_command_is_found_where_it_took_effect(recorded, verify, tmp_path):
    left = []

    def drop(message):
        left.extend(entry for entry in message['entries'] if entry[0] == 'commands')
        message['entries'] = [entry for entry in message['entries']
                              if entry[0] != 'commands' or len(left) != 7]
        return message
    code, lines = verify(changed(tmp_path, drop))
    assert code == 1 and lines[-1] == '0 of 1 equal'
    assert lines[0].startswith('the state differs, after 6 control periods, at 0.')


def test_a_digit_of_a_state_is_found(recorded, verify, tmp_path):
    def turn(message):
        for entry in message['entries']:
            if entry[0] == 'start':
                entry[2]['control_steps'] += 1
        return message
    code, lines = verify(changed(tmp_path, turn))
    assert code == 1 and lines[-1] == '0 of 1 equal'


@pytest.mark.full
@pytest.mark.parametrize('value', ['', 'digest'])
def test_another_digest_is_found(value, session, verify, tmp_path):
    node = session(robot='UR5e')
    node.begin()
    node.step(100)
    node.close()

    def turn(message):
        for entry in message['entries']:
            if entry[0] == value:
                entry[1] = entry[1][:-1] + ('0' if entry[1][-1] != '0' else '1')
        return message
    code, lines = verify(changed(tmp_path, turn))
    assert code == (value == 'digest')
    assert (lines[0] == 'the digest differs, after 100 control periods, at 1.010000 s') == code


def test_lost_messages_are_told_and_the_next_start_goes_on(session, verify, tmp_path):
    node = session(robot='UR5e')
    node.begin()
    node.act(5)
    node.begin()
    node.act(5)
    node.close()
    path = changed(tmp_path, lambda message: None if message['number'] == 3 else message)
    assert verify(path) == (1, [
        'messages of the journal are missing: number 4 follows 2, after 2 control periods, at '
        '0.030000 s', '7 control periods repeated, with 7 changes from outside', '0 of 1 equal'])


def test_what_cannot_be_repeated_is_told(session, verify):
    node = session(robot='UR5e')
    node.thread.change('save')
    node.begin()
    node.step(2)
    node.thread.restore()
    assert node.thread.changes.journal.incomplete
    node.step(3)
    node.begin()
    node.step(4)
    node.close()
    code, lines = verify()
    assert code == 1
    assert lines[0].startswith('a state was restored that was saved before, which cannot be '
                               'repeated, after 2 control periods')
    assert lines[1].startswith('6 control periods repeated')


def test_what_follows_a_robot_that_came_is_not_repeated(session, verify):
    node = session(robot='Panda')
    node.begin()
    node.act(2)
    robot = compose_robot('UR5e', prefix='left_')
    robot.set_base_xpos([0.0, 2.0, 0.0])
    node.thread.change_robots(plan_with_robot(node.simulation, robot))
    node.begin()
    node.act(3, node.simulation.robots['left'])
    node.close()
    code, lines = verify()
    assert code == 1
    assert lines[0].startswith('a robot came or went, which cannot be repeated, after 2 control')
    assert lines[1] == ('the journal cannot be repeated here: the state was saved with the robots '
                        'robot0, left, now there are robot0')


def test_files_of_others_are_not_read(session, verify, tmp_path):
    node = session(robot='UR5e')
    node.given['objects'] = ['{name: it, shape: mesh, file: secret.obj, mass: 1.0}']
    node.begin()
    node.close()
    code, lines = verify()
    assert code == 1
    assert lines[0] == ("the journal cannot be repeated here: the parameter 'objects' names a "
                        'file or folder, and a record does not contain those')


def test_other_versions_are_told(recorded, verify, tmp_path):
    def turn(message):
        for entry in message['entries']:
            if entry[0] == 'start':
                entry[2]['versions'] = 'manip_sim 0.0.9 with MuJoCo 3.0.0'
        return message
    code, lines = verify(changed(tmp_path, turn))
    assert code == 1 and lines[0].startswith(
        'the journal cannot be repeated here: the state was saved by manip_sim 0.0.9 with MuJoCo '
        '3.0.0, this is ')


def scrambled(value, random):
    """Return JSON in which something was replaced."""
    odd = (None, True, -1, 2**62, 1e308, float('nan'), '', 'x' * 99, [], {}, ['#', 0], ['@', 3],
           ['o', 'manip_sim.control.commands:CommandHandle', {}], ['v', '<f8', [9], 0, 0, [8]],
           ['a', '<f8', [2**40], '', 'C'])
    if isinstance(value, (list, dict)) and value and random.random() < 0.97:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[int(random.integers(len(keys)))]
        value[key] = scrambled(value[key], random)
        return value
    return odd[int(random.integers(len(odd)))]


@pytest.mark.full
@pytest.mark.parametrize('seed', range(60))
def test_scrambled_journals_end_in_lines_and_without_a_traceback(
        seed, recorded, verify, tmp_path):
    random = np.random.default_rng(seed)
    which = int(random.integers(8))

    def scramble(message):
        if message['number'] == which or seed % 2 and message['number'] == 0:
            return scrambled(message, random)
        return message
    code, lines = verify(changed(tmp_path, scramble))
    assert code in (0, 1) and len(lines) <= 6
    assert not any('Traceback' in line or len(line) > 700 for line in lines)


@pytest.mark.full
@pytest.mark.parametrize('given', [
    {'robots': ['left', 'right'], 'left.robot': 'UR5e', 'right.robot': 'Panda'},
    {'robot': 'PandaOmron', 'seed': 3, 'initialization_noise.magnitude': 0.02}
    ], ids=['two robots', 'drawn start'])
def test_drawn_starts_and_several_robots_are_repeated(given, session, verify):
    node = session(**given)
    node.thread.next_seed = 11
    node.thread.reset()
    for robot in node.simulation.robots.values():
        node.act(5, robot)
    node.begin()
    for robot in node.simulation.robots.values():
        node.act(20, robot)
    node.thread.next_seed = 12
    node.thread.reset()
    for robot in node.simulation.robots.values():
        node.act(100, robot)
    node.close()
    code, lines = verify()
    assert (code, lines[-1]) == (0, '1 of 1 equal'), lines


def test_planned_faults_and_randomization_are_repeated_without_their_files(
        session, verify, tmp_path):
    files = {'faults': 'faults: [{what: lost_commands, part: arm, from: [0.0, 0.1]},'
                       ' {what: offset_state, part: arm, value: 0.01, until: 0.2}]',
             'randomization': 'joints: {"*": {friction: {uniform: [0.1, 1.0]}}}'}
    for name, content in files.items():
        (tmp_path / f'{name}.yaml').write_text(content)
    node = session(robot='UR5e', seed=4, **{
        name: str(tmp_path / f'{name}.yaml') for name in files})
    node.given = with_contents(node.given)
    for name in files:
        (tmp_path / f'{name}.yaml').unlink()
    node.begin()
    node.act(20)
    node.thread.next_seed = 12
    node.thread.reset()
    node.act(20)
    assert [fault['what'] for fault in node.simulation.faults.summary()] == [
        'lost_commands', 'offset_state']
    assert node.simulation.randomized.drawn
    node.close()
    code, lines = verify()
    assert (code, lines[-1]) == (0, '1 of 1 equal'), lines


BOX = """<mujoco><worldbody><body name="box" pos="0 0 1"><freejoint/>
<geom type="box" size="0.03 0.02 0.01" mass="0.1"/></body></worldbody></mujoco>"""
YAML = '{name: ball, shape: sphere, size: [0.03], mass: 0.2}'


@pytest.mark.full
def test_objects_that_come_and_go_are_repeated(session, verify):
    node = session(robot='UR5e', arena='table')
    turn = [1.0, 0.0, 0.0, 0.0]
    node.act(10)
    node.thread.change('spawn', 'box', BOX, [0.4, 0.1, 1.1], turn)  # While everything moves.
    node.act(10)
    node.begin()
    node.act(10)
    node.thread.change('spawn', 'ball', YAML, [0.4, 0.3, 1.1], turn)
    node.act(10)
    node.thread.change('delete', 'cube')
    node.act(10)
    node.begin()  # As for a new subscriber, with objects of both kinds.
    node.act(10)
    node.thread.change('delete', 'box')
    node.thread.change('spawn_all', [
        [name, YAML, [0.4, y, 1.1], turn] for name, y in (('left', 0.5), ('right', -0.5))])
    node.act(10)
    node.thread.change('despawn')
    assert node.simulation.plan.object_names == []
    node.act(100)
    node.close()
    code, lines = verify()
    assert (code, lines[-1]) == (0, '1 of 1 equal'), lines
    assert lines[0].startswith('150 control periods repeated')


def test_an_object_from_a_file_is_told(session, verify):
    node = session(robot='UR5e', arena='table')
    node.begin()
    item = create_object({'name': 'of_file', 'shape': 'box', 'size': [0.1, 0.1, 0.1], 'mass': 1.0})
    node.thread.change('spawn', 'of_file', None, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0],
                       using=plan_with(node.simulation.plan, item))
    node.step(3)
    node.close()
    assert verify() == (1, [
        "'of_file' was spawned from a file, which the record does not contain, after 0 control "
        'periods, at 0.010000 s', '0 control periods repeated, with 0 changes from outside',
        '0 of 1 equal'])


@pytest.mark.full
@pytest.mark.parametrize('changes', [{'body': 10**7}, {'body': -10**7}, {'site': 10**7}])
def test_frames_of_no_bodies_are_rejected(changes, session, verify, tmp_path):
    node = session(robot='UR5e')
    robot = node.simulation.robot
    node.begin()
    node.thread.submit([robot.parse_cartesian.twist(
        'right', [0.0, 0.0, 0.1], [0.0, 0.0, 0.0], '')])
    node.step(3)
    node.close()

    def turn(value):
        if isinstance(value, list):
            for one in value:
                turn(one)
        elif isinstance(value, dict):
            if 'frame' in value:
                value['frame'] = ['v', 'manip_sim.physics.robot_frames:Frame',
                                  {'name': 'world', 'body': 0, 'site': None, **changes}]
            turn(list(value.values()))
        return value
    code, lines = verify(changed(tmp_path, turn))
    assert code == 1
    assert lines[0].startswith('the journal cannot be repeated: a frame of no body or site')
