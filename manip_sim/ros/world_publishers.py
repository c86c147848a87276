# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Topics of the whole world, and the log of its robots at the start.

The topics are the descriptions of the robots and the model, the start of the present episode, the
task that is done in it, the safety state, and the journal.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
import json
import time
from typing import Any, TYPE_CHECKING

import mujoco
import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import String, UInt8MultiArray

from manip_sim.control.modes import MODES, POSITION
from manip_sim.control.reflexes import RUNNING, SAFETY_STATES
from manip_sim.interface.composition import with_contents
from manip_sim.interface.topics import BY_NAME, hardware_of, Scope, STALLS
from manip_sim.models.asset_files import LostShape
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.urdf_writer import Hardware, TOPIC_PLUGIN, urdfs_of
from manip_sim.models.world import inferred_by_model, skipped_geoms, World
from manip_sim.rclpy_internals import missing_for_publishing
from manip_sim.resources import package_version
from manip_sim.ros.channel_publishers import InstrumentPublishers
from manip_sim.ros.feature import create_output, create_publisher, Feature, NodeContext
from manip_sim.ros.messages import missing_note
from manip_sim.simulation import SimulatedRobot, Simulation

if TYPE_CHECKING:
    from manip_sim.tasks import Task


class DynamicsPublisher(Feature):
    """A latched publisher of ``~/dynamics``, which says what a URDF does not: JSON by joint."""

    def __init__(self, context: NodeContext) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/dynamics'])
        self._simulation = context.simulation
        self._gravity_compensation = context.parameters.value('gravity_compensation')
        self._robots: list[str] = []

    def started(self) -> None:
        self.publish()

    def world_changed(self) -> None:
        if [*self._simulation.robots] != self._robots:
            self.publish()

    def publish(self) -> None:
        self._robots = [*self._simulation.robots]
        self._publisher.publish(String(data=json.dumps({
            'timestep': self._simulation.timestep_s,
            'gravity_compensation': self._gravity_compensation,
            'joints': {name: asdict(joint) for robot in self._simulation.robots.values()
                       for name, joint in robot.dynamics().items()}}, allow_nan=False)))


class DescriptionPublisher(Feature):
    """
    Latched publishers of ``robot_description`` of each robot.

    A ``<ros2_control>`` tag for the present control modes names the topics as they are called
    after remapping.

    :param instruments: that its sensors are
    """

    def __init__(self, context: NodeContext, instruments: InstrumentPublishers) -> None:
        self._context, self._instruments = context, instruments
        self._simulation = context.simulation
        self._has_tag = context.parameters.value('ros2_control_tag')
        self._robots: dict[Scope, SimulatedRobot] = {}
        self._publishers: dict[Scope, Publisher] = {}
        self._hardware: dict[str, Hardware] = {}
        for scope, robot in context.robots.items():
            self._add(scope, robot)

    def _add(self, scope: Scope, robot: SimulatedRobot) -> None:
        row, context = BY_NAME['robot_description'], self._context
        self._robots[scope] = robot
        self._publishers[scope] = create_publisher(
            context, replace(row, name=scope.topic(row.name)))
        if self._has_tag:
            value = context.parameters.value
            self._hardware[robot.name] = hardware_of(
                self._simulation, robot, scope, value('ros2_control_plugin'),
                value('stepping') == 'lockstep', context.node.resolve_topic_name,
                context.node.get_fully_qualified_name(), self._instruments.rates_hz)

    def started(self) -> None:
        """
        Publish the descriptions.

        :raises ModelError: if the world does not compile
        """
        self._publish(self._context.composition.world, self._robots)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._add(scope, robot)
        self._publish(self._simulation.world, [scope])

    def robot_removed(self, scope: Scope) -> None:
        self._hardware.pop(self._robots.pop(scope).name, None)
        self._context.node.destroy_publisher(self._publishers.pop(scope))

    def _publish(self, world: World, scopes: Iterable[Scope]) -> None:
        urdfs = urdfs_of(world, self._hardware)
        for scope in scopes:
            urdf = urdfs[self._robots[scope].name]
            self._publishers[scope].publish(String(data=urdf.xml))
            if urdf.notes:
                name = f'{scope.name}: ' if scope.name else ''
                self._context.notes.append(f'{name}robot_description: {"; ".join(urdf.notes)}')


class ModelPublisher(Feature):
    """
    Latched publishers of the composed model; it comes again when robots or objects come or go.

    ``~/mjcf`` is its MJCF, ``~/mjcf_archive`` a zip archive of the MJCF and of the files, such as
    meshes, that it refers to.
    """

    def __init__(self, context: NodeContext) -> None:
        self._mjcf = create_publisher(context, BY_NAME['~/mjcf'])
        self._archive = create_publisher(context, BY_NAME['~/mjcf_archive'])
        self._simulation, self._world = context.simulation, context.composition.world

    def started(self) -> None:
        self._publish(self._world)

    def world_changed(self) -> None:
        self._publish(self._simulation.world)

    def _publish(self, world: World) -> None:
        """
        Publish the model.

        :raises ModelError: if a file cannot be read
        """
        xml, archive = world.to_xml_and_archive()
        self._mjcf.publish(String(data=xml))
        self._archive.publish(UInt8MultiArray(data=array('B', archive)))


#: Of how many episodes the digests are kept for states that are restored.
_REMEMBERED = 1000
#: Interval at which new content is published, wall time [s].
_JOURNAL_S = 0.05


class EpisodePublisher(Feature):
    """
    A latched publisher of ``~/episode``: JSON, at the start and after each reset.

    It publishes after a restore, too, if that leads to another episode. Its keys are ``seed``,
    ``drawn`` (what ``randomization`` drew, by name, in SI units), ``versions`` of ``manip_sim``,
    ``mujoco`` and ``numpy``, ``digest`` of the start, and ``stamp_ns`` of the first states.

    :param context: with a thread that has not been started
    :param restart: puts the simulation to its start, from a seed or as it was
    :param joints_changed: is called in the simulation's thread when joints were drawn
    """

    def __init__(self, context: NodeContext, restart: Callable[[int | None], None],
                 joints_changed: Callable[[], None]) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/episode'])
        self._simulation: Simulation = context.simulation
        self._restart_simulation, self._joints_changed = restart, joints_changed
        #: Digests of the starts of all episodes that may be in a saved state, by what they are of.
        self._digests: dict[str, str] = {}
        self._published: tuple[int, Any] | None = None
        self._refresh = context.thread.observers.refresh
        context.thread.changes.operations.restart = self._restart
        context.thread.observe(self._follow, look=self._is_another)

    def start(self) -> None:
        """
        Begin the first episode.

        It begins as all others: parameters do not undo draws, nor leave a change of mode behind.
        """
        self._restart(self._simulation.seed)

    def _restart(self, seed: int | None) -> None:
        self._restart_simulation(seed)
        if len(self._digests) >= _REMEMBERED:
            del self._digests[next(iter(self._digests))]
        self._digests[self._key()] = self._simulation.digest()
        # It is published with the first states, as their stamp is not known yet.
        self._published = None
        self._refresh()

    def _is_another(self) -> bool:
        """Return whether another episode has begun, or a state of another one was restored."""
        return (self._simulation.seed, self._simulation.randomized.drawn) != self._published

    def _follow(self, simulation: Simulation) -> None:
        if not self._is_another():
            return
        drawn = simulation.randomized.drawn
        self._published = simulation.seed, drawn
        self._publisher.publish(String(data=json.dumps({
            'seed': simulation.seed, 'drawn': drawn, 'versions': {
                'manip_sim': package_version(), 'mujoco': mujoco.mj_versionString(),
                'numpy': np.__version__},
            'digest': self._digests.get(self._key(), ''), 'stamp_ns': simulation.time_ns},
            allow_nan=False)))
        if any(name.startswith('joints/') for name in drawn):
            self._joints_changed()

    def _key(self) -> str:
        return repr((self._simulation.seed, self._simulation.randomized.drawn))


class TaskPublisher(Feature):
    """
    A latched publisher of ``~/task``: JSON, once for each instant.

    Its keys are ``task``, ``robot``, ``instruction``, ``seed`` of the start, ``stamp_ns`` of the
    instant, ``success``, ``reward``, and ``goal``, as the task has it. Resets draw the start of
    the task from the parameter ``seed``, where :meth:`restart` does them.

    :param context: with a thread that has not been started
    :param task: that is performed
    """

    def __init__(self, context: NodeContext, task: Task) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/task'])
        self._task, self._simulation, self._thread = task, context.simulation, context.thread
        self._seen_ns = -1
        self.restart(context.parameters.value('seed'))
        # Changes by the task at the end of a period are in the states that are published.
        context.thread.observe(self._end_period)

    def restart(self, seed: int | None) -> None:
        """Begin the episode of a seed, or the same one again."""
        from manip_sim.tasks import start  # It takes a while, and most nodes have no task.
        start(self._task, self._simulation, self.seed if seed is None else seed)

    @property
    def seed(self) -> int:
        """The seed of the present start."""
        return self._simulation.seed

    def _end_period(self, simulation: Simulation) -> None:
        if simulation.time_ns == self._seen_ns:
            return  # A state that is repeated.
        self._seen_ns = simulation.time_ns
        if not (self._thread.at_start or simulation.diverged):
            self._task.end_period(simulation)
        self._publisher.publish(String(data=json.dumps({
            'task': self._task.name, 'robot': self._task.robot.type_name,
            'instruction': self._task.instruction, 'seed': self.seed,
            'stamp_ns': simulation.time_ns, 'success': bool(self._task.success(simulation)),
            'reward': float(self._task.reward(simulation)),
            'goal': self._task.goal(simulation).tolist()})))


class JournalPublisher(Feature):
    """
    The publisher of ``~/journal``: JSON with the keys ``number``, from 0, and ``entries``.

    A :class:`~manip_sim.runtime.change_queue.Journal` makes the entries. It begins, with the
    present state, for each new subscriber, and ends when the last one has gone.

    :param context: with all parameters declared
    :param task: that is served, or None
    """

    def __init__(self, context: NodeContext, task: TaskPublisher | None) -> None:
        self._output = create_output(context, BY_NAME['~/journal'])
        self._operations = context.thread.changes.operations
        self._journal = context.thread.changes.journal
        # Those that change while the node runs are in the state, too.
        self._parameters = with_contents(context.parameters.values)
        self._task = task
        self._subscribers = self._number = 0
        self._published_s = 0.0
        context.thread.observe(self._follow, look=self._look)

    def _look(self) -> bool:
        if self._journal.active and not self._output.has_subscribers:
            self._journal.end()
            self._subscribers = 0
        return self._output.has_subscribers

    def _follow(self, simulation: Simulation) -> None:
        count = self._output.subscribers
        if count > self._subscribers or self._journal.incomplete:
            self._journal.begin({
                'parameters': self._parameters,
                'objects': self._operations.objects,
                'task_seed': None if self._task is None else self._task.seed}, self._publish)
        self._subscribers = count
        now_s = time.monotonic()
        if now_s >= self._published_s + _JOURNAL_S:
            self._published_s = now_s
            self._journal.flush()

    def _publish(self, entries: Sequence[Any]) -> None:
        self._output.publish(String(data=json.dumps({'number': self._number, 'entries': entries},
                                                    separators=(',', ':'))))
        self._number += 1

    def close(self) -> None:
        """Publish the remaining entries."""
        self._journal.end()


class SafetyStatePublisher(Feature):
    """
    A latched publisher of ``~/safety_state``, at each change: the worst of all robots.

    :param context: with a thread that has not been started
    """

    def __init__(self, context: NodeContext) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/safety_state'])
        self._simulation: Simulation = context.simulation
        self._published = ''
        context.thread.observe(self._publish, look=self._has_changed)

    def _present(self) -> str:
        states = [robot.safety_state for robot in self._simulation.robots.values()]
        return max(states, key=SAFETY_STATES.index, default=RUNNING)

    def _has_changed(self) -> bool:
        return self._present() != self._published

    def _publish(self, _: Simulation) -> None:
        if self._has_changed():
            self._published = self._present()
            self._publisher.publish(String(data=self._published))


Value = Callable[[str], Any]


class StartupLog(Feature):
    """Logs the robots of a simulation after its start, and what the user has to know of them."""

    def __init__(self, context: NodeContext) -> None:
        self._context, self._log = context, context.node.get_logger()

    def started(self) -> None:
        context, log, value = self._context, self._log, self._context.parameters.value
        simulation, world = context.simulation, context.simulation.world
        log.info(_introduction(context.robots, simulation, value, context.thread.paused))
        for note in (*_inferred(world), *simulation.lowered_gains, *context.notes,
                     *([missing_note(context.missing)] if context.missing else ())):
            log.info(note)
        for name in missing_for_publishing():
            log.warning(f'no {name}: Python does nothing else while a message is published')
        for sentence in skipped_geoms(world):
            log.warning(sentence)
        for defect in simulation.start_defects:
            log.warning(f'start: {defect}')
        if (value('ros2_control_tag') and value('stepping') == 'lockstep'
                and value('ros2_control_plugin') == TOPIC_PLUGIN):
            log.warning(STALLS)
        if context.node.get_parameter('use_sim_time').value:
            log.warning('use_sim_time has no effect here: this node is the source of the time')

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        world = self._context.simulation.world
        for note in (*_inferred(world, robot.robot_model), *robot.joints.lowered):
            self._log.info(note)
        for sentence in skipped_geoms(world, robot.robot_model):
            self._log.warning(sentence)


def _introduction(robots: Mapping[Scope, SimulatedRobot], simulation: Simulation, value: Value,
                  paused: bool) -> str:
    """
    Return a description of the robots: their parts, modes, limits and topics.

    :param robots: by the scope of their topics and parameters
    :param simulation: of the robots
    :param value: returns the value of a parameter
    :param paused: whether the simulation is paused
    """
    lines = []
    for scope, robot in robots.items():
        name = f'{scope.name}: ' if scope.name else ''
        task = value('task')
        composition = (f'{value("robot")}, task {task}' if task else
                       f'{value(scope.parameter("robot"))} in arena {value("arena")}')
        lines.append(f'{name}{composition}, '
                     f'{value("stepping")}, {value("publish_rate"):g} Hz, timestep '
                     f'{simulation.timestep_s:g} s'
                     + (', paused until ~/pause is called' if paused else ''))
        lines += _parts(scope, robot, value)
    space = '<robot>/' if any(scope.name for scope in robots) else ''
    lines.append(f'  states on {space}joint_states and {space}<part>/joint_states, commands '
                 f'on {space}<part>/command, {space}<part>/joint_command and '
                 f'{space}joint_command')
    return '\n'.join(lines)


def _parts(scope: Scope, robot: SimulatedRobot, value: Value) -> Iterator[str]:
    for name, part in robot.parts.items():
        if not part.joints or part.atomic != (name,):
            continue
        mode = POSITION.name
        if part.gripper is None and part.actuators:
            mode = value(scope.parameter(f'control_mode.{name}'))
        yield f'  {name}: {mode} mode, joints {", ".join(part.joints)}'
        if part.gripper is None:
            limits = ' '.join(f'[{low:g}, {high:g}]' for low, high in robot.limits(name))
            yield f'    limits {limits} {" or ".join(MODES[mode].units)}'


def _inferred(world: World, robot: RobotModel | None = None) -> Iterator[str]:
    """
    Yield the inferences about each model that comes from a file, but for lost shapes.

    Arms without a gripper, which have no topics of an end effector, are named with the remedy.

    :param world: the world of the models
    :param robot: that all is about; None: the whole world
    """
    for name, sentences in inferred_by_model(world, robot):
        kept = [sentence for sentence in sentences if not isinstance(sentence, LostShape)]
        if kept:
            yield f'{name}: inferred: {"; ".join(kept)}'
    for model in world.robots if robot is None else [robot]:
        if isinstance(model, ManipulatorModel):
            for arm in model.arms:
                if arm not in model.grippers:
                    yield (f"{model.name}: arm '{arm}' has no gripper, so no {arm}/eef_pose, "
                           f'{arm}/target_pose or {arm}/wrench; gripper:=NullGripper puts a bare '
                           f"flange with these on '{model.eef_name[arm]}'")
