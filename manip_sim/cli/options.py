# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Types of options, and the options of the verbs that talk to nodes, with words of ros2cli."""

from __future__ import annotations

import argparse
import math
from typing import Any

from manip_sim.errors import ManipSimError
from manip_sim.ros_environment import check_ros_environment, missing_module

#: The least and the greatest edge of a picture [pixels].
SMALLEST, LARGEST = 16, 8192


def number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f'must be a finite number, got {text[:60]!r}')
    return value


def numbers(text: str) -> list[float]:
    return [number(part) for part in text.split(',')]


def positive(text: str) -> float:
    value = number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f'must be above 0, got {text[:60]!r}')
    return value


def whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f'must be a whole number, got {text[:60]!r}')
    return int(text[:9])


def count(text: str) -> int:
    value = whole(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'must be at least 1, got {text[:60]!r}')
    return value


def image_size(text: str) -> tuple[int, int]:
    """Return width and height of a picture [pixels] from text such as ``800x540``."""
    width, _, height = text.lower().partition('x')
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f'must be like 800x540, got {text[:60]!r}')
    size = int(width[:9]), int(height[:9])
    if not all(SMALLEST <= edge <= LARGEST for edge in size):
        raise argparse.ArgumentTypeError(
            f'must be from {SMALLEST} to {LARGEST} pixels each way, got {text[:60]!r}')
    return size


def assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition('=')
    if not (name and equals):
        raise argparse.ArgumentTypeError(f'must be like NAME=VALUE, got {text[:60]!r}')
    return name, value


_Argument = tuple[tuple[str, ...], dict[str, Any]]


def _argument(*names: str, **settings: Any) -> _Argument:
    return names, settings


def _flag(*names: str, **settings: Any) -> _Argument:
    return names, {'action': 'store_true', **settings}


_TOPIC = _argument('name', metavar='TOPIC')
_SERVICE = _argument('name', metavar='SERVICE')
_NODE = _argument('node', metavar='NODE', help='such as /manip_sim')
_PARAMETER = _argument('name', metavar='NAME')
_VALUES = _argument('values', nargs='?', default='{}', metavar='VALUES',
                    help="fields in YAML, such as '{data: [1.0]}' (default: the type's own)")
_LISTED = (_flag('-t', '--show-types', help='with the types'),
           _flag('-c', '--count', help='only how many'))

#: For each command its summary, and for each verb its summary and arguments.
COMMANDS: dict[str, tuple[str, dict[str, tuple[str, tuple[_Argument, ...]]]]] = {
    'topic': ('list, print and publish topics, as ros2 topic', {
        'list': ('list the topics', _LISTED),
        'info': ('print the type of a topic, and how many publish and subscribe', (
            _TOPIC, _flag('-v', '--verbose', help='with nodes and quality of service'))),
        'type': ('print the type of a topic', (_TOPIC,)),
        'echo': ('print messages', (
            _TOPIC, _argument('type', nargs='?', metavar='TYPE', help='(default: as published)'),
            _flag('--once', help='print one message'),
            _argument('--field', metavar='FIELD', help='print a field, such as pose.position'),
            _argument('--timeout', type=positive, metavar='SECONDS',
                      help='fail if no message comes for so long'),
            _flag('-f', '--full-length', help='print long arrays and text completely'),
            _flag('--no-arr', help='print no arrays'))),
        'hz': ('print how often messages come', (
            _TOPIC, _argument('-w', '--window', type=count, default=10000, metavar='N',
                              help='number of messages to average over (default: 10000)'))),
        'pub': ('publish messages', (
            _TOPIC, _argument('type', metavar='TYPE', help='such as std_msgs/msg/String'),
            _VALUES, _flag('-1', '--once', help='publish one message'),
            _argument('-t', '--times', type=count, metavar='N', help='publish N messages'),
            _argument('-r', '--rate', type=positive, default=1.0, metavar='HZ',
                      help='messages per second (default: 1)')))}),
    'param': ('list, read and set parameters of nodes, as ros2 param', {
        'list': ('list the parameters', (
            _argument('node', nargs='?', metavar='NODE', help='(default: all nodes)'),
            _argument('--filter', metavar='REGEX', help='those whose beginning matches'))),
        'describe': ('describe parameters', (
            _NODE, _argument('names', nargs='+', metavar='NAME'))),
        'get': ('print the value of a parameter', (
            _NODE, _PARAMETER, _flag('--hide-type', help='the value only'))),
        'set': ('set a parameter', (
            _NODE, _PARAMETER, _argument('value', metavar='VALUE', help='in YAML'))),
        'dump': ('print all parameters as a parameter file', (_NODE,)),
        'load': ('set the parameters of a file; exit code 1 if some cannot be set', (
            _NODE, _argument('file', metavar='FILE', help='as dump prints it'),
            _flag('--no-use-wildcard', help='leave out what is for all nodes')))}),
    'service': ('list and call services, as ros2 service', {
        'list': ('list the services', _LISTED),
        'type': ('print the type of a service', (_SERVICE,)),
        'call': ('call a service; exit code 1 if it answers with success: false', (
            _SERVICE, _argument('type', metavar='TYPE', help='such as std_srvs/srv/Trigger'),
            _VALUES))})}


def add_verbs(parser: argparse.ArgumentParser, command: str) -> None:
    """Add the verbs of a command."""
    verbs = parser.add_subparsers(dest='action', required=True, metavar='VERB', title='verbs')
    for name, (summary, arguments) in COMMANDS[command][1].items():
        verb = verbs.add_parser(name, help=summary, description=f'{summary.capitalize()}.',
                                allow_abbrev=False)
        for names, settings in arguments:
            verb.add_argument(*names, **settings)


def run(options: argparse.Namespace) -> tuple[str, int]:
    """
    Run a verb, which prints by itself.

    :raises ManipSimError: without ROS, or as the verb
    """
    check_ros_environment()
    try:
        from manip_sim.cli.ros_commands import run_verb
    except ImportError as error:
        raise ManipSimError(missing_module(error)) from error
    return '', run_verb(options)
