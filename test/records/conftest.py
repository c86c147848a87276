# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Episodes to record."""

import numpy as np
import pytest

from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode


@pytest.fixture(scope='package')
def episode():
    """Return episodes of reach: one robot, no objects."""
    task = create_task('reach', 'Panda')
    return Episode(task, Simulation(task.world))


@pytest.fixture(scope='package')
def recording(tmp_path_factory, episode):
    """Return the file of two episodes with images, of which only the first one does the task."""
    pytest.importorskip('mcap_ros2', reason='needs the extra records')
    from manip_sim.records import EpisodeRecorder
    path = tmp_path_factory.mktemp('records') / 'reach.mcap'
    expert = episode.task.expert(episode.simulation)
    with EpisodeRecorder(path, episode, digest_every=4) as recorder:
        for seed, periods in ((3, 1000), (11, 3)):
            episode.reset(seed)
            expert.reset(seed)
            recorder.begin(seed, {'front': image_of(episode)})
            while not episode.over and episode.periods < periods:
                action = 0.1 * expert.act()  # Slowly.
                episode.step(action)
                recorder.period(action, images={'front': image_of(episode)})
            recorder.end()
    return path


def image_of(episode):
    """Return an image that shows seconds and periods of a simulation."""
    image = np.full((48, 64, 3), 40, np.uint8)
    image[:, :4 + 2 * episode.periods % 60, 0] = 220
    return image
