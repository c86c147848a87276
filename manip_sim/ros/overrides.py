# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check QoS overrides, and look for parameters that are meant for other nodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import difflib
import itertools
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, ReliabilityPolicy
import yaml

from manip_sim.errors import describe_choices, ParameterError
from manip_sim.interface.parameter_files import matches, sections_of
from manip_sim.quoting import quoted, quoted_names
from manip_sim.rclpy_internals import parameter_overrides

_QOS = 'qos_overrides.'
_CHOICES = {
    'history': [policy.name.lower() for policy in HistoryPolicy if policy.name != 'UNKNOWN'],
    'reliability': [policy.name.lower() for policy in ReliabilityPolicy
                    if policy.name != 'UNKNOWN']}
#: A history of more messages costs more memory than a state is worth.
_MAX_DEPTH = 100_000


def check_qos_values(node: Node) -> None:
    """
    Check the values of QoS overrides; rclpy would raise unclear errors, or accept them.

    :raises ParameterError: if one cannot be used
    """
    for name, parameter in _qos_overrides(node):
        policy, value = name.rpartition('.')[2], parameter.value
        choices = _CHOICES.get(policy)
        if choices is not None and value not in choices:
            raise ParameterError(f"parameter '{name}': unknown value {quoted(value)}: "
                                 f'{describe_choices(value, choices)}')
        if policy == 'depth' and not (type(value) is int and 1 <= value <= _MAX_DEPTH):
            raise ParameterError(f"parameter '{name}' must be an integer from 1 to {_MAX_DEPTH}, "
                                 f'got {quoted(value)}')


def check_qos_names(node: Node) -> None:
    """
    Check that each QoS override belongs to a topic; to be called when all topics exist.

    Exact values below ``truth/`` may come later, beside the topics that exist.

    :raises ParameterError: naming the nearest override that has an effect
    """
    for name, _ in _qos_overrides(node):
        if not node.has_parameter(name) and not node.has_parameter(
                name.replace('/truth/', '/', 1)):
            known = node.list_parameters([_QOS[:-1]], 0).names
            near = difflib.get_close_matches(name, known, n=2, cutoff=0.0)
            raise ParameterError(f'unknown parameter {quoted(name, 200)}: did you mean '
                                 + ' or '.join(f"'{other}'" for other in near) + '?')


def _qos_overrides(node: Node) -> list[tuple[str, Any]]:
    overrides = parameter_overrides(node)
    return [(name, overrides[name]) for name in sorted(overrides) if name.startswith(_QOS)]


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
