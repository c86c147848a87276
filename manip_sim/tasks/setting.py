# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Everything that determines an episode of a seed, as data: task, robot, actions, latency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import functools
import logging
import math
import multiprocessing
from typing import Any, Union

from manip_sim.errors import ModelError
from manip_sim.models.composing import DEFAULT, Gripper, Grippers, Robot
from manip_sim.models.faults import FaultPlan
from manip_sim.models.randomization import Randomization
from manip_sim.quoting import format_value
from manip_sim.simulation import Simulation
from manip_sim.tasks.episode import Episode
from manip_sim.tasks.late_answers import AnswerTime, AnswerTimeLike, LateAnswers, NO_ANSWER_TIME
from manip_sim.tasks.latency import Latency, LatencyLike, NO_LATENCY
from manip_sim.tasks.pictures import (
    CameraLike, checked_kinds, descriptions, Pictures, PictureThreads, views_of)
from manip_sim.tasks.task import create_task, Task
from manip_sim.validation import fitting_timestep, steps_of


@dataclass(frozen=True)
class Setting:
    """
    Parts of which episodes are made.

    :ivar task: its name, or an instance
    :ivar robot: as for ``compose``; a task that is an instance has its own
    :ivar gripper: as for ``compose``
    :ivar action: what actions mean, one of ``manip_sim.tasks.ACTIONS``
    :ivar control_hz: actions per second of simulated time [Hz]
    :ivar latency: of commands and states, in simulated time [s], see :class:`Latency`
    :ivar cameras: whose images are observed: names, or descriptions as for ``compose``
    :ivar image_size: width and height of images [pixels]; None for the cameras' sizes
    :ivar noise: of all robots, by the names of the node's parameters, such as
        ``noise.joint_position``
    :ivar image_kinds: of the cameras: ``rgb``, ``depth`` and ``labels``
    :ivar composition: what else ``compose`` takes, such as ``timestep_s``
    :ivar answer_time: how long the policy thinks, see :class:`AnswerTime`
    """

    task: Union[str, Task]
    robot: Robot = 'Panda'
    gripper: Union[Gripper, Grippers] = DEFAULT
    action: str = 'osc_pose'
    control_hz: float = 20.0
    latency: LatencyLike = NO_LATENCY
    cameras: tuple[CameraLike, ...] = ()
    image_size: tuple[int, int] | None = None
    composition: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    answer_time: AnswerTimeLike = NO_ANSWER_TIME
    image_kinds: Sequence[str] = ('rgb',)

    def __post_init__(self) -> None:
        rate = self.control_hz
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not (
                0.0 < rate < math.inf):
            raise ModelError(f'control_hz must be above 0 Hz, got {format_value(rate)}')
        object.__setattr__(self, 'latency', Latency.of(self.latency))
        object.__setattr__(self, 'answer_time', AnswerTime.of(self.answer_time))
        object.__setattr__(self, 'image_kinds', checked_kinds(self.image_kinds))

    @property
    def plain_composition(self) -> dict[str, Any]:
        """The composition with the content of files that are not only named."""
        composition = dict(self.composition)
        if composition.get('randomization') is not None:
            composition['randomization'] = Randomization(composition['randomization']).given
        if 'faults' in composition:
            composition['faults'] = FaultPlan(composition['faults']).given
        return composition

    def create_task(self) -> Task:
        """
        Return the task.

        If no timestep is given, it has the longest up to its own that fits ``control_hz``; a
        warning is logged then, once for each process that is not a worker of another one.

        :raises UnknownNameError: if the task or part is unknown
        :raises ModelError: if the robot cannot do it, naming those that can
        """
        if isinstance(self.task, Task):
            return self.task
        cameras = [*self.composition.get('cameras', ()), *descriptions(self.cameras)]
        composition = {**self.composition, 'cameras': cameras}
        task = create_task(self.task, self.robot, self.gripper, **composition)
        period_s, timestep_s = 1.0 / self.control_hz, task.world.timestep_s
        if steps_of(period_s, timestep_s) or 'timestep_s' in composition or not (
                fitted_s := fitting_timestep(period_s, timestep_s)):
            return task
        if multiprocessing.parent_process() is None:
            _log_timestep(self.control_hz, timestep_s, fitted_s)
        return create_task(self.task, self.robot, self.gripper,
                           **{**composition, 'timestep_s': fitted_s})

    def create_episode(self, task: Task | None = None, simulation: Simulation | None = None,
                       pictures: Pictures | PictureThreads | None = None) -> Episode:
        """
        Return an episode that has to be reset.

        :param task: as :meth:`create_task` returns it; None creates it
        :param simulation: of the task's world; None creates it
        :param pictures: of the cameras; None creates them
        :raises ManipSimError: if something cannot be used
        """
        task = self.create_task() if task is None else task
        simulation = Simulation(task.world) if simulation is None else simulation
        return Episode(task, simulation, 1.0 / self.control_hz, self.action, self.latency,
                       self.create_pictures(simulation, task) if pictures is None else pictures,
                       self.noise)

    def create_answers(self, episode: Episode) -> LateAnswers:
        """
        Return the way of the policy's answers to an episode.

        :param episode: of this setting
        :raises ModelError: if the rate of chunks does not fit the timestep
        """
        return LateAnswers(episode, AnswerTime.of(self.answer_time))

    def create_pictures(self, simulation: Simulation, task: Task, threads: int = 1
                        ) -> Pictures | PictureThreads | None:
        """
        Return what renders the images of the cameras; None if there are none.

        :param simulation: of the task's world
        :param task: as :meth:`create_task` returns it
        :param threads: that render at once
        :raises ManipSimError: if a camera cannot be chosen, or nothing can be rendered
        """
        views = views_of(self.cameras, task.world, simulation, self.image_size)
        if not views:
            return None
        create = functools.partial(Pictures, simulation, views, self.image_kinds)
        return create() if threads == 1 else PictureThreads(create, threads)


@functools.cache
def _log_timestep(rate_hz: float, timestep_s: float, fitted_s: float) -> None:
    logging.getLogger(__name__).warning(
        'control rate of %g Hz: the timestep is %.9g s instead of %g s, so that a control period '
        'is %d whole timesteps', rate_hz, fitted_s, timestep_s,
        steps_of(1.0 / rate_hz, fitted_s))
