# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Physics steps in compiled code: operational space control in each interval, without Python."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding
import mujoco
from numba import types
from numba.core import config
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.arm_records import Arm, Goal, Motion, Spring
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.operational_space import exert
from manip_sim.physics.physics import WorldArrays

#: A number of contacts that no world has, and how many words of ``MjData`` to look for it in.
_MARK, _WORDS = 987654321, 45000

#: Share of the memory of ``MjData`` that may have been used so far.
_MEMORY = 0.5


def _load_mj_step() -> bool:
    """Let compiled code call MuJoCo by name, so that numba can keep it; return False if not."""
    for library in sorted(Path(mujoco.__path__[0]).glob('libmujoco*')):
        address = ctypes.cast(ctypes.CDLL(str(library)).mj_step, ctypes.c_void_p).value
        llvmlite.binding.add_symbol('mj_step', address)
        return True
    return False


#: False where MuJoCo's library lies elsewhere than in its package.
_LOADED = _load_mj_step()
_mj_step = types.ExternalFunction('mj_step', types.void(types.uintp, types.uintp))


class Touch(NamedTuple):
    """
    Contact forces on a tool, and the arrays that note them.

    :ivar contacts: number of all contacts, a view into ``MjData``, shape (1,)
    :ivar forces: on the bodies of the tool, a view, shape (m, 6)
    :ivar centre: that these are about [m], a view, shape (3,)
    :ivar rows: the forces of each step that are not zero, shape (steps, m, 6)
    :ivar centres: where the centre was then, shape (steps, 3)
    """

    contacts: NDArray[np.int32]
    forces: FloatArray
    centre: FloatArray
    rows: FloatArray
    centres: FloatArray


@cache
def _place_of_contacts() -> int | None:
    """Return where the number of contacts is in ``MjData`` [bytes]; None if it is not found."""
    data = mujoco.MjData(mujoco.MjModel.from_xml_string('<mujoco/>'))
    words = (ctypes.c_int32 * _WORDS).from_address(data._address)
    data.ncon = _MARK
    found = [place for place in range(_WORDS) if words[place] == _MARK]
    data.ncon = 0
    return 4 * found[0] if len(found) == 1 and words[found[0]] == 0 else None


def touch_of(data: mujoco.MjData, forces: FloatArray, centre: FloatArray, steps: int
             ) -> Touch | None:
    """
    Return what :func:`step_and_exert` needs, or None where it cannot be used.

    :param forces: on the bodies of the tool, a view, shape (m, 6)
    :param centre: that these are about [m], a view, shape (3,)
    :param steps: how many there will be
    """
    place = None if config.DISABLE_JIT or not _LOADED else _place_of_contacts()
    # Out of memory, MuJoCo ends the process, where Python would get an exception.
    if place is None or data.maxuse_arena > _MEMORY * data.narena:
        return None
    words = (ctypes.c_int32 * 1).from_address(data._address + place)
    return Touch(np.ctypeslib.as_array(words), forces, centre,
                 np.empty((steps, *forces.shape)), np.empty((steps, 3)))


@inner
def _touches(forces: FloatArray) -> bool:
    """Return whether any force is not zero."""
    for body in range(forces.shape[0]):
        for k in range(6):
            if forces[body, k] != 0.0:
                return True
    return False


@inner
def _note(touch: Touch, number: int) -> None:
    """Note the forces on a tool."""
    for k in range(3):
        touch.centres[number, k] = touch.centre[k]
    for body in range(touch.forces.shape[0]):
        for k in range(6):
            touch.rows[number, body, k] = touch.forces[body, k]


@compiled
def step_and_exert(model: int, data: int, intervals: IntArray, world: WorldArrays, arm: Arm,
                   place: FloatArray, turned: FloatArray, goal: Goal, postures: FloatArray,
                   spring: Spring, rested: bool, motion: Motion, activations: IntArray,
                   gear: FloatArray, touch: Touch) -> tuple[bool, int, bool]:
    """
    Exert efforts and run the physics of intervals.

    :param model: address of the ``MjModel``, ``data`` of its ``MjData``
    :param intervals: steps of each, shape (k,)
    :param place: position of the end effector in the world, a view; see :func:`exert`, as for the
        others
    :param activations: addresses of the actuators in ``act``, shape (n,)
    :param gear: of these, shape (n,)
    :returns: whether the end effector is as near as it can come, in how many steps something
        touched the tool, and whether contacts came or went
    """
    count, changed, contacts = 0, False, touch.contacts[0]
    for steps in intervals:
        rested, _, _ = exert(world, arm, place, turned, goal, postures, spring, rested, motion)
        for i in range(len(activations)):
            world.activations[activations[i]] = motion.efforts[i] / gear[i]
        for _ in range(steps):
            _mj_step(model, data)
            if touch.contacts[0] != contacts:
                changed, contacts = True, touch.contacts[0]
            if contacts > 0 and _touches(touch.forces):
                _note(touch, count)
                count += 1
    return rested, count, changed


def addresses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Any, Any]:
    """Return the addresses of a model and its data for :func:`step_and_exert`."""
    return np.uintp(model._address), np.uintp(data._address)
