# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node: builds robots from parameters and serves their simulation by its features."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import contextlib
import threading
from typing import Any, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from manip_sim.control.law.kept import all_are_kept, laws_folder
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import ManipSimError, ParameterError, SimulationEnded
from manip_sim.interface.composition import (
    compose_world, Composition, declare_cameras, declare_parts, spawn_files)
from manip_sim.interface.topics import (
    JointNames, load_profile, Profile, PUBLISHED, Scope, SUBSCRIBED, Topic, topics_of_surroundings,
    topics_of_world)
from manip_sim.models.cameras import ImageSettings
from manip_sim.quoting import one_line
from manip_sim.rclpy_internals import RCLError, without_source
from manip_sim.ros.action_servers import ActionServers, MotionsUntilContact, offer_actions
from manip_sim.ros.camera_publishers import Cameras
from manip_sim.ros.channel_publishers import (
    clock, InstrumentPublishers, lidar_scans, object_states, OfferedSensors, robot_states)
from manip_sim.ros.command_inbox import CommandThread, create_command_inbox
from manip_sim.ros.command_subscribers import RobotCommands, SurroundingsCommands
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.diagnostics import Diagnostics
from manip_sim.ros.executor import BACKGROUND_THREAD, RejectionLog
from manip_sim.ros.feature import (
    add_offered_features, Feature, load_features, NodeContext, PublishingThread)
from manip_sim.ros.services import LiveParameters, SimulationServices
from manip_sim.ros.standard_services import StandardServices
from manip_sim.ros.visualization_topics import check_frame_prefix, OdometryPublishers, SceneTopics
from manip_sim.ros.world_publishers import (
    DescriptionPublisher, DynamicsPublisher, EpisodePublisher, JournalPublisher, ModelPublisher,
    SafetyStatePublisher, StartupLog, TaskPublisher)
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.compiled_period import load

F = TypeVar('F', bound=Feature)
#: Number of publications that may wait, by stepping: states would become old in ``free``, else as
#: many as there are states in a second, while a reader does not acknowledge.
_MOST = {'free': 32, 'realtime': 20_000}


class SimNode(Node):
    """
    A node that serves simulated robots; :meth:`start` lets it run, :meth:`stop` ends it.

    :param arguments: further arguments of ``rclpy.node.Node``, such as ``context`` and
        ``parameter_overrides``
    :raises ManipSimError: if a parameter cannot be used, or the models do not fit together
    :ivar declared: its parameters
    :ivar simulation: the simulation that it serves
    :ivar thread: the simulation's thread
    :ivar rejections: rejected messages and failures
    :ivar shared: the context of its features, and the features
    """

    actions: ActionServers | None = None
    #: Names of others; none while rclpy makes its own topics.
    profile = Profile()

    def __init__(self, **arguments: Any) -> None:
        #: The rows of the table for this world; none while rclpy makes its own
        #: topics.
        self.table: list[Topic] = []
        try:
            super().__init__('manip_sim', **arguments)
        except InvalidParameterTypeException as error:
            raise ParameterError(str(error).rpartition(': ')[0]) from error
        except RCLError as error:
            raise ManipSimError(without_source(error)) from error
        self.rejections = RejectionLog(self.get_logger())
        #: Functions that end the present threads.
        self._ends = contextlib.ExitStack()
        try:
            self._build()
        except Exception:  # Others of its process would see a node that does not answer.
            self.destroy_node()
            raise

    def _build(self) -> None:
        self.declared = Parameters(self)
        composition = compose_world(self.declared)
        self.profile = self._load_profile(composition)
        self.simulation = Simulation(composition.world)
        robots = dict(zip(composition.scopes, self.simulation.robots.values()))
        declare_parts(self.declared, [(scope, r.parts) for scope, r in robots.items()])
        cameras = declare_cameras(self.declared, composition.world, self.simulation.model)
        offered = load_features(self.declared, self.get_logger().warning)
        self.declared.check_names()
        names = (self.profile.joint_names(*robots.values()) if self.profile.name else
                 JointNames())
        self.shared = self._create_context(composition, robots, names)
        if self.profile.name:
            self.shared.notes.append(f'profile {self.profile.name}: ' + ', '.join(
                f'{name} is {other}' for name, other in self.profile.names.items()))
        self.thread = self.shared.thread
        self.table += topics_of_world(
            self.simulation, robots, {name: images.depth for name, images in cameras.items()},
            composition.task is not None)
        self._add_features(self.shared, composition, cameras)
        add_offered_features(self.shared, offered, self.get_logger().warning)
        self._add(StartupLog(self.shared))
        self._parameters_changed([])
        self.declared.check_qos_names()
        self.shared.is_built = True
        self.add_post_set_parameters_callback(self._parameters_changed)

    def _create_context(self, composition: Composition, robots: dict[Scope, SimulatedRobot],
                        joint_names: JointNames) -> NodeContext:
        """Create the threads, which do not run yet, and the context that the features share."""
        value = self.declared.value
        frame_prefix = check_frame_prefix(value('frame_prefix'))
        inbox = create_command_inbox(self, self.rejections)
        lockstep = value('stepping') == 'lockstep'
        self._command_thread = None if inbox is None or lockstep else CommandThread(inbox)
        # In lock-step, the thread of the physics waits for the answer to a state in any case.
        publishing = None if lockstep else PublishingThread(_MOST[value('stepping')])
        thread = SimulationThread(
            self.simulation, composition.steps, value('stepping'), value('real_time_factor'),
            {robot.name: self._lockstep_parts(scope, robot) for scope, robot in robots.items()},
            value('start_paused'),
            lambda failed, error: self.rejections.failure('commands', failed, error),
            inbox if lockstep else None,
            None if self._command_thread is None else self._command_thread.take,
            None if publishing is None else publishing.flush,
            lockstep and any(ARENA in value(scope.parameter('lockstep_parts'))
                             for scope in robots))
        self._check_lockstep(robots)
        thread.pause_at(value('pause_at'))
        # The last that is added here is the first to end.
        if inbox is not None:
            self._ends.callback(inbox.close)
        if publishing is not None:
            self._ends.callback(publishing.stop)
        self._ends.callback(self._close_features)
        self._ends.callback(thread.stop)
        if self._command_thread is not None:
            self._ends.callback(self._command_thread.stop)
        return NodeContext(
            self, self.simulation, thread, robots, self.declared, self.rejections,
            frame_prefix, inbox, publishing, self.table,
            joint_names)

    def _load_profile(self, composition: Composition) -> Profile:
        profile = load_profile(self.declared.value('profile'))
        if profile.name and any(scope.name for scope in composition.scopes):
            raise ParameterError("parameter 'profile' needs a node with one robot; start a node "
                                 'for each, in namespaces')
        if profile.name and self.declared.value('ros2_control_tag'):
            raise ParameterError("parameter 'profile' cannot be used with ros2_control_tag, whose "
                                 "hardware needs the node's own names of joints")
        return profile

    def renamed(self, name: str) -> str:
        """Return what a topic, service or action of ours is called with the profile."""
        return self.profile.names.get(name, name)

    def _lockstep_parts(self, scope: Scope, robot: SimulatedRobot) -> list[str]:
        # In ROS parameters, a list with one empty string stands for an empty list of strings.
        name = scope.parameter('lockstep_parts')
        parts: list[str] = [part for part in self.declared.value(name) if part]
        if parts == ['arm'] and 'arm' not in robot.parts:
            return list(robot.parts)
        if ARENA in parts and self.simulation.surroundings.actuators:
            parts.remove(ARENA)
        for part in parts:
            if part not in robot.parts:
                raise ParameterError(f"parameter '{name}': this robot has no part '{part}'; it "
                                     f'has {", ".join(robot.parts)}')
        return parts

    def _check_lockstep(self, scopes: Iterable[Scope]) -> None:
        names = [scope.parameter('lockstep_parts') for scope in scopes]
        if self.declared.value('stepping') == 'lockstep' and not any(
                part for name in names for part in self.declared.value(name)):
            raise ParameterError(f"parameter '{names[0]}': lockstep needs at least one part")

    def _add(self, feature: F) -> F:
        self.shared.features.append(feature)
        return feature

    def _add_features(self, context: NodeContext, composition: Composition,
                      cameras: Mapping[str, ImageSettings]) -> None:
        """Create the features, in the order in which they publish a state."""
        world, task = composition.world, None
        restart: Callable[[int | None], None] = self.simulation.reset
        if composition.task is not None:
            task = self._add(TaskPublisher(context, composition.task))
            restart = task.restart
        self._live = self._add(LiveParameters(context))
        self._add(robot_states(context))
        self.commands = self._add(RobotCommands(context))
        self._add(OfferedSensors(context))
        self._add(ModelPublisher(context, world))
        self._add(object_states(context))
        self.surroundings = self._add(SurroundingsCommands(context))
        instruments = self._add(InstrumentPublishers(context))
        odometry = self._add(OdometryPublishers(context))
        self._add(SceneTopics(context, odometry.placed))
        if self.declared.value('publish_clock'):
            self._add(clock(context))
        self._add(DescriptionPublisher(context, world, instruments))
        dynamics = self._add(DynamicsPublisher(context))
        self._add(EpisodePublisher(context, restart, dynamics.publish))
        self.cameras = self._add(Cameras(context, cameras))
        for lidar in world.lidars:
            self._add(lidar_scans(context, lidar))
        self.actions = offer_actions(context, self.commands)
        if self.actions is not None:
            self._add(self.actions)
        self._add(SafetyStatePublisher(context))
        self._motions = self._add(MotionsUntilContact(context, self.commands))
        self._add(SimulationServices(context))
        self._add(StandardServices(context, spawn_files(self.declared.value('spawn_roots'))))
        self._add(Diagnostics(context, self.commands, self.surroundings, self.cameras))
        self._add(JournalPublisher(context, task))
        self.thread.restarted = self._live.show

    def _parameters_changed(self, parameters: list[Parameter]) -> None:
        # After the end of the simulation there is nothing to change.
        with contextlib.suppress(SimulationEnded):
            for feature in self.shared.features:
                feature.parameters_changed([] if self.declared.showing else parameters)
            self.thread.observers.refresh()

    def create_publisher(self, message_type: Any, topic: str, *arguments: Any, **keywords: Any
                         ) -> Publisher:
        """Create a publisher as rclpy does; what does not match it is in the diagnostics."""
        self._check_listed(PUBLISHED, topic)
        return super().create_publisher(message_type, self.renamed(topic), *arguments, **{
            'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False), **keywords})

    def create_subscription(self, message_type: Any, topic: str, *arguments: Any, **keywords: Any
                            ) -> Any:
        self._check_listed(SUBSCRIBED, topic)
        return super().create_subscription(
            message_type, self.renamed(topic), *arguments, **keywords)

    def create_service(self, service_type: Any, name: str, *arguments: Any, **keywords: Any
                       ) -> Any:
        return super().create_service(service_type, self.renamed(name), *arguments, **keywords)

    def resolve_topic_name(self, topic: str, **keywords: Any) -> str:
        return str(super().resolve_topic_name(self.renamed(topic), **keywords))

    def _check_listed(self, direction: str, topic: str) -> None:
        # With use_sim_time rclpy subscribes to the clock.
        if not self.table or (direction, topic) == (SUBSCRIBED, '/clock'):
            return
        listed = [*self.table, *topics_of_surroundings(self.simulation.surroundings)]
        if not any((row.direction, row.name) == (direction, topic) for row in listed):
            raise ManipSimError(f"'{topic}' is {direction} but not in the table of topics")

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters as rclpy does, but say more about those that cannot be set."""
        reason = self.declared.rejection(parameter_list)
        if reason is not None:
            return SetParametersResult(successful=False, reason=reason)
        before = {name: self.get_parameter(name) for name in self.declared.names}
        seed = self.thread.next_seed
        try:
            return super().set_parameters_atomically(parameter_list)
        except Exception as error:  # The class of a control mode may raise anything.
            self._take_back(before)
            self.thread.next_seed = seed
            self._live.show()
            return SetParametersResult(successful=False, reason=one_line(str(error)))

    def _take_back(self, before: Mapping[str, Parameter]) -> None:
        """Let parameters act as before a change that failed half-way."""
        self._live.show()
        with contextlib.suppress(Exception):
            super().set_parameters_atomically(self.declared.changed_since(before))

    def start(self) -> None:
        """
        Start the simulation, then publish and log what it consists of.

        :raises ManipSimError: if the world cannot be described
        """
        kept = all_are_kept()
        if not kept:
            self.compile_laws()
        for feature in self.shared.features:
            feature.start()
        self._live.show()
        self.thread.start()
        if self._command_thread is not None:
            self._command_thread.start()
        if kept:
            # The first command should not wait for them, and steps in Python cost more.
            threading.Thread(target=_load_laws, name=BACKGROUND_THREAD).start()
        for feature in self.shared.features:
            feature.started()

    def compile_laws(self) -> None:
        """
        Compile the control laws, in any thread; :meth:`start` does so unless they are kept.

        :raises ManipSimError: if they cannot be kept
        """
        self.get_logger().info('Compiling control laws, once, which takes about a minute')
        _load_laws()

    def destroy_node(self) -> None:
        """End the simulation and destroy the node."""
        self.stop()
        super().destroy_node()

    @property
    def ended_thread(self) -> str:
        """Name of the thread of the node that has ended unexpectedly, or empty."""
        threads = {'the thread that takes commands': self._command_thread,
                   'the thread that publishes': self.shared.publishing}
        return next((description for description, thread in threads.items()
                     if thread is not None and not thread.is_alive), '')

    def end_goals(self) -> None:
        """End goals and motions, and inform their clients, while the executor still spins."""
        self._motions.end()
        if self.actions is not None:
            self.actions.end()

    def stop(self) -> None:
        """End the simulation, all threads of the node and its features; again, nothing."""
        self._ends.close()

    def _close_features(self) -> None:
        for feature in reversed(self.shared.features):
            feature.close()


def _load_laws() -> None:
    from manip_sim.control.law.loading import load_laws  # It imports numba.
    try:
        load_laws()
        load()
    except OSError as error:
        raise ManipSimError(f'cannot keep compiled control laws in {laws_folder()}: '
                            f'{error.strerror}; set XDG_CACHE_HOME to another folder') from error
