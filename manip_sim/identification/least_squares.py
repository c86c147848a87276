# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Least squares for friction, rotor inertia and payload, on the inverse dynamics of MuJoCo.

Effort and model pass through the same Gaussian, which shifts no phase, so what is linear in
position, velocity and acceleration is not changed by it. Derivatives come from a Gaussian too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import ModelError
from manip_sim.identification.recorded_motion import RecordedMotion, Stretch

#: The values of a joint, in the order of the columns; the last one is the effort at rest.
KINDS = ('armature', 'damping', 'frictionloss', 'offset')
#: Of the low-pass filter [Hz].
CUTOFF_HZ = 4.0
#: Of a payload at the flange: mass, mass times position, and the inertia about the flange.
_PAYLOAD = 10
#: States whose efforts are computed together; all would take memory, one takes long in Python.
_TOGETHER = 1000
#: Width of the Gaussian of the derivatives [s], and least in intervals; reach of a Gaussian.
_NARROW_S, _LEAST, _REACH = 0.008, 1.0, 4.0
#: Width of a Gaussian times the frequency at which it halves the power.
_HALF_POWER = math.sqrt(math.log(2.0)) / (2.0 * math.pi)
#: A joint is at rest below this share of its highest velocity.
_REST = 0.12
#: Least mean direction of motion in a Gaussian: friction near rest has laws of its own.
_ONE_WAY = 0.98
#: Variance of the fourth differences of noise, as a multiple of its own.
_FOURTH = 70.0
#: Least motion of a joint [rad or m], and least share of the time in each direction.
_LEAST_MOTION, _LEAST_SHARE = 0.02, 0.05
#: Share of the record at its end that is not fitted; blocks of the others for standard errors.
_HELD_OUT, _BLOCKS = 0.2, 12
#: Least time that is fitted [s], and least number of rows of a joint.
_SHORTEST_S, _LEAST_ROWS = 5.0, 40
#: Effort may lag behind the state by so many intervals, or lead.
_LAG = 3.0
#: Greatest standard errors, as shares of the inertia of a joint and of its effort limit (damping:
#: at its highest velocity in the record).
_SURE = {'armature': 0.1, 'damping': 0.01, 'frictionloss': 0.01, 'offset': 0.01}
#: Share of a value to which a record should tell it at 95 %; standard errors of that (Student's t
#: of 12 blocks); and what the method itself leaves of a joint's inertia in records without noise.
_WANTED, _SURELY, _LEFT = 0.05, 2.2, 0.002
#: Error of a value that does not matter, as a share of its tolerance.
_NO_MATTER = 0.01
#: A payload is hinted at if it leaves less than this share of the squares, and has this mass [kg].
_BETTER, _LEAST_MASS = 0.9, 0.03


@dataclass(frozen=True)
class Value:
    """
    A number that was identified.

    :ivar value: None if it cannot be observed
    :ivar error: standard error, by a jackknife over blocks of time
    :ivar before: what the model has
    :ivar tolerance: standard error up to which the value is told
    :ivar reason: why it cannot be observed, or empty
    :ivar within: by which the value may be wrong, at 95 %
    :ivar more: factor of the record's length with which that would be 5 % of the value, or too
        little to matter
    """

    value: float | None
    error: float
    before: float = 0.0
    tolerance: float = 0.0
    reason: str = ''
    within: float = 0.0
    more: float = 0.0


@dataclass(frozen=True)
class JointFit:
    """
    The identified values of a joint, and the share of its effort that they explain.

    :ivar values: by the names in :data:`KINDS`
    :ivar rms: of the effort that is left, where it was fitted [N m or N]
    :ivar held_out: of the effort that is left at the end of the record, which was not fitted
    :ivar held_out_before: the same with the values of the model
    :ivar explained: share of the effort's variance at the end of the record that is explained
    """

    name: str
    values: Mapping[str, Value]
    rms: float
    held_out: float
    held_out_before: float
    explained: float


@dataclass(frozen=True)
class PayloadFit:
    """
    A payload at the end of an arm.

    :ivar mass: [kg]
    :ivar center: of mass in the frame of the flange [m], each with its error
    """

    arm: str
    mass: Value
    center: tuple[Value, Value, Value]

    @property
    def counts(self) -> bool:
        """True if there is a mass, beyond doubt."""
        return abs(self.mass.value or 0.0) > max(5.0 * self.mass.error, _LEAST_MASS)


@dataclass(frozen=True)
class Identification:
    """
    The result.

    :ivar joints: in the order of the part
    :ivar payloads: by arm, those that were fitted
    :ivar hints: payloads that would explain more, if none was fitted
    :ivar lag_s: time by which efforts lag behind the states [s]
    :ivar fitted_s: length of the fitted part [s]
    :ivar held_out_s: length of the held-out part [s]
    """

    joints: list[JointFit]
    payloads: list[PayloadFit]
    hints: list[PayloadFit]
    lag_s: float
    fitted_s: float
    held_out_s: float

    @property
    def suffices_s(self) -> float:
        """Length of such a record that tells all values to 5 % [s]."""
        return (self.fitted_s + self.held_out_s) * max(
            value.more for joint in self.joints for value in joint.values.values())


class _Gaussian:
    """
    A Gaussian and its derivatives as filters.

    :param width: [s]
    :param interval: [s]
    :param lag: of the filtered signal [s]
    :param most_lag: that another one has, which must be of the same reach [s]
    """

    def __init__(self, width: float, interval: float, lag: float = 0.0, most_lag: float = 0.0
                 ) -> None:
        self.reach = math.ceil((_REACH * width + most_lag) / interval)
        # np.convolve turns the kernel around.
        at = interval * np.arange(-self.reach, self.reach + 1) + lag
        bell = np.exp(-0.5 * (at / width) ** 2)
        bell /= bell.sum()
        slope = -at * bell
        bend = (at**2 - (bell @ at**2)) * bell
        # Exact for parabolas, whatever the interval.
        self._kernels = bell, -slope / (slope @ at), 2.0 * bend / (bend @ at**2)

    def __call__(self, values: FloatArray, order: int = 0) -> FloatArray:
        """
        Return columns that are filtered, shorter by the reach at both ends.

        :param values: shape (t, ...)
        :param order: of the derivative
        """
        found = np.empty((len(values) - 2 * self.reach, *values.shape[1:]))
        for column in np.ndindex(values.shape[1:]):
            own = (slice(None), *column)
            found[own] = np.convolve(values[own], self._kernels[order], 'valid')
        return found

    def combined(self, order: int, other: _Gaussian) -> float:
        """Return the factor of the variance of noise that passes this filter and another one."""
        return float((np.convolve(self._kernels[order], other._kernels[0]) ** 2).sum())


class RigidModel:
    """
    The effort of a model whose joints have neither friction nor rotors.

    :param model: the compiled model, which is copied
    :param qpos: of the joints that are not recorded, shape (nq,)
    :param joints: that are identified
    :param flanges: body of the flange by arm
    """

    def __init__(self, model: mujoco.MjModel, qpos: FloatArray, joints: Sequence[str],
                 flanges: Mapping[str, str]) -> None:
        self.before = {name: _before(model, name) for name in joints}
        self._model = model.__copy__()
        self._model.dof_armature[:] = 0.0
        self._model.dof_damping[:] = 0.0
        self._model.dof_frictionloss[:] = 0.0
        # The effort of a motor includes what it needs against gravity.
        self._model.body_gravcomp[:] = 0.0
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data, self._qpos = mujoco.MjData(self._model), np.array(qpos)
        self.joints, self._dofs = list(joints), self._addresses(joints)[1]
        self.arms = list(flanges)
        self._flanges = [self._model.body(body).id for body in flanges.values()]
        self.limits = _effort_limits(model, self._dofs)
        # Damping acts with the velocity at the end of a step, half a step after the middle between
        # its ends: the arm of a simulation has so much more inertia for each unit of damping.
        self.late_s = 0.5 * float(model.opt.timestep)

    def _addresses(self, joints: Sequence[str]) -> tuple[IntArray, IntArray]:
        ids = [self._model.joint(name).id for name in joints]
        return self._model.jnt_qposadr[ids], self._model.jnt_dofadr[ids]

    def efforts(self, joints: Sequence[str], motion: FloatArray
                ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """
        Return efforts, what payloads add, and mean inertia of the joints that are identified.

        :param joints: whose motion it is
        :param motion: position, velocity and acceleration, shape (3, t, len(joints))
        :returns: shapes (t, n), (t, n, 10 arms) and (n,)
        """
        data, (qpos, dofs) = self._data, self._addresses(joints)
        data.qpos[:], data.qvel[:], data.qacc[:] = self._qpos, 0.0, 0.0
        count = motion.shape[1]
        rigid = np.empty((count, len(self._dofs)))
        loads = np.empty((count, len(self._dofs), _PAYLOAD * len(self._flanges)))
        flanges = [_Flange(self._model, body, self._dofs) for body in self._flanges]
        inertia, mass = np.zeros(len(self._dofs)), np.empty((self._model.nv, self._model.nv))
        for row, (position, velocity, acceleration) in enumerate(zip(*motion)):
            data.qpos[qpos], data.qvel[dofs], data.qacc[dofs] = position, velocity, acceleration
            mujoco.mj_inverse(self._model, data)
            rigid[row] = data.qfrc_inverse[self._dofs]
            if flanges:
                mujoco.mj_rnePostConstraint(self._model, data)
                begin = row - row % _TOGETHER
                for index, flange in enumerate(flanges):
                    flange.note(data, row - begin)
                    if row + 1 in (begin + _TOGETHER, count):
                        loads[begin:row + 1, :, _PAYLOAD * index:_PAYLOAD * (index + 1)] = (
                            flange.efforts(row + 1 - begin))
            if row % 100 == 0:
                mujoco.mj_fullM(self._model, data, mass)
                inertia += np.diag(mass)[self._dofs]
        return rigid, loads, inertia / max(1, -(-count // 100))


class _Flange:
    """
    The motion of the body at the end of an arm, from which efforts of payloads follow.

    :param body: its id
    :param dofs: of the joints that are identified, shape (n,)
    """

    def __init__(self, model: mujoco.MjModel, body: int, dofs: IntArray) -> None:
        self._model, self._body, self._dofs = model, body, dofs
        self._jacobian = np.empty((2, 3, model.nv))
        self._jacobians = np.empty((_TOGETHER, 2, 3, len(dofs)))
        self._rotations = np.empty((_TOGETHER, 3, 3))
        self._twists, self._changes = np.empty((2, _TOGETHER, 6))

    def note(self, data: mujoco.MjData, row: int) -> None:
        """Note the motion in a state."""
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self._model, data, kind, self._body, self._twists[row], 1)
        # Less the acceleration of gravity.
        mujoco.mj_objectAcceleration(self._model, data, kind, self._body, self._changes[row], 1)
        mujoco.mj_jacBody(self._model, data, *self._jacobian, self._body)
        self._jacobians[row] = self._jacobian[:, :, self._dofs]
        self._rotations[row] = data.xmat[self._body].reshape(3, 3)

    def efforts(self, count: int) -> FloatArray:
        """Return the efforts of a unit of each parameter of a payload, shape (count, n, 10)."""
        spin, (bend, along) = self._twists[:count, :3], np.split(self._changes[:count], 2, axis=1)
        forces, torques = np.zeros((2, len(spin), 3, _PAYLOAD))
        forces[:, :, 0] = along
        forces[:, :, 1:4] = _cross(bend) + _cross(spin) @ _cross(spin)
        torques[:, :, 1:4] = -_cross(along)
        for column, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), 4):
            unit = np.zeros((3, 3))
            unit[i, j] = unit[j, i] = 1.0
            torques[:, :, column] = bend @ unit + np.cross(spin, spin @ unit)
        linear, angular = np.moveaxis(self._jacobians[:count], 1, 0).swapaxes(2, 3)
        rotations = self._rotations[:count]
        return np.asarray(linear @ (rotations @ forces) + angular @ (rotations @ torques))


def _cross(vectors: FloatArray) -> FloatArray:
    """Return the matrices that multiply by the cross product, shape (t, 3, 3)."""
    return np.cross(vectors[:, None], np.eye(3)).swapaxes(1, 2)


def _before(model: mujoco.MjModel, name: str) -> dict[str, float]:
    dof = int(model.joint(name).dofadr[0])
    return {'armature': float(model.dof_armature[dof]),
            'damping': float(np.reshape(model.dof_damping, (model.nv, -1))[dof, 0]),
            'frictionloss': float(model.dof_frictionloss[dof]), 'offset': 0.0}


def _effort_limits(model: mujoco.MjModel, dofs: IntArray) -> FloatArray:
    """Return the effort limits of joints, infinite without one."""
    joints = model.dof_jntid[dofs]
    return np.where(model.jnt_actfrclimited[joints],
                    np.abs(model.jnt_actfrcrange[joints]).max(axis=1), np.inf)


class _Rows:
    """
    Filtered rows of all stretches, the rows of all joints at one instant together.

    :param motion: that was recorded
    :param model: of it
    :param width: of the Gaussian [s]
    :param progress: is called with the number of states that are done
    :ivar rigid: effort of the model without friction and rotors, shape (t, n)
    :ivar columns: of each joint by :data:`KINDS`, shape (t, n, 4)
    :ivar loads: of the payloads, shape (t, n, 10 arms)
    :ivar moving: which joints move, shape (t, n)
    :ivar inertia: mean of each joint without its rotor, shape (n,)
    :ivar most: highest velocity of each joint, shape (n,)
    :ivar travel: from the lowest to the highest position of each joint, shape (n,)
    :ivar noise: variance that noise of positions has in accelerations and velocities, (2, n)
    :ivar interval_s: between two rows [s]
    """

    def __init__(self, motion: RecordedMotion, model: RigidModel, width: float,
                 progress: Callable[[int], object]) -> None:
        self._width, self.interval_s = width, 0.0
        self._efforts: list[tuple[FloatArray, float]] = []
        parts: list[tuple[FloatArray, ...]] = []
        done = 0
        for stretch in motion.stretches:
            narrow = _Gaussian(max(_NARROW_S, _LEAST * stretch.interval_s), stretch.interval_s)
            wide = self._wide(stretch.interval_s)
            if len(stretch) > 2 * (narrow.reach + wide.reach):
                parts.append(self._add(stretch, model, narrow, wide))
                done += len(stretch)
                progress(done)
        if not parts:
            raise ModelError('the record is too short: it has no stretch of '
                             f'{2.0 * _REACH * (width + _NARROW_S):.1f} s without a gap')
        self.rigid, self.columns, self.loads, speed = (
            np.concatenate(rows) for rows in list(zip(*parts))[:4])
        inertias, noises, lows, highs = (np.array(rows) for rows in list(zip(*parts))[4:])
        self.inertia, self.noise = inertias.mean(axis=0), noises.mean(axis=0)
        self.travel = highs.max(axis=0) - lows.min(axis=0)
        self.most = np.abs(speed).max(axis=0)
        self.moving = (np.abs(speed) > _REST * self.most) & (
            np.abs(self.columns[:, :, 2]) > _ONE_WAY)

    def _wide(self, interval: float, lag: float = 0.0) -> _Gaussian:
        return _Gaussian(self._width, interval, lag, _LAG * interval)

    def _add(self, stretch: Stretch, model: RigidModel, narrow: _Gaussian, wide: _Gaussian
             ) -> tuple[FloatArray, ...]:
        positions = np.array([*stretch.positions.values()]).T
        smooth = np.stack([narrow(positions, order) for order in range(3)])
        rigid, loads, inertia = model.efforts(list(stretch.positions), smooth)
        own = [list(stretch.positions).index(joint) for joint in model.joints]
        position, speed, change = smooth[:, :, own]
        columns = np.stack([change, speed, np.sign(speed), np.ones_like(speed)], axis=2)
        stride = max(1, round(self._width / stretch.interval_s))
        self.interval_s = stride * stretch.interval_s
        efforts = narrow(np.array([stretch.efforts[joint] for joint in model.joints]).T)
        self._efforts.append((efforts, stretch.interval_s))
        kept = [wide(values)[::stride] for values in (rigid, columns, loads, speed)]
        # The share of a motion in fourth differences is far below noise.
        noise = np.diff(positions[:, own], 4, axis=0).var(axis=0) / _FOURTH
        gains = np.array([[narrow.combined(order, wide)] for order in (2, 1)])
        return *kept, inertia, gains * noise, position.min(axis=0), position.max(axis=0)

    def efforts(self, intervals: float) -> FloatArray:
        """
        Return the recorded efforts, filtered.

        :param intervals: by which they lag behind the states
        :returns: shape (t, n)
        """
        found = []
        for efforts, interval in self._efforts:
            stride = max(1, round(self._width / interval))
            found.append(self._wide(interval, intervals * interval)(efforts)[::stride])
        return np.concatenate(found)


class _Sums:
    """
    Sums of squares and products, by block of time and joint, from which any fit is solved.

    :param rows: that are fitted
    :param efforts: what the rigid model leaves, shape (t, n)
    """

    def __init__(self, rows: _Rows, efforts: FloatArray, fitted: int) -> None:
        joints, self._kinds = rows.columns.shape[1:]
        width = self._kinds + rows.loads.shape[2] + 1
        self._sums = np.zeros((_BLOCKS, joints, width, width))
        self._counts = np.zeros((_BLOCKS, joints))
        for block, part in enumerate(np.array_split(np.arange(fitted), _BLOCKS)):
            for joint in range(joints):
                used = part[rows.moving[part, joint]]
                table = np.column_stack([rows.columns[used, joint], rows.loads[used, joint],
                                         efforts[used, joint]])
                self._sums[block, joint] = table.T @ table
                self._counts[block, joint] = len(used)
        self._take_off_noise(rows)

    def _take_off_noise(self, rows: _Rows) -> None:
        """Take off the addition of noise of the positions, which would make links seem lighter."""
        for column in range(2):
            self._sums[..., column, column] -= self._counts * rows.noise[column]
        common = self._counts * rows.inertia * rows.noise[0]
        self._sums[..., 0, -1] += common
        self._sums[..., -1, 0] += common

    @property
    def count(self) -> FloatArray:
        """Number of rows of each joint, shape (n,)."""
        return np.asarray(self._counts.sum(axis=0))

    def solve(self, weights: FloatArray | None = None, without: int | None = None) -> FloatArray:
        """
        Return the values that fit best.

        :param weights: of the joints' squares, with payloads; None for a fit without them
        :param without: block that is left out
        :returns: of all joints by kind, one after the other, and then of the payloads
        """
        sums = self._sums.sum(axis=0) - (0.0 if without is None else self._sums[without])
        kinds, joints = self._kinds, len(sums)
        loads = 0 if weights is None else sums.shape[1] - kinds - 1
        size = kinds * joints
        matrix, right = np.zeros((size + loads, size + loads)), np.zeros(size + loads)
        for joint, of_joint in enumerate(sums):
            weight = 1.0 if weights is None else weights[joint]
            own = slice(joint * kinds, (joint + 1) * kinds)
            matrix[own, own] = weight * of_joint[:kinds, :kinds]
            right[own] = weight * of_joint[:kinds, -1]
            if loads:
                matrix[own, size:] = weight * of_joint[:kinds, kinds:-1]
                matrix[size:, own] = matrix[own, size:].T
                matrix[size:, size:] += weight * of_joint[kinds:-1, kinds:-1]
                right[size:] += weight * of_joint[kinds:-1, -1]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
        return np.asarray(scale * (np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-10,
                                                  hermitian=True) @ (scale * right)))

    def squares(self, found: FloatArray) -> FloatArray:
        """Return the mean square of what values leave of the effort of each joint, shape (n,)."""
        kinds, sums = self._kinds, self._sums.sum(axis=0)
        joints = len(sums)
        loads = np.zeros(sums.shape[1] - kinds - 1)
        loads[:len(found) - kinds * joints] = found[kinds * joints:]
        left = np.array([np.concatenate([found[j * kinds:(j + 1) * kinds], loads, [-1.0]])
                         for j in range(joints)])
        return np.asarray(np.einsum('ji,jik,jk->j', left, sums, left) / np.maximum(self.count, 1))

    def errors(self, weights: FloatArray | None = None) -> FloatArray:
        """Return standard errors of :meth:`solve`, by leaving out one block after the other."""
        found = np.array([self.solve(weights, block) for block in range(_BLOCKS)])
        return np.asarray(np.sqrt((_BLOCKS - 1) * found.var(axis=0)))


def identify(motion: RecordedMotion, model: RigidModel, cutoff_hz: float = CUTOFF_HZ,
             payload: bool = False, progress: Callable[[int], object] = lambda done: None
             ) -> Identification:
    """
    Return friction, rotor inertia and payload that explain recorded efforts.

    :param motion: that was recorded
    :param model: of the robot
    :param cutoff_hz: of the low-pass filter of efforts and model, at half of the power [Hz]
    :param payload: whether a payload at each flange is identified too
    :param progress: is called with the number of states that are done
    :raises ModelError: if the record is too short, or the robot stands still in it
    """
    rows = _Rows(motion, model, _HALF_POWER / cutoff_hz, progress)
    fitted = round((1.0 - _HELD_OUT) * len(rows.rigid))
    if fitted * rows.interval_s < _SHORTEST_S:
        raise ModelError(f'the record is too short: {fitted * rows.interval_s:.1f} s can be '
                         f'fitted, and it takes {_SHORTEST_S:g} s')
    if (rows.travel < _LEAST_MOTION).all():
        raise ModelError(f'the robot stands still: no joint moves by {_LEAST_MOTION:g} rad or m')
    lag = _find_lag(rows, fitted)
    efforts = rows.efforts(lag)
    sums = _Sums(rows, efforts - rows.rigid, fitted)
    alone = sums.solve()
    weights = 1.0 / np.maximum(sums.squares(alone), 1e-12)
    loaded = sums.solve(weights) if model.arms else alone
    found = loaded if payload else alone
    errors = sums.errors(weights if payload else None)
    size = len(KINDS) * len(model.joints)
    left = efforts - rows.rigid - np.einsum(
        'tnk,nk->tn', rows.columns, found[:size].reshape(-1, len(KINDS)))
    if payload:
        left -= rows.loads @ found[size:]
    joints = [_joint_fit(rows, model, sums, efforts, left, fitted, index, (
        found[index * len(KINDS):][:len(KINDS)], errors[index * len(KINDS):][:len(KINDS)]))
        for index in range(len(model.joints))]
    payloads = _payloads(model.arms, found[size:], errors[size:]) if payload else []
    hints = []
    if model.arms and not payload:
        better = (sums.squares(loaded) * weights * sums.count).sum() / sums.count.sum()
        if better < _BETTER:
            hints = [load for load in _payloads(
                model.arms, loaded[size:], sums.errors(weights)[size:]) if load.counts]
    return Identification(joints, payloads, hints, lag * motion.stretches[0].interval_s,
                          fitted * rows.interval_s, (len(rows.rigid) - fitted) * rows.interval_s)


def _find_lag(rows: _Rows, fitted: int) -> float:
    """Return the number of intervals by which efforts lag behind the states, by golden section."""
    def misfit(lag: float) -> float:
        sums = _Sums(rows, rows.efforts(lag) - rows.rigid, fitted)
        squares = np.maximum(sums.squares(sums.solve()), 1e-18)
        return float(sums.count @ np.log(squares))
    low, high, share = -_LAG, _LAG, (math.sqrt(5.0) - 1.0) / 2.0
    inner = [high - share * (high - low), low + share * (high - low)]
    values = [misfit(lag) for lag in inner]
    while high - low > 0.02:
        if values[0] < values[1]:
            high, inner = inner[1], [inner[1] - share * (inner[1] - low), inner[0]]
            values = [misfit(inner[0]), values[0]]
        else:
            low, inner = inner[0], [inner[1], inner[0] + share * (high - inner[0])]
            values = [values[1], misfit(inner[1])]
    return 0.5 * (low + high)


def _joint_fit(rows: _Rows, model: RigidModel, sums: _Sums, efforts: FloatArray, left: FloatArray,
               fitted: int, index: int, found: tuple[FloatArray, FloatArray]) -> JointFit:
    name, used = model.joints[index], rows.moving[:, index]
    before, reason = model.before[name], _reason(rows, fitted, index)
    limit = model.limits[index]
    if not math.isfinite(limit):
        limit = float(np.abs(efforts[:, index]).max())
    scale = {'armature': rows.inertia[index] + before['armature'],
             'damping': limit / max(rows.most[index], 1e-9), 'frictionloss': limit,
             'offset': limit}
    values = {}
    for kind, value, error in zip(KINDS, *found):
        why, tolerance = reason, _SURE[kind] * scale[kind]
        if not why and error > tolerance:
            why = f'the standard error would be {error:.2g}'
        if kind == 'armature':
            value -= model.late_s * found[0][KINDS.index('damping')]
        off = _LEFT * scale[kind] if kind == 'armature' else 0.0
        values[kind] = Value(
            None if why else float(value), float(error), before[kind], float(tolerance), why,
            float(_SURELY * error + off), 0.0 if why or kind == 'offset' else _more(
                max(abs(value), before[kind]), error, tolerance, off))
    late = used & (np.arange(len(used)) >= fitted)
    plain = efforts[:, index] - rows.rigid[:, index] - rows.columns[:, index] @ [
        before[kind] + (model.late_s * before['damping'] if kind == 'armature' else 0.0)
        for kind in KINDS]
    rest, whole = left[late, index], efforts[late, index]
    spread = float(whole.var()) if len(whole) else 0.0
    return JointFit(
        name, values, _rms(left[:fitted, index][used[:fitted]]), _rms(rest), _rms(plain[late]),
        1.0 - float(rest.var()) / spread if spread else math.nan)


def _more(value: float, error: float, tolerance: float, off: float) -> float:
    """Return the factor of the record's length with which a value is told to the wanted share."""
    room = max(_WANTED * value - off, _NO_MATTER * tolerance)
    return float((_SURELY * error / room) ** 2)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _reason(rows: _Rows, fitted: int, index: int) -> str:
    """Return why nothing can be told of a joint, or nothing."""
    if rows.travel[index] < _LEAST_MOTION:
        return f'it moves by {rows.travel[index]:.2g} only'
    signs = rows.columns[:fitted, index, 2][rows.moving[:fitted, index]]
    if len(signs) < _LEAST_ROWS:
        return f'it moves for {len(signs) * rows.interval_s:.1f} s only'
    if min(np.mean(signs > 0.0), np.mean(signs < 0.0)) < _LEAST_SHARE:
        return 'it moves in one direction only'
    return ''


def _payloads(arms: Sequence[str], found: FloatArray, errors: FloatArray) -> list[PayloadFit]:
    payloads = []
    for index, arm in enumerate(arms):
        own = slice(index * _PAYLOAD, index * _PAYLOAD + 4)
        (mass, *moments), (error, *of_moments) = found[own], errors[own]
        size = max(abs(mass), 1e-9)
        center = [Value(float(moment / mass) if mass else None, float(of_moment / size))
                  for moment, of_moment in zip(moments, of_moments)]
        payloads.append(PayloadFit(arm, Value(float(mass), float(error)),
                                   (center[0], center[1], center[2])))
    return payloads
