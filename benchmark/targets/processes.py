# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Processes that are measured: started, halted while others are measured, and ended cleanly."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
import json
import os
from pathlib import Path
import select
import signal
import subprocess
import sys
import tempfile
import time
from types import TracebackType
from typing import Any

from targets.cpp_loop import build
from targets.figures import MeasureError

_TICK_S = 1.0 / os.sysconf('SC_CLK_TCK')
_HERE = Path(__file__).parent
#: A process that does not answer for so long has failed [s].
_PATIENCE_S = 30.0


def stay_on_two_cores() -> int:
    """Let this process and all that it starts use two cores; return how many there are then."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, cores)
    return len(cores)


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) * _TICK_S


def memory_mb(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def busy_s() -> float:
    """Return the CPU time that all processes together have used on the cores of this one [s]."""
    cores = {f'cpu{core}' for core in os.sched_getaffinity(0)}
    ticks = 0
    for line in Path('/proc/stat').read_text().splitlines():
        name, *fields = line.split()
        if name in cores:
            user, nice, system, _, _, interrupts, soft, stolen = map(int, fields[:8])
            ticks += user + nice + system + interrupts + soft + stolen
    return ticks * _TICK_S


def own_s() -> float:
    """Return the CPU time of this process and of all that it has started and that ended [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class Process:
    """
    A process in a ``with`` statement.

    :param command: what is run
    :param piped: talk with it through its standard input and output
    :param apart: let it live in this one of other ROS domains than that of this process
    """

    def __init__(self, command: Sequence[str], piped: bool = False, apart: int = 0) -> None:
        # A pipe that nobody reads would block the process.
        self._errors = tempfile.TemporaryFile('w+', errors='replace')  # noqa: SIM115
        self._popen = subprocess.Popen(
            command, stdin=subprocess.PIPE if piped else subprocess.DEVNULL,
            stdout=subprocess.PIPE if piped else self._errors, stderr=self._errors,
            env={**os.environ, 'ROS_DOMAIN_ID': _other_domain(apart)} if apart else None)
        self._read = b''

    @property
    def pid(self) -> int:
        """Its number."""
        return self._popen.pid

    def cpu_s(self) -> float:
        """Return the CPU time that it has used [s]."""
        return cpu_s(self.pid)

    def halt(self) -> None:
        """Let it stand still until :meth:`go`."""
        self._popen.send_signal(signal.SIGSTOP)

    def go(self) -> None:
        """Let it go on."""
        self._popen.send_signal(signal.SIGCONT)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End it by SIGINT, and kill it if it does not obey."""
        self.go()
        self._popen.send_signal(signal.SIGINT)
        try:
            self._popen.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()
        for stream in (self._popen.stdin, self._popen.stdout):
            if stream is not None:
                stream.close()
        self._errors.close()

    def check(self) -> None:
        """
        Check that it runs.

        :raises MeasureError: if it has ended
        """
        if self._popen.poll() is not None:
            raise self.failed(f'it ended with {self._popen.returncode}')

    def failed(self, what: str) -> MeasureError:
        """Return the error that this process did not do what was expected."""
        self._errors.seek(0)
        said = self._errors.read()[-1000:].strip()
        return MeasureError(f'{" ".join(str(a) for a in self._popen.args[:3])}: '  # type: ignore
                            f'{what}; it said: {said or "nothing"}')

    def line(self, timeout_s: float = _PATIENCE_S) -> str:
        """
        Return the next line of its standard output.

        :raises MeasureError: if there is none in time
        """
        end = time.monotonic() + timeout_s
        out = self._popen.stdout
        assert out is not None
        while b'\n' not in self._read:
            if not select.select([out], [], [], max(0.0, end - time.monotonic()))[0]:
                raise self.failed(f'no answer within {timeout_s:g} s')
            chunk = os.read(out.fileno(), 1 << 20)
            if not chunk:
                raise self.failed('it ended')
            self._read += chunk
        line, _, self._read = self._read.partition(b'\n')
        return line.decode()

    def ask(self, words: str, timeout_s: float = _PATIENCE_S) -> Any:
        """
        Send a line and return the answer, which is JSON.

        :raises MeasureError: if there is none in time
        """
        assert self._popen.stdin is not None
        try:
            self._popen.stdin.write(f'{words}\n'.encode())
            self._popen.stdin.flush()
        except BrokenPipeError:
            raise self.failed('it ended') from None
        return json.loads(self.line(timeout_s))


def start_node(*parameters: str) -> Process:
    """Start the node with parameters as ``NAME:=VALUE``."""
    words = [word for parameter in parameters for word in ('-p', parameter)]
    return Process([sys.executable, '-m', 'manip_sim', '--ros-args', *words])


def start_script(name: str, *arguments: str, piped: bool = True, apart: int = 0) -> Process:
    """Start a script beside this module."""
    return Process([sys.executable, str(_HERE / name), *arguments], piped, apart)


def loops(*arguments: str) -> list[list[str]]:
    """
    Return the commands of the plain loop and, where it is built, of that in C++.

    As they have the same topics, each needs a domain of its own.
    """
    plain = [sys.executable, str(_HERE / 'plain_loop.py'), *arguments]
    cpp, _ = build()
    return [plain] if cpp is None else [plain, [str(cpp), *arguments]]


def yardsticks(measured: Sequence[Sequence[float]]) -> dict[str, Any]:
    """Return the keywords of a figure for what was measured with each of :func:`loops`."""
    return {'plain': measured[0], 'cpp': measured[1] if len(measured) > 1 else None}


@cache
def _other_domain(number: int) -> str:
    """
    Return the ROS domain of one of the programs that the node is compared with.

    If a participant is stopped for a second while others in its domain write to it, Fast DDS
    abandons its shared-memory segment, and it receives nothing after it is resumed.
    """
    from manip_sim.testing.domains import reserve_domain
    return str(reserve_domain()[0])
