# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Saved states: they continue to the last bit, here and in another process."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import replace
import inspect
import json
import operator
from pathlib import Path
import pickle
import subprocess
import sys
import textwrap

from hypothesis import given, settings, strategies as st
import mujoco
import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import DivergenceError, ModelError
from manip_sim.models import compose, create_object
from manip_sim.models.robots import ROBOTS
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation
from manip_sim.simulation.journal_entries import Operations, plain_state, restore_plain
from manip_sim.worlds.worlds import owner_of, SimulationPrototype

NOISE = {'type': 'uniform', 'magnitude': 0.1}
#: What may happen in a run.
SCRIPT = ('stream', 'gripper', 'pose', 'twist', 'trajectory', 'nothing', 'mode')


HERE = Path(__file__).parent
#: Of another process.
GOES_ON = """
from pathlib import Path
import pickle
import sys
sys.path.insert(0, sys.argv[2])
from test_saved_states import compose, NOISE, run, SCRIPT, Simulation
simulation = Simulation(compose('Panda', arena='table', initialization_noise=NOISE, seed=2))
simulation.restore(pickle.loads(Path(sys.argv[1]).read_bytes()))
print(*run(simulation, SCRIPT[:5], begin=5))
"""


def command(simulation, kind, number):
    """Apply a command of a kind, whatever the robot has; the same for the same number."""
    robot = simulation.robot
    part = next(name for name, part in robot.parts.items()
                if part.gripper is None and part.atomic == (name,) and part.actuators)
    arm = next(iter(robot.end_effectors))
    indices = robot.joints.indices_of(part)
    wave = 0.2 * np.sin(0.3 * number + np.arange(len(indices)))
    if kind == 'stream':
        robot.apply(robot.parse.action(part, wave))
    elif kind == 'gripper':
        gripper = f'{arm}/gripper'
        dof = robot.robot_model.grippers[arm].dof
        robot.apply(robot.parse.action(gripper, np.full(dof, np.sign(np.sin(number)))))
    elif kind == 'pose':
        pose = robot.state().end_effectors[arm].pose
        moved = np.add(pose.position, [0.02, 0.03 * np.sin(number), 0.0])
        robot.apply(robot.parse_cartesian.pose(arm, moved, pose.quat_xyzw))
    elif kind == 'twist':
        robot.apply(robot.parse_cartesian.twist(arm, [0.0, 0.1, 0.05], [0.0, 0.0, 0.2]))
    elif kind == 'trajectory' and robot.joints.modes[indices[0]] == 'position':
        here = robot.controller_state(part).reference.position[0]
        robot.apply(robot.parse.trajectory(
            part, [robot.joints.names[indices[0]]], [0.1, 0.3], [[here + 0.02], [here]],
            start_ns=simulation.time_ns + 20_000_000, now_ns=simulation.time_ns))
    elif kind == 'mode':
        mode = ('position', 'velocity', 'effort')[number % 3]
        robot.set_control_mode(part, mode)


def anew(simulation, seed):
    """Reset a simulation with a seed, in position mode."""
    simulation.robot.set_control_mode('arm', 'position')
    simulation.reset(seed=seed)


def run(simulation, kinds, begin=0):
    """Run two control periods for each command, and return the digests."""
    digests = []
    for number, kind in enumerate(kinds, start=begin):
        command(simulation, kind, number)
        for _ in range(2):
            simulation.advance(5)
        digests.append(simulation.digest())
    return digests


@pytest.fixture(scope='module')
def panda():
    return Simulation(compose('Panda', arena='table', initialization_noise=NOISE, seed=1))


@pytest.mark.full
@given(before=st.lists(st.sampled_from(SCRIPT), max_size=8),
       between=st.lists(st.sampled_from(SCRIPT), max_size=5),
       after=st.lists(st.sampled_from(SCRIPT), min_size=2, max_size=8))
@settings(max_examples=15, deadline=None)
def test_a_restored_state_continues_to_the_last_bit(panda, before, between, after):
    anew(panda, 1)
    run(panda, before)
    state, digest = panda.save(), panda.digest()
    sensors = panda.data.sensordata.copy()
    expected = run(panda, after)
    run(panda, between)
    panda.restore(state)
    assert panda.digest() == digest
    np.testing.assert_array_equal(panda.data.sensordata, sensors)
    assert run(panda, after) == expected


@pytest.mark.parametrize('kind', ['stream', 'gripper', 'pose', 'twist', 'trajectory'])
def test_commands_on_their_way_are_the_same_after_restoring(panda, kind):
    anew(panda, 1)
    panda.robot.sensing.set('latency.command', 0.03)
    run(panda, [kind])
    state, journal = panda.save(), json.dumps(plain_state(panda)[0])
    expected = run(panda, [kind] * 3, begin=1)
    panda.restore(state)
    assert run(panda, [kind] * 3, begin=1) == expected
    restore_plain(panda, json.loads(journal))
    assert run(panda, [kind] * 3, begin=1) == expected
    panda.robot.sensing.set('latency.command', 0.0)


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS.names())
def test_every_robot_continues_and_starts_again_to_the_last_bit(name):
    simulation = Simulation(compose(name, arena='table'))
    start = simulation.digest()
    first = run(simulation, SCRIPT[:5])
    state = simulation.save()
    expected = run(simulation, SCRIPT[:6], begin=5)
    simulation.restore(state)
    assert run(simulation, SCRIPT[:6], begin=5) == expected
    simulation.reset()
    assert simulation.digest() == start
    assert run(simulation, SCRIPT[:5]) == first


@pytest.mark.full
def test_a_state_goes_on_in_another_process(panda, tmp_path):
    anew(panda, 3)
    run(panda, SCRIPT[:5])
    (tmp_path / 'state').write_bytes(pickle.dumps(panda.save()))
    expected = run(panda, SCRIPT[:5], begin=5)
    done = subprocess.run([sys.executable, '-c', GOES_ON, tmp_path / 'state', HERE],
                          capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.split() == expected, done.stderr


def test_efforts_after_a_restored_state_are_those_of_before(panda):
    robot, names = panda.robot, panda.robot.joint_names[:7]

    def move():
        efforts = []
        for number in range(6):
            robot.apply(*robot.parse.joint_command(
                names, position=[0.05 * number, *robot.measured('arm')[1:7]]))
            panda.advance(5)
            efforts.append(robot.state().effort)
        return efforts
    move()
    state = panda.save()
    first = move()
    panda.restore(state)
    np.testing.assert_array_equal(move(), first)


def test_a_seed_gives_the_same_episode_after_any_other(panda):
    anew(panda, 7)
    first = run(panda, SCRIPT)
    anew(panda, 8)
    other = run(panda, SCRIPT[::-1])
    panda.robot.emergency_stop()
    assert panda.robot.reflexes.counts == {'arm': 1}
    anew(panda, 7)
    assert run(panda, SCRIPT) == first
    fresh = Simulation(compose('Panda', arena='table', initialization_noise=NOISE, seed=7))
    assert run(fresh, SCRIPT) == first
    assert not set(first) & set(other)


def test_a_reset_after_restoring_leads_to_the_start_of_the_state(panda):
    anew(panda, 7)
    state, start = panda.save(), panda.digest()
    anew(panda, 8)
    panda.restore(state)
    panda.reset()
    assert panda.digest() == start


def test_reading_does_not_change_the_digest(panda):
    anew(panda, 7)
    run(panda, SCRIPT[:4])
    before = panda.digest()
    panda.robot.state()
    panda.robot.measured()
    panda.robot.controller_state('arm')
    panda.robot.dynamics()
    panda.save()
    assert panda.digest() == before


def test_the_digest_says_which_release_of_mujoco_it_belongs_to(panda):
    assert panda.digest().startswith(f'mujoco-{mujoco.mj_versionString()}:')


@pytest.mark.parametrize('change', [
    lambda s: s.data.qpos.__setitem__(0, s.data.qpos[0] + 1e-15),
    lambda s: s.robot.set_control_mode('arm', 'velocity'),
    lambda s: s.robot.set_wrench_cutoff('right', 5.0),
    lambda s: s.robot.apply(*s.robot.parse.joint_command(['robot0_joint1'], position=[0.1])),
    lambda s: s.robot.set_command_timeout('arm', 0.7)])
def test_the_digest_sees_what_the_future_depends_on(change):
    simulation = Simulation(compose('Panda', arena='table'))
    before = simulation.digest()
    change(simulation)
    assert simulation.digest() != before


def test_handles_of_before_are_aborted_and_time_is_restored(panda):
    anew(panda, 1)
    state, time_ns = panda.save(), panda.time_ns
    (command,) = panda.robot.parse.joint_command(['robot0_joint1'], position=[0.3])
    panda.robot.apply(command)
    panda.advance(5)
    panda.restore(state)
    assert command.handle.status is Status.ABORTED and 'restored' in command.handle.reason
    assert panda.time_ns == time_ns
    panda.advance(5)
    assert panda.robot.controller_state('arm').reference.velocity[0] == 0.0


def test_a_state_of_another_world_is_refused_and_changes_nothing(panda):
    other = Simulation(compose('Panda', arena='table', cube=False))
    before = panda.digest()
    with pytest.raises(ModelError, match='another world'):
        panda.restore(other.save())
    assert panda.digest() == before


def test_a_state_of_another_version_is_refused(panda):
    state = replace(panda.save(), versions='manip_sim 9 with MuJoCo 3.9.0')
    with pytest.raises(ModelError, match='saved by manip_sim 9'):
        panda.restore(state)


def test_a_diverged_simulation_is_restored():
    simulation = Simulation(compose('Panda', arena='table'))
    state, digest = simulation.save(), simulation.digest()
    simulation.data.qvel[0] = 1e9
    with pytest.raises(DivergenceError):
        simulation.advance(5)
    simulation.restore(state)
    assert simulation.diverged is None and simulation.digest() == digest
    simulation.advance(5)


@pytest.mark.parametrize('seed', [-1, 1.5, True, 'one'])
def test_a_seed_is_a_whole_number_from_zero_with_noise_or_without(panda, seed):
    for simulation in (panda, Simulation(compose('Panda'))):
        before = simulation.digest()
        with pytest.raises(ModelError, match='seed'):
            simulation.reset(seed=seed)
        assert simulation.digest() == before


def test_what_follows_from_data_changed_by_hand_is_saved_after_forward(panda):
    data = panda.data
    data.qpos[0] += 0.3
    panda.forward()
    place, state = data.site('gripper0_right_grip_site').xpos.copy(), panda.save()
    panda.reset()
    panda.restore(state)
    np.testing.assert_array_equal(data.site('gripper0_right_grip_site').xpos, place)


def test_states_are_restored_after_objects_came_and_went_during_a_command():
    simulation = Simulation(compose('Panda', arena='table'))
    ball = {'name': 'ball', 'shape': 'sphere', 'size': 0.1, 'position': [0.0, 0.5, 1.0]}

    def spawn():
        simulation.change_objects(plan_with(simulation.plan, create_object(ball)))

    def delete():
        simulation.change_objects(plan_without(simulation.plan, 'ball'))

    def move():
        robot = simulation.robot
        robot.apply(robot.parse.action('arm', [0.2] * 7), period_s=0.01)
        simulation.advance(5)

    spawn()
    still, at_rest = simulation.save(), simulation.digest()
    delete()
    move()
    spawn()
    moving, digest = simulation.save(), simulation.digest()
    move()
    after = simulation.digest()
    # What they refer to is in the same places, as streams of commands are no such places.
    for state, expected in ((still, at_rest), (moving, digest)):
        simulation.restore(state)
        assert simulation.digest() == expected
    move()
    assert simulation.digest() == after
    simulation.reset()
    delete()
    spawn()
    simulation.restore(moving)
    assert simulation.digest() == digest
    simulation.restore(still)
    assert simulation.digest() == at_rest


@pytest.mark.full
@pytest.mark.parametrize('name', ['Panda', 'PandaOmron', 'GR1'])
def test_what_commands_bring_along_is_no_fixed_place_of_states(name):
    simulation = Simulation(compose(name, arena='table'))
    robot, ball = simulation.robot, {'name': 'ball', 'shape': 'sphere', 'size': 0.1,
                                     'position': [0.0, 0.5, 3.0]}
    layout = simulation.states.control.layout

    def check():
        simulation.advance(5)
        simulation.change_objects(plan_with(simulation.plan, create_object(ball)))
        simulation.change_objects(plan_without(simulation.plan, 'ball'))
        assert simulation.states.control.layout == layout

    for number in range(6):
        for part in robot.parts.values():
            if part.actuators and part.atomic == (part.name,) and part.gripper is None:
                robot.apply(robot.parse.action(part.name, [0.1 * number] * len(part.actuators)))
        check()
    for arm in robot.joints.cartesian.settings:
        for number in range(3):
            robot.apply(robot.parse_cartesian.twist(
                arm, [0.0, 0.0, 0.01 * number], [0.0, 0.0, 0.0], ''))
            check()
        for number in range(3):
            robot.apply(robot.parse_cartesian.pose(
                arm, [0.5, 0.01 * number, 1.0], [0.0, 1.0, 0.0, 0.0], ''))
            check()
        for _ in range(3):
            robot.apply(robot.parse_cartesian.action(arm, [0.1] * 6))
            check()
    if robot.joints.twist_indices is not None:
        for number in range(4):
            robot.apply(robot.parse.twist(0.1 * number, 0.0, 0.0))
            check()


def test_settings_of_streams_leave_nothing_behind_that_a_reset_would_undo():
    simulation = Simulation(compose('Panda'))
    simulation.robot.set_stream('arm', longest_s=0.2, hold_s=0.1)
    before = simulation.digest()
    simulation.reset()
    assert simulation.digest() == before


#: Operations that change settings, each to another value than it has.
SETTINGS = [
    *(('cartesian', 'robot0', 'right', name, value) for name, value in (
        ('stiffness', 99.0), ('damping_ratio', 0.7), ('linear_velocity', 0.4),
        ('angular_velocity', 0.5), ('twist_timeout', 1.0), ('cartesian_damping', [0.5] * 6))),
    *(('reflex', 'robot0', 'arm', name, 0.7) for name in (
        'velocity', 'effort', 'force', 'torque', 'discontinuity', 'collision')),
    ('timeout', 'robot0', 'arm', 0.7, True), ('timeout', 'robot0', 'arm', 0.7, False),
    ('stream_interval', 'robot0', 'arm', 0.3), ('stream_hold', 'robot0', 'arm', 0.3),
    ('payload', 'robot0', 'right', 'mass', 0.7), ('integral_gain', 'robot0', 'arm', 3.0),
    ('set_payload', 'robot0', 'right', 0.7, [0.0, 0.0, 0.1], [0.1, 0.0, 0.0, 0.1, 0.0, 0.1]),
    ('wrench_cutoff', 'robot0', 'right', 5.0), ('mode', 'robot0', 'arm', 'velocity'),
    ('sensing', 'robot0', 'noise.wrench_bias', 0.01),
    ('sensing', 'robot0', 'latency.command', 0.02)]


@pytest.fixture(scope='module')
def nothing_was_read():
    """Return a function that copies a simulation of which no digest was ever read."""
    template = SimulationPrototype(Simulation(compose('Panda', arena='table')))
    return template.copy


#: That of a Panda.
POSTURE = 'cartesian', 'robot0', 'right', 'null_space_posture', '[0, 0.3, 0, -2, 0, 2, 0]'


@pytest.mark.parametrize('setting', [*SETTINGS, POSTURE], ids=(
    lambda setting: ' '.join(map(str, setting[2:]))))
def test_every_setting_is_a_part_of_digests_saved_states_and_journals(setting, nothing_was_read):
    first, later = nothing_was_read(), nothing_was_read()
    before = later.digest()
    for simulation in (first, later):
        Operations(simulation, 5).run(*setting)
    assert first.digest() == later.digest() != before
    saved, journal = pickle.loads(pickle.dumps(first.save())), json.dumps(plain_state(first)[0])
    elsewhere, repeated = nothing_was_read(), nothing_was_read()
    elsewhere.restore(saved)
    restore_plain(repeated, json.loads(journal))
    # In an index that is new, what was replaced is what the index refers to.
    for simulation in (elsewhere, repeated):
        simulation.states.sync_robots()
        assert simulation.digest() == first.digest()


@pytest.mark.parametrize('name', ['Panda', 'PandaOmron', 'Baxter'])
def test_attributes_that_no_class_declares_as_its_state_stay_as_they_are(name):
    simulation = Simulation(compose(name, arena='table'))
    operations, own = Operations(simulation, 5), simulation.robot.name
    fixed, before = [*simulation.states.control.fixed], undeclared(simulation.robot)

    def check():
        simulation.advance(5)
        now = undeclared(simulation.robot)
        assert [key for key in now if now[key] != before.get(key)] == [] and len(now) > 150
    for number, kind in enumerate(SCRIPT * 2):
        command(simulation, kind, number)
        check()
    for operation, _, *rest in SETTINGS:
        operations.run(operation, own, *rest)
        check()
    operations.run('tare')
    check()
    operations.run('reset', 3, False)
    simulation.states.sync_robots()
    check()
    assert all(map(operator.is_, simulation.states.control.fixed, fixed))


def test_attributes_that_methods_set_are_declared_as_a_state():
    simulation = Simulation(compose('Baxter', arena='table'))
    owners = simulation.states.control._owners
    kinds = {kind for owner in owners for kind in type(owner).__mro__
             if kind.__module__.startswith('manip_sim.')}
    assert len(kinds) > 20
    for kind in kinds:
        # Places in another model are found again, the model has them.
        methods = [each for name, each in vars(kind).items() if inspect.isfunction(each)
                   and not name.startswith(('__', '_find'))]
        declared = {name for owner in owners if isinstance(owner, kind)
                    for name in owner.remembered}
        set_here = {name for method in methods for name in attributes_set_by(method)
                    if not isinstance(getattr(kind, name, None), property)}
        assert set_here <= declared | {*FOLLOWS.get(kind.__name__, ())}, kind


def attributes_set_by(method):
    """Return the attributes of its object that the source of a method sets or sets a part of."""
    (function,) = ast.parse(textwrap.dedent(inspect.getsource(method))).body
    found = set()
    for node in ast.walk(function):
        left = (node.targets if isinstance(node, ast.Assign) else
                [node.target] if isinstance(node, (ast.AugAssign, ast.AnnAssign)) else [])
        while left:
            target = left.pop()
            if isinstance(target, (ast.Tuple, ast.List)):
                left += target.elts
            elif isinstance(target, (ast.Subscript, ast.Starred)):
                left.append(target.value)
            elif (isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name)
                  and target.value.id == 'self'):
                found.add(target.attr)
    return found


def undeclared(robot):
    """Return what objects of control have besides their state, by object and attribute."""
    found, left, seen = {}, [robot], set()
    while left:
        owner = left.pop()
        if id(owner) in seen:
            continue
        seen.add(id(owner))
        kind = type(owner)
        if isinstance(owner, Mapping):
            left += owner.values()
        elif isinstance(owner, (list, tuple)):
            left += owner
        elif (kind.__module__.startswith(('manip_sim.control.', 'manip_sim.simulation.'))
              or hasattr(kind, 'remembered')) and hasattr(owner, '__dict__'):
            for name, value in vars(owner).items():
                if name not in getattr(kind, 'remembered', ()):
                    left.append(value)
                    if name not in FOLLOWS.get(kind.__name__, ()):
                        found[kind.__name__, id(owner), name] = plain(value)
    return found


#: Attributes that follow from the rest.
FOLLOWS = {'ActuatorEfforts': ('rules',), 'Formatter': ('_closing',), 'Servos': ('lowered',),
           'Derived': ('of',)}


def plain(value):
    """Return numbers and texts of a value; other objects by their identity."""
    if isinstance(value, np.ndarray):
        view = type(owner_of(value).base).__name__ == 'PyCapsule'
        return id(value) if view else (value.dtype.str, value.tobytes())
    if isinstance(value, Mapping):
        return [(key, plain(item)) for key, item in value.items()]
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value if isinstance(value, (bool, int, float, str)) else id(value)


def test_a_restored_state_starts_again_from_its_own_keyframe(tmp_path):
    file = tmp_path / 'arm.xml'
    file.write_text("""<mujoco><worldbody><body name="link"><joint name="j" range="-1 1"/>
        <geom size="0.1" mass="1"/></body></worldbody><actuator><position joint="j" kp="10"/>
        </actuator><keyframe><key name="low" qpos="-0.5"/><key name="high" qpos="0.5"/></keyframe>
        </mujoco>""")
    simulation = Simulation(compose(str(file)))
    operations = Operations(simulation, 5)
    operations.run('keyframe', 'low')
    saved = simulation.save()
    operations.run('keyframe', 'high')
    simulation.reset()
    assert simulation.data.qpos[0] == 0.5
    simulation.restore(saved)
    assert simulation.episode_start.keyframe == 'low'
    simulation.reset()
    assert simulation.data.qpos[0] == -0.5
