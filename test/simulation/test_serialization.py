# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Objects as plain data: the same again, and nothing else from untrusted input."""

from base64 import b64decode
from collections import deque
from dataclasses import replace
import enum
import json
import pickle
import sys
import tracemalloc

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from manip_sim.control.commands import CommandHandle, Status
from manip_sim.errors import ModelError
from manip_sim.models import compose
from manip_sim.models.grippers import PandaGripper
from manip_sim.physics.payload import Payload
from manip_sim.physics.robot_frames import Frame
from manip_sim.simulation import Simulation
from manip_sim.simulation.journal_entries import plain_state, restore_plain
from manip_sim.simulation.serialization import Decoder, Encoder, to_json


def through_json(value):
    """Write a value as JSON, and read it."""
    return Decoder([]).decode(json.loads(to_json(Encoder({}).encode(value))))


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', arena='table'))


VALUES = [
    None, True, 3, -0.0, float('inf'), 1e-320, 2**80, 'ä\ud800', b'\0\xff', (1, (2.0,)), [1, []],
    {'a': {'b': (1,)}}, {}, {3: 'x', 'y': 2, (1, 2): None}, deque([1, (2,)]), {1, 2},
    frozenset({'a'}), Status.DONE, np.float64(0.1), np.int32(7), np.bool_(True),
    Payload(0.3, (0.0, 0.1, 0.2)), Frame('world', 0)]


@pytest.mark.parametrize('value', VALUES, ids=repr)
@pytest.mark.parametrize('again', [
    through_json, lambda value: Decoder([]).decode(Encoder({}).encode(value))],
    ids=['json', 'tree'])
def test_a_value_is_the_same_again(value, again):
    found = again(value)
    assert found == value and type(found) is type(value) and repr(found) == repr(value)


@pytest.mark.parametrize('array', [
    np.arange(6.0).reshape(2, 3), np.array([True, False]), np.zeros((0, 3)),
    np.asfortranarray(np.arange(6).reshape(2, 3)), np.arange(10, dtype=np.int16)[::3],
    np.array(np.nan)])
def test_an_array_is_the_same_again_and_one_of_its_own(array):
    for found in (through_json(array), Decoder([]).decode(Encoder({}).encode(array))):
        np.testing.assert_array_equal(found, array)
        assert found.dtype == array.dtype and found.flags.writeable
        assert not np.shares_memory(found, array)


def test_an_object_that_two_others_have_stays_one():
    handle = CommandHandle(Status.RUNNING)
    first, again, other = through_json([handle, handle, CommandHandle(Status.RUNNING)])
    assert first is again and first is not other and first == handle


def digest(value):
    """Return what a digest is made of."""
    return to_json(Encoder({}, digest=True).encode(value), sort_keys=True)


def test_a_digest_sees_neither_what_became_of_a_command_nor_types_of_numpy():
    assert digest(CommandHandle(Status.DONE)) == digest(CommandHandle(Status.ABORTED, 'reset'))
    assert digest(CommandHandle(Status.DONE)) != digest(CommandHandle(Status.RUNNING))
    assert digest({'a': 1, 'b': np.float64(0.1)}) == digest({'b': 0.1, 'a': 1})
    assert digest({2: 'x', 1: 'y'}) == digest({1: 'y', 2: 'x'}) != digest({1: 'x', 2: 'y'})
    assert digest({0, 8}) == digest({8, 0})
    frame = Frame('world', 0)
    assert digest([frame, frame]) == digest([frame, Frame('world', 0)])


def test_a_digest_leaves_out_what_a_class_says_and_a_state_does_not(simulation):
    state = simulation.save()
    before = simulation.digest()
    simulation.robot.joints.setpoints.counts[:] += 3
    assert simulation.digest() == before
    (command,) = simulation.robot.parse.joint_command(['robot0_joint1'], position=[0.1])
    assert digest(replace(command, robot=None)) == digest(replace(command, robot=None, sent_ns=5))
    assert through_json(replace(command, robot=None, sent_ns=5)).sent_ns == 5
    simulation.restore(state)


def test_a_state_that_was_restored_can_be_restored_again(simulation):
    tree = Encoder({}).encode([np.zeros(3)])
    for _ in range(2):
        (array,) = Decoder([]).decode(tree)
        assert not array.any()
        array += 1.0


@pytest.mark.parametrize('value', [object(), lambda: 0, np.array(['a']), np.array([None]), 1j,
                                   {'a': [print]}, Simulation, ModelError('x')])
def test_a_value_that_cannot_be_read_again_is_rejected_when_it_is_written(value):
    with pytest.raises(ModelError, match='cannot be a part of a state'):
        Encoder({}).encode(value)


DATA = 'manip_sim.control.commands:CommandHandle'
HANDLE = {'status': None, 'reason': '', 'error': None}
ATTACKS = {
    'a class of another package': (['o', 'subprocess:Popen', {}], "no class 'subprocess:Popen'"),
    'a module that is not loaded': (['o', 'manip_sim.control.no:A', {}], 'no class'),
    'what a module has imported': (['o', 'manip_sim.control.commands:Trajectory', {}], 'no class'),
    'a function': (['o', 'manip_sim.control.commands:takes_from', {}], 'no class'),
    'an error': (['o', 'manip_sim.simulation.start_defect:Exception', {}], 'no class'),
    'an enumeration as an object': (['o', 'manip_sim.control.commands:Status', {}], 'no data'),
    'a method': (['o', DATA, {**HANDLE, 'end': 1}], "no attribute 'end'"),
    'a special attribute': (['o', DATA, {**HANDLE, '__class__': 1}], "no attribute '__class__'"),
    'a special attribute that no class has': (
        ['o', DATA, {**HANDLE, '__deepcopy__': 1}], "no attribute '__deepcopy__'"),
    'too few attributes': (['o', DATA, {'status': None}], 'lacks attributes'),
    'a law that is not here': (['w', 'no law'], 'a law that is not here'),
    'a member that is none': (['e', 'manip_sim.control.commands:Status', 'NO'], 'KeyError'),
    'a class as an enumeration': (['e', DATA, 'status'], 'no enumeration'),
    'an enumeration of no module': (['e', 'antigravity:A', 'B'], 'KeyError'),
    'a tuple of too few': (['T', 'manip_sim.control.commands:TrajectoryReference', 1], 'no tuple'),
    'a class as a tuple': (['T', DATA, 1, 2, 3], 'no tuple'),
    'an array of objects': (['a', '|O', [1], 'AAAAAAAAAAA='], 'no numbers'),
    'an array of records': (['a', 'f8,f8', [1], 'AAAAAAAAAAA='], 'no numbers'),
    'an array of long doubles': (['a', '<f16', [1], f'{"A" * 22}=='], 'no numbers'),
    'an array larger than its text': (['a', '<f8', [10**12], 'AAAAAAAAAAA='], 'ValueError'),
    'an array of unknown length': (['a', '<f8', [-1], 'AAAAAAAAAAA='], 'no natural number'),
    'no base64': (['a', '<f8', [1], '?'], 'Error'),
    'a reference to nothing': (['#', 0], 'IndexError'),
    'a reference from behind': (['@', -1], 'no natural number'),
    'a kind that is none': (['?', 1], 'KeyError'), 'a kind that is a list': ([[]], 'TypeError'),
    'no kind': ([], 'IndexError'), 'a key that cannot be one': (['d', [['l'], 1]], 'TypeError')}


@pytest.mark.parametrize('case', ATTACKS)
def test_untrusted_input_is_rejected(case):
    content, message = ATTACKS[case]
    with pytest.raises(ModelError, match=message):
        Decoder([]).decode(content)


def test_deep_and_large_input_takes_neither_the_stack_nor_memory():
    deep = []
    for _ in range(100_000):
        deep = ['l', deep]
    tracemalloc.start()
    with pytest.raises(ModelError, match='RecursionError'):
        Decoder([]).decode(deep)
    with pytest.raises(ModelError, match='ValueError'):
        Decoder([]).decode(['a', '<f8', [2**40, 2**20], ''])
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()


LETTERS = st.sampled_from(['a', '@', '#', 'n', 'e', 'b', 'w', 'T', 'd', 'o', 'v', 'l', 't', 's'])
LEAVES = (st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9) | LETTERS
          | st.sampled_from([DATA, 'manip_sim.physics.payload:Payload', '<f8', '|b1', 'AAAA']))
JSON = st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=4) | st.tuples(
    LETTERS, inner, inner).map(list) | st.dictionaries(st.text(max_size=9), inner, max_size=3))


@given(content=JSON)
@settings(deadline=None)
def test_any_json_is_read_or_rejected_and_nothing_is_imported(content):
    modules = {*sys.modules}
    try:
        value = Decoder([]).decode(content)
    except ModelError:
        value = None
    assert {*sys.modules} == modules
    assert not callable(value)


def places(content, path=()):
    """Yield the paths to all parts of JSON."""
    yield path
    items = content.items() if isinstance(content, dict) else (
        enumerate(content) if isinstance(content, list) else ())
    for key, item in items:
        yield from places(item, (*path, key))


STREAM = 'manip_sim.control.velocity_stream:VelocityStream'
POSE = 'manip_sim.control.cartesian.cartesian_commands:CartesianPose'


def arrays(content):
    """Yield the arrays in JSON, with the name of the attribute and the class that have them."""
    left = [('', '', content)]
    while left:
        name, owner, item = left.pop()
        if isinstance(item, dict):
            left += ((key, owner, value) for key, value in item.items())
        elif isinstance(item, list) and item[:1] == ['a']:
            yield name, owner, item
        elif isinstance(item, list):
            owner = item[1] if item[:1] == ['o'] else owner
            left += ((name, owner, value) for value in item)


@pytest.mark.parametrize('change', ['fewer', 'more', 'bytes'])
@pytest.mark.parametrize('wanted', [
    ('_state', ''), ('_stiffness', ''), ('integrals', ''), ('_state', STREAM), ('_motion', STREAM),
    ('position', POSE), ('rotation', POSE)], ids=' '.join)
def test_arrays_that_compiled_code_reads_have_the_shapes_and_numbers_that_it_expects(
        simulation, wanted, change):
    robot, state = simulation.robot, simulation.save()
    robot.apply(robot.parse_cartesian.twist('right', [0.0, 0.1, 0.0], [0.0, 0.0, 0.0]))
    simulation.advance(5)
    plain = plain_state(simulation)[0]
    robot.apply(robot.parse_cartesian.pose('right', [0.1, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]))
    simulation.advance(5)
    plain = plain_state(simulation)[0] if wanted[1] == POSE else plain
    array = next(item for *place, item in arrays(plain) if tuple(place) == wanted)
    numbers = np.frombuffer(b64decode(array[3]), array[1]).reshape(array[2])
    numbers = {'fewer': numbers[1:], 'more': np.concatenate([numbers, numbers]),
               'bytes': numbers.astype(bool)}[change]
    array[:] = json.loads(to_json(numbers))
    with pytest.raises(ModelError, match='has another shape'):
        restore_plain(simulation, plain)
    simulation.restore(state)


@given(data=st.data())
@settings(deadline=None)
def test_a_journal_with_another_value_anywhere_is_rejected_or_continues_as_it_says(
        simulation, data):
    start = json.dumps(plain_state(simulation)[0])
    content = json.loads(start)
    path = data.draw(st.sampled_from([*places(content)][1:]))
    parent = content
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = data.draw(JSON)
    try:
        restore_plain(simulation, content)
        assert json.dumps(plain_state(simulation)[0]) == json.dumps(content)
    except ModelError as error:
        assert '\n' not in str(error)
    restore_plain(simulation, json.loads(start))


class Mode(enum.Enum):
    """A mode of a gripper of a user."""

    SLOW = 1
    FAST = 2


class CountingGripper(PandaGripper, registered=False):
    """A gripper of a user, whose next action depends on those before."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.memory, self.names, self.mode = np.zeros(3), np.array(['a', 'b']), Mode.SLOW

    def format_action(self, action):
        """Close a little more at each call."""
        self.memory += 0.01
        self.mode = Mode.FAST
        return super().format_action(np.clip(action + self.memory[:1], -1.0, 1.0))


@pytest.mark.parametrize('way', ['here', 'pickled', 'json'])
def test_the_state_of_a_gripper_of_a_user_is_restored(way):
    simulation = Simulation(compose('Panda', gripper=CountingGripper(), arena='table'))
    (gripper,) = [part.gripper for part in simulation.robot.parts.values() if part.gripper]

    def act(action):
        simulation.robot.apply(simulation.robot.parse.action('right/gripper', [action]))
        simulation.advance(30)
    act(-0.5)
    state, plain = simulation.save(), json.dumps(plain_state(simulation)[0])
    before = gripper.memory.copy()
    act(0.3)
    expected = simulation.digest()
    assert gripper.memory[0] > before[0] > 0.0
    gripper.mode = Mode.SLOW
    if way == 'json':
        restore_plain(simulation, json.loads(plain))
    else:
        simulation.restore(state if way == 'here' else pickle.loads(pickle.dumps(state)))
    np.testing.assert_array_equal(gripper.memory, before)
    assert gripper.mode is Mode.FAST
    act(0.3)
    assert simulation.digest() == expected


def test_a_state_with_another_version_of_the_layout_is_rejected(simulation):
    state = replace(simulation.save(), layout_version=1)
    with pytest.raises(ModelError, match='version 1 of the layout of states, .* has version 3'):
        simulation.restore(state)
