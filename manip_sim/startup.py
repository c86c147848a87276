# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Start of a program: standard streams, signals that end it, the slow imports of NumPy and MuJoCo.

It imports little, so that signals are handled as soon as a program begins.
"""

from __future__ import annotations

import gc
import itertools
import os
import select
import signal
import sys

TYPE_CHECKING = False  # As in typing, whose import would take longer than all others here.
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: Files with the quota of a cgroup and its period [us], in version 2 and 1.
_QUOTA_2: tuple[str, ...] = ('cpu.max',)
_QUOTA_1: tuple[str, ...] = ('cpu.cfs_quota_us', 'cpu.cfs_period_us')


def run_program(program: Callable[[], int]) -> int:
    """
    Run a program that SIGINT, SIGTERM and SIGHUP end with code 0, from the first line on.

    :param program: imports what takes long, without collection of garbage: nothing of it is any;
        then enables ``gc`` and takes over by :class:`EndSignals`
    """
    gc.disable()
    exit_on_signals()
    open_standard_streams()
    try:
        return program()
    finally:
        ignore_end_signals()
        spare_garbage()


def spare_garbage() -> None:
    """
    Let Python not look for garbage when this process ends, as it is about to.

    That would take a fifth of the processor time of a program that ends soon.
    """
    gc.freeze()


def open_standard_streams() -> None:
    """
    Open standard input, output and error on the null device where they are closed.

    Otherwise what the process opens gets their descriptors, and whatever a library prints is
    written to it, such as to a socket or to the pipe of :class:`EndSignals`.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
    for descriptor, name in enumerate(('stdin', 'stdout', 'stderr')):
        if getattr(sys, name) is None:
            setattr(sys, name,
                    os.fdopen(descriptor, 'w' if descriptor else 'r', closefd=False))


def exit_on_signals() -> None:
    """
    Let SIGINT, SIGTERM and SIGHUP end the process at once with code 0, as long as it only imports.

    That is until there are :class:`EndSignals`.
    """
    for number in _end_signals():
        signal.signal(number, lambda *_: os._exit(0))


class EndSignals:
    """
    SIGINT, SIGTERM and SIGHUP, for which the main thread can wait from now on.

    The signals arrive as bytes in a pipe: a handler that takes a lock, such as that of an event,
    can deadlock if the thread that it interrupts holds this lock.
    """

    def __init__(self) -> None:
        self._arrived, signals = os.pipe()
        os.set_blocking(signals, False)
        # Until the last of these lines a signal ends the process as before; none is lost.
        signal.set_wakeup_fd(signals, warn_on_full_buffer=False)
        for number in _end_signals():
            signal.signal(number, lambda *_: None)

    def wait(self, timeout_s: float) -> bool:
        """Wait for a signal, at most for a timeout [s]; return whether one has come."""
        return bool(select.select([self._arrived], [], [], max(0.0, timeout_s))[0])


def ignore_end_signals() -> None:
    """Ignore SIGINT, SIGTERM and SIGHUP from now on: the process is ending."""
    # Python would print a message about a signal that comes while the handlers change.
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    for number in _end_signals():
        signal.signal(number, signal.SIG_IGN)
    sys.unraisablehook = hook


def leave(code: int, *abandoned: str) -> int:
    """
    Return an exit code, or end the process at once if a thread runs that cannot be ended in it.

    A normal exit of Python would close OpenGL while a thread renders, or unload what compiles.
    """
    import threading
    if any(thread.name in abandoned for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def _end_signals() -> list[signal.Signals]:
    """Return the signals that end a program; nohup ignores SIGHUP."""
    return [number for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN]


def processors(root: str = '') -> int:
    """
    Return the number of processors that this process may use, at least 1.

    It is that of its CPU affinity, or of the least quota among its cgroups (versions 2 and 1) and
    those above them, rounded up. A quota that cannot be read does not count.

    :param root: folder with ``proc`` and ``sys``
    """
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else (
        os.cpu_count() or 1)
    return min([allowed, *_quotas(root)])


def _quotas(root: str) -> Iterator[int]:
    """Yield the numbers of processors that quotas allow, rounded up."""
    for folder, names in _cgroups(root):
        text = ' '.join(_text(f'{folder}/{name}') for name in names)
        try:
            quota_us, period_us = map(int, text.split())
        except ValueError:  # Such as max, or nothing.
            continue
        if quota_us > 0 and period_us > 0:
            yield -(-quota_us // period_us)


def _cgroups(root: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield folders of the cgroups of this process and above, and the files with their quotas."""
    mounted = f'{root}/sys/fs/cgroup'
    for line in _text(f'{root}/proc/self/cgroup').splitlines():
        _, controllers, path = line.split(':', 2) if line.count(':') > 1 else ('', 'odd', '')
        if not controllers:
            mounts, names = [mounted, f'{mounted}/unified'], _QUOTA_2
        elif 'cpu' in controllers.split(','):
            mounts, names = [f'{mounted}/cpu', f'{mounted}/{controllers}'], _QUOTA_1
        else:
            continue
        below = [name for name in path.split('/') if name]
        if '..' in below:  # The process was moved out of what the container sees.
            below = []
        # In a container, its own cgroup may be the root, and the path that of the host.
        for mount, depth in itertools.product(mounts, range(len(below) + 1)):
            yield '/'.join([mount, *below[:depth]]), names


def _text(path: str) -> str:
    """Return the text of a file, none if it cannot be read."""
    try:
        with open(path, encoding='ascii', errors='replace') as file:
            return file.read()
    except (OSError, ValueError):
        return ''


def use_one_blas_thread() -> None:
    """
    Let NumPy start without threads for linear algebra.

    ``OPENBLAS_NUM_THREADS`` and ``OMP_NUM_THREADS`` count, where they are set.

    A robot's matrices are too small for them, and after the import of NumPy the OpenBLAS threads
    busy-wait: a quarter of the processor time of a node's start on two processors.
    """
    if 'OMP_NUM_THREADS' not in os.environ:
        os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')


def import_mujoco() -> None:
    """
    Import MuJoCo without OpenGL, in programs that render later, or never.

    Otherwise MuJoCo looks for OpenGL in child processes, which take long and outlive a signal, and
    its import fails where ``MUJOCO_GL`` names a backend that is not available.
    """
    use_one_blas_thread()
    asked = os.environ.get('MUJOCO_GL')
    os.environ['MUJOCO_GL'] = 'disable'
    try:
        import mujoco  # noqa: F401
    finally:
        del os.environ['MUJOCO_GL']
        if asked is not None:
            os.environ['MUJOCO_GL'] = asked


def without_ros_arguments(arguments: list[str]) -> list[str]:
    """Return the arguments that are not between ``--ros-args`` and ``--``."""
    ours, ros = [], False
    for argument in arguments:
        if argument == '--ros-args':
            ros = True
        elif not ros:
            ours.append(argument)
        elif argument == '--':
            ros = False
    return ours
