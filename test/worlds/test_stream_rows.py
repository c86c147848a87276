# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Streams that Worlds holds in rows: equal to simulations, and given back to whoever asks."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError, DivergenceError
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

COUNT, STEPS = 5, 10
OTHER = 2
PERIOD_S = 0.02


class Streams:
    """Worlds, and a simulation for each of them, whose arms follow the same streams."""

    def __init__(self):
        self.worlds = Worlds(compose('Panda', arena='table'), COUNT, threads=2)
        self.simulations = [Simulation(compose('Panda', arena='table')) for _ in range(COUNT)]
        self.names = self.worlds.robot.joint_names[:7]
        self._start = self.worlds.robot.state().position[:, :7]
        self._number = 0

    def goals(self):
        self._number += 1
        time_s = self._number * PERIOD_S
        phases = np.arange(COUNT)[:, None]
        return self._start + 0.1 * (np.sin(2.0 * time_s + phases) - np.sin(phases))

    def command(self, goals=None, where=None):
        goals = self.goals() if goals is None else goals
        self.worlds.robot.command.joint_command(
            self.names, position=goals, where=where, period_s=PERIOD_S)
        for world, simulation in enumerate(self.simulations):
            if where is None or where[world]:
                robot = simulation.robot
                robot.apply(*robot.parse.joint_command(self.names, position=goals[world]),
                            period_s=PERIOD_S)

    def advance(self):
        self.worlds.advance(STEPS)
        for simulation in self.simulations:
            if simulation.diverged is None:
                with contextlib.suppress(DivergenceError):
                    simulation.advance(STEPS)

    def stream(self, periods):
        for _ in range(periods):
            self.command()
            self.advance()

    def both(self, act, world=OTHER):
        """Do the same in a world and in its simulation."""
        for simulation in (self.worlds.simulations[world], self.simulations[world]):
            act(simulation)

    @property
    def held(self):
        """Which worlds have given the state of their joints to rows."""
        return [simulation.robot.joints.holder is not None
                for simulation in self.worlds.simulations]

    def check_equal(self):
        assert self.worlds.digest() == [of.digest() for of in self.simulations]

    def save(self):
        self._saved = self.worlds.save(), self._number

    def restore(self):
        states, self._number = self._saved
        self.worlds.restore(states)
        for simulation, state in zip(self.simulations, states):
            simulation.restore(state)


@pytest.fixture(scope='module')
def module_streams():
    streams = Streams()
    streams.stream(40)
    streams.save()
    yield streams
    streams.worlds.close()


@pytest.fixture
def streams(module_streams):
    """Return worlds whose streams are held in rows."""
    module_streams.restore()
    module_streams.stream(3)
    assert all(module_streams.held)
    return module_streams


def reset(simulation):
    simulation.reset()


def restore(simulation):
    simulation.restore(simulation.save())


def change_mode(simulation):
    simulation.robot.set_control_mode('arm', 'velocity')


def command_a_joint(simulation):
    robot = simulation.robot
    robot.apply(*robot.parse.joint_command(robot.joint_names[3:4], position=[-1.5]))


def command_late(simulation):
    simulation.robot.sensing.set('latency.command', 0.03)
    command_a_joint(simulation)
    simulation.robot.sensing.set('latency.command', 0.0)


def close_the_gripper(simulation):
    simulation.robot.apply(simulation.robot.parse.action('right/gripper', [1.0]))


def plan_a_trajectory(simulation):
    robot = simulation.robot
    robot.apply(robot.parse.trajectory('arm', robot.joint_names[:2], [0.5], [[0.1, 0.1]]))


def set_a_timeout(simulation):
    simulation.robot.set_command_timeout('arm', 0.03)


def arm_a_reflex(simulation):
    simulation.robot.set_reflex('arm', 'velocity', 0.01)


def change_what_a_stream_is(simulation):
    simulation.robot.set_stream('arm', longest_s=0.01)


def push_a_joint(simulation):
    simulation.data.qvel[0] += 0.05


def diverge(simulation):
    simulation.data.qvel[0] = 1e7


@pytest.mark.full
@pytest.mark.parametrize(('act', 'commanded'), [
    *((act, False) for act in (
        reset, restore, change_mode, command_a_joint, command_late, close_the_gripper,
        plan_a_trajectory, set_a_timeout, arm_a_reflex, change_what_a_stream_is, push_a_joint,
        diverge)),
    *((act, True) for act in (
        reset, restore, change_mode, command_a_joint, command_late, diverge))])
def test_what_happens_to_one_world_happens_as_in_its_simulation(streams, act, commanded):
    if commanded:  # While goals wait for the next period.
        streams.command()
    streams.both(act)
    if not commanded:
        with contextlib.suppress(CommandError):  # In another mode they are no goals.
            streams.command(where=np.arange(COUNT) != OTHER)
    streams.advance()
    where = np.array([act is not change_mode or world != OTHER for world in range(COUNT)])
    for _ in range(8):
        streams.command(where=where)
        streams.advance()
    streams.check_equal()


@pytest.mark.full
def test_a_timeout_that_is_set_ends_a_stream_as_in_its_simulation(streams):
    streams.both(set_a_timeout)
    for _ in range(4):
        streams.advance()
    streams.check_equal()
    assert streams.worlds.robot[OTHER].joints.timeouts == (
        streams.simulations[OTHER].robot.joints.timeouts)


@pytest.mark.full
@pytest.mark.parametrize('read', [
    lambda simulation: simulation.digest(),
    lambda simulation: pickled(simulation.save()),
    lambda simulation: simulation.robot.controller_state('arm').reference.position.tobytes(),
    lambda simulation: simulation.robot.joints.moving,
    lambda simulation: [command.values.tobytes()
                        for command in simulation.robot.joints.commands.running],
])
def test_a_world_reads_as_its_simulation_while_its_stream_is_held(streams, read):
    for _ in range(3):
        streams.stream(1)
        assert all(streams.held)
        assert read(streams.worlds.simulations[OTHER]) == read(streams.simulations[OTHER])
    streams.command()
    assert read(streams.worlds.simulations[OTHER]) == read(streams.simulations[OTHER])
    streams.stream(1)
    streams.check_equal()


def pickled(state):
    return state.physics, state.control_steps, state.gains


@pytest.mark.full
def test_a_controller_that_somebody_keeps_is_up_to_date(streams):
    joints = streams.worlds.simulations[0].robot.joints
    streams.stream(2)
    assert joints._setpoints.position.tolist() == (
        streams.simulations[0].robot.joints._setpoints.position.tolist())


@pytest.mark.full
def test_worlds_that_are_reset_leave_the_others_in_rows(streams):
    where = np.arange(COUNT) == OTHER
    streams.worlds.reset(where=where)
    streams.simulations[OTHER].reset()
    streams.stream(20)
    assert streams.held == (~where).tolist()
    streams.check_equal()


@pytest.mark.full
def test_streams_end_as_in_simulations_when_nothing_comes(streams):
    for _ in range(60):
        streams.advance()
    assert not any(streams.held)
    streams.check_equal()
    assert not streams.worlds.robot[0].moving


def test_some_worlds_may_wait_while_others_go_on(streams):
    where = np.arange(COUNT) > 0
    streams.command()
    streams.worlds.advance(STEPS, where=where)
    for simulation in streams.simulations[1:]:
        simulation.advance(STEPS)
    streams.stream(5)
    streams.check_equal()


def test_a_command_is_replaced_by_a_stream_that_is_held(streams):
    robot = streams.worlds.robot[OTHER]
    goals = streams.goals()
    command, = robot.parse.joint_command(streams.names, position=goals[OTHER])
    streams.command(goals, where=np.arange(COUNT) != OTHER)
    robot.apply(command, period_s=PERIOD_S)
    same, = streams.simulations[OTHER].robot.parse.joint_command(
        streams.names, position=goals[OTHER])
    streams.simulations[OTHER].robot.apply(same, period_s=PERIOD_S)
    streams.advance()
    streams.advance()
    assert command.handle.status is Status.RUNNING
    streams.command()
    assert command.handle.status is Status.REPLACED
    streams.advance()
    streams.check_equal()


@pytest.mark.parametrize(('change', 'message'), [
    (lambda goals: np.full_like(goals, np.nan), None),
    (lambda goals: np.where(np.arange(COUNT)[:, None] == OTHER, np.inf, goals), 'world 2: .*inf'),
    (lambda goals: goals[:, :5], 'world 0: .* 7 numbers'),
])
def test_goals_that_are_none_leave_streams_as_they_are(streams, change, message):
    goals = change(streams.goals())
    with pytest.raises(CommandError, match=message) if message else contextlib.nullcontext():
        streams.worlds.robot.command.joint_command(streams.names, position=goals)
    streams.stream(3)
    streams.check_equal()


def test_goals_beyond_a_range_are_clamped_in_rows_too(streams):
    goals = streams.goals()
    goals[OTHER, 3] = 1.0
    streams.command(goals)
    streams.advance()
    streams.stream(5)
    streams.check_equal()


@pytest.mark.full
def test_states_of_streams_are_late_to_the_timestep_as_those_of_a_simulation(streams):
    streams.both(lambda simulation: simulation.robot.sensing.set('latency.state', 0.034))
    streams.stream(6)
    assert streams.held[OTHER]
    streams.check_equal()
    late, truth = (simulation.robot for simulation in (
        streams.worlds.simulations[OTHER], streams.simulations[OTHER]))
    np.testing.assert_array_equal(late.measured(), truth.measured())
    assert np.abs(late.measured() - late.reader.exact()).max() > 1e-4
    streams.both(lambda simulation: simulation.robot.sensing.set('latency.state', 0.0))
