# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where cameras stand, so that pictures are filled: by projection of the points that are shown."""

import mujoco
import numpy as np
import pytest

from manip_sim.cli.render import cameras, View
from manip_sim.errors import UnknownNameError

#: Far from square, and not in the middle of the world [m].
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [1.2, 0.2, 0.5], [0.3, -0.2, 1.1]])
FRONT_AND_SIDE = (View(200.0, -20.0), View(110.0, -5.0))


@pytest.fixture(scope='module')
def model():
    return mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><camera name="eye" pos="1 0 0"/></worldbody></mujoco>')


def projected(model, camera, aspect):
    """Return where the points are in the picture, from -1 to 1, by MuJoCo's own camera."""
    scene = mujoco.MjvScene(model, maxgeom=10)
    mujoco.mjv_updateScene(model, mujoco.MjData(model), mujoco.MjvOption(), None, camera,
                           mujoco.mjtCatBit.mjCAT_ALL, scene)
    eye = scene.camera[0]
    forward, up = np.array(eye.forward), np.array(eye.up)
    seen = POINTS - (np.array(scene.camera[0].pos) + np.array(scene.camera[1].pos)) / 2.0
    tangent = eye.frustum_top / eye.frustum_near
    at = np.stack([seen @ np.cross(forward, up) / aspect, seen @ up])
    return at / (seen @ forward) / tangent


@pytest.mark.parametrize('aspect', [0.5, 1.0, 3.0])
def test_all_points_are_in_both_pictures_in_the_middle_and_one_picture_is_filled(aspect, model):
    found = cameras(FRONT_AND_SIDE, model, POINTS, aspect)
    reach = []
    for camera in found:
        at = projected(model, camera, aspect)
        assert np.allclose(at.min(axis=1), -at.max(axis=1), atol=1e-3)
        reach.append(np.abs(at).max())
    assert max(reach) == pytest.approx(1 / 1.05, abs=1e-3)


def test_both_sides_are_seen_from_the_same_distance(model):
    one, other = cameras(FRONT_AND_SIDE, model, POINTS, 0.7)
    assert one.distance == other.distance
    alone = [cameras([view], model, POINTS, 0.7)[0].distance for view in FRONT_AND_SIDE]
    assert alone[0] != pytest.approx(alone[1], rel=0.05)
    assert one.distance == max(alone)


def test_a_camera_of_the_model_is_taken_by_its_name(model):
    assert cameras([View(camera='eye')], model, POINTS, 1.0) == ['eye']
    with pytest.raises(UnknownNameError, match="unknown camera 'ear': available: eye"):
        cameras([View(camera='ear')], model, POINTS, 1.0)
