# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A user's law in the seat of a part: its inputs in a physics step, its call, and its efforts.

In each step ``mj_step1`` is followed by the law, and that by ``mj_step2``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import llvmlite.ir
import mujoco
import numba
from numba import types
from numba.core.base import BaseContext
from numba.extending import intrinsic
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.compiling import inlined, inner, Layout
from manip_sim.control.law.loads import carry, find_reaction, Loads, no_loads
from manip_sim.control.law.operational_space import find_jacobian
from manip_sim.control.law.records import Arm, blank_state, CHAIN, PLAIN, readable, records, SERVO
from manip_sim.physics.physics import WorldArrays

#: Status of a law: how often it was called, whether it runs now, and why its efforts are not used
#: any more, 0 for none.
CALLS, INSIDE, FAILED = range(3)
#: Why that is: it has raised an exception, or an effort is not finite.
RAISED, NOT_FINITE = 1, 2
#: Arguments that cost something, which are computed where the law reads them.
MASS, JACOBIAN, WRENCH = range(3)
#: The tip of a part: site of the end effector or -1, site of the sensor, first body of the tool,
#: the one after its last, root of its tree.
TIP, SENSOR, FIRST, END, ROOT = range(5)


class Arguments(NamedTuple):
    """
    The arguments of a law, arrays of its own.

    :ivar t: [s], shape (1,)
    :ivar q: shape (n,), as the others, see :func:`manip_sim.laws.law`
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    bias: FloatArray
    mass: FloatArray
    jacobian: FloatArray
    wrench: FloatArray
    setpoint: FloatArray
    parameters: FloatArray
    memory: FloatArray
    effort: FloatArray

    @classmethod
    def of(cls, count: int, parameters: FloatArray, memory: FloatArray, wrench: FloatArray
           ) -> Arguments:
        """Return arguments for a number of joints."""
        return cls(np.zeros(1), np.zeros(count), np.zeros(count), np.zeros(count),
                   np.zeros((count, count)), np.zeros((6, count)), wrench, np.zeros((count, 3)),
                   parameters, memory, np.zeros(count))


class SeatJoints(NamedTuple):
    """
    The joints of a part.

    :ivar arm: them as a chain
    :ivar servos: records of ``SERVO``, shape (n,)
    :ivar tip: by :data:`TIP`, :data:`SENSOR`, :data:`FIRST`, :data:`END`, :data:`ROOT`, shape (5,)
    :ivar loads: payloads, and which of these joints move them
    """

    arm: Arm
    servos: NDArray[np.void]
    tip: IntArray
    loads: Loads


class Seat(NamedTuple):
    """
    The place of a law between the joints of a part and the physics.

    :ivar code: address of the compiled law, or 0
    :ivar world: arrays of the data
    :ivar forces: ``cfrc_ext``, shape (nbody, 6)
    :ivar others: force and torque about the origin on the tool that these have not, in ``world``,
        shape (6,)
    :ivar setpoints: records of all joints of the robot
    :ivar efforts: of all joints of the robot [N m or N]
    :ivar joints: of the part
    :ivar starts: position and velocity of setpoints at the beginning of the interval, shape (n, 2)
    :ivar arguments: of the law
    :ivar reads: by :data:`MASS`, :data:`JACOBIAN`, :data:`WRENCH`, whether the law reads it, (3,)
    :ivar status: by :data:`CALLS`, :data:`INSIDE`, :data:`FAILED`, shape (3,)
    """

    code: int
    world: WorldArrays
    forces: FloatArray
    others: FloatArray
    setpoints: NDArray[np.void]
    efforts: FloatArray
    joints: SeatJoints
    starts: FloatArray
    arguments: Arguments
    reads: BoolArray
    status: IntArray


@inlined
def begin(seat: Seat) -> None:
    """Note where setpoints are when an interval begins."""
    joints = seat.joints.arm.joints
    for i in range(len(joints)):
        setpoint = seat.setpoints[joints[i].joint]
        seat.starts[i, 0], seat.starts[i, 1] = setpoint.position, setpoint.velocity


@inlined
def sense(seat: Seat, now: float, share: float) -> None:
    """
    Fill the arguments of a law, after ``mj_step1``.

    :param now: simulation time since the last reset [s]
    :param share: of the interval that has passed
    """
    world, joints, x = seat.world, seat.joints, seat.arguments
    chain, places = joints.arm.joints, joints.arm.places
    x.t[0] = now
    for i in range(len(chain)):
        joint, start = chain[i], seat.starts[i]
        x.q[i], x.v[i] = world.kinematics.positions[joint.qpos], world.velocities[joint.dof]
        x.bias[i] = world.bias[joint.dof] - world.carried[joint.dof]
        if seat.reads[MASS]:
            for j in range(len(chain)):
                x.mass[i, j] = world.inertia[places[i, j]] if places[i, j] >= 0 else 0.0
        end = seat.setpoints[joint.joint]
        x.setpoint[i, 0] = start[0] + share * (end.position - start[0])
        x.setpoint[i, 1] = start[1] + share * (end.velocity - start[1])
        x.setpoint[i, 2] = end.acceleration
        x.effort[i] = 0.0
    if seat.reads[JACOBIAN] and joints.tip[TIP] >= 0:
        find_jacobian(world.kinematics, joints.arm, world.kinematics.sites[joints.tip[TIP]],
                      x.jacobian)


@inlined
def settle(seat: Seat) -> None:
    """Let the efforts of a law act, if all are finite, beside those that carry payloads."""
    x, chain, servos = seat.arguments, seat.joints.arm.joints, seat.joints.servos
    for i in range(len(chain)):
        if not np.isfinite(x.effort[i]):
            seat.status[FAILED] = NOT_FINITE
            return
    for i in range(len(chain)):
        seat.efforts[chain[i].joint] = x.effort[i]
        seat.world.activations[servos[i].activation] = x.effort[i] / servos[i].gear
    loads = seat.joints.loads
    if len(loads.loads):
        carried = x.effort.copy()
        carry(seat.world, loads, servos, loads.accelerations, False, carried)
        for i in range(len(chain)):
            seat.world.activations[servos[i].activation] = carried[i] / servos[i].gear


@inlined
def feel(seat: Seat) -> None:
    """Note the wrench of the world on the tool, after a step."""
    tip, wrench, kinematics = seat.joints.tip, seat.arguments.wrench, seat.world.kinematics
    if tip[TIP] < 0 or not seat.reads[WRENCH]:
        return
    center, place = kinematics.centers[tip[ROOT]], kinematics.sites[tip[SENSOR]]
    axes, total, moment = kinematics.site_axes[tip[SENSOR]], np.zeros(6), np.empty(3)
    others = seat.others
    if len(seat.joints.loads.loads):
        others = seat.others.copy()
        _add_reactions(seat, others)
    for body in range(tip[FIRST], tip[END]):
        for k in range(6):
            total[k] += seat.forces[body, k]
    for k in range(3):
        one, two = (k + 1) % 3, (k + 2) % 3
        # Torque about the sensor; MuJoCo has it about the centre, and the others about the origin.
        moment[k] = total[k] + others[3 + k] + (
            (center[one] - place[one]) * total[3 + two]
            - (center[two] - place[two]) * total[3 + one]) - (
            place[one] * others[two] - place[two] * others[one])
    for k in range(3):
        wrench[k] = wrench[3 + k] = 0.0
        for i in range(3):
            wrench[k] += axes[i, k] * (total[3 + i] + others[i])
            wrench[3 + k] += axes[i, k] * moment[i]


@inner
def _add_reactions(seat: Seat, others: FloatArray) -> None:
    """Add to a wrench about the origin the reaction of payloads, which the tool leaves out."""
    loads, place, reaction = seat.joints.loads, np.empty(3), np.empty(6)
    for k in range(len(loads.loads)):
        if loads.loads[k].body == seat.joints.tip[FIRST]:
            find_reaction(seat.world, loads, k, loads.accelerations, True, place, reaction)
            for i in range(3):
                one, two = (i + 1) % 3, (i + 2) % 3
                others[i] += reaction[i]
                others[3 + i] += reaction[3 + i] + (
                    place[one] * reaction[two] - place[two] * reaction[one])


def _example() -> Seat:
    """Return a seat of no joints."""
    world = WorldArrays.of(mujoco.MjData(mujoco.MjModel.from_xml_string('<mujoco/>')))
    none = np.zeros(0)
    arm = Arm(readable(np.zeros(0, CHAIN)), np.zeros((0, 0), np.int64), 0)
    joints = SeatJoints(arm, readable(np.zeros(0, SERVO)), np.zeros(5, np.int64), no_loads())
    return Seat(0, world, np.zeros((0, 6)), np.zeros(6), records(blank_state(none)), none, joints,
                np.zeros((0, 2)), Arguments.of(0, none, none, np.zeros(6)),
                np.zeros(3, np.bool_), np.zeros(3, np.int64))


#: The places of a seat in its row.
SEAT = Layout(_example())
_read_seat = SEAT.reader()


@intrinsic  # type: ignore[untyped-decorator]
def _call(_: Any, address: Any, row: Any) -> Any:
    """Call the compiled law at an address with that of the row of its seat."""
    def generate(context: BaseContext, builder: Any, __: Any, arguments: Any) -> Any:
        word = llvmlite.ir.IntType(64)
        kind = llvmlite.ir.FunctionType(word, [word])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [arguments[1]])
    return types.int64(address, row), generate


@inlined
def begin_all(rows: IntArray) -> None:
    """Let an interval begin for laws."""
    for row in rows:
        begin(_read_seat(row))


@inlined
def exert_all(rows: IntArray, now: float, share: float) -> None:
    """Let laws exert their efforts, after ``mj_step1``; a failed law keeps its last ones."""
    for row in rows:
        seat = _read_seat(row)
        if seat.status[FAILED] == 0:
            sense(seat, now, share)
            seat.status[CALLS] += 1
            seat.status[INSIDE] = 1
            raised = _call(seat.code, row)
            seat.status[INSIDE] = 0
            if raised != 0:
                seat.status[FAILED] = RAISED
            else:
                settle(seat)


@inlined
def feel_all(rows: IntArray) -> bool:
    """Note the wrenches on tools after a step; return whether any law has failed."""
    failed = False
    for row in rows:
        seat = _read_seat(row)
        feel(seat)
        failed = failed or seat.status[FAILED] != 0
    return failed


class Code:
    """
    A law in machine code, which looks whether indices are within bounds.

    :param function: of the user
    :ivar function: the same, compiled, for Python
    :ivar address: of what takes the address of a row and returns whether it has raised anything
    """

    def __init__(self, function: Callable[..., object]) -> None:
        law = self.function = function
        self.address = 0
        if PLAIN:
            return
        law = self.function = numba.njit(boundscheck=True, nogil=True, error_model='numpy')(
            function)

        @numba.cfunc(types.int64(types.int64))  # type: ignore[untyped-decorator]
        def call(row: Any) -> int:
            x = _read_seat(row).arguments
            try:
                law(x.t[0], x.q, x.v, x.bias, x.mass, x.jacobian, x.wrench, x.setpoint,
                    x.parameters, x.memory, x.effort)
            except Exception:
                return 1
            return 0

        self._call = call
        self.address = int(call.address)
