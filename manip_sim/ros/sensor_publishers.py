# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the topics that other packages add; what they raise stops the topic, not the node."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import serialize_message

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.interface.offered_sensors import Offered, offered_topics
from manip_sim.quoting import one_line
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import create_output, message_class
from manip_sim.ros.messages import stamp_of
from manip_sim.ros.node_context import NodeContext
from manip_sim.simulation import Simulation


class SensorPublisher:
    """
    The publisher of a topic of another package.

    :raises ModelError: if its class or the first message cannot be made
    """

    def __init__(self, context: NodeContext, offered: Offered) -> None:
        self._context = context
        self._offered = offered
        simulation, seed = context.simulation, context.parameters.value('seed')
        try:
            self._class = message_class(offered.topic)
            # A trial, by an instance of its own, which may remember what it has published.
            self._source = offered.create(simulation, seed)
            serialize_message(self._message(simulation) or self._class())
            self._source = offered.create(simulation, seed)
        except ManipSimError:
            raise
        except Exception as error:  # Code of another package may raise anything.
            raise ModelError(f'{type(error).__name__}: {error}') from error
        context.table.append(offered.topic)
        self._output = create_output(context, offered.topic)
        self._works = True

    def _message(self, simulation: Simulation) -> Any:
        """Return the message of the present instant, or None."""
        message = _checked(self._class)
        if hasattr(message, 'header'):
            message.header.stamp = stamp_of(simulation.time_ns)
            message.header.frame_id = self._source.frame and (
                self._context.frame_prefix + self._source.frame)
        return None if self._source.write(message, simulation) is False else message

    def look(self) -> bool:
        """Return whether there are subscribers, and messages for them."""
        return self._works and self._output.has_subscribers

    def publish(self, simulation: Simulation) -> None:
        """Publish the present instant; after a failure nothing is published any more."""
        if not self._works:
            return
        try:
            message = self._message(simulation)
            if message is not None:
                self._output.publish(message)
        except Exception as error:  # Code of another package may raise anything.
            self._works = False
            self._context.log.failure(
                'sensors', f'{self._offered.topic.name} ends, sensor {self._offered.offer}', error)


def _checked(message_class: Any) -> Any:
    """Return a message that checks its fields; rclpy would serialize a wrong type as garbage."""
    message = message_class(check_fields=True)
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            setattr(message, name, _checked(type(value)))
    return message


class OfferedSensors(Feature):
    """The topics that other packages add; those that cannot be used are logged."""

    def __init__(self, context: NodeContext) -> None:
        warn = context.node.get_logger().warning
        for offered in offered_topics(
                context.robots, context.table, lambda line: warn(one_line(line))):
            try:
                publisher = SensorPublisher(context, offered)
            except ManipSimError as error:
                warn(one_line(
                    f'{offered.topic.name}: sensor {offered.offer} cannot be used: {error}'))
            else:
                context.thread.observe(publisher.publish, look=publisher.look)
