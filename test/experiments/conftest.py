# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures of several tests of runs."""

import multiprocessing
from multiprocessing import forkserver
import os
import sys

import pytest


@pytest.fixture
def in_this_process(monkeypatch):
    """Run episodes here, in tests of rows and folders: each process would import all again."""
    from manip_sim.experiments import Worker

    def run_here(experiment, seeds, count):
        worker = Worker(experiment)
        return (worker.run(seed) for seed in seeds)
    monkeypatch.setattr('manip_sim.cli.run.run_in_processes', run_here)


@pytest.fixture(scope='session')
def server():
    """Return the context of processes that are forked from one that has imported all."""
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload(['worker_server'])
    with pytest.MonkeyPatch.context() as patch:
        # The server takes no path of modules from this process.
        patch.setenv('PYTHONPATH', os.pathsep.join(sys.path))
        forkserver.ensure_running()
    return context


@pytest.fixture
def forked(server, monkeypatch):
    """
    Fork the processes of runs, in tests of what becomes of them.

    One that is spawned, as those of users are, takes a second of processor time to import all.
    """
    from worker_server import ServeInEnvironment
    monkeypatch.setattr('manip_sim.experiments.processes._serve', ServeInEnvironment())
    monkeypatch.setattr(multiprocessing, 'get_context', lambda method: server)
