# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Payloads of arms: carried in each mode, left out of the external wrench, and estimated."""

import numpy as np
import pytest

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.laws import law
from manip_sim.models import compose
from manip_sim.models.world import World
from manip_sim.simulation import Payload, Simulation
from manip_sim.worlds import Worlds

MASS, CENTER = 0.6, np.array([0.02, 0.03, 0.08])


@law(parameters={'stiffness': 300.0, 'damping': 30.0})
def spring(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    """Pull joints to their setpoints."""
    for i in range(len(q)):
        effort[i] = (bias[i] + parameters[0] * (setpoint[i, 0] - q[i]) - parameters[1] * v[i])


def hang(simulation, arm='right', mass=MASS):
    """Let a weight pull at the tool of an arm, from now on and until it moves."""
    model, data = simulation.model, simulation.data
    site = simulation.robot.end_effectors[arm].external.site
    body, axes = model.site_bodyid[site], data.site_xmat[site].reshape(3, 3)
    force = mass * model.opt.gravity
    data.xfrc_applied[body, :3] = force
    data.xfrc_applied[body, 3:] = np.cross(
        data.site_xpos[site] + axes @ CENTER - data.xipos[body], force)


def settled(simulation, seconds=2.0):
    """Return how far joints go from where they are, and the external wrench then."""
    before = simulation.robot.state().position
    for _ in range(round(seconds / 0.01)):
        hang(simulation)
        simulation.advance(5)
    state = simulation.robot.state()
    wrench = state.end_effectors['right'].external_wrench
    return np.abs(state.position - before).max(), np.linalg.norm(wrench.force)


def begin(robot, mode):
    """Let an arm be at rest where it is in some mode."""
    position, names = robot.state().position[robot.indices_of['right']], [
        robot.joints.names[i] for i in robot.joints.indices_of('right')]
    if mode == 'law':
        robot.set_law('right', spring)
        return
    robot.set_control_mode('right', 'effort' if mode.startswith('cartesian') else mode)
    if mode == 'impedance':
        robot.apply(*robot.parse.joint_impedance(
            names, position, stiffness=[200.0] * len(names), damping=[20.0] * len(names)))
    elif mode == 'effort':
        robot.set_command_timeout('right', 0.0)
        robot.apply(*robot.parse.joint_command(names, effort=np.zeros(len(names))))
    elif mode.startswith('cartesian'):
        if mode == 'cartesian impedance':
            robot.joints.cartesian.set('right', 'cartesian_stiffness', [500.0] * 3 + [30.0] * 3)
        pose = robot.state().end_effectors['right'].pose
        robot.apply(robot.parse_cartesian.pose('right', pose.position, pose.quat_xyzw))


@pytest.mark.parametrize('mode', ['position', 'velocity', 'impedance', 'effort', 'cartesian',
                                  'cartesian impedance', 'law'])
def test_a_declared_payload_bends_no_posture_in_any_mode(panda, mode):
    simulation = Simulation(World([panda]))
    simulation.advance(5)
    begin(simulation.robot, mode)
    simulation.robot.set_payload('right', MASS, CENTER)
    bent, force = settled(simulation, 0.5)
    assert bent < 1e-4 and force < 5e-3
    simulation.robot.set_payload('right', 0.0)
    bent, force = settled(simulation, 0.2)
    assert bent > 2e-4 and force > 0.2 * MASS * 9.81


@pytest.mark.full
@pytest.mark.parametrize('name', ['GR1', 'Tiago', 'UR5e', 'Baxter'])
def test_torsos_and_free_robots_carry_payloads_too(name):
    simulation = Simulation(compose(name))
    simulation.advance(5)
    simulation.robot.set_payload('right', MASS, CENTER)
    assert settled(simulation) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-3))


def holding(name, mass=0.5):
    """Return a simulation in which a gripper holds a cube, whose centre is at the grasp frame."""
    place = Simulation(compose(name)).robot.state().end_effectors['right'].pose.position
    simulation = Simulation(compose(name, objects=[{
        'name': 'cube', 'shape': 'box', 'size': [0.04] * 3, 'mass': mass,
        'friction': 2.0, 'position': place.tolist()}]))
    gravity, robot = simulation.model.opt.gravity.copy(), simulation.robot
    simulation.model.opt.gravity[:] = 0.0
    robot.apply(robot.parse.action('right/gripper', np.ones(1)))
    for _ in range(150):
        simulation.advance(5)
    simulation.model.opt.gravity[:] = gravity
    for _ in range(100):
        simulation.advance(5)
    return simulation


def center_of(simulation):
    """Return where the cube is in ft_frame."""
    site = simulation.robot.end_effectors['right'].external.site
    return simulation.data.site_xmat[site].reshape(3, 3).T @ (
        simulation.data.body('cube').xpos - simulation.data.site_xpos[site])


def test_a_cube_that_is_held_in_fast_motion_is_no_collision():
    simulation = holding('Panda')
    robot, most = simulation.robot, []
    robot.set_reflex('arm', 'collision', 'default')
    limits = 0.25 * robot.joints.efforts_allowed(robot.joints.indices_of('arm'))
    for declared in (False, True):
        if declared:
            robot.set_payload('right', 0.5, center_of(simulation), [0.5 * 0.04**2 / 6.0] * 6 * (
                np.array([1, 0, 0, 1, 0, 1])))
            simulation.advance(100)
        shares = []
        for sign in (1.0, -1.0):
            goal = robot.joints.setpoints.position[:4] + sign * np.array([0.6, 0.2, 0.6, 0.3])
            robot.apply(*robot.parse.joint_command(robot.joints.names[:4], position=goal))
            for _ in range(60):
                simulation.advance(5)
                shares.append(np.abs(robot.external_efforts('arm') / limits).max())
        most.append(max(shares))
    assert not robot.reflexes.tripped
    assert 0.1 < most[0] < 0.6 and most[1] < 0.1, most


def moved_by_osc(simulation, declares):
    """Return where an end effector goes that OSC is to move by 0.1 m to the side and up [m]."""
    robot = simulation.robot
    if declares:
        robot.set_payload('right', 1.0, center_of(simulation), np.array(
            [1, 0, 0, 1, 0, 1]) * 0.04**2 / 6.0)
    robot.set_control_mode('arm', 'effort')
    robot.joints.cartesian.set('right', 'stiffness', 300.0)
    start, path = robot.state().end_effectors['right'].pose, []
    for way, periods in ((0.0, 30), (0.1, 50)):
        robot.apply(robot.parse_cartesian.pose(
            'right', start.position + [0.0, way, way], start.quat_xyzw))
        for _ in range(periods):
            simulation.advance(5)
            path.append(robot.state().end_effectors['right'].pose.position)
    return np.array(path[30:]) - path[29]


def test_osc_moves_a_declared_cube_as_if_the_arm_held_nothing():
    free = Simulation(compose('Panda'))
    free.robot.apply(free.robot.parse.action('right/gripper', np.ones(1)))
    for _ in range(250):
        free.advance(5)
    alone = moved_by_osc(free, False)
    off, unknown = (np.abs(moved_by_osc(holding('Panda', 1.0), declares) - alone)
                    for declares in (True, False))
    assert off[-1].max() < 1e-4 < 5e-4 < unknown[-1].max() and off.max() < 0.6 * unknown.max()


@pytest.mark.parametrize('name', [
    'Panda', *(pytest.param(name, marks=pytest.mark.full) for name in ('UR5e', 'IIWA'))])
def test_a_held_cube_is_estimated_and_then_neither_bends_the_arm_nor_is_read(name, run):
    simulation = holding(name)
    robot = simulation.robot
    estimate = simulation.estimate_payload('right')
    payload = estimate.payload
    assert payload.mass == pytest.approx(0.5, rel=0.01)
    assert estimate.mass_error < 0.005
    np.testing.assert_allclose(payload.center_of_mass, center_of(simulation), atol=0.002)
    assert max(estimate.center_of_mass_error) < 0.002
    joints = robot.indices_of['right']
    goal = np.array([robot.joints.setpoints.position[i] for i in robot.joints.indices_of('right')])
    bent = np.abs(robot.state().position[joints] - goal).max()
    inertia = 0.5 * 0.04**2 / 6.0
    robot.set_payload('right', 0.5, center_of(simulation), [inertia, 0, 0, inertia, 0, inertia])
    run(simulation, 1.0)
    left = np.abs(robot.state().position[joints] - goal).max()
    assert bent > 5e-5 and left < 0.01 * bent
    wrench = robot.state().end_effectors['right'].external_wrench
    np.testing.assert_allclose([*wrench.force, *wrench.torque], 0.0, atol=0.01)
    # On the way, it is read without its inertia either; of a weight of 4.9 N.
    forces = []
    goal = goal + 0.3 * (np.arange(len(goal)) == 0)
    robot.apply(robot.parse.trajectory(
        'right', [robot.joints.names[i] for i in robot.joints.indices_of('right')], [0.5],
        [goal], [0.0 * goal]))
    run(simulation, 0.5, lambda: forces.append(np.linalg.norm(
        robot.state().end_effectors['right'].external_wrench.force)))
    assert max(forces) < 0.3
    run(simulation, 0.5)
    simulation.data.body('cube').xfrc_applied[:3] = [0.0, 0.0, -3.0]
    run(simulation, 0.5)
    wrench = robot.state().end_effectors['right'].external_wrench
    assert np.linalg.norm(wrench.force) == pytest.approx(3.0, abs=0.02)


@pytest.mark.full
def test_an_estimate_of_nothing_is_zero_and_noise_and_offsets_of_the_sensor_are_told(panda):
    simulation = Simulation(World([panda]))
    found = simulation.estimate_payload('right')
    assert found.payload == Payload() and found.mass_error < 1e-6
    for name, value in (('noise.wrench_bias', 5.0), ('noise.wrench_force', 0.5),
                        ('noise.wrench_torque', 0.05)):
        simulation.robot.sensing.set(name, value)
    found = simulation.estimate_payload('right')
    assert found.payload == Payload() and 0.001 < found.mass_error < 0.05
    advance = simulation.advance

    def with_weight(steps):
        hang(simulation)
        advance(steps)
    simulation.advance = with_weight
    for declared in (0.0, 0.4):  # A payload that is declared already makes no difference.
        simulation.robot.set_payload('right', declared, [0.0, 0.0, 0.1])
        found = simulation.estimate_payload('right')
        assert abs(found.payload.mass - MASS) < 4.0 * found.mass_error < 0.1
        assert (np.abs(found.payload.center_of_mass - CENTER)
                < 4.0 * np.array(found.center_of_mass_error)).all()


def test_an_arm_that_cannot_estimate_its_payload_says_why(panda):
    simulation = Simulation(World([panda]))
    robot, digest = simulation.robot, simulation.digest()
    with pytest.raises(UnknownNameError, match="'left'"):
        simulation.estimate_payload('left')
    with pytest.raises(UnknownNameError, match="'robot1'"):
        simulation.estimate_payload('right', robot='robot1')
    assert simulation.digest() == digest
    robot.apply(*robot.parse.joint_command(robot.joints.names[:1], position=[1.0]))
    simulation.advance(5)
    with pytest.raises(CommandError, match='follows another command'):
        simulation.estimate_payload('right')
    robot.set_control_mode('right', 'velocity')
    with pytest.raises(CommandError, match='in position mode, but it is in velocity mode'):
        simulation.estimate_payload('right')
    robot.set_control_mode('right', 'position')
    robot.emergency_stop()
    with pytest.raises(CommandError, match='could not be estimated: the robot is in emergency'):
        simulation.estimate_payload('right')


def test_an_arm_that_cannot_turn_its_gripper_estimates_no_payload(panda):
    simulation = Simulation(World([panda]))
    simulation.model.opt.gravity[:] = 0.0
    with pytest.raises(CommandError, match='turn the gripper too little'):
        simulation.estimate_payload('right')


@pytest.mark.parametrize('numbers, match', [
    ({'mass': -1.0}, 'the mass of a payload must be positive'),
    ({'mass': float('nan')}, 'the mass of a payload must be positive'),
    ({'mass': True}, 'the mass of a payload must be positive'),
    ({'mass': 1e308}, 'the mass of a payload must be within 1000'),
    ({'mass': 1.0, 'center_of_mass': [0.0, 0.0, -11.0]}, 'center_of_mass .* must be within 10,'),
    ({'mass': 1.0, 'inertia': [1e30, 0.0, 0.0, 1e30, 0.0, 1e30]}, 'inertia .* must be within'),
    ({'mass': 1.0, 'center_of_mass': [0.0, 0.1]}, 'center_of_mass .* must have 3 numbers, got 2'),
    ({'mass': 1.0, 'center_of_mass': [0.0, 0.1, float('inf')]}, 'must be finite, got inf'),
    ({'mass': 1.0, 'inertia': [1.0] * 3}, 'inertia .* must have 6 numbers, got 3'),
    ({'mass': 1.0, 'inertia': [1.0, 0.0, 0.0, 1.0, 0.0, -1.0]}, 'no body has the inertia'),
    ({'mass': 1.0, 'inertia': [1.0, 0.0, 0.0, 1.0, 0.0, 3.0]}, 'principal moments would be'),
    ({'mass': 1.0, 'inertia': [0.1, 0.5, 0.0, 0.1, 0.0, 0.1]}, 'no body has the inertia')])
def test_a_payload_that_cannot_be_is_rejected_and_nothing_changes(panda, numbers, match):
    simulation = Simulation(World([panda]))
    simulation.robot.set_payload('right', 0.1, [0.0, 0.0, 0.1], [1e-4, 0, 0, 1e-4, 0, 2e-4])
    digest = simulation.digest()
    with pytest.raises(CommandError, match=match):
        simulation.robot.set_payload('right', **numbers)
    with pytest.raises(UnknownNameError, match="'left'"):
        simulation.robot.set_payload('left', 1.0)
    assert simulation.digest() == digest and simulation.robot.payload('right').mass == 0.1


@pytest.mark.parametrize('name', ['Panda', 'UR5e', 'SO101'])
@pytest.mark.parametrize('mode', [
    'position', 'velocity', 'effort', 'impedance', 'cartesian', 'cartesian impedance', 'law'])
def test_the_greatest_payload_does_not_make_the_physics_diverge(name, mode):
    simulation = Simulation(compose(name))
    begin(simulation.robot, mode)
    simulation.robot.set_payload('right', 1e3, [10.0] * 3, [1e3, 0.0, 0.0, 1e3, 0.0, 1e3])
    for _ in range(50):
        simulation.advance(10)
    assert simulation.diverged is None


def test_payloads_of_worlds_are_their_own_and_survive_a_reset(panda):
    worlds = Worlds(World([panda]), 3)
    alone = Simulation(World([panda]))
    worlds.robot.set_payload('right', [5.0, MASS, 7.0], CENTER, where=[False, True, False])
    alone.robot.set_payload('right', MASS, CENTER)
    for own in (worlds.robot[1], alone.robot):
        own.set_integral_gain('arm', 2.0)
    goals, names = np.full((3, 7), 0.3), alone.robot.joints.names
    worlds.robot.command.joint_command(names, position=goals)
    alone.robot.apply(*alone.robot.parse.joint_command(names, position=goals[1]))
    for _ in range(20):
        worlds.advance(5)
        alone.advance(5)
    digests = worlds.digest()
    assert digests[1] == alone.digest() != digests[0] == digests[2]
    alone.reset()
    assert alone.robot.payload('right') == Payload(MASS, tuple(CENTER.tolist()))
    digests = worlds.digest()
    for numbers, match in (({'mass': [1.0, 2.0]}, 'mass must have a leading axis of 3'),
                           ({'mass': [1.0, 2.0, -1.0]}, 'the mass of a payload must be positive'),
                           ({'mass': 1.0, 'center_of_mass': np.zeros((2, 3))}, 'center_of_mass'),
                           ({'mass': 1.0, 'inertia': [1.0] * 5}, 'must have the shape'),
                           ({'mass': float('nan')}, 'must be positive'),
                           ({'mass': 1.0, 'where': [1, 0, 1]}, 'where must be 3 truth values')):
        with pytest.raises(CommandError, match=match):
            worlds.robot.set_payload('right', **numbers)
    with pytest.raises(UnknownNameError, match="'left'"):
        worlds.robot.set_payload('left', 1.0)
    assert worlds.digest() == digests
    worlds.robot.set_payload('right', [0.1, 0.2, 0.3], np.eye(3), np.diag([1.0] * 6)[[0, 3, 5]] + [
        1, 0, 0, 1, 0, 1])
    assert [robot.payload('right').mass for robot in worlds.robot] == [0.1, 0.2, 0.3]
    assert worlds.robot[1].payload('right').center_of_mass == (0.0, 1.0, 0.0)


def test_a_law_of_a_user_feels_no_declared_payload(panda):
    simulation = Simulation(World([panda]))
    felt = []

    def feeling(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        felt.append(wrench.copy())
        for i in range(len(q)):
            effort[i] = bias[i] + 300.0 * (setpoint[i, 0] - q[i]) - 30.0 * v[i]
    simulation.robot.set_law('right', feeling)
    simulation.robot.set_payload('right', MASS, CENTER)
    settled(simulation, 0.2)
    np.testing.assert_allclose(felt[-1], 0.0, atol=1e-6)
    simulation.robot.set_payload('right', 0.0)
    settled(simulation, 0.02)
    assert np.linalg.norm(felt[-1][:3]) == pytest.approx(MASS * 9.81, rel=0.2)
