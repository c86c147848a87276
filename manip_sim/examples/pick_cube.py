# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Pick a cube up through topics alone, and report its weight as the wrist's sensor measures it.

Needs a node with ``arena:=table``. The model comes from ``~/mjcf``, everything else from the
joint states and the wrench.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.examples.demonstration import Arm, Demonstration, run, TaskFailed

GRAVITY = 9.81
#: Height to which the cube is lifted, also by arms that do not point down there [m].
_LIFT_M, _LOW_LIFT_M = 0.10, 0.05
_HOLD_S = 2.0
_SETTLE_S = 1.0


class CubePicker(Demonstration):
    """A task that moves the arm over the cube and down, closes the gripper, lifts and holds."""

    def __init__(self) -> None:
        super().__init__('pick_cube', 'sim_node --ros-args -p arena:=table')
        self._arm = Arm(self)

    def perform(self) -> None:
        """
        Pick the cube up and hold it.

        :raises TaskFailed: if the node or the cube is missing, or the cube is not held
        """
        arm = self._arm
        model = self.connect(lambda: arm.is_seen)
        bodies = [model.body(i).name for i in range(model.nbody)]
        if 'cube' not in bodies:
            raise TaskFailed("there is no cube: start the node with '-p arena:=table'")
        arm.connect(model)
        cube = model.body('cube').pos
        down = _pointing_down(arm.grip[1])
        try:
            lift_m, above = _LIFT_M, arm.posture(cube + [0.0, 0.0, _LIFT_M], [down])
        except TaskFailed:
            lift_m, above = _LOW_LIFT_M, arm.posture(cube + [0.0, 0.0, _LOW_LIFT_M], [down])
        at_cube = arm.posture(cube, [down], start=above)

        self.say('opening the gripper and moving over the cube')
        arm.open()
        arm.move(above)
        self.wait(_SETTLE_S)
        empty = self._average_force(_SETTLE_S)
        self.say(f'the wrist carries {np.linalg.norm(empty):.3f} N, the weight of the gripper')
        self.say('moving down')
        arm.move(at_cube)
        self.say('closing the gripper')
        arm.close()
        self.say(f'lifting by {lift_m:.2f} m')
        arm.move(above)
        self.wait(_SETTLE_S)
        self._report(empty, self._average_force(_HOLD_S), model)

    def _report(self, empty: FloatArray, loaded: FloatArray, model: mujoco.MjModel) -> None:
        added = loaded - empty
        x, y, z = added
        self.say(f'held for {_HOLD_S:g} s; fingers at '
                 + ', '.join(f'{p:.4f}' for p in self._arm.fingers))
        self.say(f'right/wrench changed by ({x:.3f}, {y:.3f}, {z:.3f}) N in '
                 f'{self._arm.sensor_frame}: {np.linalg.norm(added):.3f} N, a mass of '
                 f'{np.linalg.norm(added) / GRAVITY:.4f} kg')
        weight = model.body('cube').mass[0] * GRAVITY
        if abs(np.linalg.norm(added) - weight) > 0.05 * weight:
            raise TaskFailed(f'the cube weighs {weight:.3f} N: it is not held')
        self.say('done')

    def _average_force(self, duration_s: float) -> FloatArray:
        end_s, forces = self.now_s + duration_s, []
        while self.now_s < end_s:
            self.next_state()
            forces.append(self._arm.force)
        average: FloatArray = np.mean(forces, axis=0)
        return average


def _pointing_down(rotation: FloatArray) -> FloatArray:
    """Return the rotation nearest to a given one with z down and axes along the world's."""
    z = np.array([0.0, 0.0, -1.0])
    x = np.zeros(3)
    largest = int(np.abs(rotation[:2, 0]).argmax())
    x[largest] = np.sign(rotation[largest, 0])
    return np.stack([x, np.cross(z, x), z], axis=1)


def main(arguments: Sequence[str] | None = None,
         is_asked_to_end: Callable[[], bool] = lambda: False) -> int:
    """
    Pick the cube up.

    :param arguments: the command line, with ROS arguments; None: that of the process
    :param is_asked_to_end: is asked while the task waits
    :returns: the exit code: 1 if the task failed, 0 if the cube is held or it was interrupted
    """
    return run(CubePicker, arguments, is_asked_to_end)
