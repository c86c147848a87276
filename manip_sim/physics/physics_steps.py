# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The physics steps of control periods, in which MuJoCo computes nothing twice.

At the end of a period ``mj_forward`` computes all of the new instant. The next step goes on from
there: it is only integrated if nothing has changed since, and if just controls have changed, what
depends on positions and velocities alone is kept. What control does in between is not known here.
A step that diverges is detected, and the last good state restored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
import math
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.external_wrench import BodyForces, ExternalWrench, RobotForces, TouchWatch
from manip_sim.physics.physics import Physics, PHYSICS
from manip_sim.physics.state_dependent_terms import FrictionLaws

_EULER = int(mujoco.mjtIntegrator.mjINT_EULER)
#: Integrators with which a step after ``mj_forward`` may go on from there, with the same bits.
_RESUMABLE = (_EULER, int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))
#: The state that mj_step1 depends on, the half of a step that mj_step2 leaves out.
_FIRST_HALF = (int(mujoco.mjtState.mjSTATE_QPOS) | int(mujoco.mjtState.mjSTATE_QVEL)
               | int(mujoco.mjtState.mjSTATE_MOCAP_POS) | int(mujoco.mjtState.mjSTATE_MOCAP_QUAT)
               | int(mujoco.mjtState.mjSTATE_EQ_ACTIVE))
#: A generalised velocity that no robot reaches [rad/s or m/s].
_ABSURD_VELOCITY = 1e4
_INTEGRATED = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_BAD_NUMBERS = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS),
                     int(mujoco.mjtWarning.mjWARN_BADCTRL) + 1)


class DivergenceWatch:
    """
    A detector of divergence that keeps the last good state.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    :ivar good: the last good state, every number that MuJoCo integrates
    :ivar warnings: how often MuJoCo has warned of bad numbers, by kind, a view
    :ivar warned: the same when the good state was remembered
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model = model
        self._data = data
        self.good: FloatArray = np.empty(mujoco.mj_stateSize(model, _INTEGRATED))
        # Views, which need not be fetched in each period.
        self._numbers = data.qpos, data.qvel, data.qacc
        self.warnings: NDArray[np.int32] = data.warning.number[_BAD_NUMBERS]
        self.warned: NDArray[np.int32] = self.warnings.copy()

    def remember(self) -> FloatArray:
        """Remember the present state as the good one, and return it."""
        mujoco.mj_getState(self._model, self._data, self.good, _INTEGRATED)
        self.warned[:] = self.warnings
        return self.good

    def reason(self) -> str | None:
        """Return why the present state has diverged, or None if it is good."""
        position, velocity, acceleration = self._numbers
        warns = self.warnings.tobytes() != self.warned.tobytes()
        if (velocity.dot(velocity) < _ABSURD_VELOCITY**2 and not warns
                and math.isfinite(position.dot(position) + acceleration.dot(acceleration))):
            return None
        if not all(np.isfinite(values).all() for values in self._numbers):
            return 'a position, velocity or acceleration is not finite'
        if np.abs(velocity).max(initial=0.0) > _ABSURD_VELOCITY:
            return f'a velocity is above {_ABSURD_VELOCITY:g}'
        if warns:
            return 'MuJoCo warns of a bad position, velocity, acceleration or control'
        return None

    def hold(self) -> None:
        """Restore the good state, at rest; ``mj_forward`` has to follow."""
        mujoco.mj_setState(self._model, self._data, self.good, _INTEGRATED)
        self._data.qvel[:] = 0.0


class StepLaws(Protocol):
    """Laws that exert efforts in each step."""

    @property
    def of(self) -> Mapping[str, Any]:
        """The laws, by part; none exert anything if it is empty."""

    @property
    def runs_python(self) -> bool:
        """True if any law runs as plain Python."""

    def exert(self) -> None:
        """Let laws exert their efforts, after ``mj_step1``."""

    def feel(self) -> None:
        """Note the wrenches on tools, after a step."""


class ModelEdit(Protocol):
    """Changes of the model between control periods, by the present state alone."""

    @property
    def acts(self) -> bool:
        """True if there is anything that may change it."""

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Change the model, and return whether it was another one."""


class PhysicsSteps:
    """
    Runs the steps of control periods, and records the forces on tools.

    :param physics: of the world
    :param clock: that counts the steps
    :param efforts: of the actuators, recorded at the end of each period
    :param tools: whose external wrenches are recorded
    :param laws: what changes the model with the velocities
    :param seats: laws that act between the halves of a step, of each robot
    :param edits: of the model between periods, such as the speeds of belts
    :ivar physics: of the world
    :ivar efforts: of the last step; without room :meth:`finish` has to record them
    :ivar divergence: keeps the state at the beginning of the period
    :ivar computed_from: the whole state that the present forces were computed from
    :ivar first_half: the parts of a state that the first half of a step depends on
    :ivar seats: laws that act between the halves of a step, of each robot
    :ivar measuring: called within the period, with all of that instant computed, by after how many
        steps of the period that is; it changes nothing of the physics
    """

    def __init__(self, physics: Physics, clock: Clock, efforts: ActuatorEfforts,
                 tools: Sequence[ExternalWrench], laws: Sequence[FrictionLaws] = (),
                 seats: Sequence[StepLaws] = (), edits: Sequence[ModelEdit] = ()) -> None:
        self.physics, self._edits = physics, tuple(edits)
        self._clock = clock
        self.efforts = efforts
        self.tools: tuple[BodyForces, ...] = tuple(tools)
        self._laws, self.seats = tuple(laws), tuple(seats)
        self.measuring: Mapping[int, Callable[[], None]] = {}
        physics.places_at_begin = self.places_at_begin
        physics.on_change(self._rebind)

    def refresh_joint_parameters(self) -> None:
        """Take over the dry friction of the joints, which was changed in the model."""
        for laws in self._laws:
            laws.refresh_joint_parameters()

    def sync_robots(self, tools: Sequence[ExternalWrench], laws: Sequence[FrictionLaws],
                    seats: Sequence[StepLaws]) -> None:
        """Take over the tools and laws of the robots that there are now."""
        self.tools, self._laws, self.seats = tuple(tools), tuple(laws), tuple(seats)
        self._rebind_tools()

    def watch_forces(self, forces: Sequence[RobotForces]) -> None:
        """Record the forces on all bodies of these robots too, and of no others."""
        # The record of a tool counts where it is one of these bodies too.
        self.tools = (*forces, *[tool for tool in self.tools if isinstance(tool, ExternalWrench)])
        self._rebind_tools()

    def _rebind_tools(self) -> None:
        self._touch = TouchWatch(self._model, self._data, self.tools)
        #: True if only contacts, and forces that :attr:`_touch` sees, act on tools.
        self._only_touched = all(tool.is_only_touched for tool in self.tools)
        #: Room for the notes of compiled steps, by their number.
        self.notes = Derived()
        #: Of each tool the first body, the one after its last, and the root of its tree, (t, 3).
        self.tool_bodies: IntArray = np.array([
            (tool.bodies.start, tool.bodies.stop, self._model.body_rootid[tool.bodies.start])
            for tool in self.tools], dtype=np.int64).reshape(-1, 3)

    def _rebind(self) -> None:
        model, data = self.physics.model, self.physics.data
        self._model, self._data, self._options = model, data, model.opt
        self.divergence = DivergenceWatch(model, data)
        self._rebind_tools()
        self.computed_from: FloatArray = np.empty(mujoco.mj_stateSize(model, PHYSICS))
        mujoco.mj_getState(model, data, self.computed_from, PHYSICS)
        self.first_half = _places(model, _FIRST_HALF)
        self._pushed, self._begin = False, 0
        #: Holds the computed quantities while something is measured.
        self._aside: mujoco.MjData | None = None
        #: True if all is computed for a state, and the first half of the next step for the present
        #: one.
        self._computed = self._resumes = False

    # ------------------------------------------------------------------ computation

    def state(self) -> FloatArray:
        """Return the present state, every number that MuJoCo integrates, as one array."""
        state = np.empty(len(self.computed_from))
        mujoco.mj_getState(self._model, self._data, state, PHYSICS)
        return state

    def compute(self) -> None:
        """Compute all of the present instant."""
        mujoco.mj_getState(self._model, self._data, self.computed_from, PHYSICS)
        self._edit()
        for laws in self._laws:
            laws.write(self._model, self._data)
        mujoco.mj_forward(self._model, self._data)
        self._computed = True

    def compute_anew(self) -> None:
        """Let the next step compute all anew, as the model may be changed before it."""
        self.physics.interrupt()
        self._computed = False

    def compute_from(self, state: FloatArray) -> None:
        """Compute all of the instant of a state, which becomes the present one."""
        mujoco.mj_setState(self._model, self._data, state, PHYSICS)
        self.compute()

    @property
    def _may_resume(self) -> bool:
        """True if a step may go on from the last computation, as long as the state is the same."""
        options = self._options
        return (self._computed and int(options.integrator) in _RESUMABLE
                and not options.enableflags)

    def _compare(self, state: FloatArray) -> None:
        """Find out what of a step has been computed for the present state."""
        self._edit()
        self._resumes = self._may_resume and all([
            state[part].tobytes() == self.computed_from[part].tobytes()
            for part in self.first_half])

    def _edit(self) -> None:
        """Edit the model as the present state says; an edit makes computed quantities outdated."""
        for edit in self._edits:
            if edit.write(self._model, self._data):
                self._computed = False

    # ------------------------------------------------------------------ control periods

    def begin(self) -> None:
        """Begin a control period."""
        self._begin_records()
        self._compare(self.divergence.remember())

    def _begin_records(self) -> None:
        self._begin = self._clock.step_count
        for tool in self.tools:
            tool.begin_period()

    def begin_by_law(self) -> bool:
        """
        Begin a control period of which a law remembers the state.

        :returns: whether a step may go on from the computed quantities, if the state is the same
        """
        self._begin_records()
        self._edit()
        resumes = self._may_resume
        self._computed = self._resumes = False
        return resumes

    def end_by_law(self) -> None:
        """End a control period of which a law has computed the last instant."""
        self._computed = True
        self._edit()
        if not self._computed:
            self.compute()

    def places_at_begin(self) -> mujoco.MjData:
        """Return data with the kinematics at the beginning of the period, until others use it."""
        scratch = self.physics.scratch.data
        mujoco.mj_setState(self._model, scratch, self.divergence.good, _INTEGRATED)
        mujoco.mj_kinematics(self._model, scratch)
        return scratch

    def end_period(self, steps: int, duration_s: float) -> None:
        """End the measurement of forces on tools in a period of some steps [s]."""
        for tool in self.tools:
            tool.end_period(self._data, steps, duration_s)

    def restart(self) -> None:
        """Compute all of a state that was set, without what came before."""
        self.compute()
        self.efforts.restart()
        for tool in self.tools:
            tool.restart(self._data)

    def run(self, intervals: Iterable[int]) -> None:
        """
        Run intervals of a period, and record the forces on the tools in each step.

        :param intervals: the steps of each; it is asked for when the one before has been run
        """
        model, data = self._model, self._data
        laws, pushed, step = self._laws, self._pushed, mujoco.mj_step
        tools = [(tool.forces, b'' if pushed else tool.no_forces, tool.record)
                 for tool in self.tools]
        seats = [seat for seat in self.seats if seat.of]
        if seats:
            step = partial(_step_with_laws, seats, mujoco.mj_step1)
        # All that depends on positions and velocities alone may have been computed already.
        next_step = step
        if self._resumes:
            next_step = partial(_step_with_laws, seats, None) if seats else mujoco.mj_step2
        self._resumes = False
        for steps in self._interrupted(intervals) if self.measuring else intervals:
            for _ in range(steps):
                for law in laws:
                    law.write(model, data)
                next_step(model, data)
                next_step = step
                if data.ncon or pushed:
                    for forces, none, record in tools:
                        if forces.tobytes() != none:
                            record()
            self._clock.count(steps)

    def resumes_after_laws(self, act: bool) -> int:
        """
        Return what of a step is computed after a period that a law has ended, as it has it.

        :param act: whether laws change controls or applied forces before the step
        """
        if not self._may_resume:
            return 0
        return 1 if act or int(self._options.integrator) == _EULER else 2

    @property
    def goes_on(self) -> bool:
        """True if laws may run the next period too while nothing is changed or pushes a tool."""
        return (self.lets_laws_step and self.efforts.room is not None and self._touch.may_go_on
                and not any([edit.acts for edit in self._edits])
                and all([not tool.goes_on for tool in self.tools]))

    @property
    def lets_laws_step(self) -> bool:
        """True if compiled laws may run steps: nothing but contacts has to be watched."""
        return (self._only_touched and not (self._laws or self._pushed or self.measuring)
                and not any([seats.runs_python for seats in self.seats]))

    def take_resumes(self) -> bool:
        """Return whether the first half of the next step is computed, which then is made."""
        resumes, self._resumes = self._resumes, False
        return resumes

    def took_steps(self, counts: IntArray, rows: FloatArray, roots: FloatArray) -> None:
        """
        Record steps that a law has run.

        :param counts: in how many of them something touched each tool, shape (t,)
        :param rows: the forces on its bodies in these, shape (t, steps, m, 6)
        :param roots: where the centre of mass of its tree was then [m], shape (t, steps, 3)
        """
        for number, (tool, count) in enumerate(zip(self.tools, counts.tolist())):
            if count:
                tool.record_rows(rows[number, :count, :len(tool.forces)], roots[number, :count])

    def _interrupted(self, intervals: Iterable[int]) -> Iterator[int]:
        """Divide intervals where something is measured within the period."""
        for steps in intervals:
            begin = self._clock.step_count - self._begin
            end = begin + steps
            for stop in sorted(self.measuring):
                if begin < stop <= end:
                    yield stop - begin
                    begin = stop
                    self._measure(stop)
            if begin < end:
                yield end - begin

    def _measure(self, steps: int) -> None:
        """Measure after some steps of the period, unless the physics has diverged."""
        if self.divergence.reason() is not None:
            return
        if self._aside is None:
            self._aside = mujoco.MjData(self._model)
        mujoco.mj_copyData(self._aside, self._model, self._data)
        efforts = self.efforts.set_aside()
        wrenches = [tool.set_aside() for tool in self.tools]
        self.finish()
        for tool in self.tools:
            tool.interrupt(steps)
        self.measuring[steps]()
        # The next step and control find what they would have found.
        self.efforts.take_back(efforts)
        for tool, wrench in zip(self.tools, wrenches):
            tool.take_back(wrench)
        mujoco.mj_copyData(self._data, self._model, self._aside)

    def keep_measured(self) -> None:
        """Compute efforts and forces of the last period, for commands that come within one."""
        self.efforts.keep()
        for tool in self.tools:
            tool.keep()

    def begin_run(self) -> None:
        """Prepare for :meth:`run`, which is called for the intervals of a period."""
        self._pushed = self._touch.pushed

    def finish(self) -> None:
        """Compute all of the new instant, at the end of a period."""
        self.efforts.record()
        # After mj_step the sensors are one step older than the positions.
        self.compute()


def _step_with_laws(seats: Sequence[StepLaws],
                    begin: Callable[[mujoco.MjModel, mujoco.MjData], None] | None,
                    model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """
    Run a step, between the halves of which laws exert efforts.

    :param begin: the first half, or None if it has been computed
    """
    if begin is not None:
        begin(model, data)
    for laws in seats:
        laws.exert()
    mujoco.mj_step2(model, data)
    for laws in seats:
        laws.feel()


def _places(model: mujoco.MjModel, wanted: int) -> list[slice]:
    """Return the places of parts of the state in the array of all of it."""
    slices: list[slice] = []
    begin = 0
    for number in range(PHYSICS.bit_length()):
        part = PHYSICS & (1 << number)
        end = begin + (mujoco.mj_stateSize(model, part) if part else 0)
        if part & wanted and end > begin:
            if slices and slices[-1].stop == begin:
                begin = slices.pop().start
            slices.append(slice(begin, end))
        begin = end
    return slices
