# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node: builds robots from parameters and serves their simulation."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from functools import partial
import threading
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from manip_sim.control.law.kept import all_are_kept
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import ManipSimError, ParameterError, SimulationEnded
from manip_sim.interface.composition import (
    compose_world, declare_cameras, declare_parts, spawn_files)
from manip_sim.interface.ros2_control import STALLS
from manip_sim.interface.scope import Scope
from manip_sim.interface.topics import PUBLISHED, SUBSCRIBED, Topic
from manip_sim.interface.world_topics import (
    topics_of_objects, topics_of_surroundings, topics_of_world)
from manip_sim.models import World
from manip_sim.models.missing_meshes import lost_shapes
from manip_sim.models.urdf_writer import TOPIC_PLUGIN
from manip_sim.quoting import one_line
from manip_sim.rclpy_internals import RCLError, without_source
from manip_sim.ros.action_servers import ActionServers, offer_actions
from manip_sim.ros.camera_publishers import offer_cameras
from manip_sim.ros.command_inbox import CommandThread, create_command_inbox
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.diagnostics import Diagnostics
from manip_sim.ros.episode_publishers import EpisodePublisher, TaskPublisher
from manip_sim.ros.instrument_publishers import InstrumentPublishers
from manip_sim.ros.journal_publisher import JournalPublisher
from manip_sim.ros.lidar_publishers import offer_lidars
from manip_sim.ros.optional_packages import missing_note
from manip_sim.ros.overrides import check_qos_names, check_qos_values
from manip_sim.ros.publishing_thread import PublishingThread
from manip_sim.ros.rejection_log import RejectionLog
from manip_sim.ros.robot_description import DescriptionPublisher, DynamicsPublisher
from manip_sim.ros.scene import check_frame_prefix, SceneTopics
from manip_sim.ros.sensor_publishers import offer_sensors
from manip_sim.ros.served_robot import ServedRobot
from manip_sim.ros.services import SimulationServices
from manip_sim.ros.standard_services import offer_simulation_interfaces
from manip_sim.ros.startup_log import inferred, introduction
from manip_sim.ros.state_publishers import ClockPublisher, ModelPublisher
from manip_sim.ros.surroundings_topics import SurroundingsTopics
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import SimulatedRobot, Simulation

#: How many publications may wait, by stepping: states would become old in ``free``, else as many
#: as a second of states, while a reader does not acknowledge.
_MOST = {'free': 32, 'realtime': 20_000}


class SimNode(Node):
    """
    A node that serves simulated robots; :meth:`start` lets it run, :meth:`stop` ends it.

    :param arguments: further arguments of ``rclpy.node.Node``, such as ``context`` and
        ``parameter_overrides``
    :raises ManipSimError: if a parameter cannot be used, or the models do not fit together
    """

    actions: ActionServers | None = None
    #: True once everything is declared that belongs to the start.
    is_built = False

    def __init__(self, **arguments: Any) -> None:
        #: The rows of the table for this world but for objects; none while rclpy makes its own
        #: topics.
        self.table: list[Topic] = []
        try:
            super().__init__('manip_sim', **arguments)
        except InvalidParameterTypeException as error:
            raise ParameterError(str(error).rpartition(': ')[0]) from error
        except RCLError as error:
            raise ManipSimError(without_source(error)) from error
        self.rejections = RejectionLog(self.get_logger())
        #: What ends the threads that there are.
        self._ends = contextlib.ExitStack()
        try:
            self._build()
        except Exception:  # Others of its process would see a node that does not answer.
            self.destroy_node()
            raise

    def _build(self) -> None:
        check_qos_values(self)
        self.declared = Parameters(self)
        value = self.declared.value
        #: Notes for the user that are logged after the start.
        self.notes: list[str] = []
        self.missing: dict[str, str] = {}
        composition = compose_world(self.declared)
        world = composition.world
        self.simulation = Simulation(world)
        self.robots = dict(zip(composition.scopes, self.simulation.robots.values()))
        declare_parts(self.declared, [(scope, r.parts) for scope, r in self.robots.items()])
        cameras = declare_cameras(self.declared, world, self.simulation.model)
        self.declared.check_names()
        for scope, robot in self.robots.items():
            self.declared.couple(scope, robot.parts)
        self.inbox = create_command_inbox(self, self.rejections)
        lockstep = value('stepping') == 'lockstep'
        self._command_thread = (None if self.inbox is None or lockstep
                                else CommandThread(self.inbox))
        # In lock-step, the thread of the physics waits for the answer to a state in any case.
        self.publishing = None if lockstep else PublishingThread(_MOST[value('stepping')])
        if self.publishing is not None:
            self._ends.callback(self.publishing.stop)
        self.thread = SimulationThread(
            self.simulation, composition.steps, value('stepping'), value('real_time_factor'),
            {robot.name: self._lockstep_parts(scope, robot)
             for scope, robot in self.robots.items()},
            value('start_paused'), self._report_failure, self.inbox if lockstep else None,
            None if self._command_thread is None else self._command_thread.take,
            None if self.publishing is None else self.publishing.flush,
            lockstep and any(ARENA in value(scope.parameter('lockstep_parts'))
                             for scope in self.robots))
        self._check_lockstep()
        self.thread.pause_at(value('pause_at'))
        self.table = topics_of_world(
            [(scope, robot.parts, robot.joints.twist_indices is not None)
             for scope, robot in self.robots.items()],
            cameras={name: images.depth for name, images in cameras.items()},
            task=composition.task is not None, surroundings=self.simulation.surroundings,
            lidars={lidar.name: lidar.rays.rings > 1 for lidar in world.lidars})
        restart: Callable[[int | None], None] = self.simulation.reset
        self._task = None
        if composition.task is not None:
            self._task = TaskPublisher(self, composition.task)
            restart = self._task.restart
        self.frame_prefix = check_frame_prefix(value('frame_prefix'))
        self._serve_robots()
        offer_sensors(self)
        self._show_world(world)
        self._episode = EpisodePublisher(self, restart)
        self.cameras = offer_cameras(self, cameras)
        self._followers.append(self.cameras.follow)
        offer_lidars(self, world.lidars)
        self.actions = offer_actions(self)
        SimulationServices(self)
        offer_simulation_interfaces(self, spawn_files(value('spawn_roots')))
        Diagnostics(self)
        self._publish_truth()
        self._journal = JournalPublisher(self, self._task)
        # The last that is added here is the first to end.
        for end in (self.cameras.stop, self._journal.close, self.thread.stop):
            self._ends.callback(end)
        if self._command_thread is not None:
            self._ends.callback(self._command_thread.stop)
        check_qos_names(self)
        self.is_built = True
        self.add_post_set_parameters_callback(self._parameters_changed)
        self.thread.restarted = self._show_settings
        self._world = world

    def _serve_robots(self) -> None:
        self._truths: list[tuple[Scope, Callable[[], None], bool]] = []
        #: What uses the value of a live parameter of no robot, by its name.
        self._uses: dict[str, Callable[[Any], None]] = {
            'real_time_factor': self.thread.set_real_time_factor,
            'pause_at': self.thread.pause_at,
            'seed': partial(setattr, self.thread, 'next_seed'),
            'keyframe': partial(self.thread.change, 'keyframe')}
        self.served: dict[Scope, ServedRobot] = {}
        for scope, robot in self.robots.items():
            self.serve(scope, robot)
        self.commands = [served.commands for served in self.served.values()]

    def serve(self, scope: Scope, robot: SimulatedRobot) -> ServedRobot:
        """Publish the states of a robot, whose parameters are declared, and take its commands."""
        served = self.served[scope] = ServedRobot(self, scope, robot)
        self.publish_truth_by(scope, served.states.publish_truth)
        return served

    def _show_world(self, world: World) -> None:
        self.surroundings = SurroundingsTopics(self)
        model = ModelPublisher(self)
        self.instruments = InstrumentPublishers(self)
        for scope in self.robots:
            self.publish_truth_by(scope, partial(self.instruments.publish_truth, scope))
        for shown in (self.surroundings, self.instruments):
            self.thread.observe(shown.publish, look=shown.look)
        self.scene = SceneTopics(self)
        if self.declared.value('publish_clock'):
            clock = ClockPublisher(self)
            self.thread.observe(clock.publish, look=clock.look)
        self._followers = [
            lambda simulation: model.publish(simulation.world), self.instruments.follow,
            self.surroundings.follow, self.scene.follow]
        self.dynamics = DynamicsPublisher(self)
        self.descriptions = DescriptionPublisher(self, world)
        self._at_start: list[Callable[[], None]] = [
            partial(model.publish, world), self.descriptions.publish, self.dynamics.publish]

    def publish_truth_by(self, scope: Scope, publish: Callable[[], None], images: bool = False
                         ) -> None:
        """
        Call a function once when noise or latency of a robot is set.

        :param publish: publishes exact values beside those that are measured
        :param images: only when noise or latency of images is set
        """
        self._truths.append((scope, publish, images))

    def forget_truths(self, scope: Scope) -> None:
        """Forget what :meth:`publish_truth_by` was told about a robot, which is deleted."""
        self._truths = [entry for entry in self._truths if entry[0] != scope]

    def _publish_truth(self) -> None:
        ready = []
        for entry in self._truths:
            settings = self.robots[entry[0]].sensing.settings
            if settings.measures_images if entry[2] else settings.measures:
                ready.append(entry)
        # A new publisher declares parameters, which calls this again.
        self._truths = [entry for entry in self._truths if entry not in ready]
        for entry in ready:
            entry[1]()
        if ready:
            self.thread.observers.look_again()

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

    def _check_lockstep(self) -> None:
        names = [scope.parameter('lockstep_parts') for scope in self.robots]
        if self.declared.value('stepping') == 'lockstep' and not any(
                part for name in names for part in self.declared.value(name)):
            raise ParameterError(f"parameter '{names[0]}': lockstep needs at least one part")

    def _show_settings(self) -> None:
        """Let parameters have the values that act, as a reset or a restored state changes them."""
        def acting() -> tuple[dict[str, Any], dict[str, bool]]:
            seed = self.thread.next_seed
            values: dict[str, Any] = {
                'seed': self.simulation.seed if seed is None else seed,
                'keyframe': self.simulation.episode_start.keyframe}
            timeouts: dict[str, bool] = {}
            for served in self.served.values():
                values.update(served.acting)
                timeouts.update(served.timeouts)
            return values, timeouts
        with contextlib.suppress(SimulationEnded):
            self.declared.show(*self.thread.call(acting))

    def _parameters_changed(self, parameters: list[Parameter]) -> None:
        # After the end of the simulation there is nothing to change.
        with contextlib.suppress(SimulationEnded):
            for parameter in () if self.declared.showing else parameters:
                if parameter.name in self._uses:
                    self.thread.call(partial(self._uses[parameter.name], parameter.value))
                for served in self.served.values():
                    served.parameter_changed(parameter)
            self._publish_truth()

    def create_publisher(self, message_type: Any, topic: str, *arguments: Any, **keywords: Any
                         ) -> Publisher:
        """Create a publisher as rclpy does; what does not match it is in the diagnostics."""
        self._check_listed(PUBLISHED, topic)
        return super().create_publisher(message_type, topic, *arguments, **{
            'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False), **keywords})

    def create_subscription(self, message_type: Any, topic: str, *arguments: Any, **keywords: Any
                            ) -> Any:
        self._check_listed(SUBSCRIBED, topic)
        return super().create_subscription(message_type, topic, *arguments, **keywords)

    def _check_listed(self, direction: str, topic: str) -> None:
        # With use_sim_time rclpy subscribes to the clock.
        if not self.table or (direction, topic) == (SUBSCRIBED, '/clock'):
            return
        listed = [*self.table, *topics_of_objects(self.simulation.entities.free_names),
                  *topics_of_surroundings(self.simulation.surroundings)]
        if not any((row.direction, row.name) == (direction, topic) for row in listed):
            raise ManipSimError(f"'{topic}' is {direction} but not in the table of topics")

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters as rclpy does, but say more about those that cannot be set."""
        reason = self.declared.rejection(parameter_list)
        if reason is not None:
            return SetParametersResult(successful=False, reason=reason)
        try:
            return super().set_parameters_atomically(parameter_list)
        except Exception as error:  # The class of a control mode may raise anything.
            self._show_settings()
            return SetParametersResult(successful=False, reason=one_line(str(error)))

    def world_changed(self, simulation: Simulation) -> None:
        """Let all that depends on the robots and objects of the world follow it."""
        for follow in self._followers:
            follow(simulation)

    def _report_failure(self, what: str, error: Exception) -> None:
        self.rejections.failure('commands', what, error)

    def _introduce(self) -> None:
        log = self.get_logger()
        value = self.declared.value
        log.info(introduction(self.robots, self.simulation, value, self.thread.paused))
        for note in (*inferred(self._world), *self.simulation.lowered_gains, *self.notes,
                     *([missing_note(self.missing)] if self.missing else ())):
            log.info(note)
        for sentence in lost_shapes(self._world):
            log.warning(sentence)
        for defect in self.simulation.start_defects:
            log.warning(f'start: {defect}')
        if (value('ros2_control_tag') and value('stepping') == 'lockstep'
                and value('ros2_control_plugin') == TOPIC_PLUGIN):
            log.warning(STALLS)
        if self.get_parameter('use_sim_time').value:
            log.warning('use_sim_time has no effect here: this node is the source of the time')

    def start(self) -> None:
        """
        Start the simulation, then publish and log what it consists of.

        :raises ManipSimError: if the world cannot be described
        """
        kept = all_are_kept()
        if not kept:
            self.get_logger().info('Compiling control laws, once, which takes up to a minute')
            _load_laws()
        self.cameras.start()
        self._episode.begin()
        self._show_settings()
        self.thread.start()
        if self._command_thread is not None:
            self._command_thread.start()
        if kept and self.declared.value('stepping') == 'realtime':
            # The first command should not wait for them.
            threading.Thread(target=_load_laws, name='laws').start()
        # The first state should not wait for these, which take longer.
        for publish in self._at_start:
            publish()
        self._introduce()

    def destroy_node(self) -> None:
        """End the simulation and destroy the node, its action servers too, unlike rclpy."""
        self.stop()
        if self.actions is not None:
            self.actions.destroy()
        super().destroy_node()

    @property
    def ended_thread(self) -> str:
        """Which thread of the node has ended unexpectedly; empty if none has."""
        threads = {'the thread that takes commands': self._command_thread,
                   'the thread that publishes': self.publishing}
        return next((what for what, thread in threads.items()
                     if thread is not None and not thread.is_alive), '')

    def end_goals(self) -> None:
        """Abort the goals of actions and inform their clients, while the executor still spins."""
        if self.actions is not None:
            self.actions.end()

    def stop(self) -> None:
        """End the simulation and all threads of the node; again, this does nothing."""
        self._ends.close()


def _load_laws() -> None:
    from manip_sim.control.law.loading import load_laws  # It imports numba.
    load_laws()
