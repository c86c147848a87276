# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Hands from files: of their own, on a mount, or that a robot's file brings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import itertools
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product, relative_quat_wxyz, wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.fingers import (
    Closings, control_range, digest_of, Fingers, integrates, once, UNLIMITED)
from manip_sim.models.files.found_hands import FoundHand, hands_of_hand
from manip_sim.models.files.model_file import read_model
from manip_sim.models.files.part_descriptions import (
    FrameDescription, GripperDescription, HandDescription, OwnHandDescription)
from manip_sim.models.grippers import add_standard_elements, GripperModel
from manip_sim.models.loading import compile_copy
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.models.spec_edits import (
    add_body_at, delete_elements, find_place, free_name, quat_wxyz_of)
from manip_sim.models.user_files import stem_of
from manip_sim.quoting import quoted_names

#: Fingers that reach less far give no direction [m].
_SHORT_M = 0.02
#: A palm may reach this far behind its mount, around the flange of the arm [m].
_BEHIND_MOUNT_M = 0.05
_KEYFRAMES = ('home', 'open', 'rest')


class HandFromFile(GripperModel, registered=False):
    """
    A hand that a file and a description declare.

    An action says how far each actuator closes: -1 is open, +1 is closed.

    :ivar inferred: the inferences and omissions, in sentences
    :ivar grasp_point: the grasp frame
    :ivar closing: control that opens and control that closes, by actuator of the file
    """

    grasp_point: FrameDescription
    closing: dict[str, list[float]]

    inferred: list[str]
    #: True if the grasp frame was added.
    _has_grasp_frame = False
    #: Source of the description, for messages.
    _source: str
    _description: HandDescription
    _start: Mapping[str, float]
    #: Control that opens and that closes, by actuator that the description does not name.
    _found_closings: Mapping[str, tuple[float, float]]
    #: Commands in [-1, 1] that open and close.
    _open: FloatArray
    _closed: FloatArray

    def _add_grasp_frame(self, spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand, prefix: str,
                         middle: Callable[[], FloatArray] | None = None) -> None:
        """
        Add the grasp frame, declared or between the fingers, with standard sites and sensors.

        :param tree: may lack meshes
        :param prefix: what the names of all these begin with
        :param middle: returns the middle of the fingertips; None: by the shapes of the tree
        """
        fingers = Fingers(tree, hand, self._start)
        point, mount = self._description.grasp_point, tree.name(hand.body)
        at = (point.at if point else None) or (None if point else fingers.grasp_frame()) or mount
        place = find_place(spec, at, f"'grasp_point' of {self._source}")
        position = point.position if point else np.zeros(3)
        orientation: ArrayLike = point.orientation if point else np.zeros(3)
        if point is None and at == mount:
            position = (middle or fingers.grasp_point)()
            orientation = [1.0, 0.0, 0.0, 0.0]
            if not tree.parent(hand.body):  # As the mount is, in whose frame the root is.
                orientation = relative_quat_wxyz(tree.model.body_quat[hand.body], orientation)
        if point is None:
            rounded = ' '.join(f'{number:.3f}' for number in np.round(position, 3) + 0.0)
            origin = f"the middle of the fingertips, {rounded} m in '{mount}'"
            self.inferred.append(
                'grasp frame: ' + (origin if at == mount else f"{place[0]} '{at}'"))
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

    def _try_closing(self, names: list[str], closing: Callable[[list[str]], Closings]) -> None:
        """Find which way the actuators close that the description does not name."""
        declared = self._description.closing
        for name in declared:
            if name not in names:
                raise UnknownNameError(f"actuator in 'closing' of {self._source}", name, names)
        closings, changed = closing([name for name in names if name not in declared])
        closings.update(changed)
        self._found_closings = {name: ends[:2] for name, ends in closings.items()}
        notes = [f'{name} from {opened + 0.0:g} to {closed + 0.0:g}'
                 f'{"" if is_clear else " (a guess)"}'
                 for name, (opened, closed, is_clear) in closings.items()]
        if notes:
            self.inferred.append(f'closing: {", ".join(notes)}')
        if changed:
            self.inferred.append(
                f'closing of {quoted_names(list(changed))}: other than '
                "the ends of its range, from which it does not open again; 'closing' in a YAML "
                'file changes it')

    def _set_closing(self, ids: list[int], out_of_touch: list[str]) -> None:
        """
        Set which way the actuators close, by the description or as was found.

        :param ids: of :attr:`actuators`, in the model that the part is compiled in
        :param out_of_touch: names of the fingers' bodies if none can touch an object
        """
        ends = []
        self.closing = {}
        for name, actuator in zip(self._actuators, ids):
            opened, closed = self._description.closing.get(name) or self._found_closings.get(
                name, UNLIMITED)
            low, high = control_range(self._own_model, actuator) or (opened, closed)
            if name in self._found_closings:  # The range may have been edited since.
                opened, closed = min(max(opened, low), high), min(max(closed, low), high)
            if not all(low <= end <= high for end in (opened, closed)):
                raise ModelError(f"'closing' of actuator '{name}' in {self._source} must be "
                                 f'within its control range of {low:g} to {high:g}, got '
                                 f'[{opened:g}, {closed:g}]')
            self.closing[name] = [float(opened), float(closed)]
            span = (high - low) or 1.0
            ends.append(2.0 * (np.array([opened, closed]) - low) / span - 1.0)
        self._open, self._closed = np.array(ends).reshape(-1, 2).T
        if out_of_touch:
            self.inferred.append(
                f'no shape of the fingers ({", ".join(out_of_touch)}) can touch an object: give '
                f'them collision shapes, with contype and conaffinity 1, in {self.file}')

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


def _fill_control_ranges(spec: mujoco.MjSpec, model: mujoco.MjModel, actuators: list[int]
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
            limits = UNLIMITED
            notes.append(f"actuator '{element.name}' has no limits: actions are its control")
        element.inheritrange = 0.0
        if integrates(model, actuator):
            element.actrange = limits
            continue
        element.ctrlrange, element.ctrllimited = limits, int(mujoco.mjtLimited.mjLIMITED_TRUE)
    return notes


class BuiltInGripper(HandFromFile, registered=False):
    """
    A hand within a robot: its elements are the robot's and have its prefix.

    It comes with the robot and cannot be mounted elsewhere.

    :param start: where the robot's joints start, by name [rad or m]
    :ivar body: name in the file of the body that carries all of it
    """

    def __init__(self, arm: str, description: OwnHandDescription, source: str,
                 start: dict[str, float]) -> None:
        # Its file is the robot's, so there is nothing to load.
        self.idn = arm
        self._given_prefix = ''
        self._description = description
        self._source = source
        self._start = start
        self.inferred = []
        self._important_geoms = {**type(self)._important_geoms, **description.geoms_by_role}

    def add_to(self, spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand, key: bytes,
               with_shapes: Callable[[], BodyTree]) -> None:
        """
        Add the grasp frame and sensors to the robot's spec.

        :param tree: the robot without meshes
        :param key: digest of the robot with its meshes
        :param with_shapes: returns the same tree with the meshes of the hands
        """
        self.inferred += _fill_control_ranges(spec, tree.model, list(hand.actuators))
        key += repr((hand, sorted(self._start.items()))).encode()

        def fingers() -> Fingers:
            whole = with_shapes()
            return Fingers(whole, hand.in_tree(tree, whole), self._start)

        self._add_grasp_frame(spec, tree, hand, f'{self.idn}_hand_', lambda: once(
            key, lambda: fingers().grasp_point()))
        bodies = hands_of_hand(tree, hand)
        if bodies:
            self.inferred.append(
                f'the fingers on {quoted_names(bodies)} are one gripper; arms: {{{self.idn}: {{'
                f'hand: {bodies[0]}}}}} in a YAML file takes one of them, and the joints of the '
                "others become the part 'other'")
        self.body = tree.name(hand.body)
        self._joints = [tree.joint_name(joint) for joint in hand.joints
                        if int(tree.model.jnt_type[joint]) != 0]
        self._actuators = [str(tree.model.actuator(a).name) for a in hand.actuators]
        self._try_closing(self._actuators, lambda names: once(
            key + repr(names).encode(), lambda: fingers().closing(names)))

    def bind(self, robot: RobotModel, model: mujoco.MjModel) -> None:
        """
        Record the elements of the hand.

        :param model: the robot, which may lack meshes
        """
        self._robot = robot
        self.file = robot.file
        self._own_model, self._spec = model, robot._spec
        tree = BodyTree(model)
        bodies = tree.below(int(model.body(self.body).id))
        self._bodies = [tree.name(body) for body in sorted(bodies)]
        self._sensors = list(self._important_sensors.values())
        self._cameras = []
        self._record_shapes(model, bodies)
        self._check_declared()
        hand = FoundHand(int(model.body(self.body).id),
                         tuple(int(model.joint(name).id) for name in self._joints),
                         tuple(int(model.actuator(name).id) for name in self._actuators))
        # Joints of the other arm's hand may have gone with it.
        self._set_closing(list(hand.actuators), Fingers(tree, hand, self._start).out_of_touch)
        self.current_action = np.zeros(self.dof)

    @property
    def names_in_file(self) -> set[str]:
        """Names of its joints and actuators in the robot's file."""
        return {*self._joints, *self._actuators}

    def remove_from(self, spec: mujoco.MjSpec) -> None:
        """Delete the hand; a body that the arm moves remains, with nothing of the hand on it."""
        body = spec.body(self.body)
        joints, moves = set(self._joints), len(body.joints) > 0
        for child in list(body.bodies):
            carries = joints.intersection(joint.name for joint in child.find_all('joint'))
            if carries or child.name == self._eef_body or not moves:
                spec.delete(child)
        names = {*self._important_sites.values(), f'{self.idn}_hand_ft_frame'}
        delete_elements(spec, [site for site in body.sites if site.name in names or not moves])
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
        return self._robot._spec.body(self.body)

    @property
    def rotation_offset(self) -> FloatArray:
        """The rotation from the hand's body to its grasp frame, x, y, z, w, shape (4,)."""
        data = mujoco.MjData(self._own_model)
        mujoco.mj_kinematics(self._own_model, data)
        return wxyz_to_xyzw(relative_quat_wxyz(
            data.body(self.body).xquat, data.body(self._eef_body).xquat))

    def set_mount_pose(self, pos: ArrayLike | None = None,
                       quat_wxyz: ArrayLike | None = None) -> None:
        """Reject the pose: the robot's file says where its hand is."""
        raise ModelError(f'{self.name} is part of {self.file} and cannot be mounted elsewhere')

    def clone(self, idn: int | str) -> BuiltInGripper:
        """Reject copying: there is one such hand."""
        raise ModelError(f'{self.name} is part of {self.file} and cannot be mounted elsewhere')

    def attach_to(self, spec: mujoco.MjSpec, frame: Any) -> None:
        """Change nothing: the hand comes with the robot."""

    def _attach_recorded(self, spec: mujoco.MjSpec, frame: Any) -> None:
        pass


def _place_root(spec: mujoco.MjSpec, position: ArrayLike, quat_wxyz: FloatArray) -> None:
    """Set the pose of the root body of a hand in the body that it is mounted on."""
    root = spec.worldbody.bodies[0]
    root.pos, root.quat = np.asarray(position, dtype=float), quat_wxyz
    root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _stand_on_mount(spec: mujoco.MjSpec, tree: BodyTree, hand: FoundHand,
                    start: Mapping[str, float]) -> list[str]:
    """
    Turn and move a hand whose root pose in the file is not that on an arm.

    Fingers that point more than 45 degrees away from the mount's z axis are turned to it by
    quarter turns, and a palm that reaches farther than 50 mm behind the mount is moved in front.

    :returns: the changes, in sentences
    """
    model, notes = tree.model, []
    reach = Fingers(tree, hand, start).grasp_point()
    size = length(reach)
    if size < _SHORT_M:
        return []
    position, quat = model.body_pos[1].copy(), model.body_quat[1].copy()
    if _rotated(quat, reach)[2] < size * np.sqrt(0.5):
        quat, position = _quarter_turn(reach), np.zeros(3)
        notes.append('mount: turned so that the fingers point along z')
    behind = -_lowest(tree, hand, quat) - position[2]
    if behind > _BEHIND_MOUNT_M:
        position[2] += behind
        notes.append(f'mount: {behind:.3f} m along z, so that the palm is in front of it')
    if notes:
        _place_root(spec, position, quat)
    return notes


def _quarter_turn(reach: FloatArray) -> FloatArray:
    """Return the rotation w, x, y, z that turns the axis nearest to a direction to z."""
    axis = np.zeros(3)
    nearest = int(np.abs(reach).argmax())
    axis[nearest] = np.sign(reach[nearest])
    quat = np.empty(4)
    if axis[2] < 0.0:
        return np.array([0.0, 1.0, 0.0, 0.0])
    mujoco.mju_quatZ2Vec(quat, axis)
    mujoco.mju_negQuat(quat, quat.copy())
    return quat


def _rotated(quat: FloatArray, vector: FloatArray) -> FloatArray:
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.asarray(vector, dtype=float), quat)
    return turned


def _lowest(tree: BodyTree, hand: FoundHand, quat: FloatArray) -> float:
    """Return the lowest height of fixed shapes above the root, at most 0 [m]."""
    model = tree.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moved: set[int] = set().union(
        *(tree.below(int(model.jnt_bodyid[joint])) for joint in hand.joints))
    still = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) not in moved
             and (model.geom_contype[g] or model.geom_conaffinity[g])]
    back = np.empty(4)
    mujoco.mju_negQuat(back, model.body_quat[1])
    lowest = 0.0
    for geom in still:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            corner = (product(data.geom_xmat[geom].reshape(3, 3), centre + half * np.array(signs))
                      + data.geom_xpos[geom] - model.body_pos[1])
            lowest = min(lowest, float(_rotated(quat, _rotated(back, corner))[2]))
    return lowest


class FileGripper(HandFromFile, registered=False):
    """
    A hand or gripper.

    :param file: MJCF or URDF
    :param description: what the YAML file says
    :param source: the file that the description was read from, for messages
    :param idn: number or word in names
    :raises ModelError: if the file or what the description says of it cannot be used
    """

    _refers_to_all = True  # As it was read with ``read_model``.

    def __init__(self, file: Path, description: GripperDescription, source: str,
                 idn: int | str = 0) -> None:
        self._description: GripperDescription = description
        self._source = source
        self._important_geoms = {**type(self)._important_geoms, **description.geoms_by_role}
        super().__init__(file, idn=idn)
        tree, hand = _whole(self._own_model)
        fingers = Fingers(tree, hand, self._start)
        key = digest_of(self._own_model) + repr(sorted(self._start.items())).encode()
        self._try_closing(self._actuators, lambda names: once(
            key + repr(names).encode(), lambda: fingers.closing(names)))
        self._set_closing(list(hand.actuators), fingers.out_of_touch)

    @property
    def name(self) -> str:
        """Name of the file and idn, such as ``right_hand0``."""
        return f'{stem_of(self.file)}{self.idn}'

    def _read(self) -> Any:
        declared = self._description
        model_file = read_model(self.file, declared, self._source, _KEYFRAMES)
        self.inferred = model_file.inferred
        if model_file.mocap is not None:
            self.inferred += model_file.mocap.left_out()
        self._keyframes = model_file.keyframes
        self._start = model_file.start
        spec = model_file.spec
        free = [joint for joint in spec.worldbody.bodies[0].joints
                if int(joint.type) == int(mujoco.mjtJoint.mjJNT_FREE)]
        if free:  # Its pose in the air goes with it.
            delete_elements(spec, free)
            _place_root(spec, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
            self.inferred.append(
                'left out, as the arm carries the hand: the free joint of its root')
        if declared.mount is not None:
            _place_root(spec, declared.mount.position, quat_wxyz_of(declared.mount.orientation))
        elif spec.body('eef') is None:
            self.inferred += _stand_on_mount(spec, *_whole(compile_copy(spec, str(self.file))),
                                             self._start)
        model = compile_copy(spec, str(self.file))
        tree, hand = _whole(model)
        self.inferred += _fill_control_ranges(spec, model, list(hand.actuators))
        if declared.grasp_point is not None or spec.body('eef') is None:
            taken = {site.name for site in spec.sites}
            prefix = 'grasp_' if taken & set(self._important_sites.values()) else ''
            self._add_grasp_frame(spec, tree, hand, prefix)
        return spec

    def _prepare_spec(self, spec: mujoco.MjSpec) -> None:
        if not self._has_grasp_frame:
            super()._prepare_spec(spec)


def _whole(model: mujoco.MjModel) -> tuple[BodyTree, FoundHand]:
    """Return a model as a tree and as a hand of all below its root body."""
    tree = BodyTree(model)
    return tree, FoundHand(1, tuple(range(model.njnt)), tuple(range(model.nu)))
