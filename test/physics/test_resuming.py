# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A period begins with the half of a step that the period before has not computed already."""

import mujoco
import numpy as np
import pytest
from robot_kinds import KINDS

from manip_sim.errors import DivergenceError
from manip_sim.models import compose
from manip_sim.models.arenas import create_arena
from manip_sim.physics import physics_steps as module
from manip_sim.physics.physics import BECAME, STEPS, STOOD
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.simulation import control_period, Simulation
from manip_sim.simulation.compiled_period import CompiledPeriod, load
from manip_sim.simulation.control_period import ControlPeriods

EVERYTHING = int(mujoco.mjtState.mjSTATE_INTEGRATION)
PERIODS = 80


def whole_state(simulation):
    """Return all that the next step depends on, and what was computed of it."""
    data = simulation.data
    state = np.empty(mujoco.mj_stateSize(simulation.model, EVERYTHING))
    mujoco.mj_getState(simulation.model, data, state, EVERYTHING)
    wrenches = [reader.external_wrench(data)
                for reader in simulation.robot.end_effectors.values()]
    return np.concatenate([state, data.qacc, data.sensordata, data.qfrc_actuator, *wrenches])


def run(name, integrator, between=lambda simulation, period: None):
    """Return the states after each period of a robot that flails about, and the contacts."""
    simulation = Simulation(compose(name, arena=create_arena('table', cube=True)))
    simulation.model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator}')
    robot, random = simulation.robot, np.random.default_rng(1)
    names = [joint for joint in robot.parts['arm'].driven_joints if joint]
    low, high = np.clip(robot.limits('arm'), -3.0, 3.0).T
    states, contacts = [], []
    for period in range(PERIODS):
        if period % 3 == 0:
            robot.apply(*robot.parse.joint_command(names, random.uniform(low, high)),
                        *(robot.parse.action(part, random.uniform(-1, 1, gripper.part.gripper.dof))
                          for part, gripper in robot.grippers.items()))
        simulation.advance((1, 5, 7)[period % 3])
        between(simulation, period)
        states.append(whole_state(simulation))
        contacts.append(simulation.data.ncon)
    assert simulation.diverged is None
    return np.array(states), contacts


@pytest.fixture
def count(monkeypatch):
    """Return a list that grows by the name of each part of a step that is not a whole one."""
    parts = []

    def counted(name, function):
        def call(model, data):
            parts.append(name)
            function(model, data)
        return call
    for name in ('mj_step2', 'mj_implicit'):
        monkeypatch.setattr(mujoco, name, counted(name, getattr(mujoco, name)))
    take = PhysicsSteps.take_resumes

    def taken(steps):
        resumes = take(steps)
        parts.extend(['mj_step2'] * resumes)
        return resumes
    monkeypatch.setattr(PhysicsSteps, 'take_resumes', taken)
    run_law = CompiledPeriod.run

    def ran(period):
        run_law(period)
        begins, _, resumes, *_ = period.orders.tolist()
        parts.extend(['mj_step2'] * (begins and resumes))
    monkeypatch.setattr(CompiledPeriod, 'run', ran)
    advance, go_on, advanced = ControlPeriods.advance, control_period.go_on, []

    def advancing(periods, steps):
        advanced[:] = [periods]
        advance(periods, steps)

    def going_on(rows, table, *rest):
        go_on(rows, table, *rest)
        if table[0, BECAME] != STOOD:
            _, _, resumes, *_ = advanced[0].compiled.orders.tolist()
            parts.extend(['', 'mj_step2', 'mj_implicit'][resumes:resumes + 1] * (resumes > 0))
    monkeypatch.setattr(ControlPeriods, 'advance', advancing)
    monkeypatch.setattr(control_period, 'go_on', going_on)
    return parts


@pytest.mark.full
@pytest.mark.parametrize('name', KINDS)
@pytest.mark.parametrize('integrator', ['EULER', 'IMPLICITFAST'])
def test_the_states_are_those_of_whole_steps_to_the_last_bit(
        name, integrator, monkeypatch, count):
    resumed, contacts = run(name, integrator)
    assert len(count) >= PERIODS - 1 and max(contacts) > 0
    count.clear()
    monkeypatch.setattr(module, '_RESUMABLE', ())
    whole, _ = run(name, integrator)
    assert not count
    assert np.array_equal(resumed, whole)


@pytest.mark.full
@pytest.mark.parametrize('name', ['Panda', 'Baxter', 'PandaOmron'])
@pytest.mark.parametrize('integrator, part', [
    ('EULER', 'mj_step2'), ('IMPLICITFAST', 'mj_implicit')])
def test_periods_at_rest_only_integrate_first_and_are_whole_steps_to_the_last_bit(
        name, integrator, part, monkeypatch, count):
    def rest():
        simulation = Simulation(compose(name, arena=create_arena('table', cube=True)))
        simulation.model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator}')
        states = []
        for period in range(40):
            if period == 20:  # Something falls: not all has been computed.
                simulation.data.joint('cube_joint').qpos[2] += 0.05
            if period == 30:  # Something is pushed: only what forces depend on was not.
                simulation.data.xfrc_applied[simulation.model.body('cube').id, 0] = 0.2
            simulation.advance(5)
            states.append(whole_state(simulation))
        return np.array(states)
    resumed = rest()
    assert set(count) == {part, 'mj_step2'}
    assert count.count(part) > 20
    count.clear()
    monkeypatch.setattr(module, '_RESUMABLE', ())
    assert np.array_equal(resumed, rest())
    assert not count


def test_other_integrators_take_whole_steps(count):
    run('Panda', 'RK4')
    assert not count


def shift(simulation, period):
    """Move the cube, or turn a joint, without any computation of what follows from that."""
    if period % 4 == 1:
        simulation.data.joint('cube_joint').qpos[2] += 0.02
    if period % 4 == 3:
        simulation.data.qvel[0] += 0.1


def test_positions_and_velocities_that_were_changed_from_outside_are_noticed(monkeypatch, count):
    resumed, _ = run('Panda', 'IMPLICITFAST', shift)
    assert 0.4 * PERIODS < len(count) < 0.6 * PERIODS
    monkeypatch.setattr(module, '_RESUMABLE', ())
    whole, _ = run('Panda', 'IMPLICITFAST', shift)
    assert np.array_equal(resumed, whole)


@pytest.mark.parametrize('by_law', [True, False])
def test_a_divergence_at_rest_is_told_and_held(by_law, monkeypatch):
    monkeypatch.setattr(ControlPeriods, '_lets_laws_step', lambda periods, awake: by_law)
    simulation = Simulation(compose('Panda', arena=create_arena('table', cube=True)))
    simulation.advance(5)
    # Faster and faster, until it is too fast in the 21st period.
    simulation.data.xfrc_applied[simulation.model.body('cube').id, 0] = 0.1 * 5e4
    with pytest.raises(DivergenceError):
        for _ in range(30):
            simulation.advance(5)
    assert simulation.diverged == 'the physics diverged at 0.220 s: a velocity is above 10000'
    assert simulation.step_count == 110 and not simulation.idle
    assert not simulation.data.warning.number.any() and not simulation.data.qvel.any()


def test_a_world_that_is_asked_whether_it_is_idle_goes_on(panda_sim):
    load()
    for _ in range(3):
        panda_sim.advance(5)
    assert panda_sim.physics.standing[STEPS] == 5
    assert panda_sim.idle
    assert panda_sim.physics.standing[STEPS] == 5


def test_a_simulation_is_idle_only_while_no_command_is_under_way(panda_sim):
    robot, joint = panda_sim.robot, 'robot0_joint1'
    panda_sim.advance(5)
    assert panda_sim.idle

    def wait():
        for period in range(500):
            panda_sim.advance(5)
            if panda_sim.idle:
                return period
        return None
    here = robot.state().position[0]
    robot.apply(*robot.parse.joint_command([joint], [here + 0.1]))
    assert not panda_sim.idle
    assert wait() > 10
    robot.apply(robot.parse.action('right/gripper', [1.0]))
    assert not panda_sim.idle
    assert wait() > 10
    robot.apply(robot.parse.trajectory(
        'arm', [joint], [0.1], [[here]], start_ns=panda_sim.time_ns + 100_000_000,
        now_ns=panda_sim.time_ns))
    assert wait() >= 19
    robot.set_control_mode('arm', 'effort')
    robot.set_command_timeout('arm', 0.2)
    robot.apply(*robot.parse.joint_command([joint], [], [], [1.0]))
    assert wait() >= 19
    assert sum(robot.joints.timeouts.values()) == 1
