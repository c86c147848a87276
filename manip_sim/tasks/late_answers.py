# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Answers of a policy that come late: the simulation goes on while the policy thinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import math
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.quoting import format_value
from manip_sim.sensing.robot_sensing import Delay, ROUNDING
from manip_sim.tasks.episode import Episode
from manip_sim.tasks.latency import LONGEST_S
from manip_sim.validation import steps_of, whole_number

#: In place of seconds: as long as the policy takes, wall time.
MEASURED = 'measured'
#: Most actions of a chunk; more are a mistake in the axes.
_LONGEST_CHUNK = 10_000


@dataclass(frozen=True)
class AnswerTime:
    """
    The time that a policy thinks, simulated, and its use of chunks of actions.

    :ivar mean_s: from the observation to the effect of the first action [s]
    :ivar jitter_s: standard deviation of the single times, drawn from the seed [s]
    :ivar measured: whether each time is the wall time that the policy took, which no seed repeats
    :ivar chunk_hz: rate of the actions of a chunk [Hz]; None for the control rate
    :ivar ask_ahead: number of actions left of a chunk with which the policy is asked again; with
        0 it is asked when all were taken
    """

    mean_s: float = 0.0
    jitter_s: float = 0.0
    measured: bool = False
    chunk_hz: float | None = None
    ask_ahead: int = 0

    @classmethod
    def of(cls, given: AnswerTimeLike) -> AnswerTime:
        """
        Return an answer time from what a user gives.

        :param given: one, or seconds, or ``measured``, or a mapping with ``time`` (one of these),
            ``jitter`` [s], ``chunk_hz`` and ``ask_ahead``
        :raises UnknownNameError: if a key of the mapping is another one
        :raises ModelError: if a value cannot be used
        """
        if isinstance(given, AnswerTime):
            return given
        values = given if isinstance(given, Mapping) else {'time': given}
        known = ('time', 'jitter', 'chunk_hz', 'ask_ahead')
        for key in values:
            if key not in known:
                raise UnknownNameError('key of answer_time', key, known)
        time, rate = values.get('time', 0.0), values.get('chunk_hz')
        measured = isinstance(time, str) and time == MEASURED
        mean_s = 0.0 if measured else _seconds(time, f"answer_time must be '{MEASURED}' or")
        jitter_s = _seconds(values.get('jitter', 0.0), 'jitter of answer_time must be')
        if measured and jitter_s:
            raise ModelError('a measured answer_time has no jitter')
        if rate is not None and (isinstance(rate, bool) or not isinstance(rate, (int, float))
                                 or not 0.0 < rate < math.inf):
            raise ModelError(f'chunk_hz must be above 0 Hz, got {format_value(rate)}')
        return cls(mean_s, jitter_s, measured, None if rate is None else float(rate),
                   whole_number(values.get('ask_ahead', 0), 0, 'ask_ahead'))

    @property
    def is_none(self) -> bool:
        """True if each answer is one action that takes effect at once, unless it is a chunk."""
        return self == NO_ANSWER_TIME

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)


NO_ANSWER_TIME = AnswerTime()
AnswerTimeLike = Union[AnswerTime, float, str, Mapping[str, Any]]


def _seconds(value: Any, noun: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
            0.0 <= value <= LONGEST_S):  # NaN is not either.
        raise ModelError(f'{noun} from 0 to {LONGEST_S:g} s, got {format_value(value)}')
    return float(value)


class LateAnswers:
    """
    The way of a policy's answers to an episode, whose time goes on while the policy thinks.

    The policy observes at the beginning of a control period, whenever :attr:`asks`. Its answer
    takes effect as much later as it thinks, exact to the timestep; until then nothing is
    commanded. Of a chunk, the first action takes effect then, and the others follow at the rate
    of chunks. If the policy is asked ahead, the actions of the last chunk go on meanwhile, and as
    many of the new one are left out, as they are for times that are over.

    :param episode: that the actions are for
    :param time: of the answers
    :raises ModelError: if the rate of chunks does not fit the timestep
    """

    def __init__(self, episode: Episode, time: AnswerTime) -> None:
        self._episode = episode
        self._sensing = episode.simulation.robots[episode.task.robot.name_in_world].sensing
        self._time = time
        self._timestep_s = timestep_s = episode.simulation.timestep_s
        spacing_s = episode.period_s if time.chunk_hz is None else 1.0 / time.chunk_hz
        spacing = steps_of(spacing_s, timestep_s)
        if spacing is None:
            raise ModelError(f'chunk_hz must be that of a whole number of timesteps of '
                             f'{timestep_s:g} s, got {time.chunk_hz:g} Hz')
        self._spacing = spacing
        self._delay = Delay('answer_time', timestep_s)
        self._delay.mean_s, self._delay.jitter_s = time.mean_s, time.jitter_s
        self.reset(0)

    def reset(self, seed: int) -> None:
        """
        Begin an episode, after its own reset.

        :param seed: draws the times
        """
        self._delay.set_seed(seed)
        #: Actions by when they take effect, in steps since the reset.
        self._waiting: list[tuple[int, FloatArray]] = []
        #: When the last answer arrives, and when there is nothing left of it.
        self._arrival = self._end = self._count

    @property
    def _count(self) -> int:
        """Steps since the reset."""
        return self._sensing.count

    @property
    def asks(self) -> bool:
        """True if the policy is to be asked at the present instant."""
        left = -(-(self._end - self._count) // self._spacing)
        return self._count >= self._arrival and left <= self._time.ask_ahead

    def answer(self, answer: ArrayLike, took_s: float = 0.0) -> None:
        """
        Take an answer to the present observation.

        :param answer: an action, or a chunk of actions, shape (n,) or (actions, n)
        :param took_s: wall time that the policy took [s]
        :raises CommandError: if it cannot be used; then nothing changes
        """
        self.take(self._actions(answer), took_s)

    def take(self, actions: Sequence[FloatArray], took_s: float) -> None:
        """
        Take an answer as :meth:`answer` does.

        :param actions: as ``Actions.checked`` returns them, one or more
        :param took_s: wall time that the policy took [s]
        """
        now, spacing = self._count, self._spacing
        thinks = (math.ceil(took_s / self._timestep_s - ROUNDING) if self._time.measured
                  else self._delay.steps(now))
        self._arrival = now + thinks
        self._waiting = [(due, action) for due, action in self._waiting if due < self._arrival]
        # Without actions left, the grid of the new ones begins with the observation.
        grid = self._waiting[-1][0] + spacing if self._waiting else now
        actions = actions[min(len(self._waiting), len(actions) - 1):]
        first = max(self._arrival, grid)
        second = grid + ((first - grid) // spacing + 1) * spacing
        times = [first, *(second + i * spacing for i in range(len(actions) - 1))]
        self._end = second + (len(actions) - 1) * spacing
        self._waiting += zip(times, actions)

    def _actions(self, answer: ArrayLike) -> list[FloatArray]:
        actions, numbers = self._episode.actions, np.asarray(answer)
        if numbers.ndim < 2:
            return [actions.checked(answer)]
        if numbers.ndim > 2 or not 0 < len(numbers) <= _LONGEST_CHUNK:
            raise CommandError(
                f'a chunk of actions must have the shape (actions, {actions.size}), with up to '
                f'{_LONGEST_CHUNK} actions, got {numbers.shape}')
        return [actions.checked(action, f'action {index} of a chunk')
                for index, action in enumerate(numbers)]

    def begin_period(self) -> list[tuple[int, FloatArray]]:
        """
        Let due actions take effect within the next control period.

        :returns: the actions, and in how many steps they take effect
        :raises CommandError: if one cannot be carried out
        """
        due = self.take_due()
        self.apply(due)
        return due

    def take_due(self) -> list[tuple[int, FloatArray]]:
        """Return the actions due within the next control period, as :meth:`begin_period` does."""
        begin = self._count
        end = begin + self._episode.steps
        due = [(time - begin, action) for time, action in self._waiting if time < end]
        self._waiting = self._waiting[len(due):]
        return due

    def apply(self, due: Sequence[tuple[int, FloatArray]]) -> None:
        """
        Let actions take effect within the next control period.

        :param due: as :meth:`take_due` has returned them
        :raises CommandError: if one cannot be carried out
        """
        for steps, action in due:
            self._episode.actions.apply(action, self._episode.period_s, steps)

    def advance(self) -> list[tuple[int, FloatArray]]:
        """
        Advance by one control period, with the actions due in it.

        :returns: as :meth:`begin_period`
        :raises CommandError: if an action cannot be carried out
        :raises DivergenceError: if the physics diverges
        """
        due = self.begin_period()
        self._episode.advance()
        return due
