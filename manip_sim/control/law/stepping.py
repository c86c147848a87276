# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Physics steps in compiled code, which note forces on tools.

Whole control periods remember the state that they begin with, and compute all of that they end in.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding
import mujoco
from numba import types
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.compiling import inlined, inner
from manip_sim.control.law.records import PLAIN
from manip_sim.control.law.seat import exert_all, feel_all
from manip_sim.physics.physics import Addresses

#: Numbers of contacts by which their place is recognized.
_MARKS = (987654321, 0)
#: The options of a model have fewer words from gravity on.
_MOST_OPTIONS = 100
_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
#: Share of the memory of ``MjData`` that may have been used so far.
_MEMORY = 0.5
#: Sum of the squares of velocities from which on somebody has to look [(rad/s or m/s)^2].
_ABSURD = 1e8
#: Parts of a step that have been computed: its first half, or all but its integration.
RESUMED, INTEGRATES = 1, 2
#: Functions of MuJoCo that compiled code calls, with the addresses of an ``MjModel`` and an
#: ``MjData``; and one that takes where to write a state, and which parts of it.
_CALLED = ('mj_step', 'mj_step1', 'mj_step2', 'mj_kinematics', 'mj_comPos', 'mj_forward',
           'mj_implicit')
_GET_STATE = 'mj_getState'


def _library() -> ctypes.CDLL:
    """
    Return MuJoCo's library, as its package has loaded it.

    :raises ImportError: if it is neither in the package nor known by its name
    """
    folder = Path(mujoco.__path__[0])
    paths = sorted((*folder.glob('libmujoco*'), *folder.glob('mujoco.dll')))
    name = str(paths[0]) if paths else f'libmujoco.so.{mujoco.mj_versionString()}'
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise ImportError(f"control laws call MuJoCo's library, which is not in {folder}, and "
                          f'not known as {name}: {error}') from error


def _function(name: str, *kinds: Any) -> Any:
    """Return a function of MuJoCo, which compiled code calls by name, so that it can be kept."""
    function = getattr(_library(), name)
    if PLAIN:
        return lambda *values: function(*[ctypes.c_size_t(int(value)) for value in values])
    llvmlite.binding.add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
    return types.ExternalFunction(name, types.void(*kinds))


_mj_step, _mj_step1, _mj_step2, _mj_kinematics, _mj_com_pos, _mj_forward, _mj_implicit = (
    _function(name, types.uintp, types.uintp) for name in _CALLED)
_mj_get_state = _function(
    _GET_STATE, types.uintp, types.uintp, types.uintp, types.int32)


class Notes(NamedTuple):
    """
    Notes of forces on tools in steps, and views in ``MjData``.

    :ivar contacts: number of all contacts, a view into ``MjData``, shape (1,)
    :ivar forces: ``cfrc_ext``, external forces on bodies, a view, shape (nbody, 6)
    :ivar centers: ``subtree_com``, a view [m], shape (nbody, 3)
    :ivar tools: of each tool the first body, the one after its last, and the root of its tree,
        shape (t, 3)
    :ivar counts: in how many steps something has touched each tool, shape (t,)
    :ivar rows: the forces on its bodies in these, shape (t, steps, m, 6)
    :ivar roots: where the centre of mass of its tree was then, shape (t, steps, 3)
    """

    contacts: NDArray[np.int32]
    forces: FloatArray
    centers: FloatArray
    tools: IntArray
    counts: IntArray
    rows: FloatArray
    roots: FloatArray


class LastStep(NamedTuple):
    """
    Efforts of actuators and what they depend on, as views, and room for those of the last step.

    :ivar acted: ``qfrc_actuator``, shape (nv,)
    :ivar velocities: ``qvel``, shape (nv,)
    :ivar forces: ``actuator_force``, shape (nu,)
    :ivar speeds: ``actuator_velocity``, shape (nu,)
    :ivar biases: ``actuator_biasprm``, shape (nu, k)
    :ivar ranges: ``actuator_forcerange``, shape (nu, 2)
    :ivar limited: ``actuator_forcelimited``, shape (nu,)
    :ivar kinds: ``actuator_biastype``, shape (nu,)
    :ivar moments: ``actuator_moment``, shape (m,)
    :ivar counts: ``moment_rownnz``, shape (nu,)
    :ivar begins: ``moment_rowadr``, shape (nu,)
    :ivar dofs: ``moment_colind``, shape (m,)
    :ivar joint_limited: ``jnt_actfrclimited``, shape (njnt,)
    :ivar joint_dofs: ``jnt_dofadr``, shape (njnt,)
    :ivar joint_ranges: ``jnt_actfrcrange``, shape (njnt, 2)
    :ivar last: of the last step, the first four, damping, ranges and limits one after another
    :ivar stale: whether that was noted and efforts have not been computed of it, shape (1,)
    :ivar values: the efforts, shape (nv,)
    :ivar rules: as ``ActuatorEfforts.rules``, shape (3,)
    """

    acted: FloatArray
    velocities: FloatArray
    forces: FloatArray
    speeds: FloatArray
    biases: FloatArray
    ranges: FloatArray
    limited: NDArray[Any]
    kinds: NDArray[np.int32]
    moments: FloatArray
    counts: NDArray[np.int32]
    begins: NDArray[np.int32]
    dofs: NDArray[np.int32]
    joint_limited: NDArray[Any]
    joint_dofs: NDArray[np.int32]
    joint_ranges: FloatArray
    last: FloatArray
    stale: BoolArray
    values: FloatArray
    rules: BoolArray

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, last: FloatArray, stale: BoolArray,
           values: FloatArray, rules: BoolArray) -> LastStep:
        """Return the views of a model and its data."""
        return cls(data.qfrc_actuator, data.qvel, data.actuator_force, data.actuator_velocity,
                   model.actuator_biasprm, model.actuator_forcerange,
                   model.actuator_forcelimited, model.actuator_biastype, data.actuator_moment,
                   data.moment_rownnz, data.moment_rowadr, data.moment_colind,
                   model.jnt_actfrclimited, model.jnt_dofadr, model.jnt_actfrcrange, last, stale,
                   values, rules)


class Watch(NamedTuple):
    """
    The state that a period begins with, and what is computed of the one that it ends in.

    :ivar good: the state at its beginning, shape (n,)
    :ivar computed: the state that all of an instant was computed from last, shape (n,)
    :ivar first_half: begins and ends of the parts of it that ``mj_step1`` depends on, (p, 2)
    :ivar parts: the parts that the state consists of, as MuJoCo numbers them
    :ivar positions: ``qpos``, shape (nq,)
    :ivar accelerations: ``qacc``, shape (nv,)
    :ivar warnings: how often MuJoCo has warned of bad numbers, each second number, (2 w - 1,)
    :ivar warned: how often it had at the beginning, shape (w,)
    :ivar last_step: what becomes of the efforts of actuators
    """

    good: FloatArray
    computed: FloatArray
    first_half: IntArray
    parts: int
    positions: FloatArray
    accelerations: FloatArray
    warnings: NDArray[np.int32]
    warned: NDArray[np.int32]
    last_step: LastStep


def words_of(address: int, count: int) -> NDArray[np.int32]:
    """Return a view of some numbers of 32 bits in memory of MuJoCo."""
    return np.ctypeslib.as_array((ctypes.c_int32 * count).from_address(address))


@cache
def _place_of_contacts() -> int | None:
    """Return where the number of contacts is in ``MjData`` [bytes]; None if it is not found."""
    data = mujoco.MjData(mujoco.MjModel.from_xml_string('<mujoco/>'))
    # It follows the timers, of which there is a view.
    timers = data.timer.duration
    address = timers.ctypes.data + len(timers) * timers.strides[0]
    number = ctypes.c_int32.from_address(address)
    for mark in _MARKS:
        data.ncon = mark
        if number.value != mark:
            return None
    return int(address - data._address)


@cache
def _count_of_options() -> int:
    """Return how many words of the options of a model follow one another, from gravity on."""
    model = mujoco.MjModel.from_xml_string('<mujoco/>')
    words = options_of(model, _MOST_OPTIONS)
    before = words.copy()
    model.opt.integrator, model.opt.enableflags = mujoco.mjtIntegrator.mjINT_RK4, _MARKS[0]
    changed = np.flatnonzero(words != before)
    return int(changed[-1]) + 1 if len(changed) == 2 else 0


def options_of(model: mujoco.MjModel, count: int | None = None) -> NDArray[np.int32]:
    """
    Return a view of the options of a model from gravity to its flags, as words of 32 bits.

    :param count: of the words; None for all; none if their order is not known
    """
    return words_of(model.opt.gravity.ctypes.data, _count_of_options() if count is None else count)


def may_step(data: mujoco.MjData) -> bool:
    """Return whether compiled code may run steps."""
    # Out of memory, MuJoCo ends the process, where Python would get an exception.
    return _place_of_contacts() is not None and data.maxuse_arena <= _MEMORY * data.narena


def notes_of(data: mujoco.MjData, tools: IntArray, steps: int) -> Notes:
    """
    Return room for the notes of steps, if compiled code may run them.

    :param tools: as in :class:`Notes`
    :param steps: how many there will be at most
    """
    contacts = words_of(data._address + (_place_of_contacts() or 0), 1)
    count, bodies = len(tools), int((tools[:, 1] - tools[:, 0]).max(initial=0))
    return Notes(contacts, data.cfrc_ext, data.subtree_com, tools,
                 np.zeros(count, np.int64),
                 np.empty((count, steps, bodies, 6)), np.empty((count, steps, 3)))


@inner
def any_force(forces: FloatArray, first: int, end: int) -> bool:
    """Return whether any force on some bodies is not zero."""
    for body in range(first, end):
        for k in range(6):
            if forces[body, k] != 0.0:
                return True
    return False


@inlined
def _note(notes: Notes) -> None:
    """Note the forces on tools that something touches."""
    tools = notes.tools
    if notes.contacts[0] == 0:
        return
    for tool in range(len(tools)):
        first, end = tools[tool, 0], tools[tool, 1]
        if any_force(notes.forces, first, end):
            number = notes.counts[tool]
            notes.counts[tool] = number + 1
            for k in range(3):
                notes.roots[tool, number, k] = notes.centers[tools[tool, 2], k]
            for body in range(first, end):
                for k in range(6):
                    notes.rows[tool, number, body - first, k] = notes.forces[body, k]


@inlined
def take_steps(addresses: Addresses, steps: int, resumes: int, notes: Notes, seats: IntArray,
               now: float, step_s: float) -> bool:
    """
    Run physics steps.

    :param resumes: what of the first step has been computed, by :func:`remember`
    :param seats: addresses of the rows of laws of users, shape (s,)
    :param now: simulation time since the last reset [s]
    :param step_s: length of a step [s]
    :returns: whether any of these laws has failed
    """
    failed = False
    for number in range(steps):
        halved = resumes != 0 and number == 0
        if len(seats):
            if not halved:
                _mj_step1(addresses.model, addresses.data)
            exert_all(seats, now + number * step_s, number / steps)
            halved = True
        if halved and resumes == INTEGRATES:
            _mj_implicit(addresses.model, addresses.data)
        elif halved:
            _mj_step2(addresses.model, addresses.data)
        else:
            _mj_step(addresses.model, addresses.data)
        if len(seats):
            failed = feel_all(seats)
        _note(notes)
    return failed


@inner
def find_places(addresses: Addresses) -> None:
    """Compute where bodies and sites are in the scratch, and the motions of joints."""
    _mj_kinematics(addresses.model, addresses.scratch)
    _mj_com_pos(addresses.model, addresses.scratch)


@inner
def _same(first: FloatArray, second: FloatArray, begin: int, end: int) -> bool:
    """Return whether parts of two states have the same bits."""
    ones, others = first.view(np.int64), second.view(np.int64)
    for k in range(begin, end):
        if ones[k] != others[k]:
            break
    else:
        return True
    return False


@inner
def remember(addresses: Addresses, watch: Watch, most: int) -> int:
    """
    Remember the state that a period begins with.

    :param most: what of a step may have been computed
    :returns: what has been computed for that state: nothing, its first half, or all but its
        integration
    """
    _mj_get_state(addresses.model, addresses.data, watch.good.ctypes.data, watch.parts)
    for kind in range(len(watch.warned)):
        watch.warned[kind] = watch.warnings[2 * kind]
    if most == INTEGRATES and _same(watch.good, watch.computed, 0, len(watch.good)):
        return INTEGRATES
    for k in range(len(watch.first_half)):
        if not _same(watch.good, watch.computed, watch.first_half[k, 0], watch.first_half[k, 1]):
            return 0
    return min(most, RESUMED)


@inner
def compute_end(addresses: Addresses, watch: Watch) -> bool:
    """
    Compute all of the instant in which a period ends.

    :returns: whether it is good; else somebody has to look whether the physics has diverged
    """
    _record(watch.last_step)
    _mj_get_state(addresses.model, addresses.data, watch.computed.ctypes.data, watch.parts)
    _mj_forward(addresses.model, addresses.data)
    _compute_efforts(watch.last_step)
    for kind in range(len(watch.warned)):
        if watch.warned[kind] != watch.warnings[2 * kind]:
            return False
    position, velocity, acceleration = 0.0, 0.0, 0.0
    for k in range(len(watch.positions)):
        position += watch.positions[k] * watch.positions[k]
    for k in range(len(watch.accelerations)):
        speed, change = watch.last_step.velocities[k], watch.accelerations[k]
        velocity += speed * speed
        acceleration += change * change
    return velocity < _ABSURD and np.isfinite(position + acceleration)


@inner
def _record(step: LastStep) -> None:
    """Note the efforts of the last step, and what they depend on."""
    last, joints, actuators = step.last, len(step.acted), len(step.forces)
    step.stale[0] = True
    for k in range(joints):
        last[k], last[joints + k] = step.acted[k], step.velocities[k]
    place = 2 * joints
    for k in range(actuators):
        last[place + k], last[place + actuators + k] = step.forces[k], step.speeds[k]
        last[place + 2 * actuators + k] = step.biases[k, 2]
        last[place + 3 * actuators + 2 * k] = step.ranges[k, 0]
        last[place + 3 * actuators + 2 * k + 1] = step.ranges[k, 1]
        last[place + 5 * actuators + k] = step.limited[k]


@inner
def _compute_efforts(step: LastStep) -> None:
    """Compute the efforts of the last step as ``efforts.compute`` does, with the same bits."""
    last, values, joints, actuators = step.last, step.values, len(step.acted), len(step.forces)
    for k in range(joints):
        values[k] = 0.0
    for actuator in range(actuators):
        place, begin = 2 * joints + actuator, step.begins[actuator]
        low, high = step.ranges[actuator, 0], step.ranges[actuator, 1]
        if not step.rules[0] or step.kinds[actuator] != _AFFINE or (
                step.rules[1] and step.limited[actuator] and not low < last[place] < high):
            continue
        speed = 0.0
        for k in range(begin, begin + step.counts[actuator]):
            speed += step.moments[k] * last[joints + step.dofs[k]]
        missing = step.biases[actuator, 2] * (speed - last[place + actuators])
        for k in range(begin, begin + step.counts[actuator]):
            values[step.dofs[k]] += step.moments[k] * missing
    for joint in range(len(step.joint_limited)):
        dof = step.joint_dofs[joint]
        if step.rules[2] and step.joint_limited[joint] and not (
                step.joint_ranges[joint, 0] < last[dof] < step.joint_ranges[joint, 1]):
            values[dof] = 0.0
    for k in range(joints):
        values[k] += last[k]
    step.stale[0] = False
