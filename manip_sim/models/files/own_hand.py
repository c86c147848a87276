# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The hand in a robot's file, as a gripper of that robot."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.fingers import Fingers
from manip_sim.models.files.found_hands import FoundHand, hands_of_hand
from manip_sim.models.files.hand_model import fill_control_ranges, HandFromFile
from manip_sim.models.files.part_descriptions import OwnHandDescription
from manip_sim.models.spec_edits import delete_elements
from manip_sim.quaternion import relative_quat_wxyz, wxyz_to_xyzw
from manip_sim.quoting import quoted_names

if TYPE_CHECKING:
    from manip_sim.models.robots.robot_model import RobotModel


class OwnHand(HandFromFile, registered=False):
    """
    A hand within a robot: its elements are the robot's and have its prefix.

    It comes with the robot and cannot be mounted elsewhere.

    :param start: where the robot's joints start, by name [rad or m]
    """

    def __init__(self, arm: str, description: OwnHandDescription, where: str,
                 start: dict[str, float]) -> None:
        # Its file is the robot's, so there is nothing to load.
        self.idn = arm
        self._given_prefix = ''
        self._description = description
        self._where = where
        self._start = start
        self.inferred = []
        self._important_geoms = {**type(self)._important_geoms, **description.geoms_by_role}

    def add_to(self, spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand) -> None:
        """Add the grasp frame and sensors to the robot's spec."""
        self.inferred += fill_control_ranges(spec, tree.model, list(hand.actuators))
        self._add_grasp_frame(spec, tree, hand, f'{self.idn}_hand_')
        bodies = hands_of_hand(tree, hand)
        if bodies:
            self.inferred.append(
                f'the fingers on {quoted_names(bodies)} are one gripper; arms: {{{self.idn}: {{'
                f'hand: {bodies[0]}}}}} in a YAML file takes one of them, and the joints of the '
                "others become the part 'other'")
        self._body = tree.name(hand.body)
        self._joints = [str(tree.model.joint(joint).name) for joint in hand.joints
                        if int(tree.model.jnt_type[joint]) != 0]
        self._actuators = [str(tree.model.actuator(a).name) for a in hand.actuators]

    def bind(self, robot: RobotModel, model: mujoco.MjModel) -> None:
        """Record the elements of the hand."""
        self._robot = robot
        self.file = robot.file
        self._own_model, self._spec = model, robot._spec
        tree = BodyTree(model)
        bodies = tree.below(int(model.body(self._body).id))
        self._bodies = [tree.name(body) for body in sorted(bodies)]
        self._sensors = list(self._important_sensors.values())
        self._cameras = []
        self._record_shapes(model, bodies)
        self._check_declared()
        hand = FoundHand(int(model.body(self._body).id),
                         tuple(int(model.joint(name).id) for name in self._joints),
                         tuple(int(model.actuator(name).id) for name in self._actuators))
        # Joints of the other arm's hand may have gone with it.
        present = {model.joint(joint).name for joint in range(model.njnt)}
        start = {name: value for name, value in self._start.items() if name in present}
        self._set_closing(Fingers(tree, hand, start), list(hand.actuators))
        self.current_action = np.zeros(self.dof)

    @property
    def body(self) -> str:
        """Name in the file of the body that carries all of it."""
        return self._body

    @property
    def names_in_file(self) -> set[str]:
        """Names of its joints and actuators in the robot's file."""
        return {*self._joints, *self._actuators}

    def remove_from(self, spec: mujoco.MjSpec) -> None:
        """Delete the hand; a body that the arm moves remains, with nothing of the hand on it."""
        body = spec.body(self._body)
        joints, moves = set(self._joints), len(body.joints) > 0
        for child in list(body.bodies):
            carries = joints.intersection(joint.name for joint in child.find_all('joint'))
            if carries or child.name == self._eef_body or not moves:
                spec.delete(child)
        own = {*self._important_sites.values(), f'{self.idn}_hand_ft_frame'}
        delete_elements(spec, [site for site in body.sites if site.name in own or not moves])
        if not moves:
            delete_elements(spec, [*body.geoms, *body.cameras, *body.lights])
            body.explicitinertial = False
            body.mass, body.inertia, body.fullinertia = 0.0, [0.0] * 3, [np.nan] + [0.0] * 5

    def refresh(self) -> None:
        """Change nothing: the hand is updated when the robot is, whose spec it shares."""

    @property
    def spec(self) -> Any:
        """The robot's ``mujoco.MjSpec``."""
        return self._robot.spec

    @property
    def name(self) -> str:
        """Names of the robot and the arm, for messages."""
        return f"{self._robot.name}'s {self.idn} hand"

    @property
    def naming_prefix(self) -> str:
        """The prefix of the robot."""
        return self._robot.naming_prefix

    def set_naming_prefix(self, prefix: str) -> None:
        """Change nothing: the prefix is that of the robot."""

    def _root(self) -> Any:
        return self._robot._spec.body(self._body)

    @property
    def rotation_offset(self) -> FloatArray:
        """The rotation from the hand's body to its grasp frame, x, y, z, w, shape (4,)."""
        data = mujoco.MjData(self._own_model)
        mujoco.mj_kinematics(self._own_model, data)
        return wxyz_to_xyzw(relative_quat_wxyz(
            data.body(self._body).xquat, data.body(self._eef_body).xquat))

    def set_mount_pose(self, pos: ArrayLike | None = None,
                       quat_wxyz: ArrayLike | None = None) -> None:
        """Reject the pose: the robot's file says where its hand is."""
        raise ModelError(f'{self.name} is part of {self.file} and cannot be mounted elsewhere')

    def clone(self, idn: int | str) -> OwnHand:
        """Reject copying: there is one such hand."""
        raise ModelError(f'{self.name} is part of {self.file} and cannot be mounted elsewhere')

    def attach_to(self, spec: mujoco.MjSpec, frame: Any) -> None:
        """Change nothing: the hand comes with the robot."""

    def _attach_recorded(self, spec: mujoco.MjSpec, frame: Any) -> None:
        pass
