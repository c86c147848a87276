# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The objects that the features of a node share."""

from __future__ import annotations

from dataclasses import dataclass, field

from rclpy.node import Node

from manip_sim.interface.scope import Scope
from manip_sim.interface.topics import Topic
from manip_sim.ros.command_inbox import CommandInbox
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.feature import Feature
from manip_sim.ros.publishing_thread import PublishingThread
from manip_sim.ros.rejection_log import RejectionLog
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import SimulatedRobot, Simulation


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
    :ivar notes: sentences for the user, logged after the start
    :ivar missing: by a ROS package that is not installed, what does not exist without it
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
    notes: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    features: list[Feature] = field(default_factory=list)
    is_built: bool = False

    def world_changed(self) -> None:
        """Let all features follow robots or objects that have come or gone."""
        for feature in self.features:
            feature.world_changed()
