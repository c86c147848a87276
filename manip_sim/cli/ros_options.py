# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Options of ``manip_sim topic``, ``param`` and ``service``, with the words of ``ros2``."""

from __future__ import annotations

import argparse
from typing import Any

from manip_sim.cli.option_types import count, positive
from manip_sim.errors import ManipSimError
from manip_sim.ros_environment import check_ros_environment, missing_module

_Argument = tuple[tuple[str, ...], dict[str, Any]]


def _argument(*names: str, **settings: Any) -> _Argument:
    return names, settings


def _flag(*names: str, **settings: Any) -> _Argument:
    return names, {'action': 'store_true', **settings}


_TOPIC = _argument('name', metavar='TOPIC')
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
        'dump': ('print all parameters as a parameter file', (_NODE,))}),
    'service': ('list and call services, as ros2 service', {
        'list': ('list the services', _LISTED),
        'call': ('call a service; exit code 1 if it answers with success: false', (
            _argument('name', metavar='SERVICE'),
            _argument('type', metavar='TYPE', help='such as std_srvs/srv/Trigger'), _VALUES))})}


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
