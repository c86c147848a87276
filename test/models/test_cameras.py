# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cameras beside those of robots: where they look, and descriptions that cannot be used."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose, create_arena, World
from manip_sim.models.cameras import create_camera, ImageSettings


def seen_by(world, name):
    """Return a camera's place, its view and its up in the world, at the start."""
    model = world.compile()
    data = mujoco.MjData(model)
    for joint, position in world.init_qpos().items():
        data.joint(joint).qpos = position
    mujoco.mj_forward(model, data)
    axes = data.camera(name).xmat.reshape(3, 3)
    return data.camera(name).xpos, -axes[:, 2], axes[:, 1]


def a_world(*cameras):
    return World([], cameras=[{'name': 'front', **camera} for camera in cameras])


def test_a_camera_looks_at_the_point_that_is_named_with_the_vertical_up():
    position, point = np.array([1.5, -0.4, 1.6]), np.array([0.1, 0.2, 0.8])
    place, view, up = seen_by(
        a_world({'position': position.tolist(), 'look_at': point.tolist()}), 'front')
    np.testing.assert_allclose(place, position)
    np.testing.assert_allclose(view, (point - position) / np.linalg.norm(point - position))
    assert up[2] > 0.7
    assert np.cross(view, up)[2] == pytest.approx(0.0, abs=1e-12)


def test_a_camera_that_looks_straight_down_has_x_up():
    _, view, up = seen_by(a_world({'position': [0.3, 0.1, 2.0], 'look_at': [0.3, 0.1, 0.0]}),
                          'front')
    np.testing.assert_allclose(view, [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(up, [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize('turn, view, up', [
    ({}, [1, 0, 0], [0, 0, 1]),
    ({'rpy': [0.0, 0.0, np.pi / 2]}, [0, 1, 0], [0, 0, 1]),
    ({'rpy': [0.0, np.pi / 2, 0.0]}, [0, 0, -1], [1, 0, 0]),
    ({'rpy': [np.pi / 2, 0.0, 0.0]}, [1, 0, 0], [0, -1, 0]),
    ({'quat_xyzw': [0.0, 0.0, 0.5**0.5, 0.5**0.5]}, [0, 1, 0], [0, 0, 1])],
    ids=['nothing', 'yaw', 'pitch', 'roll', 'quaternion'])
def test_without_a_turn_a_camera_looks_along_x_with_z_up(turn, view, up):
    _, found_view, found_up = seen_by(a_world(turn), 'front')
    np.testing.assert_allclose(found_view, view, atol=1e-12)
    np.testing.assert_allclose(found_up, up, atol=1e-12)


def test_a_camera_moves_with_its_body(panda):
    world = World([panda], cameras=[
        {'name': 'wrist', 'body': 'robot0_right_hand', 'position': [0.1, 0.0, 0.05]}])
    model = world.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = np.linspace(-0.5, 0.5, model.nq)
    mujoco.mj_forward(model, data)
    hand = data.body('robot0_right_hand')
    axes = hand.xmat.reshape(3, 3)
    np.testing.assert_allclose(data.camera('wrist').xpos, hand.xpos + axes @ [0.1, 0.0, 0.05])
    np.testing.assert_allclose(-data.camera('wrist').xmat.reshape(3, 3)[:, 2], axes[:, 0])


def test_size_rate_and_field_of_view_are_those_of_the_description():
    camera = create_camera({'name': 'a', 'fovy': 60, 'width': 320, 'height': 240, 'rate': 5,
                            'depth': False})
    assert camera.images == ImageSettings(320, 240, 5.0, False)
    assert create_camera({'name': 'a'}).images == ImageSettings()
    assert World([], cameras=[camera]).compile().camera('a').fovy[0] == 60.0


def test_the_mjcf_of_a_world_has_its_cameras():
    model = mujoco.MjModel.from_xml_string(a_world({'position': [0.0, 0.0, 2.0]}).to_xml())
    assert model.camera('front').pos[2] == 2.0


@pytest.mark.parametrize('description, what', [
    ({}, "^camera without a name: needs 'name'$"),
    ({'name': 'a b'}, "^camera: 'a b' cannot be the name of a camera and its topics: it needs a"),
    ({'name': 'a', 'positon': [0, 0, 1]}, "camera 'a': unknown key 'positon': did you mean "
     "'position'"),
    ({'name': 'a', 'position': [0, 0]}, "'position' must have at least 3 of them"),
    ({'name': 'a', 'position': [0, 0, float('nan')]}, r"'position'\[2\] must be .* got nan"),
    ({'name': 'a', 'look_at': ['x', 0, 0]}, r"'look_at'\[0\] must be a number, got 'x'"),
    ({'name': 'a', 'look_at': [0, 0, 0]}, "'look_at' must not be where the camera is"),
    ({'name': 'a', 'look_at': [1, 0, 0], 'rpy': [0, 0, 0]}, "give 'look_at', 'rpy' or 'quat"),
    ({'name': 'a', 'quat_xyzw': [0, 0, 0, 2]}, 'of length 1, got'),
    ({'name': 'a', 'fovy': 0.8}, "'fovy' must be at least 1, got 0.8"),
    ({'name': 'a', 'fovy': 180}, "'fovy' must be at most 170, got 180"),
    ({'name': 'a', 'width': 0}, "'width' must be at least 1, got 0"),
    ({'name': 'a', 'height': 4097}, "'height' must be at most 4096, got 4097"),
    ({'name': 'a', 'width': 3.5}, "'width' must be a whole number, got 3.5"),
    ({'name': 'a', 'rate': 0}, "'rate' must be at least 0.01, got 0"),
    ({'name': 'a', 'rate': float('inf')}, "'rate' must be "),
    ({'name': 'a', 'depth': 'yes'}, "'depth' must be true or false, got 'yes'")], ids=str)
def test_a_description_that_cannot_be_used_is_told_on_one_line(description, what):
    with pytest.raises(ModelError, match=what) as error:
        create_camera(description)
    assert '\n' not in str(error.value)


def test_a_camera_on_an_unknown_body_is_told_the_nearest(panda):
    world = World([panda], cameras=[{'name': 'wrist', 'body': 'right_hand'}])
    with pytest.raises(UnknownNameError, match="unknown body of the camera 'wrist' 'right_hand': "
                                               "did you mean 'robot0_right_hand'"):
        world.compile()


@pytest.mark.parametrize('name, kind', [
    ('robot0_eye_in_hand', 'camera'), ('robot0_right_hand', 'body'), ('front', 'camera')])
def test_a_camera_with_a_name_that_is_taken_is_rejected(panda, name, kind):
    world = World([panda], cameras=[{'name': 'front'}, {'name': name}])
    with pytest.raises(ModelError, match=f"camera '{name}': there is a {kind} of this name"):
        world.compile()


@pytest.mark.parametrize('arena', ['empty', 'table', 'bins'])
def test_arenas_have_the_cameras_of_the_reference(arena):
    assert set(create_arena(arena).cameras) == {'frontview', 'birdview', 'agentview', 'sideview'}


@pytest.mark.parametrize('arena, parameter, usual', [
    ('table', 'table_height', 0.8), ('bins', 'bin_height', 0.82)])
def test_the_cameras_of_an_arena_are_as_high_above_its_furniture(arena, parameter, usual):
    usual_height = create_arena(arena).compile().camera('agentview').pos[2]
    lower = create_arena(arena, **{parameter: 0.5}).compile().camera('agentview').pos[2]
    assert lower == pytest.approx(usual_height - (usual - 0.5))


@pytest.mark.parametrize(('what', 'descriptions'), [
    ('camera', ['frontview']), ('camera', [None]), ('lidar', [1])])
def test_what_is_no_description_is_rejected_with_an_example(what, descriptions):
    with pytest.raises(ModelError, match=f'^{what} without a name: must be keys with values, such '
                       "as {'name': ...}, got "):
        compose('Panda', **{f'{what}s': descriptions})


@pytest.mark.parametrize('descriptions', [[1], [None], [['a']]])
def test_what_is_no_object_is_rejected_with_what_can_be(descriptions):
    with pytest.raises(ModelError, match='^an object must be keys with values, such as '
                       "{'name': ...}, or the path of a file, got "):
        compose('Panda', objects=descriptions)


@pytest.mark.parametrize(('keyword', 'value'), [
    ('cameras', {'name': 'front'}), ('lidars', 'front'), ('objects', b'x'),
    ('objects', {'name': 'a'})])
def test_what_is_no_list_is_rejected(keyword, value):
    with pytest.raises(ModelError, match=f'^{keyword} must be a list, got '):
        compose('Panda', **{keyword: value})
