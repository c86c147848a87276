# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Gravity compensation of a robot that stands on the floor by its own weight."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose, load_robot
from manip_sim.simulation.compiled_period import load
from manip_sim.simulation.control_period import ControlPeriods

ROBOT = """
<body name="base" pos="0 0 0.1">
  <freejoint/>
  <geom type="box" size="0.3 0.2 0.1" mass="30"/>
  <body name="link1" pos="0 0 0.3">
    <joint name="shoulder" axis="0 1 0" range="-2 2" damping="2"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="2"/>
    <body name="link2" pos="0.4 0 0">
      <joint name="elbow" axis="0 1 0" range="-2 2" damping="2"/>
      <geom type="capsule" fromto="0 0 0 {reach} 0 0" size="0.02" mass="{mass}"/>
      <body name="right_hand" pos="{reach} 0 0"/>
    </body>
  </body>
</body>"""
SERVOS = """
<actuator>
  <position name="s" joint="shoulder" kp="300" kv="20" forcerange="-500 500"/>
  <position name="e" joint="elbow" kp="300" kv="20" forcerange="-500 500"/>
</actuator>"""
GRAVITY = 9.81


@pytest.fixture
def standing(mjcf, run):
    """Return a function that makes a simulation of the robot and lets it stand for a while."""
    def make(mass=1.0, reach=0.3, seconds=2.0, **options):
        from manip_sim.simulation import Simulation
        robot = load_robot(mjcf(ROBOT.format(mass=mass, reach=reach), SERVOS))
        simulation = Simulation(compose(robot, 'none', 'none', **options))
        run(simulation, seconds)
        return simulation
    return make


def ground_force(simulation):
    """Return the force of the floor [N] and where along x it acts [m]."""
    model, data = simulation.model, simulation.data
    forces, places = [], []
    for number, contact in enumerate(data.contact):
        force = np.empty(6)
        mujoco.mj_contactForce(model, data, number, force)
        world = contact.frame.reshape(3, 3).T @ force[:3]
        forces.append(world if model.geom_bodyid[contact.geom1] == 0 else -world)
        places.append(contact.pos[0])
    forces = np.array(forces)
    return forces.sum(axis=0), (forces[:, 2] @ places) / forces[:, 2].sum()


def test_actuators_carry_what_hangs_on_them(standing):
    simulation = standing()
    state = simulation.robot.state()
    np.testing.assert_allclose(state.position, 0.0, atol=1e-3)
    # Torque of level links about the y axis, which points so that lowering is positive.
    elbow = -1.0 * GRAVITY * 0.15
    shoulder = -2.0 * GRAVITY * 0.2 - 1.0 * GRAVITY * 0.55
    np.testing.assert_allclose(state.effort, [shoulder, elbow], rtol=0.01)


def test_the_floor_carries_the_whole_robot_where_its_mass_is(standing):
    simulation = standing()
    force, place = ground_force(simulation)
    np.testing.assert_allclose(force, [0.0, 0.0, 33.0 * GRAVITY], atol=0.01 * 33.0 * GRAVITY)
    assert place == pytest.approx(simulation.data.subtree_com[1, 0], abs=2e-3)


def test_it_falls_over_when_its_arm_is_too_heavy(standing):
    simulation = standing(mass=40.0, reach=0.6, seconds=3.0)
    assert simulation.data.body('robot0_base').xmat[0] < 0.95


def test_without_compensation_the_arm_sags_and_the_floor_feels_the_same(standing):
    simulation = standing(gravity_compensation=False)
    assert simulation.robot.state().position[0] > 0.01
    force, _ = ground_force(simulation)
    assert force[2] == pytest.approx(33.0 * GRAVITY, rel=0.01)


def test_objects_that_come_do_not_change_that(standing, run):
    from manip_sim.models.object_creation import create_object
    from manip_sim.physics.object_spawning import plan_with
    simulation = standing()
    simulation.change_objects(plan_with(simulation.plan, create_object(
        {'name': 'far', 'shape': 'sphere', 'size': 0.05, 'mass': 1, 'position': [5, 0, 2]})))
    run(simulation, 0.5)
    np.testing.assert_allclose(simulation.robot.state().position, 0.0, atol=1e-3)
    force, _ = ground_force(simulation)
    assert force[2] == pytest.approx(33.0 * GRAVITY, rel=0.02)
    run(simulation, 0.1)
    simulation.reset()
    run(simulation, 1.0)
    np.testing.assert_allclose(simulation.robot.state().position, 0.0, atol=1e-3)


def test_the_model_that_is_written_does_not_float(mjcf):
    robot = load_robot(mjcf(ROBOT.format(mass=1.0, reach=0.3), SERVOS))
    model = mujoco.MjModel.from_xml_string(compose(robot, 'none', 'none').to_xml())
    assert not model.body_gravcomp.any()


@pytest.mark.parametrize('integrator', ['EULER', 'IMPLICITFAST'])
def test_compiled_steps_are_those_of_python_to_the_last_bit(standing, integrator, monkeypatch):
    digests, by_law, lets = [], [], ControlPeriods._lets_laws_step

    def counted(periods, awake):
        by_law.append(lets(periods, awake))
        return by_law[-1]
    load()
    for lets_laws_step in (counted, lambda periods, awake: False):
        monkeypatch.setattr(ControlPeriods, '_lets_laws_step', lets_laws_step)
        simulation = standing(seconds=0.0)
        simulation.model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator}')
        robot, draw = simulation.robot, np.random.default_rng(1)
        for period in range(60):
            if 20 < period < 40:  # Before and after that it stands by itself.
                robot.apply(*robot.parse.joint_command(
                    robot.joint_names, draw.uniform(-0.5, 0.5, 2)))
            simulation.advance(5)
            digests.append(simulation.digest())
    assert digests[:60] == digests[60:] and len(set(digests)) == 60
    assert len(by_law) >= 20 and all(by_law)
