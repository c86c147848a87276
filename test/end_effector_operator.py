# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands for end effectors in a few words, and where these are by MuJoCo's kinematics alone."""

from dataclasses import replace

import mujoco
import numpy as np

from sampling import whole_robot

PERIOD_S = 0.01


class EndEffectorOperator:
    """
    Commands the end effector of an arm and lets a simulation run.

    :param simulation: of one robot
    :param arm: whose end effector
    :param mode: control mode of all arms
    """

    def __init__(self, simulation, arm='right', mode='position', period_s=PERIOD_S):
        self.simulation, self.arm, self.period_s = simulation, arm, period_s
        self.robot = simulation.robot
        self.site = simulation.model.site(self.robot.end_effectors[arm].grip_site).id
        self.part = self.robot.parts[arm]
        self.report = self.robot.joints.cartesian.reports[arm]
        if mode != 'position':
            self.robot.set_control_mode('arm', mode)

    @property
    def pose(self):
        """Where the end effector is: position and rotation matrix in the world."""
        data = self.simulation.data
        return data.site_xpos[self.site].copy(), data.site_xmat[self.site].reshape(3, 3).copy()

    @property
    def twist(self):
        """How the end effector moves: linear and angular in the world, shape (6,)."""
        velocity = np.empty(6)
        mujoco.mj_objectVelocity(self.simulation.model, self.simulation.data,
                                 mujoco.mjtObj.mjOBJ_SITE, self.site, velocity, 0)
        return velocity[[3, 4, 5, 0, 1, 2]]

    @property
    def goal(self):
        """Where the end effector shall be: position and rotation matrix in the world."""
        pose = self.robot.joints.cartesian.goal(self.arm, self.simulation.data)
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, pose.quat_xyzw[[3, 0, 1, 2]])
        return pose.position, matrix.reshape(3, 3)

    @property
    def reference(self):
        """Setpoints of the arm."""
        return self.robot.controller_state(self.arm).reference

    def reachable(self, spread, seed=0):
        """Return the pose of the end effector with joints somewhat elsewhere, by kinematics."""
        model, data = self.simulation.model, mujoco.MjData(self.simulation.model)
        data.qpos[:] = self.simulation.data.qpos
        offset = np.random.default_rng(seed).uniform(-spread, spread, len(self.part.joints))
        for joint, change in zip(self.part.joints, offset):
            spec, place = model.joint(joint), data.joint(joint)
            low, high = spec.range if spec.limited[0] else (-np.inf, np.inf)
            place.qpos[0] = np.clip(place.qpos[0] + change, low + 0.1, high - 0.1)
        mujoco.mj_kinematics(model, data)
        return data.site_xpos[self.site].copy(), data.site_xmat[self.site].reshape(3, 3).copy()

    def go_to(self, pose, frame='', sent_ns=0, messages=1):
        """Apply a target pose; return its handle."""
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(pose[1]).ravel())
        return self.apply(replace(self.robot.parse_cartesian.pose(
            self.arm, pose[0], quat[[1, 2, 3, 0]], frame), sent_ns=sent_ns, messages=messages))

    def move_at(self, linear, angular=(0.0, 0.0, 0.0), frame=''):
        """Apply a target twist; return its handle."""
        return self.apply(self.robot.parse_cartesian.twist(self.arm, linear, angular, frame))

    def act(self, *numbers):
        """Apply an action of OSC_POSE; return its handle."""
        return self.apply(self.robot.parse_cartesian.action(self.arm, numbers))

    def apply(self, command):
        self.robot.apply(command, period_s=self.period_s)
        return command.handle

    def run(self, seconds, each_period=None):
        """Advance; call a function before each period."""
        for _ in range(round(seconds / self.period_s)):
            if each_period is not None:
                each_period()
            self.simulation.advance(round(self.period_s / self.simulation.timestep_s))

    def run_until_done(self, handles, limit_s=4.0):
        """Advance until commands are done; fail where they are not in time."""
        for _ in range(round(limit_s / self.period_s)):
            if not any(handle.is_active for handle in handles):
                return
            self.run(self.period_s)
        raise AssertionError(f'not done in {limit_s} s: {self.report.texts}')


def operator_of(name, arm='right', mode='position', period_s=PERIOD_S, **options):
    """Return an operator of an end effector of a robot of the catalogue."""
    return EndEffectorOperator(whole_robot(name, **options), arm, mode, period_s)


def distance(one, other):
    """Return how far two poses are from one another [m], [rad]."""
    turn = one[1] @ other[1].T
    return (np.linalg.norm(one[0] - other[0]),
            np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))


def turned(axis, angle):
    """Return a rotation matrix, by Rodrigues' formula."""
    x, y, z = np.asarray(axis, dtype=float)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
