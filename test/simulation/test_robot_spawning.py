# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of robots that come and go while a world runs."""

import gc
import weakref

import numpy as np
import pytest
from robot_kinds import KINDS

from manip_sim.control.commands import Status
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose, compose_robot, create_arena, World
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import robot_spawning, Simulation
from manip_sim.simulation.journal_entries import plain_state, restore_plain
from manip_sim.simulation.robot_spawning import plan_with_robot

BOX = {'shape': 'box', 'size': [0.04] * 3, 'mass': 0.1}


def robot_at(name, y, kind='UR5e', **more):
    robot = compose_robot(kind, idn=name, **more)
    robot.set_base_xpos([0.0, y, 0.0])
    return robot


def with_cubes():
    """Return a Panda at a table with two cubes, whose constraints are solved apart in any case."""
    return Simulation(World([compose_robot('Panda')], create_arena('table', cube=False), objects=[
        {**BOX, 'name': 'cube', 'position': [0.1, 0.1, 0.83]},
        {**BOX, 'name': 'other', 'position': [0.1, -0.2, 0.83]}]))


def run(simulation, periods):
    for _ in range(periods):
        simulation.advance(5)


def arm(robot):
    return list(robot.parts['arm'].driven_joints)


def place_of(robot):
    return robot.true_state().position[robot.indices_of['arm']]


def move(robot, by):
    """Send the arm a step away from where it is, and return the command's handle."""
    (command,) = robot.parse.joint_command(
        arm(robot), position=(place_of(robot) + by).tolist(), part='arm')
    robot.apply(command, period_s=0.01)
    return command.handle


def numbers(robot):
    state = robot.true_state()
    measured = [part for of_arm in state.end_effectors.values() for part in (
        of_arm.pose.position, of_arm.pose.quat_xyzw, of_arm.wrench.force, of_arm.wrench.torque,
        of_arm.external_wrench.force)]
    return np.concatenate([state.position, state.velocity, state.effort, *measured])


# ---------------------------------------------------------------------- what comes


@pytest.mark.full
def test_a_spawned_robot_makes_the_world_that_it_would_have_been_in_from_the_start():
    simulation = Simulation(World([compose_robot('Panda')], create_arena('table')))
    spawned = simulation.spawn_robot(robot_at('left', 2.0))
    both = Simulation(World([compose_robot('Panda'), robot_at('left', 2.0)],
                            create_arena('table')))
    assert list(simulation.robots) == list(both.robots) == ['robot0', 'robotleft']
    assert simulation.model.signature == both.model.signature
    for one in (simulation, both):
        run(one, 5)
        move(one.robots['robotleft'], 0.2)
        move(one.robots['robot0'], 0.1)
        left = one.robots['robotleft']
        left.apply(left.parse.action('right/gripper', [1.0]))
        run(one, 100)
    for name, robot in simulation.robots.items():
        np.testing.assert_allclose(numbers(robot), numbers(both.robots[name]), rtol=0, atol=1e-4)
    # What is saved here is restored there, and goes on with the same bits.
    both.restore(simulation.save())
    assert both.digest() == simulation.digest()
    for one in (simulation, both):
        move(one.robots['robotleft'], -0.3)
        run(one, 50)
    assert both.digest() == simulation.digest()
    assert spawned is simulation.robots['robotleft']


@pytest.mark.full
@pytest.mark.parametrize('kind', KINDS)
def test_a_robot_of_each_kind_can_come_rest_move_and_go(kind):
    simulation = Simulation(World([], create_arena('empty')))
    for name, y in (('first', 3.0), ('second', -3.0)):
        simulation.spawn_robot(robot_at(name, y, kind))
    first, second = simulation.robots.values()
    start = place_of(second)
    run(simulation, 50)
    assert np.abs(place_of(second) - start).max() < 5e-3
    simulation.delete_robot(first.name)
    moves = move(second, 0.05)
    run(simulation, 150)
    assert moves.status is not Status.ABORTED
    limits = second.limits('arm')
    expected = np.clip(start + 0.05, *limits.T)
    assert np.abs(place_of(second) - expected).max() < 0.02


def test_a_robot_that_comes_starts_as_at_construction_and_returns_there_with_a_reset():
    simulation = with_cubes()
    run(simulation, 10)
    spawned = simulation.spawn_robot(robot_at('left', 2.0))
    at_start = spawned.true_state().position
    alone = Simulation(World([robot_at('left', 2.0)]))
    np.testing.assert_allclose(at_start, alone.robot.true_state().position, atol=1e-12)
    move(spawned, 0.3)
    run(simulation, 50)
    assert np.abs(spawned.true_state().position - at_start).max() > 0.1
    for seed in (None, 5):
        simulation.reset(seed)
        assert list(simulation.robots) == ['robot0', 'robotleft']
        np.testing.assert_allclose(spawned.true_state().position, at_start, atol=1e-9)


def test_a_robot_with_laws_of_friction_comes_and_goes():
    robot = robot_at('left', 2.0, 'UR5e')
    robot.set_actuation('arm', friction='catalogue', torque_speed='catalogue')
    simulation = with_cubes()
    spawned = simulation.spawn_robot(robot)
    move(spawned, 0.3)
    run(simulation, 3)
    alone = Simulation(World([robot]))
    move(alone.robot, 0.3)
    run(alone, 3)
    np.testing.assert_allclose(place_of(spawned), place_of(alone.robot), rtol=0, atol=1e-6)
    friction = [one.model.dof_frictionloss[one.model.joint(arm(robot_)[0]).dofadr[0]]
                for one, robot_ in ((simulation, spawned), (alone, alone.robot))]
    assert friction[0] == pytest.approx(friction[1], rel=1e-3)
    nominal = simulation.plan.compiled
    assert friction[0] != nominal.dof_frictionloss[nominal.joint(arm(spawned)[0]).dofadr[0]]
    simulation.delete_robot('robotleft')
    run(simulation, 3)
    assert list(simulation.robots) == ['robot0']


# ---------------------------------------------------------------------- what stays


def all_that_is_published(changes):
    """Let an arm stream, follow a target pose, grasp; return what is published and digests."""
    simulation = with_cubes()
    robot, told = simulation.robot, []
    middle = place_of(robot)
    for period in range(240):
        if period in changes:
            changes[period](simulation)
            robot = simulation.robots['robot0']
        if period < 120:
            swing = 0.3 * np.sin(np.pi * period * 0.01)
            robot.apply(*robot.parse.joint_command(
                arm(robot), position=(middle + swing).tolist()), period_s=0.01)
        if period == 20:
            robot.apply(robot.parse.action('right/gripper', [1.0]))
        if period == 120:
            pose = robot.true_state().end_effectors['right'].pose
            robot.apply(robot.parse_cartesian.pose(
                'right', pose.position + [0.0, 0.1, 0.1], pose.quat_xyzw))
        simulation.advance(5)
        told.append(np.concatenate([numbers(robot), simulation.data.body('cube').xpos]))
    return np.array(told)


@pytest.mark.full
def test_what_is_there_moves_on_bit_for_bit_when_robots_come_and_go():
    def go(name):
        return lambda simulation: simulation.delete_robot(name)

    def come(name, y, kind):
        return lambda simulation: simulation.spawn_robot(robot_at(name, y, kind))

    alone = all_that_is_published({})
    with_others = all_that_is_published({
        30: come('left', 3.0, 'UR5e'), 60: come('right', -3.0, 'Baxter'), 90: go('robotleft'),
        130: come('left', 3.0, 'PandaOmron'), 160: go('robotright'), 200: go('robotleft')})
    np.testing.assert_array_equal(with_others, alone)


def later_robot(deletes):
    """Command a robot in many ways while one that came before it is deleted, or stays."""
    simulation = with_cubes()
    # From 60 degrees of freedom on, MuJoCo computes with other matrices, and rounds differently.
    for number in range(4):
        simulation.spawn_robot(robot_at(f'before{number}', 3.0 * (number + 1), 'SO101'))
    robot = simulation.spawn_robot(robot_at('last', -3.0, 'Panda'))
    robot.set_wrench_cutoff('right', 5.0)
    grip = robot.robot_model.grippers['right'].important_sites['grip_site']
    told, middle = [], place_of(robot)
    for period in range(400):
        if period == 50:
            robot.tare_wrench()
            robot.apply(robot.parse.action('right/gripper', [1.0]))
        if period < 100:
            swing = 0.3 * np.sin(np.pi * period * 0.01)
            robot.apply(*robot.parse.joint_command(
                arm(robot), position=(middle + swing).tolist()), period_s=0.01)
        elif period == 100:
            robot.apply(robot.parse_cartesian.pose(
                'right', [0.0, 0.0, 0.1], [0.0, 0.0, 0.0, 1.0], grip))
        elif period == 160:
            robot.set_control_mode('arm', 'effort')
            robot.apply(robot.parse_cartesian.twist(
                'right', [0.0, 0.0, 0.05], [0.0, 0.0, 0.0], grip))
        elif period == 250:
            robot.set_control_mode('arm', 'position')
            robot.apply(robot.parse.trajectory(
                'arm', arm(robot), [1.0], [(middle + 0.1).tolist()]), period_s=0.01)
        elif period == 260:
            (finger, *_) = robot.grippers['right/gripper'].joints.names
            robot.apply(*robot.parse.joint_command([finger], position=[0.02]))
        if deletes and period in (75, 130, 190, 280):
            simulation.delete_robot(simulation.spawned_robots[0])
        simulation.advance(5)
        told.append(numbers(robot))
    return np.array(told)


@pytest.mark.full
def test_a_later_robot_goes_on_when_one_before_it_is_deleted():
    np.testing.assert_array_equal(later_robot(True), later_robot(False))


@pytest.mark.full
@pytest.mark.parametrize('kind', ['SO101', 'Panda'])
def test_a_later_gripper_goes_on_when_one_before_it_is_deleted_after_a_restored_state(kind):
    digests = []
    for restores in (False, True):
        simulation = Simulation(World([compose_robot('Panda')], create_arena('empty')))
        simulation.spawn_robot(robot_at('before', 2.0, kind))
        robot = simulation.spawn_robot(robot_at('last', -2.0, 'Panda'))
        if restores:
            simulation.restore(simulation.save())
        simulation.delete_robot(simulation.spawned_robots[0])
        robot.apply(robot.parse.action('right/gripper', [1.0]), period_s=0.01)
        run(simulation, 20)
        digests.append(simulation.digest())
    assert digests[0] == digests[1]


@pytest.mark.full
@pytest.mark.parametrize('restores', [
    lambda simulation: simulation.restore(simulation.save()),
    lambda simulation: restore_plain(simulation, plain_state(simulation)[0])],
    ids=['state', 'journal'])
def test_a_target_keeps_its_frame_when_a_robot_before_is_deleted_after_a_restored_state(restores):
    places = []
    for restore in (None, restores):
        simulation = Simulation(World([compose_robot('Panda')], create_arena('empty')))
        simulation.spawn_robot(robot_at('before', 2.0))
        robot = simulation.spawn_robot(robot_at('last', -2.0, 'IIWA'))
        pose = robot.state().end_effectors['right'].pose
        goal, base = np.add(pose.position, [0.0, 0.05, 0.05]), robot.robot_model.root_body
        robot.apply(robot.parse_cartesian.pose(
            'right', goal - simulation.data.body(base).xpos, pose.quat_xyzw, base))
        run(simulation, 1)
        if restore is not None:
            restore(simulation)
        simulation.delete_robot(simulation.spawned_robots[0])
        run(simulation, 100)
        places.append(robot.state().end_effectors['right'].pose.position)
    np.testing.assert_allclose(places, [goal] * 2, atol=1e-3)


def test_a_constraint_that_is_off_stays_off():
    simulation = with_cubes()
    first = simulation.spawn_robot(robot_at('first', 3.0))
    simulation.spawn_robot(robot_at('second', -3.0, 'Panda'))
    (off,) = (number for number in range(simulation.model.neq) if simulation.model.joint(
        simulation.model.eq_obj1id[number]).name.startswith('gripper')
        and 'second' in simulation.model.joint(simulation.model.eq_obj1id[number]).name)
    simulation.data.eq_active[off] = 0
    simulation.delete_robot(first.name)
    assert simulation.data.eq_active.tolist() == [1] * (simulation.model.neq - 1) + [0]


def test_objects_come_and_go_between_robots():
    simulation = with_cubes()
    first = simulation.spawn_robot(robot_at('first', 3.0))
    simulation.change_objects(plan_with(simulation.plan, create_object(
        {**BOX, 'name': 'box', 'position': [1.0, 1.0, 0.5]})))
    second = simulation.spawn_robot(robot_at('second', -3.0, 'Sawyer'))
    run(simulation, 20)
    before = numbers(second)
    simulation.change_objects(plan_without(simulation.plan, 'box'))
    simulation.delete_robot(first.name)
    np.testing.assert_array_equal(numbers(second), before)
    assert simulation.plan.object_names == ['cube', 'other']
    assert [robot.name_in_world for robot in simulation.world.robots] == ['robot0', 'robotsecond']
    assert simulation.world.compile().nq == simulation.model.nq


# ---------------------------------------------------------------------- what goes


def test_commands_of_a_deleted_robot_are_aborted_with_the_reason():
    simulation = with_cubes()
    spawned = simulation.spawn_robot(robot_at('left', 2.0))
    handle = move(spawned, 0.5)
    own = move(simulation.robots['robot0'], 0.1)
    run(simulation, 2)
    simulation.delete_robot('robotleft')
    assert (handle.status, handle.reason) == (Status.ABORTED, "robot 'robotleft' was deleted")
    assert own.status is Status.RUNNING
    assert list(simulation.robots) == ['robot0']
    names = [simulation.model.joint(joint).name for joint in range(simulation.model.njnt)]
    assert not [name for name in names if name.startswith('robotleft')]


@pytest.mark.full
def test_nothing_keeps_a_deleted_robot_in_memory():
    simulation = with_cubes()
    for _ in range(3):
        simulation.spawn_robot(robot_at('left', 2.0))
        run(simulation, 2)
        gone = weakref.ref(simulation.robots['robotleft'])
        simulation.delete_robot('robotleft')
        run(simulation, 1)
        gc.collect()
        assert gone() is None


def test_states_are_restored_only_with_the_robots_that_they_were_saved_with():
    simulation = with_cubes()
    alone = simulation.save()
    simulation.spawn_robot(robot_at('left', 2.0))
    both, digest = simulation.save(), simulation.digest()
    with pytest.raises(ModelError, match='saved with the robots robot0, now there are robot0, '
                                         'robotleft'):
        simulation.restore(alone)
    simulation.delete_robot('robotleft')
    with pytest.raises(ModelError, match='saved with the robots robot0, robotleft, now there are '
                                         'robot0'):
        simulation.restore(both)
    simulation.restore(alone)
    run(simulation, 3)
    simulation.spawn_robot(robot_at('left', 2.0))
    simulation.restore(both)
    assert simulation.digest() == digest


def test_robots_that_cannot_come_or_go_change_nothing(monkeypatch):
    simulation = with_cubes()
    run(simulation, 3)
    digest, model = simulation.digest(), simulation.model
    with pytest.raises(ModelError, match='need different idn or prefix, got robot0_, robot0_'):
        simulation.spawn_robot(robot_at('0', 2.0))
    with pytest.raises(ModelError, match="robot 'robot0' was there at the start"):
        simulation.delete_robot('robot0')
    with pytest.raises(UnknownNameError, match="unknown robot 'cube'"):
        simulation.delete_robot('cube')
    with pytest.raises(ModelError, match="^robot must be a RobotModel, got 'Panda'"):
        simulation.spawn_robot('Panda')
    monkeypatch.setattr(robot_spawning, 'MAX_ROBOTS', 1)
    with pytest.raises(ModelError, match='there are 1 robots already, a world takes no more'):
        simulation.spawn_robot(robot_at('left', 2.0))
    monkeypatch.undo()
    assert simulation.model is model and simulation.digest() == digest
    simulation.change_objects(plan_with(simulation.plan, create_object(
        {**BOX, 'name': 'robotleft_box', 'position': [1.0, 1.0, 0.5]})))
    with pytest.raises(ModelError, match="an object has a name that begins with 'robotleft_'"):
        plan_with_robot(simulation, robot_at('left', 2.0))


def test_a_world_whose_robots_come_later():
    simulation = Simulation(compose('Panda', arena='table'))
    run(simulation, 5)
    spawned = simulation.spawn_robot(robot_at('left', 2.0))
    spawned.sensing.set('noise.joint_position', 0.01)
    run(simulation, 5)
    assert not np.array_equal(spawned.state().position, spawned.true_state().position)
    np.testing.assert_array_equal(simulation.robots['robot0'].state().position,
                                  simulation.robots['robot0'].true_state().position)
    assert set(spawned.robot_model.sensors) <= set(simulation.sensors)
    simulation.delete_robot('robotleft')
    assert not [name for name in simulation.sensors if name.startswith('robotleft')]
