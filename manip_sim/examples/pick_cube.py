# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Pick a cube up through topics alone, and say what the wrist feels.

Needs a node with ``arena:=table``. The model comes from ``~/mjcf``; everything else from the
joint states and the wrench.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import sys
import time

from geometry_msgs.msg import WrenchStamped
import mujoco
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from manip_sim.examples.inverse_kinematics import InverseKinematics
from manip_sim.typing import FloatArray

GRAVITY = 9.81
_LIFT_M = 0.10
_HOLD_S = 2.0
_MOVE_S = 2.0
_SETTLE_S = 1.0
_STILL_S = 0.5
#: Fingers that move less are still [rad or m].
_STILL = 5e-4
_PATIENCE_S = 10.0


class PickFailed(Exception):
    """The cube could not be picked up; the message says why."""


class CubePicker(Node):
    """Moves the arm over the cube, down, closes the gripper, lifts and holds."""

    def __init__(self) -> None:
        super().__init__('pick_cube')
        self._mjcf: str | None = None
        self._arm: JointState | None = None
        self._all: JointState | None = None
        self._fingers: JointState | None = None
        self._wrench: WrenchStamped | None = None
        latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, 'manip_sim/mjcf', self._take_mjcf, latched)
        self.create_subscription(JointState, 'joint_states', self._take_all, 1)
        self.create_subscription(JointState, 'arm/joint_states', self._take_arm, 1)
        self.create_subscription(JointState, 'right/gripper/joint_states', self._take_fingers, 1)
        self.create_subscription(WrenchStamped, 'right/wrench', self._take_wrench, 1)
        self._joint_command = self.create_publisher(JointState, 'arm/joint_command', 1)
        self._gripper = self.create_publisher(Float64MultiArray, 'right/gripper/command', 1)

    def _take_mjcf(self, message: String) -> None:
        self._mjcf = message.data

    def _take_all(self, message: JointState) -> None:
        self._all = message

    def _take_arm(self, message: JointState) -> None:
        self._arm = message

    def _take_fingers(self, message: JointState) -> None:
        self._fingers = message

    def _take_wrench(self, message: WrenchStamped) -> None:
        self._wrench = message

    # ------------------------------------------------------------------ the task

    def pick(self) -> None:
        """
        Pick the cube up and hold it.

        :raises PickFailed: if there is no node, no cube, or the cube is not held
        """
        arm, mjcf = self._connect()
        model = mujoco.MjModel.from_xml_string(mjcf)
        bodies = [model.body(i).name for i in range(model.nbody)]
        if 'cube' not in bodies:
            raise PickFailed("there is no cube: start the node with '-p arena:=table'")
        cube = model.body('cube').pos
        assert self._all is not None and self._wrench is not None
        # The sites of a gripper have the same prefix, whatever the robot's names begin with.
        site = self._wrench.header.frame_id.removesuffix('ft_frame') + 'grip_site'
        kinematics = InverseKinematics(model, arm.name, site,
                                       dict(zip(self._all.name, self._all.position)))
        start = np.array(arm.position)
        down = _pointing_down(kinematics.forward(start)[1])
        try:
            above = kinematics.solve(start, cube + [0.0, 0.0, _LIFT_M], down)
            at_cube = kinematics.solve(above, cube, down)
        except ValueError as error:
            raise PickFailed(str(error)) from error

        self._say('opening the gripper and moving over the cube')
        self._gripper.publish(Float64MultiArray(data=[-1.0]))
        self._move(start, above)
        empty = self._average_force(_SETTLE_S)
        self._say(f'the wrist carries {np.linalg.norm(empty):.3f} N, the weight of the hand')
        self._say('moving down')
        self._move(above, at_cube)
        self._say('closing the gripper')
        self._gripper.publish(Float64MultiArray(data=[1.0]))
        self._wait_for_fingers()
        self._say(f'lifting by {_LIFT_M:.2f} m')
        self._move(at_cube, above)
        self._wait(_SETTLE_S)
        self._report(empty, self._average_force(_HOLD_S), model)

    def _connect(self) -> tuple[JointState, str]:
        self._wait_until(lambda: None not in (self._mjcf, self._all, self._arm,
                                              self._fingers, self._wrench),
                         "no node answers: start one with 'sim_node --ros-args -p arena:=table'")
        self._wait_until(lambda: min(self._joint_command.get_subscription_count(),
                                     self._gripper.get_subscription_count()) > 0,
                         'the node does not listen to commands')
        assert self._arm is not None and self._mjcf is not None
        return self._arm, self._mjcf

    def _report(self, empty: FloatArray, loaded: FloatArray, model: object) -> None:
        assert self._wrench is not None and self._fingers is not None
        added = loaded - empty
        x, y, z = added
        self._say(f'held for {_HOLD_S:g} s; fingers at '
                  + ', '.join(f'{p:.4f}' for p in self._fingers.position))
        self._say(f'right/wrench changed by ({x:.3f}, {y:.3f}, {z:.3f}) N in '
                  f'{self._wrench.header.frame_id}: {np.linalg.norm(added):.3f} N, a mass of '
                  f'{np.linalg.norm(added) / GRAVITY:.4f} kg')
        weight = model.body('cube').mass[0] * GRAVITY  # type: ignore[attr-defined]
        if abs(np.linalg.norm(added) - weight) > 0.05 * weight:
            raise PickFailed(f'the cube weighs {weight:.3f} N: it is not held')
        self._say('done')

    # ------------------------------------------------------------------ motion and waiting

    def _move(self, start: FloatArray, goal: FloatArray) -> None:
        begin = self._now_s()
        share = 0.0
        while share < 1.0:
            share = min((self._now_s() - begin) / _MOVE_S, 1.0)
            smooth = 0.5 - 0.5 * np.cos(np.pi * share)
            message = JointState(name=self._arm.name if self._arm else [],
                                 position=(start + smooth * (goal - start)).tolist())
            self._joint_command.publish(message)
            self._next_state()

    def _average_force(self, duration_s: float) -> FloatArray:
        forces = []
        end = self._now_s() + duration_s
        while self._now_s() < end:
            self._next_state()
            assert self._wrench is not None
            force = self._wrench.wrench.force
            forces.append((force.x, force.y, force.z))
        average: FloatArray = np.mean(forces, axis=0)
        return average

    def _wait(self, duration_s: float) -> None:
        end = self._now_s() + duration_s
        while self._now_s() < end:
            self._next_state()

    def _wait_for_fingers(self) -> None:
        """Wait until the fingers have not moved for a while."""
        last, since = np.zeros(0), self._now_s()
        while self._now_s() < since + _STILL_S:
            self._next_state()
            assert self._fingers is not None
            here = np.array(self._fingers.position)
            if last.shape != here.shape or np.abs(here - last).max() > _STILL:
                last, since = here, self._now_s()

    def _now_s(self) -> float:
        assert self._arm is not None
        stamp = self._arm.header.stamp
        return float(stamp.sec) + float(stamp.nanosec) * 1e-9

    def _next_state(self) -> None:
        last = self._now_s()
        self._wait_until(lambda: self._now_s() > last, 'the simulation stands still')

    def _wait_until(self, condition: Callable[[], bool], problem: str) -> None:
        end = time.monotonic() + _PATIENCE_S
        while not condition():
            rclpy.spin_once(self, timeout_sec=0.1)
            if time.monotonic() > end:
                raise PickFailed(problem)

    def _say(self, text: str) -> None:
        print(f'{self._now_s():8.2f} s  {text}', flush=True)


def _pointing_down(rotation: FloatArray) -> FloatArray:
    """Return the rotation nearest to one whose z points down and whose axes are the world's."""
    z = np.array([0.0, 0.0, -1.0])
    x = np.zeros(3)
    largest = int(np.abs(rotation[:2, 0]).argmax())
    x[largest] = np.sign(rotation[largest, 0])
    return np.stack([x, np.cross(z, x), z], axis=1)


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Pick the cube up.

    :returns: the exit code: 0 if the cube is held, else 1
    """
    rclpy.init(args=arguments)
    picker = CubePicker()
    try:
        picker.pick()
        return 0
    except PickFailed as error:
        print(f'pick_cube: {error}', file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        picker.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
