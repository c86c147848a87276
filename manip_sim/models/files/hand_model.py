# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What hands from files share: a grasp frame, and actions that say how far to close."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.fingers import control_range, Fingers, integrates
from manip_sim.models.files.found_hands import FoundHand
from manip_sim.models.files.found_places import add_body_at, find_place, free_name
from manip_sim.models.files.part_descriptions import FrameDescription, HandDescription
from manip_sim.models.grippers.gripper_model import add_standard_elements, GripperModel
from manip_sim.quaternion import relative_quat_wxyz
from manip_sim.quoting import quoted_names


class HandFromFile(GripperModel, registered=False):
    """
    A hand that a file and a description declare.

    An action says how far each actuator closes: -1 is open, +1 is closed.

    :ivar inferred: what was inferred or left out, in sentences
    :ivar grasp_point: the grasp frame
    :ivar closing: control that opens and control that closes, by actuator of the file
    """

    grasp_point: FrameDescription
    closing: dict[str, list[float]]

    inferred: list[str]
    #: Whether the grasp frame was added.
    _has_grasp_frame = False
    #: What the description was read from, for messages.
    _where: str
    _description: HandDescription
    _start: Mapping[str, float]
    #: Commands in [-1, 1] that open and close.
    _open: FloatArray
    _closed: FloatArray

    def _add_grasp_frame(self, spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand, prefix: str
                         ) -> None:
        """
        Add the grasp frame, declared or between the fingers, with standard sites and sensors.

        :param prefix: what the names of all these begin with
        """
        fingers = Fingers(tree, hand, self._start)
        point, mount = self._description.grasp_point, tree.name(hand.body)
        at = (point.at if point else None) or (None if point else fingers.grasp_frame()) or mount
        place = find_place(spec, at, f"'grasp_point' of {self._where}")
        position = point.position if point else np.zeros(3)
        orientation: ArrayLike = point.orientation if point else np.zeros(3)
        if point is None and at == mount:
            position, orientation = fingers.grasp_point(), _upright(tree, hand.body)
        if point is None:
            middle = f"the middle of the fingertips, {_rounded(position)} m in '{mount}'"
            self.inferred.append(
                'grasp frame: ' + (middle if at == mount else f"{place[0]} '{at}'"))
        self.grasp_point = FrameDescription(
            at=at, position=list(map(float, position)),
            orientation=np.asarray(orientation, dtype=float).tolist())
        self._eef_body = free_name({body.name for body in spec.bodies}, f'{prefix}eef')
        eef = add_body_at(tree.model, place, self._eef_body, position, orientation)
        add_standard_elements(spec, spec.body(mount), eef, prefix)
        self._has_grasp_frame = True
        self._important_sites = {role: prefix + name for role, name in
                                 GripperModel._important_sites.items()}
        self._important_sensors = {role: prefix + name for role, name in
                                   GripperModel._important_sensors.items()}

    def _set_closing(self, fingers: Fingers, ids: list[int]) -> None:
        """
        Set which way the actuators close, by the description or by trial.

        :param ids: of :attr:`actuators`, in the model that the part is compiled in
        """
        declared, names = self._description.closing, self._actuators
        for name in declared:
            if name not in names:
                raise UnknownNameError(f"actuator in 'closing' of {self._where}", name, names)
        found = fingers.closing([i for name, i in zip(names, ids) if name not in declared])
        changed = fingers.reopening(found)
        found.update(changed)
        ends = []
        self.closing = {}
        for name, actuator in zip(names, ids):
            opened, closed = declared.get(name) or found.get(actuator, (-1.0, 1.0, False))[:2]
            low, high = control_range(self._own_model, actuator) or (opened, closed)
            if not all(low <= end <= high for end in (opened, closed)):
                raise ModelError(f"'closing' of actuator '{name}' in {self._where} must be within "
                                 f'its control range of {low:g} to {high:g}, got [{opened:g}, '
                                 f'{closed:g}]')
            self.closing[name] = [float(opened), float(closed)]
            span = (high - low) or 1.0
            ends.append(2.0 * (np.array([opened, closed]) - low) / span - 1.0)
        self._open, self._closed = np.array(ends).reshape(-1, 2).T
        notes = [f'{names[ids.index(actuator)]} from {opened:g} to {closed:g}'
                 f'{"" if is_clear else " (a guess)"}'
                 for actuator, (opened, closed, is_clear) in found.items()]
        if notes:
            self.inferred.append(f'closing: {", ".join(notes)}')
        if changed:
            self.inferred.append(
                f'closing of {quoted_names([names[ids.index(a)] for a in changed])}: other than '
                "the ends of its range, from which it does not open again; 'closing' in a YAML "
                'file changes it')
        if bodies := fingers.out_of_touch:
            self.inferred.append(
                f'no shape of the fingers ({", ".join(bodies)}) can touch an object: give them '
                f'collision shapes, with contype and conaffinity 1, in {self.file}')

    @property
    def dof(self) -> int:
        """One number for each actuator, or for all together."""
        count = len(self._actuators)
        return min(1, count) if self._description.action == 'together' else count

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Return the commands that open or close the actuators.

        :param action: -1 open, +1 closed, clamped to these, shape (dof,)
        :returns: commands in the order of :attr:`actuators`, in [-1, 1], shape (nu,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        share = (np.clip(self._checked(action), -1.0, 1.0) + 1.0) / 2.0
        commands: FloatArray = self._open + share * (self._closed - self._open)
        return commands

    def start_at(self, command: ArrayLike) -> None:
        """
        Change nothing: an action does not depend on the ones before.

        :param command: commands in [-1, 1], one for each actuator
        """

    @property
    def init_qpos(self) -> FloatArray:
        """Start positions of the joints [rad or m], shape (number of joints,), a copy."""
        # A ball joint has no start: it stays at the unit quaternion, whose w is 1.
        return np.array([self._start.get(joint, 1.0) for joint in self._joints])


def _upright(tree: BodyTree, body: int) -> FloatArray:
    """Return the rotation of the mount in a root body, w, x, y, z; identity in another body."""
    if tree.parent(body) != 0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return relative_quat_wxyz(tree.model.body_quat[body], (1.0, 0.0, 0.0, 0.0))


def _rounded(position: ArrayLike) -> str:
    return ' '.join(f'{number:.3f}' for number in np.asarray(position))


def fill_control_ranges(spec: mujoco.MjSpec, model: mujoco.MjModel, actuators: list[int]
                        ) -> list[str]:
    """
    Set the control ranges of a hand's actuators, as :func:`control_range` returns them.

    :returns: a sentence for each actuator without limits, whose range becomes [-1, 1]
    """
    notes = []
    for actuator in actuators:
        element = spec.actuator(model.actuator(actuator).name)
        limits = control_range(model, actuator)
        if limits is None:
            limits = (-1.0, 1.0)
            notes.append(f"actuator '{element.name}' has no limits: actions are its control")
        element.inheritrange = 0.0
        if integrates(model, actuator):
            element.actrange = limits
            continue
        element.ctrlrange, element.ctrllimited = limits, int(mujoco.mjtLimited.mjLIMITED_TRUE)
    return notes
