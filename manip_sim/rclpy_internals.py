# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Parts of rclpy without a public name, in one place; its start, with errors of one line.

They exist in rclpy 7.1 and 9.1, of ROS 2 Jazzy and Kilted, and in the sources of rclpy for ROS 2
Lyrical. Where a release lacks a part that only saves time, :func:`missing_for_waits` or
:func:`missing_for_publishing` names it, and the public way of rclpy is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import contextlib
import ctypes
import functools
import importlib
import os
from pathlib import Path
import re
import sys
from typing import Any

import rclpy
# It knows by which name the module of rclpy's C API is imported, which changes with releases.
from rclpy.impl.implementation_singleton import rclpy_implementation as _C_API
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

from manip_sim.errors import ManipSimError
from manip_sim.quoting import one_line, quoted, quoted_names
from manip_sim.ros_environment import set_discovery_profile, SHARE_MEMORY

__all__ = ['count_messages', 'describe_missing', 'describe_unheard', 'endpoint_counts',
           'forget_parameters', 'import_type_supports', 'InUse', 'is_unheard', 'MatchCounter',
           'missing_for_publishing', 'missing_for_waits', 'parameter_overrides', 'publish_bytes',
           'RCLError', 'start_rclpy', 'start_ros', 'WaitSet', 'without_source']

RCLError = _C_API.RCLError
#: None in a release of rclpy without it.
WaitSet: Any = getattr(_C_API, 'WaitSet', None)
#: Methods that waits for some of a node's subscriptions use, by class of the C API.
_WAITS = {'Context': ('__enter__', '__exit__'),
          'EventHandle': ('__enter__', '__exit__', 'destroy_when_not_in_use', 'pointer'),
          'Subscription': ('__enter__', '__exit__', 'pointer', 'take_message'),
          'WaitSet': ('clear_entities', 'wait'),
          'rcl_publisher_event_type_t': ('RCL_PUBLISHER_MATCHED',)}
#: Name that rmw gives to a node until the message comes in which that tells its name.
_UNNAMED = '_NODE_NAME_UNKNOWN_'
_OF_EVERY_NODE = ('/parameter_events', '/rosout')
#: Text of rclpy's error if it cannot write its log.
_LOG = re.compile(r'log directory|log file|Failed opening file .*\.log')
#: Options of ROS with a value.
_WITH_VALUE = ('-e', '--enclave', '--log-level', '--log-config-file', '--log-file-name')
_NODE = re.compile('[A-Za-z_][A-Za-z0-9_]*')


def start_rclpy(**options: Any) -> None:
    """
    Initialize rclpy.

    :param options: as ``rclpy.init`` takes them
    :raises ManipSimError: if the log cannot be written; any other error is that of rclpy
    """
    log = os.environ.get('ROS_LOG_DIR') or os.environ.get('ROS_HOME') or '~'
    if log.startswith('~') and not os.environ.get('HOME'):  # rcl prints nine lines of its own.
        raise ManipSimError('the environment variable HOME is not set: set it, or ROS_LOG_DIR to '
                            'a folder that can be written')
    set_discovery_profile()
    try:
        rclpy.init(**options)
    except RuntimeError as error:  # In some releases the log does not raise RCLError.
        reason = without_source(error)
        if not _LOG.search(reason):
            raise
        raise ManipSimError(
            f'{reason}; set ROS_LOG_DIR to a folder that can be written') from error


def start_ros(arguments: Sequence[str] | None) -> None:
    """
    Initialize rclpy, without its signal handlers.

    :param arguments: the command line with ROS arguments; None: that of the process
    :raises ManipSimError: in one line, if an argument is wrong, or the log cannot be written
    """
    words = sys.argv if arguments is None else list(arguments)
    # Errors are reported once, by our error and not by rcl too.
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        start_rclpy(args=words, signal_handler_options=SignalHandlerOptions.NO)
    except (_C_API.UnknownROSArgsError, RCLError) as error:
        reason = next(_mistakes(words), without_source(error))
        raise ManipSimError(f'bad ROS arguments: {reason}') from error
    set_logger_level('rcl', LoggingSeverity.UNSET)


def _mistakes(arguments: Sequence[str]) -> Iterator[str]:
    words = iter(arguments)
    for word in words:
        if word == '--ros-args':
            break
    for word in words:
        if word in ('-p', '--param'):
            yield from _mistakes_of_parameter(next(words, ''))
        elif word in ('-r', '--remap'):
            yield from _mistakes_of_remapping(next(words, ''))
        elif word == '--params-file':
            yield from _mistakes_of_file(next(words, ''))
        elif word in _WITH_VALUE:
            next(words, None)
        elif ':=' in word:
            option = '-r' if word.startswith('__') else '-p'
            yield f'{quoted(word)} must follow {option}: {option} {one_line(word, 60)}'


def _mistakes_of_parameter(word: str) -> Iterator[str]:
    import yaml  # Only mistakes need it.
    name, assigned, value = word.partition(':=')
    if not (name and assigned and value):
        yield f'{quoted(f"-p {word}".strip())} must be -p NAME:=VALUE, without spaces'
    try:
        kinds = {type(item) for item in yaml.safe_load(value)}
    except (TypeError, ValueError, RecursionError, yaml.YAMLError):
        return  # The value is not a list.
    if kinds == {int, float}:
        yield f'{quoted(word)}: write all numbers of a list with a decimal point, such as 0.0'


def _mistakes_of_remapping(word: str) -> Iterator[str]:
    old, assigned, new = word.partition(':=')
    kind = old.rpartition(':')[2]
    if not (old and assigned and new):
        yield f'{quoted(f"-r {word}".strip())} must be -r OLD:=NEW, without spaces'
    elif kind == '__ns' and not new.startswith('/'):
        yield f'{quoted(word)}: a namespace begins with a slash: __ns:=/{one_line(new, 60)}'
    elif kind in ('__node', '__name') and not _NODE.fullmatch(new):
        yield (f'{quoted(word)}: the name of a node consists of letters, digits and underscores, '
               'and does not begin with a digit')


def _mistakes_of_file(name: str) -> Iterator[str]:
    import yaml  # Only mistakes need it.
    try:
        content = yaml.safe_load(Path(name).read_text())
    except yaml.MarkedYAMLError as error:
        line = f', line {error.problem_mark.line + 1}' if error.problem_mark else ''
        yield f'{quoted(name, 200)}{line}: {one_line(str(error.problem))}'
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        pass  # rcl names it.
    else:
        below = content.values() if isinstance(content, dict) else ()
        if not any(isinstance(section, dict) for section in below) or any(
                'ros__parameters' not in repr(section) for section in below):
            yield (f'{quoted(name, 200)}: parameters must be below the name of the node and '
                   "'ros__parameters', as in '/**: {ros__parameters: {robot: Panda}}'")


def import_type_supports() -> None:
    """
    Import the loader of the C code of messages, without the generator of their Python code.

    The package that has both goes without the generator where that cannot be imported. Its parser
    of IDL takes a twentieth of the processor time of a node's start to import.
    """
    generator = 'rosidl_generator_py.generate_py_impl'
    if generator in sys.modules:
        return
    sys.modules[generator] = None  # type: ignore[assignment]
    try:
        with contextlib.suppress(ImportError):  # A release of ROS may load it otherwise.
            importlib.import_module('rosidl_generator_py')
    finally:
        del sys.modules[generator]


def without_source(error: Exception) -> str:
    """Return the first line of an error of rcl, without the places in its source code."""
    lines = str(error).splitlines()
    return one_line(re.sub(r', at [^ ,]+:\d+', '', lines[0])) if lines else type(error).__name__


class InUse:
    """
    A guard against destruction of handles by other threads; ``ExitStack`` takes twice as long.

    :param handles: of a context, subscriptions ...; events are handles too
    """

    def __init__(self, handles: Iterable[Any]) -> None:
        self._handles = handles
        self._entered: list[Any] = []

    def __enter__(self) -> None:
        try:
            for handle in self._handles:
                handle.__enter__()
                self._entered.append(handle)
        except BaseException:
            self.__exit__()
            raise

    def __exit__(self, *_: object) -> None:
        for handle in self._entered:
            handle.__exit__(None, None, None)


def endpoint_counts(node: Node, topics: Sequence[str]) -> list[tuple[int, int]]:
    """
    Return how many publishers and subscriptions topics have, in a 40th of the time of the node's.

    :param topics: their full names
    """
    handle = node.handle
    with handle:
        return [(handle.get_count_publishers(topic), handle.get_count_subscribers(topic))
                for topic in topics]


def is_unheard(info: TopicEndpointInfo) -> bool:
    """Return whether an endpoint is of a node none of whose messages have come yet."""
    return bool(info.node_name == _UNNAMED)


def describe_unheard(node: Node) -> str:
    """
    Return which topics have endpoints of nodes none of whose messages come, and what to do.

    :param node: that has been there for some seconds: messages come after the endpoints
    :returns: a clause for the end of a line; empty without such nodes
    """
    topics = [topic for topic, _ in node.get_topic_names_and_types() if any(map(is_unheard, (
        *node.get_publishers_info_by_topic(topic), *node.get_subscriptions_info_by_topic(topic))))]
    if not topics:
        return ''
    names = quoted_names(sorted(topics, key=lambda topic: (topic in _OF_EVERY_NODE, topic)), 3)
    return (f'a node is found with an endpoint of {names}, but none of its messages arrive: '
            f'{SHARE_MEMORY}')


def describe_missing(node: Node) -> str:
    """
    Return why a node finds no other one, or gets no messages of those, and what to do.

    :param node: that has been there for some seconds
    :returns: a clause for the end of a line; empty if it finds a node and gets its messages
    """
    own = node.get_fully_qualified_name()
    if describe_unheard(node) or any(
            name != own and not topic_or_service_is_hidden(name)
            for name in node.get_fully_qualified_node_names()):
        return describe_unheard(node)
    return (f'no other node in ROS domain {os.environ.get("ROS_DOMAIN_ID", "0")}: start it in a '
            'second shell, with the same ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE')


def parameter_overrides(node: Node) -> dict[str, Parameter]:
    """Return the overrides of a node's parameters, declared or not; no copy, may be changed."""
    overrides: dict[str, Parameter] = node._parameter_overrides
    return overrides


def forget_parameters(node: Node, begins: tuple[str, ...]) -> None:
    """
    Undeclare parameters, read-only ones too, which rclpy itself would not.

    :param begins: of their names
    """
    for name in [name for name in node._parameters if name.startswith(begins)]:
        del node._parameters[name]
        node._descriptors.pop(name, None)


class _SerializedMessage(ctypes.Structure):
    """``rcl_serialized_message_t``."""

    _fields_ = (('buffer', ctypes.c_char_p), ('length', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t), ('allocator', 5 * ctypes.c_void_p))


class _ErrorText(ctypes.Structure):
    """``rcl_error_string_t``."""

    _fields_ = (('text', 1024 * ctypes.c_char),)


#: Functions of C: their libraries (None: what the process has linked), arguments and results.
_FUNCTIONS: dict[str, tuple[str | None, tuple[Any, ...], Any]] = {
    'eventfd_write': (None, (ctypes.c_int, ctypes.c_uint64), ctypes.c_int),
    'rcl_event_set_callback': (
        'librcl.so', (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p), ctypes.c_int),
    'rcl_publish_serialized_message': (
        'librcl.so', (ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p),
        ctypes.c_int),
    'rcl_subscription_set_on_new_message_callback': (
        'librcl.so', (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p), ctypes.c_int),
    'rcutils_get_error_string': ('librcutils.so', (), _ErrorText),
    'rcutils_reset_error': ('librcutils.so', (), None)}
_OF_ERRORS = ('rcutils_get_error_string', 'rcutils_reset_error')
_TO_PUBLISH = ('rcl_publish_serialized_message', *_OF_ERRORS)
_TO_WAIT = ('rcl_subscription_set_on_new_message_callback', 'rcl_event_set_callback',
            'eventfd_write', *_OF_ERRORS)


@functools.cache
def _function(name: str) -> Any:
    """Return a function of a library that rclpy has loaded, or None if it is not found there."""
    library, arguments, result = _FUNCTIONS[name]
    try:
        function = getattr(ctypes.CDLL(library, mode=os.RTLD_NOW | (
            os.RTLD_NOLOAD if library else 0)), name)
    except (AttributeError, OSError):
        return None
    function.argtypes, function.restype = arguments, result
    return function


def _missing(names: Iterable[str]) -> list[str]:
    return [f'{name} in {_FUNCTIONS[name][0] or "libc"}' for name in names
            if _function(name) is None]


def missing_for_publishing() -> list[str]:
    """Return what publishing without Python's global lock uses and cannot be found here."""
    return _missing(_TO_PUBLISH)


def missing_for_waits() -> list[str]:
    """Return what waits for some of a node's subscriptions use and cannot be found here."""
    missing = [f'{name}.{attribute}' for name, attributes in _WAITS.items()
               for attribute in attributes if not hasattr(getattr(_C_API, name, None), attribute)]
    if not hasattr(os, 'eventfd') or ctypes.sizeof(ctypes.c_void_p) != ctypes.sizeof(
            ctypes.c_uint64):
        missing.append('eventfd for pointers of 64 bits')
    return missing + _missing(_TO_WAIT)


def _check(result: int, action: str) -> None:
    """Raise the error of a function of rcl that did not succeed."""
    if result:
        text = _function('rcutils_get_error_string')().text.decode(errors='replace')
        _function('rcutils_reset_error')()
        raise RCLError(f'Failed to {action}: {text}')


def publish_bytes(publisher: Publisher, content: bytes) -> None:
    """
    Publish a serialized message as rclpy does, but without Python's global lock meanwhile.

    :raises RCLError: if it cannot be published
    :raises InvalidHandle: if the publisher has been destroyed
    """
    publish = _function('rcl_publish_serialized_message')
    if publish is None:
        publisher.publish(content)
        return
    message = _SerializedMessage(content, len(content), len(content))
    handle = publisher.handle
    with handle:
        _check(publish(handle.pointer, ctypes.byref(message), None), 'publish')


def _count(function: str, handle: Any, descriptor: int | None) -> None:
    """
    Let a thread of the middleware add to an eventfd what comes; no Python runs in that thread.

    :param function: of rcl, which sets what is called
    :param handle: of a subscription or an event
    :param descriptor: of the eventfd, which must stay open; None: add no more
    :raises RCLError: if the middleware cannot do so
    :raises InvalidHandle: if the handle has been destroyed
    """
    # The callback's arguments are those of eventfd_write: what is given here, and the number.
    callback = None if descriptor is None else ctypes.cast(
        _function('eventfd_write'), ctypes.c_void_p)
    with handle:
        _check(_function(function)(handle.pointer, callback, descriptor), 'set a callback')


def count_messages(subscription: Any, descriptor: int | None) -> None:
    """
    Add the number of messages that come, and of those that wait already, to an eventfd.

    :param descriptor: of the eventfd, which must stay open; None: add no more
    :raises RCLError: if the middleware cannot do so
    :raises InvalidHandle: if the subscription has been destroyed
    """
    _count('rcl_subscription_set_on_new_message_callback', subscription.handle, descriptor)


class MatchCounter:
    """
    Adds to an eventfd whenever a subscription of a publisher comes or goes.

    rclpy's own event would make each round of the executor longer.

    :param descriptor: of the eventfd, which must stay open until :meth:`close`
    :raises RCLError: if the middleware cannot do so
    """

    def __init__(self, publisher: Publisher, descriptor: int) -> None:
        handle = publisher.handle
        with handle:
            self._event = _C_API.EventHandle(
                handle, _C_API.rcl_publisher_event_type_t.RCL_PUBLISHER_MATCHED)
        try:
            _count('rcl_event_set_callback', self._event, descriptor)
        except RCLError:
            self._event.destroy_when_not_in_use()
            raise

    def close(self) -> None:
        """Add no more, and let go of the publisher, which could not be destroyed before."""
        _count('rcl_event_set_callback', self._event, None)
        self._event.destroy_when_not_in_use()
