# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images of a world are the same whatever was rendered before."""

import gc
import threading

import numpy as np
import pytest

from manip_sim.errors import ManipSimError, SimulationEnded
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.tasks.observation import Pictures, PictureThreads

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


@pytest.fixture(scope='module')
def others():
    """Return simulations of the same world, whose robots stand in other ways."""
    others = [Simulation(compose('Panda', arena='table')) for _ in range(3)]
    for number, other in enumerate(others):
        other.data.qpos[1] += 0.2 * number
        other.forward()
    return others


def take(pictures, simulation):
    return pictures.take(simulation)['frontview']


@pytest.mark.full
def test_threads_render_the_pixels_of_one_in_the_order_of_the_worlds(renderer, simulation, others):
    def create():
        return Pictures(simulation, {'frontview': SIZE}, ('rgb', 'depth', 'labels'))

    alone, threads = create(), PictureThreads(create, 2)
    assert threads.cameras == ['frontview']
    wanted = alone.each(take, others)
    assert len({picture.rgb.tobytes() for picture in wanted}) == 3
    for count in (3, 1, 2):
        found = threads.each(take, others[:count])
        assert len(found) == count
        for one, picture in zip(found, wanted):
            for kind in ('rgb', 'depth', 'labels'):
                assert np.array_equal(getattr(one, kind), getattr(picture, kind))
    with pytest.raises(ZeroDivisionError):
        threads.each(lambda own, number: 1 // number, [1, 1, 0])
    assert len(threads.each(take, others)) == 3
    for _ in range(2):
        threads.close()
    with pytest.raises(SimulationEnded, match='these pictures are closed'):
        threads.each(take, others)
    alone.close()


@pytest.mark.full
def test_threads_that_cannot_all_render_end(renderer, simulation):
    made, before = [], threading.active_count()

    def create():
        if made:
            raise ManipSimError('no context is left')
        made.append(Pictures(simulation, {'frontview': SIZE}))
        return made[0]

    with pytest.raises(ManipSimError, match='no context is left'):
        PictureThreads(create, 2)
    assert threading.active_count() == before
    with pytest.raises(SimulationEnded):
        made[0].take(simulation)
