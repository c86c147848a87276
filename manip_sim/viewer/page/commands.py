# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the page asks of whoever is connected to the node, and a queue between the threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import queue
from typing import Protocol

from manip_sim.arrays import FloatArray


class Commands(Protocol):
    """Does what people ask for; called in one thread."""

    def move_joints(self, space: str, part: str, mode: str, goals: Mapping[str, float]) -> None:
        """
        Command joints.

        :param space: of the robot's topics
        :param part: that the joints belong to
        :param mode: its control mode
        :param goals: by joint [rad or m, rad/s or m/s, N m or N]
        """

    def act(self, space: str, part: str, action: float) -> None:
        """Send an action in [-1, 1], the same for all fingers of a gripper; +1 closes."""

    def drive(self, space: str, twist: tuple[float, float, float]) -> None:
        """Send a velocity of a mobile base along its x and y and about z [m/s, m/s, rad/s]."""

    def reach(self, space: str, arm: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Send a goal of a hand in ``world`` [m]."""

    def pause(self, paused: bool) -> None:
        """Let the simulation pause or go on."""

    def step(self) -> None:
        """Let a paused simulation make one control period."""

    def reset(self) -> None:
        """Bring the simulation back to its start."""

    def tare(self) -> None:
        """Let the external wrenches read zero now."""

    def watch(self, camera: str, wanted: bool) -> None:
        """Begin or end to listen to the images of a camera."""


class Events:
    """What people do arrives in threads of the server; this hands it to the one that acts."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def add(self, event: Callable[[], None]) -> None:
        """Let something be done by the next :meth:`run`."""
        self._waiting.put(event)

    def run(self) -> None:
        """Do what waits, in the order in which it came."""
        for _ in range(self._waiting.qsize()):
            self._waiting.get()()
