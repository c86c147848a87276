# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is measured of a robot beside the truth; latency of states and commands."""

import mujoco
import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.models import compose, compose_robot, World
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

STEPS = 5
PERIOD_S = 0.01


@pytest.fixture
def simulation():
    return Simulation(compose('Panda'))


def run(simulation, periods):
    """Advance, and return what is measured and true of all joints after each period."""
    measured, true = [], []
    for _ in range(periods):
        simulation.advance(STEPS)
        measured.append(simulation.robot.measured())
        true.append(simulation.robot.reader.exact())
    return np.array(measured), np.array(true)


def action(simulation, value=0.5):
    robot = simulation.robot
    command = robot.parse.action('right', [value] * 7)
    robot.apply(command)
    return command


def test_a_digest_does_not_depend_on_who_reads_late_states_and_on_what_came_and_went(simulation):
    sensing = simulation.robot.sensing
    sensing.set('latency.state', 3 * PERIOD_S)
    digests = []
    for reads in (True, False):
        if not reads:
            sensing.add('odom', lambda: np.ones(3))  # As the node does.
            simulation.instruments.rebind()
        simulation.reset(1)
        for _ in range(10):
            simulation.advance(STEPS)
            if reads:
                simulation.robot.state()
        digests.append(simulation.digest())
    sensing.forget('odom')
    assert digests[0] == digests[1] == simulation.digest()


def test_commands_that_are_under_way_are_a_part_of_saved_states(simulation):
    robot = simulation.robot
    robot.sensing.set('latency.command', 0.05)
    simulation.reset(1)
    start = simulation.data.qpos[:7].copy()
    robot.apply(robot.parse.action('arm', np.full(7, 0.3)))
    state, digest = simulation.save(), simulation.digest()
    simulation.reset(1)
    assert simulation.digest() != digest
    simulation.restore(state)
    assert simulation.digest() == digest
    for _ in range(20):
        simulation.advance(10)
    assert np.abs(simulation.data.qpos[:7] - start).max() > 0.01


def test_without_settings_what_is_measured_is_what_is_true(simulation):
    action(simulation)
    measured, true = run(simulation, 20)
    np.testing.assert_array_equal(measured, true)
    assert not simulation.robot.sensing.settings.measures


def test_noise_changes_what_is_measured_and_not_the_motion(simulation):
    action(simulation)
    _, without = run(simulation, 20)
    simulation.reset()
    sensing = simulation.robot.sensing
    sensing.set('noise.joint_position', 0.01)
    sensing.set('noise.joint_velocity', 0.1)
    action(simulation)
    measured, true = run(simulation, 20)
    np.testing.assert_array_equal(true, without)
    count = len(simulation.robot.joint_names)
    noise = (measured - true).reshape(20, 3, count)
    assert 0.008 < noise[:, 0].std() < 0.012 and 0.08 < noise[:, 1].std() < 0.12
    np.testing.assert_array_equal(noise[:, 2], 0.0)


@pytest.mark.parametrize('kind, rows', [('position', 0), ('velocity', 1), ('effort', 2)])
@pytest.mark.parametrize('of, slides', [('joint', False), ('slide', True)])
def test_hinges_and_slide_joints_have_noise_of_their_own(simulation, kind, rows, of, slides):
    robot, model = simulation.robot, simulation.model
    is_slide = np.array([model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
                         for name in robot.joint_names])
    assert is_slide.any() and not is_slide.all()
    robot.sensing.set(f'noise.{of}_{kind}', 0.01)
    measured, true = run(simulation, 20)
    noise = (measured - true).reshape(20, 3, len(is_slide))[:, rows]
    np.testing.assert_array_equal(noise[:, is_slide != slides], 0.0)
    assert 0.006 < noise[:, is_slide == slides].std() < 0.014


def test_encoders_of_slide_joints_have_a_resolution_of_their_own(simulation):
    robot = simulation.robot
    robot.sensing.set('resolution.slide_position', 0.001)
    fingers = robot.indices_of['right/gripper']
    np.testing.assert_allclose(
        robot.state().position[fingers], np.round(robot.true_state().position[fingers], 3))
    assert (robot.state().position[fingers] != robot.true_state().position[fingers]).all()
    np.testing.assert_array_equal(
        robot.state().position[robot.indices_of['arm']],
        robot.true_state().position[robot.indices_of['arm']])


def test_a_part_has_the_noise_of_all_joints(simulation):
    simulation.robot.sensing.set('noise.joint_effort', 1.0)
    robot = simulation.robot
    of_all = robot.measured().reshape(3, -1)[:, robot.indices_of['right']]
    np.testing.assert_array_equal(robot.measured('right'), of_all.ravel())
    np.testing.assert_array_equal(robot.state().effort, robot.measured().reshape(3, -1)[2])


def test_the_same_seed_gives_the_same_noise_whatever_was_read_and_another_seed_another(
        simulation):
    simulation.robot.sensing.set('noise.joint_position', 0.01)
    simulation.reset(3)
    first, _ = run(simulation, 10)
    simulation.reset(4)
    other, _ = run(simulation, 10)
    simulation.reset(3)
    for _ in range(10):
        simulation.advance(STEPS)
    np.testing.assert_array_equal(simulation.robot.measured(), first[-1])
    assert (other[:, :7] != first[:, :7]).all()


def test_two_robots_have_noise_of_their_own():
    world = World([compose_robot('Panda', idn=0), compose_robot('Panda', idn=1)])
    simulation = Simulation(world)
    one, other = simulation.robots.values()
    for robot in (one, other):
        robot.sensing.set('noise.joint_position', 0.01)
    errors = [robot.measured()[:7] - robot.reader.exact()[:7] for robot in (one, other)]
    assert (errors[0] != errors[1]).all()
    other.sensing.set('noise.joint_position', 0.0)
    np.testing.assert_array_equal(other.measured(), other.reader.exact())
    assert (one.measured()[:7] != one.reader.exact()[:7]).all()


@pytest.mark.parametrize('periods', [1, 3, 7])
def test_latency_publishes_what_was_measured_so_many_periods_ago(periods, simulation):
    simulation.robot.sensing.set('latency.state', periods * PERIOD_S)
    start = simulation.robot.reader.exact()
    action(simulation)
    measured, true = run(simulation, 20)
    np.testing.assert_array_equal(measured[periods:], true[:-periods])
    # Before, nothing is known but the start.
    np.testing.assert_array_equal(measured[:periods - 1], np.tile(start, (periods - 1, 1)))


@pytest.mark.parametrize('late_steps', [1, 3, 7, 12])
@pytest.mark.parametrize('reset', [False, True])
def test_latency_of_states_is_exact_to_the_timestep_and_changes_nothing(late_steps, reset):
    late, exactly = (Simulation(compose('Panda', arena='table')) for _ in range(2))
    late.robot.sensing.set('latency.state', late_steps * late.timestep_s)
    truth = []

    def sample(model, data):
        if data is exactly.data:
            truth.append(data.qpos[:7].copy())
    if reset:
        late.advance(3)
        late.reset()
    for simulation in (late, exactly):
        command = simulation.robot.parse.action('right', [0.8] * 7)
        simulation.robot.apply(command, period_s=PERIOD_S)
    mujoco.set_mjcb_control(sample)
    try:
        for _ in range(12):
            late.advance(STEPS)
            exactly.advance(STEPS)
    finally:
        mujoco.set_mjcb_control(None)
    np.testing.assert_array_equal(late.data.qpos, exactly.data.qpos)
    instants = [truth[0]]  # A step and the forward before it are of one instant.
    for positions in truth:
        if not np.array_equal(positions, instants[-1]):
            instants.append(positions)
    assert len(instants) == 12 * STEPS + 1
    np.testing.assert_array_equal(late.robot.measured()[:7], instants[-1 - late_steps])


@pytest.mark.full
@pytest.mark.parametrize('late_s', [0.002, 0.016])
def test_a_state_that_is_measured_within_a_period_does_not_change_contacts_and_wrenches(late_s):
    ways = []
    for seconds in (0.0, late_s):
        simulation = Simulation(compose('Panda', arena='table'))
        robot = simulation.robot
        robot.set_wrench_cutoff('right', 20.0)
        robot.sensing.set('latency.state', seconds)
        robot.apply(robot.parse.action('right', [0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.0]))
        wrenches = []
        for _ in range(150):
            simulation.advance(STEPS)
            wrenches.append(robot.sensing.exact('right/external_wrench'))
        ways.append((np.array(wrenches), simulation.data.qpos.copy(), simulation.data.qvel.copy()))
    assert np.abs(ways[0][0]).max() > 5.0
    for one, other in zip(*ways):
        np.testing.assert_array_equal(one, other)


def test_jitter_never_goes_back_in_time_and_has_the_mean_that_was_asked_for(simulation):
    sensing = simulation.robot.sensing
    sensing.set('latency.state', 0.05)
    sensing.set('latency.state_jitter', 0.02)
    simulation.reset(1)
    action(simulation, 1.0)
    measured, true = run(simulation, 60)
    ages = [next(age for age in range(n + 1) if np.array_equal(measured[n], true[n - age]))
            for n in range(12, 60)]
    assert len(set(ages)) > 2
    assert all(later <= age + 1 for age, later in zip(ages, ages[1:])), 'an older one came later'
    simulation.reset(1)
    action(simulation, 1.0)
    np.testing.assert_array_equal(run(simulation, 60)[0], measured)


def test_poses_and_wrenches_are_as_old_as_the_joints(simulation):
    simulation.robot.sensing.set('latency.state', 2 * PERIOD_S)
    action(simulation)
    states = []
    for _ in range(10):
        simulation.advance(STEPS)
        states.append((simulation.robot.state(), simulation.robot.true_state()))
    for (late, _), (_, true) in zip(states[2:], states):
        for field in ('pose', 'twist', 'wrench', 'external_wrench'):
            one, other = (getattr(s.end_effectors['right'], field) for s in (late, true))
            for name in vars(one):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize('periods', [1, 4])
def test_a_command_takes_effect_so_many_periods_later(periods, simulation):
    action(simulation)
    _, at_once = run(simulation, 20)
    simulation.reset()
    simulation.robot.sensing.set('latency.command', periods * PERIOD_S)
    action(simulation)
    assert not simulation.robot.resting
    _, late = run(simulation, 20)
    count = len(simulation.robot.joint_names)
    np.testing.assert_allclose(late[periods:, :count], at_once[:-periods, :count], atol=1e-9)
    np.testing.assert_allclose(late[:periods, :count], late[:1, :count].repeat(periods, axis=0),
                               atol=1e-6)


def test_delayed_commands_keep_their_order_and_end_with_a_reset(simulation):
    sensing = simulation.robot.sensing
    sensing.set('latency.command', 0.05)
    sensing.set('latency.command_jitter', 0.05)
    commands = []
    for number in range(10):
        commands.append(action(simulation, number / 10.0))
        simulation.advance(STEPS)
    ended = [command.handle.is_active for command in commands]
    assert ended == sorted(ended), 'a newer command took effect before an older one'
    assert any(ended)
    simulation.reset()
    assert not any(command.handle.is_active for command in commands)
    assert commands[-1].handle.status is Status.ABORTED


def test_a_delayed_command_can_be_withdrawn(simulation):
    simulation.robot.sensing.set('latency.command', 0.02)
    command = action(simulation)
    simulation.robot.withdraw(command, 'no more')
    assert command.handle.status is Status.ABORTED
    _, true = run(simulation, 10)
    np.testing.assert_allclose(true[-1][:9], true[0][:9], atol=1e-6)


def test_saved_states_hold_what_has_not_arrived_yet(simulation):
    sensing = simulation.robot.sensing
    for name, value in (('noise.joint_position', 0.01), ('noise.wrench_drift', 1.0),
                        ('latency.state', 0.03), ('latency.state_jitter', 0.01),
                        ('latency.command', 0.02), ('noise.imu_gyro_bias', 0.1)):
        sensing.set(name, value)
    simulation.reset(5)
    action(simulation)
    run(simulation, 5)
    state, digest = simulation.save(), simulation.digest()
    first = run(simulation, 10)
    end = simulation.digest()
    other = Simulation(compose('Panda'))
    other.restore(state)
    assert other.digest() == digest
    again = run(other, 10)
    np.testing.assert_array_equal(again, first)
    assert other.digest() == end
    other.robot.sensing.set('noise.joint_position', 0.02)
    assert other.digest() != end


def test_a_tare_takes_the_offset_away_and_a_filter_smooths_the_noise():
    simulation = Simulation(compose('Panda'))
    robot = simulation.robot
    robot.sensing.set('noise.wrench_bias', 20.0)

    def external():
        return robot.state().end_effectors['right'].external_wrench.force
    run(simulation, 2)
    assert np.abs(external()).max() > 1.0
    robot.tare_wrench()
    np.testing.assert_allclose(external(), 0.0, atol=1e-9)
    robot.sensing.set('noise.wrench_force', 1.0)
    spread = {}
    for cutoff in (0.0, 2.0):
        robot.set_wrench_cutoff('right', cutoff)
        values = []
        for _ in range(300):
            simulation.advance(STEPS)
            values.append(external())
        spread[cutoff] = np.std(values[50:])
    assert spread[0.0] == pytest.approx(1.0, rel=0.15)
    # A low-pass of first order with weight w: the variance is w / (2 - w).
    weight = -np.expm1(-2.0 * np.pi * 2.0 * PERIOD_S)
    assert spread[2.0] == pytest.approx(np.sqrt(weight / (2.0 - weight)), rel=0.35)


def test_sensors_by_name_have_the_noise_of_their_kind(simulation):
    sensing = simulation.robot.sensing
    sensing.set('noise.imu_gyro', 0.5)
    exact = simulation.data.sensor('robot0_right_imu_gyro').data.copy()
    assert (simulation.sensors['robot0_right_imu_gyro'] != exact).all()
    np.testing.assert_array_equal(simulation.sensors['robot0_right_imu_accelerometer'],
                                  simulation.data.sensor('robot0_right_imu_accelerometer').data)
    sensing.set('noise.imu_orientation', 0.1)
    measured = simulation.sensors['robot0_right_imu_orientation']
    true = simulation.data.sensor('robot0_right_imu_orientation').data
    assert np.linalg.norm(measured) == pytest.approx(1.0)
    assert 0.01 < 2.0 * np.arccos(min(1.0, abs(measured @ true))) < 0.5


def test_worlds_have_the_noise_of_their_seeds():
    worlds = Worlds(compose('Panda'), 2)
    for robot in (worlds.robot[0], worlds.robot[1]):
        robot.sensing.set('noise.joint_position', 0.01)
    worlds.reset([3, 4])
    single = Simulation(compose('Panda'))
    single.robot.sensing.set('noise.joint_position', 0.01)
    for row, seed in enumerate((3, 4)):
        single.reset(seed)
        np.testing.assert_array_equal(worlds.robot.state().position[row],
                                      single.robot.state().position)


@pytest.mark.full
@pytest.mark.parametrize('late_steps', [1, 7, 24, 25, 26, 51])
def test_a_late_command_takes_effect_in_its_timestep(late_steps):
    late, by_hand = (Simulation(compose('UR5e')) for _ in range(2))
    late.robot.sensing.set('latency.command', 0.002 * late_steps)
    late.robot.apply(late.robot.parse.action('arm', [0.5] * 6), period_s=0.05)
    for _ in range(3):
        late.advance(25)
    by_hand.advance(late_steps)
    by_hand.robot.apply(by_hand.robot.parse.action('arm', [0.5] * 6), period_s=0.05)
    by_hand.advance(-late_steps % 25 or 25)
    while by_hand.time_ns < late.time_ns:
        by_hand.advance(25)
    np.testing.assert_allclose(late.data.qpos, by_hand.data.qpos, atol=1e-12)
    np.testing.assert_allclose(late.data.qvel, by_hand.data.qvel, atol=1e-10)
