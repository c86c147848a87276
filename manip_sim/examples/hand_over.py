# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Hand a cube from one arm to a second and a third one, through topics alone.

Needs a node with ``config/hand_over.yaml``. The arms ``left`` and ``right`` hold the cube from
above by its sides along y, the arm ``middle`` from below by its sides along x. After each grasp
the cube's pose shows whether it moves with the gripper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from geometry_msgs.msg import PoseStamped
import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.examples.demonstration import Arm, Demonstration, run, TaskFailed
from manip_sim.resources import share_directory

#: The topic of the cube's pose.
CUBE = 'objects/cube/pose'
#: Points where ``left`` and then ``middle`` give the cube to the next arm, in ``world`` [m].
LEFT_PLACE, RIGHT_PLACE = np.array([0.0, 0.2, 1.4]), np.array([0.0, -0.2, 1.4])
#: Place of the cube in the end, in ``world`` [m], and the tolerance [m].
GOAL, NEAR_GOAL_M = np.array([-0.05, -0.5, 0.825]), 0.03
#: Distance from the cube of a gripper that waits [m], and of a grip from its centre [m].
_AWAY_M, _OFF_MIDDLE_M = 0.12, 0.008
#: A cube that is held moves in the gripper by less than this [m].
_SLIP_M = 0.01
#: Fingers that close move by more than this [rad or m].
_CLOSES = 2e-3
_SETTLE_S = 0.3
_UP = np.array([0.0, 0.0, 1.0])


class HandOverDemonstration(Demonstration):
    """A task: ``left`` picks the cube up, ``middle`` takes it, and ``right`` puts it down."""

    def __init__(self) -> None:
        file = share_directory() / 'config' / 'hand_over.yaml'
        super().__init__('hand_over', f'sim_node --ros-args --params-file {file}')
        self._left, self._middle, self._right = (Arm(self, name)
                                                 for name in ('left', 'middle', 'right'))
        self.follow(PoseStamped, CUBE)

    @property
    def _cube(self) -> FloatArray:
        position = self.latest[CUBE].pose.position
        return np.array([position.x, position.y, position.z])

    def _sides(self) -> list[FloatArray]:
        """Return the horizontal directions from the cube's centre to its sides, in ``world``."""
        turned, rotation = self.latest[CUBE].pose.orientation, np.empty(9)
        mujoco.mju_quat2Mat(rotation, np.array([turned.w, turned.x, turned.y, turned.z]))
        axes = rotation.reshape(3, 3).T
        return [sign * axis for axis in axes if abs(axis[2]) < 0.1 for sign in (1.0, -1.0)]

    def perform(self) -> None:
        """
        Hand the cube over twice.

        :raises TaskFailed: if the node is missing, a gripper does not hold the cube, or it is not
            at the goal in the end
        """
        left, middle, right = arms = self._left, self._middle, self._right
        model = self.connect(
            lambda: CUBE in self.latest and all(arm.is_seen for arm in arms))
        for arm in arms:
            arm.connect(model)
            arm.open()
        self._take(left, -_UP, self._sides())
        self._carry(left, LEFT_PLACE, -_UP)
        self._give(left, middle, _UP)
        self._carry(middle, RIGHT_PLACE, _UP)
        self._give(middle, right, -_UP)
        self._carry(right, GOAL + _AWAY_M * _UP, -_UP)
        self._put_down(right)
        self._check_goal()

    # ------------------------------------------------------------------ steps

    def _take(self, arm: Arm, approach: FloatArray, across: Sequence[FloatArray]) -> None:
        """Let an arm approach the cube and grip it, fingers closing along one of ``across``."""
        rotations = [_looking(approach, direction) for direction in across]
        # Two grippers that hold the cube leave room for each other.
        grip = self._cube - _OFF_MIDDLE_M * approach
        before = arm.posture(grip - _AWAY_M * approach, rotations)
        at_cube = arm.posture(grip, rotations, start=before)
        arm.move(before)
        arm.move(at_cube)
        fingers = arm.fingers
        arm.close()
        if np.abs(arm.fingers - fingers).max() < _CLOSES:
            raise TaskFailed(f'the gripper of {arm.name} does not close')
        self.say(f'{arm.name} grips the cube at {_in_words(self._cube)}')

    def _carry(self, arm: Arm, place: FloatArray, approach: FloatArray) -> None:
        """Let an arm carry the cube to a place, and check that it is still held."""
        inside = self._inside(arm)
        rotations = [_looking(approach, direction) for direction in _directions(approach)]
        arm.move(arm.posture(place - _OFF_MIDDLE_M * approach, rotations))
        self.wait(_SETTLE_S)
        self._check_held(arm, inside)

    def _check_held(self, arm: Arm, inside: FloatArray) -> None:
        slipped = float(np.linalg.norm(self._inside(arm) - inside))
        if slipped > _SLIP_M:
            raise TaskFailed(f'the cube is not held by {arm.name}: it is at '
                             f'{_in_words(self._cube)}, {slipped:.3f} m from where it was in '
                             'the gripper')
        self.say(f'{arm.name} holds the cube at {_in_words(self._cube)}: it moved by '
                 f'{1000.0 * slipped:.1f} mm in the gripper')

    def _give(self, giver: Arm, taker: Arm, approach: FloatArray) -> None:
        """Let an arm take the cube from another one, which lets go, and move both away."""
        self._take(taker, approach, _directions(approach))
        self._let_go(giver, approach)
        self._carry(taker, self._cube - _AWAY_M * approach, approach)

    def _let_go(self, arm: Arm, away: FloatArray) -> None:
        arm.open()
        position, rotation = arm.grip
        arm.move(arm.posture(position + _AWAY_M * away, [rotation]))

    def _put_down(self, arm: Arm) -> None:
        position, rotation = arm.grip
        down = position + (GOAL - self._cube)
        inside = self._inside(arm)
        arm.move(arm.posture(down, [rotation]))
        self._check_held(arm, inside)
        self._let_go(arm, _UP)

    def _check_goal(self) -> None:
        self.wait(_SETTLE_S)
        off = float(np.linalg.norm(self._cube - GOAL))
        if off > NEAR_GOAL_M:
            raise TaskFailed(f'the cube is at {_in_words(self._cube)}, {off:.3f} m from the goal')
        self.say(f'done: the cube stands at {_in_words(self._cube)}, {1000.0 * off:.1f} mm from '
                 'the goal')

    def _inside(self, arm: Arm) -> FloatArray:
        """Return the cube's position in the frame of an arm's grip site [m], shape (3,)."""
        position, rotation = arm.grip
        inside: FloatArray = (self._cube - position) @ rotation
        return inside


def _directions(approach: FloatArray) -> list[FloatArray]:
    """Return directions in which fingers may close: along y from above, along x from below."""
    axis = np.array([0.0, 1.0, 0.0] if approach[2] < 0.0 else [1.0, 0.0, 0.0])
    return [axis, -axis]


def _looking(approach: FloatArray, across: FloatArray) -> FloatArray:
    """Return the rotation of a grip site that approaches along z and closes fingers along x."""
    x = across - (across @ approach) * approach
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(approach, x), approach], axis=1)


def _in_words(position: FloatArray) -> str:
    return f'({", ".join(f"{value:.3f}" for value in position)}) m'


def main(arguments: Sequence[str] | None = None,
         is_asked_to_end: Callable[[], bool] = lambda: False) -> int:
    """
    Hand the cube over.

    :param arguments: the command line, with ROS arguments; None: that of the process
    :param is_asked_to_end: is asked while the task waits
    :returns: the exit code: 1 if the task failed, 0 if it succeeded or was interrupted
    """
    return run(HandOverDemonstration, arguments, is_asked_to_end)
