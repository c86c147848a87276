# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node: builds robots from parameters and serves their simulation by its features."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import contextlib
import threading
from typing import Any, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from manip_sim.control.law.kept import all_are_kept
from manip_sim.errors import ManipSimError, ParameterError, SimulationEnded
from manip_sim.interface.topics import PUBLISHED, SUBSCRIBED, Topic, topics_of_surroundings
from manip_sim.rclpy_internals import RCLError, without_source
from manip_sim.ros.action_servers import ActionServers, MotionsUntilContact, offer_actions
from manip_sim.ros.camera_publishers import Cameras
from manip_sim.ros.channel_publishers import (
    clock, InstrumentPublishers, lidar_scans, object_states, OfferedSensors, robot_states)
from manip_sim.ros.command_subscribers import RobotCommands, SurroundingsCommands
from manip_sim.ros.diagnostics import Diagnostics
from manip_sim.ros.executor import BACKGROUND_THREAD, load_laws, RejectionLog
from manip_sim.ros.feature import add_offered_features, create_context, Feature, NodeContext
from manip_sim.ros.services import LiveParameters, SimulationServices
from manip_sim.ros.standard_services import StandardServices
from manip_sim.ros.visualization_topics import OdometryPublishers, SceneTopics
from manip_sim.ros.world_publishers import (
    DescriptionPublisher, DynamicsPublisher, EpisodePublisher, JournalPublisher, ModelPublisher,
    SafetyStatePublisher, StartupLog, TaskPublisher)

F = TypeVar('F', bound=Feature)


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
    _names: Mapping[str, str] = {}

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
        context = self.shared = create_context(self, self.rejections, self._ends)
        self.declared, self.simulation, self.thread, self.table, self._names = (
            context.parameters, context.simulation, context.thread, context.table,
            context.profile.names)
        self._add_features(context)
        add_offered_features(context, self.get_logger().warning)
        self._add(StartupLog(context))
        self._parameters_changed([])
        self.declared.check_qos_names()
        context.is_built = True
        self.add_post_set_parameters_callback(self._parameters_changed)

    def renamed(self, name: str) -> str:
        """Return what a topic, service or action of ours is called with the profile."""
        return self._names.get(name, name)

    def _add(self, feature: F) -> F:
        self.shared.features.append(feature)
        return feature

    def _add_features(self, context: NodeContext) -> None:
        """Create the features, in the order in which they publish a state."""
        task = None
        restart: Callable[[int | None], None] = self.simulation.reset
        if context.composition.task is not None:
            task = self._add(TaskPublisher(context, context.composition.task))
            restart = task.restart
        self._live = self._add(LiveParameters(context))
        self._add(robot_states(context))
        self.commands = self._add(RobotCommands(context))
        self._add(OfferedSensors(context))
        self._add(ModelPublisher(context))
        self._add(object_states(context))
        self.surroundings = self._add(SurroundingsCommands(context))
        instruments = self._add(InstrumentPublishers(context))
        odometry = self._add(OdometryPublishers(context))
        self._add(SceneTopics(context, odometry.placed))
        if self.declared.value('publish_clock'):
            self._add(clock(context))
        self._add(DescriptionPublisher(context, instruments))
        dynamics = self._add(DynamicsPublisher(context))
        self._add(EpisodePublisher(context, restart, dynamics.publish))
        self.cameras = self._add(Cameras(context))
        for lidar in context.composition.world.lidars:
            self._add(lidar_scans(context, lidar))
        self.actions = offer_actions(context, self.commands)
        if self.actions is not None:
            self._add(self.actions)
        self._add(SafetyStatePublisher(context))
        self._motions = self._add(MotionsUntilContact(context, self.commands))
        self._add(SimulationServices(context))
        self._add(StandardServices(context))
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
        return self._live.set_atomically(parameter_list, super().set_parameters_atomically)

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
        if self.shared.command_thread is not None:
            self.shared.command_thread.start()
        if kept:
            # The first command should not wait for them, and steps in Python cost more.
            threading.Thread(target=load_laws, name=BACKGROUND_THREAD).start()
        for feature in self.shared.features:
            feature.started()

    def compile_laws(self) -> None:
        """
        Compile the control laws, in any thread; :meth:`start` does so unless they are kept.

        :raises ManipSimError: if they cannot be kept
        """
        self.get_logger().info('Compiling control laws, once, which takes about a minute')
        load_laws()

    def destroy_node(self) -> None:
        """End the simulation and destroy the node."""
        self.stop()
        super().destroy_node()

    @property
    def ended_thread(self) -> str:
        """Name of the thread of the node that has ended unexpectedly, or empty."""
        threads = {'the thread that takes commands': self.shared.command_thread,
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
