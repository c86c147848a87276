# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The channels of cameras: which there are, and what their messages hold."""

import io

import numpy as np
from PIL import Image
import pytest

from manip_sim.channels.contents import image_channels
from manip_sim.interface.topics import CAMERA, TOPICS
from manip_sim.rendering import Intrinsics

FOUND = Intrinsics(width=4, height=2, fx=2.0, fy=3.0, cx=1.5, cy=0.5)
HEAD = {'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': 'eye'}


@pytest.fixture
def make():
    """Return a function that makes the message of a topic of the camera."""
    found = {channel.topic.name: channel for channel in image_channels('eye', FOUND, True)}
    return lambda topic, *parts: found[f'eye/{topic}'].make(HEAD, *parts)


@pytest.mark.parametrize('depth', [True, False])
def test_each_topic_of_images_of_the_table_has_a_channel(depth):
    expected = {row.filled_in('eye') for row in TOPICS if row.per == CAMERA
                and row.type != 'std_msgs/String' and (depth or row.needs != 'depth')}
    assert {channel.topic for channel in image_channels('eye', FOUND, depth)} == expected


def test_intrinsics_project_a_point_onto_the_pixel_where_it_is_seen(make):
    message = make('color/camera_info')
    u, v, w = np.reshape(message['p'], (3, 4)) @ [1.0, -0.5, 2.0, 1.0]
    assert (u / w, v / w) == (1.5 + 2.0 * 0.5, 0.5 - 3.0 * 0.25)
    np.testing.assert_array_equal(np.reshape(message['k'], (3, 3)),
                                  np.reshape(message['p'], (3, 4))[:, :3])
    assert (message['width'], message['height'], message['header']) == (4, 2, HEAD)


def test_colours_are_bytes_by_row_and_a_jpeg_of_them_shows_the_same(make):
    rgb = np.zeros((2, 4, 3), np.uint8)
    rgb[:, 2:] = 200
    message = make('color/image_raw', rgb)
    assert (message['encoding'], message['step'], message['height']) == ('rgb8', 12, 2)
    assert bytes(message['data']) == rgb.tobytes()
    shown = np.asarray(Image.open(io.BytesIO(make('color/image_raw/compressed', rgb)['data'])))
    assert shown.shape == rgb.shape and abs(shown.astype(int) - rgb).max() < 20


def test_depth_and_labels_have_the_encodings_of_their_numbers(make):
    for topic, kind, encoding in (('depth', np.float32, '32FC1'), ('labels', np.int32, '32SC1')):
        message = make(f'{topic}/image_raw', np.arange(8, dtype=kind).reshape(2, 4))
        assert (message['encoding'], message['step'], message['width']) == (encoding, 16, 4)
        np.testing.assert_array_equal(np.frombuffer(message['data'], kind), np.arange(8))


def test_points_are_where_the_intrinsics_see_them_and_nan_for_nothing(make):
    depth = np.full((2, 4), 2.0, np.float32)
    depth[0, 0] = np.inf
    rgb = np.zeros((2, 4, 3), np.uint8)
    rgb[1, 3] = 10, 20, 30
    message = make('depth/points', depth, rgb)
    points = np.frombuffer(message['data'], np.float32).reshape(2, 4, 4)
    assert np.isnan(points[0, 0, :3]).all()
    np.testing.assert_allclose(points[1, 3, :3], [2.0 * 1.5 / 2.0, 2.0 * 0.5 / 3.0, 2.0])
    assert points[1, 3, 3:].tobytes() == bytes([30, 20, 10, 0])
    white = np.frombuffer(make('depth/points', depth, None)['data'], np.uint8).reshape(2, 4, 16)
    assert (white[..., 12:15] == 255).all()
