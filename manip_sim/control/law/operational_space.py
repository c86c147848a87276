# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Operational space control: what makes an end effector behave like a mass on a spring and damper.

As Khatib (1987) the end effector accelerates as spring and damper say, whatever the inertia of the
arm; here by joint accelerations rather than by a force at the end effector, which is the same for
the end effector and well behaved where the arm is singular. What leaves the end effector where it
is goes to a posture.
"""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.arm_records import Arm, Goal, Motion, Spring
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.displacement import displace, project_free, way_to_posture
from manip_sim.control.law.loads import find_inertia, Loads
from manip_sim.control.law.small_matrices import (
    clip, multiply, multiply_matrices, norm3, rotation_vector)
from manip_sim.physics.physics import Kinematics, WorldArrays

#: Stiffness towards the posture in the null space [1/s^2], critically damped; that of robosuite.
_POSTURE = 10.0
_POSTURE_DAMPING = 2.0 * math.sqrt(_POSTURE)
#: Displacements are sought for a longer motion than this no more [m], [rad].
_LARGEST_STEP, _LARGEST_TURN = 0.1, 0.5


@compiled
def exert(world: WorldArrays, loads: Loads, arm: Arm, place: FloatArray, turned: FloatArray,
          goal: Goal, postures: FloatArray, spring: Spring, rested: bool, motion: Motion
          ) -> tuple[bool, bool, bool]:
    """
    Write the efforts that move an end effector to its goal, within the limits of the joints.

    :param loads: payloads, whose weight is carried beside
    :param place: position of the end effector in the world [m], shape (3,)
    :param turned: its rotation in the world, shape (3, 3)
    :param postures: positions that redundant arms are drawn to, of all joints [rad]
    :param rested: whether the end effector was as near as it can come before
    :returns: whether it is as near as it can come, whether a motion is wanted in a direction in
        which it can hardly move, and whether velocity limits of joints slow it down
    """
    count = len(arm.joints)
    jacobian, velocity, accelerations = np.empty((6, count)), np.empty(count), np.empty(count)
    low, high, away, most = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    find_jacobian(world.kinematics, arm, place, jacobian)
    find_error(place, turned, goal, motion.error)
    for i in range(count):
        joint = arm.joints[i]
        velocity[i], most[i] = world.velocities[joint.dof], joint.velocity_limit
        position = world.kinematics.positions[joint.qpos]
        low[i], high[i] = joint.low - position, joint.high - position
        away[i] = way_to_posture(postures[joint.joint] - position, joint.turn)
    multiply(jacobian, velocity, motion.twist)
    flags = accelerate(jacobian, motion.error, goal.along, spring, most, low, high, away,
                       velocity, rested, motion.held, accelerations)
    inertia = np.empty((count, count))
    find_inertia(world, loads, arm, inertia)
    for i in range(count):
        joint = arm.joints[i]
        # Gravity that is compensated needs no effort here.
        effort = (world.bias[joint.dof] - world.carried[joint.dof]
                  + joint.damping * velocity[i])
        for j in range(count):
            effort += inertia[i, j] * accelerations[j]
        motion.efforts[i] = clip(effort, joint.weakest, joint.strongest)
    return flags


@compiled
def accelerate(jacobian: FloatArray, error: FloatArray, along: FloatArray, spring: Spring,
               velocity_limit: FloatArray, low: FloatArray, high: FloatArray, away: FloatArray,
               velocity: FloatArray, rested: bool, held: BoolArray, accelerations: FloatArray
               ) -> tuple[bool, bool, bool]:
    """
    Write the accelerations of the joints [rad/s^2], shape (n,).

    Those of the end effector are damping times its velocity error, in all six directions. The
    velocity is that at which spring and damper are in balance, limited to those of the settings
    and of the joints, and to what the arm can do near a singularity and near the ends of ranges.

    :param jacobian: of position and rotation of the end effector, shape (6, n)
    :param error: translation [m] and rotation vector [rad] to the goal, shape (6,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    :param velocity: of the joints [rad/s], shape (n,)
    :returns: as of :func:`exert`
    """
    count = len(velocity)
    task, step, drift, slack = np.empty(6), np.empty(count), np.empty(count), np.empty(count)
    factor = np.empty((count, count))
    duration_s = _find_task(error, along, spring, task)
    rests, singular = displace(
        jacobian, task, low, high, away, rested, step, drift, held, factor)
    excess = 0.0
    for i in range(count):
        excess = max(excess, abs(step[i]) / duration_s / velocity_limit[i])
    project_free(factor, velocity, slack)
    for i in range(count):
        wanted = step[i] / duration_s / max(excess, 1.0)
        accelerations[i] = spring.damping * (wanted - velocity[i] + slack[i]) + (
            _POSTURE * drift[i] - _POSTURE_DAMPING * slack[i])
    return rests, singular, excess > 1.0 + 1e-6


@inner
def _find_task(error: FloatArray, along: FloatArray, spring: Spring, task: FloatArray) -> float:
    """
    Write the motion at which spring and damper are in balance.

    :returns: in how long it is made [s]
    """
    rate = spring.stiffness / spring.damping
    duration_s = 1.0 / rate
    way, turn = rate * norm3(error, 0), rate * norm3(error, 3)
    slower = min(1.0, spring.linear_velocity / max(way, 1e-12))
    calmer = min(1.0, spring.angular_velocity / max(turn, 1e-12))
    for i in range(3):
        task[i] = slower * rate * error[i] + along[i]
        task[3 + i] = calmer * rate * error[3 + i] + along[3 + i]
    duration_s = min(duration_s, _LARGEST_STEP / max(norm3(task, 0), 1e-12),
                     _LARGEST_TURN / max(norm3(task, 3), 1e-12))
    for i in range(6):
        task[i] *= duration_s
    return duration_s


@inner
def find_jacobian(kinematics: Kinematics, arm: Arm, place: FloatArray, jacobian: FloatArray
                  ) -> None:
    """Write the Jacobian of position and rotation of the end effector, shape (6, n)."""
    motions, center = kinematics.motions, kinematics.centers[arm.root]
    for k in range(3):
        one, two = (k + 1) % 3, (k + 2) % 3
        lever_one, lever_two = place[one] - center[one], place[two] - center[two]
        for i in range(len(arm.joints)):
            joint = arm.joints[i]
            linear = motions[joint.dof, 3 + k] + (
                motions[joint.dof, one] * lever_two - motions[joint.dof, two] * lever_one)
            jacobian[k, i] = linear if joint.moves else 0.0
            jacobian[3 + k, i] = motions[joint.dof, k] if joint.moves else 0.0


@inner
def find_error(place: FloatArray, turned: FloatArray, goal: Goal, error: FloatArray) -> None:
    """Write translation [m] and rotation vector [rad] from an end effector to its goal, (6,)."""
    turn, wanted = np.empty((3, 3)), np.empty((3, 3))
    multiply_matrices(goal.axes, goal.rotation, wanted)
    for i in range(3):
        error[i] = goal.origin[i] - place[i]
        for j in range(3):
            error[i] += goal.axes[i, j] * goal.position[j]
            turn[i, j] = (wanted[i, 0] * turned[j, 0] + wanted[i, 1] * turned[j, 1]
                          + wanted[i, 2] * turned[j, 2])
    rotation_vector(turn, error)
