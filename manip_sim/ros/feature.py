# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Features of a node: their base class, the context that they share, and their publishers.

The context holds what is composed of the node's parameters, its threads and its names.

Features of other packages are found here too, and their failures end nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
import inspect
from queue import SimpleQueue
import threading
from typing import Any, ClassVar, NamedTuple

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message

from manip_sim.errors import ManipSimError, ModelError, ParameterError, SimulationEnded
from manip_sim.interface.composition import (
    compose_world, Composition, declare_cameras, declare_parts)
from manip_sim.interface.offered_sensors import filled_in
from manip_sim.interface.parameter_spec import ParameterSpec, spawned_parameter
from manip_sim.interface.profiles import JointNames, load_profile, Profile
from manip_sim.interface.topics import Scope, Topic, topics_of_robot, topics_of_world
from manip_sim.quoting import one_line, quoted
from manip_sim.rclpy_internals import parameter_overrides, publish_bytes, RCLError
from manip_sim.resources import Offer, offers
from manip_sim.ros.command_inbox import CommandInbox, CommandThread, create_command_inbox
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.executor import RejectionLog, RESULT_ROUNDS, Rounds
from manip_sim.ros.messages import message_class
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import SimulatedRobot, Simulation

#: Period at which who waits checks whether the thread still runs [s].
_WATCH_S = 0.5
#: Number of publications that may wait, by stepping: states would become old in ``free``, else as
#: many as there are states in a second, while a reader does not acknowledge.
_MOST = {'free': 32, 'realtime': 20_000}


class PublishingThread:
    """
    A thread that publishes messages in the order in which they are added.

    Messages and their order are the same as without it. rclpy would keep Python's global lock
    while it publishes; :func:`manip_sim.rclpy_internals.publish_bytes` does not.

    :param most: publications that may wait, from 2; who adds more has to wait for earlier ones
    """

    def __init__(self, most: int) -> None:
        self._half = most // 2
        self._waiting: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name='publishing')
        self._begun = self._ended = False
        self._lock = threading.Lock()
        #: Number of added ones; the event is set when all up to the last multiple of half are out.
        self._count = 0
        self._published = threading.Event()
        self._published.set()

    def add(self, publish: Callable[[], object]) -> None:
        """
        Let the thread publish; any thread may call this.

        :param publish: publishes one message, and raises nothing
        """
        if not self._begun:
            with self._lock:
                if not (self._begun or self._ended):
                    self._thread.start()
                    self._begun = True
        if self._ended:
            publish()
            return
        self._waiting.put(publish)
        self._count += 1
        if self._count % self._half == 0:
            before, self._published = self._published, self._mark()
            self._wait(before)

    def _mark(self) -> threading.Event:
        """Return an event that is set once all earlier messages have been published."""
        done = threading.Event()
        self._waiting.put(done.set)
        return done

    def _wait(self, done: threading.Event) -> None:
        while not done.wait(_WATCH_S) and self.is_alive:
            pass

    def flush(self) -> None:
        """Wait until all earlier messages have been published."""
        if self._begun and not self._ended and threading.current_thread() is not self._thread:
            self._wait(self._mark())

    @property
    def is_alive(self) -> bool:
        """True if the thread has not ended unexpectedly."""
        return not self._begun or self._ended or self._thread.is_alive()

    def stop(self) -> None:
        """Publish the waiting messages, and end; the caller publishes later ones."""
        with self._lock:
            begun, self._ended = self._begun and not self._ended, True
        if begun:
            self._waiting.put(None)
            self._thread.join()

    def _run(self) -> None:
        while (publish := self._waiting.get()) is not None:
            publish()


class Feature:
    """
    A service of the node, such as the topics of all cameras; its methods do nothing by default.

    Its constructor creates what the node has from the start, for the robots of the context too.
    All methods are called in the thread that spins the node, or before it spins, on each feature
    in the order of the list in ``sim_node.py``; :meth:`close` in the reverse order.

    :cvar topics: of a feature of another package: rows of the topics that it publishes and
        subscribes to; names may hold ``<part>`` or ``<arm>``
    :cvar parameters: of a feature of another package
    """

    topics: ClassVar[Sequence[Topic]] = ()
    parameters: ClassVar[Sequence[ParameterSpec]] = ()

    def __init__(self, context: NodeContext) -> None:
        """Create what the node has from the start."""

    def start(self) -> None:
        """Begin, before the simulation's thread starts."""

    def started(self) -> None:
        """Do what takes longer than the first state should wait, once the simulation runs."""

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        """Serve a robot that has come, whose parameters are declared."""

    def robot_removed(self, scope: Scope) -> None:
        """Let go of a robot, before it leaves the world."""

    def world_changed(self) -> None:
        """Follow the simulation after robots or objects have come or gone."""

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        """
        Use live parameters: at the end of the node's construction, and after each change.

        :param parameters: with new values, or just declared; none if only settings that act
            already are shown
        :raises SimulationEnded: if the simulation has ended
        """

    def close(self) -> None:
        """End, after the simulation's thread has ended."""


@dataclass
class NodeContext:
    """
    The objects that the features of a node share.

    :ivar node: creates publishers, subscriptions, services and timers
    :ivar simulation: used by ``thread`` alone while it runs
    :ivar thread: the simulation's thread
    :ivar robots: by the scope of their topics and parameters
    :ivar parameters: of the node, declared
    :ivar log: rejected messages and failures
    :ivar frame_prefix: start of all frame names in messages
    :ivar inbox: takes the messages of commands; None: the executor does
    :ivar publishing: the thread that publishes; None: publishers do so themselves
    :ivar table: the rows of the table of topics for this world
    :ivar composition: the world of the start
    :ivar profile: names of others for topics, services and actions
    :ivar joint_names: what joints are called in messages
    :ivar notes: sentences for the user, logged after the start
    :ivar missing: by a ROS package that is not installed, what does not exist without it
    :ivar command_thread: takes commands from ``inbox``; None: the thread of the simulation does
    :ivar offered: classes of features of other packages
    :ivar features: of the node, in order
    :ivar is_built: true once everything is declared that belongs to the start
    """

    node: Node
    simulation: Simulation
    thread: SimulationThread
    robots: dict[Scope, SimulatedRobot]
    parameters: Parameters
    log: RejectionLog
    frame_prefix: str
    inbox: CommandInbox | None
    publishing: PublishingThread | None
    table: list[Topic]
    composition: Composition
    profile: Profile = field(default_factory=Profile)
    joint_names: JointNames = field(default_factory=JointNames)
    notes: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    command_thread: CommandThread | None = None
    offered: Sequence[FeatureClass] = ()
    features: list[Feature] = field(default_factory=list)
    is_built: bool = False

    def world_changed(self) -> None:
        """Let all features follow robots or objects that have come or gone."""
        for feature in self.features:
            feature.world_changed()

    def add_robot(self, name: str) -> None:
        """Serve a robot that has come into the simulation, in the thread that spins the node."""
        scope, robot = Scope(name), self.simulation.robots[name]
        self.table += [row for row in topics_of_robot(scope, robot) if row not in self.table]
        self.robots[scope] = robot
        self.parameters.declare([spawned_parameter(scope)])
        declare_parts(self.parameters, [(scope, robot.parts)])
        for feature in self.features:
            feature.robot_added(scope, robot)
        self.world_changed()

    async def remove_robot(self, name: str, remove: Callable[[], object]) -> None:
        """
        Let go of a robot, whose goals are aborted; awaited in the thread that spins the node.

        :param remove: removes it from the simulation
        """
        scope = Scope(name)
        for feature in self.features:
            feature.robot_removed(scope)
        remove()
        del self.robots[scope]
        # Clients get the results of their goals before the servers are gone.
        await Rounds(self.node, RESULT_ROUNDS)
        self.world_changed()
        begin = scope.topic('')
        self.table[:] = [row for row in self.table if not row.name.startswith(begin)]
        self.parameters.undeclare(scope)

    def close_features(self) -> None:
        """Close all features, after the simulation's thread has ended."""
        for feature in reversed(self.features):
            feature.close()


def create_context(node: Node, log: RejectionLog, ends: ExitStack) -> NodeContext:
    """
    Compose the world that the parameters of a node describe, and create what its features share.

    Its threads do not run yet.

    :param ends: gets the functions that end the threads and close the features
    :raises ManipSimError: if a parameter cannot be used, or the models do not fit together
    """
    parameters = Parameters(node)
    composition = compose_world(parameters)
    profile = _profile(parameters, composition)
    simulation = Simulation(composition.world)
    robots = dict(zip(composition.scopes, simulation.robots.values()))
    declare_parts(parameters, [(scope, robot.parts) for scope, robot in robots.items()])
    composition = replace(composition, cameras=declare_cameras(
        parameters, composition.world, simulation.model))
    offered = load_features(parameters, node.get_logger().warning)
    parameters.check_names()
    frame_prefix = _frame_prefix(parameters)
    table = topics_of_world(
        simulation, robots, {name: images.depth for name, images in composition.cameras.items()},
        composition.task is not None)
    names, notes = JointNames(), []
    if profile.name:
        names = profile.joint_names(*robots.values())
        notes.append(f'profile {profile.name}: ' + ', '.join(
            f'{name} is {other}' for name, other in profile.names.items()))
    threads = _create_threads(node, log, parameters, simulation, composition.steps, robots)
    inbox, command_thread, publishing, thread = threads
    context = NodeContext(
        node, simulation, thread, robots, parameters, log, frame_prefix, inbox, publishing,
        table, composition, profile, names, notes, command_thread=command_thread,
        offered=offered)
    # The last that is added here is the first to end.
    if inbox is not None:
        ends.callback(inbox.close)
    if publishing is not None:
        ends.callback(publishing.stop)
    ends.callback(context.close_features)
    ends.callback(thread.stop)
    if command_thread is not None:
        ends.callback(command_thread.stop)
    return context


def _create_threads(node: Node, log: RejectionLog, parameters: Parameters, simulation: Simulation,
                    steps: int, robots: Mapping[Scope, SimulatedRobot]
                    ) -> tuple[CommandInbox | None, CommandThread | None, PublishingThread | None,
                               SimulationThread]:
    """Create the inbox of commands, and the threads that take them, publish and simulate."""
    value = parameters.value
    lockstep = value('stepping') == 'lockstep'
    lockstep_parts, waits_for_arena = parameters.lockstep_parts(simulation, robots)
    inbox = create_command_inbox(node, log)
    command_thread = None if inbox is None or lockstep else CommandThread(inbox)
    # In lock-step, the thread of the physics waits for the answer to a state in any case.
    publishing = None if lockstep else PublishingThread(_MOST[value('stepping')])
    thread = SimulationThread(
        simulation, steps, value('stepping'), value('real_time_factor'), lockstep_parts,
        value('start_paused'), lambda failed, error: log.failure('commands', failed, error),
        inbox if lockstep else None, None if command_thread is None else command_thread.take,
        None if publishing is None else publishing.flush, waits_for_arena)
    thread.pause_at(value('pause_at'))
    return inbox, command_thread, publishing, thread


def _frame_prefix(parameters: Parameters) -> str:
    prefix: str = parameters.value('frame_prefix')
    if prefix.startswith('/') or any(not c.isprintable() or c.isspace() for c in prefix):
        raise ParameterError(f"parameter 'frame_prefix': {quoted(prefix)} cannot begin the name "
                             "of a frame: it must not begin with '/' or contain spaces")
    return prefix


def _profile(parameters: Parameters, composition: Composition) -> Profile:
    profile = load_profile(parameters.value('profile'))
    if profile.name and any(scope.name for scope in composition.scopes):
        raise ParameterError("parameter 'profile' needs a node with one robot; start a node for "
                             'each, in namespaces')
    if profile.name and parameters.value('ros2_control_tag'):
        raise ParameterError("parameter 'profile' cannot be used with ros2_control_tag, whose "
                             "hardware needs the node's own names of joints")
    return profile


class Output:
    """
    A publisher that never stops the simulation.

    With history ``keep_all`` a reader that does not acknowledge fills the history. Publishing then
    waits (100 ms with Fast DDS) and fails. Until all messages are acknowledged or the reader is
    gone, further messages are dropped and counted without waiting.

    :param thread: publishes the messages; None: :meth:`publish` does so itself
    :param inbox: is told of the publisher, and notes whether subscriptions come or go
    """

    def __init__(self, publisher: Publisher, log: RejectionLog,
                 thread: PublishingThread | None = None, inbox: CommandInbox | None = None
                 ) -> None:
        self._publisher, self._inbox = publisher, inbox
        if inbox is not None:
            inbox.watch(publisher)
        self._thread = thread
        self._log = log
        self._count = 0
        #: ``matches`` of the inbox when subscriptions were counted.
        self._seen: int | None = None
        self._stalled = False
        self._closed = False

    @property
    def subscribers(self) -> int:
        """Number of subscriptions, which is asked for again when some have come or gone."""
        matches = None if self._inbox is None else self._inbox.matches
        if matches is None or matches != self._seen:
            # Noted first: others may come while it is counted.
            self._seen, self._count = matches, self._counted()
        return 0 if self._closed else self._count

    def _counted(self) -> int:
        try:
            return 0 if self._closed else int(self._publisher.get_subscription_count())
        except InvalidHandle:  # It is being closed in another thread.
            return 0

    @property
    def has_subscribers(self) -> bool:
        return self.subscribers > 0

    @property
    def wanted(self) -> bool:
        """True if there are subscribers and the next message can be published."""
        return self.has_subscribers and not self._drops()

    def _drops(self) -> bool:
        """Return whether the next message is dropped, and count it if so."""
        if self._stalled:
            self._stalled = not self._publisher.wait_for_all_acked(Duration())
            if self._stalled:
                topic = self._publisher.topic_name
                self._log.failed['publications'] += 1
                self._log.warn(topic, 'stalled', f'{topic}: a reader does not acknowledge, '
                               'messages are dropped until it does or is gone')
        return self._stalled

    def close(self, node: Node) -> None:
        """Destroy the publisher; no messages are wanted from now on."""
        self._closed = True
        if self._inbox is not None:
            self._inbox.forget(self._publisher)
        node.destroy_publisher(self._publisher)

    def publish(self, message: Any) -> None:
        """Publish a message or its serialized bytes, or count it as dropped."""
        if self._thread is None:
            self._publish(self._publisher.publish, message)
            return
        content = message if isinstance(message, bytes) else serialize_message(message)
        self._thread.add(partial(
            self._publish, partial(publish_bytes, self._publisher), content))

    def _publish(self, publish: Callable[[Any], None], message: Any) -> None:
        try:
            if not (self._stalled and self._drops()):
                publish(message)
        except InvalidHandle:  # It is being closed in another thread.
            pass
        except RCLError as error:
            self._stalled = True
            self._log.failure('publications', self._publisher.topic_name, error)


def qos_options(context: NodeContext, topic: str) -> dict[str, Any]:
    """
    Return the arguments with which parameters override the QoS of a topic that is created now.

    Topics that come while the node runs have no such parameters, unless they were given: a dump
    has to start a node in which the topics are not there yet.
    """
    begin = f'qos_overrides.{context.node.resolve_topic_name(topic)}.'
    if context.is_built and not any(
            name.startswith(begin) for name in parameter_overrides(context.node)):
        return {}
    return {'qos_overriding_options': QoSOverridingOptions.with_default_policies()}


def create_publisher(context: NodeContext, row: Topic, message_type: Any = None) -> Publisher:
    """Create the publisher of a row of the table, or of another message type."""
    message_type = message_type or message_class(row.type)
    if row.latched:
        return context.node.create_publisher(message_type, row.name, QoSProfile(
            depth=row.depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    return context.node.create_publisher(
        message_type, row.name, QoSProfile(depth=row.depth), **qos_options(context, row.name))


def create_output(context: NodeContext, row: Topic, message_type: Any = None) -> Output:
    """
    Create the output of a row of the table; at the start, parameters override its QoS.

    :param message_type: instead of that of the row
    """
    return Output(create_publisher(context, row, message_type), context.log, context.publishing,
                  context.inbox)


GROUP = 'manip_sim.features'
#: Whatever logs a line.
Warn = Callable[[str], object]


class FeatureClass(NamedTuple):
    """A class of another package, and the entry point that names it."""

    offer: Offer
    feature: type[Feature]


def load_features(parameters: Parameters, warn: Warn) -> list[FeatureClass]:
    """
    Return the features that other packages offer, whose parameters are declared afterwards.

    :param warn: is called with a line about each class that cannot be used
    :raises ParameterError: if the value that the user gave for a parameter cannot be used
    """
    loaded = []
    for offer in offers(GROUP).values():
        try:
            feature = _load(offer)
            taken = {spec.name for spec in feature.parameters} & {*parameters.names}
            if taken:
                raise ModelError(f"its parameter '{min(taken)}' exists already")
        except ManipSimError as error:
            warn(one_line(f'feature {offer} cannot be used: {error}'))
            continue
        parameters.declare(feature.parameters)
        loaded.append(FeatureClass(offer, feature))
    return loaded


def _load(offer: Offer) -> type[Feature]:
    feature = offer.load()
    if not (inspect.isclass(feature) and issubclass(feature, Feature)):
        raise ModelError(f'must be a class that derives from Feature, got {feature!r:.60}')
    for kind, rows in ((Topic, feature.topics), (ParameterSpec, feature.parameters)):
        if not (isinstance(rows, Sequence) and all(isinstance(row, kind) for row in rows)):
            raise ModelError(f'its {kind.__name__} rows must be a list of these, got {rows!r:.60}')
    return feature


def add_offered_features(context: NodeContext, warn: Warn) -> None:
    """Add the features of other packages; one that cannot be created does not hide the others."""
    for offer, feature in context.offered:
        before = [*context.table]
        try:
            context.features.append(OfferedFeature(context, offer, feature))
        except Exception as error:  # Code of another package may raise anything.
            context.table[:] = before
            warn(one_line(
                f'feature {offer} cannot be used: {type(error).__name__}: {error}'))


class OfferedFeature(Feature):
    """
    A feature of another package; an exception of a method is logged and counted.

    :raises Exception: what its constructor raises; :class:`ModelError`, if one of its topics
        exists already
    """

    def __init__(self, context: NodeContext, offer: Offer, feature: type[Feature]) -> None:
        self._context, self._offer, self._rows = context, offer, feature.topics
        self._list_topics(context.robots)
        self._feature = feature(context)

    def _list_topics(self, robots: Mapping[Scope, SimulatedRobot]) -> None:
        table = self._context.table
        for row in self._rows:
            for topic, _, _ in filled_in(row, robots):
                # A private topic is of the node: it is the same for each robot.
                if topic in table and topic.name == row.name:
                    continue
                if topic.name in {other.name for other in table}:
                    raise ModelError(f"its topic '{topic.name}' exists already")
                table.append(topic)

    def _call(self, method: Callable[[], None]) -> None:
        try:
            method()
        except SimulationEnded:
            raise
        except Exception as error:  # Code of another package may raise anything.
            self._context.log.failure('features', f'feature {self._offer}', error)

    def start(self) -> None:
        self._call(self._feature.start)

    def started(self) -> None:
        self._call(self._feature.started)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        def add() -> None:
            self._list_topics({scope: robot})
            self._feature.robot_added(scope, robot)
        self._call(add)

    def robot_removed(self, scope: Scope) -> None:
        self._call(lambda: self._feature.robot_removed(scope))

    def world_changed(self) -> None:
        self._call(self._feature.world_changed)

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        self._call(lambda: self._feature.parameters_changed(parameters))

    def close(self) -> None:
        self._call(self._feature.close)
