# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images of a world are the same whatever was rendered before."""

import gc

import numpy as np
import pytest

from manip_sim.errors import SimulationEnded
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.tasks.pictures import Pictures

SIZE = (64, 48)


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', arena='table'))


@pytest.mark.full
@pytest.mark.parametrize('camera', ['frontview', 'sideview'])
def test_the_first_image_is_that_of_any_later_moment_and_order_of_cameras(
        renderer, simulation, camera):
    alone = Pictures(simulation, {camera: SIZE})
    first = alone.take(simulation)[camera].rgb
    assert np.array_equal(alone.take(simulation)[camera].rgb, first)
    alone.close()
    others = Pictures(simulation, {'birdview': SIZE, camera: SIZE})
    assert np.array_equal(others.take(simulation)[camera].rgb, first)
    others.close()


@pytest.mark.full
def test_pictures_that_nobody_closed_leave_those_of_others_alone(renderer, simulation):
    lost = Pictures(simulation, {'agentview': SIZE})
    wanted = lost.take(simulation)['agentview'].rgb
    pictures = Pictures(simulation, {'agentview': SIZE})
    lost.itself = lost
    del lost
    gc.collect()
    for _ in range(2):
        assert np.array_equal(pictures.take(simulation)['agentview'].rgb, wanted)
    pictures.close()
    with pytest.raises(SimulationEnded, match='these pictures are closed'):
        pictures.take(simulation)
