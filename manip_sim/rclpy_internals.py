# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What rclpy has no public name for, in one place; as in its releases 7.1, of ROS 2 Jazzy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError, WaitSet
from rclpy.node import Node
from rclpy.parameter import Parameter

__all__ = ['endpoint_counts', 'InUse', 'parameter_overrides', 'RCLError',
           'UnknownROSArgsError', 'WaitSet']


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


def parameter_overrides(node: Node) -> dict[str, Parameter]:
    """Return the overrides of a node's parameters, declared or not; no copy, may be changed."""
    overrides: dict[str, Parameter] = node._parameter_overrides
    return overrides
