# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""All that decides what an episode of a seed is, as plain data: task, robot, actions, latency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any, Union

from manip_sim.errors import ModelError
from manip_sim.models.composing import DEFAULT, Gripper, Grippers, Robot
from manip_sim.models.randomization import Randomization
from manip_sim.quoting import shown
from manip_sim.simulation import Simulation
from manip_sim.tasks.episode import Episode
from manip_sim.tasks.latency import Latency, LatencyLike, NO_LATENCY
from manip_sim.tasks.pictures import CameraLike, descriptions, Pictures, views_of
from manip_sim.tasks.task import create_task, Task


@dataclass(frozen=True)
class Setting:
    """
    What episodes are made of.

    :ivar task: its name, a YAML file, or an instance
    :ivar robot: as for ``compose``; a task that is an instance has its own
    :ivar gripper: as for ``compose``
    :ivar action: what actions mean, one of ``manip_sim.tasks.ACTIONS``
    :ivar control_hz: actions per second of simulated time [Hz]
    :ivar latency: of commands and states, in simulated time [s], see :class:`Latency`
    :ivar cameras: whose images are observed: names, or descriptions as for ``compose``
    :ivar image_size: width and height of images [pixels]; None for those of the cameras
    :ivar noise: of all robots, by the names of the node's parameters, such as
        ``noise.joint_position``
    :ivar composition: what else ``compose`` takes, such as ``timestep_s``
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

    def __post_init__(self) -> None:
        rate = self.control_hz
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not (
                0.0 < rate < math.inf):
            raise ModelError(f'control_hz must be above 0 Hz, got {shown(rate)}')
        object.__setattr__(self, 'latency', Latency.of(self.latency))

    @property
    def plain_composition(self) -> dict[str, Any]:
        """The composition with the content of files that are not only named."""
        found = dict(self.composition)
        if found.get('randomization') is not None:
            found['randomization'] = Randomization(found['randomization']).given
        return found

    def create_task(self) -> Task:
        """
        Return the task.

        :raises UnknownNameError: if there is no such task or part
        :raises ModelError: if the robot cannot do it, naming those that can
        """
        if isinstance(self.task, Task):
            return self.task
        cameras = [*self.composition.get('cameras', ()), *descriptions(self.cameras)]
        return create_task(self.task, self.robot, self.gripper,
                           **{**self.composition, 'cameras': cameras})

    def create_episode(self, task: Task | None = None, simulation: Simulation | None = None,
                       pictures: Pictures | None = None) -> Episode:
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

    def create_pictures(self, simulation: Simulation, task: Task) -> Pictures | None:
        """
        Return what renders the images of the cameras; None if there are none.

        :param simulation: of the task's world
        :param task: as :meth:`create_task` returns it
        :raises ManipSimError: if a camera cannot be chosen, or nothing can be rendered
        """
        views = views_of(self.cameras, task.world, simulation, self.image_size)
        return Pictures(simulation, views) if views else None
