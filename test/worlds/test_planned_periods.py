# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control periods in compiled code are those of ticks and steps by Python, to the last bit."""

import contextlib
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from robot_kinds import KINDS
from scipy.spatial.transform import Rotation

from manip_sim.errors import CommandError, DivergenceError
from manip_sim.laws import law
from manip_sim.models import compose, compose_robot
from manip_sim.models.arenas import create_arena
from manip_sim.models.world import World
from manip_sim.physics.physics import BECAME, PERIODS as GONE_ON, WENT_ON
from manip_sim.simulation import Simulation
from manip_sim.simulation.control_period import ControlPeriods
from manip_sim.worlds import Worlds

COUNT, PERIODS, STEPS = 3, 70, 10
EVERYTHING = int(mujoco.mjtState.mjSTATE_INTEGRATION)


#: The periods of simulations whose steps Python runs.
BY_PYTHON: list[ControlPeriods] = []


@pytest.fixture
def at_once(monkeypatch):
    """Return a list that grows by whether compiled code runs what is left of a period."""
    done, lets = [], ControlPeriods._lets_laws_step

    def counted(periods, awake):
        by_law = periods not in BY_PYTHON and lets(periods, awake)
        if awake and periods not in BY_PYTHON:
            done.append(by_law)
        return by_law
    monkeypatch.setattr(ControlPeriods, '_lets_laws_step', counted)
    yield done
    BY_PYTHON.clear()


def whole_state(simulation):
    """Return all that the next step depends on, and what was computed and measured of it."""
    data = simulation.data
    state = np.empty(mujoco.mj_stateSize(simulation.model, EVERYTHING))
    mujoco.mj_getState(simulation.model, data, state, EVERYTHING)
    return [*state, *data.qacc, *data.sensordata, *data.qfrc_actuator, *data.warning.number,
            simulation.step_count, *simulation.robot.state().effort]


def wrench(simulation):
    """Return the external wrenches on the tools, shape (6 n,)."""
    return np.concatenate([reader.external_wrench(simulation.data)
                           for reader in simulation.robot.end_effectors.values()])


class Followers:
    """Worlds, and a simulation of the first one, whose arms follow the same stream."""

    def __init__(self, name, integrator='IMPLICITFAST'):
        def world():
            return compose(name, arena=create_arena('table', cube=True))
        self.worlds, self.alone = Worlds(world(), COUNT, 2), Simulation(world())
        for simulation in (self.alone, *self.worlds.simulations):
            simulation.model.opt.integrator = getattr(
                mujoco.mjtIntegrator, f'mjINT_{integrator}')
            if 'base' in simulation.robot.parts:
                simulation.robot.set_control_mode('base', 'position')
        BY_PYTHON.append(self.alone.periods)
        robot = self.alone.robot
        self._names = list(robot.joints.names)
        self._start = np.array([self.alone.data.joint(name).qpos[0] for name in self._names])
        self.wrenches = []

    def run(self, disturb=lambda simulation, period: None):
        """Advance all, and see that the first world is the simulation after each period."""
        with self.worlds:
            for period in range(PERIODS):
                goals = self._start + 0.002 * np.sin(0.1 * period + np.arange(len(self._names)))
                self.worlds.robot.command.joint_command(
                    self._names, position=np.tile(goals, (COUNT, 1)), period_s=0.02)
                self.alone.robot.apply(*self.alone.robot.parse.joint_command(
                    self._names, goals), period_s=0.02)
                for simulation in (self.alone, *self.worlds.simulations):
                    disturb(simulation, period)
                self.worlds.advance(STEPS)
                with contextlib.suppress(DivergenceError):
                    self.alone.advance(STEPS)
                first = self.worlds.simulations[0]
                assert first.diverged == self.alone.diverged
                assert whole_state(first) == whole_state(self.alone)
                self.wrenches.append(wrench(first))
                assert self.wrenches[-1].tolist() == wrench(self.alone).tolist()


@pytest.mark.full
@pytest.mark.parametrize(('name', 'integrator'), [
    *((name, 'IMPLICITFAST') for name in KINDS), ('Panda', 'EULER'), ('Tiago', 'EULER'),
    ('Panda', 'RK4'), ('Baxter', 'RK4')])
def test_planned_periods_in_one_call_are_those_of_a_simulation(name, integrator, at_once):
    Followers(name, integrator).run()
    assert at_once and all(at_once)


@pytest.mark.full
def test_what_else_acts_and_was_counted_is_kept(at_once):
    def disturb(simulation, period):
        # The cube is pushed for a while and lifted now and then; a warning is counted.
        simulation.data.xfrc_applied[simulation.model.body('cube').id, 0] = 0.2 * (period > 50)
        if period % 10 == 5:
            simulation.data.joint('cube_joint').qpos[2] += 0.02
        simulation.data.warning.number[int(mujoco.mjtWarning.mjWARN_INERTIA)] += period % 7 == 0
    Followers('Panda').run(disturb)
    assert all(at_once)


@pytest.mark.full
def test_a_warning_in_a_planned_period_does_not_end_it(at_once):
    def warn(_, data):
        if round(data.time / 0.002) % 50 == 5:
            data.warning.number[int(mujoco.mjtWarning.mjWARN_INERTIA)] += 1
    followers = Followers('Panda')
    mujoco.set_mjcb_control(warn)
    try:
        followers.run()
    finally:
        mujoco.set_mjcb_control(None)
    assert all(at_once)


@pytest.mark.full
def test_a_tool_that_is_hit_in_a_planned_period_reads_the_same_forces(at_once):
    def throw(simulation, period):
        if period in (50, 60):
            place = simulation.data.site(simulation.robot.end_effectors['right'].grip_site).xpos
            simulation.data.joint('cube_joint').qpos[:3] = place - [0.0, 0.0, 0.15]
            simulation.data.joint('cube_joint').qvel[:] = 0.0, 0.0, 2.0, 0.0, 0.0, 0.0
    followers = Followers('Panda')
    followers.run(throw)
    assert all(at_once)
    assert np.abs(followers.wrenches).max() > 1.0


@pytest.mark.full
def test_a_divergence_in_a_planned_period_is_reported_as_that_of_a_simulation(at_once):
    def disturb(simulation, period):
        if period == 60:
            simulation.data.qvel[-1] = 9.9e9
    followers = Followers('Panda')
    followers.run(disturb)
    assert followers.alone.diverged and all(at_once)


def _push(robot):
    body = robot._physics.model.site(robot.end_effectors['right'].grip_site).bodyid[0]
    robot._physics.data.xfrc_applied[body, 2] = -3.0
    robot._physics.data.joint('cube_joint').qpos[2] = 3.0  # It touches nothing for a while.


def _hit(robot):
    data = robot._physics.data
    place = data.site(robot.end_effectors['right'].grip_site).xpos
    data.joint('cube_joint').qpos[:3] = place - [0.0, 0.0, 0.12]
    data.joint('cube_joint').qvel[:] = 0.0, 0.0, 2.0, 0.0, 0.0, 0.0


def _grip(robot):
    data = robot._physics.data
    place = data.site(robot.end_effectors['right'].grip_site).xpos
    data.joint('cube_joint').qpos[:3] = place
    data.joint('cube_joint').qvel[:] = 0.0


def _blow(robot):
    robot._physics.model.opt.wind[:] = 50.0
    robot._physics.model.opt.density = 1.2


def _take(robot):
    name = robot.joints.names[0]
    robot.apply(*robot.parse.joint_command([name], **{robot.command_interfaces()[name]: [0.1]}))


@law(parameters={'stiffness': 100.0})
def held(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    """Hold joints as springs do."""
    for i in range(len(q)):
        effort[i] = bias[i] + parameters[0] * (setpoint[i, 0] - q[i]) - 10.0 * v[i]


#: Events between two periods that go on like those before.
_BETWEEN = [
    [lambda robot: None], [_push], [_hit], [_blow], [_take], [_take, _hit],
    [lambda robot: robot.apply(robot.parse.action('right/gripper', [1.0]))],
    [_grip, lambda robot: robot.apply(*robot.parse.joint_command(
        robot.grippers['right/gripper'].joints.names[:1], position=[0.03]))],
    [lambda robot: robot.set_wrench_cutoff('right', 20.0), _hit],
    [_hit, lambda robot: robot.tare_wrench()],
    [lambda robot: robot.set_payload('right', 0.3, [0.0, 0.0, 0.1]), _hit],
    [lambda robot: robot.set_integral_gain('arm', 3.0)],
    [lambda robot: robot.set_command_timeout('arm', 0.03)],
    [lambda robot: robot.set_control_mode('arm', 'velocity')],
    [lambda robot: robot.set_control_mode('arm', 'effort')],
    [lambda robot: robot.set_reflex('arm', 'velocity', 1e-4)],
    [lambda robot: robot.emergency_stop(), lambda robot: robot.recover()],
    [lambda robot: robot.sensing.set('latency.state', 0.03)],
    [lambda robot: robot.sensing.set('latency.command', 0.03), _take],
    [lambda robot: robot.set_law('arm', held), lambda robot: robot.reset_reflexes()],
    [lambda robot: robot.set_speed_scaling(0.5)],
    [lambda robot: robot.set_stream('arm', hold_s=0.04)],
    [lambda robot: robot.joints.cartesian.set('right', 'stiffness', 300.0)],
    [lambda robot: robot.joints.cartesian.set('right', 'cartesian_stiffness', [500.0] * 6),
     lambda robot: robot.joints.cartesian.set('right', 'cartesian_stiffness', [0.0] * 6)],
    [lambda robot: robot.apply(robot.parse_cartesian.action('right', np.full(6, 0.1))),
     lambda robot: robot.joints.cartesian.goal('right', robot._physics.data)],
    [lambda robot: robot.apply(robot.parse_cartesian.twist('right', [0.1, 0, 0], [0, 0, 0.1]))],
    [lambda robot: robot.apply(robot.parse_cartesian.action('right', [-1.0] * 6))]]


def _same(one, other):
    assert whole_state(one) == whole_state(other)
    assert wrench(one).tolist() == wrench(other).tolist()
    np.testing.assert_array_equal(one.robot.state().position, other.robot.state().position)
    assert one.robot.safety_state == other.robot.safety_state
    assert one.robot.joints.timeouts == other.robot.joints.timeouts
    own, others = (
        simulation.robot.joints.cartesian.reports['right'] for simulation in (one, other))
    assert (own.counts, own.texts) == (others.counts, others.texts)


def _same_digest(one, other):
    assert one.digest() == other.digest()
    own, others = (
        simulation.robot.joints.cartesian.reports['right'] for simulation in (one, other))
    assert own == others


def _send(first, alone, parse, times, period_s):
    """Let a robot in each of two simulations take a command, some times."""
    sent = [parse(simulation.robot) for simulation in (first, alone)]
    for simulation, command in zip((first, alone), sent):
        for _ in range(times):
            simulation.robot.apply(command, period_s=period_s)
    SENT[alone] = [*SENT.get(alone, [])[-2:], sent]
    for one, other in SENT[alone]:
        assert one.handle.status is other.handle.status


def _lead(kind, first, alone, period, period_s):
    """Let the end effectors of two simulations follow actions, or go to poses now and then."""
    if kind == 'acted':
        actions = 0.3 * np.sin(0.15 * period + np.arange(6)) * (1.0 if period % 9 else 4.0)
        _send(first, alone, lambda robot: robot.parse_cartesian.action('right', actions),
              1 + (period % 7 == 0), period_s)
    elif kind == 'led':
        arm, count = alone.robot.joints.indices_of('arm'), 3 + period % 3
        names = [alone.robot.joints.names[i] for i in arm]
        if period % 25 == 0 and alone.robot.command_interfaces()[names[0]] == 'position':
            goals = alone.robot.joints.cartesian.posture[arm] + 0.01 * np.sin(
                period + np.arange(7))
            # They end within a control period, or with it.
            _send(first, alone, lambda robot: robot.parse.trajectory(
                'arm', names[:count], [0.1, 0.2 + 0.01 * count],
                [goals[:count] + 0.01, goals[:count]]), 1, period_s)
    elif period % 30 == 0:
        place = np.array([0.55, 0.1 * np.sin(period), 1.0 + 0.05 * (period % 60 == 0)])
        _send(first, alone, lambda robot: robot.parse_cartesian.pose(
            'right', place, [1.0, 0.0, 0.0, 0.0]), 1, period_s)
    elif kind == 'sprung' and period % 50 == 5 and alone.robot.joints.impedes('right'):
        _send(first, alone, lambda robot: robot.parse_cartesian.wrench(
            'right', [8.0, 0.0, -5.0], [0.0, 0.5, 0.0]), 1, period_s)
    elif kind == 'sprung' and period % 50 == 40 and alone.robot.joints.impedes('right'):
        _send(first, alone, lambda robot: robot.parse_cartesian.force_mode(
            'right', [0, 0, 1, 0, 0, 0], [0.0, 0.0, -4.0, 0.0, 0.0, 0.0], [0.1] * 6), 1, period_s)


def _follow(kind, first, alone, period, period_s):
    """Let a stream of poses or twists go on in two simulations; some stand for two, or pause."""
    if period % 40 > 30 or period % (1 + period // 50 % 3):
        return
    way = 0.1 * np.sin(0.1 * period + np.arange(6))
    start = STARTS.setdefault(alone, alone.robot.state().end_effectors['right'].pose)
    turned = Rotation.from_rotvec(way[3:]) * Rotation.from_quat(start.quat_xyzw)
    frames = ['', alone.robot.end_effectors['right'].grip_site]

    def parse(robot):
        if kind == 'driven':
            command = robot.parse.twist(*way[:3])
        elif kind in ('twisted', 'spun'):
            command = robot.parse_cartesian.twist(
                'right', way[:3], 3.0 * way[3:], frames[period // 100 % 2])
        else:
            command = robot.parse_cartesian.pose(
                'right', start.position + 0.5 * way[:3], turned.as_quat())
        return replace(command, sent_ns=(period // 60 % 2) * (period + 1) * 20_000_000,
                       messages=1 + (period % 7 == 0))
    _send(first, alone, parse, 1 + (period % 11 == 0), period_s)


#: By simulation: the last messages to the first world and to it, and where streams of poses began.
SENT, STARTS = {}, {}
#: Kinds of commands for an end effector of a simulation, and of streams, by control mode.
LED = ('acted', 'posed', 'sprung', 'led')
STREAMED = {'streamed': 'position', 'twisted': 'velocity', 'pushed': 'effort', 'spun': 'effort',
            'pulled': 'effort', 'driven': 'position'}
ALL_KINDS = ('rest', 'stream', 'sent', 'exert', 'osc', 'lead', *LED, *STREAMED)


def _compose(driven):
    """Return the world of an arm, which stands on a mobile base if that is driven."""
    return compose('PandaOmron' if driven else 'Panda', arena=create_arena('table', cube=True))


def _prepare(robot, kind):
    """Let an arm have the control mode that commands of a kind need."""
    robot.set_control_mode('arm', STREAMED.get(kind) or ('effort' if kind in (
        'exert', 'osc', 'acted', 'sprung') else 'velocity' if kind == 'sent' else 'position'))
    if kind in ('sprung', 'pulled'):
        robot.joints.cartesian.set('right', 'cartesian_stiffness', [400.0] * 3 + [20.0] * 3)
        robot.set_command_timeout('arm', 0.31, ends_targets=False)  # Ends within a period.


def _command(kind, worlds, alone, period, steps):
    """Let the first world and a simulation follow the next message of a stream."""
    arm, period_s = alone.robot.joints.indices_of('arm'), steps * 0.002
    names, posture = ([alone.robot.joints.names[i] for i in arm],
                      alone.robot.joints.cartesian.posture[arm])
    where = np.arange(len(worlds)) == 0
    if kind == 'stream':
        field = alone.robot.command_interfaces()[names[0]]
        goals = 0.1 * np.sin(0.05 * period + np.arange(7)) + (
            posture if field == 'position' else 0.0)
        worlds.robot.command.joint_command(
            names, **{field: np.tile(goals, (len(where), 1))}, where=where, period_s=period_s)
        alone.robot.apply(*alone.robot.parse.joint_command(
            names, **{field: goals}), period_s=period_s)
    elif kind in ('sent', 'exert'):  # By messages, with stamps, some of which stand for two.
        field = alone.robot.command_interfaces()[names[0]]
        goals = 0.1 * np.sin(0.05 * period + np.arange(7)) + (
            posture if field == 'position' else 0.0)
        if field == 'velocity' and 20 <= period < 40:
            goals[:] = 0.0  # All rests, while the stream goes on.
        _send(worlds.simulations[0], alone, lambda robot: replace(
            robot.parse.joint_command(names, **{field: goals})[0],
            sent_ns=(period + 1) * 20_000_000, messages=1 + (period % 7 == 0)),
            1 + (period % 11 == 0), period_s)
    elif kind in STREAMED:
        _follow(kind, worlds.simulations[0], alone, period, period_s)
    elif kind in LED:
        _lead(kind, worlds.simulations[0], alone, period, period_s)
    elif kind in ('osc', 'lead'):
        if period // 20 % 2 or period % 60 > 52:  # It closes, turns back, and may stay open.
            grip = [np.sign(np.sin(0.4 * period)) if period // 40 % 2 else (
                1.0 if period % 20 < 8 or period % 60 in (53, 54, 55) else -1.0)]
            worlds.robot.command.action(
                'right/gripper', np.tile(grip, (len(where), 1)), where=where, period_s=period_s)
            alone.robot.apply(
                alone.robot.parse.action('right/gripper', grip), period_s=period_s)
        # Now and then far enough for an arm that is held, and off its way.
        actions = (0.9 if period // 50 % 2 else 0.2) * np.sin(0.15 * period + np.arange(6))
        worlds.robot.command_cartesian.action(
            'right', np.tile(actions, (len(where), 1)), where=where, period_s=period_s)
        alone.robot.apply(
            alone.robot.parse_cartesian.action('right', actions), period_s=period_s)


@pytest.mark.parametrize('kind', STREAMED)
def test_streams_go_on_while_their_messages_come(kind, at_once):
    both = [Simulation(_compose(kind == 'driven')) for _ in range(2)]
    for simulation in both:
        _prepare(simulation.robot, kind)
    for period in range(40, 71):
        if period == 46:
            at_once.clear()
        _follow(kind, *both, period, STEPS * 0.002)
        for simulation in both:
            simulation.advance(STEPS)
    assert len(at_once) < 12  # So often Python has begun a period, of 50.


@pytest.mark.full
@pytest.mark.parametrize('kind', ALL_KINDS)
def test_whatever_comes_between_periods_that_go_on_acts_as_by_python(kind, at_once):
    world = _compose(kind == 'driven')
    worlds, alone = Worlds(world, 1, 1), Simulation(world)
    BY_PYTHON.append(alone.periods)
    first = worlds.simulations[0]
    for simulation in (alone, first):
        _prepare(simulation.robot, kind)
    options = alone.model.opt.wind.copy(), alone.model.opt.density

    def command(begin, end):
        for period in range(begin, end):
            _command(kind, worlds, alone, period, STEPS)
            worlds.advance(STEPS)
            alone.advance(STEPS)
    command(0, 4 if kind == 'rest' else 60)
    assert first.physics.standing[GONE_ON] > 0
    saved = [alone.save(), first.save()]
    for acts in _BETWEEN:
        for simulation, state in zip((alone, first), saved):
            simulation.restore(state)
            simulation.model.opt.wind[:], simulation.model.opt.density = options
            simulation.data.xfrc_applied[:] = 0.0
        command(60, 66)
        for act in acts:
            for simulation in (alone, first):
                act(simulation.robot)
            for _ in range(8):
                worlds.advance(STEPS)
                alone.advance(STEPS)
                _same(first, alone)
        for _ in range(12):
            worlds.advance(STEPS)
            alone.advance(STEPS)
        _same(first, alone)
        _same_digest(first, alone)


@pytest.mark.full
def test_an_arm_that_has_come_to_a_pose_follows_it_when_its_base_is_pushed(at_once):
    world = compose('PandaOmron')
    worlds, alone = Worlds(world, 1, 1), Simulation(world)
    BY_PYTHON.append(alone.periods)
    first = worlds.simulations[0]
    pose = alone.robot.state().end_effectors['right'].pose
    for simulation in (alone, first):
        simulation.robot.apply(simulation.robot.parse_cartesian.pose(
            'right', pose.position, pose.quat_xyzw))
    for period in range(160):
        for simulation in (alone, first):
            base = simulation.model.body(simulation.robot.frame_body).id
            simulation.data.xfrc_applied[base, 1] = 2e4 if 80 <= period < 120 else 0.0
        worlds.advance(STEPS)
        alone.advance(STEPS)
        _same(first, alone)
    _same_digest(first, alone)


@pytest.mark.full
@pytest.mark.parametrize('kind', ['stream', 'osc'])
def test_no_world_that_goes_on_takes_a_command_that_is_invalid_in_another_one(kind):
    world = compose('Panda')
    worlds, alone = Worlds(world, 2, 1), Simulation(world)
    for simulation in (alone, *worlds.simulations):
        simulation.robot.set_control_mode('arm', 'effort' if kind == 'osc' else 'position')
    for period in range(60):
        _command(kind, worlds, alone, period, STEPS)
        worlds.advance(STEPS)
        alone.advance(STEPS)
    assert worlds.simulations[0].physics.standing[GONE_ON] > 0
    numbers = np.tile(alone.robot.joints.cartesian.posture[:7 if kind == 'stream' else 6], (2, 1))
    numbers = np.clip(numbers, -1.0, 1.0) if kind == 'osc' else numbers
    numbers[1, 0] = np.inf
    with pytest.raises(CommandError, match='world 1'):
        if kind == 'stream':
            worlds.robot.command.joint_command(
                alone.robot.joints.names[:7], position=numbers, period_s=0.02)
        else:
            worlds.robot.command_cartesian.action('right', numbers, period_s=0.02)
    worlds.advance(STEPS)
    alone.advance(STEPS)
    assert worlds.digest()[0] == alone.digest()


@pytest.mark.full
def test_ends_of_the_reach_and_of_grips_are_told_as_by_python(at_once):
    world, went_on, grips = compose('Panda'), 0, []
    worlds, alone = Worlds(world, 1, 1), Simulation(world)
    BY_PYTHON.append(alone.periods)
    first = worlds.simulations[0]
    for simulation in (alone, first):
        simulation.robot.set_control_mode('arm', 'effort')
    for along in 120 * [0.8] + 40 * [-0.8] + 120 * [0.8]:
        action = np.array([along, 0.0, 0.0, 0.0, 0.0, 0.0])
        worlds.robot.command_cartesian.action('right', action[None], period_s=0.02)
        alone.robot.apply(alone.robot.parse_cartesian.action('right', action), period_s=0.02)
        if not grips:
            grips = [simulation.robot.parse.action('right/gripper', [-1.0])
                     for simulation in (alone, first)]
            alone.robot.apply(grips[0])
            first.robot.apply(grips[1])
        worlds.advance(STEPS)
        alone.advance(STEPS)
        _same(first, alone)
        assert grips[0].handle.status is grips[1].handle.status
        went_on += first.physics.standing[BECAME] == WENT_ON
    _same_digest(first, alone)
    assert went_on > 100 and not grips[0].handle.is_active
    assert alone.robot.joints.cartesian.reports['right'].unreachable > 1


@pytest.mark.full
@pytest.mark.parametrize('seed', [3, 4, 8, 101, 102, 103])
def test_worlds_go_on_by_themselves_as_by_python_whatever_comes_between(seed, at_once):
    draw, went_on = np.random.default_rng(seed), 0
    world, kinds = _compose(seed % 3 == 0), ALL_KINDS[:None if seed % 3 == 0 else -1]
    worlds, alone = Worlds(world, 2, 1), Simulation(world)
    BY_PYTHON.append(alone.periods)
    kind, steps, saved = 'stream', STEPS, []
    first = worlds.simulations[0]
    with worlds:
        for period in range(200):
            if draw.random() < 0.15:
                for act in _BETWEEN[draw.integers(len(_BETWEEN))]:
                    for simulation in (alone, first):
                        with contextlib.suppress(CommandError):
                            act(simulation.robot)
            if draw.random() < 0.1:
                for simulation in (alone, first):
                    simulation.reset(period)
                    simulation.model.opt.density = 0.0
                    simulation.data.xfrc_applied[:] = 0.0
                    _prepare(simulation.robot, kind)
                    simulation.robot.set_reflex('arm', 'velocity', 0.0)
                    simulation.robot.sensing.set('latency.state', 0.0)
            if draw.random() < 0.03:
                saved = [alone.save(), first.save()]
            elif saved and draw.random() < 0.03:
                alone.restore(saved[0])
                first.restore(saved[1])
            if draw.random() < 0.05:
                kind = draw.choice(kinds)
                steps = int(draw.choice([STEPS, 4]))
            _command(kind, worlds, alone, period, steps)
            worlds.advance(steps)
            with contextlib.suppress(DivergenceError):
                alone.advance(steps)
            went_on += first.physics.standing[GONE_ON] > 0
            _same(first, alone)
            if draw.random() < 0.2:
                _same_digest(first, alone)
    assert went_on > 10


def test_a_period_of_very_many_steps_is_run_in_parts(at_once):
    states = []
    for steps in ([1500], [900, 600]):
        simulation = Simulation(compose('Panda'))
        robot = simulation.robot
        robot.apply(*robot.parse.joint_command(robot.joints.names[:1], position=[0.5]))
        for count in steps:
            simulation.advance(count)
        states.append(simulation.data.qpos.tolist())
    assert all(at_once) and len(at_once) >= 3
    np.testing.assert_allclose(*states, atol=1e-6)


def test_two_robots_whose_grippers_move_are_stepped_together_as_by_python(at_once):
    states = []
    for by_python in (False, True):
        robots = [compose_robot(name, idn=number, gripper='default')
                  for number, name in enumerate(('Panda', 'UR5e'))]
        robots[1].set_base_xpos([0.0, 1.5, 0.0])
        simulation = Simulation(World(robots))
        if by_python:
            BY_PYTHON.append(simulation.periods)
        found = []
        for period in range(30):
            for robot in simulation.robots.values():
                names = robot.joints.names
                goal = robot.joints.setpoints.position + 0.01 * np.cos(0.2 * period)
                robot.apply(*robot.parse.joint_command(list(names), position=goal),
                            robot.parse.action('right/gripper', [1.0 if period < 15 else -1.0]),
                            period_s=0.02)
            simulation.advance(STEPS)
            found.append([simulation.digest(), *simulation.data.qpos])
        states.append(found)
    assert states[0] == states[1]
    assert at_once and all(at_once)
