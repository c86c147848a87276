# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Infer what the file of a hand does not say: where it grasps and which way it closes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
import copy
from functools import partial
import hashlib
import os
from typing import Any, TypeVar

import mujoco
import numpy as np

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.models.actuators import position_servos
from manip_sim.models.archive import to_binary
from manip_sim.models.files.body_tree import BodyTree, words_of
from manip_sim.models.files.found_hands import FoundHand

#: Words in the names of frames between the fingertips, in order of preference.
_GRASP_WORDS = (
    {'pinch'}, {'grasp'}, {'grip'}, {'tcp'}, {'gripperframe'}, {'gripper', 'frame'})
#: Duration and physics step of a trial in which a finger moves [s].
_TRIAL_S, _TRIAL_STEP_S = 0.5, 0.002
#: A relative change of the distance of the fingers up to this one decides nothing.
_TELLING = 0.02
#: A fingertip that moves at most this fraction of the greatest motion counts as still.
_STILL = 0.1
#: Range of the control of an actuator that nothing limits.
UNLIMITED = (-1.0, 1.0)
#: A control range may exceed what the joint can reach by this fraction of the joint's range.
_BEYOND = 0.5
#: Time constant of the fingers in a trial [s].
_SLOWNESS_S = 0.01
#: A finger opens again if it comes back by at least this share of its way.
_OPENS_AGAIN = 0.7
#: Shares of the way to the end of the range, or of a motor's effort, that are tried where a finger
#: does not open again.
_SHORTER = (0.75, 0.5, 0.25)
#: Opening and closing control, and whether a trial decided which is which.
Closing = tuple[float, float, bool]
#: Closings of actuators by name, and other closings of those that would not open again.
Closings = tuple[dict[str, Closing], dict[str, Closing]]
Result = TypeVar('Result')
#: Results for hands with their shapes, by digest, and the most that are kept.
_known: dict[bytes, Any] = {}
_MOST_KNOWN = 400


def once(key: bytes, compute: Callable[[], Result]) -> Result:
    """Return the result of a computation, of an earlier one with the same key if there was one."""
    digest = hashlib.blake2b(key).digest()
    if digest not in _known:
        result = compute()
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        _known[digest] = result
    known: Result = copy.deepcopy(_known[digest])
    return known


def digest_of(model: mujoco.MjModel) -> bytes:
    """Return a digest of a compiled model."""
    return hashlib.blake2b(to_binary(model)).digest()


def digest_of_meshes(spec: mujoco.MjSpec) -> bytes:
    """
    Return a digest of the meshes of a spec: of their files the size and the time of change.

    It differs each time if the origin of a mesh is not known.
    """
    digest = hashlib.blake2b()
    for mesh in spec.meshes:
        digest.update(repr((mesh.name, mesh.file, mesh.maxhullvert, *[
            list(numbers) for numbers in (mesh.scale, mesh.refpos, mesh.refquat)])).encode())
        if mesh.file in spec.assets:
            digest.update(spec.assets[mesh.file])
        elif os.path.isabs(mesh.file) and os.path.isfile(mesh.file):
            status = os.stat(mesh.file)
            digest.update(repr((status.st_size, status.st_mtime_ns, status.st_ino)).encode())
        else:
            digest.update(os.urandom(16) if mesh.file or not len(mesh.uservert) else repr(
                (list(mesh.uservert), list(mesh.userface))).encode())
    return digest.digest()


def _apart(points: FloatArray) -> float:
    """Return the mean distance between points [m]."""
    if len(points) < 2:
        return 0.0
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    return float(distances.sum() / (len(points) * (len(points) - 1)))


def _relative(low: float, high: float) -> float:
    return float((high - low) / max(low, high)) if max(low, high) > 0.0 else 0.0


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """Suppress MuJoCo's warnings of a trial that fails."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def integrates(model: mujoco.MjModel, actuator: int) -> bool:
    """Return whether a servo integrates its control: that is the velocity of its setpoint."""
    return bool(position_servos(model, actuator)) and int(
        model.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


def control_range(model: mujoco.MjModel, actuator: int) -> tuple[float, float] | None:
    """
    Return the control range of an actuator; a servo's is cut if it far exceeds its joint's.

    Of one that integrates its control, it is the range of the integral.

    :returns: lowest and highest control; None if nothing limits it or the range is empty
    """
    reach = _reach(model, actuator)
    if integrates(model, actuator):
        low, high = model.actuator_actrange[actuator]
        return (float(low), float(high)) if low < high else reach
    if model.actuator_ctrllimited[actuator]:
        low, high = model.actuator_ctrlrange[actuator]
        if reach:
            # A target that is a little beyond the joint's range makes the servo press.
            beyond = _BEYOND * (reach[1] - reach[0])
            if low < reach[0] - beyond or high > reach[1] + beyond:
                low, high = max(low, reach[0]), min(high, reach[1])
        return (float(low), float(high)) if low < high else None
    if reach:
        return reach
    gain = model.actuator_gainprm[actuator, 0]
    if (model.actuator_forcelimited[actuator] and gain > 0.0
            and not position_servos(model, actuator)):
        low, high = model.actuator_forcerange[actuator] / gain
        return float(low), float(high)
    return None


def _reach(model: mujoco.MjModel, actuator: int) -> tuple[float, float] | None:
    """Return the controls at which a servo rests at the ends of its joint's range, or None."""
    joint = int(model.actuator_trnid[actuator, 0])
    is_joint = int(model.actuator_trntype[actuator]) == int(mujoco.mjtTrn.mjTRN_JOINT)
    if not (is_joint and position_servos(model, actuator) and model.jnt_limited[joint]):
        return None
    bias = model.actuator_biasprm[actuator]
    ends = (-(bias[0] + bias[1] * model.jnt_range[joint] * model.actuator_gear[actuator, 0])
            / model.actuator_gainprm[actuator, 0])
    return float(ends.min()), float(ends.max())


class Fingers:
    """
    The moving parts of a hand.

    :param start: where joints start, by name; of others than those of the tree, too [rad or m]
    """

    def __init__(self, tree: BodyTree, hand: FoundHand, start: Mapping[str, float]) -> None:
        self._model = model = tree.model
        self._tree, self._hand = tree, hand
        self._data = mujoco.MjData(model)
        for joint in range(model.njnt):
            name = str(model.joint(joint).name)
            if name in start:
                self._data.joint(name).qpos[0] = start[name]
        mujoco.mj_forward(model, self._data)
        below = tree.below(hand.body)
        moved: set[int] = set().union(
            *(tree.below(int(model.jnt_bodyid[joint])) for joint in hand.joints))
        self._moved, self._palm = sorted(moved), sorted(below - moved)
        ends = [b for b in sorted(moved) if not (tree.below(b) - {b}) & moved]
        self._tips = [self._farthest_geom(body) for body in ends]

    @property
    def out_of_touch(self) -> list[str]:
        """Names of the bodies that move if no shape of them can touch an object, else empty."""
        model, moved = self._model, self._moved
        # Objects have bit 1 of contype and conaffinity, as all shapes have by default.
        touching = (model.geom_contype | model.geom_conaffinity) & 1
        if touching[np.isin(model.geom_bodyid, moved)].any():
            return []
        return [self._tree.name(body) for body in moved]

    def _farthest_geom(self, body: int) -> tuple[int, int]:
        """Return the id of a body and of its geom farthest from the hand's body, -1 for none."""
        model, data = self._model, self._data
        # The last body of a finger may be a frame without a geom; then its parent counts.
        while not model.body_geomnum[body] and self._tree.parent(body) not in self._palm:
            body = self._tree.parent(body)
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        if not count:
            return body, -1
        geoms = range(first, first + count)
        origin = data.xpos[self._hand.body]
        return body, max(geoms, key=lambda g: length(data.geom_xpos[g] - origin))

    def _tip_points(self, data: mujoco.MjData) -> FloatArray:
        return np.array([data.geom_xpos[geom] if geom >= 0 else data.xpos[body]
                         for body, geom in self._tips])

    def _palm_point(self, data: mujoco.MjData) -> FloatArray:
        geoms = [g for g in range(self._model.ngeom) if self._model.geom_bodyid[g] in self._palm]
        points = data.geom_xpos[geoms] if geoms else data.xpos[[self._hand.body]]
        middle: FloatArray = np.asarray(points).mean(axis=0)
        return middle

    def grasp_frame(self) -> str | None:
        """
        Return a frame whose name says that it is between the fingertips, or None.

        It is a site, or else a body on the palm without shapes, such as a frame of a URDF.
        """
        model, below = self._model, self._tree.below(self._hand.body)
        sites = [str(model.site(i).name) for i in range(model.nsite)
                 if model.site_bodyid[i] in below]
        links = [self._tree.name(body) for body in self._palm
                 if body != self._hand.body and not model.body_geomnum[body]]
        for frames in (sites, links):
            for words in _GRASP_WORDS:
                for name in frames:
                    if words <= words_of(name):
                        return name
        return None

    def grasp_point(self) -> FloatArray:
        """
        Return the mean of the fingertips in the frame of the hand's body [m], shape (3,).

        For a hand with one moving finger it is the mean of its tip and the palm; for one without,
        the origin of the body.
        """
        data, body = self._data, self._hand.body
        if not self._tips:
            return np.zeros(3)
        points = self._tip_points(data)
        if len(points) == 1:
            points = np.vstack([points, self._palm_point(data)])
        local: FloatArray = product(
            data.xmat[body].reshape(3, 3).T, points.mean(axis=0) - data.xpos[body])
        return local

    def closing(self, actuators: Sequence[str]) -> Closings:
        """Return how actuators close, as :meth:`_ends` and :meth:`_reopening` say."""
        if not actuators:
            return {}, {}
        trial = self._trial_model()
        ends = self._ends(trial, [int(self._model.actuator(name).id) for name in actuators])
        trial.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        by_name, changed = ({str(self._model.actuator(i).name): closing
                             for i, closing in closings.items()}
                            for closings in (ends, self._reopening(trial, ends)))
        return by_name, changed

    def _ends(self, trial: mujoco.MjModel, actuators: Sequence[int]) -> dict[int, Closing]:
        """
        Return the opening and the closing control of actuators.

        Each is driven to both ends of its range while the others hold. The closing end is that at
        which the fingertips that it moves are nearer to each other, or nearer to the palm if that
        changes more; the upper end if neither changes.

        :returns: by id, opening and closing control, and whether the trial decided
        """
        closings = {}
        for actuator in actuators:
            limits = control_range(self._model, actuator) or UNLIMITED
            with _without_warnings():
                low, high = (self._tips_at(trial, actuator, control) for control in limits)
            # Positive where the fingers are farther apart at the upper end.
            change = self._change(low, high)
            is_clear = abs(change) > _TELLING
            closings[actuator] = (
                *(limits[::-1] if is_clear and change > 0.0 else limits), is_clear)
        return closings

    def _reopening(self, trial: mujoco.MjModel, closing: Mapping[int, Closing]
                   ) -> dict[int, Closing]:
        """
        Return closings from which the fingers open again, where the given ones lock a hand.

        All actuators close at once, with contacts of the hand, and open again. One that does not
        come back closes less far, or with less effort, see :data:`_SHORTER`. What never opens
        again stays as it is.

        :returns: those that are other ones, by id
        """
        # Slow ones get more time before they count.
        long_s = 2.0 * _TRIAL_S
        stuck = self._stuck(trial, closing, _TRIAL_S) and self._stuck(trial, closing, long_s)
        reopening: dict[int, Closing] = {}
        if not stuck:
            return reopening
        for share in _SHORTER:
            changed = {actuator: self._lessened(actuator, closing[actuator], share)
                       for actuator in stuck}
            still = self._stuck(trial, {**closing, **reopening, **changed}, long_s)
            reopening.update({actuator: changed[actuator] for actuator in stuck - still})
            stuck &= still
        return reopening

    def _lessened(self, actuator: int, closing: Closing, share: float) -> Closing:
        """Return a closing that goes less far, or with less effort."""
        opened, closed, is_clear = closing
        if position_servos(self._model, actuator):
            return opened, opened + share * (closed - opened), is_clear
        return opened, share * closed, is_clear

    def _stuck(self, model: Any, closing: Mapping[int, Closing], duration_s: float) -> set[int]:
        """Return the actuators that close and do not open again, none if a trial fails."""
        data = copy.copy(self._data)
        ids, lengths = list(closing), []
        for other in range(model.nu):
            data.ctrl[other] = self._holding_control(other)
        for end in (0, 1, 0):
            data.ctrl[ids] = [closing[actuator][end] for actuator in ids]
            try:
                with _without_warnings():
                    mujoco.mj_step(model, data, round(duration_s / _TRIAL_STEP_S))
            except mujoco.FatalError:  # More contacts than MuJoCo has memory for.
                return set()
            lengths.append(data.actuator_length[ids].copy())
        way, back = np.abs(lengths[1] - lengths[0]), np.abs(lengths[2] - lengths[1])
        if not np.isfinite(lengths).all():
            return set()
        moves = way > _STILL * np.abs(way).max(initial=0.0)
        return {ids[i] for i in np.flatnonzero(moves & (back < _OPENS_AGAIN * way))}

    def _change(self, low: FloatArray, high: FloatArray) -> float:
        """
        Return how much farther apart fingertips are at the upper end, over the greater distance.

        :param low: palm and tips at the lower end [m], shape (1 + number of tips, 3)
        :param high: the same at the upper end
        """
        if not (self._tips and np.isfinite(low).all() and np.isfinite(high).all()):
            return 0.0
        moved = np.linalg.norm(high[1:] - low[1:], axis=1)
        moves = moved > _STILL * moved.max()
        pair = moves if moves.sum() > 1 or len(moves) != 2 else np.array([True, True])
        changes = [_relative(_apart(low[1:][pair]), _apart(high[1:][pair])),
                   _relative(*(np.linalg.norm(end[1:][moves] - end[0], axis=1).mean()
                               for end in (low, high)))] if moves.any() else [0.0]
        return max(changes, key=abs)

    def _trial_model(self) -> mujoco.MjModel:
        """Return a copy of the model without gravity and contacts, where only the hand touches."""
        model = copy.copy(self._model)
        model.opt.timestep = _TRIAL_STEP_S
        model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        off = mujoco.mjtDisableBit
        model.opt.disableflags |= int(
            off.mjDSBL_GRAVITY | off.mjDSBL_AUTORESET | off.mjDSBL_CONTACT)
        elsewhere = ~np.isin(model.geom_bodyid, [*self._palm, *self._moved])
        model.geom_contype[elsewhere] = model.geom_conaffinity[elsewhere] = 0
        hand = list(self._hand.actuators)
        model.actuator_ctrlrange[hand] = [
            control_range(self._model, actuator) or UNLIMITED for actuator in hand]
        model.actuator_ctrllimited[hand] = 1
        for actuator in range(model.nu):
            if integrates(self._model, actuator):  # The trials set positions.
                model.actuator_dyntype[actuator] = int(mujoco.mjtDyn.mjDYN_NONE)
                model.actuator_actadr[actuator], model.actuator_actnum[actuator] = -1, 0
                model.actuator_ctrllimited[actuator] = 0
        # Only where the fingers come to rest counts, so they may be slow, which makes them stable.
        moments = np.zeros((model.nu, model.nv))
        data = self._data
        mujoco.mju_sparse2dense(moments, data.actuator_moment.reshape(-1), data.moment_rownnz,
                                data.moment_rowadr, data.moment_colind)
        stiffness = np.zeros(model.nv)
        for actuator in filter(partial(position_servos, model), self._hand.actuators):
            stiffness += -model.actuator_biasprm[actuator, 1] * moments[actuator]**2
        model.dof_armature[:] += stiffness * _SLOWNESS_S**2
        damping = np.asarray(model.dof_damping).reshape(model.nv, -1)
        damping[:, 0] += 2.0 * stiffness * _SLOWNESS_S
        model.dof_damping[:] = damping.reshape(model.dof_damping.shape)
        return model

    def _tips_at(self, model: mujoco.MjModel, actuator: int, control: float) -> FloatArray:
        """Return palm and fingertips after an actuator has moved them [m], shape (n, 3)."""
        data = copy.copy(self._data)
        for other in range(model.nu):
            data.ctrl[other] = self._holding_control(other)
        data.ctrl[actuator] = control
        mujoco.mj_step(model, data, round(_TRIAL_S / _TRIAL_STEP_S))
        return np.vstack([self._palm_point(data), *self._tip_points(data)])

    def _holding_control(self, actuator: int) -> float:
        model = self._model
        if not position_servos(model, actuator):
            return 0.0
        bias, length = model.actuator_biasprm[actuator], self._data.actuator_length[actuator]
        return float(-(bias[0] + bias[1] * length) / model.actuator_gainprm[actuator, 0])
