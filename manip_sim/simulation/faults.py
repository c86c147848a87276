# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Faults of robots that act: on measurements, commands that are lost, and joints that fail."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.commands import Command, NoCommand, Status
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.faults import (
    KINDS, LATE, LIMP, LOST, LOST_COMMANDS, NOISY, OFFSET, planned, PlannedFault, STATE_FAULTS,
    STUCK)
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import Physics
from manip_sim.sensing.randomness import generator
from manip_sim.sensing.robot_sensing import JOINTS
from manip_sim.simulation.robot_state import RobotReader

#: Dry friction of a joint that is stuck [N m or N].
_STUCK_FRICTION = 1e4
#: Most faults of an episode.
_MOST = 1000
#: End of what never ends, in steps.
_NEVER = 2**62
#: A fault of an episode: what, part, first step, step after the last one, value and a number;
#: plain, so that it can be written.
_Scheduled = tuple[str, str, int, int, float, int]


class RobotFaults:
    """
    The faults of a robot in the present episode; all of it is a part of its state.

    A fault acts in the control periods that begin within its time.

    :param reader: of the robot
    :param clock: of the simulation
    :ivar scheduled: the faults of the episode
    :ivar lost: number of commands that each has lost
    :ivar seen: measurement of the joints while states are at fault, shape (3 n,), else None
    """

    remembered = ('scheduled', 'lost', 'seen', '_held')

    def __init__(self, reader: RobotReader, clock: Clock) -> None:
        self._reader, self._clock = reader, clock
        self.scheduled: list[_Scheduled] = []
        self.lost: list[int] = []
        self.seen: FloatArray | None = None
        #: Memory of the joints of a part, by place in the schedule: the measurement that came
        #: last, or all of them and when.
        self._held: dict[int, list[tuple[int, FloatArray]]] = {}

    def set(self, scheduled: Iterable[_Scheduled]) -> None:
        """Begin an episode with some faults."""
        self.scheduled, self.seen, self._held = [*scheduled], None, {}
        self.lost = [0] * len(self.scheduled)

    def add(self, fault: _Scheduled) -> None:
        """Add a fault to the episode."""
        self.scheduled = [*self.scheduled, fault]
        self.lost = [*self.lost, 0]

    def current(self) -> FloatArray | None:
        """Return the measurements of the joints while states are at fault, else None."""
        return self.seen

    def acting(self, *kinds: str) -> Iterator[tuple[int, str, str, float, int]]:
        """Yield place, kind, part, value and number of the faults that act at present."""
        now = self._clock.control_steps
        for place, (kind, part, begin, end, value, number) in enumerate(self.scheduled):
            if kind in kinds and begin <= now < end:
                yield place, kind, part, value, number

    def _random(self, number: int) -> np.random.Generator:
        """Return a generator for a fault and the present step."""
        sensing = self._reader.sensing
        return generator(sensing.seed, f'fault {number}', self._clock.control_steps)

    def loses(self, command: Command) -> bool:
        """End a command that is lost, and return whether it is."""
        if not self.scheduled or isinstance(command, NoCommand):
            return False
        for place, _, part, share, number in self.acting(LOST_COMMANDS):
            atomic = {name for name, joints in self._reader.indices_of.items()
                      if name == part or set(joints) & set(self._reader.indices_of[part])}
            if not command.parts & (atomic | {part}) or (
                    share < 1.0 and self._random(number).random() >= share):
                continue
            self.lost = [count + (index == place) for index, count in enumerate(self.lost)]
            command.handle.end(Status.ABORTED, f'a fault has lost the command for {part}')
            return True
        return False

    def measure(self) -> None:
        """Measure the joints at the end of a control period, or at the start."""
        if not self.scheduled:
            return
        acting = [*self.acting(*STATE_FAULTS)]
        self._held = {place: self._held.get(place, []) for place, *_ in acting}
        if not acting:
            self.seen = None
            return
        states = self._reader.sensing.without_faults(JOINTS).reshape(3, -1)
        for place, kind, part, value, number in acting:
            joints = self._reader.indices_of[part]
            if kind == OFFSET:
                states[0, joints] += value
            elif kind == NOISY:
                states[0, joints] += value * self._random(number).standard_normal(len(joints))
            else:
                states[:, joints] = self._remembered(
                    self._held[place], states[:, joints], kind, value, number)
        self.seen = states.ravel()

    def _remembered(self, held: list[tuple[int, FloatArray]], measured: FloatArray, kind: str,
                    value: float, number: int) -> FloatArray:
        """Return what arrives of a part, and remember what may arrive later."""
        now, late = self._clock.control_steps, 0
        if kind == LATE:
            late = math.ceil(value / (self._clock.step_ns * 1e-9) - 1e-6)
        if not held or kind == LATE or (
                kind == LOST and value < 1.0 and self._random(number).random() >= value):
            held.append((now, measured.copy()))
        while len(held) > 1 and held[1][0] + late <= now:
            held.pop(0)
        return held[0][1]


class Faults:
    """
    The faults of all robots of a simulation.

    :param physics: of the world
    :param clock: of the simulation
    :param robots: by name, those that there are at present
    :param plan: of each episode
    :raises ModelError: if a fault of the plan fits no robot
    """

    def __init__(self, physics: Physics, clock: Clock, robots: Mapping[str, Any],
                 plan: Iterable[PlannedFault]) -> None:
        self._physics, self._clock, self._robots = physics, clock, robots
        self._plan = [(fault, self._fitting(fault)) for fault in plan]
        #: Numbers of the model before, by joint and kind of fault.
        self._before: dict[tuple[str, str], Any] = {}

    def _fitting(self, fault: PlannedFault) -> list[str]:
        """Return the names of the robots that a fault is for."""
        if fault.robot and fault.robot not in self._robots:
            raise UnknownNameError('robot of a fault', fault.robot, self._robots)
        names = [name for name, robot in self._robots.items()
                 if name == (fault.robot or name) and fault.part in robot.parts]
        if not names:
            raise UnknownNameError('part of a fault', fault.part, dict.fromkeys(
                part for robot in self._robots.values() for part in robot.parts))
        for name in names:
            self._check(fault, self._robots[name])
        return names

    @staticmethod
    def _check(fault: PlannedFault, robot: Any) -> None:
        part = robot.parts[fault.part]
        title = f'{fault.what} of {fault.part}'
        if fault.what == STUCK and (part.gripper is None or not part.joints):
            raise ModelError(f'{title}: only fingers of a gripper can be stuck; {LOST_COMMANDS} '
                             'keeps a part as it is')
        curved = {name for name, law in robot.robot_model.friction_laws.items()
                  if np.isfinite(law.no_load)}
        if fault.what == LIMP and curved.intersection(part.joints):
            raise ModelError(f'{title}: its joints have a torque-speed curve, which decides what '
                             'they exert; set torque_speed to false')
        if fault.what != LOST_COMMANDS and not part.joints:
            raise ModelError(f'{title}: it has no joints')

    def begin(self, seed: int) -> None:
        """
        Begin an episode.

        :param seed: that times and values are drawn from
        """
        scheduled: dict[str, list[Any]] = {name: [] for name in self._robots}
        for number, (fault, names) in enumerate(self._plan):
            drawn = fault.drawn(generator(seed, f'plan of fault {number}'))
            for name in names if drawn is not None else ():
                if name in scheduled:
                    assert drawn is not None
                    scheduled[name].append(self._scheduled(fault, *drawn, number, 0))
        for name, robot in self._robots.items():
            robot.faults.set(scheduled[name])

    def inject(self, description: Mapping[str, Any]) -> None:
        """
        Add a fault to the present episode.

        :param description: as in a plan, but times are from now on [s]; a range is its middle
        :raises ModelError: if it cannot be used
        :raises UnknownNameError: if the part or robot is unknown
        """
        fault = planned(description, 'the fault')
        if 'chance' in description:
            raise ModelError("the fault: one that is injected has no 'chance': it is there")
        number = sum(len(robot.faults.scheduled) for robot in self._robots.values())
        if number >= _MOST:
            raise ModelError(f'an episode has {_MOST} faults at most, and there are {number}')
        begin, end, value = (sum(ends) / 2.0 for ends in (
            fault.begin_s, fault.end_s, fault.value))
        names = self._fitting(fault)
        self._physics.interrupt()
        for name in names:
            self._robots[name].faults.add(self._scheduled(
                fault, begin, end, value, number + len(self._plan), self._clock.control_steps))

    def _scheduled(self, fault: PlannedFault, begin_s: float, end_s: float, value: float,
                   number: int, now: int) -> _Scheduled:
        begin, end = (_NEVER if math.isinf(time_s) else
                      now + math.ceil(time_s / (self._clock.step_ns * 1e-9) - 1e-6)
                      for time_s in (begin_s, end_s))
        return fault.what, fault.part, begin, end, value, number

    @property
    def acts(self) -> bool:
        """True if the present episode has a fault."""
        return any([robot.faults.scheduled for robot in self._robots.values()])

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Let joints fail as scheduled, and return whether the model has changed."""
        failing = {(joint, kind) for robot in self._robots.values() if robot.faults.scheduled
                   for _, kind, part, *_ in robot.faults.acting(LIMP, STUCK)
                   for joint in robot.parts[part].joints}
        if failing == self._before.keys():
            return False
        self._end(self._before.keys() - failing)
        for joint, kind in sorted(failing - self._before.keys()):
            element = model.joint(joint)
            if kind == LIMP:
                number = element.id
                self._before[joint, kind] = (
                    int(model.jnt_actfrclimited[number]), model.jnt_actfrcrange[number].copy())
                model.jnt_actfrclimited[number], model.jnt_actfrcrange[number] = 1, 0.0
            else:
                dof = int(element.dofadr[0])
                self._before[joint, kind] = float(model.dof_frictionloss[dof])
                model.dof_frictionloss[dof] = _STUCK_FRICTION
        return True

    def _end(self, keys: Iterable[tuple[str, str]]) -> None:
        model = self._physics.model
        for joint, kind in sorted(keys):
            before = self._before.pop((joint, kind))
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) < 0:
                continue  # Its robot has gone.
            element = model.joint(joint)
            if kind == LIMP:
                model.jnt_actfrclimited[element.id], model.jnt_actfrcrange[element.id] = before
            else:
                model.dof_frictionloss[int(element.dofadr[0])] = before

    def lift(self) -> None:
        """Let no joint fail, until the next step, as the model will change."""
        self._end([*self._before])

    def summary(self) -> list[dict[str, Any]]:
        """
        Return past and planned faults of the present episode.

        :returns: mappings with ``what``, ``robot``, ``part``, ``from`` and ``until`` (since the
            reset [s]; None: to the end), ``value`` where it has one, ``state`` (``waits``,
            ``acts`` or ``over``) and for lost commands their number ``lost``
        """
        now, step_s, faults = self._clock.control_steps, (self._clock.step_ns * 1e-9), []
        for name, robot in self._robots.items():
            for (kind, part, begin, end, value, _), lost in zip(
                    robot.faults.scheduled, robot.faults.lost):
                state = 'waits' if now < begin else 'acts' if now < end else 'over'
                faults.append({
                    'what': kind, 'robot': name, 'part': part, 'from': round(begin * step_s, 9),
                    'until': None if end == _NEVER else round(end * step_s, 9),
                    **({'value': value} if KINDS[kind].value else {}), 'state': state,
                    **({'lost': lost} if kind == LOST_COMMANDS else {})})
        return faults
