# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control periods in compiled code are those of ticks and steps by Python, to the last bit."""

import contextlib

import mujoco
import numpy as np
import pytest
from robot_kinds import KINDS

from manip_sim.errors import DivergenceError
from manip_sim.models import compose, compose_robot
from manip_sim.models.arenas import create_arena
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.compiled_period import CompiledPeriod
from manip_sim.simulation.control_period import ControlPeriods
from manip_sim.worlds import Worlds

COUNT, PERIODS, STEPS = 3, 70, 10
EVERYTHING = int(mujoco.mjtState.mjSTATE_INTEGRATION)


#: The periods of simulations whose steps Python runs.
BY_PYTHON: list[ControlPeriods] = []


@pytest.fixture
def at_once(monkeypatch):
    """Return a list that grows by whether compiled code runs what is left of a period."""
    done, begin, may = [], ControlPeriods._begin_runs, CompiledPeriod.may_run

    def begun(periods, awake):
        if periods in BY_PYTHON:
            return []
        runs = begin(periods, awake)
        if awake:
            done.append(bool(runs))
        return runs
    monkeypatch.setattr(ControlPeriods, '_begin_runs', begun)
    monkeypatch.setattr(
        CompiledPeriod, 'may_run', lambda compiled, steps: may(compiled, steps) and compiled not in
        [periods.compiled for periods in BY_PYTHON])
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


def test_a_period_of_very_many_steps_takes_no_room_for_notes(at_once):
    states = []
    for steps in ([1500], [900, 600]):
        simulation = Simulation(compose('Panda'))
        robot = simulation.robot
        robot.apply(*robot.parse.joint_command(robot.joints.names[:1], position=[0.5]))
        for count in steps:
            simulation.advance(count)
        states.append(simulation.data.qpos.tolist())
    assert False in at_once and True in at_once
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
                goal = robot.joints._setpoints.position + 0.01 * np.cos(0.2 * period)
                robot.apply(*robot.parse.joint_command(list(names), position=goal),
                            robot.parse.action('right/gripper', [1.0 if period < 15 else -1.0]),
                            period_s=0.02)
            simulation.advance(STEPS)
            found.append([simulation.digest(), *simulation.data.qpos])
        states.append(found)
    assert states[0] == states[1]
    assert at_once and all(at_once)
