# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Repeat recorded episodes in a fresh simulation, and compare states and digests."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.errors import CommandError, DivergenceError, ModelError, RecordError
from manip_sim.quoting import one_line
from manip_sim.records.gate import files_of
from manip_sim.records.recorded import RecordedEpisode
from manip_sim.records.recorder import physics_state
from manip_sim.resources import package_version
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode


@dataclass(frozen=True)
class Repetition:
    """
    What came of repeating an episode.

    :ivar recorded: the episode
    :ivar periods: control periods that were repeated
    :ivar success: whether it ended with success
    :ivar difference: where it first differs from the record, and why that may be; None if it
        does not
    :ivar difference_period: the control period in which it first differs, 0 for the start; None
        if it does not
    """

    recorded: RecordedEpisode
    periods: int
    success: bool
    difference: str | None = None
    difference_period: int | None = None


class Replay:
    """Repeats episodes; the simulation of one is used for the next if it has the same world."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._episode: Episode | None = None

    def repeat(self, recorded: RecordedEpisode) -> Repetition:
        """
        Repeat an episode up to its end, or to where its record ends.

        :param recorded: the episode
        :raises RecordError: if it cannot be repeated here
        """
        actions, states = recorded.actions, recorded.states
        if len(states) == 0 or len(states) > 1 and len(actions) == 0:
            raise RecordError(f'episode {recorded.number} has no actions that could be repeated')
        if len(states) < len(actions):
            raise RecordError(f'episode {recorded.number} has {len(actions)} actions and '
                              f'{len(states)} states')
        episode, digests = self._fresh(recorded), recorded.digests
        found: tuple[int, str] | None = None
        try:
            for period in range(len(states)):
                if period:
                    episode.step(actions[period - 1])
                what = _difference(episode, states[period], digests.get(period))
                if what is not None and found is None:
                    found = period, what
        except (CommandError, DivergenceError) as error:
            found = found or (episode.periods + 1, str(error))
        if found is None and recorded.result is not None and (
                episode.digest != recorded.result['digest']):
            found = episode.periods, 'the digest'
        success = episode.success
        if found is None and recorded.result is not None and success != recorded.success:
            found = episode.periods, 'success'
        if found is None:
            return Repetition(recorded, episode.periods, success)
        period, what = found
        where = f'in period {period} of {len(states) - 1}' if period else 'at the start'
        return Repetition(recorded, episode.periods, success, f'{what} first differs {where}'
                          + _reason(recorded, episode), period)

    def _fresh(self, recorded: RecordedEpisode) -> Episode:
        about = recorded.about
        key = tuple(about.get(name) for name in (
            'task', 'arguments', 'period_s', 'action', 'latency', 'noise'))
        try:
            if self._episode is None or key != self._key:
                task = create_task(about['task'], **recorded.json('arguments'))
                self._episode, self._key = Episode(
                    task, Simulation(task.world), recorded.period_s, about['action'],
                    recorded.json('latency'), noise=recorded.json('noise')), key
            # Time goes on over the episodes of a record.
            self._episode.simulation.step_count = int(about['steps'])
            self._episode.reset(recorded.seed, recorded.json('drawn') or None)
        except (CommandError, ModelError) as error:
            raise RecordError(f'episode {recorded.number} cannot be repeated here: {error}'
                              ) from error
        except Exception as error:  # A record may say anything in place of names and numbers.
            raise RecordError(f'episode {recorded.number} cannot be repeated here: '
                              f'{type(error).__name__} {one_line(str(error), 200)}') from error
        return self._episode


def _difference(episode: Episode, state: np.ndarray, digest: str | None) -> str | None:
    """Return what differs from what was recorded at the present instant, or None."""
    if not np.array_equal(physics_state(episode.simulation), state, equal_nan=True):
        return 'the state'
    if digest is not None and digest != episode.digest:
        return 'the digest'
    return None


def _reason(recorded: RecordedEpisode, episode: Episode) -> str:
    """Return why a repetition may differ, from what is known."""
    here = f'manip_sim {package_version()} with MuJoCo {mujoco.mj_versionString()}'
    if recorded.versions != here:
        return f': it was recorded by {recorded.versions}, this is {here}'
    if files_of(recorded.model) != files_of(episode.task.world.to_archive()):
        return ': the model is another one than that of the record'
    return f'; both are {here}' + (
        '' if recorded.about.get('machine') is None else
        f", recorded on {recorded.about['machine']} with NumPy {recorded.about.get('numpy')}")
