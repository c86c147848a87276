# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the whole simulation: start, state of one instant, reset, determinism, divergence."""

import dataclasses
import importlib
import inspect
import pkgutil
import re

import mujoco
import numpy as np
import pytest

from manip_sim import control, physics, simulation
from manip_sim.control.commands import Command
from manip_sim.errors import CommandError, DivergenceError, ModelError, UnknownNameError
from manip_sim.models import compose, compose_robot
from manip_sim.models.arenas import TableArena
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.robots import Panda
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.compiled_period import CompiledPeriod

#: Classes of data that change: all others are handed from thread to thread as they are.
CHANGING = {'control.commands.CommandHandle', 'control.cartesian.reports.CartesianReport',
            'control.cartesian.targets.Target'}


def data_classes():
    """Return the classes of data of what happens, by module and name."""
    modules = [importlib.import_module(found.name) for room in (control, physics, simulation)
               for found in pkgutil.walk_packages(room.__path__, f'{room.__name__}.')]
    return {f'{module.__name__.removeprefix("manip_sim.")}.{name}': found
            for module in modules for name, found in vars(module).items()
            if isinstance(found, type) and dataclasses.is_dataclass(found)
            and found.__module__ == module.__name__}


@pytest.mark.parametrize('name', sorted(data_classes().keys() - CHANGING))
def test_what_is_handed_from_thread_to_thread_cannot_be_changed(name):
    found = data_classes()[name]
    value = object.__new__(found)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(value, dataclasses.fields(found)[0].name, None)


@pytest.mark.parametrize('name', sorted(
    name for name, found in data_classes().items() if issubclass(found, Command)))
def test_commands_are_made_by_name_and_differ_whatever_their_numbers_are(name):
    found = data_classes()[name]
    assert object.__new__(found) != object.__new__(found)
    kinds = {parameter.kind for parameter in inspect.signature(found).parameters.values()}
    assert kinds == {inspect.Parameter.KEYWORD_ONLY}


@pytest.fixture
def cube_sim(panda):
    """Return a simulation of the Panda at a table with the cube."""
    return Simulation(World([panda], TableArena(cube=True)))


def numbers_of(state):
    """Return all numbers of a state in one array."""
    parts = [state.position, state.velocity, state.effort]
    for end in state.end_effectors.values():
        parts += [end.pose.position, end.pose.quat_xyzw, end.twist.linear, end.twist.angular,
                  end.wrench.force, end.wrench.torque, end.external_wrench.force,
                  end.external_wrench.torque]
    return np.concatenate(parts)


def move(simulation):
    """Disturb everything that a reset has to restore."""
    robot = simulation.robot
    robot.apply(robot.parse.action('arm', [0.3, 0.9, 0.2, 0.1, 0.5, -0.4, 0.2]))
    robot.apply(robot.parse.action('right/gripper', [1.0]))
    simulation.data.joint('cube_joint').qvel[:3] = [0.5, 0.2, 0.1]
    for _ in range(30):
        simulation.advance(5)


def test_start_pose_is_held_for_ten_seconds(panda_sim, run):
    start = np.concatenate([panda_sim.robot.robot_model.init_qpos, PandaGripper().init_qpos])
    np.testing.assert_array_equal(panda_sim.robot.state().position, start)
    run(panda_sim, 10.0)
    np.testing.assert_allclose(panda_sim.robot.state().position[:7], start[:7], atol=1e-3)
    np.testing.assert_allclose(panda_sim.robot.state().position[7:], start[7:], atol=1e-4)


def test_state_is_that_of_one_instant(panda_sim, run):
    panda_sim.robot.apply(panda_sim.robot.parse.action('arm', [0.3] * 7))
    run(panda_sim, 0.1)
    fresh = mujoco.MjData(panda_sim.model)
    for field in ('qpos', 'qvel', 'act', 'ctrl'):
        getattr(fresh, field)[:] = getattr(panda_sim.data, field)
    mujoco.mj_forward(panda_sim.model, fresh)
    state = panda_sim.robot.state()
    end = state.end_effectors['right']
    assert np.abs(state.velocity).max() > 0.1
    np.testing.assert_allclose(end.wrench.force, fresh.sensor('gripper0_right_force_ee').data,
                               rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(end.wrench.torque, fresh.sensor('gripper0_right_torque_ee').data,
                               rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(end.pose.position, fresh.site('gripper0_right_grip_site').xpos)


def test_state_is_a_copy(panda_sim, run):
    panda_sim.robot.apply(panda_sim.robot.parse.action('arm', [0.3] * 7))
    run(panda_sim, 0.05)
    state = panda_sim.robot.state()
    before = numbers_of(state).copy()
    run(panda_sim, 0.05)
    np.testing.assert_array_equal(numbers_of(state), before)
    assert np.abs(numbers_of(panda_sim.robot.state()) - before).max() > 0.01


def test_joints_are_listed_by_part_with_positions_in_the_same_order(panda_sim, reference):
    assert list(panda_sim.robot.joint_names) == reference['joint_order_in_model']
    assert {part: list(indices) for part, indices in panda_sim.robot.indices_of.items()} == {
        'arm': list(range(7)), 'right': list(range(7)), 'right/gripper': [7, 8]}
    for name, position in zip(panda_sim.robot.joint_names, panda_sim.robot.state().position):
        assert panda_sim.data.joint(name).qpos[0] == position


def test_reset_restores_everything_but_the_time(cube_sim):
    before, cube = numbers_of(cube_sim.robot.state()), cube_sim.data.body('cube').xpos.copy()
    gripper = cube_sim.robot.parts['right/gripper'].gripper
    action_state = gripper.current_action.copy()
    move(cube_sim)
    assert np.abs(gripper.current_action - action_state).max() > 0.1
    cube_sim.robot.tare_wrench()
    assert np.abs(cube_sim.data.body('cube').xpos - cube).max() > 0.01
    cube_sim.reset()
    np.testing.assert_array_equal(numbers_of(cube_sim.robot.state()), before)
    np.testing.assert_array_equal(cube_sim.data.body('cube').xpos, cube)
    np.testing.assert_array_equal(gripper.current_action, action_state)
    assert cube_sim.robot.state().time_ns == 30 * 5 * 2_000_000


def test_what_follows_a_reset_is_what_followed_the_start(cube_sim):
    move(cube_sim)
    first = numbers_of(cube_sim.robot.state())
    cube_sim.reset()
    move(cube_sim)
    np.testing.assert_array_equal(numbers_of(cube_sim.robot.state()), first)


def test_reset_drops_commands(panda_sim, run):
    start = panda_sim.robot.state().position
    panda_sim.robot.apply(panda_sim.robot.parse.action('arm', [0.3] * 7))
    panda_sim.robot.apply(panda_sim.robot.parse.action('right/gripper', [1.0]))
    panda_sim.reset()
    run(panda_sim, 0.5)
    np.testing.assert_allclose(panda_sim.robot.state().position, start, atol=1e-6)


def test_time_counts_steps_exactly(panda):
    simulation = Simulation(World([panda], timestep_s=0.0015))
    for _ in range(7):
        simulation.advance(3)
    assert simulation.step_count == 21
    assert simulation.robot.state().time_ns == 31_500_000


@pytest.mark.parametrize(('timestep_s', 'steps', 'intervals'), [
    (0.002, 5, [2, 2, 1]), (0.0005, 20, [7, 7, 6]), (0.0005, 8, [8]), (0.005, 2, [1, 1])])
def test_setpoints_move_every_four_milliseconds_or_more_often(
        timestep_s, steps, intervals, monkeypatch):
    simulation, seen = Simulation(compose('Panda', timestep_s=timestep_s)), []
    robot, prepare = simulation.robot, CompiledPeriod.prepare

    def noted(period, runs, intervals, *rest):
        seen.extend(intervals)
        return prepare(period, runs, intervals, *rest)
    monkeypatch.setattr(CompiledPeriod, 'prepare', noted)
    robot.apply(robot.parse.action('arm', [0.5] * 7))
    simulation.advance(steps)
    assert seen == intervals


def test_same_commands_give_bit_identical_states():
    states = []
    for _ in range(2):
        robot = Panda()
        robot.add_gripper(PandaGripper(idn='0_right'))
        simulation = Simulation(World([robot], TableArena(cube=True)))
        move(simulation)
        states.append(numbers_of(simulation.robot.state()))
    np.testing.assert_array_equal(*states)


def test_each_of_two_robots_is_commanded_for_itself(panda, run):
    other = compose_robot('UR5e', idn=1)
    other.set_base_xpos([0.0, 3.0, 0.0])
    simulation = Simulation(World([panda, other]))
    first, second = simulation.robots.values()
    assert list(simulation.robots) == ['robot0', 'robot1']
    assert not set(first.joint_names) & set(second.joint_names)
    start, goal = first.state().position, second.state().position[:6] + 0.1
    second.apply(*second.parse.joint_command(second.joints.names, goal))
    run(simulation, 2.0)
    np.testing.assert_allclose(second.state().position[:6], goal, atol=1e-3)
    np.testing.assert_allclose(first.state().position, start, atol=1e-3)


def test_the_only_robot_is_asked_for_where_there_are_two(panda):
    other = compose_robot('UR5e', idn=1)
    other.set_base_xpos([0.0, 3.0, 0.0])
    with pytest.raises(ModelError, match='expected one robot, but the world has robot0, robot1'):
        _ = Simulation(World([panda, other])).robot


def make_velocity_absurd(simulation):
    simulation.data.qvel[0] = 1e9


def make_servo_unstable(simulation):
    simulation.model.jnt_actfrclimited[:] = 0
    simulation.model.actuator_forcelimited[:] = 0
    simulation.model.actuator_biasprm[0, 1] = 1e14
    simulation.data.qvel[0] = 1.0


@pytest.mark.parametrize('disturb', [make_velocity_absurd, make_servo_unstable])
def test_divergence_is_noticed_and_held_with_a_finite_state(panda_sim, run, disturb):
    run(panda_sim, 0.1)
    disturb(panda_sim)
    with pytest.raises(DivergenceError, match=r'diverged at 0\.1.*held until reset\(\)'):
        run(panda_sim, 0.05)
    assert panda_sim.diverged.startswith('the physics diverged at 0.1')
    held = numbers_of(panda_sim.robot.state())
    assert np.isfinite(held).all()
    assert not panda_sim.robot.state().velocity.any()
    count = panda_sim.step_count
    with pytest.raises(DivergenceError, match=re.escape(panda_sim.diverged)):
        panda_sim.advance(5)
    assert panda_sim.step_count == count
    np.testing.assert_array_equal(numbers_of(panda_sim.robot.state()), held)


def test_absurd_velocity_of_a_free_object_is_told_as_such(cube_sim):
    cube_sim.data.joint('cube_joint').qvel[2] = 5e4
    with pytest.raises(DivergenceError, match='a velocity is above 10000'):
        cube_sim.advance(5)
    assert cube_sim.diverged == 'the physics diverged at 0.010 s: a velocity is above 10000'
    assert np.isfinite(numbers_of(cube_sim.robot.state())).all()


@pytest.mark.parametrize('bad', [np.nan, np.inf, -1e11])
def test_a_bad_control_is_divergence_and_does_not_last(panda_sim, run, bad):
    # MuJoCo sets all controls to zero then, and the arm would fall without a word.
    panda_sim.data.ctrl[1] = bad
    start = panda_sim.robot.state().position
    with pytest.raises(DivergenceError, match='MuJoCo warns of a bad position'):
        panda_sim.advance(5)
    assert panda_sim.diverged == ('the physics diverged at 0.010 s: MuJoCo warns of a bad '
                                  'position, velocity, acceleration or control')
    np.testing.assert_array_equal(panda_sim.robot.state().position, start)
    panda_sim.reset()
    run(panda_sim, 0.5)
    assert panda_sim.diverged is None
    np.testing.assert_allclose(panda_sim.robot.state().position, start, atol=1e-6)


def test_divergence_is_mended_by_reset(panda_sim, run):
    start = panda_sim.robot.state().position
    make_velocity_absurd(panda_sim)
    with pytest.raises(DivergenceError):
        run(panda_sim, 0.05)
    assert panda_sim.diverged is not None
    panda_sim.reset()
    assert panda_sim.diverged is None
    run(panda_sim, 0.5)
    assert panda_sim.diverged is None
    np.testing.assert_allclose(panda_sim.robot.state().position, start, atol=1e-6)


def test_unknown_part_tells_what_there_is(panda_sim):
    with pytest.raises(UnknownNameError, match=r"^unknown part 'arms': did you mean 'arm'\? "
                                               r'available: arm, right$'):
        panda_sim.robot.joints.indices_of('arms')


def test_mode_and_timeout_of_a_gripper_cannot_be_set(panda_sim):
    message = r'^right/gripper is a gripper: it has no control mode, no timeout and no streams$'
    with pytest.raises(CommandError, match=message):
        panda_sim.robot.set_control_mode('right/gripper', 'effort')
    with pytest.raises(CommandError, match=message):
        panda_sim.robot.set_command_timeout('right/gripper', 1.0)


def test_robot_without_grippers_has_no_end_effectors(one_joint_arm):
    simulation = Simulation(World([one_joint_arm()]))
    simulation.advance(1)
    assert simulation.robot.state().end_effectors == {}


def test_what_is_no_world_is_rejected_with_what_makes_one():
    with pytest.raises(ModelError, match=r"a World, such as compose\('Panda'\), got 'Panda'$"):
        Simulation('Panda')
