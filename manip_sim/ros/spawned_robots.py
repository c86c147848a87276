# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that come and go while the node runs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.interface.composition import check_robot_name, declare_parts
from manip_sim.interface.parameters import spawned_parameter
from manip_sim.interface.scope import Scope
from manip_sim.interface.world_topics import topics_of_robot
from manip_sim.models import compose_robot
from manip_sim.models.bases import base_names
from manip_sim.models.composing import DEFAULT, NONE
from manip_sim.models.files.requested_robot import load_requested
from manip_sim.models.files.xacro_expansion import split_arguments, stem_of
from manip_sim.models.grippers import gripper_names
from manip_sim.models.regular_files import FilesBelow, OneText
from manip_sim.models.robots import robot_names, RobotModel
from manip_sim.models.sources import is_path
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quoting import shown
from manip_sim.ros.background import in_background, RESULT_ROUNDS, Rounds
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.standard_answers import change_unless_diverged, free_name
from manip_sim.ros.startup_log import log_robot
from manip_sim.simulation.robot_spawning import plan_without_robot, RobotsPlan

#: Name of a robot that is sent as text.
UNNAMED = 'robot'


class RequestedRobot:
    """
    A robot, as a request describes it.

    :param values: ``robot``, a name of the catalogue, which includes the folders of
        ``model_path``, or a file; where they are not the robot's own ``gripper`` and ``base``,
        names of the catalogue; and ``name``
    :param where: where they come from, for messages
    :param files: those that a request may name
    :param folder: where relative paths begin; None: in the folders of ``spawn_roots``
    :raises ModelError: on one line, naming the key
    """

    #: The key that only robots have.
    KEY = 'robot'

    def __init__(self, values: Mapping[str, Any], where: str, files: FilesBelow,
                 folder: Path | None = None) -> None:
        self._given: Path | OneText | None = None
        self._files = files
        known = {'name': None, self.KEY: robot_names(),
                 'gripper': [DEFAULT, NONE, *gripper_names()],
                 'base': [DEFAULT, NONE, *base_names()]}
        for key, value in values.items():
            if key not in known:
                raise ModelError(f'{where}: {UnknownNameError("key", key, known)}')
            names = known[key]
            if not isinstance(value, str):
                raise ModelError(f'{where}: {key}: expected a name, got {shown(value)}')
            if names is None or value in names:
                continue
            if key != self.KEY or not is_path(value):
                raise ModelError(f'{where}: {UnknownNameError(key, value, names)}')
            self._given = files.first(
                files.places(value) if folder is None else [folder / value])
            files.check(self._given, 'robot file')
        self._values = values

    @classmethod
    def from_text(cls, text: OneText, files: FilesBelow) -> RequestedRobot:
        """
        Return the robot that a URDF is, which a request sends as text.

        :param text: names no files
        """
        robot = cls({}, str(text.file), files)
        robot._given, robot._values = text, {cls.KEY: UNNAMED}
        return robot

    @property
    def name(self) -> str:
        """The name that it gives itself, or what kind of robot it is."""
        named: str = self._values[self.KEY]
        own = named if self._given is None else stem_of(Path(split_arguments(named)[0]))
        found: str = self._values.get('name', own)
        return found

    def create(self, name: str, pose: Pose) -> RobotModel:
        """
        Create the robot.

        :param name: what all of its names begin with
        :param pose: of its base
        :raises ModelError: if the parts do not fit together
        """
        robot = compose_robot(
            self._values[self.KEY] if self._given is None else load_requested(
                self._given, self._files, name), self._values.get('gripper', DEFAULT),
            self._values.get('base', DEFAULT), prefix=f'{name}_', idn=name)
        # A message cannot leave out the height, so zero is no choice.
        robot.set_base_xpos(pose.position, may_be_raised=not pose.position[2])
        robot.set_base_quat(pose.quat_xyzw)
        return robot


class SpawnedRobots:
    """Add robots to the context and the features of a node, and remove them."""

    def __init__(self, context: NodeContext) -> None:
        self._context = context
        self._simulation, self._thread = context.simulation, context.thread

    @property
    def names(self) -> list[str]:
        """Names of the robots that can be deleted."""
        return list(self._simulation.spawned_robots)

    def free_name(self, wanted: str, may_rename: bool) -> str:
        """
        Return the name of a robot that comes.

        :param wanted: name that a client asks for
        :param may_rename: whether a number may follow it
        :raises Rejection: if it cannot be a name, or something has it
        """
        return free_name(
            wanted, may_rename, self._taken(),
            '{} is taken: by a robot, an object, a topic or a parameter', check_robot_name)

    def _taken(self) -> set[str]:
        context, simulation = self._context, self._simulation
        return {*simulation.robots, *simulation.entities.names,
                *(row.name.partition('/')[0] for row in context.table if '/' in row.name),
                *(name.partition('.')[0] for name in context.parameters.names if '.' in name)}

    def add(self, name: str, plan: RobotsPlan) -> None:
        """
        Add a robot, in the thread that spins the node.

        :param plan: with the robot
        :raises Rejection: if the physics is on hold
        """
        change_unless_diverged(self._simulation, self._thread,
                               partial(self._thread.change_robots, plan))
        context, scope, robot = self._context, Scope(name), self._simulation.robots[name]
        context.table += [row for row in topics_of_robot(scope, robot)
                          if row not in context.table]
        context.robots[scope] = robot
        context.parameters.declare([spawned_parameter(scope)])
        declare_parts(context.parameters, [(scope, robot.parts)])
        context.parameters.couple(scope, robot.parts)
        for feature in context.features:
            feature.robot_added(scope, robot)
        log_robot(context, robot)
        context.world_changed()

    async def remove(self, name: str) -> None:
        """
        Remove a robot, whose goals are aborted; to be awaited in the thread that spins the node.

        :param name: one of :attr:`names`
        :raises ModelError: if the world cannot be without it
        """
        context, simulation, scope = self._context, self._simulation, Scope(name)
        plan = await in_background(context.node, lambda: plan_without_robot(simulation, name))
        for feature in context.features:
            feature.robot_removed(scope)
        self._thread.change_robots(plan)
        del context.robots[scope]
        # Clients get the results of their goals before the servers are gone.
        await Rounds(context.node, RESULT_ROUNDS)
        context.world_changed()
        begin = scope.topic('')
        context.table[:] = [row for row in context.table if not row.name.startswith(begin)]
        context.parameters.undeclare(scope)
