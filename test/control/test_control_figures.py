# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a user may rely on of position and velocity control, at every step, for every robot."""

import itertools

import mujoco
import numpy as np
import pytest

from robot_kinds import all_and_kinds, KINDS
from sampling import Driven, sampled, whole_robot

from manip_sim.models.robots import robot_names

pytestmark = pytest.mark.full

ROBOTS = robot_names()
#: Joints that are slower than this need too long for the goals of a test [m/s].
SLOW = 0.2


def run(simulation, seconds, rate=100):
    steps = round(1.0 / (rate * simulation.timestep_s))
    for _ in range(round(seconds * rate)):
        simulation.advance(steps)


@pytest.mark.parametrize(('name', 'rate'), [
    *itertools.product(KINDS, [100]), *itertools.product(KINDS[:3], [50, 500])])
def test_streamed_constant_speed_is_met_with_the_torque_that_it_needs(name, rate):
    simulation = whole_robot(name)
    arm, speed, steps = Driven(simulation, 'right'), 0.4, round(500 / rate)
    start, first = arm.position, simulation.step_count
    joint = int(np.argmax(np.minimum(arm.high - start, 2.0)))
    speed = min(speed, 0.8 * arm.velocity_limit[joint])
    with sampled(arm) as samples:
        for _ in range(round(1.6 * rate)):
            time_s = (simulation.step_count - first) * 0.002
            arm.command('position', [start[joint] + speed * time_s], [arm.names[joint]],
                        1.0 / rate)
            simulation.advance(steps)
    late = slice(-200, None)
    np.testing.assert_allclose(samples.velocity[late, joint], speed, rtol=5e-3)
    # At constant speed of one joint the torque of a vertical axis is that of its damping; others
    # have Coriolis and the like, which the velocity says is all that is needed.
    acceleration = np.diff(samples.velocity[:, joint])[late] / 0.002
    assert np.abs(acceleration).max() < 0.5


@pytest.mark.parametrize('rate', [50, 100, 500])
def test_effort_at_constant_speed_is_that_of_the_damping(rate):
    simulation = whole_robot('Panda')
    arm, steps = Driven(simulation, 'right'), round(500 / rate)
    start = arm.position[0]
    with sampled(arm) as samples:
        for _ in range(round(1.6 * rate)):
            arm.command('position', [start + 0.4 * simulation.time_s], arm.names[:1], 1.0 / rate)
            simulation.advance(steps)
            published = simulation.robot.state().effort[0]
    np.testing.assert_allclose(samples.effort[-200:, 0], 0.4 * arm.damping[0], atol=0.05)
    assert published == pytest.approx(0.4 * arm.damping[0], abs=0.05)


@pytest.mark.parametrize(('name', 'goal'), all_and_kinds(
    (0.1, False), (0.02, False), (0.02, True), (0.1, True), (0.5, False), (0.5, True)))
def test_goal_on_all_joints_at_once_does_not_overshoot_or_overspeed(name, goal):
    simulation, (distance, repeated) = whole_robot(name), goal
    joints = Driven(simulation)
    start = joints.position
    sign = np.where(np.arange(len(start)) % 3 == 1, -1.0, 1.0)
    far = np.where(joints.velocity_limit < SLOW, np.minimum(distance, 0.02), distance)
    offset = joints.within(start, sign * far)
    with sampled(joints) as samples:
        for _ in range(round((1.5 + 3.0 * distance) * 100)):
            if repeated or not samples._rows:
                joints.command('position', start + offset)
            simulation.advance(5)
    past = ((samples.position - start - offset) * np.sign(offset)).max(axis=0)
    assert (past < 0.02 * np.abs(offset)).all()
    assert (np.abs(samples.velocity).max(axis=0) <= 1.01 * joints.velocity_limit).all()
    np.testing.assert_allclose(samples.position[-1], start + offset, atol=1e-3 * distance)


@pytest.mark.parametrize('rate', [1, 5, 20, 500])
def test_goal_does_not_overspeed_at_any_rate(rate):
    simulation = whole_robot('Panda')
    arm = Driven(simulation, 'arm')
    start = arm.position
    offset = arm.within(start, np.full(7, 0.5))
    with sampled(arm) as samples:
        arm.command('position', start + offset, period_s=1.0 / rate)
        run(simulation, 3.0, rate)
    assert (np.abs(samples.velocity).max(axis=0) <= 1.01 * arm.velocity_limit).all()
    assert ((samples.position - start - offset) * np.sign(offset)).max() < 0.01


def feasible_amplitude(driven, frequency_hz, wanted):
    """Return the amplitude that a joint's limits allow, zero for very slow joints."""
    model, turn = driven.simulation.model, 2.0 * np.pi * frequency_hz
    mass = np.empty((model.nv, model.nv))
    for row, unit in zip(mass, np.eye(model.nv)):
        mujoco.mj_mulM(model, driven.simulation.data, row, unit)
    joints = [model.joint(name).id for name in driven.names]
    torque = np.where(model.jnt_actfrclimited[joints], model.jnt_actfrcrange[joints, 1], np.inf)
    allowed = 0.7 * np.minimum(driven.velocity_limit / turn,
                               torque / (np.diag(mass)[driven.dofs] * turn**2))
    return np.where(driven.velocity_limit < SLOW, 0.0, np.minimum(wanted, allowed))


def transfer(times, reference, measured, frequency_hz):
    """Return gain and delay [s] of each column at a frequency, by least squares."""
    angle = 2.0 * np.pi * frequency_hz * times
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(times)], axis=1)
    phasors = []
    for signal in (reference, measured):
        sine, cosine, _ = np.linalg.lstsq(basis, signal, rcond=None)[0]
        phasors.append(sine + 1j * cosine)
    ratio = phasors[1] / phasors[0]
    return np.abs(ratio), -np.angle(ratio) / (2.0 * np.pi * frequency_hz)


@pytest.mark.parametrize(('name', 'frequency_hz'), all_and_kinds(1.0, 0.5, 2.0))
def test_streamed_sine_is_followed_in_full_and_on_time(name, frequency_hz):
    simulation = whole_robot(name)
    arm = Driven(simulation, 'right')
    start, amplitude = arm.position, feasible_amplitude(arm, frequency_hz, 0.1)
    middle = start + np.where(start - amplitude < arm.low, amplitude, 0.0)
    everything = list(range(len(start)))
    # Slow ones all at once, fast ones one after the other, so that the torque limits allow it.
    for joints in [everything] if frequency_hz <= 1.0 else [[joint] for joint in everything]:
        simulation.reset()
        begin, rows = simulation.step_count, []
        for _ in range(round(2.0 / frequency_hz * 100)):
            time_s = (simulation.step_count - begin) * 0.002
            ramp = min(1.0, time_s * frequency_hz)
            goals = middle + ramp * amplitude * np.sin(2.0 * np.pi * frequency_hz * time_s)
            rows.append((time_s, goals[joints], arm.position[joints]))
            arm.command('position', goals[joints], [arm.names[j] for j in joints])
            simulation.advance(5)
        times, goals, positions = map(np.array, zip(*rows[-round(100 / frequency_hz):]))
        moved = amplitude[joints] > 0.0
        gain, delay_s = transfer(times, goals[:, moved], positions[:, moved], frequency_hz)
        assert ((gain > 0.98) & (gain < 1.02)).all(), (joints, gain)
        assert ((delay_s > 0.0) & (delay_s < 0.02)).all(), (joints, delay_s)


@pytest.mark.parametrize(('name', 'how'), [
    *itertools.product(KINDS, ['streamed', 'trajectory'])])
def test_wrench_of_a_smooth_free_motion_has_no_ripple(name, how):
    simulation = whole_robot(name)
    arm = Driven(simulation, 'right')
    start, duration_s = arm.position, 1.5
    offset = arm.within(start, np.resize([0.3, -0.3], len(start)))

    def smooth(time_s):
        s = np.clip(time_s / duration_s, 0.0, 1.0)
        return start + offset * (10 * s**3 - 15 * s**4 + 6 * s**5)

    if how == 'trajectory':
        zero = np.zeros((1, len(start)))
        simulation.robot.apply(simulation.robot.parse.trajectory(
            'right', arm.names, [duration_s], [start + offset], zero, zero))
    with sampled(arm, wrench=True) as samples:
        for _ in range(200):
            if how == 'streamed':
                arm.command('position', smooth(simulation.time_s))
            simulation.advance(5)
    # What is left when the motion's own slow course is taken away: a moving average over 40 ms.
    kernel = np.ones(21) / 21.0
    course = np.stack([np.convolve(f, kernel, 'valid') for f in samples.wrench[:, :3].T], axis=1)
    curve = np.stack([np.convolve(np.convolve(f, kernel, 'valid'), kernel, 'valid')
                      for f in samples.wrench[:, :3].T], axis=1)
    # A moving average lowers a curve; twice lowers it twice as much.
    smoothed = 2.0 * course[10:-10] - curve
    ripple = samples.wrench[20:-20, :3] - smoothed
    assert np.abs(ripple).max() < 0.3


def put_somewhere(simulation, joints, random):
    """Put the joints into the middle half of their ranges, at rest."""
    simulation.reset()
    low, high = np.maximum(joints.low, -2.0), np.minimum(joints.high, 2.0)
    simulation.data.qpos[joints.qpos] = low + (high - low) * random.uniform(0.25, 0.75, len(low))
    mujoco.mj_forward(simulation.model, simulation.data)
    simulation.robot.joints.reset(simulation.data)


@pytest.mark.timeout(300)
@pytest.mark.parametrize('name', ROBOTS)
def test_stops_and_reversals_come_to_rest(name):
    simulation, random = whole_robot(name), np.random.default_rng(7)
    joints = Driven(simulation)
    for part in ('arm', 'base', 'torso', 'head', 'legs'):
        if part in simulation.robot.parts:
            simulation.robot.set_control_mode(part, 'velocity')
    for _ in range(200 // len(ROBOTS) + 1):
        put_somewhere(simulation, joints, random)
        count = len(joints.names)
        speed = joints.velocity_limit * random.uniform(0.02, 0.9, count)
        speed *= random.choice([-1.0, 1.0], count)
        for wanted in (speed, -speed):
            joints.command('velocity', wanted)
            run(simulation, random.uniform(0.05, 0.3), 20)
        joints.command('velocity', 0.0 * speed)
        run(simulation, 0.8, 20)
        with sampled(joints) as samples:
            run(simulation, 0.1)
        assert np.abs(samples.velocity).max() < 5e-3
        assert np.ptp(samples.effort, axis=0).max() < 0.1


@pytest.mark.parametrize(('name', 'share'), all_and_kinds(0.3, 0.02, 0.1, 0.9))
def test_mean_speed_is_the_commanded_one(name, share):
    simulation = whole_robot(name)
    arm = Driven(simulation, 'right')
    simulation.robot.set_control_mode('arm', 'velocity')
    joints = simulation.robot.joints
    accelerations = joints.acceleration_limits([joints.names.index(name) for name in arm.names])
    for joint, limit in enumerate(arm.velocity_limit):
        simulation.reset()
        up = arm.high[joint] - arm.position[joint] > arm.position[joint] - arm.low[joint]
        speed = share * limit * (1.0 if up else -1.0)
        way = min(abs((arm.high if up else arm.low)[joint] - arm.position[joint]), 4.0)
        arm.command('velocity', [speed], [arm.names[joint]])
        speeds_up_s = max(0.4, round(abs(speed) / accelerations[joint] + 0.1, 1))
        run(simulation, speeds_up_s, 20)
        time_s = min(0.3, 0.6 * way / abs(speed) - speeds_up_s)
        if time_s < 0.02:
            continue
        before = arm.position
        run(simulation, round(time_s, 2))
        moved = (arm.position - before)[joint]
        assert moved == pytest.approx(speed * round(time_s, 2), rel=1e-2), arm.names[joint]


def test_velocity_stops_softly_before_the_range_ends(panda_sim, run):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    joint = 'robot0_joint1'
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command([joint], velocity=[2.0]))
    arm, efforts = Driven(panda_sim, 'arm'), []
    with sampled(arm) as samples:
        run(panda_sim, 3.0)
    efforts = samples.effort[:, 0]
    assert samples.position[-1, 0] == pytest.approx(2.8973, abs=1e-3)
    assert samples.position[:, 0].max() < 2.8973 + 1e-3
    assert np.abs(efforts).max() < 60.0


@pytest.mark.parametrize(('name', 'frequency_hz'), [
    *itertools.product(KINDS, [0.5]), *itertools.product(KINDS[:3], [2.0])])
def test_streamed_sine_of_velocities_is_followed_in_full_and_on_time(name, frequency_hz):
    simulation = whole_robot(name)
    arm = Driven(simulation, 'right')
    angle_rate = 2.0 * np.pi * frequency_hz
    amplitude = feasible_amplitude(arm, frequency_hz, 0.1) * angle_rate
    simulation.robot.set_control_mode('arm', 'velocity')
    everything = list(range(len(amplitude)))
    for joints in [everything] if frequency_hz <= 1.0 else [[joint] for joint in everything]:
        simulation.reset()
        rows, begin = [], simulation.step_count
        for _ in range(round(2.0 / frequency_hz * 100)):
            time_s = (simulation.step_count - begin) * 0.002
            goals = min(1.0, time_s * frequency_hz) * amplitude[joints] * np.sin(
                angle_rate * time_s)
            rows.append((time_s, goals, simulation.data.qvel[arm.dofs[joints]]))
            arm.command('velocity', goals, [arm.names[j] for j in joints])
            simulation.advance(5)
        times, goals, velocities = map(np.array, zip(*rows[-round(100 / frequency_hz):]))
        moved = amplitude[joints] > 0.0
        gain, delay_s = transfer(times, goals[:, moved], velocities[:, moved], frequency_hz)
        assert ((gain > 0.98) & (gain < 1.02)).all(), (joints, gain)
        assert ((delay_s > 0.0) & (delay_s < 0.02)).all(), (joints, delay_s)


@pytest.mark.parametrize('name', ROBOTS)
def test_a_lost_message_keeps_the_acceleration_limit(name):
    simulation = whole_robot(name)
    arm, rate = Driven(simulation, 'right'), 100
    start = arm.position
    joint = int(np.argmax(np.minimum(arm.high - start, 2.0)))
    speed = min(0.8, 0.6 * arm.velocity_limit[joint])
    limit = simulation.robot.joints.acceleration_limits(
        simulation.robot.joints.find([arm.names[joint]]))[0]
    with sampled(arm) as samples:
        for message in range(110):
            # It speeds up evenly in half a second; then one message is lost.
            time_s = message / rate
            way = speed * (time_s**2 if time_s < 0.5 else time_s - 0.25)
            if message != 80:
                arm.command('position', [start[joint] + way], [arm.names[joint]])
            simulation.advance(5)
    velocity = samples.velocity[:, joint]
    assert np.abs(np.diff(velocity)).max() / 0.002 < limit
    np.testing.assert_allclose(velocity[400:], speed, rtol=0.03)
