# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run episodes on a cluster of Ray, which runs those of workers and nodes that die again."""

from __future__ import annotations

import atexit
from collections.abc import Iterator, Sequence
import functools
import os
import pickle
import socket
from typing import Any

from manip_sim.errors import ManipSimError
from manip_sim.experiments.experiment import Experiment
from manip_sim.experiments.processes import WorkerPool
from manip_sim.experiments.summary import Row
from manip_sim.quoting import one_line
from manip_sim.startup import processors

#: Seeds of one of Ray's tasks: seconds of work, beside which its overhead is small.
_SEEDS_OF_TASK = 8
#: Longest wait for a connection to a cluster [s].
_ANSWER_S = 10.0


def run_on_ray(experiment: Experiment, seeds: Sequence[int], address: str | None,
               count: int | None) -> Iterator[Row]:
    """
    Yield the row of each seed, as they come.

    :param experiment: what is run; its policy must be importable on all nodes
    :param seeds: of the episodes
    :param address: of a running cluster, as ``ray.init`` takes it; None starts one here
    :param count: number of episodes at once; None for one per processor of the cluster
    :raises ManipSimError: if Ray is not installed, or there is no cluster
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
    pieces = [list(seeds[i:i + _SEEDS_OF_TASK]) for i in range(0, len(seeds), _SEEDS_OF_TASK)]
    most = count or max(1, int(ray.cluster_resources().get('CPU', 1)))
    under_way: list[Any] = []
    while pieces or under_way:
        while pieces and len(under_way) < 2 * most:
            under_way.append(run.remote(shared, pieces.pop(0)))
        ready, under_way = ray.wait(under_way, num_returns=1)
        for found in ready:
            answer = ray.get(found)
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
