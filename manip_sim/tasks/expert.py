# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Policies, which act in an episode, and experts, which are scripts that read the simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
import logging
from typing import Any, Protocol

import mujoco
import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.models.grippers import GripperModel
from manip_sim.physics.entities import pulling_bodies
from manip_sim.quoting import quoted_names
from manip_sim.simulation import Simulation
from manip_sim.tasks.episode_actions import ArmAction, PoseActions, STEP_M
from manip_sim.tasks.placing import bodies_of_gripper, pressure, touching

_LOGGER = logging.getLogger(__name__)

#: An end effector has arrived if it is within this of its goal [m], and turned so: the cosine.
_ARRIVED_M, _TURNED = 0.006, 0.998
#: It is given up after this many control periods, or if it came nearer by less than this in some
#: of them; a radian counts as a metre [m].
_MOST_PERIODS, _STALLED = 60, 10
_NEARER_M = 0.005
#: Fingers are waited for, but for so many control periods at most.
_MOST_WAITED = 40
#: Distance of fingers beyond the width of an object before they are around it [m].
_ROOM_M = 0.012
#: A gripper holds an object if it presses on it with so many times its weight.
_WEIGHTS, _GRAVITY = 4.0, 9.81
#: A stroke of a gripper in the unit of its actions, from -1 to +1.
_STROKE = 2.0
#: Way up of a gripper in a period while its fingers stand on something [m].
_UP_M = 0.002
#: Joints are beyond their range from this distance on [rad or m].
_BEYOND = 0.02
#: Distance of fingers without pads [m].
_FAR_M = 1.0


class Policy(Protocol):
    """A policy, which chooses the actions of an episode."""

    def reset(self, seed: int) -> None:
        """Begin an episode."""

    def act(self, observation: Any) -> FloatArray:
        """
        Return the action of the next control period.

        :returns: as for :class:`PoseActions`
        """


class Hold:
    """
    Goal of an expert for one arm: a pose of its end effector, and whether the gripper closes.

    :param position: of ``grip_site`` in ``world`` [m], shape (3,)
    :param rotation: of ``grip_site`` in ``world``, shape (3, 3)
    :ivar closing: from -1, open, to +1
    :ivar longest_m: how far ahead of the end effector its goal may be [m]; less is slower
    """

    def __init__(self, item: ArmAction, position: FloatArray, rotation: FloatArray) -> None:
        self.item = item
        self.position = position
        self.rotation = rotation
        self.closing = -1.0
        self.longest_m = STEP_M


class Expert(ABC):
    """
    A policy that follows a script and reads the simulation instead of observations.

    :param simulation: in which it acts
    :ivar arms: what it wants, by arm as in ``PoseActions.arms``
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self._actions = PoseActions(simulation)
        self._has_missed = False
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """
        Begin an episode, at its start.

        :param seed: of the episode; it does not matter to a script
        """
        data = self.simulation.data
        self.arms = [Hold(item, *item.chain.tip.pose(data)) for item in self._actions.arms]
        self._script = self.script()

    @abstractmethod
    def script(self) -> Iterator[None]:
        """Change :attr:`arms`; each ``yield`` is one control period. It begins after a reset."""

    def act(self, observation: Any = None) -> FloatArray:
        """
        Return the action of the next control period, as for :class:`PoseActions`.

        :param observation: not used
        """
        next(self._script, None)
        action = np.zeros(self._actions.size)
        for hold in self.arms:
            action[hold.item.goals] = self._actions.towards(
                hold.item, hold.position, hold.rotation, hold.longest_m)
            action[hold.item.gripper] = hold.closing
        return action

    def end_effector(self, arm: Hold) -> tuple[FloatArray, FloatArray]:
        """
        Return position [m] and rotation of the end effector of an arm in ``world``.

        :param arm: one of :attr:`arms`
        """
        return arm.item.chain.tip.pose(self.simulation.data)

    def move(self, arm: Hold, position: FloatArray, rotation: FloatArray | None = None,
             longest_m: float = STEP_M, within_m: float = _ARRIVED_M) -> Iterator[None]:
        """
        Move an end effector to a pose, until it is there or does not come nearer for long.

        :param arm: one of :attr:`arms`
        :param position: of ``grip_site`` in ``world`` [m], shape (3,)
        :param rotation: of ``grip_site`` in ``world``; None keeps the one before
        :param longest_m: how far ahead of the end effector its goal may be [m]; less is slower
        :param within_m: how near is there [m]
        """
        arm.position, arm.longest_m = position, longest_m
        arm.rotation = arm.rotation if rotation is None else rotation
        ways: list[float] = []
        for _ in range(_MOST_PERIODS):
            yield
            here, turned = self.end_effector(arm)
            # The trace of a turn by an angle is one, and twice its cosine.
            cosine = (float((arm.rotation * turned).sum()) - 1.0) / 2.0
            if length(arm.position - here) <= within_m and cosine >= _TURNED:
                return
            ways.append(length(arm.position - here) + float(np.arccos(np.clip(cosine, -1.0, 1.0))))
            if min(ways) > min(ways[:-_STALLED], default=np.inf) - _NEARER_M:
                return

    def grip(self, arm: Hold, closing: float, periods: int = 10, body: str = '') -> Iterator[None]:
        """
        Open or close a gripper and wait.

        :param arm: one of :attr:`arms`
        :param closing: from -1, open, to +1
        :param periods: how long to wait at least
        :param body: of an object; a gripper whose stroke takes longer is waited for until it
            holds that
        """
        arm.closing = closing
        yield from self.wait(periods)
        if body:
            # Its speed is the share of half a stroke in a period; zero: it moves at once.
            if 0.0 < _gripper(arm).speed * periods < _STROKE or self._stands(arm, body):
                yield from self._press(arm, body)
            self._report_miss(arm, body)

    def _stands(self, arm: Hold, body: str) -> bool:
        """Return whether a gripper presses on something else, and does not touch an object."""
        gripper = bodies_of_gripper(self.simulation, arm.item.robot, arm.item.arm)
        return not touching(self.simulation, body) & gripper and (
            pressure(self.simulation, gripper, but={body}) > 0.0)

    def _press(self, arm: Hold, body: str) -> Iterator[None]:
        """Wait until a gripper that closes presses on an object."""
        gripper = bodies_of_gripper(self.simulation, arm.item.robot, arm.item.arm)
        weight_n = float(self.simulation.model.body(body).subtreemass[0]) * _GRAVITY
        for _ in range(_MOST_WAITED):
            if pressure(self.simulation, gripper, {body}) > _WEIGHTS * weight_n:
                return
            if pressure(self.simulation, gripper, but={body}):
                # The surface that the fingers stand on keeps them from closing.
                arm.position = arm.position + [0.0, 0.0, _UP_M]
            yield

    def _report_miss(self, arm: Hold, body: str) -> None:
        """Warn once of a gripper that has closed and does not hold an object, and say why."""
        simulation, gripper = self.simulation, _gripper(arm)
        model, data = simulation.model, simulation.data
        touched = touching(simulation, body) & bodies_of_gripper(
            simulation, arm.item.robot, arm.item.arm)
        if len(touched) > 1 or touched & pulling_bodies(model, data) or self._has_missed:
            return
        self._has_missed = True
        joints = [model.joint(name).id for name in gripper.joints]
        at = {model.joint(joint).name: float(data.qpos[model.jnt_qposadr[joint]])
              for joint in joints}
        beyond = [model.joint(joint).name for joint in joints if model.jnt_limited[joint] and not (
            model.jnt_range[joint, 0] - _BEYOND <= at[model.joint(joint).name]
            <= model.jnt_range[joint, 1] + _BEYOND)]
        _LOGGER.warning(
            "the expert cannot grasp '%s': the gripper %s has closed, and %s of its bodies "
            'touches that; joints: %s%s', body, gripper.name, len(touched) or 'none',
            ', '.join(f'{name} {value:.3f}' for name, value in at.items()),
            f'; beyond its range: {quoted_names(beyond)}, so the actuators are too strong for the '
            'inertia of the fingers: give these joints armature' if beyond else '')

    def open_to(self, arm: Hold, width_m: float) -> Iterator[None]:
        """
        Wait until an object fits between the fingers of an arm that opens its gripper.

        :param arm: one of :attr:`arms`
        :param width_m: of the object [m]
        """
        model, data, ends = self.simulation.model, self.simulation.data, np.empty(6)
        left, right = ([model.geom(name).id for name in _gripper(arm).important_geoms[
            f'{side}_fingerpad']] for side in ('left', 'right'))
        for _ in range(_MOST_WAITED):
            if min((mujoco.mj_geomDistance(model, data, geom, other, _FAR_M, ends)
                    for geom in left for other in right), default=_FAR_M) > width_m + _ROOM_M:
                return
            yield

    def wait(self, periods: int) -> Iterator[None]:
        """
        Wait.

        :param periods: number of control periods
        """
        for _ in range(periods):
            yield


def _gripper(arm: Hold) -> GripperModel:
    gripper = arm.item.robot.parts[f'{arm.item.arm}/gripper'].gripper
    assert gripper is not None
    return gripper


def fingers_side_by_side(model: mujoco.MjModel, arm: Hold) -> bool:
    """Return whether a gripper has several fingers on one side, as one with three fingers has."""
    geoms = _gripper(arm).important_geoms
    return any(len({int(model.geom(name).bodyid[0]) for name in geoms[side]}) > 1
               for side in ('left_fingerpad', 'right_fingerpad'))


def pointing_down(across: Iterable[FloatArray], rotation: FloatArray) -> FloatArray:
    """
    Return a rotation of ``grip_site`` with z down and the fingers closing along a direction.

    :param across: horizontal directions in ``world`` to choose from, each of shape (3,)
    :param rotation: the present one, shape (3, 3); the nearest direction to its x is chosen
    """
    z = np.array([0.0, 0.0, -1.0])
    x = max(across, key=lambda direction: float((direction * rotation[:, 0]).sum()))
    x = x - (x * z).sum() * z
    x = x / length(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def sides(rotation: FloatArray) -> list[FloatArray]:
    """
    Return the nearly horizontal axes of a body in both directions, in ``world``.

    :param rotation: of the body, shape (3, 3)
    """
    return [sign * axis for axis in rotation.T if abs(axis[2]) < 0.5 for sign in (1.0, -1.0)]
