# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""End effectors come as near to targets out of reach as they can, and all joints come to rest."""

from end_effector_operator import EndEffectorOperator
import mujoco
import numpy as np
import pytest
from robot_kinds import KINDS
from sampling import whole_robot


#: Rest [rad/s], and how long after the end effector it comes [s].
REST, REST_S = 0.002, 3.0
#: The end effector has arrived when it moves less than this in this time [m], [s]; it does by then
#: [s].
STILL, STILL_S, LIMIT_S = 1e-3, 0.4, 14.0


def operators(simulation):
    return [EndEffectorOperator(simulation, arm) for arm in simulation.robot.end_effectors]


def send_out_of_reach(ops, random):
    for op in ops:
        position, rotation = op.pose
        way = random.normal(size=3)
        op.go_to((position + 1.5 * way / np.linalg.norm(way), rotation))


def until_still(ops):
    """Advance until the end effectors have arrived."""
    for _ in range(round(LIMIT_S / STILL_S)):
        before = [op.pose[0] for op in ops]
        ops[0].run(STILL_S)
        if max(np.abs(op.pose[0] - old).max() for op, old in zip(ops, before)) < STILL:
            return
    raise AssertionError('the hands do not come to rest')


def highest_speed(ops, seconds=0.3):
    """Return the highest speed of the arms' joints in a while [rad/s]."""
    dofs, speeds = np.concatenate([op.part.dof_addresses for op in ops]), []
    ops[0].run(seconds, lambda: speeds.append(
        np.abs(ops[0].simulation.data.qvel[dofs]).max()))
    return max(speeds)


def place(ops, random, at_ends):
    """Put the arms anywhere, some joints at the ends of their ranges."""
    model, data = ops[0].simulation.model, ops[0].simulation.data
    for op in ops:
        for joint in op.part.joints:
            low, high = model.joint(joint).range if model.joint(joint).limited[0] else (-3, 3)
            share = random.uniform(0.05, 0.95)
            if at_ends and random.uniform() < 0.3:
                share = float(random.integers(2))
            data.joint(joint).qpos[0] = low + share * (high - low)
    mujoco.mj_forward(model, data)
    ops[0].robot.joints.reset(data)


@pytest.mark.full
@pytest.mark.parametrize('name', KINDS)
@pytest.mark.parametrize('mode', ['position', 'effort'])
def test_a_target_out_of_reach_ends_in_rest(name, mode):
    simulation = whole_robot(name)
    simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    simulation.robot.set_control_mode('arm', mode)
    ops, random = operators(simulation), np.random.default_rng(7)
    send_out_of_reach(ops, random)
    until_still(ops)
    ops[0].run(REST_S - STILL_S)
    assert highest_speed(ops) < REST
    assert all(op.report.unreachable >= 1 for op in ops)


@pytest.mark.full
@pytest.mark.parametrize(('name', 'mode', 'seed'), [
    ('Panda', 'position', 2), ('Kinova3', 'velocity', 1), ('UR5e', 'position', 3),
    ('Sawyer', 'effort', 1)])
def test_from_ends_of_ranges_it_ends_in_rest_too(name, mode, seed):
    simulation = whole_robot(name)
    simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    simulation.robot.set_control_mode('arm', mode)
    ops, random = operators(simulation), np.random.default_rng(seed)
    place(ops, random, at_ends=True)
    send_out_of_reach(ops, random)
    until_still(ops)
    ops[0].run(REST_S - STILL_S)
    assert highest_speed(ops) < REST
