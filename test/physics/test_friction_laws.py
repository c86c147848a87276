# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Friction and torque limits that follow the velocity, against the formulas."""

from hypothesis import given, settings, strategies
import numpy as np
import pytest

from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.robots import create_robot, robot_names
from manip_sim.simulation import Simulation

JOINT = 'robot0_joint7'
FRICTION = {'coulomb': 0.5, 'static': 1.0, 'stribeck_velocity': 0.1}
CURVE = {'knee': 1.0, 'no_load': 2.0}


@pytest.fixture
def sim_of():
    def make(**actuation):
        world = compose('Panda')
        if actuation:
            world.robots[0].set_actuation('arm', **actuation)
        simulation = Simulation(world)
        simulation.robot.set_control_mode('arm', 'effort')
        return simulation
    return make


def push(simulation, effort, periods):
    robot = simulation.robot
    robot.apply(*robot.parse.joint_command([JOINT], effort=[effort]))
    for _ in range(periods):
        simulation.advance(5)
    return simulation.data.joint(JOINT).qvel[0]


def test_a_joint_moves_only_when_the_torque_exceeds_its_static_friction(sim_of):
    simulation = sim_of(friction=FRICTION)
    assert abs(push(simulation, 0.97, 100)) < 1e-6
    assert push(simulation, 1.03, 100) > 0.05


def test_at_speed_friction_is_what_the_stribeck_curve_says(sim_of):
    simulation = sim_of(friction={**FRICTION, 'viscous': 2.0})
    for torque in (1.2, 2.0, 4.0):
        simulation.reset()
        speed = push(simulation, torque, 60)
        resistance = 0.5 + 0.5 / (1.0 + (speed / 0.1)**2) + 2.0 * speed
        assert resistance == pytest.approx(torque, rel=0.01)


def test_a_motor_reaches_the_speed_at_which_its_torque_equals_the_friction(sim_of):
    simulation = sim_of(friction={'coulomb': 0.5, 'viscous': 0.5}, torque_speed=CURVE)
    speed = push(simulation, 12.0, 60)
    # 12 N m are left in full up to 1 rad/s, and nothing at 2 rad/s.
    assert 12.0 * (2.0 - speed) == pytest.approx(0.5 + 0.5 * speed, rel=0.01)


def test_braking_has_all_of_the_torque_at_any_speed(sim_of):
    simulation = sim_of(torque_speed=CURVE)
    push(simulation, 12.0, 100)
    assert simulation.data.joint(JOINT).qvel[0] > 1.5
    push(simulation, -12.0, 1)
    effort = simulation.robot.state().effort[simulation.robot.joint_names.index(JOINT)]
    assert effort == pytest.approx(-12.0, rel=1e-3)


def test_armature_is_the_inertia_that_a_torque_accelerates(sim_of):
    speeds = {armature: push(sim_of(friction={'coulomb': 0.0, 'viscous': 0.0},
                                    armature=armature), 0.5, 1)
              for armature in (0.5, 2.0)}
    inertia = {armature: 0.5 * 0.01 / speed for armature, speed in speeds.items()}
    assert inertia[2.0] - inertia[0.5] == pytest.approx(1.5, rel=0.02)


def test_without_actuation_nothing_changes_and_off_is_off(sim_of):
    plain, off = sim_of(), sim_of(friction={'coulomb': 0.0}, armature=0.1)
    for simulation in (plain, off):
        push(simulation, 1.0, 20)
    assert plain.data.qpos.tobytes() == off.data.qpos.tobytes()
    assert plain.robot.robot_model.friction_laws == {}


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
def test_a_saved_state_continues_to_the_last_bit(sim_of, mode):
    simulation = sim_of(friction=FRICTION, torque_speed=CURVE)
    robot = simulation.robot
    robot.set_control_mode('arm', mode)
    robot.apply(*robot.parse.joint_command(
        list(robot.joint_names[:7]), **{mode: [0.3, -0.4, 0.2, -1.8, 0.1, 1.2, 0.6]}))
    for _ in range(7):
        simulation.advance(5)
    state = simulation.save()
    digests = []
    for _ in range(2):
        simulation.restore(state)
        for _ in range(9):
            simulation.advance(5)
        digests.append(simulation.digest())
    world = compose('Panda')
    world.robots[0].set_actuation('arm', friction=FRICTION, torque_speed=CURVE)
    other = Simulation(world)
    other.restore(state)
    for _ in range(9):
        other.advance(5)
    assert {*digests, other.digest()} == {digests[0]}


def test_a_spawned_object_leaves_the_laws_in_force(sim_of):
    from manip_sim.models.object_creation import create_objects
    from manip_sim.physics.object_spawning import plan_with
    simulation = sim_of(friction=FRICTION)
    (item,) = create_objects([{'name': 'box', 'shape': 'box', 'size': [0.1, 0.1, 0.1],
                               'mass': 0.5, 'position': [0.8, 0.6, 0.05]}])
    simulation.change_objects(plan_with(simulation.plan, item))
    assert abs(push(simulation, 0.97, 50)) < 1e-6
    assert push(simulation, 1.03, 100) > 0.05


@pytest.mark.parametrize('name', robot_names())
def test_the_catalogue_has_values_with_sources_for_the_arm_of_each_robot(name):
    robot = create_robot(name)
    robot.set_actuation('arm', friction='catalogue', torque_speed='catalogue')
    assert list(robot.friction_laws) == robot.arm_joints
    for law in robot.friction_laws.values():
        assert 0.0 < law.coulomb < law.static
        assert 0.0 <= law.knee < law.no_load
    file = robot.file.parent / 'actuators.yaml'
    text = file.read_text()
    assert 'sources:' in text and ('Guess' in text or 'guess' in text)


@pytest.mark.full
@pytest.mark.parametrize('name', robot_names())
def test_a_robot_with_all_of_the_catalogue_follows_steps_and_comes_to_rest(name):
    world = compose(name)
    world.robots[0].set_actuation('arm', friction='catalogue', torque_speed='catalogue')
    simulation = Simulation(world)
    robot = simulation.robot
    joints = world.robots[0].arm_joints
    start = np.array([simulation.data.joint(joint).qpos[0] for joint in joints])
    robot.apply(*robot.parse.joint_command(joints, position=start + 0.1))
    for _ in range(200):
        simulation.advance(5)
    reached = np.array([simulation.data.joint(joint).qpos[0] for joint in joints])
    np.testing.assert_allclose(reached, start + 0.1, atol=0.03)
    assert np.abs([simulation.data.joint(joint).qvel[0] for joint in joints]).max() < 0.002


def test_dynamics_reports_the_laws(sim_of):
    joint = sim_of(friction=FRICTION, torque_speed=CURVE).robot.dynamics()[JOINT]
    assert (joint.friction_loss, joint.static_friction, joint.stribeck_velocity) == (0.5, 1.0, 0.1)
    assert (joint.knee_velocity, joint.no_load_velocity) == (1.0, 2.0)
    assert joint.effort_range == (-12.0, 12.0)


@pytest.mark.parametrize('actuation, message', [
    ({'friction': 'catalog'}, "did you mean 'catalogue'"),
    ({'friction': {'colomb': 1.0}}, "did you mean 'coulomb'"),
    ({'friction': {'coulomb': -1.0}}, 'finite number from 0'),
    ({'friction': {'coulomb': [0.1, 0.2]}}, 'needs 1 or 7 numbers, got 2'),
    ({'friction': {'coulomb': 1.0, 'static': 2.0}}, 'belong together'),
    ({'friction': {'coulomb': 2.0, 'static': 1.0, 'stribeck_velocity': 0.1}}, 'at least'),
    ({'torque_speed': {'knee': 2.0, 'no_load': 2.0}}, "'no_load' must be above 'knee'"),
    ({'torque_speed': {'knee': 2.0}}, "needs 'no_load'"),
    ({'armature': float('nan')}, 'armature of arm of Panda0 must be a finite number'),
    ({'armature': 'light'}, "got 'light'")])
def test_values_that_cannot_be_used_are_rejected(actuation, message):
    with pytest.raises(ManipSimError, match=message):
        create_robot('Panda').set_actuation('arm', **actuation)


def test_a_subsystem_that_is_not_there_is_named():
    with pytest.raises(UnknownNameError, match='arms'):
        create_robot('Panda').set_actuation('arms', friction='catalogue')
    with pytest.raises(ModelError, match='torso of Panda0: it has no such joints'):
        create_robot('Panda').set_actuation('torso', friction='catalogue')


ANYTHING = strategies.recursive(
    strategies.none() | strategies.booleans() | strategies.floats() | strategies.integers()
    | strategies.text(max_size=8),
    lambda inner: strategies.lists(inner, max_size=8)
    | strategies.dictionaries(strategies.sampled_from(
        ['coulomb', 'static', 'stribeck_velocity', 'viscous', 'knee', 'no_load']), inner),
    max_leaves=8)


@pytest.mark.full
@settings(max_examples=60, deadline=None)
@given(strategies.sampled_from(['friction', 'torque_speed', 'armature']),
       ANYTHING.filter(lambda value: value is not None))
def test_any_value_is_used_or_rejected_with_one_line(kind, value):
    robot = create_robot('Panda')
    try:
        robot.set_actuation('arm', **{kind: value})
    except ManipSimError as error:
        assert '\n' not in str(error)
    assert np.isfinite(robot.compile().dof_frictionloss).all()
