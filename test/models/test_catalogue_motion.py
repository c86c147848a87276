# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every robot of the catalogue stands still, follows its commands and stays stable."""

import mujoco
import numpy as np
import pytest

from catalogue import AtRest, is_position_servo, ROBOTS, warnings_of

HOLD_S = 5.0
COMMAND_PERIOD_S = 0.01
SINE_HZ = 0.5
SINE_AMPLITUDE = 0.3


def steps(model, duration_s):
    """Return how many steps a duration takes."""
    return round(duration_s / model.opt.timestep)


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS)
def test_robots_hold_their_first_pose_against_gravity(name):
    rest = AtRest(name)
    model, data = rest.model, rest.data
    addresses = model.jnt_qposadr[rest.joint_ids(rest.robot.all_joints)]
    start = data.qpos[addresses].copy()
    drift = np.zeros(len(addresses))
    for _ in range(10):
        mujoco.mj_step(model, data, steps(model, HOLD_S / 10.0))
        drift = np.maximum(drift, np.abs(data.qpos[addresses] - start))
    moved = {joint: by for joint, by in zip(rest.robot.all_joints, drift) if by > 1e-3}
    assert moved == {}
    assert warnings_of(data) == []


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS)
def test_robots_stay_stable_under_random_commands(name):
    """
    Goals over the whole ranges, approached at the speed that the joints are allowed.

    They may lead through the robot itself or the floor, so only the physics is asserted.
    """
    rest = AtRest(name)
    model, data = rest.model, rest.data
    joints = model.actuator_trnid[:, 0]
    limit = np.ones(model.nu)
    if model.nuser_jnt:
        declared = model.jnt_user[joints, 0]
        limit = np.where(declared > 0.0, declared, limit)
    servo = is_position_servo(model)
    low, high = np.where(model.actuator_ctrllimited[:, None], model.actuator_ctrlrange,
                         [-1.0, 1.0]).T
    random = np.random.default_rng(3)
    for period in range(round(5.0 / COMMAND_PERIOD_S)):
        if period % 50 == 0:
            goal = random.uniform(low, high)
        reach = np.where(servo, limit * COMMAND_PERIOD_S, np.inf)
        data.ctrl += np.clip(goal - data.ctrl, -reach, reach)
        mujoco.mj_step(model, data, steps(model, COMMAND_PERIOD_S))
    assert warnings_of(data) == []
    assert np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    speed = np.abs(data.qvel[model.jnt_dofadr[joints]])
    assert (speed < 20.0 * np.maximum(limit, 1.0)).all(), speed


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS)
def test_each_arm_joint_follows_a_slow_sine(name):
    """One joint at a time, 0.5 Hz and 0.3 rad, the others hold."""
    rest = AtRest(name)
    model, data = rest.model, rest.data
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    start = data.qpos.copy(), data.ctrl.copy()
    errors = {}
    for name_of_actuator in rest.robot.arm_actuators:
        actuator = model.actuator(name_of_actuator).id
        joint = model.actuator_trnid[actuator, 0]
        address = model.jnt_qposadr[joint]
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.ctrl[:] = start
        low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        amplitude = min(SINE_AMPLITUDE, 0.45 * (high - low))
        middle = np.clip(data.qpos[address], low + amplitude, high - amplitude)
        data.qpos[address] = middle
        missed = []
        for period in range(round(3.0 / COMMAND_PERIOD_S)):
            time = period * COMMAND_PERIOD_S
            if time >= 1.0:
                wanted = middle + amplitude * np.sin(2.0 * np.pi * SINE_HZ * data.time)
                missed.append(data.qpos[address] - wanted)
            data.ctrl[actuator] = middle + amplitude * np.sin(2.0 * np.pi * SINE_HZ * time)
            mujoco.mj_step(model, data, steps(model, COMMAND_PERIOD_S))
        errors[name_of_actuator] = float(np.sqrt(np.mean(np.square(missed))))
    too_large = {actuator: error for actuator, error in errors.items() if error > 0.02}
    assert too_large == {}
    assert warnings_of(data) == []
