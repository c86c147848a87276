# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The whole state of a simulation as JSON, from which another process continues to the bit."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Iterable
from dataclasses import replace
import json
from typing import Any
import weakref
import zlib

from manip_sim.control.commands import CommandHandle
from manip_sim.errors import ModelError
from manip_sim.physics.robot_frames import Frame
from manip_sim.quoting import one_line
from manip_sim.simulation.json_codec import check_like, Decoder, Encoder
from manip_sim.simulation.saved_state import gains
from manip_sim.simulation.simulation import Simulation

_BYTES = ('physics', 'computed_from')
_NUMBERS = ('versions', 'model', 'step_count', 'control_steps', 'contacts_change', 'diverged',
            'seed', 'layout')


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
    state = simulation.save()
    encoders = [Encoder(simulation.states.control.index_of) for _ in range(3)]
    control = [encoder.encode(part) for encoder, part in zip(encoders, _live(simulation))]
    plain = {name: getattr(state, name) for name in _NUMBERS}
    plain.update({name: b64encode(getattr(state, name)).decode() for name in _BYTES})
    plain.update(gains={name: b64encode(content).decode()
                        for name, content in state.gains.items()},
                 start=dict(state.start), drawn=dict(state.drawn), control=control,
                 robots=list(state.robots),
                 keyframe=state.keyframe)
    return plain, [met for met in encoders[0].met if isinstance(met, CommandHandle)]


def _live(simulation: Simulation) -> list[Any]:
    return [list(simulation.states.control.content()), [
        robot.sensing.save() for robot in simulation.robots.values()], simulation.pulls.state()]


def decoded(simulation: Simulation, content: Any) -> tuple[Any, list[CommandHandle]]:
    """
    Return a value that an :class:`Encoder` has written for a simulation, and handles in it.

    :raises ModelError: if it is none, or names bodies that are not there
    """
    decoder, model = Decoder(simulation.states.control.fixed), simulation.model
    value = decoder.decode(content)
    for item in decoder.met:
        # MuJoCo does not check them.
        if isinstance(item, Frame) and not (
                item.body in range(model.nbody)
                and (item.site is None or item.site in range(model.nsite))):
            raise ModelError('a frame of no body or site')
    return value, [met for met in decoder.met if isinstance(met, CommandHandle)]


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
    robots = [one_line(str(name), 80) for name in content['robots']]
    if robots != [*simulation.robots]:
        raise ModelError(f'the state was saved with the robots {", ".join(robots)}, now there are '
                         f'{", ".join(simulation.robots)}')
    if content['layout'] != simulation.states.control.layout:
        raise ModelError('control consists of other parts here, as with modes or grippers of '
                         'another package')
    (controls, grippers), sensing, pulls = (
        decoded(simulation, part)[0] for part in content['control'])
    for new, now in ((controls, simulation.states.control.content()[0]),
                     (grippers, simulation.states.control.content()[1]),
                     (sensing, [robot.sensing.save() for robot in simulation.robots.values()])):
        if len(new) != len(now):
            raise ModelError('control consists of other parts here')
        for values, present in zip(new, now):
            check_like(values, present)
    current = gains(simulation.model)
    saved = {name: b64decode(text, validate=True) for name, text in content['gains'].items()}
    if {name: len(value) for name, value in saved.items()} != {
            name: len(value) for name, value in current.items()}:
        raise ModelError('gains of another model')
    numbers: dict[str, Any] = {name: content[name] for name in _NUMBERS}
    state = replace(
        simulation.save(), gains=saved,
        start={str(name): float(value) for name, value in content['start'].items()},
        drawn=content['drawn'], keyframe=content['keyframe'], **numbers,
        physics=b64decode(content['physics'], validate=True),
        computed_from=b64decode(content['computed_from'], validate=True))
    if len(state.computed_from) != len(state.physics):
        raise ModelError('physics of another model')
    simulation.states.check(state)
    simulation.continue_from(state, (controls, grippers), sensing)
    simulation.pulls.set_state(pulls)
    again, handles = plain_state(simulation)
    if json.dumps(again) != json.dumps(content):
        differing = next(name for name in again if json.dumps(again[name]) != json.dumps(
            content.get(name)))
        raise ModelError(f'the state cannot be restored, {differing} differs')
    return handles


def check_sum(simulation: Simulation) -> int:
    """Return a check sum of the present positions and velocities."""
    data = simulation.data
    return zlib.crc32(data.qvel, zlib.crc32(data.qpos))
