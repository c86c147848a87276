# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Frames that Cartesian commands may refer to, and all frames of a world with their poses.

The latter are the links of the tree that URDF and SRDF are written from: one for each body, with
the body's name; one for each requested site; two for each camera, MuJoCo's and the optical one;
one for each joint between a body and its parent that needs one; and those that the caller places
in the root, ``world``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from manip_sim.algebra import relative_quat_wxyz, wxyz_to_xyzw
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import CommandError, describe_choices
from manip_sim.frame_names import FrameNames, ROOT
from manip_sim.models.actuators import SCALAR
from manip_sim.models.urdf_writer.links import build_tree, Joint, joints_of_body, KinematicTree
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import quoted

WORLD = 'world'
#: From MuJoCo's camera, which looks along -z with y up, to REP 103's optical frame, which looks
#: along z with y down: half a turn about x, as w, x, y, z.
_TO_OPTICAL = np.array([0.0, 1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Frame:
    """
    A body, or a site on it.

    :ivar name: in the model
    :ivar body: id of the body
    :ivar site: id of the site, or None
    """

    name: str
    body: int
    site: int | None = None

    @property
    def number(self) -> tuple[int, int]:
        """The id of the site or the body, and 1 if it is a site."""
        return (self.body, 0) if self.site is None else (self.site, 1)

    def rebind(self, model: mujoco.MjModel) -> None:
        """Take over the ids in another model, in which the frame is the same."""
        if self.site is None:
            body = int(model.body(self.name).id)
        else:
            site = int(model.site(self.name).id)
            object.__setattr__(self, 'site', site)
            body = int(model.site_bodyid[site])
        object.__setattr__(self, 'body', body)

    def pose(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """
        Return position [m], shape (3,), and rotation matrix, shape (3, 3), in the world, copies.

        :param data: the ``mujoco.MjData`` after ``mj_kinematics``
        """
        position, rotation = self.view(data)
        return position.copy(), rotation.copy()

    def view(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """
        Return the same as views, which change when the frame moves.

        :param data: the ``mujoco.MjData`` after ``mj_kinematics``
        """
        if self.site is not None:
            return data.site_xpos[self.site], data.site_xmat[self.site].reshape(3, 3)
        return data.xpos[self.body], data.xmat[self.body].reshape(3, 3)

    def jacobian(self, model: mujoco.MjModel, data: mujoco.MjData, dofs: slice | IntArray
                 ) -> FloatArray:
        """
        Return the Jacobian of its position and rotation in the world, shape (6, n).

        :param data: the ``mujoco.MjData`` after ``mj_kinematics`` and ``mj_comPos``
        :param dofs: addresses of the joints in ``qvel``, shape (n,)
        """
        jacobian = np.empty((6, model.nv))
        if self.site is None:
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], self.body)
        else:
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], self.site)
        return np.ascontiguousarray(jacobian[:, dofs])


class RobotFrames:
    """
    The frames of a robot by the names that they have in TF.

    :param model: the compiled ``mujoco.MjModel``
    :param bodies: names of its links
    :param sites: names of frames on links, such as ``gripper0_right_grip_site``
    """

    def __init__(self, model: mujoco.MjModel, bodies: Iterable[str], sites: Iterable[str]) -> None:
        self._frames, names = {WORLD: Frame(WORLD, 0)}, FrameNames(model)
        for name in bodies:
            body = int(model.body(name).id)
            self._frames[names.bodies[body]] = Frame(name, body)
        for name in sites:
            site = int(model.site(name).id)
            self._frames[names.sites[site]] = Frame(name, int(model.site_bodyid[site]), site)

    def rebind(self, model: mujoco.MjModel) -> None:
        """Take over the ids of all frames in another model."""
        for frame in self._frames.values():
            frame.rebind(model)

    def find(self, name: str, needed_by: str) -> Frame:
        """
        Return a frame.

        :param name: of the frame; empty for ``world``
        :param needed_by: what needs it, for the message
        :raises CommandError: naming the nearest frames if there is none of this name
        """
        frame = self._frames.get(name or WORLD)
        if frame is None:
            raise CommandError(f'{needed_by}: unknown frame {quoted(name)}: '
                               f'{describe_choices(name, self._frames)}')
        return frame


@dataclass(frozen=True)
class Odometry:
    """
    The pose and the twist of a base at one instant.

    :ivar position: in the frame of the odometry [m], shape (3,)
    :ivar quat_xyzw: orientation in that frame, shape (4,)
    :ivar linear: velocity in the base's own axes [m/s], shape (3,)
    :ivar angular: velocity in the base's own axes [rad/s], shape (3,)
    """

    position: FloatArray
    quat_xyzw: FloatArray
    linear: FloatArray
    angular: FloatArray


class OdometryReader:
    """
    A reader of a mobile base's odometry; the odometry frame is fixed in ``world``.

    It coincides with the frame of the base when the joints of the base are at zero.

    :param model: the compiled ``mujoco.MjModel``
    :param joints: that move the base, such as ``SimulatedRobot.twist_joints``
    :ivar base: name of the body that moves
    :ivar origin: pose of the frame of the odometry in ``world``
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str]) -> None:
        moved_by = [model.joint(name) for name in joints]
        # Bodies come after their parents.
        body = max(int(joint.bodyid[0]) for joint in moved_by)
        self.base: str = model.body(body).name
        data = mujoco.MjData(model)
        for joint in moved_by:
            data.qpos[joint.qposadr[0]] = 0.0
        mujoco.mj_kinematics(model, data)
        self._position = data.xpos[body].copy()
        self._quat_wxyz = data.xquat[body].copy()
        self.origin = Pose(self._position, wxyz_to_xyzw(self._quat_wxyz))

    def frame_moved_by(self, x: float, y: float, heading: float) -> FloatArray:
        """
        Return the pose in ``world`` of a frame that has moved from that of the odometry, (7,).

        :param x: in the axes of that frame [m], as ``y``
        :param heading: about its z axis [rad]
        """
        shift, turn, quat_wxyz = np.empty(3), np.empty(4), np.empty(4)
        mujoco.mju_rotVecQuat(shift, np.array([x, y, 0.0]), self._quat_wxyz)
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), heading)
        mujoco.mju_mulQuat(quat_wxyz, self._quat_wxyz, turn)
        return _row(self._position + shift, quat_wxyz)

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> Odometry:
        """
        Return the state of the base at the instant of the last ``mj_forward``.

        :param model: the ``mujoco.MjModel``, in which the robot is unchanged
        :param data: its ``mujoco.MjData``
        """
        body = int(model.body(self.base).id)
        inverse, position, velocity = np.empty(4), np.empty(3), np.empty(6)
        mujoco.mju_negQuat(inverse, self._quat_wxyz)
        mujoco.mju_rotVecQuat(position, data.xpos[body] - self._position, inverse)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 1)
        quat_wxyz = relative_quat_wxyz(self._quat_wxyz, data.xquat[body])
        return Odometry(position, wxyz_to_xyzw(quat_wxyz), velocity[3:], velocity[:3])


@dataclass(frozen=True)
class TreeFrame:
    """
    A frame and its parent.

    :ivar name: unique among frames
    :ivar parent: name of another frame, or ``world``
    """

    name: str
    parent: str


class FrameTree:
    """
    The frames of a model; poses are rows x, y, z [m] and quaternion x, y, z, w.

    :param model: the compiled ``mujoco.MjModel``
    :param sites: names of sites that are frames too
    :param placed: functions that return the present poses of further frames in ``world``, by names
        that :meth:`FrameNames.placed` returned
    :ivar model: the model
    :ivar moving: frames that move in their parent: bodies with joints and mocap bodies, frames
        of joints between bodies, cameras that follow something, and further frames
    :ivar static: frames that do not move in their parent
    :ivar static_poses: of :attr:`static` in their parents, shape (n, 7)
    """

    def __init__(self, model: mujoco.MjModel, sites: Iterable[str] = (),
                 placed: Mapping[str, Callable[[], FloatArray]] = MappingProxyType({})) -> None:
        self.model = model
        self.static: list[TreeFrame] = []
        static_poses: list[FloatArray] = []
        tree = build_tree(model, 0, [model.site(name).id for name in sites], placed)
        bodies: dict[TreeFrame, int] = {}
        joints: dict[TreeFrame, Joint] = {}
        for frame, body, joint in _frames_of(model, tree):
            if joint is None:
                bodies[frame] = body
            elif joint.kind == 'fixed':
                self.static.append(frame)
                static_poses.append(_row(joint.position, _quat_wxyz(joint.rotation)))
            else:
                joints[frame] = joint
        names = FrameNames(model, placed)
        followers = {TreeFrame(names.cameras[camera], ROOT): camera
                     for camera in range(model.ncam) if camera not in tree.link_of_camera}
        self._bodies = np.array(list(bodies.values()), dtype=np.int64)
        self._parents: Any = model.body_parentid[self._bodies]
        self._joints, self._cameras = list(joints.values()), list(followers.values())
        self._placed = dict(placed)
        self.moving: list[TreeFrame] = [
            *bodies, *joints, *followers, *[TreeFrame(name, ROOT) for name in placed]]
        for frame, camera in followers.items():
            self.static.append(TreeFrame(names.opticals[camera], frame.name))
            static_poses.append(_row(np.zeros(3), _TO_OPTICAL))
        self.static_poses = np.array(static_poses).reshape(-1, 7)

    def moving_poses(self, data: mujoco.MjData) -> FloatArray:
        """
        Return the poses of :attr:`moving` in their parents, at the last ``mj_forward``.

        :param data: the ``mujoco.MjData`` of :attr:`model`
        :returns: in the order of :attr:`moving`, shape (n, 7)
        """
        poses = np.empty((len(self.moving), 7))
        count = len(self._bodies)
        children, parents = self._bodies, self._parents
        axes = data.xmat[parents].reshape(-1, 3, 3)
        poses[:count, :3] = np.einsum('nji,nj->ni', axes, data.xpos[children] - data.xpos[parents])
        poses[:count, 3:] = np.einsum('ijk,nj,nk->ni', _INVERSE_PRODUCT, data.xquat[parents],
                                      data.xquat[children])
        others = [self._moved(joint, data) for joint in self._joints]
        others += [(data.cam_xpos[camera], _quat_wxyz(data.cam_xmat[camera]))
                   for camera in self._cameras]
        for row, (position, quat_wxyz) in enumerate(others, start=count):
            poses[row] = _row(position, quat_wxyz)
        for row, pose in enumerate(self._placed.values(), start=count + len(others)):
            poses[row] = pose()
        return poses

    def _moved(self, joint: Joint, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """Return position and quaternion w, x, y, z of the child of a joint in its parent."""
        position = float(data.qpos[self.model.jnt_qposadr[joint.id]])
        axis = np.zeros(3) if joint.axis is None else joint.axis
        if joint.kind == 'prismatic':
            return (joint.position + joint.rotation @ axis * position,
                    _quat_wxyz(joint.rotation))
        turn, turned = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, axis, position)
        mujoco.mju_mulQuat(turned, _quat_wxyz(joint.rotation), turn)
        return joint.position, turned


def _frames_of(model: mujoco.MjModel, tree: KinematicTree
               ) -> Iterator[tuple[TreeFrame, int, Joint | None]]:
    """
    Return the frames of a tree with their bodies, and joints where these give their poses.

    A body without a joint to give its pose moves in the frame of its parent body.
    """
    names = set(tree.link_of_body.values())
    for link, joint in zip(tree.links[1:], tree.joints):
        body = link.body
        if body is None:
            joint_body = -1 if joint.id is None else int(model.jnt_bodyid[joint.id])
            if joint_body < 0 or _has_scalar_joints(model, joint_body):
                yield TreeFrame(joint.child, joint.parent), 0, joint
        elif not _has_scalar_joints(model, body) or (
                joint.parent in names and joint.kind != 'fixed') or model.body_mocapid[body] >= 0:
            parent = tree.link_of_body[int(model.body_parentid[body])]
            yield TreeFrame(joint.child, parent), body, None
        else:
            yield TreeFrame(joint.child, joint.parent), body, joint


def _has_scalar_joints(model: mujoco.MjModel, body: int) -> bool:
    """Return whether all joints of a body, if it has any, are hinges or slides."""
    return all(int(model.jnt_type[joint]) in SCALAR for joint in joints_of_body(model, body))


def _row(position: Any, quat_wxyz: Any) -> FloatArray:
    return np.concatenate([position, wxyz_to_xyzw(quat_wxyz)])


def _quat_wxyz(matrix: Any) -> FloatArray:
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ravel(matrix))
    return quat_wxyz


#: t with t[i, j, k] p[j] c[k] = p^-1 c as x, y, z, w, for p and c as w, x, y, z.
_INVERSE_PRODUCT = np.array([
    [wxyz_to_xyzw(relative_quat_wxyz(p, c)) for c in np.eye(4)]
    for p in np.eye(4)]).transpose(2, 0, 1).copy()
