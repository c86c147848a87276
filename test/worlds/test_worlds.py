# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Worlds: each one is, to the last bit, the simulation of the same seeds and commands."""

from __future__ import annotations

import contextlib
import math
import pickle
import threading

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from robot_kinds import KINDS as ROBOT_KINDS

from manip_sim.control.command_parser import CartesianParser, CommandParser
from manip_sim.control.commands import Status
from manip_sim.control.law import period as law_of_periods
from manip_sim.control.modes import MODES as CONTROL_MODES
from manip_sim.errors import (
    CommandError, DivergenceError, ManipSimError, ModelError, SimulationEnded, UnknownNameError)
from manip_sim.laws import law, LAWS
from manip_sim.models import compose
from manip_sim.models.arenas import create_arena
from manip_sim.models.grippers import PandaGripper, WipingGripper
from manip_sim.models.object_creation import create_object
from manip_sim.models.world import compose_robot, DEFAULT, World
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation
from manip_sim.worlds import commands, Worlds
from manip_sim.worlds.worlds import PhysicsThreads

NOISE = {'type': 'uniform', 'magnitude': 0.05}
COUNT = 3
KINDS = ('stream', 'some', 'goals', 'gripper', 'pose', 'twist', 'osc', 'trajectory', 'nothing')
MODES = ('position', 'velocity', 'effort', 'law:pulled')


@law(parameters={'stiffness': 300.0, 'damping': 35.0}, memory=1)
def pulled(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    memory[0] += 1.0
    for i in range(len(q)):
        effort[i] = bias[i]
        for j in range(len(q)):
            effort[i] += mass[i, j] * (setpoint[j, 2] + parameters[0] * (setpoint[j, 0] - q[j])
                                       + parameters[1] * (setpoint[j, 1] - v[j]))
        for k in range(3):
            effort[i] += 0.1 * jacobian[k, i] * wrench[k]


@pytest.fixture(scope='module', autouse=True)
def mode_of_the_law():
    """Let the law be a mode, while these tests run."""
    before = dict(LAWS._laws)
    LAWS.add(pulled)
    yield
    LAWS._laws = before


class Pair:
    """Worlds, and a simulation for each of them, which get the same commands."""

    def __init__(self, name='Panda', count=COUNT, threads=2, gripper=lambda: DEFAULT, **options):
        options = {'arena': 'table', 'initialization_noise': NOISE, 'seed': 1, **options}
        self.worlds = Worlds(compose(name, gripper(), **options), count, threads)
        self.simulations = [
            Simulation(compose(name, gripper(), **options)) for _ in range(count)]
        robot = self.simulations[0].robot
        self.part = next(name for name, part in robot.parts.items()
                         if part.gripper is None and part.atomic == (name,) and part.actuators)
        self.arm = next(iter(robot.end_effectors))

    def reset(self, seeds, where=None):
        self.worlds.reset(seeds, where)
        for simulation, seed, _ in self._of(where, seeds):
            simulation.reset(seed)

    def set_mode(self, mode, where=None):
        self.worlds.robot.set_control_mode(self.part, mode, where)
        for simulation, _, _ in self._of(where):
            simulation.robot.set_control_mode(self.part, mode)

    def _of(self, where=None, values=None):
        """Yield the simulations of a mask, with their value and their number."""
        for world, simulation in enumerate(self.simulations):
            if where is None or where[world]:
                yield simulation, None if values is None else values[world], world

    def advance(self, steps=5):
        self.worlds.advance(steps)
        for simulation in self.simulations:
            if simulation.diverged is None:
                with contextlib.suppress(DivergenceError):
                    simulation.advance(steps)

    def command(self, kind, number, where=None):
        """Apply a command of a kind, other numbers in each world, the same in both."""
        robot, one = self.worlds.robot, self.simulations[0].robot
        indices = one.joints.indices_of(self.part)
        names = [one.joints.names[i] for i in indices]
        worlds = np.arange(len(self.simulations))[:, None]
        wave = 0.3 * np.sin(0.4 * number + worlds + np.arange(len(indices)))
        six = np.sin(number + worlds * 2.0 + np.arange(6))
        if kind in ('some', 'goals') and len({
                simulation.robot.joints.modes for simulation in self.simulations}) > 1:
            return  # They take other fields.
        if kind == 'stream':
            self._both('action', (self.part, wave), where)
        elif kind == 'some':
            field = one.command_interfaces()[names[-1]]
            goals = wave[:, -1:] + robot.measured(self.part)[:, len(indices) - 1][:, None]
            self._both('joint_command', (names[-1:],), where, **{field: goals})
        elif kind == 'goals':
            field = one.command_interfaces()[names[0]]
            goals = 0.2 * wave + robot.measured(self.part)[:, :len(indices)]
            for lead in (0.0, 0.01):
                self._both('joint_command', (names,), where, **{field: goals + lead})
                self.advance()
        elif kind == 'gripper':
            dof = one.robot_model.grippers[self.arm].dof
            self._both('action', (f'{self.arm}/gripper', np.sign(six[:, :1]) * np.ones(dof)),
                       where)
        elif kind == 'pose':
            pose = robot.state().end_effectors[self.arm].pose
            self._both('pose', (self.arm, pose.position + 0.03 * six[:, :3], pose.quat_xyzw),
                       where, cartesian=True)
        elif kind == 'twist':
            self._both('twist', (self.arm, 0.1 * six[:, :3], 0.2 * six[:, 3:]), where,
                       cartesian=True)
        elif kind == 'osc':
            self._both('action', (self.arm, six), where, cartesian=True)
        elif kind == 'trajectory' and all(
                CONTROL_MODES[simulation.robot.joints.modes[indices[0]]].follows_trajectories
                for simulation in self.simulations):
            here = robot.measured(self.part)[:, :1]
            goals = np.stack([here + 0.02 * six[:, :1], here], axis=1)
            self._both('trajectory', (self.part, names[:1], [0.1, 0.3], goals), where)

    def _both(self, method, arguments, where, cartesian=False, **fields):
        kind = 'command_cartesian' if cartesian else 'command'
        getattr(getattr(self.worlds.robot, kind), method)(*arguments, **fields, where=where)
        for simulation, _, world in self._of(where):
            robot = simulation.robot
            parser = robot.parse_cartesian if cartesian else robot.parse
            made = getattr(parser, method)(
                *(value[world] if isinstance(value, np.ndarray) else value
                  for value in arguments),
                **{name: value[world] for name, value in fields.items()})
            robot.apply(*(made if isinstance(made, list) else [made]))

    def check_equal(self):
        """Compare all that the future depends on, and all that is read, bit by bit."""
        assert self.worlds.digest() == [simulation.digest() for simulation in self.simulations]
        states = self.worlds.robot.state()
        for simulation, _, world in self._of():
            state = simulation.robot.state()
            assert states.time_ns[world] == state.time_ns
            for of in ('position', 'velocity', 'effort'):
                np.testing.assert_array_equal(getattr(states, of)[world], getattr(state, of))
            for arm, own in state.end_effectors.items():
                for what in ('pose', 'twist', 'wrench', 'external_wrench'):
                    ours, theirs = vars(getattr(states.end_effectors[arm], what)), vars(
                        getattr(own, what))
                    for of, values in theirs.items():
                        np.testing.assert_array_equal(ours[of][world], values)


@pytest.fixture
def pair():
    pair = Pair()
    yield pair
    pair.worlds.close()


@pytest.fixture(scope='module')
def lasting_pair():
    pair = Pair()
    yield pair
    pair.worlds.close()


def start(pair, mode='position', seeds=(4, 5, 6)):
    pair.set_mode(mode)
    pair.reset(np.array(seeds))
    return pair


MASK = st.sampled_from([None, np.array([True, False, True]), np.array([False, True, False])])


@pytest.mark.full
@given(mode=st.sampled_from(MODES), events=st.lists(st.tuples(
    st.sampled_from((*KINDS, 'reset', 'mode')), MASK), min_size=3, max_size=10))
@settings(max_examples=15)
def test_each_world_is_a_simulation_with_the_same_seed_and_commands(lasting_pair, mode, events):
    pair = start(lasting_pair, mode)
    for number, (kind, where) in enumerate(events):
        if kind == 'reset':
            pair.reset(np.array([7, 8, 9]) + number, where)
        elif kind == 'mode':
            pair.set_mode(MODES[number % len(MODES)], where)
        else:
            pair.command(kind, number, where)
        for _ in range(2):
            pair.advance()
    pair.check_equal()


@pytest.mark.full
@pytest.mark.parametrize('count, threads', [(1, 1), (2, 3), (6, 2), (2, 10**9)])
def test_any_number_of_worlds_and_threads_makes_the_same_digests(count, threads):
    pair = Pair(count=count, threads=threads)
    masks = st.none() | st.lists(st.booleans(), min_size=count, max_size=count).map(np.array)

    @given(mode=st.sampled_from(MODES), seed=st.integers(0, 2**40), events=st.lists(st.tuples(
        st.sampled_from((*KINDS, 'stream', 'reset', 'restore')), masks, st.integers(1, 12)),
        min_size=4, max_size=10))
    @settings(max_examples=8, deadline=None)
    def hold(mode, seed, events):
        pair.set_mode(mode)
        pair.reset(seed + np.arange(count))
        saved = pair.worlds.save()
        for number, (kind, where, steps) in enumerate(events):
            if kind == 'reset':
                pair.reset(seed + 7 * np.arange(count) + number, where)
            elif kind == 'restore':
                pair.worlds.restore(saved)
                for simulation, state in zip(pair.simulations, saved):
                    simulation.restore(state)
            else:
                pair.command(kind, number, where)
            pair.advance(steps)
            if number == 2:
                saved = pair.worlds.save()
        pair.check_equal()
    hold()
    pair.worlds.close()


ANYTHING = st.one_of(
    st.none(), st.floats(), st.integers(), st.text(max_size=3), st.lists(st.floats(), max_size=4),
    st.sampled_from([np.zeros((3, 7)), np.full((3, 7), np.nan), np.zeros((7, 3)), np.zeros(3),
                     np.zeros((3, 6), dtype=complex), np.array([[1, 'a']]), [[0.0], [0.0, 1.0]],
                     np.zeros((3, 7), dtype=object), np.full((3, 6), 1e300), np.zeros((3, 0)),
                     np.zeros((3, 2, 7)), np.zeros((3, 6)), {}, [None] * 3]))
WHERE = st.sampled_from([None, True, 'all', [True, False, True], [1, 0, 1], [[True] * 3],
                         np.zeros(3, dtype=bool), [], [0.0] * 3])
NAMES = st.sampled_from([['robot0_joint1'], ['robot0_joint1'] * 2, [], ['joint'], 'robot0_joint1',
                         [f'robot0_joint{n}' for n in range(1, 8)]])


def test_worlds_take_whatever_parsers_make():
    def methods(kind):
        return {name for name in dir(kind) if not name.startswith('_')} - {'rebind'}
    assert methods(CommandParser) == methods(commands.Commands)
    assert methods(CartesianParser) == methods(commands.CartesianCommands)


def test_impedances_of_worlds_are_those_of_simulations(pair):
    start(pair, 'impedance')
    pair._both('joint_impedance', (['robot0_joint1', 'robot0_joint2'],), [True, False, True],
               position=np.array([[0.2, math.nan], [math.nan, 0.3], [0.1, 0.4]]),
               effort=np.array([[1.0, 0.0]] * 3), stiffness=np.array([100.0, 200.0, 300.0]),
               damping=np.array([[20.0, math.nan]] * 3))
    with pytest.raises(CommandError, match='world 1: joint_impedance: stiffness of joint'):
        pair.worlds.robot.command.joint_impedance(['robot0_joint1'], stiffness=[1.0, 0.0, 1.0])
    pair.advance(50)
    pair.check_equal()


@pytest.mark.full
@given(what=st.sampled_from(['action', 'joints', 'trajectory', 'twist', 'pose', 'arm_twist', 'osc',
                             'reset', 'restore', 'mode']),
       one=ANYTHING, other=ANYTHING, where=WHERE, names=NAMES)
@settings(max_examples=150, deadline=None)
def test_whatever_is_given_is_taken_or_rejected_with_a_reason(
        lasting_pair, what, one, other, where, names):
    worlds, robot = start(lasting_pair).worlds, lasting_pair.worlds.robot
    command, cartesian = robot.command, robot.command_cartesian
    before = worlds.digest()
    try:
        {'action': lambda: command.action('arm', one, where=where),
         'joints': lambda: command.joint_command(names, position=one, where=where),
         'trajectory': lambda: command.trajectory('arm', names, other, one, where=where),
         'twist': lambda: command.twist(one, where=where),
         'pose': lambda: cartesian.pose('right', one, other, where=where),
         'arm_twist': lambda: cartesian.twist('right', one, other, where=where),
         'osc': lambda: cartesian.action('right', one, where=where),
         'reset': lambda: worlds.reset(one, where),
         'restore': lambda: worlds.restore(one, where),
         'mode': lambda: robot.set_control_mode('arm', one, where)}[what]()
    except ManipSimError as error:
        assert str(error)
        assert worlds.digest() == before
    for _ in range(2):
        worlds.advance(3)
    assert not worlds.diverged.any()


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOT_KINDS)
def test_worlds_of_robots_of_each_kind_are_simulations(name):
    pair = Pair(name, initialization_noise=None)
    for number, kind in enumerate(KINDS[:6]):
        pair.command(kind, number)
        pair.command('gripper', number)
        pair.advance(10)
    pair.check_equal()
    pair.worlds.close()


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity'])
def test_joints_that_arrive_stop_at_ends_or_are_held_back_do_so_in_each_world(pair, mode):
    start(pair, mode)
    names = pair.simulations[0].robot.joint_names[:7]
    # A stream that ends, far beyond the range in one world, and with one joint that is pushed.
    for number in range(12):
        goals = np.array([0.02, 0.6, -0.02])[:, None] * number * np.ones(7)
        pair._both('joint_command', (names,), None, **{mode: goals})
        for world in (pair.worlds.simulations[2], pair.simulations[2]):
            world.data.qfrc_applied[3] = 200.0 if 4 < number < 9 else 0.0
        pair.advance()
    pair.check_equal()
    pair._both('joint_command', (names[:3],), np.array([True, False, True]),
               **{mode: np.zeros((3, 3))})
    for _ in range(150):
        pair.advance(7)
    pair.check_equal()
    moving = [simulation.robot.joints.moving for simulation in pair.simulations]
    assert mode == 'velocity' or not all(moving)


@pytest.mark.full
def test_joints_too_fast_for_the_rest_of_their_ranges_slow_down_alike_in_each_world(pair):
    start(pair, 'position')
    names = pair.simulations[0].robot.joint_names[:7]
    joints = pair.simulations[0].robot.joints
    highest = joints.clamps(np.arange(7))[:, 1]
    ends = np.array([0.0, 0.3, 0.0])[:, None] + np.where(np.arange(7) == 3, highest, 0.0)
    speeds = np.where(np.arange(7) == 3, 2.1, 0.0) * np.ones((3, 1))
    pair._both('trajectory', ('arm', names, [2.0], ends[:, None], speeds[:, None]), None)
    while joints.setpoints.position[3] < highest[3] - 0.05:
        pair.advance(5)
    assert joints.setpoints.velocity[3] > 2.0  # With its limit it would take 0.17 rad to stop.
    braking = []
    for _ in range(20):
        goals = pair.worlds.robot.measured('arm')[:, :7] + np.where(np.arange(7) == 3, -1, 0.01)
        pair._both('joint_command', (names,), None, position=goals)
        pair.advance(5)
        braking.append(joints.setpoints.acceleration[3] / joints.servos.acceleration_limit[3])
        pair.check_equal()
    assert min(braking) < -2.0


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity'])
def test_streams_whose_messages_are_late_or_lost_are_the_same_in_each_world(pair, mode):
    start(pair, mode)
    names = pair.simulations[0].robot.joint_names[:7]
    draw = np.random.default_rng(5)
    for steps in [5] * 6 + draw.choice([3, 5, 5, 6, 11], 24).tolist():
        time_s = pair.worlds.time_ns[0] * 1e-9
        goals = np.array([0.1, 0.3, 2.0])[:, None] * np.sin((1.0 + np.arange(7)) * time_s)
        pair._both('joint_command', (names,), None, **{mode: goals})
        pair.advance(steps)
    pair.check_equal()


@pytest.mark.full
def test_a_stream_whose_goals_are_off_at_random_is_averaged_in_its_own_world_alone(pair):
    start(pair, 'position')
    names = pair.simulations[0].robot.joint_names[:7]
    draw = np.random.default_rng(5)
    # One message is lost; the goals of one world are rough after it.
    for steps in [5] * 12 + [10] + [5] * 40:
        time_s = pair.worlds.time_ns[0] * 1e-9
        goals = np.array([0.1, 0.3, 0.2])[:, None] * np.sin((1.0 + np.arange(7)) * time_s)
        goals[1] += draw.normal(0.0, 1e-3, 7)
        pair._both('joint_command', (names,), None, position=goals)
        pair.advance(steps)
    pair.check_equal()
    joints = [of.robot.joints.setpoints.joints[0] for of in pair.simulations]
    assert [of['memory'] > 0.01 for of in joints] == [False, True, False]


def _take_a_joint(robot):
    field = robot.command_interfaces()[robot.joint_names[2]]
    robot.apply(*robot.parse.joint_command(robot.joint_names[2:3], **{field: [0.1]}))


def _wait_for_a_trajectory(robot):
    begin_ns = robot._clock.time_ns + 15_000_000
    robot.apply(robot.parse.trajectory(
        'arm', robot.joint_names[:2], [0.05], [[0.0, 0.3]], start_ns=begin_ns))


def _withdraw(robot):
    (command,) = robot.joints.commands.running
    robot.withdraw(command, 'no longer')


def _switch(robot):
    before = robot.joints.modes[0]
    for mode in ('effort', before):
        robot.set_control_mode('arm', mode)


def _trip(robot):
    robot.set_reflex('arm', 'velocity', 1e-6)


def _delay(robot):
    robot.sensing.set('latency.command', 0.013)


@pytest.mark.parametrize('mode', ['position', 'velocity'])
@pytest.mark.parametrize('change', [
    _take_a_joint, _wait_for_a_trajectory, _withdraw, _switch, _trip, _delay,
    lambda robot: robot.set_command_timeout('arm', 0.005)])
def test_streams_go_on_in_worlds_in_which_nothing_has_changed(pair, mode, change, monkeypatch):
    start(pair, mode)
    names, renewed = pair.simulations[0].robot.joint_names[:7], []
    renew = law_of_periods.renew
    start_at = pair.worlds.robot.state().position[:, :7] if mode == 'position' else 0.0
    monkeypatch.setattr(law_of_periods, 'renew', lambda table, robots, worlds, *rest: (
        renewed.append(len(worlds)), renew(table, robots, worlds, *rest)))
    for period in range(12):
        if period == 5 and (mode == 'position' or change is not _wait_for_a_trajectory):
            for simulation in (pair.worlds.simulations[1], pair.simulations[1]):
                change(simulation.robot)
        goals = start_at + np.array([0.1, 0.3, 0.2])[:, None] * np.sin(
            0.02 * period * (1.0 + np.arange(7)))
        pair._both('joint_command', (names,), None, **{mode: goals})
        pair.advance()
        if period % 4 == 3:  # Whoever looks interrupts them.
            pair.check_equal()
    assert max(renewed) == 3


@pytest.mark.parametrize('again', ['reset', 'restore'])
def test_a_stream_begins_anew_after_a_reset_and_a_restored_state(pair, again):
    start(pair)
    names, goals = pair.simulations[0].robot.joint_names[:7], np.zeros((COUNT, 7))
    saved = pair.worlds.save()
    for period in range(8):
        if period == 4 and again == 'reset':
            pair.reset(np.array([4, 5, 6]), np.array([True, False, True]))
        elif period == 4:
            pair.worlds.restore(saved)
            for simulation, state in zip(pair.simulations, saved):
                simulation.restore(state)
        goals += 0.01
        pair._both('joint_command', (names,), None, position=goals)
        pair.check_equal()
        pair.advance()
        pair.check_equal()


def test_a_command_that_came_from_elsewhere_ends_when_a_stream_takes_its_joints(pair):
    start(pair)
    robot, names = pair.worlds.simulations[0].robot, pair.simulations[0].robot.joint_names[:7]
    goals = pair.worlds.robot.state().position[:, :7]
    pair.worlds.robot.command.joint_command(names, position=goals + 0.1)
    pair.worlds.advance(5)
    (command,) = robot.parse.joint_command(names, position=goals[0])
    robot.apply(command)
    pair.worlds.advance(5)
    pair.worlds.robot.command.joint_command(names, position=goals + 0.05)
    assert command.handle.status is Status.REPLACED
    np.testing.assert_array_equal(command.values, goals[0])


def test_goals_for_joints_that_are_not_side_by_side_pass_in_all_worlds(pair):
    start(pair)
    joints = pair.worlds.robot.joint_names
    names, here = [joints[0], joints[2]], pair.worlds.robot.state().position[:, [0, 2]]
    for number in range(3):
        pair._both('joint_command', (names,), None, position=here + 0.01 * number)
        pair.advance()
    pair.check_equal()


@pytest.mark.full
def test_worlds_with_other_objects_or_with_several_robots_go_on_together():
    def world():
        return World([compose_robot('Panda', idn=0), compose_robot('UR5e', idn=1)],
                     create_arena('table'))
    worlds, simulations = Worlds(world(), 4, threads=1), [Simulation(world()) for _ in range(4)]
    for simulation in (worlds.simulations[1], simulations[1]):
        simulation.change_objects(plan_without(simulation.plan, 'cube'))
    for number in range(6):
        for name, robot in worlds.robots.items():
            joints = np.arange(len(robot[0].limits('arm')))
            actions = 0.1 * np.sin(number + np.arange(4)[:, None] + joints)
            robot.command.action('arm', actions)
            for simulation, action in zip(simulations, actions):
                one = simulation.robots[name]
                one.apply(one.parse.action('arm', action))
        worlds.advance(6)
        for simulation in simulations:
            simulation.advance(6)
    assert worlds.digest() == [simulation.digest() for simulation in simulations]


def test_worlds_with_more_objects_than_the_first_one_are_led_to_their_poses(pair):
    start(pair)
    for simulation in (pair.worlds.simulations[2], pair.simulations[2]):
        simulation.change_objects(plan_with(simulation.plan, create_object(
            {'name': 'ball', 'shape': 'sphere', 'size': [0.03], 'position': [0.5, 0.0, 1.2]})))
    for number in range(6):
        pair.command('osc', number)
        pair.advance()
    pair.check_equal()


def test_arms_whose_mounts_differ_from_world_to_world_come_to_rest_alike():
    pair = start(Pair('Tiago'))
    pair.command('pose', 1)
    for _ in range(18):
        pair.advance(25)
    pair.check_equal()
    pair.worlds.close()


def test_a_base_takes_twists_in_the_worlds_of_a_mask():
    pair = Pair('PandaOmron', initialization_noise=None)
    twists, where = np.array([[0.2, 0.0, 0.1], [np.nan] * 3, [0.0, 0.1, 0.0]]), [True, False, True]
    pair.worlds.robot.command.twist(twists, where=where)
    for world in (0, 2):
        robot = pair.simulations[world].robot
        robot.apply(robot.parse.twist(*twists[world]))
    for _ in range(5):
        pair.advance()
    pair.check_equal()
    pair.worlds.close()


@pytest.mark.full
def test_a_world_that_diverges_is_told_and_disturbs_no_other(pair):
    start(pair)
    pair.command('stream', 0)
    pair.advance()
    for world in (pair.worlds.simulations[1], pair.simulations[1]):
        world.data.qvel[2] = 1e9
    for _ in range(3):
        pair.advance()
    assert pair.worlds.diverged.tolist() == [False, True, False]
    assert 'diverged at' in pair.worlds.reasons[1] and pair.worlds.reasons[0] is None
    pair.check_equal()
    pair.reset(np.array([1, 2, 3]), np.array([False, True, False]))
    assert not pair.worlds.diverged.any()
    pair.command('stream', 1)
    pair.advance()
    pair.check_equal()


@pytest.mark.full
def test_states_continue_in_other_worlds_and_in_simulations(pair):
    start(pair)
    for number, kind in enumerate(('pose', 'gripper', 'trajectory')):
        pair.command(kind, number)
        pair.advance()
    states, digests = pickle.loads(pickle.dumps(pair.worlds.save())), pair.worlds.digest()
    for _ in range(4):
        pair.advance()
    ends = pair.worlds.digest()
    pair.simulations[0].restore(states[2])
    assert pair.simulations[0].digest() == digests[2]
    assert pair.worlds.digest() == ends
    pair.worlds.restore(states[::-1])
    assert pair.worlds.digest() == digests[::-1]
    for _ in range(4):
        pair.worlds.advance(5)
    assert pair.worlds.digest() == ends[::-1]
    pair.worlds.restore(states[:1], where=[False, True, False])
    assert pair.worlds.digest() == [ends[2], digests[0], ends[0]]
    assert pair.worlds.digest([False, True, False]) == [digests[0]]
    assert len(pair.worlds.save([True, False, True])) == 2


def test_masked_worlds_stand_still_while_others_go_on(pair):
    start(pair)
    before = pair.worlds.digest()
    pair.worlds.advance(5, where=[True, False, True])
    after = pair.worlds.digest()
    assert [a == b for a, b in zip(after, before)] == [False, True, False]
    assert pair.worlds.time_ns.tolist() == [10_000_000, 0, 10_000_000]


def test_a_mode_and_an_edit_of_a_model_are_those_of_one_world(pair):
    start(pair)
    one, other = pair.worlds.simulations[0], pair.worlds.simulations[1]
    start_digest = other.digest()
    pair.worlds.robot.set_control_mode('arm', 'effort', [True, False, False])
    pair.worlds.robot.command.joint_command(
        ['robot0_joint1'], effort=np.full((3, 1), 2.0), where=[True, False, False])
    one.model.body_mass[3] *= 2.0
    assert one.robot.joints.mode_of('robot0_joint1') == 'effort'
    assert one.model.actuator_gainprm[0, 0] != other.model.actuator_gainprm[0, 0]
    assert other.digest() == start_digest
    pair.worlds.advance(5)
    simulation = pair.simulations[1]
    simulation.advance(5)
    assert other.digest() == simulation.digest() != one.digest()


def test_the_state_of_a_gripper_of_a_user_is_that_of_one_world(
        one_joint_arm, gripper_class, gripper_file):
    def world():
        robot = one_joint_arm()
        robot.add_gripper(gripper_class(gripper_file))
        return World([robot])
    worlds, simulation = Worlds(world(), 2, threads=1), Simulation(world())
    worlds.robot.command.action('right/gripper', [[1.0], [-1.0]])
    simulation.robot.apply(simulation.robot.parse.action('right/gripper', [-1.0]))
    for _ in range(30):
        worlds.advance(5)
        simulation.advance(5)
    assert worlds.digest()[1] == simulation.digest()
    assert worlds.digest()[0] != simulation.digest()


def test_actions_that_have_yet_to_take_effect_are_digested_alike(pair):
    start(pair)
    for number in range(8):
        pair.advance()
        pair.command('osc', 0.1 * number)
    pair.check_equal()


class OwnGripper(PandaGripper, registered=False):
    """A gripper with a meaning of actions of its own, without a state."""

    def format_action(self, action):
        return np.array([-1.0, 1.0]) * action


@pytest.mark.parametrize('gripper', [OwnGripper, WipingGripper])
def test_grippers_without_a_rule_take_actions_in_worlds_that_go_on(gripper):
    pair = start(Pair(gripper=gripper))
    for number in range(30):
        pair.command('osc', 0.01 * number)
        if number % 3 == 0:
            pair.command('gripper', number)
        pair.advance()
    pair.check_equal()
    pair.worlds.close()


def test_arrays_of_all_worlds_are_read_at_once(lasting_pair):
    start(lasting_pair)
    read = lasting_pair.worlds.read('xpos')
    np.testing.assert_array_equal(
        read, [simulation.data.xpos for simulation in lasting_pair.worlds.simulations])
    measured = lasting_pair.worlds.robot.measured('arm')
    assert measured.shape == (3, 21)
    np.testing.assert_array_equal(measured[1], lasting_pair.worlds.robot[1].measured('arm'))
    with pytest.raises(UnknownNameError, match="unknown array of MjData 'qpso': did you mean "
                                               "'qpos'"):
        lasting_pair.worlds.read('qpso')


@pytest.mark.parametrize('count', [0, -1, 1.5, True, None])
def test_the_count_of_worlds_is_a_whole_number_from_one(count):
    with pytest.raises(ModelError, match='count of worlds must be a whole number from 1, got'):
        Worlds(compose('Panda'), count)


@pytest.mark.parametrize('threads', [0, -1, 1.5, True, '2'])
def test_the_number_of_threads_is_a_whole_number_from_one(threads):
    with pytest.raises(ModelError, match='threads must be a whole number from 1, got'):
        Worlds(compose('Panda'), 2, threads)


@pytest.mark.parametrize('where', [
    [True, False], [1, 0, 1], True, [[True, False, True]], [[True], [True, False], []]])
def test_a_mask_has_a_truth_value_for_each_world(lasting_pair, where):
    worlds = lasting_pair.worlds
    before, robot = worlds.digest(), worlds.robot
    for call in (lambda: worlds.reset(None, where), lambda: worlds.advance(5, where),
                 lambda: worlds.save(where),
                 lambda: robot.set_control_mode('arm', 'effort', where),
                 lambda: robot.command.action('arm', np.zeros((3, 7)), where=where)):
        with pytest.raises(CommandError, match='where must be 3 truth values, one for each world'):
            call()
    assert worlds.digest() == before


@pytest.mark.parametrize('steps', [0, -1, None, 1.5, math.nan, math.inf, True, '5', 2 + 0j, [2]])
def test_steps_that_are_none_advance_no_world(lasting_pair, steps):
    worlds, before = lasting_pair.worlds, lasting_pair.worlds.digest()
    for advance in (worlds.advance, worlds.simulations[0].advance):
        with pytest.raises(CommandError, match='steps must be a whole number from 1, got'):
            advance(steps)
    assert worlds.digest() == before


@pytest.mark.parametrize('period_s', [0, -1, math.nan, math.inf, True, 'x', [0.01], 10**400])
def test_a_control_period_is_a_number_above_zero(lasting_pair, period_s):
    worlds, before = lasting_pair.worlds, lasting_pair.worlds.digest()
    with pytest.raises(CommandError, match='period_s must be positive and finite, got'):
        worlds.robot.command.action('arm', np.zeros((COUNT, 7)), period_s=period_s)
    assert worlds.digest() == before


class _Liar(list):
    def __len__(self):
        return 7


@pytest.mark.parametrize('names, message', [
    (None, 'must be a sequence of texts, got None'), (7, 'got 7'), ('joint1', "got 'joint1'"),
    ([1] * 7, 'got .1, 1'), ([['joint1']], "got ..'joint1"), ([b'joint1'], 'got .b'),
    (_Liar(['robot0_joint1'] * 2), "joint 'robot0_joint1' is named twice"),
    (_Liar(['robot0_joint1']), 'must have')])
def test_names_that_are_none_command_no_world(lasting_pair, names, message):
    worlds, before = lasting_pair.worlds, lasting_pair.worlds.digest()
    robot, goals = worlds.robot, np.zeros((COUNT, 7))
    for call in (lambda: robot.command.joint_command(names, goals),
                 lambda: robot.command.trajectory('arm', names, [1.0], goals[:, None])):
        with pytest.raises(CommandError, match=message):
            call()
    assert worlds.digest() == before


@pytest.mark.parametrize('times_s', [None, 'soon', [[1.0]], [math.nan], ['a'], [10**400]])
def test_times_that_are_none_command_no_world(lasting_pair, times_s):
    worlds, before = lasting_pair.worlds, lasting_pair.worlds.digest()
    names = list(worlds.robot.joint_names[:7])
    with pytest.raises(CommandError, match='time_from_start must'):
        worlds.robot.command.trajectory('arm', names, times_s, np.zeros((COUNT, 1, 7)))
    assert worlds.digest() == before


@pytest.mark.parametrize('part', ['wing', '', 3])
def test_an_unknown_part_has_no_measured_state(lasting_pair, part):
    with pytest.raises(UnknownNameError, match='unknown part .*available: '):
        lasting_pair.worlds.robot.measured(part)


@pytest.mark.parametrize('seeds, message', [
    ([1, 2], 'expected 3 seeds, one for each world'), (5, 'expected 3 seeds'),
    ([1, 2, -3], 'seed must be a whole number from 0'),
    ([1, 2.5, 3], 'seed must be a whole number from 0'),
    (np.array([1.0, 2.0, 3.0]), 'seed must be a whole number from 0')])
def test_seeds_that_are_none_reset_no_world(lasting_pair, seeds, message):
    before = lasting_pair.worlds.digest()
    with pytest.raises(ModelError, match=message):
        lasting_pair.worlds.reset(seeds)
    assert lasting_pair.worlds.digest() == before


@pytest.mark.parametrize('call, message', [
    (lambda c, _: c.action('arm', np.zeros((2, 7))), 'leading axis of 3.*got the shape'),
    (lambda c, _: c.action('arm', np.zeros((3, 6))), 'world 0: arm: an action must'),
    (lambda c, _: c.action('arm', [[0.0] * 7, [np.nan] * 7, [0.0] * 7]), 'world 1: arm'),
    (lambda c, _: c.action('arm', 'fast'), 'arm: actions'),
    (lambda c, _: c.action('amr', np.zeros((3, 7))), "unknown part 'amr'"),
    (lambda c, _: c.joint_command(['robot0_joint1'], position=np.full((3, 1), np.inf)),
     'world 0: joint_command: position must be finite'),
    (lambda c, _: c.joint_command(['robot0_joint1'], velocity=np.zeros((3, 1))),
     'world 0: .* does not use the field velocity'),
    (lambda c, _: c.joint_command(['joint1'], position=np.zeros((3, 1))), 'no joint'),
    (lambda c, _: c.twist(np.zeros((3, 2))), r'twists must have the shape \(3, 3\)'),
    (lambda _, k: k.pose('right', np.zeros((3, 3)), np.zeros((3, 4))), 'world 0: orientation'),
    (lambda _, k: k.action('left', np.zeros((3, 6))), "unknown arm with a gripper 'left'"),
    (lambda _, k: k.twist('right', np.zeros((3, 3)), np.zeros((3, 3)), 'tool'),
     'unknown frame')])
def test_an_invalid_row_changes_no_world(lasting_pair, call, message):
    start(lasting_pair)
    before, robot = lasting_pair.worlds.digest(), lasting_pair.worlds.robot
    with pytest.raises((CommandError, UnknownNameError), match=message):
        call(robot.command, robot.command_cartesian)
    assert lasting_pair.worlds.digest() == before


@pytest.mark.parametrize('mode', ['position', 'velocity'])
def test_an_infinite_goal_lets_no_stream_have_other_numbers(pair, mode):
    start(pair, mode)
    names = pair.simulations[0].robot.joint_names[:7]
    goals = (pair.worlds.robot.state().position[:, :7] if mode == 'position'
             else np.zeros((3, 7)))
    for period in range(60):  # In the end worlds go on without Python.
        pair._both('joint_command', (names,), None, **{mode: goals + 1e-4 * period})
        pair.advance()
    goals[2, 3] = np.inf
    with pytest.raises(CommandError, match=f'world 2: joint_command: {mode} must be finite'):
        pair.worlds.robot.command.joint_command(names, **{mode: goals})
    pair.advance()
    pair.check_equal()


@pytest.mark.parametrize('mode', ['position', 'velocity'])
def test_a_world_in_another_mode_lets_no_stream_have_other_numbers(pair, mode):
    start(pair, mode)
    names = pair.simulations[0].robot.joint_names[:7]
    goals = (pair.worlds.robot.state().position[:, :7] if mode == 'position'
             else np.zeros((3, 7)))
    for period in range(12):
        pair._both('joint_command', (names,), None, **{mode: goals + 1e-4 * period})
        pair.advance()
    for simulation in (pair.worlds.simulations[2], pair.simulations[2]):
        simulation.robot.set_control_mode('arm', 'effort')
    with pytest.raises(CommandError, match='world 2: joint_command: joint .* is in effort mode'):
        pair.worlds.robot.command.joint_command(names, **{mode: goals + 0.1})
    pair.advance()
    pair.check_equal()


def test_states_that_do_not_fit_restore_no_world(pair):
    start(pair)
    before, states = pair.worlds.digest(), pair.worlds.save()
    other = Simulation(compose('UR5e')).save()
    pair.worlds.advance(5)
    after = pair.worlds.digest()
    assert before != after
    with pytest.raises(ModelError, match='expected 3 states, one for each world .*got 2'):
        pair.worlds.restore(states[:2])
    with pytest.raises(ModelError, match='another world'):
        pair.worlds.restore([*states[:2], other])
    with pytest.raises(ModelError, match="expected a state of save\\(\\), got 'saved'"):
        pair.worlds.restore([*states[:2], 'saved'])
    with pytest.raises(ModelError, match='expected 3 states, one for each world .*got None'):
        pair.worlds.restore(None)
    assert pair.worlds.digest() == after


@pytest.mark.parametrize('threads', [1, 2])
def test_closed_worlds_can_be_read_only(threads):
    worlds = Worlds(compose('Panda'), 2, threads)
    worlds.close()
    before = worlds.digest()
    for call in (lambda: worlds.advance(5), worlds.reset):
        with pytest.raises(SimulationEnded, match='these worlds are closed'):
            call()
    assert worlds.digest() == before


def test_a_function_that_fails_lets_all_threads_end_first():
    threads, ends = PhysicsThreads(3), threading.Event()
    done = []

    def fail():
        ends.set()
        raise ValueError('failed')

    def last():
        ends.wait()
        threading.Event().wait(0.1)
        done.append(True)

    try:
        with pytest.raises(ValueError, match='failed'):
            threads.run([fail, last, last])
        assert done == [True, True]
    finally:
        threads.close()


def test_threads_end_with_a_context():
    before = threading.active_count()
    with Worlds(compose('Panda'), 2, threads=2) as worlds:
        worlds.advance(5)
        assert worlds.threads == 2 and threading.active_count() == before + 1
    assert threading.active_count() == before


def test_a_law_of_a_user_has_parameters_and_memory_of_its_own_in_each_world(pair):
    start(pair)
    stiffness = np.array([100.0, 200.0, 400.0])
    pair.worlds.robot.set_law(pair.part, pulled, stiffness=stiffness, damping=20.0)
    for simulation, value, _ in pair._of(None, stiffness):
        simulation.robot.set_law(pair.part, pulled, stiffness=value, damping=20.0)
    parameters = pair.worlds.robot.law_parameters(pair.part)
    for number, kind in enumerate(('stream', 'goals', 'pose', 'trajectory', 'twist', 'osc')):
        pair.command(kind, number)
        pair.advance(20)
        parameters['damping'] = 20.0 + number + np.arange(3)
        for simulation, _, world in pair._of():
            simulation.robot.law_parameters(pair.part)['damping'] = 20.0 + number + world
    pair.check_equal()
    assert parameters['stiffness'].tolist() == stiffness.tolist()
    assert {*parameters} == {'stiffness', 'damping'} and len(parameters) == 2


@pytest.mark.parametrize(('act', 'error', 'text'), [
    (lambda robot: robot.set_law('arm', pulled, stiffness=[1.0, 2.0]), CommandError, 'axis of 3'),
    (lambda robot: robot.set_law('arm', pulled, stiffness=[1.0, 2.0, math.nan]), ModelError,
     'world 2: .*stiffness must be a finite number, got nan'),
    (lambda robot: robot.set_law('arm', pulled, stiffness=np.ones((3, 1))), CommandError,
     'a number or one for each world'),
    (lambda robot: robot.set_law('arm', pulled, stifness=1.0), UnknownNameError, 'stiffness'),
    (lambda robot: robot.set_law('arm', pulled, where=[1, 0, 0]), CommandError, 'truth values'),
    (lambda robot: robot.set_law('arm', 'pulled'), ModelError, 'must be a function'),
    (lambda robot: robot.law_parameters('arm'), ModelError, 'no law moves arm'),
    (lambda robot: _of_one(robot).__setitem__('damping', [1.0, 2.0, math.inf]), ModelError,
     'world 2: .*damping must be a finite number, got inf'),
    (lambda robot: robot.set_payload('right', [1.0, -1.0, 1.0]), CommandError, 'world 1: .*mass')])
def test_what_no_law_of_worlds_can_be_changes_no_world(act, error, text, pair):
    before = None if 'inf' in text else pair.worlds.digest()
    with pytest.raises(error, match=text):
        act(pair.worlds.robot)
    if before is None:
        assert pair.worlds.robot.law_parameters('arm')['damping'].tolist() == [35.0] * 3
    else:
        assert pair.worlds.digest() == before


def _of_one(robot):
    robot.set_law('arm', pulled)
    return robot.law_parameters('arm')


def test_a_world_whose_objects_change_forgets_what_was_made_of_its_model():
    # Compiled code read rows with addresses of the model before, which was freed.
    worlds = Worlds(compose('Panda'), 2, 1)
    made = [(simulation.periods.compiled._derived, simulation.robot.reflexes.collisions._derived)
            for simulation in worlds.simulations]
    for derived in (*made[0], *made[1]):
        derived.of['mark'] = 0
    changed = worlds.simulations[1]
    changed.change_objects(plan_with(changed.plan, create_object(
        {'name': 'ball', 'shape': 'sphere', 'size': [0.03], 'position': [0.5, 0.0, 1.2]})))
    assert [['mark' in derived.of for derived in own] for own in made] == [[True] * 2, [False] * 2]


def test_a_law_feels_its_tool_after_objects_have_gone_from_its_world(pair):
    for one in (pair.worlds.simulations[1], pair.simulations[1]):
        one.robot.set_law('arm', pulled)
        one.advance(2)
        one.change_objects(plan_without(one.plan, one.entities.free_names[0]))
        tool = one.model.site(one.robot.end_effectors['right'].grip_site).bodyid[0]
        one.data.xfrc_applied[tool, :3] = 30.0
        one.advance(20)
    assert pair.worlds.digest()[1] == pair.simulations[1].digest()


def test_different_laws_in_worlds_have_no_parameters_together(pair):
    pair.worlds.robot.set_law('arm', pulled, where=np.array([True, True, False]))
    with pytest.raises(ModelError, match='no law moves arm'):
        pair.worlds.robot.law_parameters('arm')
    pair.worlds.robot.set_law('arm', _hold, where=np.array([False, False, True]))
    with pytest.raises(ModelError, match='not moved by the same law in all worlds'):
        pair.worlds.robot.law_parameters('arm')


@law(compiled=False)
def _hold(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    effort[:] = bias - 20.0 * v


def test_a_law_that_fails_in_one_world_is_stopped_there_alone(pair):
    @law(parameters={'end': 10.0})
    def ending(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        for i in range(len(q)):
            effort[i] = bias[i] - 20.0 * v[i]
        if t > parameters[0]:
            effort[0] = np.nan
    pair.worlds.robot.set_law('arm', ending, end=[10.0, 0.1, 10.0])
    for _ in range(20):
        pair.worlds.advance(10)
    tripped = [robot.reflexes.tripped for robot in pair.worlds.robot]
    assert [*map(len, tripped)] == [0, 1, 0] and "the law 'ending'" in tripped[1]['arm']
