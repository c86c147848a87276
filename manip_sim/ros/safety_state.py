# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish whether robots run, were stopped, or recover, and how motions until contact ended."""

from __future__ import annotations

import json

from std_msgs.msg import String

from manip_sim.control.cartesian.reports import Contact
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


class ContactPublisher(Feature):
    """
    A latched publisher of ``~/contact``, at each end of a motion until contact.

    :param context: with a thread that has not been started
    """

    def __init__(self, context: NodeContext) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/contact'])
        self._simulation: Simulation = context.simulation
        self._published = self._present()
        context.thread.observe(self._publish, look=lambda: bool(self._new()))

    def _present(self) -> dict[tuple[str, str], Contact | None]:
        return {(name, arm): report.contact for name, robot in self._simulation.robots.items()
                for arm, report in robot.joints.cartesian.reports.items()}

    def _new(self) -> dict[tuple[str, str], Contact]:
        return {of: contact for of, contact in self._present().items()
                if contact is not None and contact is not self._published.get(of)}

    def _publish(self, _: Simulation) -> None:
        for (robot, arm), contact in self._new().items():
            self._publisher.publish(String(data=json.dumps({
                'robot': robot, 'arm': arm, 'cause': contact.cause,
                'position': contact.position.tolist(), 'wrench': contact.wrench.tolist(),
                'distance': contact.distance, 'duration': contact.duration_s})))
        self._published = self._present()
