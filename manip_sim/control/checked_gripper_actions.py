# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Call a gripper's ``format_action``, which may be a user's code, and check what it returns."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.grippers import GripperModel


class Formatter:
    """
    The ``format_action`` of a gripper, with its results checked.

    :param gripper: its method is called once with zeros, and its state restored
    :param count: how many commands the method has to return
    :ivar faults: how many later calls raised or returned something else
    :ivar last_fault: what the last of these did
    :raises ModelError: if the call with zeros raises or does not return ``count`` finite numbers
    """

    #: Only counted and told.
    remembered = ('faults', 'last_fault')
    undigested = remembered

    def __init__(self, gripper: GripperModel, count: int) -> None:
        self._gripper = gripper
        self._count = count
        self.dof = gripper.dof
        self.faults = 0
        self.last_fault = ''
        self._closing: FloatArray | None = None
        with self._state_kept():
            fault = self._fault(np.zeros(self.dof))[1]
        if fault is not None:
            raise ModelError(f'format_action of {type(gripper).__name__} must return {count} '
                             f'finite numbers, one for each actuator, but with an action of '
                             f'{self.dof} zeros {fault}')

    @contextlib.contextmanager
    def _state_kept(self) -> Iterator[None]:
        gripper = self._gripper
        state = gripper.state_copy()
        try:
            yield
        finally:
            vars(gripper).clear()
            vars(gripper).update(state)

    @property
    def closing(self) -> FloatArray:
        """
        Signs of how commands change with actions of ones, zero where they do not, shape (count,).

        On first use, ``format_action`` is called with ones and minus ones, and its state restored.
        """
        if self._closing is None:
            commands = []
            with self._state_kept():
                for sign in (1.0, -1.0):
                    self.start_at(np.zeros(self._count))
                    commands.append(self._fault(np.full(self.dof, sign))[0])
            self._closing = np.sign(commands[0] - commands[1])
        return self._closing

    def format(self, action: FloatArray) -> FloatArray | None:
        """
        Return commands in [-1, 1], shape (count,), or None after a fault, which is counted.

        :param action: in [-1, 1], shape (dof,)
        """
        command, fault = self._fault(action)
        if fault is not None:
            self._take_note(f'format_action: {fault}')
            return None
        return np.minimum(np.maximum(command, -1.0), 1.0)  # np.clip takes thrice as long.

    def start_at(self, command: FloatArray) -> bool:
        """Let ``format_action`` continue from a command; return whether that worked."""
        try:
            self._gripper.start_at(command)
        except Exception as error:
            self._take_note(f'start_at: it raised {type(error).__name__}: {error}')
            return False
        return True

    def _take_note(self, fault: str) -> None:
        self.faults += 1
        self.last_fault = fault

    def _fault(self, action: FloatArray) -> tuple[FloatArray, str | None]:
        """Return the commands of an action, and their fault or None."""
        nothing: Any = np.zeros(self._count)
        try:
            command = np.asarray(self._gripper.format_action(action.copy()), dtype=float)
        except Exception as error:
            return nothing, f'it raised {type(error).__name__}: {error}'
        if command.shape != (self._count,):
            return nothing, f'it returned the shape {command.shape}'
        if not np.isfinite(command).all():
            return nothing, f'it returned {command.tolist()}'
        return command, None
