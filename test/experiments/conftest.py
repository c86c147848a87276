# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A fixture of several tests of runs."""

import pytest


@pytest.fixture
def in_this_process(monkeypatch):
    """Run episodes here, in tests of rows and folders: each process would import all again."""
    from manip_sim.experiments import Worker

    def run_here(experiment, seeds, count):
        worker = Worker(experiment)
        return (worker.run(seed) for seed in seeds)
    monkeypatch.setattr('manip_sim.cli.run.run_in_processes', run_here)
