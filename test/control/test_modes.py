# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control modes that other packages add; springs in particular."""

from dataclasses import dataclass
import importlib
import logging
from pathlib import Path

import numpy as np
import pytest
from springs import assert_swings, deflection

from manip_sim.control.commands import Status
from manip_sim.control.modes import (
    ControlMode, Effort, EFFORT, LAWS, MODES, Modes, Position, POSITION, VELOCITY)
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

SPRINGS = Path(__file__).resolve().parents[1] / 'data' / 'spring_mode'
ARM = [f'robot0_joint{n}' for n in range(1, 8)]


@pytest.fixture
def modes(monkeypatch):
    """Return the control modes of this process, which are put back after the test."""
    monkeypatch.setattr(MODES, '_modes', dict(MODES._modes))
    return MODES


@pytest.fixture
def springs(modes, monkeypatch):
    """Return a function that adds the example's mode with other gains, and returns it."""
    monkeypatch.syspath_prepend(str(SPRINGS))

    def add(stiffness, damping):
        mode = importlib.import_module('spring_mode').Springs(stiffness, damping)
        modes.add(mode)
        return mode
    return add


@pytest.mark.parametrize('name', robot_names())
def test_an_effort_moves_joints_in_spring_mode_by_effort_over_stiffness(name, springs):
    springs(stiffness=200.0, damping=30.0)
    simulation = Simulation(compose(name))
    simulation.robot.set_control_mode('arm', 'springs')
    moved, effort = deflection(simulation)
    np.testing.assert_allclose(moved, effort / 200.0, rtol=0.01)


def test_a_joint_in_spring_mode_swings_as_a_damped_spring(springs, one_joint_arm):
    stiffness, damping = 200.0, 4.0
    springs(stiffness, damping)
    simulation = Simulation(World([one_joint_arm('<motor name="a" joint="joint1"/>')],
                                  timestep_s=0.0005))
    simulation.robot.set_control_mode('arm', 'springs')
    assert_swings(simulation, stiffness, damping)


def test_a_moving_arm_changes_to_impedance_within_its_acceleration_limits(springs, panda_sim):
    springs(stiffness=50.0, damping=15.0)
    robot, joints = panda_sim.robot, panda_sim.robot.joints
    indices = joints.indices_of('arm')
    robot.apply(*robot.parse.joint_command(ARM[:1], position=[1.5]))
    panda_sim.advance(200)
    assert joints.measured(indices, panda_sim.data)[1][0] > 0.5
    robot.set_control_mode('arm', 'springs')
    step_s = panda_sim.timestep_s
    before = robot.controller_state('arm')
    for _ in range(600):
        panda_sim.advance(1)
        now = robot.controller_state('arm')
        change = np.abs(now.reference.velocity - before.reference.velocity)
        assert (change <= joints.acceleration_limits(indices) * step_s * (1.0 + 1e-6)).all()
        # The force of the motion is fed forward, from the first step on: soft springs do not lag.
        swing = np.abs(now.velocity - before.velocity)[0]
        assert swing <= 1.0 * joints.acceleration_limits(indices)[0] * step_s
        assert np.abs(now.reference.position - now.position).max() < 0.01
        before = now
    assert np.abs(before.reference.velocity).max() == 0.0


def test_a_soft_joint_is_pushed_far_on_its_way_and_comes_to_its_goal_when_it_is_let_go(
        springs, panda_sim):
    springs(stiffness=50.0, damping=15.0)
    robot, data = panda_sim.robot, panda_sim.data
    robot.set_control_mode('arm', 'springs')
    robot.apply(*robot.parse.joint_command(ARM[:1], position=[0.5]))
    data.qfrc_applied[0] = -20.0
    panda_sim.advance(3000)
    assert robot.state().position[0] == pytest.approx(0.5 - 20.0 / 50.0, rel=0.01)
    data.qfrc_applied[0] = 0.0
    panda_sim.advance(2000)
    assert robot.state().position[0] == pytest.approx(0.5, abs=1e-3)


def test_leaving_a_mode_gives_the_servos_back_what_the_model_says(springs, panda_sim):
    springs(stiffness=50.0, damping=15.0)
    model, robot = panda_sim.model, panda_sim.robot
    gains = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    for other in ('position', 'effort', 'velocity'):
        robot.set_control_mode('arm', 'springs')
        assert (model.actuator_gainprm[:7, 0] == 50.0).all()
        robot.set_control_mode('arm', other)
        np.testing.assert_array_equal(model.actuator_gainprm, gains[0])
        np.testing.assert_array_equal(model.actuator_biasprm, gains[1])


def test_a_mode_for_positions_takes_trajectories_targets_and_the_field_position(
        springs, panda_sim):
    springs(stiffness=400.0, damping=40.0)
    robot = panda_sim.robot
    robot.set_control_mode('arm', 'springs')
    assert robot.command_interfaces()[ARM[0]] == 'position'
    with pytest.raises(CommandError, match=r"'robot0_joint1' is in springs mode, which does not "
                                           'use the field velocity'):
        robot.parse.joint_command(ARM[:1], velocity=[0.1])
    start = robot.controller_state('arm').position
    goal = robot.parse.trajectory('arm', ARM, [0.5], [start + 0.1])
    robot.apply(goal)
    for _ in range(100):
        panda_sim.advance(5)
    assert goal.handle.status is Status.DONE
    assert np.abs(robot.controller_state('arm').position - start - 0.1).max() < 1e-3
    (step,) = robot.parse.joint_command(ARM[:1], position=[float(start[0])])
    robot.apply(step)
    for _ in range(200):
        panda_sim.advance(5)
    assert step.handle.status is Status.DONE
    robot.set_control_mode('arm', 'velocity')
    with pytest.raises(CommandError, match='in position or impedance or springs mode only, .* in '
                                           'velocity'):
        robot.parse.trajectory('arm', ARM, [0.5], [start])


class Damped(Effort):
    """Efforts against a damping that is added here, as a mode with a law of its own might."""

    name, timeout_s = 'halved_effort', 0.0

    def command(self, joints, indices, values, arrival):
        super().command(joints, indices, 0.5 * values, arrival)


def test_the_law_of_a_mode_is_what_moves_the_joint(modes, panda_sim):
    modes.add(Damped())
    robot = panda_sim.robot
    robot.set_control_mode('arm', 'halved_effort')
    robot.apply(*robot.parse.joint_command(ARM[6:], effort=[1.0]))
    panda_sim.advance(1)
    assert robot.controller_state('arm').reference.effort[6] == 0.5


@pytest.mark.parametrize('gains', [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (1.0, np.inf),
                                   ([1.0, 2.0], 1.0), (1.0,), ('soft', 1.0)])
def test_gains_that_no_servo_can_have_are_rejected_and_change_nothing(gains, modes, panda_sim):
    class Wrong(Position):
        name = 'wrong'

        def gains(self, joints):
            return gains
    modes.add(Wrong())
    before = panda_sim.model.actuator_gainprm.copy()
    with pytest.raises(ModelError, match='stiffness|damping'):
        panda_sim.robot.set_control_mode('arm', 'wrong')
    assert panda_sim.robot.joints.mode_of(ARM[0]) == 'position'
    np.testing.assert_array_equal(panda_sim.model.actuator_gainprm, before)


def test_gains_beyond_what_the_timestep_allows_are_lowered_and_the_arm_stays(modes, panda_sim):
    class Hard(Position):
        name = 'hard'

        def gains(self, joints):
            return 1e9, 1e9
    modes.add(Hard())
    robot = panda_sim.robot
    start = robot.controller_state('arm').position
    robot.set_control_mode('arm', 'hard')
    robot.apply(*robot.parse.joint_command(ARM, position=start + 0.2))
    panda_sim.advance(1000)
    assert np.abs(robot.controller_state('arm').position - start - 0.2).max() < 1e-3
    assert panda_sim.model.actuator_gainprm[:7, 0].max() < 1e9


def test_a_mode_without_behaviour_cannot_be_made():
    class Nothing(ControlMode):
        name, field, units = 'nothing', 'position', ('rad', 'm')

    with pytest.raises(TypeError, match='abstract'):
        Nothing()


class Nameless(Position):
    name = 'two words'


class Fieldless(Position):
    name, field = 'current', 'current'


class Again(Position):
    name = 'effort'


@pytest.mark.parametrize(('mode', 'error'), [
    ('springs', "^a control mode must derive from ControlMode, got 'springs'$"),
    (Position, '^a control mode must derive from ControlMode, got <class'),
    (Nameless(), "^the name of a control mode must be a word, got 'two words'$"),
    (Fieldless(), "^unknown field for commands in 'current' mode 'current': .*available: pos"),
    (Again(), "^there is a control mode 'effort' already$")])
def test_what_is_no_usable_mode_cannot_be_added(mode, error):
    modes = Modes(POSITION, VELOCITY, EFFORT)
    with pytest.raises(ModelError, match=error):
        modes.add(mode)
    assert list(modes) == ['position', 'velocity', 'effort'] and len(modes) == 3


def test_a_damaged_mode_of_another_package_does_not_hide_the_others(tmp_path, monkeypatch, caplog):
    (tmp_path / 'their_modes.py').write_text(
        'from manip_sim.control.modes import Position\n'
        'class Fine(Position): name = "fine"\n'
        'class Taken(Position): name = "effort"\n'
        'class Needy(Position):\n    name = "needy"\n    def __init__(self, gain): pass\n'
        'class Torn(Position):\n    name = "torn"\n'
        '    def __init__(self): raise OSError("two\\nlines")\n')
    (tmp_path / 'their_other_modes.py').write_text('import does_not_exist\n')
    info = tmp_path / 'their_modes-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: their_modes\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text(
        '[manip_sim.modes]\na = their_other_modes:Lost\nb = their_modes:Taken\n'
        'c = their_modes:Needy\nd = their_modes:Fine\ne = their_modes:Torn\n')
    monkeypatch.syspath_prepend(str(tmp_path))
    caplog.set_level(logging.WARNING, logger='manip_sim.control')
    modes = Modes(EFFORT)
    assert list(modes) == list(modes) == ['effort', 'fine']
    assert modes['effort'] is EFFORT
    with pytest.raises(UnknownNameError, match="^unknown control mode 'needy': .*fine"):
        modes['needy']
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == 4 and not any('\n' in message for message in messages)
    assert 'does_not_exist' in messages[0] and "'effort' already" in messages[1]
    assert "'c' of the package their_modes 1.0" in messages[2] and 'gain' in messages[2]


@dataclass
class Comparable(Position):
    """A mode that cannot be hashed, as a dataclass that compares its fields."""

    name = 'comparable'
    stiffness: float = 1000.0

    def gains(self, joints):
        return np.full(len(joints), self.stiffness), 40.0


def test_other_packages_are_not_asked_again_for_the_mode_of_a_law(monkeypatch):
    def still(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        pass
    LAWS.add(still)
    mode = MODES['law:still']
    monkeypatch.setattr('manip_sim.control.modes.offers', lambda group: pytest.fail(group))
    assert MODES['law:still'] is mode


def test_a_law_that_cannot_be_used_does_not_hide_what_is_wrong_with_a_command(
        package_on_path, panda_sim):
    package_on_path('manip_sim.laws', 'their_laws', 'number = 5', {'five': 'number'})
    robot = panda_sim.robot
    robot.set_control_mode('arm', 'effort')
    with pytest.raises(CommandError, match='follows trajectories in position or .*effort mode'):
        robot.parse.trajectory('arm', ARM, [1.0], [[0.0] * 7])
    with pytest.raises(ModelError, match="'five' of the package their_laws 1.2.*got 5"):
        robot.set_control_mode('arm', 'law:five')
    assert {robot.joints.mode_of(name) for name in ARM} == {'effort'}


def test_a_mode_need_not_be_hashable_and_its_fields_may_change_until_it_is_entered(
        modes, panda_sim):
    mode = Comparable()
    modes.add(mode)
    mode.stiffness = 500.0
    panda_sim.robot.set_control_mode('arm', 'comparable')
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command(ARM[:1], position=[0.1]))
    panda_sim.advance(5)
    assert (panda_sim.model.actuator_gainprm[:7, 0] == 500.0).all()


def test_a_saved_state_in_spring_mode_is_continued_bit_by_bit(springs):
    springs(stiffness=50.0, damping=15.0)
    first, second = Simulation(compose('Panda')), Simulation(compose('Panda'))
    first.robot.set_control_mode('arm', 'springs')
    first.robot.apply(*first.robot.parse.joint_command(ARM[:1], position=[0.5]))
    first.advance(50)
    second.restore(first.save())
    for simulation in (first, second):
        simulation.robot.apply(*simulation.robot.parse.joint_command(ARM[1:2], position=[0.3]))
        simulation.advance(100)
        simulation.robot.set_control_mode('arm', 'position')
        simulation.advance(100)
    assert first.digest() == second.digest()


@pytest.mark.full
@pytest.mark.parametrize('name', robot_names())
def test_a_robot_rests_after_a_velocity_command_to_stop(name):
    simulation = Simulation(compose(name, base='none'))
    robot, rng = simulation.robot, np.random.default_rng(2)
    joints = list(robot.joints.names)
    for part in robot.parts.values():
        if part.gripper is None and part.atomic == (part.name,):
            robot.set_control_mode(part.name, 'velocity')
    limits = np.abs(robot.joints.velocity_limits(np.arange(len(joints))))
    for _ in range(3):
        speed = np.minimum(limits, 0.3) * rng.uniform(-1.0, 1.0, len(joints))
        for velocity in (speed, np.zeros(len(joints))):
            robot.apply(*robot.parse.joint_command(joints, [], velocity.tolist(), []))
            for _ in range(20):
                simulation.advance(5)
        for _ in range(100):
            simulation.advance(5)
        assert robot.joints.resting or not robot.joints.setpoints.moving
