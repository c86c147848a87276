# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""States and commands of a simulation in journals: as JSON, which may come from anybody."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import json
from typing import Any
import weakref
import zlib

from manip_sim.control.commands import Command, CommandHandle
from manip_sim.errors import ModelError
from manip_sim.quoting import one_line
from manip_sim.simulation.plain_data import check_like, Decoder, Encoder, to_json
from manip_sim.simulation.saved_state import check_frames, SimulationState
from manip_sim.simulation.simulation import Simulation


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
