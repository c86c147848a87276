# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Programs of the package in forks of one process, which has imported what all of them need.

Imports and the loading of compiled laws are most of the processor time of a start. Tests of the
start itself begin a process of its own instead. This file is run as that one process: it reads
lines of JSON, each a program to start, and writes the identifier of its process.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Sequence
import contextlib
import functools
import gc
import json
import os
from pathlib import Path
import runpy
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

#: Period at which a process is waited for [s].
_LOOK_S = 0.005
#: Set by the recorder of test/mutation, for which a process belongs to the test that starts it.
_RECORDED = 'MUTATION_CHILDREN'


class End(NamedTuple):
    """
    How a program ended.

    :ivar code: exit code, negative for a signal
    """

    code: int
    output: str
    errors: str


class Fork:
    """
    A program as ``python3 -m MODULE ARGUMENTS``, with the part of ``subprocess.Popen`` in use.

    :param module: with a ``__main__``, or the path of a script
    :param arguments: of its command line
    :ivar pid: identifier of the process
    :ivar returncode: exit code, negative for a signal; None until its end has been seen
    """

    def __init__(self, module: str, arguments: Sequence[str]) -> None:
        self.returncode: int | None = None
        template = _template()
        print(json.dumps([module, [*arguments], os.getcwd(), dict(os.environ)]),
              file=template.stdin, flush=True)
        self.pid, folder = json.loads(template.stdout.readline())
        self._folder = Path(folder)

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        with contextlib.suppress(FileNotFoundError):
            self.returncode = int((self._folder / 'code').read_text())
        return self.returncode

    def wait(self, timeout: float = 300.0) -> int:
        """Return the exit code when the process has ended, within a timeout [s]."""
        end_s = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end_s:
                raise subprocess.TimeoutExpired('a fork', timeout)
            time.sleep(_LOOK_S)
        return code

    def communicate(self, timeout: float) -> tuple[str, str]:
        """Return output and errors when the process has ended, within a timeout [s]."""
        self.wait(timeout)
        output, errors = ((self._folder / name).read_text() for name in _STREAMS)
        return output, errors

    def send_signal(self, number: int) -> None:
        """Send a signal unless the process has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


def start(module: str, arguments: Sequence[str],
          fresh: bool = False) -> Fork | subprocess.Popen[str]:
    """Start a program as a fork, or as a process that has imported nothing before."""
    if not fresh and _RECORDED not in os.environ:
        return Fork(module, arguments)
    program = [module] if _is_script(module) else ['-m', module]
    return subprocess.Popen([sys.executable, *program, *arguments], text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def _is_script(module: str) -> bool:
    return module.endswith('.py')


def ends(arguments: Sequence[Sequence[str]]) -> list[End]:
    """Return how nodes that are started with some arguments end, one after the other."""
    found = []
    for words in arguments:
        node = start('manip_sim', words)
        try:
            output, errors = node.communicate(timeout=300.0)
        finally:
            node.kill()
        found.append(End(node.returncode, output, errors))
    return found


@functools.cache
def _template() -> Any:
    """Return the process that forks; it ends with this one."""
    template = subprocess.Popen([sys.executable, __file__], text=True, stdin=subprocess.PIPE,
                                stdout=subprocess.PIPE)
    atexit.register(template.communicate)
    return template


#: Files of the standard streams in the folder of a program, in the order of their descriptors.
_STREAMS = ('output', 'errors')


def _serve(root: str) -> list[Any] | None:
    """Fork for each line of the standard input until its end; return to a fork what it runs."""
    poll, notes = select.poll(), dict[int, Callable[[], None]]()
    poll.register(sys.stdin, select.POLLIN)
    while True:
        for descriptor, _ in poll.poll():
            if descriptor in notes:
                notes.pop(descriptor)()
                poll.unregister(descriptor)
                os.close(descriptor)
                continue
            line = sys.stdin.readline()
            if not line:
                return None
            folder = Path(tempfile.mkdtemp(dir=root))
            child = os.fork()
            if not child:
                return [folder, *json.loads(line)]
            process = os.pidfd_open(child)
            poll.register(process, select.POLLIN)
            notes[process] = functools.partial(_note_end, child, folder)
            print(json.dumps([child, str(folder)]), flush=True)


def _note_end(child: int, folder: Path) -> None:
    _, status = os.waitpid(child, 0)
    (folder / 'new').write_text(str(os.waitstatus_to_exitcode(status)))
    (folder / 'new').rename(folder / 'code')


def _run(folder: Path, module: str, arguments: Sequence[str], here: str,
         environment: dict[str, str]) -> None:
    """Run a program, and end as any other process does."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for descriptor, name in enumerate(_STREAMS, 1):
        os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_APPEND), descriptor)
    os.chdir(here)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [module, *arguments]
    if _is_script(module):
        runpy.run_path(module, run_name='__main__')
    else:
        runpy.run_module(module, run_name='__main__', alter_sys=True)


def _import() -> None:
    """Import and load what programs need; nothing of it is garbage."""
    gc.disable()
    from manip_sim.startup import import_mujoco
    import_mujoco()
    from manip_sim.control.law.kept import all_are_kept
    from manip_sim.control.law.loading import load_laws
    import manip_sim.examples.hand_over
    import manip_sim.examples.pick_cube
    import manip_sim.ros.process  # noqa: F401
    if all_are_kept():
        load_laws()
    gc.freeze()


if __name__ == '__main__':
    _import()
    files = tempfile.mkdtemp(prefix='manip_sim_forks_')
    program = _serve(files)
    if program is None:
        shutil.rmtree(files)
    else:
        _run(*program)
