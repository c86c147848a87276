# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks: a world, its drawn starts, the condition of success, a reward and a name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.faults import FaultPlan
from manip_sim.models.object_creation import Description
from manip_sim.models.randomization import Randomization
from manip_sim.models.registry import Registry
from manip_sim.models.robots import create_robot, ManipulatorModel, robot_names
from manip_sim.models.world import compose, DEFAULT, Gripper, Grippers, Robot, World
from manip_sim.quoting import pluralize
from manip_sim.validation import listed
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert
from manip_sim.tasks.placing import nearness

#: Height of the table's top [m].
TABLE_M = 0.8
#: Of the starts of robots, unless the composition says otherwise; robosuite's default.
_NOISE: Mapping[str, Any] = {'type': 'gaussian', 'magnitude': 0.02}
#: Middle of the area on the table that one arm of two works in, in front of the right one [m].
_RIGHT_M = -0.2
#: Robots of the catalogue that do not reach the area on the table from where they stand.
TOO_SHORT: Mapping[str, str] = MappingProxyType({
    'GR1': 'its hands do not reach the middle of the table',
    'SO101': 'its gripper points down less than 0.1 m above its foot and 0.35 m away'})


class Task(ABC):
    """
    Aim of a robot, without the way; a subclass registers itself by its :attr:`name`.

    A task keeps nothing of an episode: everything that :meth:`start` draws and :meth:`end_period`
    changes is in the simulation (poses of objects and mocap bodies), so that saved states hold it
    and any number of simulations of :attr:`world` can share the task.

    :cvar name: such as ``pick_cube``
    :cvar instruction: what to do, as one would say it
    :cvar horizon_s: an episode is over after this simulated time [s]
    :cvar arms_needed: number of arms with grippers that the robot must have
    :cvar arms_in_all: number of arms that take part, where several robots may bring them
    :cvar needs_fingers: whether the grippers must be able to grasp
    :cvar own_gripper: the gripper that replaces ``default``
    :cvar unable: why robots of the catalogue cannot do it where they stand, by class
    :cvar expert_fails: how often the expert succeeds with robots with which it often fails, by
        class
    :param robot: as for ``compose``
    :param gripper: as for ``compose``
    :param composition: what else ``compose`` takes, such as ``cameras`` or ``timestep_s``;
        ``objects`` are there in addition to the task's own
    :raises ModelError: if the robot cannot do it, naming those that can, or as ``compose`` does
    :raises UnknownNameError: if a name is not known
    :ivar arguments: what it was made of: ``robot``, ``gripper`` and the composition
    :ivar world: the world of the task
    :ivar robot: the model of the robot, of several the first
    :ivar arm: the arm that the task is for, the right one of two
    """

    name: ClassVar[str]
    instruction: ClassVar[str]
    horizon_s: ClassVar[float]
    arms_needed: ClassVar[int] = 1
    arms_in_all: ClassVar[int] = 1
    needs_fingers: ClassVar[bool] = True
    own_gripper: ClassVar[str] = DEFAULT
    unable: ClassVar[Mapping[str, str]] = MappingProxyType({})
    expert_fails: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        TASKS.register(cls)

    def __init__(self, robot: Robot = 'Panda', gripper: Gripper | Grippers = DEFAULT,
                 **composition: Any) -> None:
        self.arguments: dict[str, Any] = {'robot': robot, 'gripper': gripper, **composition}
        if composition.get('randomization') is not None:
            # Another process that repeats an episode needs what the file holds.
            composition['randomization'] = Randomization(composition['randomization'])
            self.arguments['randomization'] = composition['randomization'].given
        if 'faults' in composition:
            self.arguments['faults'] = FaultPlan(composition['faults']).given
        if isinstance(gripper, str) and gripper == DEFAULT:
            gripper = self.own_gripper
        self.world: World = self.compose(
            robot, gripper, {
                'initialization_noise': _NOISE, 'seed': 0, **composition, 'arena': self.arena(),
                'objects': [*self.objects(),
                            *listed(composition.get('objects', ()), 'objects')]})
        model = self.world.robots[0]
        self._check(model)
        assert isinstance(model, ManipulatorModel)
        self.robot = model
        self.arm = usable_arms(model, self.needs_fingers)[0]
        aside_m = float(self.work_area[1])
        if aside_m:
            self.world.arena.shift_camera('agentview', [0.0, aside_m, 0.0])

    def compose(self, robot: Robot, gripper: Gripper | Grippers, composition: dict[str, Any]
                ) -> World:
        """
        Return the world; by default with one robot.

        :param robot: as for ``compose``
        :param gripper: as for ``compose``
        :param composition: all else that ``compose`` gets, with arena and objects of the task
        :raises ModelError: as ``compose`` does
        """
        return compose(robot, gripper, **composition)

    def _check(self, robot: Any) -> None:
        """Reject a robot that cannot do the task."""
        arms, kind = usable_arms(robot, self.needs_fingers), type(robot).__name__
        moved = not {'position'}.isdisjoint(self.arguments)
        if len(arms) < self.arms_needed:
            kit = 'with grippers that grasp' if self.needs_fingers else 'with grippers'
            reason = (f'{self.name} needs {pluralize(self.arms_needed, "arm")} {kit}, '
                      f'{robot.type_name} has {len(arms)} here')
        elif kind in self.unable and not moved:
            reason = f'{self.name}: {kind} cannot do it, {self.unable[kind]}'
        else:
            return
        able = [name for name in robot_names() if self._suits(name)]
        raise ModelError(f'{reason}; these can do it with their own grippers: {", ".join(able)}')

    @classmethod
    def _suits(cls, name: str) -> bool:
        robot = create_robot(name)
        return (isinstance(robot, ManipulatorModel) and len(robot.arms) >= cls.arms_needed
                and type(robot).__name__ not in cls.unable)

    # ------------------------------------------------------------------ the world

    def arena(self) -> Arena:
        """Return the arena; by default the table without its cube."""
        return create_arena('table', cube=False)

    def objects(self) -> Iterable[Description]:
        """Return the objects, as for ``compose``; by default there are none."""
        return ()

    @property
    def work_area(self) -> FloatArray:
        """
        Middle of the area on the table that the arm works in, in ``world`` [m], shape (3,).

        The camera ``agentview`` of the arena, which looks at y = 0, is moved in front of it.
        """
        return np.array([0.0, _RIGHT_M if len(self.robot.arms) > 1 else 0.0, TABLE_M])

    # ------------------------------------------------------------------ an episode

    @abstractmethod
    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """
        Draw and place what differs between episodes, after ``simulation.reset(seed)``.

        It is called by ``manip_sim.tasks.start``, which then computes all of the start.

        :param simulation: of :attr:`world`
        :param random: the same for the same seed
        """

    def end_period(self, simulation: Simulation) -> None:  # noqa: B027
        """
        Change in the simulation what the physics does not, such as dirt that was wiped off.

        It is called after each control period, before success and reward are asked for.

        :param simulation: of :attr:`world`
        """

    @abstractmethod
    def success(self, simulation: Simulation) -> bool:
        """
        Return whether the task is done, as the physics of the present instant shows.

        :param simulation: of :attr:`world`
        """

    @abstractmethod
    def progress(self, simulation: Simulation) -> float:
        """
        Return how near the task is to being done, from 0 to 1.

        :param simulation: of :attr:`world`
        """

    def reward(self, simulation: Simulation) -> float:
        """
        Return the dense reward of the present instant: 1 at success, else below 1, from 0.

        :param simulation: of :attr:`world`
        """
        if self.success(simulation):
            return 1.0
        return 0.99 * min(max(self.progress(simulation), 0.0), 1.0)

    def goal(self, simulation: Simulation) -> FloatArray:
        """
        Return what an observation needs beside the states of robot and objects, shape (n,).

        :param simulation: of :attr:`world`
        :returns: such as the point to reach in ``world`` [m]; by default empty
        """
        return np.empty(0)

    def _end_effector(self, simulation: Simulation) -> FloatArray:
        """Return the position of ``grip_site`` of :attr:`arm` in ``world`` [m], shape (3,)."""
        return simulation.robot.end_effectors[self.arm].position(simulation.data)

    def _near(self, simulation: Simulation, position: FloatArray) -> float:
        """Return 1 for an end effector at a position in ``world`` [m], towards 0 far away."""
        return nearness(length(self._end_effector(simulation) - position))

    @abstractmethod
    def expert(self, simulation: Simulation) -> Expert:
        """
        Return a scripted policy that does the task.

        :param simulation: of :attr:`world`, which it reads instead of observations
        """


TASKS: Registry[Task] = Registry(
    'task', Task, takes=('robot', 'gripper'),  # type: ignore[type-abstract]
    key=lambda cls: cls.__dict__.get('name'))


def usable_arms(robot: Any, with_fingers: bool) -> list[str]:
    """
    Return the arms of a robot that have a gripper.

    :param with_fingers: only those whose gripper closes
    """
    if not isinstance(robot, ManipulatorModel):
        return []
    return [arm for arm in robot.arms if arm in robot.grippers
            and (robot.grippers[arm].dof > 0 or not with_fingers)]


def create_task(name: str, robot: Robot = 'Panda', gripper: Gripper | Grippers = DEFAULT,
                **composition: Any) -> Task:
    """
    Create a task.

    :param name: of the task, such as ``pick_cube``
    :param robot: as for ``compose``
    :param gripper: as for ``compose``; ``default`` is the robot's own, unless the task needs
        another one
    :param composition: what else ``compose`` takes, such as ``cameras`` or ``timestep_s``
    :raises UnknownNameError: if the task or part is unknown, naming the nearest ones
    :raises ModelError: if the robot cannot do the task, naming those that can
    """
    return TASKS.create(name, robot=robot, gripper=gripper, **composition)
