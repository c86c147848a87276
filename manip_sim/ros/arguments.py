# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Start rclpy, and name the mistakes in the ROS arguments of a command line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import itertools
from pathlib import Path
import re
import sys

from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.signals import SignalHandlerOptions
import yaml

from manip_sim.errors import ManipSimError
from manip_sim.interface.parameter_spec import matches, sections_of
from manip_sim.quoting import one_line, quoted, quoted_names
from manip_sim.rclpy_internals import RCLError, start_rclpy, UnknownROSArgsError, without_source


def for_other_nodes(arguments: Sequence[str], node_name: str) -> Iterator[str]:
    """
    Yield warnings about parameters of the command line that are for other nodes only.

    :param arguments: of the command line
    :param node_name: the node's name with its namespace
    :returns: a warning for each parameters file and each parameter that is not for this node
    """
    for option, value in itertools.pairwise(arguments):
        if option == '--params-file':
            nodes = _nodes_in(Path(value))
            if nodes and not any(matches(node, node_name) for node in nodes):
                yield (f'the parameters file {quoted(value, 200)} has no effect: it is for '
                       f'{quoted_names(nodes)}, this node is {node_name}')
        elif option in ('-p', '--param'):
            node, colon, _ = value.partition(':=')[0].rpartition(':')
            if colon and not matches(node, node_name):
                yield (f'the parameter {quoted(value)} has no effect: it is for {quoted(node)}, '
                       f'this node is {node_name}')


def _nodes_in(file: Path) -> list[str]:
    """Return the node names and patterns that a parameters file is for."""
    try:
        return [node for node, _ in sections_of(yaml.safe_load(file.read_text()))]
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        # ROS has read it; only the warning is lost.
        return []


#: Options of ROS with a value.
_WITH_VALUE = ('-e', '--enclave', '--log-level', '--log-config-file', '--log-file-name')
_NODE = re.compile('[A-Za-z_][A-Za-z0-9_]*')


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
    except (UnknownROSArgsError, RCLError) as error:
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
