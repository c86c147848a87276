# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Validate Cartesian commands from outside; nothing is changed here."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, matrix_of, xyzw_to_wxyz
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianPose, CartesianTwist, CartesianWrench, ForceMode, GuardedTwist, PoseAction)
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.joint_controller import JointController
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.robots import RobotModel
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.physics.robot_frames import RobotFrames
from manip_sim.validation import action_example, clamp, finite_command_numbers, positive_number


class CartesianParser:
    """
    A parser of Cartesian commands for the arms of a robot.

    :param robot: for which the commands are
    :param joints: controller of the joints; only read
    :param frames: of the robot
    """

    def __init__(self, robot: RobotModel, joints: JointController, frames: RobotFrames) -> None:
        self._robot = robot
        self._joints = joints
        self._frames = frames

    def rebind(self, model: mujoco.MjModel) -> None:
        """Take over the ids of the robot's frames in another model."""
        self._frames.rebind(model)

    @property
    def _settings(self) -> Mapping[str, CartesianSettings]:
        return self._joints.cartesian.settings

    def pose(self, arm: str, position: ArrayLike, quat_xyzw: ArrayLike, frame: str = ''
             ) -> CartesianPose:
        """
        Return the command to bring ``grip_site`` of an arm to a pose.

        :param position: in the frame [m], shape (3,)
        :param quat_xyzw: in the frame, of length 1, shape (4,)
        :param frame: a link of the robot or a frame on one; empty for ``world``
        :raises CommandError: if the frame is unknown, or the numbers are not a pose
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        indices = self._indices_of(arm)
        target_frame = self._frames.find(frame, f'{arm}: a target pose')
        pose = Pose.checked(position, quat_xyzw)
        return CartesianPose(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices, arm=arm,
            frame=target_frame, position=pose.position,
            rotation=matrix_of(xyzw_to_wxyz(pose.quat_xyzw)))

    def twist(self, arm: str, linear: ArrayLike, angular: ArrayLike, frame: str = ''
              ) -> CartesianTwist:
        """
        Return the command for a velocity of ``grip_site`` of an arm.

        A velocity above the limit of the settings is scaled down to it, and counted as clamped.

        :param linear: [m/s], shape (3,)
        :param angular: [rad/s], shape (3,)
        :param frame: whose axes the velocity is in; empty for ``world``
        :raises CommandError: if the frame is unknown, or a number is not finite or too great
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        indices = self._indices_of(arm)
        target_frame = self._frames.find(frame, f'{arm}: a target twist')
        twist = Twist.checked(linear, angular)
        settings = self._settings[arm]
        halves = [_shortened(twist.linear, settings.linear_velocity),
                  _shortened(twist.angular, settings.angular_velocity)]
        return CartesianTwist(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices, arm=arm,
            frame=target_frame,
            twist=np.concatenate([vector for vector, _ in halves]),
            clamped=sum(clamped for _, clamped in halves))

    def until_contact(self, arm: str, linear: ArrayLike, angular: ArrayLike, *, force: float,
                      distance: float, duration_s: float, frame: str = '') -> GuardedTwist:
        """
        Return the command for a velocity of ``grip_site`` of an arm until contact.

        ``reports[arm].contact`` of the Cartesian controller has where it ended, and why.

        :param linear: [m/s], shape (3,)
        :param angular: [rad/s], shape (3,)
        :param force: size of the external force on the tool that ends it [N]
        :param distance: of ``grip_site`` from where it is now, which ends it [m]
        :param duration_s: simulation time that ends it [s]
        :param frame: whose axes the velocity is in; empty for ``world``
        :raises CommandError: if the frame is unknown, a velocity is not finite, or a number that
            ends the motion is not above 0
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        twist = self.twist(arm, linear, angular, frame)
        limits = {name: positive_number(value, f'{arm}: the {name} of a motion until contact',
                                        CommandError) for name, value in (
            ('force', force), ('distance', distance), ('duration', duration_s))}
        return GuardedTwist(
            robot=twist.robot, parts=twist.parts, indices=twist.indices, arm=arm,
            frame=twist.frame, twist=twist.twist, clamped=twist.clamped, force=limits['force'],
            distance=limits['distance'], duration_s=limits['duration'])

    def wrench(self, arm: str, force: ArrayLike, torque: ArrayLike, frame: str = ''
               ) -> CartesianWrench:
        """
        Return the command for a wrench that an impedance adds to that of its springs.

        :param force: that ``grip_site`` pushes with [N], shape (3,)
        :param torque: about ``grip_site`` [N m], shape (3,)
        :param frame: whose axes the wrench is in; empty for ``world``
        :raises CommandError: if the frame is unknown, a number is not finite, or the arm is not
            an impedance
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        indices = self._indices_of(arm)
        target_frame = self._frames.find(frame, f'{arm}: a target wrench')
        wrench = np.concatenate([
            finite_command_numbers(force, 3, f'{arm}: the force of a target wrench'),
            finite_command_numbers(torque, 3, f'{arm}: the torque of a target wrench')])
        self._check_impedance(arm, 'a target wrench')
        return CartesianWrench(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices, arm=arm,
            frame=target_frame, wrench=wrench)

    def force_mode(self, arm: str, selection: ArrayLike, wrench: ArrayLike, limits: ArrayLike
                   ) -> ForceMode:
        """
        Return the command for an impedance to exert a wrench along and about chosen axes.

        Its springs do not act there; along and about the other axes they hold the target.

        :param selection: 1 for the axes of the springs that are chosen, else 0, shape (6,)
        :param wrench: force and torque there [N, N m], shape (6,); the others are not used
        :param limits: velocities there [m/s, rad/s], above 0, shape (6,); the others are not used
        :raises CommandError: if a number is not finite or out of range, or the arm is not an
            impedance
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        indices = self._indices_of(arm)
        numbers = [
            finite_command_numbers(value, 6, f'{arm}: the {name} of force mode')
            for value, name in (
                (selection, 'selection'), (wrench, 'wrench'), (limits, 'limits'))]
        chosen = numbers[0] == 1.0
        if not (chosen | (numbers[0] == 0.0)).all():
            raise CommandError(f'{arm}: the selection of force mode must be 0 or 1 for each axis, '
                               f'got {numbers[0].tolist()}')
        if not (numbers[2][chosen] > 0.0).all():
            raise CommandError(f'{arm}: the limits of force mode must be above 0 for the axes '
                               f'that are chosen, got {numbers[2].tolist()}')
        self._check_impedance(arm, 'force mode')
        return ForceMode(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices, arm=arm,
            frame=self._frames.find('', arm), wrench=np.where(chosen, numbers[1], 0.0),
            selection=chosen, limits=np.where(chosen, numbers[2], 1.0))

    def _check_impedance(self, arm: str, what: str) -> None:
        if not self._joints.impedes(arm):
            raise CommandError(f'{arm}: {what} needs effort mode and a cartesian_stiffness.{arm} '
                               'that is not zero')

    def action(self, arm: str, action: ArrayLike) -> PoseAction:
        """
        Return the command for an action of robosuite's OSC_POSE.

        :param action: six numbers in [-1, 1]: along x, y, z and about x, y, z
        :raises CommandError: if the length is wrong or a number is not finite
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        indices = self._indices_of(arm)
        numbers = finite_command_numbers(action, 6, f'{arm}: a pose action')
        inside, clamped = clamp(numbers, np.array([-1.0, 1.0]))
        return PoseAction(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices, arm=arm,
            action=inside, clamped=clamped,
            clamped_example=action_example(numbers, inside) if clamped else '')

    def _indices_of(self, arm: str) -> IntArray:
        if arm not in self._settings:
            raise UnknownNameError('arm with a gripper', arm, self._settings)
        return self._joints.indices_of(arm)


def _shortened(vector: FloatArray, limit: float) -> tuple[FloatArray, int]:
    """Return a vector shortened to a limit, and how many of its numbers changed."""
    size = length(vector)
    if size <= limit:
        return vector, 0
    return vector * (limit / size), int(np.count_nonzero(vector))
