# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The model of a running world and its data, which all that simulates asks for here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import threading
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.derived import Derived
from manip_sim.physics.object_spawning import (
    carry_over, in_common, LiveWorld, start_live, WorldPlan)
#: All that MuJoCo integrates, with what its solvers start from.
PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)
#: State in compiled code of a world that goes on like in its last period: steps of that, 0 if
#: Python has to look; the address of its row; how often it has gone on; what the last call has
#: done: nothing, it went on, or it did and Python has to look at the end; and how often Python has
#: let it go on.
STEPS, ROW, PERIODS, BECAME, EPOCH = range(5)
STOOD, WENT_ON, ENDED = range(3)


class Kinematics(NamedTuple):
    """
    Arrays of ``MjData`` about where things are, as views.

    :ivar positions: ``qpos``, shape (nq,)
    :ivar motions: ``cdof``, shape (nv, 6)
    :ivar centers: ``subtree_com``, that these are about [m], shape (nbody, 3)
    :ivar bodies: ``xpos`` [m], shape (nbody, 3)
    :ivar body_axes: ``xmat``, shape (nbody, 3, 3)
    :ivar sites: ``site_xpos`` [m], shape (nsite, 3)
    :ivar site_axes: ``site_xmat``, shape (nsite, 3, 3)
    """

    positions: FloatArray
    motions: FloatArray
    centers: FloatArray
    bodies: FloatArray
    body_axes: FloatArray
    sites: FloatArray
    site_axes: FloatArray

    @classmethod
    def of(cls, data: mujoco.MjData) -> Kinematics:
        """Return the views into a ``mujoco.MjData``."""
        return cls(data.qpos, data.cdof, data.subtree_com, data.xpos,
                   data.xmat.reshape(-1, 3, 3), data.site_xpos, data.site_xmat.reshape(-1, 3, 3))


class WorldArrays(NamedTuple):
    """
    Arrays of ``MjData`` that laws of control read and write, as views.

    :ivar kinematics: where things are
    :ivar velocities: ``qvel``, shape (nv,)
    :ivar inertia: ``M``, shape (nM,)
    :ivar bias: ``qfrc_bias``, shape (nv,)
    :ivar carried: ``qfrc_gravcomp``, shape (nv,)
    :ivar constraints: ``qfrc_constraint``, shape (nv,)
    :ivar lengths: ``actuator_length``, shape (nu,)
    :ivar speeds: ``actuator_velocity``, shape (nu,)
    :ivar activations: ``act``, shape (na,)
    :ivar controls: ``ctrl``, shape (nu,)
    """

    kinematics: Kinematics
    velocities: FloatArray
    inertia: FloatArray
    bias: FloatArray
    carried: FloatArray
    constraints: FloatArray
    lengths: FloatArray
    speeds: FloatArray
    activations: FloatArray
    controls: FloatArray

    @classmethod
    def of(cls, data: mujoco.MjData) -> WorldArrays:
        """Return the views into a ``mujoco.MjData``."""
        return cls(Kinematics.of(data), data.qvel, data.M, data.qfrc_bias, data.qfrc_gravcomp,
                   data.qfrc_constraint, data.actuator_length, data.actuator_velocity, data.act,
                   data.ctrl)


def places_of_inertia(model: mujoco.MjModel, dofs: IntArray) -> IntArray:
    """Return where the inertia of degrees of freedom is in ``M``, -1 where it is zero, (n, n)."""
    places = np.full((model.nv, model.nv), -1)
    rows, columns = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
    places[rows, columns] = places[columns, rows] = np.arange(len(columns))
    return places[np.ix_(dofs, dofs)]


class Addresses(NamedTuple):
    """
    Addresses for compiled code.

    :ivar model: of the ``MjModel``
    :ivar data: of its ``MjData``
    :ivar scratch: of an ``MjData`` for the kinematics of other positions
    """

    model: Any
    data: Any
    scratch: Any


def address_of(found: mujoco.MjModel | mujoco.MjData) -> Any:
    """Return where a model or its data is."""
    return np.uintp(found._address)


#: Sizes of a model that decide how large the arrays of kinematics are.
_SIZES = ('nbuffer', 'nq', 'nv', 'nbody', 'njnt', 'ngeom', 'nsite', 'nmocap', 'nflexvert', 'nu')


class Scratch(NamedTuple):
    """
    Data in which kinematics is computed for other positions of joints.

    :ivar data: a ``mujoco.MjData``
    :ivar kinematics: views into it
    :ivar address: where it is
    :ivar derived: values made of it
    """

    data: mujoco.MjData
    kinematics: Kinematics
    address: Any
    derived: Derived


class _Kept(threading.local):
    """The scratch of a thread, and the sizes of its model."""

    sizes: tuple[int, ...] = ()
    scratch: Scratch | None = None


_kept = _Kept()


def _nothing() -> None:
    """Do nothing."""


class Physics:
    """
    Holder of model and data; nothing else keeps them, because others may replace them.

    Robots come first in every model, those from the start before others, so ids and addresses
    change only if a robot before is deleted. They, what depends on the number of other elements,
    such as arrays of shape (nv,), and views of arrays are made anew by what was registered with
    :meth:`on_change`.

    :param plan: the world at its start
    :ivar plan: what :attr:`model` was compiled from
    :ivar model: the ``mujoco.MjModel``
    :ivar data: its ``mujoco.MjData``
    :ivar qpos: view of its field, as the others are, so that it need not be fetched each time
    :ivar qvel: of ``qvel``
    :ivar ctrl: of ``ctrl``
    :ivar arrays: for laws of control
    :ivar sizes: worlds with the same ones can share the scratch of a thread
    :ivar standing: numbers by :data:`STEPS` and those that follow it, shape (5,)
    :ivar catch_up: takes over what compiled code has done in such periods
    :ivar places_at_begin: returns data with the kinematics at the beginning of the last period
    :ivar kept_dofs: where the degrees of freedom that stayed in the last change were in ``qvel``
        before it, and where they are now
    """

    places_at_begin: Callable[[], mujoco.MjData]

    def __init__(self, plan: WorldPlan) -> None:
        self._adapt: list[Callable[[], None]] = []
        self._derived = Derived()
        self.standing: IntArray = np.zeros(5, np.int64)
        self.catch_up: Callable[[], None] = _nothing
        self.kept_dofs: tuple[IntArray, IntArray] = (np.zeros(0, np.int64), np.zeros(0, np.int64))
        self._take(start_live(plan))

    def interrupt(self) -> None:
        """
        Let Python look before the next control period, which need not go on like the last one.

        Whoever changes what rows of compiled code were made of calls this before; so does whoever
        reads what they change.
        """
        if self.standing.item(STEPS):
            self.catch_up()
            self.standing[STEPS] = 0

    def _take(self, live: LiveWorld) -> None:
        self._derived.of.clear()
        self.plan: WorldPlan = live.plan
        self.model: mujoco.MjModel = live.model
        data = self.data = live.data
        self.qpos, self.qvel, self.ctrl = data.qpos, data.qvel, data.ctrl
        self.arrays = WorldArrays.of(data)
        self.sizes = tuple([getattr(self.model, size) for size in _SIZES])
        for adapt in self._adapt:
            adapt()

    @property
    def scratch(self) -> Scratch:
        """Data for kinematics of other positions, of this thread and of equal worlds."""
        scratch = _kept.scratch
        if scratch is None or _kept.sizes != self.sizes:
            data = mujoco.MjData(self.model)
            scratch = Scratch(data, Kinematics.of(data), address_of(data), Derived())
            _kept.sizes, _kept.scratch = self.sizes, scratch
        return scratch

    @property
    def addresses(self) -> Addresses:
        """Addresses for compiled code in this thread."""
        own: tuple[Any, Any] | None = self._derived.of.get('addresses')
        if own is None:
            own = self._derived.of['addresses'] = address_of(self.model), address_of(self.data)
        return Addresses(*own, self.scratch.address)

    def on_change(self, adapt: Callable[[], None]) -> None:
        """Call a function now, and each time the model and its data were replaced."""
        self._adapt.append(adapt)
        adapt()

    @contextmanager
    def collected(self) -> Iterator[list[Callable[[], None]]]:
        """Collect what :meth:`on_change` registers meanwhile; the caller has to call it."""
        before, self._adapt = self._adapt, []
        try:
            yield self._adapt
        finally:
            self._adapt = before

    def change(self, plan: WorldPlan) -> None:
        """Replace the model by that of another plan, and carry the state and edits over."""
        live = LiveWorld(self.plan, self.model, self.data)
        both = in_common(live, plan)
        carried = carry_over(live, plan, both)
        self.interrupt()
        _kept.scratch = None  # It keeps the model.
        self.kept_dofs = both.rows('nv', live.data.qvel, carried.data.qvel)
        self._take(carried)
