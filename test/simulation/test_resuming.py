# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A period begins with the half of a step that the period before has not computed already."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.models.arenas import create_arena
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation, simulation as module

EVERYTHING = int(mujoco.mjtState.mjSTATE_INTEGRATION)
PERIODS = 80


def whole_state(simulation):
    """Return all that the next step depends on, and what was computed of it."""
    data = simulation.data
    state = np.empty(mujoco.mj_stateSize(simulation.model, EVERYTHING))
    mujoco.mj_getState(simulation.model, data, state, EVERYTHING)
    return np.concatenate([state, data.qacc, data.sensordata, data.qfrc_actuator])


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
    """Return a list that grows with each second half of a step."""
    halves, step2 = [], mujoco.mj_step2

    def counted(model, data):
        halves.append(1)
        step2(model, data)
    monkeypatch.setattr(mujoco, 'mj_step2', counted)
    return halves


@pytest.mark.parametrize('name', robot_names())
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
