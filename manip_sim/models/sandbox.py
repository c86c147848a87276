# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Load or compile a model in a process of its own first, which can be given up.

MuJoCo cannot be interrupted. The process has little time and memory, and cannot open files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import gc
import hashlib
import os
from pathlib import Path
import pickle
import resource
import signal
import subprocess
import sys
from typing import Any

from manip_sim.errors import ModelError
from manip_sim.quoting import one_line
from manip_sim.startup import spare_garbage

#: Limits of the process: CPU time [s], wall time [s] and address space [bytes].
MAX_CPU_S, MAX_WALL_S, MAX_MEMORY_BYTES = 3, 60.0, 4 * 1024**3
_REMEMBERED = 1000

_passed: dict[bytes, None] = {}
_running: set[subprocess.Popen[bytes]] = set()


def compile_held(xml: str, models: Mapping[str, bytes], assets: Mapping[str, bytes]) -> None:
    """Compile a model."""
    from manip_sim.models.loading import compile_spec, spec_from_string
    compile_spec(spec_from_string(xml, Path('it'), models, assets), 'it')


def try_to_do(name: str, function: Callable[..., Any], *arguments: Any,
              max_cpu_s: int | None = None) -> None:
    """
    Call a function in another process; return if that can be done here, too.

    What passed once is not tried again.

    :param function: of a module; imports nothing when it is called
    :param max_cpu_s: CPU time that it may take [s]; None: :data:`MAX_CPU_S`
    :raises ModelError: if the function does, or does not end within the limits
    """
    cpu_s = max_cpu_s or MAX_CPU_S
    work = pickle.dumps((cpu_s, MAX_MEMORY_BYTES, function, arguments))
    digest = hashlib.sha256(work).digest()
    if digest in _passed:
        return
    problem = _tried(work, cpu_s)
    if problem:
        raise ModelError(f'{one_line(name)} {problem}')
    if len(_passed) >= _REMEMBERED:
        del _passed[next(iter(_passed))]
    _passed[digest] = None


def _tried(work: bytes, cpu_s: int) -> str:
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path)),
                   'OPENBLAS_NUM_THREADS': '1', 'MUJOCO_GL': 'disable'}  # It renders nothing.
    program = f'from {__name__} import main; main()'
    with subprocess.Popen([sys.executable, '-c', program], env=environment, cwd='/',
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL) as process:
        _running.add(process)
        try:
            problem, _ = process.communicate(work, timeout=MAX_WALL_S)
        except subprocess.TimeoutExpired:
            process.kill()
        finally:
            _running.discard(process)
    if process.returncode == 0:
        return problem.decode()
    if process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return f'takes more than {cpu_s} s to load, which is the limit'
    return (f'cannot be compiled: MuJoCo crashes, or needs more than '
            f'{MAX_MEMORY_BYTES / 1e9:.0f} GB')


def give_up() -> None:
    """End the processes in which models are compiled: this one is ending."""
    for process in list(_running):
        process.kill()


def main() -> None:
    """Do what is on standard input, and write what is wrong to standard output."""
    gc.disable()  # It is too short for it.
    # No file can be opened later, and numpy imports this only when it is used.
    import numpy.random  # noqa: F401

    from manip_sim.models import loading  # noqa: F401
    # By the function above, so that it can be trusted.
    cpu_s, memory, function, arguments = pickle.loads(sys.stdin.buffer.read())  # noqa: S301
    descriptions = sys.modules.get('manip_sim.models.strict_descriptions')
    if descriptions is not None:  # The function may read some.
        descriptions.compile_descriptions()
    os.nice(5)
    for limit, value in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CORE, 0),
                         (resource.RLIMIT_FSIZE, 0), (resource.RLIMIT_NOFILE, 0)):
        resource.setrlimit(limit, (value, value))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    try:
        function(*arguments)
    except ModelError as error:
        sys.stdout.write(str(error).removeprefix('it '))
    except (ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError) as error:
        sys.stdout.write(f'cannot be loaded: {type(error).__name__}: {one_line(str(error), 200)}')
    spare_garbage()
