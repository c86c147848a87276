# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Something that publishes states, with a listener: both stand still while others are measured."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from dataclasses import dataclass
import time
from types import TracebackType

from targets.processes import Process, start_node, start_script

#: Topics of one client, as the targets mean it.
ONE_CLIENT = ('joint_states', 'right/wrench')
#: After the first states, a start goes on for so long: a node then loads its compiled laws [s].
_START_S = 2.0
#: After it stood still, a process gets so long to find its pace again [s].
_RECOVERY_S = 0.4


@dataclass(frozen=True)
class Window:
    """
    Observations of a window of time.

    :ivar simulated_s: simulation time [s]
    :ivar wall_s: wall time [s]
    :ivar core: fraction of a core that the publishing process used
    :ivar walls: when states came, wall time [s], if requested
    """

    simulated_s: float
    wall_s: float
    core: float
    walls: tuple[float, ...] = ()


class Watched:
    """
    A publishing process and its listener in a ``with`` statement; halted but in :meth:`watch`.

    :param server: publishes states
    :param topics: that are listened to
    :param scale: of the waits until they run as fast as they can
    :param apart: ROS domain of the listener, as for :class:`Process`
    """

    def __init__(self, server: Process, topics: tuple[str, ...], scale: float,
                 apart: int = 0) -> None:
        self._recovery_s = _RECOVERY_S * scale
        self._stack = contextlib.ExitStack()
        self.server: Process = self._stack.enter_context(server)
        try:
            self.listener: Process = self._stack.enter_context(
                start_script('listener.py', *topics, apart=apart))
            self.listener.ask('ready', 60.0)
            time.sleep(_START_S * scale)
        except BaseException:
            self._stack.close()
            raise
        self._halt()

    def __enter__(self) -> Watched:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._stack.close()

    def _halt(self) -> None:
        self.listener.halt()
        self.server.halt()

    def watch(self, duration_s: float, walls: bool = False) -> Window:
        """
        Let it run for a while.

        :param duration_s: how long [s]
        :param walls: also return when the states came
        """
        self.server.go()
        self.listener.go()
        time.sleep(self._recovery_s)
        self.listener.ask('begin')
        used_s, begin = self.server.cpu_s(), time.monotonic()
        time.sleep(duration_s)
        core = (self.server.cpu_s() - used_s) / (time.monotonic() - begin)
        simulated_ns, wall_s = self.listener.ask('report')
        came = tuple(self.listener.ask('walls')) if walls else ()
        self.server.check()
        self._halt()
        return Window(simulated_ns * 1e-9, wall_s, core, came)


def watched_node(topics: tuple[str, ...], scale: float, *parameters: str) -> Watched:
    """Start the node with parameters as ``NAME:=VALUE``, and a listener."""
    return Watched(start_node(*parameters), topics, scale)


def watched_loop(topics: tuple[str, ...], scale: float, command: Sequence[str],
                 apart: int = 1) -> Watched:
    """Start one of the loops in this one of other ROS domains, and a listener."""
    return Watched(Process(command, apart=apart), topics, scale, apart)
