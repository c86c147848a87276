# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which command took each joint last, which is remembered after the command has ended."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.simulation.commands import CommandHandle, Status


class JointOwners:
    """
    The command that took each joint last, or what took the joint from all commands.

    :param count: number of joints
    """

    def __init__(self, count: int) -> None:
        self._owners = [CommandHandle(Status.DONE) for _ in range(count)]

    def take(self, indices: IntArray, handle: CommandHandle) -> None:
        """Let joints belong to a command."""
        for index in indices.tolist():
            self._owners[index] = handle

    def release(self, indices: IntArray, reason: str) -> None:
        """Take joints from all commands, and remember why."""
        self.take(indices, CommandHandle(Status.ABORTED, reason))

    def of(self, handle: CommandHandle) -> IntArray:
        """Return the joints that belong to a command."""
        return np.array([index for index, owner in enumerate(self._owners) if owner is handle],
                        dtype=np.int64)

    def rival(self, handle: CommandHandle, indices: IntArray) -> CommandHandle | None:
        """Return what took a joint from a command, or None if all the joints are its own."""
        owners = (self._owners[index] for index in indices.tolist())
        return next((owner for owner in owners if owner is not handle), None)
