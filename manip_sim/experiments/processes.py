# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run episodes in processes, also of Ray; the seed of a process that dies is run again."""

from __future__ import annotations

import atexit
from collections import Counter, deque
from collections.abc import Iterator, Sequence
import contextlib
import functools
import math
import multiprocessing
from multiprocessing.connection import Connection, wait
import os
from pathlib import Path
import pickle
import signal
import socket
import threading
import time
from typing import Any

from manip_sim.errors import ManipSimError
from manip_sim.experiments.experiment import Experiment, Row, Worker
from manip_sim.experiments.policies import ROS
from manip_sim.quoting import one_line
from manip_sim.startup import processors, use_one_blas_thread

#: Number of tries of a seed whose process dies each time.
TRIES = 3
#: Longest time between two checks of processes that neither answer nor close their pipe, wall time
#: [s], and how many there are at least within the limit of an answer of a policy.
_LOOK_S, _LOOKS = 1.0, 4
#: Exit code of a process without memory, and of the memory of this machine, what all may use.
_WITHOUT_MEMORY, _MEMORY_SHARE = 12, 0.8


class WorkerPool:
    """
    Processes that run the episodes of an experiment.

    A process that has died is replaced, and one that uses more memory than its share, and twice
    what it used after its first episode.

    :param experiment: to run
    :param count: number of processes
    """

    def __init__(self, experiment: Experiment, count: int) -> None:
        self._experiment = experiment
        # A ROS node has its own limit.
        self._limit_s = (math.inf if experiment.policy.startswith(ROS)
                         else experiment.policy_limit_s)
        self._workers = [_WorkerProcess(experiment) for _ in range(count)]
        memory_bytes = os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE')
        self._share_bytes = _MEMORY_SHARE * memory_bytes / max(count, processors())

    def run(self, seeds: Sequence[int]) -> Iterator[Row]:
        """
        Yield the row of each seed, as they come.

        A seed whose process dies three times gets a row with that error.

        :param seeds: of the episodes
        :raises ManipSimError: if a process cannot begin
        """
        size, died, workers = max(self._experiment.batch, 1), Counter[int](), self._workers
        # The same seeds make the same batches, however fast they run.
        waiting = deque(list(seeds[i:i + size]) for i in range(0, len(seeds), size))
        while waiting or any(worker.seeds for worker in workers):
            for worker in workers:
                if waiting and not worker.seeds:
                    worker.begin(waiting.popleft())
            for worker in self._ready():
                answer = worker.answer()
                if isinstance(answer, ManipSimError):
                    raise answer
                if answer is not None:
                    yield answer
                    if not worker.seeds and worker.has_grown_beyond(self._share_bytes):
                        worker.restart()
                    continue
                died.update(worker.seeds)
                failed = {seed: self._failed(seed, died[seed], worker) for seed in worker.seeds}
                worker.restart()
                # Each alone: one may end the process of the others again.
                waiting.extendleft([seed] for seed, row in failed.items() if row is None)
                yield from (row for row in failed.values() if row is not None)

    def _ready(self) -> list[_WorkerProcess]:
        """
        Return workers that have answered or died, after ending those whose policy takes too long.

        A copy of one that has died, by a fork, may keep its pipe.
        """
        asked = [worker for worker in self._workers if worker.seeds]
        while True:
            ready = wait([worker.pipe for worker in asked], min(_LOOK_S, self._limit_s / _LOOKS))
            for worker in asked:
                worker.end_if_late(self._limit_s)
            done = [worker for worker in asked if worker.pipe in ready or not worker.alive]
            if done:
                return done

    def _failed(self, seed: int, count: int, worker: _WorkerProcess) -> Row | None:
        """Return the row of a seed whose process died, or None if it is to be tried again."""
        exit_code = worker.exit_code
        if worker.was_late:
            why = f'the policy took longer than {self._limit_s:g} s'
        elif count < TRIES:
            return None
        elif exit_code == _WITHOUT_MEMORY:
            why = f'its process ran out of memory {TRIES} times'
        else:
            why = f'its process died {TRIES} times, exit code {exit_code}'
        return Row(seed, False, 0.0, 0, '', why)

    def close(self) -> None:
        """End the processes."""
        for worker in self._workers:
            worker.end()


def run_in_processes(experiment: Experiment, seeds: Sequence[int], count: int) -> Iterator[Row]:
    """
    Yield the row of each seed, as they come.

    :param experiment: to run
    :param seeds: of the episodes
    :param count: number of processes
    :raises ManipSimError: if a process cannot begin
    """
    pool = WorkerPool(experiment, min(count, -(-len(seeds) // max(experiment.batch, 1))))
    try:
        yield from pool.run(seeds)
    finally:
        pool.close()


class _WorkerProcess:
    """
    A process that runs one episode after the other, or a batch after the other.

    :ivar seeds: what it runs
    :ivar pipe: of the answers
    :ivar was_late: whether it was ended because its policy took too long
    """

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self.seeds: list[int] = []
        self.exit_code: int | None = None
        self._start()

    def _start(self) -> None:
        # Forked processes would share OpenGL and threads of libraries.
        context = multiprocessing.get_context('spawn')
        self.pipe, theirs = context.Pipe()
        self.was_late = False
        # A policy may stop its process, or take signals and timers for itself: no alarm is sure.
        self._asked_s = context.RawValue('d', 0.0)
        self._process: Any = context.Process(
            target=_serve, args=(theirs, self._asked_s, self._experiment), daemon=True)
        self._process.start()
        theirs.close()
        self._first_bytes = 0

    def begin(self, seeds: list[int]) -> None:
        """Let it run seeds; that it has died shows in the answer."""
        self.seeds = seeds
        with contextlib.suppress(OSError):
            self.pipe.send(seeds)

    def answer(self) -> Row | ManipSimError | None:
        """Return the row of one of its seeds, why it cannot begin, or None if it has died."""
        with contextlib.suppress(EOFError, OSError):
            if self.pipe.poll():
                answer: Row | ManipSimError = self.pipe.recv()
                if isinstance(answer, Row):
                    self.seeds = [seed for seed in self.seeds if seed != answer.seed]
                return answer
        self._process.join()
        self.exit_code = self._process.exitcode
        return None

    @property
    def alive(self) -> bool:
        """True if its process runs."""
        return bool(self._process.is_alive())

    def end_if_late(self, limit_s: float) -> None:
        """End it if its policy has taken longer than a limit [s] to answer."""
        asked_s = self._asked_s.value
        if asked_s and time.monotonic() - asked_s > limit_s and not self.was_late:
            self.was_late = True
            self._process.kill()
            self._process.join()

    def has_grown_beyond(self, share_bytes: float) -> bool:
        """Return whether it uses more memory than that, and twice that of the first call."""
        try:
            pages = Path(f'/proc/{self._process.pid}/statm').read_text().split()[1]
        except OSError:  # It has ended, or the system is not Linux.
            return False
        used_bytes = int(pages) * os.sysconf('SC_PAGE_SIZE')
        self._first_bytes = self._first_bytes or used_bytes
        return used_bytes > max(share_bytes, 2 * self._first_bytes)

    def restart(self) -> None:
        """Put another process in its place, which runs nothing yet."""
        self.end()
        self.seeds = []
        self._start()

    def end(self) -> None:
        """End the process."""
        self.pipe.close()
        self._process.terminate()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _serve(pipe: Connection, asked_s: Any, experiment: Experiment) -> None:
    """Run the seeds that come, until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # The process that asks ends this one.
    use_one_blas_thread()
    process = os.getpid()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        worker = Worker(experiment, functools.partial(setattr, asked_s, 'value'))
        while True:
            for row in worker.run_at_once(pipe.recv()):
                if os.getpid() != process:  # A policy has forked; one of the two may answer.
                    os._exit(1)
                pipe.send(row)
    except MemoryError:  # Not that of the seed: others before it may have kept the memory.
        os._exit(_WITHOUT_MEMORY)
    except ManipSimError as error:
        pipe.send(ManipSimError(str(error)))  # Some types cannot be unpickled.
    except (EOFError, OSError):
        pass
    finally:
        pipe.close()


def _end_with_parent() -> None:
    """End this process when the one that asks was killed; a policy may take long to answer."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


#: Seeds of one of Ray's tasks: seconds of work, beside which its overhead is small.
_SEEDS_OF_TASK = 8
#: Longest wait for a connection to a cluster [s].
_ANSWER_S = 10.0


def run_on_ray(experiment: Experiment, seeds: Sequence[int], address: str | None,
               count: int | None) -> Iterator[Row]:
    """
    Yield the row of each seed, as they come.

    :param experiment: to run; its policy must be importable on all nodes
    :param seeds: of the episodes
    :param address: of a running cluster, as ``ray.init`` takes it; None starts one here
    :param count: number of episodes at once; None for one per processor of the cluster
    :raises ManipSimError: if Ray is not installed, or the cluster is not reachable
    """
    try:
        import ray
    except ImportError as error:
        raise ManipSimError("--engine ray needs Ray: pip install 'manip_sim[ray]'") from error
    if address is not None:
        _check_answered(address)
    started = not ray.is_initialized()
    if started:
        try:
            ray.init(address=address, num_cpus=_processors_of_new_cluster(address, count),
                     log_to_driver=False, include_dashboard=False, logging_level='warning')
        except Exception as error:  # Ray raises many types.
            raise ManipSimError(f'Ray: {one_line(str(error), 300)}') from error
    try:
        yield from _spread(ray, experiment, seeds, count)
    finally:
        if started:
            ray.shutdown()


def _processors_of_new_cluster(address: str | None, count: int | None) -> int | None:
    """Return the processors of a cluster that Ray starts here; None if it connects to one."""
    return count or processors() if address is None and 'RAY_ADDRESS' not in os.environ else None


def _check_answered(address: str) -> None:
    """Reject an address at which nothing answers, which Ray waits minutes for."""
    host, _, port = address.rpartition('://')[2].rpartition(':')
    if not host or not port.isdecimal():  # Such as 'auto', which Ray looks up.
        return
    try:
        socket.create_connection((host, int(port)), timeout=_ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise ManipSimError(f'no Ray cluster answers at {one_line(address, 100)}: '
                            f'{getattr(error, "strerror", None) or error}') from error


def _spread(ray: Any, experiment: Experiment, seeds: Sequence[int], count: int | None
            ) -> Iterator[Row]:
    # Ray runs a task again that dies with its node; the same seed, the same row.
    run = ray.remote(max_retries=-1, scheduling_strategy='SPREAD')(_run)
    shared = ray.put(experiment)
    size = experiment.batch or _SEEDS_OF_TASK
    pieces = [list(seeds[i:i + size]) for i in range(0, len(seeds), size)]
    most = count or max(1, int(ray.cluster_resources().get('CPU', 1)))
    under_way: list[Any] = []
    while pieces or under_way:
        while pieces and len(under_way) < 2 * most:
            under_way.append(run.remote(shared, pieces.pop(0)))
        ready, under_way = ray.wait(under_way, num_returns=1)
        for reference in ready:
            answer = ray.get(reference)
            if isinstance(answer, str):
                raise ManipSimError(answer)
            yield from answer


def _run(experiment: Experiment, seeds: list[int]) -> list[Row] | str:
    """Return the rows of some seeds, or why there are none."""
    pool = _pool(pickle.dumps(experiment))
    try:
        return list(pool.run(seeds))
    except ManipSimError as error:
        pool.close()
        _pool.cache_clear()
        return str(error)


@functools.lru_cache(maxsize=1)
def _pool(pickled: bytes) -> WorkerPool:
    """
    Return the process that runs episodes for this one, for one task of Ray after the other.

    A policy that ends its process, or takes too long, costs its own episode only.
    """
    pool = WorkerPool(pickle.loads(pickled), 1)
    atexit.register(pool.close)
    return pool
