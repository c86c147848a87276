# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names of bodies do not overlap, as each browser sees them."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')
pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, strategies as st  # noqa: E402
import mujoco  # noqa: E402

from manip_sim.models import compose  # noqa: E402
from manip_sim.viewer.page.model_scene import (  # noqa: E402
    _LINE, arrange, BodyLabels, FIELD_OF_VIEW, first_view, Kinematics)

HEIGHT = 800


def overlapping(places, widths):
    return [(i, j) for i in range(len(places)) for j in range(i)
            if places[i, 0] < places[j, 0] + widths[j] and places[j, 0] < places[i, 0] + widths[i]
            and abs(places[i, 1] - places[j, 1]) < _LINE - 1e-6]


@given(st.lists(st.tuples(st.floats(0, 300), st.floats(0, 300), st.floats(1, 200)), max_size=25))
def test_labels_are_moved_apart_along_y_alone(boxes):
    numbers = np.array(boxes).reshape(-1, 3)
    corners, widths = numbers[:, :2], numbers[:, 2]
    places = arrange(corners, widths)
    assert overlapping(places, widths) == []
    np.testing.assert_array_equal(places[:, 0], corners[:, 0])
    if not overlapping(corners, widths):
        np.testing.assert_array_equal(places, corners)


class Label(SimpleNamespace):
    """A label of a browser."""

    removed = False

    def remove(self):
        self.removed = True


def look(camera, position, look_at):
    """Aim a camera, with the rotation that viser gives it."""
    forward = look_at - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera.rotation = np.stack([right, np.cross(forward, right), forward])
    camera.position, camera.wxyz = position, np.empty(4)
    mujoco.mju_mat2Quat(camera.wxyz, camera.rotation.T.flatten())


def client_of(position, look_at):
    labels = []
    scene = SimpleNamespace(add_label=lambda name, text, **_: labels.append(
        Label(text=text)) or labels[-1])
    camera = SimpleNamespace(fov=FIELD_OF_VIEW, image_height=HEIGHT)
    look(camera, position, look_at)
    return SimpleNamespace(labels=labels, scene=scene, camera=camera)


def pixels(client):
    """Return where the labels of a client are in its picture, by a matrix of its camera."""
    seen = np.array([label.position for label in client.labels]) - client.camera.position
    x, y, depth = client.camera.rotation @ seen.T
    return np.stack([x, y], axis=1) / depth[:, None] * HEIGHT / (2.0 * np.tan(FIELD_OF_VIEW / 2))


@pytest.mark.parametrize('robot', ['Panda', 'GR1'])
def test_names_of_a_robot_do_not_overlap_in_any_browser(robot):
    posture = Kinematics(compose(robot, arena='table').compile())
    home = first_view(posture.model, posture.data, 1.6)
    clients = {1: client_of(*home), 2: client_of(home[0] * [-1.0, 1.0, 2.0], home[1])}
    labels = BodyLabels(SimpleNamespace(get_clients=lambda: clients), posture.model)
    labels.update(0.0, posture)
    assert not clients[1].labels
    labels.show(True)
    labels.update(1.0, posture)
    for client in clients.values():
        places = pixels(client)
        widths = np.array([5.8 * len(label.text) for label in client.labels])
        assert overlapping(places, widths) == []
    # One browser turns its view, another one goes.
    turned = clients[1].labels
    look(clients[1].camera, home[0] * [1.0, -1.0, 1.5], home[1])
    del clients[2]
    labels.update(2.0, posture)
    assert clients[1].labels is turned
    assert overlapping(pixels(clients[1]), widths) == []
    labels.show(False)
    assert all(label.removed for label in turned)
