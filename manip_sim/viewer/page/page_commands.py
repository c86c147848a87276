# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands that people give on the page, inputs that show them, and a queue between threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import queue
from typing import Protocol

from manip_sim.arrays import FloatArray

#: What a person has requested is shown at least so long [s], and until nothing moves.
_HOLD_S = 1.0


class PageCommands(Protocol):
    """
    A receiver of the commands that people give on the page; called in one thread.

    A page without one can only be watched.
    """

    def move_joints(self, space: str, part: str, field: str, goals: Mapping[str, float]) -> None:
        """
        Command joints.

        :param space: namespace of the robot's topics, such as ``/left/``
        :param part: that the joints belong to
        :param field: of the commands, such as ``position``
        :param goals: by joint [rad or m, rad/s or m/s, N m or N]
        """

    def act(self, space: str, part: str, action: float) -> None:
        """Send an action in [-1, 1], the same for all fingers of a gripper; +1 closes."""

    def drive(self, space: str, twist: tuple[float, float, float]) -> None:
        """Send a velocity of a mobile base along its x and y and about z [m/s, m/s, rad/s]."""

    def reach(self, space: str, arm: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Send a target pose of an end effector in ``world``; the position in [m]."""

    def pull(self, body: str, number: int, point: FloatArray, target: FloatArray) -> None:
        """
        Pull a body for a moment.

        :param number: of the drag; while it stays the same, the point does not count again
        :param point: of the body, in ``world`` [m], shape (3,)
        :param target: where the point is pulled to, in ``world`` [m], shape (3,)
        """

    def let_go(self, body: str) -> None:
        """End the pull of a body."""

    def modes(self, space: str, part: str) -> Sequence[str]:
        """Return the control modes that a part can be switched to; none if it has no choice."""

    def switch_mode(self, space: str, part: str, mode: str) -> None:
        """Switch the control mode of a part."""

    def record(self, wanted: bool) -> None:
        """Begin or end a record of the node."""

    def pause(self, paused: bool) -> None:
        """Pause the simulation, or let it go on."""

    def step(self) -> None:
        """Advance a paused simulation by one control period."""

    def reset(self) -> None:
        """Bring the simulation back to its start."""

    def tare(self) -> None:
        """Tare the external wrenches: let them read zero now."""


class Events:
    """A queue of calls, from threads of the server to the thread that updates the page."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def add(self, event: Callable[[], None]) -> None:
        """Queue a call for the next :meth:`run`."""
        self._waiting.put(event)

    def run(self) -> None:
        """Make the queued calls, in the order in which they came."""
        for _ in range(self._waiting.qsize()):
            self._waiting.get()()


class Following:
    """
    The choice whether an input shows the measured or the requested value.

    A goal that is not reached, such as one behind an obstacle, is given up when all is still.
    """

    def __init__(self) -> None:
        self._until_s: float | None = None

    def asked(self, now_s: float) -> None:
        """Note that a person has changed the input; ``now_s`` is wall time [s]."""
        self._until_s = now_s + _HOLD_S

    def follows(self, now_s: float, moving: bool) -> bool:
        """
        Tell whether the input is to show the measured value.

        :param now_s: wall time [s]
        :param moving: whether what is measured changes, or cannot because of a pause
        """
        if self._until_s is None:
            return True
        if moving:
            self._until_s = max(self._until_s, now_s + 0.2 * _HOLD_S)
        if now_s > self._until_s:
            self._until_s = None
        return self._until_s is None
