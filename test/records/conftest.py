# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Episodes to record."""

import pytest

from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode


@pytest.fixture(scope='package')
def episode():
    """Return episodes of reach: one robot, no objects."""
    task = create_task('reach', 'Panda')
    return Episode(task, Simulation(task.world))
