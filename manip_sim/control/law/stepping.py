# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Physics steps in compiled code, which note contacts and forces on tools."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import NamedTuple

import llvmlite.binding
import mujoco
from numba import types
from numba.core import config
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.physics.physics import Addresses

#: Numbers of contacts by which their place is recognized.
_MARKS = (987654321, 0)
#: Share of the memory of ``MjData`` that may have been used so far.
_MEMORY = 0.5
#: Functions of MuJoCo that compiled code calls, with the addresses of an ``MjModel`` and an
#: ``MjData``.
_CALLED = ('mj_step', 'mj_step2', 'mj_kinematics', 'mj_comPos')


def _load_steps() -> bool:
    """Let compiled code call MuJoCo by name, so that numba can keep it; return False if not."""
    for path in sorted(Path(mujoco.__path__[0]).glob('libmujoco*')):
        library = ctypes.CDLL(str(path))
        for name in _CALLED:
            llvmlite.binding.add_symbol(
                name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
        return True
    return False


#: False where MuJoCo's library lies elsewhere than in its package.
_LOADED = _load_steps()
_mj_step, _mj_step2, _mj_kinematics, _mj_com_pos = (
    types.ExternalFunction(name, types.void(types.uintp, types.uintp)) for name in _CALLED)


class Notes(NamedTuple):
    """
    Notes of contacts and of forces on tools in steps, and views of both in ``MjData``.

    :ivar contacts: number of all contacts, a view into ``MjData``, shape (1,)
    :ivar forces: ``cfrc_ext``, external forces on bodies, a view, shape (nbody, 6)
    :ivar centers: ``subtree_com``, a view [m], shape (nbody, 3)
    :ivar tools: of each tool the first body, the one after its last, and the root of its tree,
        shape (t, 3)
    :ivar present: number of contacts after the last step, and 1 if that has changed, shape (2,)
    :ivar counts: in how many steps something has touched each tool, shape (t,)
    :ivar rows: the forces on its bodies in these, shape (t, steps, m, 6)
    :ivar roots: where the centre of mass of its tree was then, shape (t, steps, 3)
    """

    contacts: NDArray[np.int32]
    forces: FloatArray
    centers: FloatArray
    tools: IntArray
    present: IntArray
    counts: IntArray
    rows: FloatArray
    roots: FloatArray


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


def may_step(data: mujoco.MjData) -> bool:
    """Return whether compiled code may run steps."""
    # Out of memory, MuJoCo ends the process, where Python would get an exception.
    return (data.maxuse_arena <= _MEMORY * data.narena and not config.DISABLE_JIT and _LOADED
            and _place_of_contacts() is not None)


def notes_of(data: mujoco.MjData, tools: IntArray, steps: int) -> Notes:
    """
    Return room for the notes of steps, if compiled code may run them.

    :param tools: as in :class:`Notes`
    :param steps: how many there will be at most
    """
    words = (ctypes.c_int32 * 1).from_address(data._address + (_place_of_contacts() or 0))
    count, bodies = len(tools), int((tools[:, 1] - tools[:, 0]).max(initial=0))
    return Notes(np.ctypeslib.as_array(words), data.cfrc_ext, data.subtree_com, tools,
                 np.zeros(2, np.int64), np.zeros(count, np.int64),
                 np.empty((count, steps, bodies, 6)), np.empty((count, steps, 3)))


@inner
def begin_notes(notes: Notes) -> None:
    """Begin to note what happens from now on."""
    notes.present[0], notes.present[1] = notes.contacts[0], 0
    for tool in range(len(notes.counts)):
        notes.counts[tool] = 0


@inner
def _touches(forces: FloatArray, first: int, end: int) -> bool:
    """Return whether any force on some bodies is not zero."""
    for body in range(first, end):
        for k in range(6):
            if forces[body, k] != 0.0:
                return True
    return False


@inner
def _note(notes: Notes) -> None:
    """Note contacts that came or went, and the forces on tools that something touches."""
    contacts, present, tools = notes.contacts[0], notes.present, notes.tools
    if contacts != present[0]:
        present[0], present[1] = contacts, 1
    if contacts == 0:
        return
    for tool in range(len(tools)):
        first, end = tools[tool, 0], tools[tool, 1]
        if _touches(notes.forces, first, end):
            number = notes.counts[tool]
            notes.counts[tool] = number + 1
            for k in range(3):
                notes.roots[tool, number, k] = notes.centers[tools[tool, 2], k]
            for body in range(first, end):
                for k in range(6):
                    notes.rows[tool, number, body - first, k] = notes.forces[body, k]


@inner
def take_steps(addresses: Addresses, steps: int, resumes: bool, notes: Notes) -> None:
    """
    Run physics steps.

    :param resumes: whether the first half of the first step has been computed
    """
    for number in range(steps):
        if resumes and number == 0:
            _mj_step2(addresses.model, addresses.data)
        else:
            _mj_step(addresses.model, addresses.data)
        _note(notes)


@compiled
def step(addresses: Addresses, steps: int, resumes: bool, notes: Notes) -> None:
    """
    Run physics steps.

    :param resumes: whether the first half of the first step has been computed
    """
    begin_notes(notes)
    take_steps(addresses, steps, resumes, notes)


@inner
def find_places(addresses: Addresses) -> None:
    """Compute where bodies and sites are in the scratch, and the motions of joints."""
    _mj_kinematics(addresses.model, addresses.scratch)
    _mj_com_pos(addresses.model, addresses.scratch)
