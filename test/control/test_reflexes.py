# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A part that does too much is stopped, and refuses commands until the reflex is reset."""

import mujoco
import numpy as np
import pytest
from sampling import Driven, sampled

from manip_sim.control.commands import Status
from manip_sim.control.modes import LAWS
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.laws import law
from manip_sim.models import compose
from manip_sim.models.robots import create_robot
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

J1, J2 = 'robot0_joint1', 'robot0_joint2'


def go(simulation, **fields):
    (command,) = simulation.robot.parse.joint_command([J1], **fields)
    simulation.robot.apply(command)
    return command.handle


def test_an_arm_that_is_too_fast_in_effort_mode_brakes_and_refuses_commands(panda_sim, run):
    robot, arm = panda_sim.robot, Driven(panda_sim, 'arm')
    robot.set_control_mode('arm', 'effort')
    robot.set_reflex('arm', 'velocity', 1.2)
    arm.command('effort', [20.0, *[0.0] * 6])
    with sampled(arm) as samples:
        run(panda_sim, 2.0)
    velocity = samples.velocity[:, 0]
    # States are looked at once a control period.
    assert 1.2 < velocity.max() / arm.velocity_limit[0] < 1.3
    slowing = np.diff(velocity)[velocity.argmax():] / 0.002
    assert np.abs(slowing).max() < robot.joints.acceleration_limits(np.array([0]))[0]
    assert np.abs(samples.velocity[-1]).max() < 1e-3
    assert 'the velocity of joint' in robot.reflexes.tripped['arm']
    handle = go(panda_sim, effort=[1.0])
    assert handle.status is Status.ABORTED
    assert handle.reason.startswith('arm was stopped by a reflex: the velocity of joint')
    robot.reset_reflexes()
    assert go(panda_sim, effort=[1.0]).status is Status.RUNNING
    run(panda_sim, 0.1)
    assert panda_sim.data.qvel[0] > 0.05 and robot.reflexes.counts['arm'] == 1


def test_a_push_stops_an_arm_that_rests(panda_sim, run):
    robot = panda_sim.robot
    robot.set_reflex('right', 'force', 20.0)
    gripper = panda_sim.data.body('gripper0_right_right_gripper')
    gripper.xfrc_applied[1] = 19.0
    run(panda_sim, 0.2)
    assert not robot.reflexes.tripped
    gripper.xfrc_applied[1] = 21.0
    run(panda_sim, 0.2)
    assert robot.reflexes.tripped == {'arm': 'the external force is 21 N, allowed is 20 N'}
    # While the push lasts, it stops the arm again.
    robot.reset_reflexes()
    run(panda_sim, 0.02)
    assert robot.reflexes.counts['arm'] == 2


@pytest.mark.parametrize('quantity, limit', [('effort', 0.5), ('torque', 3.0)])
def test_too_much_effort_or_torque_aborts_what_runs(panda_sim, run, quantity, limit):
    robot = panda_sim.robot
    robot.set_reflex('arm', quantity, limit)
    handle = go(panda_sim, position=[2.0])
    run(panda_sim, 0.2)
    assert handle.status is Status.RUNNING
    panda_sim.data.body('gripper0_right_right_gripper').xfrc_applied[:] = [0, 150, 0, 0, 0, 5.0]
    run(panda_sim, 0.1)
    assert handle.status is Status.ABORTED and quantity in handle.reason
    panda_sim.reset()
    assert not robot.reflexes.tripped


def test_what_is_not_stopped_goes_on(operator_of):
    op = operator_of('Baxter')
    robot = op.simulation.robot
    robot.set_reflex('arm', 'velocity', 0.05)
    (right,), (left,) = ([op.joints_of(part)[0]] for part in ('right', 'left'))
    op.go({right: op.where(right)[0] + 0.3})
    op.run(0.5)
    assert list(robot.reflexes.tripped) == ['right']
    (handle,) = op.go({left: op.where(left)[0] + 0.001})
    op.run(0.5)
    assert handle.status is Status.DONE


def test_without_limits_nothing_is_stopped_and_unknown_ones_are_told(panda_sim, run):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'velocity', 0.1)
    robot.set_reflex('arm', 'velocity', 0.0)
    assert robot.reflexes.armed == () and robot.resting
    go(panda_sim, position=[1.0])
    run(panda_sim, 0.3)
    assert not robot.reflexes.tripped
    with pytest.raises(UnknownNameError, match="unknown quantity of a reflex 'power'"):
        robot.set_reflex('arm', 'power', 1.0)
    with pytest.raises(CommandError, match='is a gripper'):
        robot.set_reflex('right/gripper', 'force', 1.0)


@pytest.mark.parametrize('quantity', ['force', 'torque'])
def test_a_wrench_stops_no_part_without_a_tool(quantity):
    simulation = Simulation(compose('GR1'))
    digest = simulation.digest()
    for part in ('head', 'torso', 'legs'):
        with pytest.raises(CommandError, match=f'{part} has no tool .* exert a {quantity}'):
            simulation.robot.set_reflex(part, quantity, 1.0)
    assert simulation.digest() == digest
    simulation.robot.set_reflex('arm', quantity, 1.0)  # Of both arms, by their name.
    assert all(getattr(simulation.robot.reflexes.limits[arm], quantity) == 1.0
               for arm in ('right', 'left'))


def test_the_wrench_on_the_only_tool_of_two_arms_stops_the_arm_that_has_it(run):
    simulation = Simulation(compose('Baxter', gripper={'right': 'PandaGripper', 'left': 'none'}))
    robot = simulation.robot
    robot.set_reflex('arm', 'force', 3.0)
    with pytest.raises(CommandError, match='left has no tool'):
        robot.set_reflex('left', 'force', 3.0)
    simulation.data.body('gripper0_right_right_gripper').xfrc_applied[1] = 8.0
    run(simulation, 0.2)
    assert list(robot.reflexes.tripped) == ['right']


def stream(simulation, positions):
    """Command positions of a joint, one each control period; return the handles."""
    handles = []
    for position in positions:
        handles.append(go(simulation, position=[position]))
        simulation.advance(5)
    return handles


#: A motion of the first joint from its start within 0.4 of the limits of the Panda.
SMOOTH = 0.1 * (1.0 - np.cos(5.0 * 0.01 * np.arange(120)))


def test_a_continuous_stream_passes_and_a_jump_in_it_stops_the_arm_before_it_acts(panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'discontinuity', 1.0)
    stream(panda_sim, SMOOTH)
    assert not robot.reflexes.tripped
    before = robot.joints.setpoints.position[0]
    handle, = stream(panda_sim, [SMOOTH[-1] + 0.05])
    assert handle.status is Status.ABORTED
    assert "times the acceleration limit of joint 'robot0_joint1', allowed is 1" in handle.reason
    panda_sim.advance(500)
    assert abs(robot.joints.setpoints.position[0] - before) < 2e-3
    assert robot.safety_state == 'protective_stop'
    robot.reset_reflexes()
    at = float(robot.joints.setpoints.position[0])
    assert stream(panda_sim, at + SMOOTH)[-1].status is not Status.ABORTED


@pytest.mark.parametrize(('positions', 'stops'), [
    ([0.002], True), ([1e-4], False),  # From rest.
    ([0.0, 0.0, 1e-4, 2e-4, 3e-4], False), ([0.0, 0.0, 0.0, 5e-3, 0.0], True),
    ([*SMOOTH[:40], *SMOOTH[42:]], True)])  # It skips what two messages would have said.
def test_what_positions_demand_is_compared_with_the_limits(positions, stops, panda_sim):
    panda_sim.robot.set_reflex('right', 'discontinuity', 2.0)
    stream(panda_sim, positions)
    assert bool(panda_sim.robot.reflexes.tripped) is stops


@pytest.mark.parametrize('mode', ['velocity', 'impedance', 'law:soft'])
def test_commands_of_other_modes_are_compared_with_the_limits_too(mode, panda_sim, monkeypatch):
    @law(compiled=False)
    def soft(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        effort[:] = bias + 200.0 * (setpoint[:, 0] - q) - 20.0 * v

    monkeypatch.setattr(LAWS, '_laws', {'soft': soft})
    robot, field = panda_sim.robot, 'velocity' if mode == 'velocity' else 'position'
    robot.set_control_mode('arm', mode)
    robot.set_reflex('arm', 'discontinuity', 1.0)
    goals = 0.5 * np.sin(5.0 * 0.01 * np.arange(120)) if field == 'velocity' else SMOOTH
    for goal in goals:
        go(panda_sim, **{field: [goal]})
        if mode == 'impedance':  # Gains alone are no jump.
            robot.apply(*robot.parse.joint_impedance([J1], stiffness=300.0))
        panda_sim.advance(5)
    assert not robot.reflexes.tripped
    handle = go(panda_sim, **{field: [goals[-1] + 0.3]})
    panda_sim.advance(5)
    assert handle.status is Status.ABORTED
    assert "limit of joint 'robot0_joint1', allowed is 1" in robot.reflexes.tripped['arm']


def test_lost_messages_are_no_discontinuity_and_other_commands_begin_anew(panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'discontinuity', 1.0)
    for number, position in enumerate(SMOOTH):
        if number % 7 not in (3, 4):
            stream(panda_sim, [position])
        else:
            panda_sim.advance(5)
    assert not robot.reflexes.tripped
    robot.apply(robot.parse.trajectory('arm', [J1], [1.0], [[0.6]]))
    panda_sim.advance(600)
    assert not robot.reflexes.tripped
    stream(panda_sim, 0.6 + SMOOTH)
    assert not robot.reflexes.tripped


def test_a_restored_state_remembers_what_was_commanded(panda_sim):
    panda_sim.robot.set_reflex('arm', 'discontinuity', 1.0)
    stream(panda_sim, SMOOTH[:30])
    saved, digests = panda_sim.save(), []
    for _ in range(2):
        stream(panda_sim, SMOOTH[30:60])
        assert not panda_sim.robot.reflexes.tripped
        digests.append(panda_sim.digest())
        panda_sim.reset()
        panda_sim.restore(saved)
    assert digests[0] == digests[1]


def test_many_worlds_stop_where_a_command_jumps():
    worlds = Worlds(compose('Panda'), 2)
    with worlds:
        for simulation in worlds.simulations:
            simulation.robot.set_reflex('arm', 'discontinuity', 1.0)
        for number, position in enumerate(SMOOTH):
            positions = np.array([[position], [position + 0.1 * (number == 90)]])
            worlds.robot.command.joint_command([J1], position=positions, period_s=0.01)
            worlds.advance(5)
        assert [bool(s.robot.reflexes.tripped) for s in worlds.simulations] == [False, True]


def test_one_arm_that_was_stopped_leaves_the_other_one_checked():
    simulation = Simulation(compose('Baxter'))
    robot = simulation.robot
    robot.set_reflex('arm', 'discontinuity', 1.0)
    for side in ('right', 'left'):
        index = robot.joints.indices_of(side)[0]
        command, = robot.parse.joint_command([robot.joints.names[index]], position=[
            float(robot.joints.setpoints.position[index]) + 0.1])
        robot.apply(command)
        simulation.advance(5)
        assert command.handle.status is Status.ABORTED
    assert robot.reflexes.tripped.keys() == {'right', 'left'}


def observed(simulation, torques, gain):
    """Yield the residual of the formula itself, from states and efforts of single steps."""
    model, data = simulation.model, simulation.data
    dofs = simulation.robot.joints.dofs(np.arange(7))

    def inertia():
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        return matrix
    integral = residual = np.zeros(model.nv)
    start = inertia() @ data.qvel
    for torque in torques:
        before, bias = inertia(), data.qfrc_bias.copy()
        command, = simulation.robot.parse.joint_command(
            simulation.robot.joints.names[:7], effort=torque)
        simulation.robot.apply(command)
        simulation.advance(1)
        mass, dt = inertia(), simulation.timestep_s
        # C^T v - g is the change of the inertia times the velocity less what MuJoCo calls bias.
        known = (simulation.efforts.values - model.dof_damping * data.qvel
                 + (mass - before) @ data.qvel / dt - bias)
        integral = integral + dt * (known + residual)
        residual = gain * (mass @ data.qvel - start - integral)
        yield residual[dofs]


def test_the_residual_of_collisions_is_that_of_the_momentum_by_its_formula():
    simulation = Simulation(compose('Panda'))
    robot = simulation.robot
    robot.set_control_mode('arm', 'effort')
    robot.set_reflex('arm', 'collision', 500.0)
    swings = 3.0 * np.sin(0.04 * np.arange(400)[:, None] + np.arange(7)) * [4, 4, 3, 3, 1, 1, 1]
    gain = -np.expm1(-100.0 * 0.002) / 0.002  # Of sums that are as fast as an integral with 100.
    for number, residual in enumerate(observed(simulation, swings, gain)):
        seen = robot.external_efforts('arm')
        if number > 150:
            simulation.data.body('robot0_link4').xfrc_applied[:3] = [20.0, 10.0, 0.0]
            simulation.data.body('gripper0_right_leftfinger').xfrc_applied[0] = 4.0
            simulation.data.body('gripper0_right_right_gripper').xfrc_applied[1:3] = [10.0, -5.0]
        else:
            np.testing.assert_array_equal(seen, 0.0)
        np.testing.assert_allclose(seen, residual, atol=0.02 * max(1.0, np.abs(seen).max()))
    assert np.abs(seen).max() > 3.0 and np.abs(simulation.data.qvel[:7]).max() > 0.5


@pytest.mark.parametrize(('name', 'body'), [
    ('Panda', 'robot0_link4'), ('UR5e', 'robot0_forearm_link'), ('PandaOmron', 'robot0_link4')])
@pytest.mark.parametrize('friction', [None, 'catalogue'])
def test_a_push_of_twice_the_threshold_at_a_link_is_found_within_20_ms(name, body, friction):
    robot = create_robot(name)
    if friction is not None:
        robot.set_actuation('arm', friction=friction)
    simulation = Simulation(compose(robot))
    robot = simulation.robot
    robot.set_reflex('arm', 'collision', 'default')
    simulation.advance(5)
    assert not robot.reflexes.tripped and not robot.external_efforts('arm').any()
    jacobian, model = np.zeros((3, simulation.model.nv)), simulation.model
    mujoco.mj_jacBodyCom(model, simulation.data, jacobian, None, model.body(body).id)
    indices = robot.joints.indices_of('arm')
    torques = jacobian[1, robot.joints.dofs(indices)]  # Of 1 N along y.
    shares = np.abs(torques) / (0.25 * robot.joints.efforts_allowed(indices))
    push = simulation.data.body(body).xfrc_applied
    push[1] = 0.9 / shares.max()
    simulation.advance(50)
    np.testing.assert_allclose(robot.external_efforts('arm'), push[1] * torques, atol=0.01 * 20)
    simulation.advance(5)
    assert not robot.reflexes.tripped
    push[1] = 0.0
    simulation.advance(200)
    push[1] = 2.0 / shares.max()
    for _ in range(10):
        simulation.advance(1)
    simulation.advance(1)  # It is looked at when a period begins.
    assert f"at joint '{robot.joints.names[indices[shares.argmax()]]}', allowed is" in (
        robot.reflexes.tripped['arm'])
    robot.reset_reflexes()
    simulation.advance(50)
    assert robot.reflexes.counts['arm'] == 1  # A lasting push is seen when that period has ended.
    simulation.advance(5)
    assert robot.reflexes.counts['arm'] == 2
    push[1] = 0.0
    robot.emergency_stop()
    robot.recover()
    for _ in range(20):
        simulation.advance(1)
    assert robot.safety_state == 'running'


@pytest.mark.parametrize('name', ['Panda', 'PandaOmron', 'Baxter'])
def test_motion_at_the_limits_with_friction_is_no_collision(name, operator_of):
    model = create_robot(name)
    model.set_actuation('arm', friction='catalogue' if name != 'Baxter' else {'coulomb': 2.0})
    op = operator_of(model)
    robot = op.simulation.robot
    for part in robot.reflexes.limits:
        robot.set_reflex(part, 'collision', 1e-9)
    names = op.joints_of('right')[:4]
    for sign in (1.0, -1.0):
        op.go(dict(zip(names, op.where(*names) + sign * np.array([0.8, 0.3, 0.8, 0.3]))))
        op.run(0.25)
        assert np.abs(op.simulation.data.qvel).max() > 0.8
        op.run(0.45)
    assert not robot.reflexes.tripped


@pytest.mark.parametrize(('value', 'text'), [
    ('none', 'none'), (0, 'none'), (' default', 'default'), ('20', '20'), (20, '20.0'),
    ([20, 20, 18, 18, 16, 14, 12.0], '[20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0]'),
    ('[20, 0, 0, 0, 0, 0, 0]', '[20, 0, 0, 0, 0, 0, 0]')])
def test_thresholds_of_collisions_are_words_or_numbers(value, text, panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('right', 'collision', value)
    acting = robot.settings['reflex.arm.collision']
    assert acting == text and robot.reflexes.observes is (text != 'none')
    robot.set_reflex('arm', 'collision', acting)
    assert robot.settings['reflex.arm.collision'] == text
    robot.set_reflex('arm', 'collision', 'none')
    assert not robot.reflexes.armed and not robot.reflexes.observes


@pytest.mark.parametrize(('value', 'message'), [
    ('always', "must be 'none', 'default', a number or one for each joint"), ('', 'must be'),
    ([20.0] * 6, 'must have 7 numbers, got 6'), ('[1, 2]', 'must have 7 numbers, got 2'),
    ('[20', r"got '\[20'"), ('20]', 'must be'), ('[[20]]', 'must be'),
    (-1.0, 'must be positive and finite, or 0'), ('[nan]', 'must be finite'),
    ([-1.0], 'must be positive, or 0 for none'), (True, 'must be'),
    (float('inf'), 'must be positive'), (None, 'must be'), ({}, 'must'), ([[1.0]], 'must have')])
def test_other_thresholds_of_collisions_are_rejected_and_change_nothing(value, message, panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'collision', 'default')
    digest = panda_sim.digest()
    with pytest.raises(CommandError, match=message):
        robot.set_reflex('arm', 'collision', value)
    assert panda_sim.digest() == digest


def test_a_residual_is_a_part_of_states_and_worlds_stop_where_they_are_pushed():
    with Worlds(compose('Panda'), 2) as worlds:
        for simulation in worlds.simulations:
            simulation.robot.set_reflex('arm', 'collision', '[20, 20, 18, 18, 16, 14, 12]')
        pushed = worlds.simulations[1]
        pushed.data.body('robot0_link4').xfrc_applied[1] = 100.0
        worlds.advance(5)
        alone, saved = Simulation(compose('Panda')), pushed.save()
        alone.restore(saved)
        alone.data.xfrc_applied[:] = pushed.data.xfrc_applied
        for _ in range(3):
            worlds.advance(5)
            alone.advance(5)
        assert alone.digest() == pushed.digest()
        assert [bool(s.robot.reflexes.tripped) for s in worlds.simulations] == [False, True]
        alone.reset()
        assert not alone.robot.external_efforts('arm').any()


def test_a_robot_without_a_gripper_feels_collisions_too():
    simulation = Simulation(compose('Panda', gripper='none'))
    robot, data = simulation.robot, simulation.data
    robot.set_reflex('arm', 'collision', 'default')
    simulation.advance(5)
    data.body('robot0_link4').xfrc_applied[1] = 100.0
    simulation.advance(50)
    push = robot.external_efforts('arm')[0]
    lever = data.body('robot0_link4').xipos[0] - data.body('robot0_link1').xpos[0]
    assert push == pytest.approx(100.0 * lever, rel=0.01)
