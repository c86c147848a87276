# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cameras that are chosen by name or by description, without rendering."""

import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.cameras import (
    chosen_cameras, create_camera, described_cameras, ImageSettings)
from manip_sim.models.world import World
from manip_sim.sensing.images import MAX_PIXELS


def choose(*given, world=None):
    """Return the cameras that are chosen by texts, as the node does."""
    world = world or compose('Panda')
    world.cameras += [create_camera(camera) for camera in described_cameras(given)]
    return chosen_cameras(given, world.cameras, world.compile())


def with_cameras(one_joint_arm, *cameras):
    """Return a world whose arm has these cameras."""
    robot = one_joint_arm()
    for attributes in cameras:
        robot.spec.worldbody.add_camera(**attributes)
    return World([robot])


def test_cameras_are_chosen_by_name_and_by_description_in_their_order():
    chosen = choose('birdview', '', '{name: side, rate: 5, width: 320, height: 200, depth: false}',
                    'frontview')
    assert chosen == {'birdview': ImageSettings(), 'frontview': ImageSettings(),
                      'side': ImageSettings(320, 200, 5.0, False)}
    assert list(chosen) == ['birdview', 'side', 'frontview']
    assert choose() == {}


@pytest.mark.parametrize('given, error, what', [
    (['birdviev'], UnknownNameError, "camera 'birdviev'.*did you mean 'birdview'"),
    (['birdview', 'birdview'], ModelError, "^the camera 'birdview' is chosen twice$"),
    (['{name: side}', '{name: side}'], ModelError, "'side'"),
    (['{name: side'], ModelError, "^one of 'cameras' is invalid or unsafe YAML")])
def test_what_cannot_be_chosen_is_rejected(given, error, what):
    with pytest.raises(error, match=what):
        choose(*given)


def test_a_camera_whose_name_no_topic_can_have_is_rejected_and_told(one_joint_arm):
    world = with_cameras(one_joint_arm, {'name': 'left eye'})
    with pytest.raises(ModelError, match="^the camera 'robot0_left eye' cannot have a topic: its "
                                         'name must consist of letters, digits and underscores, '
                                         'and not begin with a digit$'):
        choose('robot0_left eye', world=world)


def test_the_resolution_of_the_model_is_that_of_the_images_up_to_a_limit(one_joint_arm):
    world = with_cameras(one_joint_arm, {'name': 'small', 'resolution': [320, 1]},
                         {'name': 'vast', 'resolution': [100_000, 200]}, {'name': 'plain'})
    chosen = choose('robot0_small', 'robot0_vast', 'robot0_plain', world=world)
    sizes = {name: (images.width, images.height) for name, images in chosen.items()}
    assert sizes == {'robot0_small': (320, 1), 'robot0_vast': (MAX_PIXELS, 200),
                     'robot0_plain': (640, 480)}
