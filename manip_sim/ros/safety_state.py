# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish whether robots run, were stopped, or recover."""

from __future__ import annotations

from std_msgs.msg import String

from manip_sim.control.reflexes import RUNNING, SAFETY_STATES
from manip_sim.interface.topics import BY_NAME
from manip_sim.ros.feature import create_publisher, Feature, NodeContext
from manip_sim.simulation import Simulation


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
