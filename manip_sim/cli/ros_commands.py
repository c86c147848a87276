# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Topics, parameters and services on the command line, without the command ``ros2``.

Words and output as of ``ros2 topic``, ``ros2 param`` and ``ros2 service``.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
import importlib
import itertools
import math
import operator
import os
from pathlib import Path
import re
import statistics
import sys
import time
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterValue
import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.parameter import (
    get_parameter_value, parameter_dict_from_yaml_file, parameter_value_to_python)
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden
import yaml

from manip_sim.errors import ManipSimError, MessageError, UnknownNameError
from manip_sim.quoting import one_line, quoted
from manip_sim.rclpy_internals import (
    describe_missing, describe_unheard, RCLError, start_rclpy, without_source)
from manip_sim.ros_environment import apt_names
from manip_sim.startup import EndSignals

#: Time after which a name without any owner counts as unknown, time without changes of the graph
#: before it is listed, and longest wait for an answer [s].
_UNKNOWN_S, _SETTLED_S, _ANSWER_S = 5.0, 1.0, 10.0
#: Longest wait for messages at once; signals are handled in between [s].
_LOOK_S = 0.05
#: Quality of service that matches any publisher or subscription.
_BEST = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_AVAILABLE,
                   durability=DurabilityPolicy.BEST_AVAILABLE)
#: Units of bandwidth: bytes, digits and name.
_UNITS = ((1e6, 2, 'MB'), (1e3, 2, 'KB'), (1.0, 0, 'B'))
#: Longest printed part of an array or a text.
_PRINTED = 128
#: Label of a value by its type, a number of rcl_interfaces/msg/ParameterType.
_LABELS = ('Parameter not set.', 'Boolean value is:', 'Integer value is:', 'Double value is:',
           'String value is:', 'Byte values are:', 'Boolean values are:', 'Integer values are:',
           'Double values are:', 'String values are:')
_TYPES = tuple(label.partition(' value')[0].lower() + (' array' if 'are' in label else '')
               for label in _LABELS)


class _Ended(Exception):
    """A signal has ended the command."""


def run_verb(options: argparse.Namespace) -> int:
    """
    Run a verb until it is done, or a signal or a closed standard output ends it.

    :returns: the exit code
    :raises ManipSimError: if it cannot be done
    """
    verbs: Mapping[str, Callable[[_Graph, argparse.Namespace], int | None]] = {
        'topic list': _list_names, 'topic info': _info, 'topic echo': _echo, 'topic hz': _hz,
        'topic bw': _bandwidth, 'topic delay': _delay, 'topic find': _list_names,
        'topic pub': _publish, 'topic type': _type, 'param list': _list_parameters,
        'param describe': _describe, 'param get': _get, 'param set': _set, 'param delete': _delete,
        'param dump': _dump, 'param load': _load, 'service list': _list_names,
        'service type': _type, 'service find': _list_names, 'service call': _call}
    try:
        with _one_line_errors(), _graph() as graph:
            return verbs[f'{options.command} {options.action}'](graph, options) or 0
    except _Ended:
        return 0
    except BrokenPipeError:
        # Python flushes once more when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


@contextmanager
def _one_line_errors() -> Iterator[None]:
    try:
        yield
    except NameValidationException as error:
        raise ManipSimError(one_line(str(error).replace('\n', ' '))) from error
    except RCLError as error:
        raise ManipSimError(f'ROS: {without_source(error)}') from error


@contextmanager
def _graph() -> Iterator[_Graph]:
    ended = EndSignals()
    set_logger_level('rcl', LoggingSeverity.FATAL)
    context = rclpy.Context()
    start_rclpy(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    graph = _Graph(context, ended)
    try:
        yield graph
    finally:
        graph.executor.shutdown()
        graph.node.destroy_node()
        context.try_shutdown()


class _Graph:
    """The nodes, topics and services that a node of this process finds."""

    def __init__(self, context: rclpy.Context, ended: EndSignals) -> None:
        self._ended = ended
        self.node = rclpy.create_node(
            f'manip_sim_{os.getpid()}', context=context, enable_rosout=False,
            start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)

    def spin_until(self, condition: Callable[[], Any], limit_s: float = math.inf) -> bool:
        """Handle messages until a condition holds; return False if it does not in time [s]."""
        end_s = time.monotonic() + limit_s
        while not condition():
            if self._ended.wait(0.0):
                raise _Ended
            if time.monotonic() > end_s:
                return False
            self.executor.spin_once(timeout_sec=min(_LOOK_S, limit_s))
        return True

    def settle(self) -> None:
        """Wait until no node, topic or service has been found for a while."""
        begin_s, changed_s, before = time.monotonic(), time.monotonic(), None

        def settled() -> bool:
            nonlocal changed_s, before
            present = self.nodes(), self.topics(), self.services()
            if present != before:
                changed_s, before = time.monotonic(), present
            # A node may be found before its services.
            is_there = bool(present[0] and present[2])
            return time.monotonic() - changed_s > _SETTLED_S and (
                is_there or time.monotonic() - begin_s > _UNKNOWN_S)
        self.spin_until(settled, _ANSWER_S)

    def nodes(self) -> list[str]:
        return sorted({name for name in self.node.get_fully_qualified_node_names()
                       if name != self.node.get_fully_qualified_name()
                       and not topic_or_service_is_hidden(name)})

    def topics(self) -> dict[str, list[str]]:
        return dict(self.node.get_topic_names_and_types())

    def published(self) -> dict[str, list[str]]:
        return {name: types for name, types in self.topics().items()
                if self.node.count_publishers(name)}

    def subscribed(self) -> dict[str, list[str]]:
        return {name: types for name, types in self.topics().items()
                if self.node.count_subscribers(name)}

    def services(self) -> dict[str, list[str]]:
        own = f'/{self.node.get_name()}/'
        return {name: types for name, types in self.node.get_service_names_and_types()
                if not name.startswith(own)}

    def find(self, kind: str, name: str, present: Callable[[], Iterable[str]]) -> str:
        """
        Wait until a name is there, and return it in full.

        :raises UnknownNameError: if it is not after some seconds, with the nearest names
        """
        full: str = self.node.resolve_topic_name(name)
        if not self.spin_until(lambda: full in present(), _UNKNOWN_S):
            raise self._explained(UnknownNameError(kind, name, present()))
        return full

    def wait_for(self, messages: Collection[Any], topic: str, limit_s: float = math.inf) -> None:
        """Wait for messages; say on standard error if those of known nodes do not come."""
        if self.spin_until(lambda: messages, min(limit_s, _ANSWER_S)):
            return
        unheard = describe_unheard(self.node)
        if unheard:
            print(f'manip_sim: {unheard}', file=sys.stderr)
        if not self.spin_until(lambda: messages, limit_s - _ANSWER_S):
            raise ManipSimError(f'no message on {topic} for {limit_s:g} s')

    def answer(self, future: Any, name: str) -> Any:
        """Return the answer of a service; ManipSimError if there is none."""
        if not self.spin_until(future.done, _ANSWER_S):
            raise self._explained(
                ManipSimError(f'no answer of {quoted(name)} within {_ANSWER_S:g} s'))
        return future.result()

    def late_answer(self, client: Any, future: Any, name: str) -> Any:
        """Return the answer of a service, which may come at the end of a motion if it stays."""
        if not self.spin_until(future.done, _ANSWER_S):
            unheard = describe_unheard(self.node)
            if unheard:
                print(f'manip_sim: {unheard}', file=sys.stderr)
        self.spin_until(lambda: future.done() or not client.service_is_ready())
        if not future.done():
            raise ManipSimError(f'{quoted(name)} has gone without an answer')
        return future.result()

    def _explained(self, error: ManipSimError) -> ManipSimError:
        """Return an error with the reason, if no node is found or its messages do not arrive."""
        reason = describe_missing(self.node)
        return ManipSimError(f'{error}; {reason}') if reason else error


# ---------------------------------------------------------------------- topics and services

def _list_names(graph: _Graph, options: argparse.Namespace) -> None:
    graph.settle()
    if not graph.nodes():
        print('manip_sim:', describe_missing(graph.node), file=sys.stderr)
    present = graph.topics() if options.command == 'topic' else graph.services()
    kind = None if options.action == 'list' else _type_name(_interface(
        options.type, 'msg' if options.command == 'topic' else 'srv'))
    names = [name for name in sorted(present) if not topic_or_service_is_hidden(name)
             and (kind is None or kind in present[name])]
    if options.count:
        _say(str(len(names)))
        return
    for name in names:
        with_types = kind is None and options.show_types
        _say(f'{name} [{", ".join(present[name])}]' if with_types else name)


def _type(graph: _Graph, options: argparse.Namespace) -> None:
    present = graph.topics if options.command == 'topic' else graph.services
    name = graph.find(options.command, options.name, present)
    for type_name in present().get(name, []):
        _say(type_name)


def _info(graph: _Graph, options: argparse.Namespace) -> None:
    name = graph.find('topic', options.name, graph.topics)
    graph.settle()
    end = '\n\n' if options.verbose else '\n'
    _say(f'Type: {", ".join(graph.topics().get(name, []))}', end)
    for label, infos in (('Publisher', graph.node.get_publishers_info_by_topic(name)),
                         ('Subscription', graph.node.get_subscriptions_info_by_topic(name))):
        _say(f'{label} count: {len(infos)}', end)
        for info in infos if options.verbose else ():
            _say(str(info), end)


def _echo(graph: _Graph, options: argparse.Namespace) -> None:
    messages = _subscribed(graph, options)
    limit = sys.maxsize if options.full_length else _PRINTED
    while True:
        graph.wait_for(messages, options.name, options.timeout or math.inf)
        message = messages.popleft()
        if options.field is not None:
            try:
                message = operator.attrgetter(options.field)(message)
            except AttributeError as error:
                raise UnknownNameError(f'field of {options.name}', options.field,
                                       message.get_fields_and_field_types()) from error
        text = yaml.dump(_plain(message, limit, not options.no_arr), sort_keys=False,
                         allow_unicode=True, width=sys.maxsize)
        _say(text.removesuffix('...\n'), '---\n')
        if options.once:
            return


def _subscribed(graph: _Graph, options: argparse.Namespace, raw: bool = False) -> deque[Any]:
    """Subscribe to a topic as its publishers allow; return where its messages come."""
    type_name = getattr(options, 'type', None)
    if type_name:
        kind, topic = _interface(type_name, 'msg'), graph.node.resolve_topic_name(options.name)
        graph.spin_until(lambda: topic in graph.published(), _UNKNOWN_S)
    else:
        topic = graph.find('published topic', options.name, graph.published)
        types = graph.topics()[topic]
        if len(types) > 1:
            raise ManipSimError(f'{topic} has several types, choose one: {", ".join(types)}')
        kind = _interface(types[0], 'msg')
    messages: deque[Any] = deque()
    # Without a publisher, the best that is available would be transient local.
    graph.node.create_subscription(kind, topic, lambda message: messages.append(message),
                                   _BEST if topic in graph.published() else _BEST.depth, raw=raw)
    return messages


def next_message(topic: str, type_name: str) -> Any:
    """
    Return the next message on a topic.

    :param type_name: that it has to have, such as ``sensor_msgs/msg/JointState``
    :raises ManipSimError: if the topic is unknown or has another type, or no message comes
    """
    try:
        with _one_line_errors(), _graph() as graph:
            messages = _subscribed(graph, argparse.Namespace(name=topic))
            types = graph.topics().get(graph.node.resolve_topic_name(topic), [])
            if type_name not in types:
                raise ManipSimError(f'{topic} has the type {", ".join(types)}, not {type_name}')
            graph.wait_for(messages, topic, _ANSWER_S)
            return messages.popleft()
    except _Ended:
        raise ManipSimError(f'ended before a message on {topic} came') from None


def _hz(graph: _Graph, options: argparse.Namespace) -> None:
    # Of n messages there are n - 1 intervals.
    for arrivals in _windows(graph, options, lambda _, at_s: at_s, options.window + 1):
        between = [later - earlier for earlier, later in itertools.pairwise(arrivals)]
        _say(f'average rate: {1.0 / statistics.fmean(between):.3f}\n{_statistics(between)}')


def _bandwidth(graph: _Graph, options: argparse.Namespace) -> None:
    _say(f'Subscribed to [{graph.node.resolve_topic_name(options.name)}]')
    for window in _windows(graph, options, lambda data, at_s: (len(data), at_s), options.window):
        sizes = [size for size, _ in window]
        per_s = sum(sizes) / (time.monotonic() - window[0][1])
        factor, digits, unit = next((unit for unit in _UNITS if per_s >= unit[0]), _UNITS[-1])
        total, mean, least, most = (
            f'{number / factor:.{digits}f} {unit}' for number in (
                per_s, statistics.fmean(sizes), min(sizes), max(sizes)))
        _say(f'{total}/s from {len(sizes)} messages\n'
             f'\tMessage size mean: {mean} min: {least} max: {most}')


def _delay(graph: _Graph, options: argparse.Namespace) -> None:
    def age(message: Any, _: float) -> float:
        if not hasattr(message, 'header'):
            raise ManipSimError(f'the messages on {options.name} have no header')
        now = graph.node.get_clock().now()
        return float((now - Time.from_msg(message.header.stamp)).nanoseconds) * 1e-9

    for ages in _windows(graph, options, age, options.window, raw=False):
        _say(f'average delay: {statistics.fmean(ages):.3f}\n{_statistics(ages)}')


def _windows(graph: _Graph, options: argparse.Namespace, measure: Callable[[Any, float], Any],
             most: int, raw: bool = True) -> Iterator[deque[Any]]:
    """Yield measurements of the newest messages, with their times [s], once a second."""
    messages = _subscribed(graph, options, raw)
    window: deque[Any] = deque(maxlen=most)
    said_s = time.monotonic()
    while True:
        graph.wait_for(messages, options.name)
        now_s = time.monotonic()
        while messages:
            window.append(measure(messages.popleft(), now_s))
        if now_s - said_s >= 1.0 and len(window) > 1:
            said_s = now_s
            yield window


def _statistics(times: Collection[float]) -> str:
    return (f'\tmin: {min(times):.3f}s max: {max(times):.3f}s '
            f'std dev: {statistics.pstdev(times):.5f}s window: {len(times)}')


def _publish(graph: _Graph, options: argparse.Namespace) -> None:
    kind = _interface(options.type, 'msg')
    message = _message(kind, _mapping(options.values), graph.node.get_clock().now().to_msg())
    times = 1 if options.once else options.times
    try:
        topic = graph.find('subscribed topic', options.name, graph.subscribed)
    except UnknownNameError as error:
        if times:
            raise
        # As with ros2, what subscribes may come later.
        print(f'manip_sim: {error}', file=sys.stderr)
        topic = graph.node.resolve_topic_name(options.name)
    type_name, types = _type_name(kind), graph.topics().get(topic, [])
    if types and type_name not in types:
        raise ManipSimError(f'{topic} has the type {", ".join(types)}, not {type_name}')
    publisher = graph.node.create_publisher(kind, topic, _BEST)
    if times and not graph.spin_until(publisher.get_subscription_count, _ANSWER_S):
        raise ManipSimError(f'no subscription to {topic} that takes what is published reliably')
    _say('publisher: beginning loop')
    begin_s = time.monotonic()
    for number in itertools.count(1):
        _say(f'publishing #{number}: {message!r}\n')
        publisher.publish(message)
        if number == times:
            break
        next_s = begin_s + number / options.rate
        graph.spin_until(lambda end_s=next_s: time.monotonic() >= end_s)  # type: ignore[misc]
    publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=_ANSWER_S))


def _call(graph: _Graph, options: argparse.Namespace) -> int:
    kind = _interface(options.type, 'srv')
    request = _message(kind.Request, _mapping(options.values),
                       graph.node.get_clock().now().to_msg())
    name = graph.find('service', options.name, graph.services)
    types, type_name = graph.services()[name], _type_name(kind)
    if type_name not in types:
        raise ManipSimError(f'{name} has the type {", ".join(types)}, not {type_name}')
    client = graph.node.create_client(kind, name)
    if not graph.spin_until(client.service_is_ready, _ANSWER_S):
        raise ManipSimError(f'{name} is there, but does not connect')
    _say(f'requester: making request: {request!r}\n')
    response = graph.late_answer(client, client.call_async(request), name)
    _say(f'response:\n{response!r}\n')
    return int(getattr(response, 'success', True) is False)


# ---------------------------------------------------------------------- parameters

def _parameters(graph: _Graph, node: str) -> AsyncParameterClient:
    name = graph.find('node', node, graph.nodes)
    client = AsyncParameterClient(graph.node, name)
    if not graph.spin_until(client.services_are_ready, _ANSWER_S):
        raise ManipSimError(f'{name} has no parameter services')
    return client


def _names(graph: _Graph, client: AsyncParameterClient, node: str) -> list[str]:
    return sorted(graph.answer(client.list_parameters(), node).result.names)


def _check_known(graph: _Graph, client: AsyncParameterClient, node: str, names: list[str]
                 ) -> None:
    known = _names(graph, client, node)
    for name in names:
        if name not in known:
            raise UnknownNameError(f'parameter of {node}', name, known)


def _list_parameters(graph: _Graph, options: argparse.Namespace) -> None:
    try:
        matches = re.compile(options.filter or '').match
    except re.error as error:
        raise ManipSimError(f'--filter {quoted(options.filter)}: {error}') from error
    if not options.node:
        graph.settle()
    for node in [options.node] if options.node else graph.nodes():
        names = [name for name in _names(graph, _parameters(graph, node), node) if matches(name)]
        if names and not options.node:
            _say(f'{node}:')
        for name in names:
            _say(f'  {name}')


def _describe(graph: _Graph, options: argparse.Namespace) -> None:
    client = _parameters(graph, options.node)
    _check_known(graph, client, options.node, options.names)
    for descriptor in graph.answer(
            client.describe_parameters(options.names), options.node).descriptors:
        _say(f'Parameter name: {descriptor.name}\n  Type: {_TYPES[descriptor.type]}')
        if descriptor.description:
            _say(f'  Description: {descriptor.description}')
        constraints = ['Read only: true'] if descriptor.read_only else []
        for limit in (*descriptor.integer_range, *descriptor.floating_point_range):
            constraints += [f'Min value: {limit.from_value}', f'Max value: {limit.to_value}',
                            *([f'Step: {limit.step}'] if limit.step else [])]
        if descriptor.additional_constraints:
            constraints.append(f'Additional constraints: {descriptor.additional_constraints}')
        _say('\n    '.join(['  Constraints:', *constraints]))


def _get(graph: _Graph, options: argparse.Namespace) -> None:
    client = _parameters(graph, options.node)
    values = graph.answer(client.get_parameters([options.name]), options.node).values
    if not values or not values[0].type:
        _check_known(graph, client, options.node, [options.name])
    value = _value(values[0]) if values else None
    label = _LABELS[values[0].type if values else 0]
    _say(str(value) if options.hide_type else label if value is None else f'{label} {value}')


def _set(graph: _Graph, options: argparse.Namespace) -> int:
    client = _parameters(graph, options.node)
    try:
        value = get_parameter_value(options.value)
        serialize_message(value)  # It finds numbers that the fields cannot hold.
    except (AssertionError, OverflowError, SystemError, yaml.YAMLError) as error:
        raise ManipSimError(f'cannot use the value {quoted(options.value)}: '
                            f'{one_line(str(error), 200)}') from error
    return _change(graph, client, options, value, 'Set parameter successful',
                   'Setting parameter failed')


def _delete(graph: _Graph, options: argparse.Namespace) -> int:
    client = _parameters(graph, options.node)
    _check_known(graph, client, options.node, [options.name])
    # A value without a type deletes a parameter.
    return _change(graph, client, options, ParameterValue(), 'Deleted parameter successfully',
                   'Deleting parameter failed')


def _change(graph: _Graph, client: AsyncParameterClient, options: argparse.Namespace,
            value: ParameterValue, done: str, failed: str) -> int:
    parameter = Parameter(name=options.name, value=value)
    (result,) = graph.answer(client.set_parameters([parameter]), options.node).results
    reason = f': {result.reason}' if result.reason else ''
    if result.successful:
        _say(done + reason)
        return 0
    if not reason:
        _check_known(graph, client, options.node, [options.name])
    print(failed + one_line(reason, 2000), file=sys.stderr)
    return 1


def _dump(graph: _Graph, options: argparse.Namespace) -> None:
    client = _parameters(graph, options.node)
    names = _names(graph, client, options.node)
    values = graph.answer(client.get_parameters(names), options.node).values
    tree: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        branch, left = tree, name
        # A parameter may have the name of a folder too, as arena and arena.friction.
        while '.' in left and isinstance(branch.get(left.partition('.')[0], {}), dict):
            folder, _, left = left.partition('.')
            branch = branch.setdefault(folder, {})
        branch[left] = _value(value)
    _say(yaml.dump({graph.node.resolve_topic_name(options.node): {'ros__parameters': tree}},
                   default_flow_style=False))


def _load(graph: _Graph, options: argparse.Namespace) -> int:
    client, name = _parameters(graph, options.node), graph.node.resolve_topic_name(options.node)
    try:
        sections = yaml.safe_load(Path(options.file).read_text())
        of_all = '/**' in sections and not options.no_use_wildcard
        node = name if name in sections or not of_all else '/**'
        parameters = [*parameter_dict_from_yaml_file(options.file, of_all, [node]).values()]
    except (RuntimeError, OSError, ValueError, TypeError, AttributeError, yaml.YAMLError) as error:
        raise ManipSimError(f'{options.file}: {one_line(str(error), 200)}') from error
    results = graph.answer(client.set_parameters(parameters), options.node).results
    for parameter, result in zip(parameters, results, strict=True):
        outcome = (f'Set parameter {parameter.name} '
                   f'{"successful" if result.successful else "failed"}'
                   + (f': {one_line(result.reason, 2000)}' if result.reason else ''))
        if result.successful:
            _say(outcome)
        else:
            print(outcome, file=sys.stderr)
    return int(not all([result.successful for result in results]))


def _value(value: Any) -> Any:
    return _plain(parameter_value_to_python(value), sys.maxsize)


# ---------------------------------------------------------------------- messages

def _type_name(kind: Any) -> str:
    return '/'.join([*kind.__module__.split('.')[:2], kind.__name__])


def _interface(name: str, module: str) -> Any:
    """Return the class of a type such as ``std_msgs/msg/String`` or ``std_msgs/String``."""
    package, _, rest = name.partition('/')
    words = rest.split('/')
    label = {'msg': 'message', 'srv': 'service'}[module]
    if not words[-1] or words[:-1] not in ([], [module]) or not re.fullmatch(r'\w+', package):
        raise ManipSimError(f'{quoted(name)} is not the type of a {label}, which is like '
                            f'PACKAGE/{module}/NAME')
    try:
        interfaces = importlib.import_module(f'{package}.{module}')
    except ImportError as error:
        raise ManipSimError(
            f'{label} type {quoted(name)}: there is no package {quoted(package)} of {label}s '
            f'here: correct the name, or install it (apt install {apt_names(package)})'
        ) from error
    kind = getattr(interfaces, words[-1], None)
    if not isinstance(kind, type):
        raise UnknownNameError(f'{label} type', name, [
            f'{package}/{module}/{other}' for other, value in vars(interfaces).items()
            if isinstance(value, type)])
    return kind


def _mapping(text: str) -> Mapping[str, Any]:
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise MessageError(f'not YAML: {quoted(text)}: {one_line(str(error), 200)}') from error
    if not isinstance(values or {}, dict):
        raise MessageError(f'must be fields such as {{data: 1.0}}, got {quoted(text)}')
    return values or {}


def _message(kind: Any, values: Mapping[str, Any], now: Any) -> Any:
    """
    Return a message with some fields; ``auto`` is a header of now, ``now`` a stamp.

    :raises ManipSimError: naming the field
    """
    message = kind(check_fields=True)
    types = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in types:
            raise UnknownNameError(f'field of {_type_name(kind)}', name, types)
        try:
            setattr(message, name, _converted(getattr(message, name), types[name], value, now))
        except (AssertionError, OverflowError, TypeError, ValueError) as error:
            if isinstance(error, ManipSimError):
                raise
            raise MessageError(f'field {name} of {_type_name(kind)} is {types[name]}, '
                               f'got {quoted(value)}') from error
    return message


def _converted(present: Any, type_name: str, value: Any, now: Any) -> Any:
    """Return a value of YAML as the field of a message that has a value at present."""
    if hasattr(present, 'get_fields_and_field_types'):
        if value == 'auto' and type_name == 'std_msgs/Header':
            value = {'stamp': 'now'}
        if value == 'now' and type_name == 'builtin_interfaces/Time':
            return now
        if not isinstance(value, Mapping):
            raise TypeError
        return _message(type(present), value, now)
    array = re.match(r'sequence<([^,>]+)|([^\[]+)\[', type_name)
    if array is None:
        return _scalar(type_name, value)
    if isinstance(value, str):
        raise TypeError
    element = array[1] or array[2]
    if '/' not in element:
        return [_scalar(element, item) for item in value]
    kind = _interface(element, 'msg')
    return [_converted(kind(), element, item, now) for item in value]


def _scalar(type_name: str, value: Any) -> Any:
    """Return a value of YAML as a type without fields takes it; the message checks it."""
    if type_name in ('float', 'double'):
        return float(value)
    if 'string' in type_name:
        return str(value)
    return bytes([value]) if type_name == 'octet' else value


def _plain(value: Any, limit: int, arrays: bool = True) -> Any:
    """Return a message or a field of it as YAML has it, long ones shortened."""
    if hasattr(value, 'get_fields_and_field_types'):
        return {name: _plain(getattr(value, name), limit, arrays)
                for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, str):
        return value if len(value) <= limit else f'{value[:limit]}...'
    if hasattr(value, '__len__'):
        if not arrays:
            return f'<array of {len(value)}>'
        shown = [_plain(item, limit) for item in value[:limit]]
        return shown + ['...'] if len(value) > limit else shown
    return value.item() if hasattr(value, 'item') else value


def _say(text: str, end: str = '\n') -> None:
    encoding = sys.stdout.encoding or 'utf-8'
    print(text.encode(encoding, 'backslashreplace').decode(encoding), end=end, flush=True)
