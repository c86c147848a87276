# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The base class of the features of a node."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.parameter import Parameter

from manip_sim.interface.scope import Scope
from manip_sim.simulation import SimulatedRobot


class Feature:
    """
    A service of the node, such as the topics of all cameras; its methods do nothing by default.

    Its constructor creates what the node has from the start, for the robots of the context too.
    All methods are called in the thread that spins the node, or before it spins, on each feature
    in the order of the list in ``sim_node.py``; :meth:`close` in the reverse order.
    """

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
