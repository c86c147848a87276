# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Demonstrations of a task with a device: recorded, and each repeated at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
import time
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.experiments.devices import Device, DISCARD, QUIT
from manip_sim.records import EpisodeRecorder
from manip_sim.records.recorded import Record
from manip_sim.records.repeating import Repetition, Replay
from manip_sim.tasks import Episode
from manip_sim.tasks.episode_actions import STEP_M, TURN_RAD

#: Speed of an end effector at full deflection [m/s, rad/s].
_SPEED, _TURN = 0.25, 1.0


@dataclass(frozen=True)
class Demonstration:
    """
    A demonstration.

    :ivar seed: of its start
    :ivar file: its record; None if it was discarded
    :ivar success: whether it ended with success
    :ivar periods: control periods
    :ivar repetition: what came of repeating it; None if it was discarded
    :ivar quits: whether there are to be no more
    """

    seed: int
    file: Path | None
    success: bool
    periods: int
    repetition: Repetition | None
    quits: bool

    @property
    def repeats(self) -> bool:
        """True if the record repeats to the same end, to the last bit."""
        return self.repetition is not None and self.repetition.difference is None


class Demonstrator:
    """
    Lets a device act in episodes.

    :param episode: of the task, with actions ``osc_pose``; a file may have others
    :param device: that acts
    :param folder: of the records, which are called SEED.mcap
    :param settings: for the records, JSON
    :param show: is called after each period with time [s], success and external force [N]
    """

    def __init__(self, episode: Episode, device: Device, folder: Path,
                 settings: Mapping[str, Any],
                 show: Callable[[float, bool, float], object] = lambda *_: None) -> None:
        self._episode, self._device, self._folder = episode, device, folder
        self._settings, self._show = dict(settings), show
        self._replay = Replay()
        self._scale = np.repeat([_SPEED / STEP_M, _TURN / TURN_RAD], 3) * episode.period_s

    def run(self, seed: int) -> Demonstration:
        """
        Let the device act in the episode of a seed, record it, and repeat the record.

        :raises ManipSimError: if the device or the physics fails, or nothing can be recorded; then
            there is no record
        """
        episode = self._episode
        unfinished = self._folder / f'.{seed}.mcap'
        episode.reset(seed)
        try:
            with EpisodeRecorder(unfinished, episode, self._settings, overwrite=True) as recorder:
                recorder.begin(seed)
                event = self._act(recorder)
                recorder.end()
            success, kept = episode.success, event != DISCARD and episode.periods and (
                event != QUIT or not self._device.is_live)
            if not kept:
                return Demonstration(seed, None, success, episode.periods, None, event == QUIT)
            file = unfinished.rename(self._folder / f'{seed}.mcap')
        finally:
            unfinished.unlink(missing_ok=True)
        (recorded,) = Record(file).episodes()
        return Demonstration(seed, file, success, episode.periods, self._replay.repeat(recorded),
                             event == QUIT)

    def _act(self, recorder: EpisodeRecorder) -> str:
        """Act until the episode or the demonstration ends; return the event that ended it."""
        episode, closing = self._episode, np.full(len(self._episode.actions.arms), -1.0)
        begin_s = time.monotonic()
        while not episode.over:
            reading = self._device.read()
            if reading.event:
                return reading.event
            if reading.toggles:
                closing[0] = -closing[0]
            action = self._action(reading.motion, closing)
            episode.step(action)
            recorder.period(action)
            now_s = episode.periods * episode.period_s
            self._show(now_s, episode.success, self._force())
            if self._device.is_live:
                time.sleep(max(0.0, begin_s + now_s - time.monotonic()))
        self._device.end()
        return ''

    def _action(self, motion: FloatArray, closing: FloatArray) -> FloatArray:
        """Return the action of a motion; a person moves the first arm."""
        if not self._device.is_live:
            return motion
        action = np.zeros(self._episode.actions.size)
        for index, item in enumerate(self._episode.actions.arms):
            if index == 0:
                action[item.goals] = motion * self._scale
            action[item.gripper] = closing[index]
        return action

    def _force(self) -> float:
        """Return the greatest external force on a gripper [N]."""
        return max((float(np.linalg.norm(robot.sensing.measured(f'{arm}/external_wrench')[:3]))
                    for robot in self._episode.simulation.robots.values()
                    for arm in robot.end_effectors), default=0.0)
