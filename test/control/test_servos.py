# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the three control modes on the Panda and on actuators of other kinds."""

import itertools

import mujoco
import numpy as np
import pytest
from robot_kinds import KINDS
from sampling import Driven, sampled, whole_robot

from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.actuators import is_position_servo, position_servos, stiffness_and_damping
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

#: Franka Emika data sheet.
TORQUE_LIMITS_N_M = np.array([87.0] * 4 + [12.0] * 3)
ACTUATORS = {
    'motor': '<motor name="a" joint="joint1" ctrlrange="-30 30"/>',
    'motor with slow gear': '<motor name="a" joint="joint1" gear="50" ctrlrange="-0.6 0.6"/>',
    'motor with fast gear': '<motor name="a" joint="joint1" gear="0.1" ctrlrange="-300 300"/>',
    'motor turned round': '<motor name="a" joint="joint1" gear="-2" ctrlrange="-15 15"/>',
    'motor in parent': '<motor name="a" jointinparent="joint1" ctrlrange="-30 30"/>',
    'position servo': '<position name="a" joint="joint1" kp="2000" kv="40" forcerange="-30 30"/>',
    'position servo without damping': '<position name="a" joint="joint1" kp="2000" gear="2"/>',
    'velocity servo': '<velocity name="a" joint="joint1" kv="30" ctrlrange="-1 1"/>',
    'velocity servo with gear': '<velocity name="a" joint="joint1" kv="2" gear="4" '
                                'ctrlrange="-3 3"/>',
    'integrated velocity servo': '<intvelocity name="a" joint="joint1" kp="2000" kv="40" '
                                 'actrange="-2 2" ctrlrange="-1 1"/>'}

#: One link that hangs to the side of a hinge, whose weight needs -2.5 N m.
LINK = """
<body name="base">
  <geom size="0.05" mass="1"/>
  <body name="link1" pos="0 0 1">
    <joint name="joint1" axis="0 1 0" range="-2 2" damping="0.5"/>
    <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
    <site name="hook"/>
    <body name="right_hand" pos="0.5 0 0"/>
  </body>
</body>
"""


@pytest.fixture
def sim_of(one_joint_arm):
    """Return a function that makes a simulation of one joint with an actuator."""
    return lambda actuator: Simulation(World([one_joint_arm(actuator)]))


def command(simulation, mode, joint, value):
    """Apply a goal for one joint in a mode."""
    simulation.robot.apply(*simulation.robot.parse.joint_command([joint], **{mode: [value]}))


@pytest.mark.parametrize(('gain', 'bias', 'factor', 'slope', 'expected'), [
    ('fixed', 'affine', 9, -9, True), ('fixed', 'affine', 1, -4, True),
    ('affine', 'affine', 9, -9, False), ('fixed', 'none', 9, -9, False),
    ('fixed', 'affine', -9, -9, False), ('fixed', 'affine', 0, -9, False),
    ('fixed', 'affine', 9, 9, False), ('fixed', 'affine', 9, 0, False)])
def test_a_position_servo_pulls_towards_its_control(gain, bias, factor, slope, expected):
    spec = mujoco.MjSpec.from_string(f"""
<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>
  <actuator><general name="a" joint="a" gaintype="{gain}" gainprm="{factor}"
    biastype="{bias}" biasprm="0 {slope}"/></actuator></mujoco>""")
    assert is_position_servo(spec.actuator('a')) is expected
    assert position_servos(spec.compile(), [0]).tolist() == [expected]


@pytest.mark.full
@pytest.mark.parametrize('joint', range(7))
def test_position_mode_follows_a_sine(panda_sim, joint):
    robot = panda_sim.robot
    name, middle = robot.joint_names[joint], robot.robot_model.init_qpos[joint]
    errors = []
    for k in range(300):
        goal = middle + 0.2 * (1.0 - np.cos(2.0 * np.pi * 0.5 * k * 0.01)) / 2.0
        command(panda_sim, 'position', name, goal)
        panda_sim.advance(5)
        errors.append(panda_sim.robot.state().position[joint] - goal)
    # The goal moves at up to 0.31 rad/s and is met 15 to 20 ms late.
    assert np.sqrt(np.mean(np.square(errors))) < 0.006


def test_effort_mode_floats_with_zero_effort(panda_sim, run):
    panda_sim.robot.set_control_mode('arm', 'effort')
    start = panda_sim.robot.state().position
    command(panda_sim, 'effort', panda_sim.robot.joint_names[0], 0.0)
    run(panda_sim, 5.0)
    np.testing.assert_allclose(panda_sim.robot.state().position, start, atol=0.01)
    gives = panda_sim.robot.controller_state('arm').reference.gives_effort
    assert gives.tolist() == [True] + [False] * 6


def test_the_reference_effort_is_that_of_the_command_and_zero_for_servos(panda_sim, run):
    panda_sim.robot.set_control_mode('arm', 'effort')
    command(panda_sim, 'effort', panda_sim.robot.joint_names[1], 0.5)
    run(panda_sim, 0.05)
    reference = panda_sim.robot.controller_state('arm').reference
    np.testing.assert_array_equal(reference.effort, [0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_servos_need_no_force_for_joints_that_give_effort(panda_sim, run):
    panda_sim.robot.set_control_mode('arm', 'effort')
    before = panda_sim.data.act[:7].copy()
    command(panda_sim, 'effort', panda_sim.robot.joint_names[1], 0.0)
    run(panda_sim, 0.01)
    np.testing.assert_allclose(np.delete(panda_sim.data.act[:7] - before, 1), 0.0, atol=1e-9)


@pytest.mark.parametrize('joint', range(7))
def test_velocity_mode_meets_the_velocity(panda_sim, run, joint):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    command(panda_sim, 'velocity', panda_sim.robot.joint_names[joint], 0.2)
    run(panda_sim, 0.5)
    np.testing.assert_allclose(panda_sim.robot.state().velocity[joint], 0.2, rtol=5e-3)
    others = np.delete(panda_sim.robot.state().velocity[:7], joint)
    assert np.abs(others).max() < 0.01


@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
def test_torque_limits_hold_in_every_mode(panda_sim, mode):
    panda_sim.robot.set_control_mode('arm', mode)
    largest = np.zeros(7)
    for k in range(80):
        sign = 1.0 if k // 20 % 2 else -1.0
        action = sign * np.array([1, -1, 1, -1, 1, -1, 1])
        panda_sim.robot.apply(panda_sim.robot.parse.action('arm', action))
        panda_sim.advance(5)
        largest = np.maximum(largest, np.abs(panda_sim.data.qfrc_actuator[:7]))
    assert (largest <= TORQUE_LIMITS_N_M + 1e-9).all()
    assert (largest > 0.5 * TORQUE_LIMITS_N_M).any()


@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('actuator', ['motor', 'motor with slow gear', 'position servo'])
def test_torque_limit_of_the_actuator_holds_a_blocked_joint(sim_of, actuator, mode):
    simulation = sim_of(ACTUATORS[actuator])
    simulation.robot.set_control_mode('arm', mode)
    simulation.data.xfrc_applied[simulation.model.body('robot0_link1').id, 4] = -500.0
    simulation.robot.apply(simulation.robot.parse.action('arm', [1.0]))
    efforts = []
    for _ in range(10):
        simulation.advance(5)
        efforts.append(abs(simulation.data.qfrc_actuator[0]))
    assert max(efforts) == pytest.approx(30.0)


@pytest.mark.parametrize('first', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('second', ['position', 'velocity', 'effort'])
def test_mode_change_holds_the_robot_without_a_jump(panda_sim, run, first, second):
    panda_sim.robot.set_control_mode('arm', first)
    run(panda_sim, 0.1)
    panda_sim.robot.set_control_mode('arm', second)
    before = panda_sim.robot.state().position
    assert panda_sim.robot.joints.mode_of(panda_sim.robot.joint_names[0]) == second
    run(panda_sim, 0.5)
    np.testing.assert_allclose(panda_sim.robot.state().position, before, atol=1e-4)


def test_mode_change_while_moving_stops_within_a_few_centiradians(panda_sim, run):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    command(panda_sim, 'velocity', panda_sim.robot.joint_names[0], 0.5)
    run(panda_sim, 0.3)
    here = panda_sim.robot.state().position[0]
    panda_sim.robot.set_control_mode('arm', 'position')
    run(panda_sim, 0.5)
    assert abs(panda_sim.robot.state().velocity[0]) < 1e-3
    assert abs(panda_sim.robot.state().position[0] - here) < 0.02


def test_unknown_mode_tells_the_three(panda_sim):
    with pytest.raises(UnknownNameError, match="^unknown control mode 'torque': .*available: "
                                               'position, velocity, effort, impedance$'):
        panda_sim.robot.set_control_mode('arm', 'torque')
    assert panda_sim.robot.joints.mode_of(panda_sim.robot.joint_names[0]) == 'position'


@pytest.mark.full
@pytest.mark.parametrize('actuator', ACTUATORS)
def test_every_kind_of_actuator_comes_to_a_position(sim_of, run, actuator):
    simulation, positions = sim_of(ACTUATORS[actuator]), []
    command(simulation, 'position', 'robot0_joint1', 0.5)
    run(simulation, 1.0, lambda: positions.append(simulation.robot.state().position[0]))
    assert positions[-1] == pytest.approx(0.5, abs=1e-4)
    assert max(positions) < 0.501


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_every_kind_of_actuator_meets_a_velocity(sim_of, run, actuator):
    simulation = sim_of(ACTUATORS[actuator])
    simulation.robot.set_control_mode('arm', 'velocity')
    command(simulation, 'velocity', 'robot0_joint1', 0.4)
    run(simulation, 0.5)
    assert simulation.robot.state().velocity[0] == pytest.approx(0.4, rel=0.02)


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_damping_of_the_joint_does_not_slow_a_velocity(one_joint_arm, run, actuator):
    robot = one_joint_arm(ACTUATORS[actuator])
    robot.set_joint_attribute('damping', [20.0])
    simulation = Simulation(World([robot]))
    simulation.robot.set_control_mode('arm', 'velocity')
    command(simulation, 'velocity', 'robot0_joint1', 0.4)
    run(simulation, 0.5)
    assert simulation.robot.state().velocity[0] == pytest.approx(0.4, rel=2e-3)
    # Nor does it make the joint lag behind its setpoint.
    setpoint = simulation.robot.controller_state('arm').reference.position[0]
    assert simulation.robot.state().position[0] == pytest.approx(setpoint, abs=1e-4)


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_every_kind_of_actuator_gives_an_effort(sim_of, actuator):
    simulation = sim_of(ACTUATORS[actuator])
    simulation.robot.set_control_mode('arm', 'effort')
    command(simulation, 'effort', 'robot0_joint1', 0.7)
    simulation.advance(5)
    gravity = simulation.data.qfrc_gravcomp[0]
    assert simulation.robot.state().effort[0] - gravity == pytest.approx(0.7)


def test_gear_does_not_change_the_motion_of_a_motor(sim_of, run):
    ends = []
    for actuator in ('motor', 'motor with slow gear', 'motor with fast gear', 'motor in parent'):
        simulation = sim_of(ACTUATORS[actuator])
        command(simulation, 'position', 'robot0_joint1', 0.5)
        run(simulation, 0.12)
        ends.append(simulation.robot.state().position[0])
    np.testing.assert_allclose(ends, ends[0], rtol=1e-9)


@pytest.mark.parametrize(('actuator', 'limits'), [
    ('motor with slow gear', {'velocity': np.pi, 'effort': 30.0, 'position': 2.0}),
    ('velocity servo', {'velocity': 1.0}), ('velocity servo with gear', {'velocity': 0.75}),
    ('position servo', {'effort': 30.0}), ('integrated velocity servo', {'position': 2.0})])
def test_limits_are_those_at_the_joint(sim_of, actuator, limits):
    simulation = sim_of(ACTUATORS[actuator])
    for mode, limit in limits.items():
        simulation.robot.set_control_mode('arm', mode)
        ranges = simulation.robot.joints.ranges(np.array([0]))
        np.testing.assert_allclose(ranges, [[-limit, limit]])


@pytest.mark.parametrize('actuator', [
    '<motor name="pull" tendon="rope"/>', '<motor name="pull" site="hook" gear="0 0 1 0 0 0"/>',
    '<motor name="pull" joint="ball" gear="1 0 0"/>'])
def test_actuator_that_drives_no_hinge_or_slide_belongs_to_no_part(one_joint_arm, actuator):
    link = LINK.replace('<site name="hook"', '<body><joint name="ball" type="ball"/>'
                        '<geom size="0.01"/></body><site name="hook"')
    robot = one_joint_arm(f'{actuator}<motor name="turn" joint="joint1"/>', link, sections=(
        '<tendon><fixed name="rope"><joint joint="joint1" coef="1"/></fixed></tendon>'))
    simulation = Simulation(World([robot]))
    assert robot.actuators == ['robot0_pull', 'robot0_turn']
    assert robot.arm_actuators == ['robot0_turn']
    assert simulation.robot.parts['arm'].actuators == ('robot0_turn',)
    assert simulation.surroundings.other_actuators == ('robot0_pull',)
    commands = simulation.surroundings.commands['actuators']
    commands.command(commands.checked(['robot0_pull'], [], [], [0.5]))
    simulation.advance(1)
    assert simulation.surroundings.state_of_actuators()[2] == pytest.approx(0.5)


def test_an_actuator_whose_force_comes_from_a_plugin_is_rejected(one_joint_arm):
    robot = one_joint_arm(
        '<plugin name="pid" joint="joint1" plugin="mujoco.pid"><config key="kp" value="9"/>'
        '</plugin>', sections='<extension><plugin plugin="mujoco.pid"/></extension>')
    with pytest.raises(ModelError, match=r"^the force of actuator 'robot0_pid' comes from a "
                                         r'plugin, so its joint cannot have control modes: make '
                                         r'it a motor or a servo$'):
        Simulation(World([robot]))


def test_two_actuators_of_one_joint_are_rejected_by_name(one_joint_arm):
    robot = one_joint_arm('<motor name="a" joint="joint1"/><velocity name="b" joint="joint1"/>')
    with pytest.raises(ModelError, match=r"^joint 'robot0_joint1' is driven by two actuators, "
                                         r"'robot0_a' and 'robot0_b': give it one$"):
        Simulation(World([robot]))


def test_muscle_is_rejected_by_name(one_joint_arm):
    robot = one_joint_arm('<muscle name="biceps" joint="joint1"/>')
    with pytest.raises(ModelError, match=r"^actuator 'robot0_biceps' must be a motor, or a "
                                         r'position or velocity servo: '):
        Simulation(World([robot]))


@pytest.mark.parametrize(('joint', 'actuator', 'limits'), [
    ('actuatorfrcrange="-10 87"', '<motor name="a" joint="joint1"/>', (-10.0, 87.0)),
    ('', '<position name="a" joint="joint1" kp="500" kv="20" forcerange="-60 0"/>', (-60.0, 0.0)),
    ('', '<motor name="a" joint="joint1" ctrlrange="-5 30"/>', (-5.0, 30.0)),
    ('', '<motor name="a" joint="joint1" gear="-2" ctrlrange="-15 10"/>', (-20.0, 30.0)),
    ('', '<motor name="a" joint="joint1" gear="-2" forcerange="-30 10"/>', (-20.0, 60.0)),
    ('actuatorfrcrange="-10 87"', '<motor name="a" joint="joint1" ctrlrange="-30 30"/>',
     (-10.0, 30.0))])
def test_torque_limits_keep_their_two_sides(one_joint_arm, joint, actuator, limits):
    worldbody = LINK.replace('name="joint1"', f'name="joint1" {joint}')
    simulation = Simulation(World([one_joint_arm(actuator, worldbody)]))
    start = simulation.robot.state().position[0]
    for _ in range(50):
        simulation.advance(5)
    # The weight of the arm, -2.5 N m, is within all of them.
    assert simulation.robot.state().position[0] == pytest.approx(start, abs=5e-3)
    simulation.robot.set_control_mode('arm', 'effort')
    np.testing.assert_allclose(simulation.robot.joints.ranges(np.array([0])), [limits])
    for sign, limit in zip((-1.0, 1.0), limits):
        (pushed,) = simulation.robot.parse.joint_command(['robot0_joint1'], effort=[sign * 1e3])
        np.testing.assert_allclose(pushed.values, [limit])
    simulation.robot.set_control_mode('arm', 'position')
    simulation.data.xfrc_applied[simulation.model.body('robot0_link1').id, 4] = 500.0
    simulation.advance(5)
    assert simulation.data.qfrc_actuator[0] == pytest.approx(limits[0])
    simulation.data.xfrc_applied[simulation.model.body('robot0_link1').id, 4] = -500.0
    simulation.advance(200)
    assert simulation.data.qfrc_actuator[0] == pytest.approx(limits[1])


def test_joint_without_an_actuator_is_seen_but_not_driven(one_joint_arm):
    simulation = Simulation(World([one_joint_arm('')], gravity_compensation=False))
    simulation.advance(50)
    expected = mujoco.MjData(simulation.model)
    mujoco.mj_step(simulation.model, expected, 50)
    assert simulation.robot.state().position[0] == expected.qpos[0] > 1e-3


def test_effort_is_what_the_equations_of_motion_need_to_the_last_digit():
    simulation, random = whole_robot('Panda'), np.random.default_rng(2)
    arm, model, data = Driven(simulation, 'arm'), simulation.model, simulation.data
    simulation.robot.set_control_mode('arm', 'effort')
    for _ in range(20):
        effort = random.uniform(-3.0, 3.0, 7)
        arm.command('effort', effort)
        velocity, mass = data.qvel.copy(), np.empty((model.nv, model.nv))
        for row, unit in zip(mass, np.eye(model.nv)):
            mujoco.mj_mulM(model, data, row, unit)
        bias, weight = data.qfrc_bias.copy(), data.qfrc_gravcomp.copy()
        simulation.advance(1)
        acceleration = (data.qvel - velocity) / simulation.timestep_s
        # The integrator takes the damping at the end of the step.
        needed = (mass @ acceleration + bias - weight)[arm.dofs] + (
            arm.damping * data.qvel[arm.dofs])
        np.testing.assert_allclose(needed, effort, atol=1e-9)


def swing(joints, mode, share):
    """Let all joints move in a mode until one is that fast, as a share of its velocity limit."""
    simulation = joints.simulation
    middle = (np.maximum(joints.low, -1e3) + np.minimum(joints.high, 1e3)) / 2.0
    sign = np.where(joints.position < middle, 1.0, -1.0)
    goal = {'position': joints.position + 3.0 * sign,
            'velocity': share * sign * joints.velocity_limit,
            'effort': 0.1 * sign * simulation.robot.limits('right')[:, 1]}[mode]
    joints.command(mode, goal)
    for _ in range(400):
        simulation.advance(5)
        velocity = np.abs(simulation.data.qvel[joints.dofs])
        if (velocity > 0.97 * share * joints.velocity_limit).any():
            return
        if mode == 'velocity':
            joints.command(mode, goal)
    raise AssertionError('no joint is fast enough')


@pytest.mark.full
@pytest.mark.parametrize('name', KINDS)
def test_every_change_of_mode_keeps_the_acceleration_limits(name):
    simulation = whole_robot(name)
    joints, robot = Driven(simulation, 'right'), simulation.robot
    limit = robot.joints.acceleration_limits(robot.joints.find(joints.names))
    for first, second in itertools.permutations(['position', 'velocity', 'effort'], 2):
        for share in (0.3, 0.9):
            simulation.reset()
            robot.set_control_mode('right', first)
            swing(joints, first, share)
            velocity, position = simulation.data.qvel[joints.dofs].copy(), joints.position
            # Where the range ends before, a joint has to brake harder.
            room = np.where(velocity > 0.0, joints.high - position, position - joints.low)
            needed = np.maximum(velocity**2 / (2.0 * np.maximum(room, 1e-9)), limit)
            # It comes to rest as soon as 0.8 times the limits allow, all joints together.
            longest_s = (np.abs(velocity) / (0.8 * limit)).max()
            with sampled(joints) as samples:
                robot.set_control_mode('right', second)
                for _ in range(round(longest_s / 0.01) + 5):
                    simulation.advance(5)
            change = np.abs(np.diff(np.vstack([velocity, samples.velocity]), axis=0)) / 0.002
            assert (change <= needed * (1.0 + 0.15 * (needed > limit))).all(), (first, second)
            assert np.abs(samples.velocity[-1]).max() < 0.02, (first, second)
            assert (np.abs(samples.effort) <= robot.joints.efforts_allowed(
                robot.joints.find(joints.names)) + 1e-9).all()


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity'])
@pytest.mark.parametrize('name', KINDS)
def test_a_runaway_in_effort_mode_brakes_within_the_acceleration_limit(name, mode):
    simulation = whole_robot(name)
    joints, robot = Driven(simulation, 'right'), simulation.robot
    limit = robot.joints.acceleration_limits(robot.joints.find(joints.names))
    robot.set_control_mode('right', 'effort')
    middle = (np.maximum(joints.low, -1e3) + np.minimum(joints.high, 1e3)) / 2.0
    joints.command('effort', np.where(joints.position < middle, 0.1, -0.1)
                   * robot.limits('right')[:, 1])
    too_fast = 1.3 * joints.velocity_limit
    while (np.abs(simulation.data.qvel[joints.dofs]) < too_fast).all():
        simulation.advance(5)
    position, velocity = joints.position, simulation.data.qvel[joints.dofs].copy()
    room = np.where(velocity > 0.0, joints.high - position, position - joints.low)
    needed = velocity**2 / (2.0 * np.maximum(room, 1e-9))
    with sampled(joints) as samples:
        robot.set_control_mode('right', mode)
        for _ in range(300):
            simulation.advance(5)
    acceleration = np.diff(np.vstack([velocity, samples.velocity]), axis=0) / 0.002
    assert (np.abs(acceleration).max(axis=0) < 1.15 * np.maximum(limit, needed)).all()
    assert np.abs(samples.velocity[-1]).max() < 1e-3
    ended = samples.position[-1]
    assert ((joints.low - 1e-3 < ended) & (ended < joints.high + 1e-3)).all()


def test_a_runaway_near_the_end_of_its_range_brakes_evenly_up_to_there(panda_sim):
    joints, robot = Driven(panda_sim, 'arm'), panda_sim.robot
    robot.set_control_mode('arm', 'effort')
    joints.command('effort', [20.0, *[0.0] * 6])
    for _ in range(30):
        panda_sim.advance(5)
    position, velocity = joints.position[0], panda_sim.data.qvel[0]
    assert velocity > 3.0 * joints.velocity_limit[0]
    with sampled(joints) as samples:
        robot.set_control_mode('arm', 'position')
        for _ in range(100):
            panda_sim.advance(5)
    needed = velocity**2 / (2.0 * (joints.high[0] - position))
    acceleration = np.diff(samples.velocity[:, 0]) / 0.002
    assert 15.0 < needed < np.abs(acceleration).max() < 1.05 * needed
    assert samples.position[-1, 0] == pytest.approx(joints.high[0], abs=1e-3)


#: Two links that turn in a horizontal plane.
SHOULDER_AND_ELBOW = """
<body name="base">
  <body name="link1" pos="0 0 1">
    <joint name="joint1" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
    <body name="link2" pos="0.5 0 0">
      <joint name="joint2" axis="0 0 1" range="%s"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
      <body name="right_hand" pos="0.5 0 0"/>
    </body>
  </body>
</body>
"""


@pytest.mark.parametrize('low, high', [(-0.8, 0.0), (0.0, 0.8), (2.0, 2.8), (-2.8, -2.0)])
def test_the_acceleration_limit_is_that_of_postures_within_the_ranges(one_joint_arm, low, high):
    robot = one_joint_arm(
        '<motor name="a1" joint="joint1" ctrlrange="-1 1"/>'
        '<motor name="a2" joint="joint2" ctrlrange="-1 1"/>', SHOULDER_AND_ELBOW % f'{low} {high}')
    simulation = Simulation(World([robot]))
    model, data = simulation.model, mujoco.MjData(simulation.model)
    coupled, column, mass = [], np.empty(2), np.empty((2, 2))
    for elbow in np.linspace(low, high, 20):
        data.joint('robot0_joint2').qpos[0] = elbow
        mujoco.mj_forward(model, data)
        for dof, unit in enumerate(np.eye(2)):
            mujoco.mj_mulM(model, data, column, unit)
            mass[:, dof] = column
        coupled.append(np.abs(mass).sum(axis=1))
    limit = simulation.robot.joints.servos.acceleration_limit
    # Six tenths of the torque are for acceleration, those of all joints together.
    assert (0.6 / np.max(coupled, axis=0) <= limit).all()
    assert (limit <= 0.6 / np.min(coupled, axis=0)).all()


HOW = ('goal', 'stream', 'trajectory', 'velocity')


@pytest.mark.full
@pytest.mark.parametrize('how', HOW)
@pytest.mark.parametrize('name', ['Panda', 'UR5e'])
def test_blocked_joint_presses_within_its_limit_and_is_released_without_a_race(name, how):
    simulation = whole_robot(name)
    arm, joint = Driven(simulation, 'right'), 1 if name == 'UR5e' else 0
    limits = simulation.model.joint(arm.names[joint]).range
    start, high = arm.position[joint], float(limits[1])
    force = simulation.model.jnt_actfrcrange[simulation.model.joint(arm.names[joint]).id, 1]
    limits[1] = start + 0.02
    if how == 'velocity':
        simulation.robot.set_control_mode('right', 'velocity')
        arm.command('velocity', [0.5], arm.names[joint:joint + 1])
    elif how == 'goal':
        arm.command('position', [start + 1.0], arm.names[joint:joint + 1])
    elif how == 'trajectory':
        simulation.robot.apply(simulation.robot.parse.trajectory(
            'right', arm.names[joint:joint + 1], [1.2], [[start + 1.0]]))
    with sampled(arm) as samples:
        for k in range(200):
            if k == 80:
                limits[1] = high
            if how == 'stream':
                arm.command('position', [start + 0.006 * k], arm.names[joint:joint + 1])
            simulation.advance(5)
    effort, velocity = samples.effort[:, joint], samples.velocity[:, joint]
    assert 0.1 * force < np.abs(effort[200:400]).max() <= force + 1e-9
    assert samples.position[399, joint] < start + 0.04
    assert np.abs(velocity[400:]).max() <= 1.05 * arm.velocity_limit[joint]
    assert samples.position[-1, joint] > start + 0.4
    assert samples.position[:, joint].max() < start + 1.2


@pytest.mark.full
@pytest.mark.parametrize(('name', 'joint', 'most'), [
    ('Panda', 5, 3e-5), ('IIWA', 5, 4e-5), ('UR5e', 2, 1.2e-4)])
def test_joints_that_swing_hardly_push_one_aside_that_stands(name, joint, most):
    simulation = whole_robot(name)
    arm, moved = Driven(simulation, 'right'), [0, 1, 3]
    start, pace = arm.position, 2.0 * np.pi / 1.2
    times = np.arange(1, 121) * 0.01
    swing = 0.6 * arm.velocity_limit[moved] / pace * np.sin(
        pace * times[:, None] * [1.0, 0.5, 0.5])**2
    simulation.robot.apply(simulation.robot.parse.trajectory(
        'right', [arm.names[i] for i in moved], times, start[moved] + swing))
    aside = []
    for _ in range(115):
        simulation.advance(5)
        aside.append(abs(arm.position[joint] - start[joint]))
    # Centrifugal and Coriolis forces are known, so they are met before they move anything.
    assert max(aside) < most


@pytest.mark.full
@pytest.mark.parametrize(('name', 'joint'), [('Panda', 0), ('Kinova3', 5), ('IIWA', 4)])
def test_blocked_joint_presses_with_all_the_torque_that_it_has(name, joint):
    simulation = whole_robot(name)
    arm = Driven(simulation, 'right')
    blocked, start = simulation.model.joint(arm.names[joint]), arm.position[joint]
    force = simulation.model.jnt_actfrcrange[blocked.id, 1]
    blocked.limited[0], blocked.range[:] = 1, [start - 0.5, start + 0.02]
    arm.command('position', [start + 1.0], [arm.names[joint]])
    for _ in range(150):
        simulation.advance(5)
    # The setpoint goes on until it has come so far ahead that the servo saturates.
    effort = simulation.data.qfrc_actuator[blocked.dofadr[0]]
    assert effort == pytest.approx(force, rel=0.01)


def test_twist_is_clamped_in_the_frame_of_the_base_and_counted():
    simulation = whole_robot('PandaOmron')
    base, speeds = Driven(simulation, 'base'), []
    simulation.robot.set_control_mode('base', 'velocity')
    names = [next(j for j in base.names if word in j) for word in ('forward', 'side', 'yaw')]
    part, model = simulation.robot.parts['base'], simulation.model
    wheels = dict(zip(part.driven_joints, model.actuator_ctrlrange[part.actuator_ids, 1]))
    limit = {name: min(speed, wheels[name])
             for name, speed in zip(base.names, base.velocity_limit)}
    simulation.data.joint(names[2]).qpos[0] = np.pi / 4.0
    mujoco.mj_forward(model, simulation.data)
    simulation.robot.joints.reset(simulation.data)
    command = simulation.robot.parse.twist(9.0, -9.0, 0.1)
    assert command.clamped == 2
    assert simulation.robot.parse.twist(0.1, 0.1, 0.1).clamped == 0
    simulation.robot.apply(command)
    for _ in range(150):
        simulation.advance(5)
        yaw = simulation.data.joint(names[2]).qpos[0]
        x, y = (simulation.data.joint(name).qvel[0] for name in names[:2])
        speeds.append([np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x])
    np.testing.assert_allclose(speeds[-1], [limit[names[0]], -limit[names[1]]], rtol=0.02)


def test_twist_needs_velocity_mode():
    simulation = whole_robot('PandaOmron')
    simulation.robot.set_control_mode('base', 'position')
    with pytest.raises(CommandError, match=r'^base takes a twist in velocity mode only, it is in '
                                           r'position mode$'):
        simulation.robot.parse.twist(0.1, 0.0, 0.0)
    simulation.robot.set_control_mode('base', 'velocity')
    with pytest.raises(CommandError, match=r'^base: a twist must be finite, got nan at index 1$'):
        simulation.robot.parse.twist(0.1, np.nan, 0.0)


def test_torque_limit_of_a_strong_joint_is_kept(sim_of):
    simulation = sim_of('<motor name="a" joint="joint1" ctrlrange="-1500 1500"/>')
    simulation.robot.set_control_mode('arm', 'effort')
    np.testing.assert_array_equal(simulation.robot.limits('arm'), [[-1500.0, 1500.0]])


def test_step_keeps_to_what_the_torque_can_do_against_the_damping(one_joint_arm, run):
    robot = one_joint_arm('<position name="a" joint="joint1" kp="2000" forcerange="-30 30"/>')
    robot.set_joint_attribute('damping', [40.0])
    simulation, efforts, speeds = Simulation(World([robot])), [], []
    command(simulation, 'position', 'robot0_joint1', 1.0)

    def look():
        efforts.append(abs(simulation.robot.state().effort[0]))
        speeds.append(simulation.robot.state().velocity[0])
    run(simulation, 4.0, look)
    # 30 N m against 40 N m s/rad, less the weight of the arm.
    assert 0.3 < max(speeds) < 0.75
    assert max(efforts) < 30.0
    assert simulation.robot.state().position[0] == pytest.approx(1.0, abs=1e-4)


def sine_error(arm, mode, amplitude):
    """Let the arm follow a sine of 0.5 Hz; return the root mean square of the error."""
    simulation = Simulation(World([arm]))
    simulation.robot.set_control_mode('arm', mode)
    errors = []
    for tick in range(400):
        phase = np.pi * tick * 0.01
        goal = amplitude * (np.sin(phase) if mode == 'position' else np.pi * np.cos(phase))
        command(simulation, mode, simulation.robot.joint_names[0], goal)
        simulation.advance(5)
        errors.append(getattr(simulation.robot.state(), mode)[0] - goal)
    return np.sqrt(np.mean(np.square(errors[100:])))


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity'])
def test_dry_friction_that_a_weak_servo_could_not_overcome_is_overcome(one_joint_arm, mode):
    arm = one_joint_arm('<position name="a" joint="joint1" kp="20" kv="4"/>')
    arm.spec.joint('joint1').frictionloss = np.asarray(arm.spec.joint('joint1').frictionloss) + 1.0
    # Alone the servo would be off by the friction over its stiffness, 0.05 rad.
    assert sine_error(arm, mode, 0.2) < (0.012 if mode == 'position' else 0.1)


@pytest.mark.full
@pytest.mark.parametrize('mode', ['position', 'velocity'])
def test_dry_friction_of_a_light_joint_is_overcome(one_joint_arm, mode):
    arm = one_joint_arm('<position name="a" joint="joint1" kp="30" kv="0.4"/>')
    arm.spec.joint('joint1').frictionloss = np.asarray(arm.spec.joint('joint1').frictionloss) + 1.0
    arm.spec.joint('joint1').armature = 8e-4
    for geom in arm.spec.geoms:
        geom.mass = 1e-4
    # Alone the servo would be off by the friction over its stiffness, 0.033 rad.
    assert sine_error(arm, mode, 0.1) < (0.006 if mode == 'position' else 0.05)


def test_a_servo_much_too_damped_for_a_light_joint_stays_stiff(one_joint_arm, run):
    arm = one_joint_arm('<position name="a" joint="joint1" kp="2000" kv="400"/>')
    arm.spec.geom(arm.contact_geoms[1].removeprefix(arm.naming_prefix)).mass = 0.002
    simulation = Simulation(World([arm]))
    joint = simulation.robot.joint_names[0]
    simulation.data.qfrc_applied[simulation.model.joint(joint).dofadr[0]] = 0.1
    run(simulation, 2.0)
    assert abs(simulation.robot.state().position[0]) < 0.05


@pytest.mark.parametrize(('actuator', 'gains'), [
    ('<position kp="3" kv="0.5" joint="joint1"/>', (3.0, 0.5)),
    ('<velocity kv="0.5" joint="joint1"/>', (None, 0.5))])
def test_the_gains_of_a_servo_are_those_of_the_model_however_small(actuator, gains):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{LINK}</worldbody><actuator>{actuator}</actuator></mujoco>')
    kp, kv = stiffness_and_damping(model, np.array([0]), np.array([0]))
    assert kv == pytest.approx([gains[1]])
    if gains[0] is not None:
        assert kp == pytest.approx([gains[0]])


@pytest.mark.parametrize('gain', [0.0, -3.0])
def test_a_spring_that_no_control_moves_forward_gets_the_gains_of_a_motor(gain):
    models = [mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{LINK}</worldbody><actuator>{actuator}</actuator></mujoco>')
        for actuator in ('<motor joint="joint1"/>', f'<general joint="joint1" gainprm="{gain}" '
                         'biastype="affine" biasprm="0 -3 -0.5"/>')]
    motor, spring = (stiffness_and_damping(model, np.array([0]), np.array([0]))
                     for model in models)
    np.testing.assert_array_equal(spring, motor)


@pytest.mark.parametrize('gear', [1.0, 4.0])
def test_a_motor_becomes_a_critically_damped_servo_that_lags_by_thirteen_milliseconds(gear):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{LINK}</worldbody><actuator><motor joint="joint1" gear="{gear}"/>'
        '</actuator></mujoco>')
    kp, kv = stiffness_and_damping(model, np.array([0]), np.array([0]))
    # In the differential equation I q'' = kp (goal - q) - kv q' at the joint.
    assert kv == pytest.approx(2.0 * np.sqrt(kp * model.dof_M0[0] / gear**2))
    assert kv / kp == pytest.approx(0.013)


@pytest.mark.parametrize('torque', [4.0, 6.0, 8.0])
def test_a_joint_that_a_spring_stops_does_not_swing_there(one_joint_arm, run, torque):
    body = LINK.replace('axis="0 1 0" range="-2 2" damping="0.5"',
                        'axis="0 0 1" range="-2 2" damping="0.02" stiffness="60"')
    servo = '<position name="a" joint="joint1" kp="200" kv="10" forcerange="-{0} {0}"/>'
    simulation = Simulation(World([one_joint_arm(servo.format(torque), body)]))
    simulation.robot.set_control_mode('arm', 'velocity')
    command(simulation, 'velocity', 'robot0_joint1', 1.5)
    run(simulation, 1.0)
    command(simulation, 'velocity', 'robot0_joint1', 0.0)
    run(simulation, 1.0)
    speeds = []
    for _ in range(200):
        simulation.advance(1)
        speeds.append(abs(simulation.data.qvel[0]))
    # Without a servo that damps it, the joint would swing for half a minute.
    assert max(speeds) < 1e-3
