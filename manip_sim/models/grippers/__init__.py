# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Grippers and hands: actions, tactile sensors, and those of the catalogue.

The numbers of the catalogue are in ``assets/grippers``. Every module here is imported, which
registers its grippers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
import copy
from os import PathLike
from typing import Any, NamedTuple, TYPE_CHECKING, TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import NO_TURN, relative_quat_wxyz, wxyz_to_xyzw
from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.mjcf import CatalogueModel, FromYaml, MujocoXMLModel
from manip_sim.models.registry import import_submodules, Registry
from manip_sim.models.spec_edits import delete_elements
from manip_sim.validation import finite_numbers, unit_quaternion

_AXIS_SITE_OFFSET_M = 0.1

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: The standard sensors of every gripper.
_WRENCH_SENSORS = {'force_ee': mujoco.mjtSensor.mjSENS_FORCE,
                   'torque_ee': mujoco.mjtSensor.mjSENS_TORQUE}

#: Types of attributes that ``format_action`` may change in place.
_STATE = (np.ndarray, list, dict, set)

GripperT = TypeVar('GripperT', bound='GripperModel')


class ActionRule(NamedTuple):
    """
    The meaning of the actions of a gripper of the catalogue.

    Its commands are the numbers of an action, or change by a step with each call of
    ``format_action``; each actuator follows one of them, or stays.

    :ivar numbers: which number of an action each command follows, shape (m,)
    :ivar steps: change of each command in a call with an action of 1, shape (m,); empty where
        actions are commands
    :ivar proportional: whether the magnitude of actions counts, or the sign alone, shape (1,)
    :ivar sources: which command each actuator follows, -1 for one that stays, shape (nu,)
    :ivar still: command of each actuator that stays, shape (nu,)
    """

    numbers: IntArray
    steps: FloatArray
    proportional: BoolArray
    sources: IntArray
    still: FloatArray


class GripperModel(MujocoXMLModel, ABC):
    """
    A gripper or hand that is mounted on the end effector body of an arm.

    The file needs a body ``eef``, the grasp frame. Standard sites and sensors that it lacks are
    added: ``ft_frame`` with the sensors ``force_ee`` and ``torque_ee`` on the root body, and
    ``grip_site``, ``grip_site_cylinder``, ``ee``, ``ee_x``, ``ee_y`` and ``ee_z`` on ``eef``.
    Names that a subclass declares in ``_important_geoms``, ``_important_sites`` or
    ``_important_sensors`` must exist. A free joint of the root is left out.

    :param fname: path of an MJCF file with one root body
    :param idn: number or word in names, as in ``gripper0_right_finger``
    :ivar current_action: the state of :meth:`format_action`, at first zeros of shape (dof,)
    :raises UnknownNameError: if the file has no body ``eef`` or lacks a declared name
    :raises ModelError: if ``force_ee`` or ``torque_ee`` is another kind of sensor
    """

    _prefix_word = 'gripper'
    #: Change of the command in one call of :meth:`format_action`, of a range of 2.
    speed = 0.0

    _important_sites: Mapping[str, str] = {
        'grip_site': 'grip_site', 'grip_cylinder': 'grip_site_cylinder',
        'ee': 'ee', 'ee_x': 'ee_x', 'ee_y': 'ee_y', 'ee_z': 'ee_z'}
    _important_geoms: Mapping[str, list[str]] = {
        'left_finger': [], 'right_finger': [], 'left_fingerpad': [], 'right_fingerpad': []}
    _important_sensors: Mapping[str, str] = {'force_ee': 'force_ee', 'torque_ee': 'torque_ee'}
    #: Actuators that pull what a whole cup touches: of bodies, all of whose geoms are its lip.
    _cups: Sequence[str] = ()
    #: The body that is the grasp frame.
    _eef_body = 'eef'

    def __init__(self, fname: str | PathLike[str], idn: int | str = 0) -> None:
        super().__init__(fname, idn=idn)
        self._root()
        self.current_action = np.zeros(self.dof)

    def refresh(self) -> None:
        """
        Update the recorded lists, ranges and offsets after edits of :attr:`spec`.

        :attr:`current_action` becomes zeros if the number of actuators changes.
        """
        actuators = len(self._actuators)
        super().refresh()
        if len(self._actuators) != actuators:
            self.current_action = np.zeros(self.dof)

    def _prepare_spec(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        mount = self._root()
        # The arm carries the gripper; only a body of the world can be free.
        delete_elements(spec, [joint for joint in mount.joints if int(joint.type) == _FREE])
        eef = spec.body('eef')
        if eef is None:
            raise UnknownNameError(f'body of gripper {self.file}', 'eef',
                                   [body.name for body in spec.bodies[1:]])
        add_standard_elements(spec, mount, eef)

    def _check_declared(self) -> None:
        super()._check_declared()
        for name, kind in _WRENCH_SENSORS.items():
            raw = self._important_sensors.get(name, name)
            actual = int(self._own_model.sensor(raw).type[0])
            if actual != int(kind):
                raise ModelError(f"sensor '{raw}' of gripper {self.file} must be of the kind "
                                 f'{_kind(kind)}, not {_kind(mujoco.mjtSensor(actual))}')

    @property
    def important_sites(self) -> dict[str, str]:
        """Sites by role; roles that a class does not declare have the standard sites."""
        return self.correct_naming({**GripperModel._important_sites, **self._important_sites})

    @property
    def important_geoms(self) -> dict[str, list[str]]:
        """Lists of geoms by role; fingers and pads that a class does not declare have none."""
        return self.correct_naming({**GripperModel._important_geoms, **self._important_geoms})

    @property
    def important_sensors(self) -> dict[str, str]:
        """Sensors by role; roles that a class does not declare have the standard sensors."""
        return self.correct_naming({**GripperModel._important_sensors, **self._important_sensors})

    @property
    def cups(self) -> list[str]:
        """Actuators of suction cups, each of which pulls only while all of its lip touches."""
        return self.correct_naming(list(self._cups))

    @property
    def bottom_offset(self) -> FloatArray:
        """Zeros, shape (3,), a copy: a gripper does not stand on anything."""
        return np.zeros(3)

    @property
    def dof(self) -> int:
        """Length of the actions that :meth:`format_action` takes."""
        return len(self._actuators)

    @property
    @abstractmethod
    def init_qpos(self) -> ArrayLike | None:
        """Start positions in the order of :attr:`joints` [rad or m], or None for zero."""

    @abstractmethod
    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Map an abstract action to actuator commands; one call is one step of :attr:`speed`.

        :param action: +1 closes, -1 opens, shape (dof,)
        :returns: commands in [-1, 1], which are mapped to the control ranges, in the order of
            :attr:`actuators`, shape (nu,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """

    @property
    def action_rule(self) -> ActionRule | None:
        """The meaning of actions as numbers; None where only :meth:`format_action` knows it."""
        return None

    @property
    def rotation_offset(self) -> FloatArray:
        """
        The rotation from the mount to the body ``eef``, x, y, z, w with unit norm, shape (4,).

        It is that of the compiled model. robosuite multiplies the quaternions of the root body
        and ``eef`` in the wrong order and leaves out the bodies between them, so its values
        differ where these do not commute.
        """
        data = mujoco.MjData(self._own_model)
        mujoco.mj_kinematics(self._own_model, data)
        return wxyz_to_xyzw(relative_quat_wxyz(NO_TURN, data.body(self._eef_body).xquat))

    def set_mount_pose(self, pos: ArrayLike | None = None,
                       quat_wxyz: ArrayLike | None = None) -> None:
        """
        Set the pose of the root body in the frame of the body that it is mounted on.

        :param pos: position [m], shape (3,); None keeps it
        :param quat_wxyz: w, x, y, z, shape (4,); None keeps it
        :raises ModelError: if a number is not finite, or the quaternion is zero
        """
        if pos is None and quat_wxyz is None:
            return
        root = self._root()
        if pos is not None:
            root.pos = finite_numbers(pos, 3, f'position of {self.name}')
        if quat_wxyz is not None:
            root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            root.quat = unit_quaternion(quat_wxyz, f'quaternion of {self.name}')
        self.refresh()

    def add_tactile_sensors(self) -> list[str]:
        """
        Add a tactile sensor to each pad: a box or capsule that a touch sensor encloses.

        A box has its points on the face that looks at the grasp frame, row by row, a capsule all
        around it, some 4 mm apart. MuJoCo puts into each sensor, for all points, how deep each is
        inside of what touches the finger [m], then the speeds at which that slides [m/s].

        :returns: names of the sensors of all pads, also of those that had one; none without pads
        """
        data = mujoco.MjData(self._own_model)
        if self.init_qpos is not None:
            for joint, position in zip(self._joints, np.asarray(self.init_qpos, dtype=float)):
                data.joint(joint).qpos = position
        mujoco.mj_kinematics(self._own_model, data)
        names = add_tactile_sensors(self._spec, self._own_model, data, self._eef_body)
        self.refresh()
        return self.correct_naming(names)

    def clone(self: GripperT, idn: int | str) -> GripperT:
        """
        Return a copy with another idn and a spec of its own.

        :param idn: of the copy
        """
        twin = self.with_own_state()
        twin.idn = idn
        twin._spec = self._spec.copy()
        twin.current_action = np.zeros(self.dof)
        return twin

    def with_own_state(self: GripperT) -> GripperT:
        """
        Return a copy whose :meth:`format_action` does not change the state of this one.

        Arrays, lists, dictionaries and sets are copied, of subclasses too; all else is shared.
        """
        twin = copy.copy(self)
        vars(twin).update(self.state_copy())
        return twin

    def state_copy(self) -> dict[str, Any]:
        """Return all attributes, with copies of arrays, lists, dictionaries and sets."""
        return {name: copy.deepcopy(value) if isinstance(value, _STATE) else value
                for name, value in vars(self).items()}

    def start_at(self, command: ArrayLike) -> None:
        """
        Make :meth:`format_action` continue from an actuator command.

        :attr:`current_action` may have one number per actuator or per action; both and zeros are
        tried, and the state from which a zero action gives the nearest command is kept.

        :param command: commands in [-1, 1], one for each actuator
        """
        target = np.asarray(command, dtype=float)
        best, best_error = np.zeros(self.dof), np.inf
        for state in (target, target[:self.dof], np.zeros(self.dof)):
            self.current_action = state.copy()
            idle = np.asarray(self.format_action(np.zeros(self.dof)), dtype=float)
            if idle.shape != target.shape:
                continue
            error = float(np.abs(idle - target).max(initial=0.0))
            if error < best_error:
                best, best_error = state, error
            if not error:
                break
        self.current_action = best.copy()

    def _checked(self, action: ArrayLike) -> FloatArray:
        """Return an action as an array, or raise :class:`CommandError`."""
        return finite_numbers(action, self.dof, f'an action of {type(self).__name__}',
                              CommandError)

    def _integrate(self, step: FloatArray) -> FloatArray:
        """Move :attr:`current_action` by a step, within [-1, 1], and return a copy."""
        self.current_action = np.clip(self.current_action + step, -1.0, 1.0)
        return self.current_action.copy()


GRIPPERS: Registry[GripperModel] = Registry(
    'gripper', GripperModel)  # type: ignore[type-abstract]
GripperModel.registry = GRIPPERS


def add_standard_elements(spec: mujoco.MjSpec, mount: mujoco.MjsBody, eef: mujoco.MjsBody,
                          prefix: str = '') -> None:
    """
    Add the standard sites and sensors that a hand lacks.

    :param mount: its root body, which gets the force/torque sensor
    """
    present = {site.name for site in spec.sites}
    reach = _AXIS_SITE_OFFSET_M
    for name, pos in (('grip_site', (0, 0, 0)), ('grip_site_cylinder', (0, 0, 0)),
                      ('ee', (0, 0, 0)), ('ee_x', (reach, 0, 0)), ('ee_y', (0, reach, 0)),
                      ('ee_z', (0, 0, reach))):
        if prefix + name not in present:
            _add_site(eef, prefix + name, pos)
    ft_frame = f'{prefix}ft_frame'
    if ft_frame not in present:
        _add_site(mount, ft_frame, (0, 0, 0))
    sensors = {sensor.name for sensor in spec.sensors}
    for name, kind in _WRENCH_SENSORS.items():
        if prefix + name not in sensors:
            spec.add_sensor(name=prefix + name, type=kind, objname=ft_frame,
                            objtype=mujoco.mjtObj.mjOBJ_SITE)


def _kind(sensor: mujoco.mjtSensor) -> str:
    return str(sensor.name).removeprefix('mjSENS_').lower()


def _add_site(body: mujoco.MjsBody, name: str, pos: ArrayLike) -> None:
    body.add_site(name=name, pos=np.asarray(pos, dtype=float), group=4, size=[0.005] * 3)


#: Distance between neighbouring points, about [m].
_PITCH_M = 0.004
#: Points around a finger.
_AROUND = 8
#: No viewer shows shapes of this group by default.
_GROUP = 5
#: A touch sensor encloses its pad: they have the same centre but for this [m].
_SAME_PLACE_M = 2e-4
_BOX, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_TOUCH, _TACTILE = '_touch', '_tactile'


def add_tactile_sensors(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData, eef: str
                        ) -> list[str]:
    """
    Add a tactile sensor to each pad that a touch sensor encloses.

    A pad that is a box has a grid of points, row by row, on the face through which the way from
    its centre to the grasp frame leaves it; a finger that is a capsule has rings of points. The
    sensor is named like the touch sensor, with ``_tactile`` at its end, and so are the shape and
    the mesh of its points.

    :returns: names of the sensors of all pads, also of those that were there
    """
    present, names = {sensor.name for sensor in spec.sensors}, []
    for name, pad in _pads(model):
        names.append(name)
        if name in present:
            continue
        size, rotation = model.geom_size[pad], data.geom_xmat[pad].reshape(3, 3)
        if model.geom_type[pad] == _BOX:
            inward = rotation.T @ (data.body(eef).xpos - data.geom_xpos[pad])
            grid = _face(size, inward)
        else:
            grid = _rings(float(size[0]), float(size[1]))
        body = spec.body(model.body(model.geom_bodyid[pad]).name)
        _add(spec, body, name, *grid, model.geom_pos[pad], model.geom_quat[pad])
    return names


def _pads(model: mujoco.MjModel) -> Iterator[tuple[str, int]]:
    """Yield the name of a tactile sensor and the id of the geom for each pad."""
    for sensor in np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH):
        name, site = model.sensor(sensor).name, model.sensor_objid[sensor]
        if not name.endswith(_TOUCH):
            continue
        for geom in range(model.ngeom):
            if (model.geom_bodyid[geom] == model.site_bodyid[site]
                    and model.geom_type[geom] == model.site_type[site] in (_BOX, _CAPSULE)
                    and model.geom_contype[geom] | model.geom_conaffinity[geom]
                    and np.allclose(model.geom_pos[geom], model.site_pos[site],
                                    atol=_SAME_PLACE_M)):
                yield name.removesuffix(_TOUCH) + _TACTILE, geom


#: Points in rows in the frame of a pad [m], shape (rows, columns, 3), the normal and two tangents
#: of each, shape (rows, columns, 3, 3), and whether the last column is beside the first.
_Grid = tuple[FloatArray, FloatArray, bool]


def _centres(half: float) -> FloatArray:
    """Return the centres of equal cells of about the pitch, in (-half, half)."""
    count = max(2, round(2.0 * half / _PITCH_M))
    return half * ((2.0 * np.arange(count) + 1.0) / count - 1.0)


def _face(size: FloatArray, inward: FloatArray) -> _Grid:
    """Return points on the face of a box through which a way from its centre leaves it."""
    normal = int(np.abs(inward / size).argmax())
    first, second = (axis for axis in range(3) if axis != normal)
    across, along = np.meshgrid(_centres(size[first]), _centres(size[second]), indexing='ij')
    points = np.empty((*across.shape, 3))
    points[..., first], points[..., second] = across, along
    points[..., normal] = np.copysign(size[normal], inward[normal])
    frame = np.eye(3)[[normal, first, second]]
    frame[0] *= np.sign(inward[normal])
    return points, np.broadcast_to(frame, (*across.shape, 3, 3)), False


def _rings(radius: float, half: float) -> _Grid:
    """Return points around a capsule, on its straight part."""
    along, angle = np.meshgrid(_centres(half), 2.0 * np.pi / _AROUND * np.arange(_AROUND),
                               indexing='ij')
    zero = np.zeros_like(along)
    normal = np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
    around = np.stack([-np.sin(angle), np.cos(angle), zero], axis=-1)
    upward = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
    return (radius * normal + along[..., None] * upward,
            np.stack([normal, upward, around], axis=-2), True)


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, points: FloatArray,
         frames: FloatArray, closed: bool, pos: FloatArray, quat_wxyz: FloatArray) -> None:
    """Add a sensor, with the mesh and the shape that MuJoCo takes its points from."""
    rows, columns = points.shape[:2]
    ids = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        ids = np.column_stack([ids, ids[:, 0]])
    near, far = ids[:-1], ids[1:]
    triangles = np.stack([
        near[:, :-1], far[:, :-1], near[:, 1:], far[:, 1:], near[:, 1:], far[:, :-1]], axis=-1)
    spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
                  uservert=points.ravel(), usernormal=frames.ravel(), userface=triangles.ravel())
    # MuJoCo moves the points of a mesh to its centre; a shape of that mesh puts them back.
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=pos,
                  quat=quat_wxyz, contype=0, conaffinity=0, group=_GROUP, mass=0.0)
    spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TACTILE,
                    objtype=mujoco.mjtObj.mjOBJ_MESH, objname=name,
                    reftype=mujoco.mjtObj.mjOBJ_GEOM, refname=name)


class _Speed:
    def __get__(self, gripper: object, owner: Any) -> float:
        return float(owner._action.get('speed', 0.0))


class CatalogueGripper(CatalogueModel, GripperModel, registered=False):
    """
    A gripper from ``assets/grippers``; ``part.yaml`` says what its actions mean.

    Keys of an action: ``numbers``, its length, by default one for each actuator; ``speed``, the
    change of the command in one call; ``closing``, the direction of the change by command;
    ``proportional``, whether the magnitude counts or the sign alone; ``steps``, whether actions
    are changes or commands; ``actuators``, how many follow each command; ``still``, commands of
    the last actuators, which stay.

    :param idn: number or word in the prefix ``gripper{idn}_``
    """

    _kind = 'grippers'
    _important_geoms = FromYaml('fingers', {})
    _start = FromYaml('start', {})
    _cups = FromYaml('cups', ())
    _action: Any = FromYaml('action', {'steps': False})
    _each_action = FromYaml('each_action', {})
    speed = _Speed()

    def __init__(self, idn: int | str = 0) -> None:
        self._important_geoms = {**GripperModel._important_geoms, **self._important_geoms}
        super().__init__(idn=idn)

    @property
    def dof(self) -> int:
        """Length of the actions that :meth:`format_action` takes."""
        return int(self._action.get('numbers', super().dof))

    @property
    def init_qpos(self) -> FloatArray | None:
        """Start of the joints in the order of the file [rad or m], shape (n,), a copy, or None."""
        if not self._joints:
            return None
        return np.array([self._start.get(joint, 0.0) for joint in self._joints])

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Map an action to actuator commands; where it moves by steps, one call is one step.

        :param action: closes above 0, opens below; shape (dof,)
        :returns: commands in [-1, 1], in the order of :attr:`actuators`, shape (nu,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        rule = self._rule
        commands = self._checked(action)[rule.numbers]
        if rule.steps.size:
            commands = self._integrate(rule.steps * (
                commands if rule.proportional[0] else np.sign(commands)))
        return np.where(rule.sources < 0, rule.still, np.append(commands, 0.0)[rule.sources])

    def start_at(self, command: ArrayLike) -> None:
        """
        Make :meth:`format_action` continue from an actuator command, where it moves by steps.

        :param command: commands in [-1, 1], one for each actuator; of several that follow the
            same number, the first counts
        """
        rule = self._rule
        if rule.steps.size:
            self.current_action = np.zeros(len(rule.steps))
            follows = np.flatnonzero(rule.sources >= 0)[::-1]
            self.current_action[rule.sources[follows]] = np.asarray(command)[follows]

    @property
    def action_rule(self) -> ActionRule | None:
        """The meaning of actions, unless a subclass or an attribute has given them another."""
        changed = any(name in vars(self) or getattr(type(self), name) is not getattr(
            CatalogueGripper, name) for name in ('format_action', 'start_at'))
        return None if changed else self._rule

    @property
    def _rule(self) -> ActionRule:
        law = self._action
        moves = law.get('steps', True)
        closing = np.array(law.get('closing', [1.0]), dtype=float)
        count = max(self.dof, len(closing)) if moves and self.dof else self.dof
        sources = np.repeat(np.arange(count), law.get('actuators', [1]))
        still = np.array(law.get('still', []), dtype=float)
        return ActionRule(
            np.arange(count) % max(self.dof, 1),
            np.broadcast_to(closing, count) * self.speed if moves else np.zeros(0),
            np.array([bool(law.get('proportional'))]),
            np.append(sources, np.full(len(still), -1)),
            np.append(np.zeros(len(sources)), still))


class FourierLeftHand(CatalogueGripper, folder='fourier_left_hand'):
    """Left hand of the GR-1, with eleven joints and six motors."""


class FourierRightHand(CatalogueGripper, folder='fourier_right_hand'):
    """Right hand of the GR-1, the mirror image of the left one."""


class JacoThreeFingerGripper(CatalogueGripper, folder='jaco_three_finger_gripper'):
    """Kinova hand that opens and closes."""


class JacoThreeFingerDexterousGripper(JacoThreeFingerGripper):
    """Kinova hand that opens and closes each finger."""

    _action = FromYaml('each_action', {})


class NullGripper(CatalogueGripper, folder='null_gripper'):
    """A grasp frame and a force-torque sensor, without mass and without shape."""


class PalGripper(CatalogueGripper, folder='pal_gripper'):
    """Two fingers of PAL Robotics, each with a motor of its own, 90 mm stroke."""


class PandaGripper(CatalogueGripper, folder='panda_gripper'):
    """Franka hand that opens and closes."""


class RethinkGripper(CatalogueGripper, folder='rethink_gripper'):
    """Rethink gripper that opens and closes."""


class Robotiq140Gripper(CatalogueGripper, folder='robotiq_140_gripper'):
    """Robotiq 2F-140 that opens and closes."""


class Robotiq85Gripper(CatalogueGripper, folder='robotiq_85_gripper'):
    """Robotiq 2F-85 that opens and closes."""


class RobotiqThreeFingerGripper(CatalogueGripper, folder='robotiq_three_finger_gripper'):
    """Robotiq gripper that opens and closes all fingers, fingers 1 and 2 side by side."""


class RobotiqThreeFingerDexterousGripper(RobotiqThreeFingerGripper):
    """Robotiq gripper whose three fingers and scissor move by steps, one by one."""

    _action = FromYaml('each_action', {})


class SO101Gripper(CatalogueGripper, folder='so101_gripper'):
    """Jaw of the SO-101 that closes on a fixed one."""


class VacuumGripper(CatalogueGripper, folder='vacuum_gripper'):
    """One suction cup of 40 mm on an OnRobot VGC10, which holds what its whole lip touches."""


class WipingGripper(CatalogueGripper, folder='wiping_gripper'):
    """Eraser with a touch sensor at each corner of its wiping surface."""


import_submodules(__name__, __path__)


def gripper_names() -> list[str]:
    """Return the names that :func:`create_gripper` takes, also those in the user's folders."""
    return GRIPPERS.all_names()


def create_gripper(name: str | PathLike[str], idn: int | str = 0) -> GripperModel:
    """
    Create a gripper by its name, that of its class or of an entry point, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.registry.find_source`` takes
    :param idn: number or word in the prefix
    :raises UnknownNameError: if the gripper is unknown, naming the nearest ones
    :raises ModelError: if a file cannot be used, or the gripper of another package cannot be
        imported
    """
    return GRIPPERS.create_or_load(name, idn=idn)


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[GripperModel]:
        return GRIPPERS.attribute(__name__, name)


__all__ = [
    'ActionRule', 'FourierLeftHand', 'FourierRightHand', 'GripperModel',
    'JacoThreeFingerDexterousGripper', 'JacoThreeFingerGripper', 'NullGripper', 'PalGripper',
    'PandaGripper', 'RethinkGripper',
    'Robotiq140Gripper', 'Robotiq85Gripper', 'RobotiqThreeFingerDexterousGripper',
    'RobotiqThreeFingerGripper', 'SO101Gripper', 'VacuumGripper', 'WipingGripper',
    'create_gripper', 'gripper_names']
