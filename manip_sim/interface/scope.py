# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The namespace of one of several robots, in names of topics and parameters."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Scope:
    """
    The namespace of a robot within the node.

    :ivar name: of the robot; empty for the only robot of a node, whose names have no namespace
    """

    name: str = ''

    def topic(self, name: str) -> str:
        """Return the name of a topic; one that is absolute or private is not the robot's."""
        return f'{self.name}/{name}' if self.name and not name.startswith(('/', '~')) else name

    def parameter(self, name: str) -> str:
        """Return the name of a parameter of the robot."""
        return f'{self.name}.{name}' if self.name else name
