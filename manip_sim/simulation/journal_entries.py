# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Entries of journals: operations by name with plain arguments, commands and states as JSON.

The JSON may come from anybody.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
import json
from typing import Any
import weakref
import zlib

from numpy.typing import ArrayLike

from manip_sim.control.commands import Command, CommandHandle
from manip_sim.errors import CommandError, ModelError
from manip_sim.models.object_creation import object_from_text
from manip_sim.models.object_model import check_object_name, ObjectModel
from manip_sim.models.user_files import InMemoryFile
from manip_sim.physics.object_spawning import plan_with, plan_without, WorldPlan
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.quoting import one_line, quoted
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.saved_state import check_frames, SimulationState
from manip_sim.simulation.serialization import check_like, Decoder, Encoder, to_json
from manip_sim.simulation.simulation import Simulation

#: Operations that change all robots, and those that change one, whose name comes first.
_OF_ALL_ROBOTS = {
    'tare': SimulatedRobot.tare_wrench, 'emergency_stop': SimulatedRobot.emergency_stop,
    'recover': SimulatedRobot.recover}
_OF_ONE_ROBOT: Mapping[str, Callable[..., object]] = {
    'speed_scaling': SimulatedRobot.set_speed_scaling, 'mode': SimulatedRobot.set_control_mode,
    'timeout': SimulatedRobot.set_command_timeout, 'stream_interval': SimulatedRobot.set_stream,
    'wrench_cutoff': SimulatedRobot.set_wrench_cutoff, 'reflex': SimulatedRobot.set_reflex,
    'set_payload': SimulatedRobot.set_payload, 'integral_gain': SimulatedRobot.set_integral_gain}


class Operations:
    """
    The operations on a simulation, between two control periods.

    Their names and arguments can be written to a record, and repeated from it.

    :param simulation: any
    :param steps: physics steps of a control period
    :ivar restart: puts the simulation to its start, from a seed, or as it was
    """

    def __init__(self, simulation: Simulation, steps: int) -> None:
        self._simulation, self._steps = simulation, steps
        self.restart: Callable[[int | None], None] = simulation.reset
        self._saved: SimulationState | None = None
        self._spawned: dict[str, list[Any]] = {}
        self._named: Mapping[str, Callable[..., Any]] = {
            'reset': self._reset, 'save': self._save, 'restore': self._restore,
            **{name: partial(self._each, change) for name, change in _OF_ALL_ROBOTS.items()},
            **{name: partial(self._one, change) for name, change in _OF_ONE_ROBOT.items()},
            'reset_reflexes': self._reset_reflexes, 'keyframe': self._keyframe,
            'stream_hold': self._stream_hold, 'sensing': self._sensing,
            'cartesian': self._cartesian, 'law': self._law,
            'payload': self._payload, 'place': self._place, 'fault': simulation.faults.inject,
            'direct_command': self._direct_command, 'target': simulation.surroundings.set_target,
            'pull': simulation.pulls.pull, 'end_pull': simulation.pulls.end,
            'answer': lambda: None, 'spawn': self._spawn, 'spawn_all': self._spawn_all,
            'delete': self._delete, 'despawn': self._despawn}

    def run(self, name: str, *arguments: Any, using: Any = None) -> Any:
        """
        Run an operation.

        :param name: of one of them
        :param arguments: what JSON can hold
        :param using: what it would make of them, if that is there already
        :raises ManipSimError: if it cannot be done
        """
        return self._named[name](*arguments, *(() if using is None else (using,)))

    @property
    def names(self) -> frozenset[str]:
        """The names of all operations."""
        return frozenset(self._named)

    def _robot(self, name: str) -> SimulatedRobot:
        return self._simulation.robots[name]

    def _reset(self, seed: int | None, restart_time: bool) -> None:
        self.restart(seed)
        if restart_time:
            self._simulation.step_count = 0
        self._begin_instant()

    def _begin_instant(self) -> None:
        # A new state needs a new stamp, and zero means no stamp.
        self._simulation.step_count += self._steps

    def _save(self) -> str:
        if self._simulation.diverged is not None:
            raise CommandError(f'{self._simulation.diverged}; the state saved before is kept')
        self._saved = self._simulation.save()
        return self._simulation.digest()

    def _restore(self) -> str:
        if self._saved is None:
            raise CommandError('no state has been saved')
        count = self._simulation.step_count
        self._simulation.restore(self._saved)
        self._simulation.step_count = count
        digest = self._simulation.digest()
        self._begin_instant()
        return digest

    def _each(self, change: Callable[[SimulatedRobot], object]) -> None:
        for robot in self._simulation.robots.values():
            change(robot)

    def _one(self, change: Callable[..., object], robot: str, *arguments: Any) -> None:
        change(self._robot(robot), *arguments)

    def _reset_reflexes(self) -> None:
        for robot in self._simulation.robots.values():
            robot.reflexes.check_reset()
        self._each(SimulatedRobot.reset_reflexes)

    def _keyframe(self, name: str) -> None:
        self._simulation.episode_start.keyframe = name

    def _stream_hold(self, robot: str, part: str, hold_s: float) -> None:
        self._robot(robot).set_stream(part, hold_s=hold_s)

    def _payload(self, robot: str, arm: str, number: str, value: Any) -> None:
        joints = self._robot(robot).joints
        joints.set_payload(arm, joints.payloads[arm].changed(number, value))

    def _sensing(self, robot: str, quantity: str, value: float) -> None:
        self._robot(robot).sensing.set(quantity, value)
        self._simulation.randomized.replace_parameter(robot, quantity, value)

    def _cartesian(self, robot: str, arm: str, setting: str, value: ArrayLike | str) -> None:
        self._robot(robot).joints.cartesian.set(arm, setting, value)

    def _law(self, robot: str, part: str, parameter: str, value: float) -> None:
        self._robot(robot).law_parameters(part)[parameter] = value

    def _place(self, name: str, pose: list[list[float]] | None, twist: list[list[float]] | None
               ) -> None:
        self._simulation.entities.place(
            self._simulation.data, name, None if pose is None else Pose.checked(*pose),
            None if twist is None else Twist.checked(*twist))

    def _direct_command(self, part: str, name: str, quantity: str, value: float) -> None:
        # Objects may have come or gone since the message came, and actuators with them.
        commands = self._simulation.surroundings.commands[part]
        commands.command(commands.checked([name], **{
            kind: [value] * (kind == quantity) for kind in ('position', 'velocity', 'effort')}))

    def _spawn(self, name: str, text: str | None, position: list[float], quat_wxyz: list[float],
               plan: WorldPlan | None = None) -> None:
        self._spawn_all([[name, text, position, quat_wxyz]], plan)

    def _spawn_all(self, objects: list[list[Any]], plan: WorldPlan | None = None) -> None:
        """Spawn objects, given by the arguments of :meth:`_spawn`, in one change of the world."""
        if plan is None:
            plan = plan_with(self._simulation.plan, *(_created(*item) for item in objects))
        self._simulation.change_objects(plan)
        self._spawned.update({item[0]: item for item in objects})

    def _delete(self, name: str, plan: WorldPlan | None = None) -> None:
        self._simulation.change_objects(plan or plan_without(self._simulation.plan, name))
        self._spawned.pop(name, None)

    def _despawn(self, plan: WorldPlan | None = None) -> None:
        self._simulation.change_objects(plan or plan_without(self._simulation.plan, *self.spawned))
        self._spawned.clear()

    @property
    def spawned(self) -> list[str]:
        """Names of the objects that were spawned."""
        return list(self._spawned)

    @property
    def objects(self) -> list[list[Any]]:
        """The objects in their order: the arguments with which they were spawned, or the name."""
        return [self._spawned.get(name, [name]) for name in self._simulation.plan.object_names]

    def make_objects(self, wanted: list[list[Any]]) -> None:
        """
        Let there be the objects of another simulation of the same world.

        :param wanted: its :attr:`objects`
        :raises ModelError: if one cannot be made
        """
        names = [item[0] for item in wanted if len(item) == 1]
        for name in self._simulation.plan.object_names:
            if name not in names:
                self._delete(name)
        missing = [item for item in wanted if len(item) > 1]
        if missing:
            self._spawn_all(missing)


def _created(name: str, text: str | None, position: list[float], quat_wxyz: list[float]
             ) -> ObjectModel:
    """Return the object that a text describes, with another name and pose."""
    if text is None:
        raise ModelError(f'{quoted(name)} was spawned from a file')
    item = object_from_text(InMemoryFile(text, 'resource_string'))[1]()
    item.name = name
    check_object_name(name, 'name')
    item.place(position, quat_wxyz)
    return item


class NumberedHandles:
    """
    Handles of commands by their numbers since the start, as long as something else has them.

    A journal and what repeats it number them alike.
    """

    def __init__(self) -> None:
        self._handles: weakref.WeakValueDictionary[int, CommandHandle] = (
            weakref.WeakValueDictionary())
        self._count = 0

    def add(self, handles: Iterable[CommandHandle]) -> None:
        """Give handles the next numbers."""
        for handle in handles:
            self._handles[self._count] = handle
            self._count += 1

    def get(self, number: int) -> CommandHandle | None:
        """Return the handle of a number, or None if nothing has it any more."""
        return self._handles.get(number)

    def numbers_of(self, wanted: CommandHandle) -> list[int]:
        """Return the numbers of a handle; one for each time that it was added."""
        return [number for number, handle in self._handles.items() if handle is wanted]


def plain_state(simulation: Simulation) -> tuple[dict[str, Any], list[CommandHandle]]:
    """
    Return the present state as JSON, and the handles of commands in it.

    :raises ModelError: if a user's class has a state that cannot be written
    """
    encoder = Encoder(simulation.states.control.index_of)
    about = {**vars(simulation.save()), 'pulls': simulation.pulls.state()}
    del about['control']
    plain = {**Encoder({}).encode(about), 'control': simulation.states.encoded(encoder)}
    return json.loads(to_json(plain)), _handles(encoder.met)


def plain_commands(simulation: Simulation, commands: Sequence[tuple[str, Command]]
                   ) -> tuple[Any, list[CommandHandle]]:
    """
    Return commands with their robots' names as JSON, and the handles in them.

    :raises ModelError: if one cannot be written
    """
    encoder = Encoder(simulation.states.control.index_of)
    plain = json.loads(to_json(encoder.encode(list(commands))))
    return plain, _handles(encoder.met)


def decoded_commands(simulation: Simulation, content: Any
                     ) -> tuple[list[tuple[str, Command]], list[CommandHandle]]:
    """
    Return what :func:`plain_commands` was called with, and the handles.

    :raises ModelError: if these are no commands, or they name bodies that are not there
    """
    decoder = Decoder(simulation.states.control.fixed)
    commands = decoder.decode(content)
    check_frames(decoder, simulation.model)
    if not all(isinstance(command, Command) for _, command in commands):
        raise ModelError('a command is none')
    return commands, _handles(decoder.met)


def restore_plain(simulation: Simulation, content: Any) -> list[CommandHandle]:
    """
    Continue from a state.

    :param simulation: of an equal world
    :param content: what :func:`plain_state` has returned, or anything
    :returns: the handles of the commands in it, in the same order
    :raises ModelError: if it cannot be restored here; the simulation must not be used then
    """
    try:
        return _restore(simulation, content)
    except ModelError:
        raise
    except Exception as error:  # It may be anything.
        raise ModelError(f'the state cannot be used: {type(error).__name__} '
                         f'{one_line(str(error), 200)}') from error


def _restore(simulation: Simulation, content: Any) -> list[CommandHandle]:
    about = Decoder([]).decode({**content, 'control': None})
    pulls = about.pop('pulls')
    state = {**about, 'control': content['control']}
    check_like(state, vars(simulation.save()))
    simulation.restore(SimulationState(**state))
    simulation.pulls.set_state(pulls)
    again, handles = plain_state(simulation)
    for name, value in again.items():
        if json.dumps(value) != json.dumps(content[name]):
            raise ModelError(f'the state cannot be restored, {name} differs')
    return handles


def check_sum(simulation: Simulation) -> int:
    """Return a check sum of the present positions and velocities."""
    data = simulation.data
    return zlib.crc32(data.qvel, zlib.crc32(data.qpos))


def _handles(met: Iterable[object]) -> list[CommandHandle]:
    return [item for item in met if isinstance(item, CommandHandle)]
