# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node's parameters without ROS: what somebody gives, and defaults for the rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from manip_sim.errors import describe_choices, ParameterError
from manip_sim.interface.parameter_spec import ParameterSpec, type_name
from manip_sim.models.robots.subsystems import SUBSYSTEMS
from manip_sim.quoting import quoted

#: Parameters that every rclpy node knows.
_OF_RCLPY = ('use_sim_time', 'start_type_description_service')
#: Name of the parameter that a robot has, after its namespace, if it came while the node ran.
SPAWNED = 'spawned'


class ParameterSource(Protocol):
    """A declarer of parameters that returns their values: a node or :class:`GivenParameters`."""

    def declare(self, specs: Sequence[ParameterSpec]) -> None:
        """Declare parameters; ParameterError if a given value cannot be used."""

    def value(self, name: str) -> Any:
        """Return the value of a declared parameter."""


class GivenParameters:
    """
    Parameters from a file or a command line.

    :param given: values by name
    :ivar given: the same, a copy
    :ivar specs: what was declared, by name
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given = dict(given)
        self._values: dict[str, Any] = {}
        self.specs: dict[str, ParameterSpec] = {}

    def declare(self, specs: Sequence[ParameterSpec]) -> None:
        """
        Declare parameters and read what was given for them.

        :raises ParameterError: if a value cannot be used
        """
        for spec in specs:
            self.specs[spec.name] = spec
            self._values[spec.name] = spec.default
            if spec.name in self.given:
                value = spec.as_declared(self.given[spec.name])
                problem = spec.type_problem(type_name(value), value) or spec.problem_with(value)
                if problem:
                    raise ParameterError(problem)
                self._values[spec.name] = value

    def value(self, name: str) -> Any:
        """Return the value of a declared parameter."""
        return self._values[name]

    def check_names(self) -> None:
        """
        Reject what was given and nobody declared; forget what is of spawned robots.

        :raises ParameterError: naming the nearest parameters
        """
        forget_spawned(self.given, self.specs)
        check_names(self.given, self.specs)


def forget_spawned(given: dict[str, Any], known: Iterable[str]) -> None:
    """
    Remove the parameters of spawned robots, which the dump of a node has.

    :param given: parameters by name; changed
    :param known: names of those that were declared; a robot that has some of them stays
    """
    spawned = {name.partition('.')[0] for name in given if name.partition('.')[2] == SPAWNED}
    spawned -= {name.partition('.')[0] for name in known}
    for name in [name for name in given if name.partition('.')[0] in spawned]:
        del given[name]


def check_names(given: Iterable[str], known: Iterable[str]) -> None:
    """
    Reject names of parameters that are not known, but for those that every node has.

    :raises ParameterError: naming the nearest parameters
    """
    known = list(known)
    for name in given:
        if name in known or name in _OF_RCLPY or name.startswith('qos_overrides.'):
            continue
        missing = [f'this robot has no {part}, ' for part in name.split('.')
                   if part in SUBSYSTEMS and not any(
                       other.endswith(f'control_mode.{part}') for other in known)]
        raise ParameterError(f"unknown parameter {quoted(name, 200)}: {''.join(missing)}"
                             f'{describe_choices(name, known)}')
