# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The world as a planner is told of it: shapes, poses, what moves, what a gripper holds."""

import mujoco
import numpy as np
import pytest

from manip_sim.simulation.planning_scene import PlanningScene

#: A robot of one link, a finger on each side of a ball, and what surrounds it.
WORLD = """
<mujoco><option gravity="0 0 0"/>
  <asset><mesh name="tetrahedron" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>
    <hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -1"/>
    <geom name="seen" type="box" size="1 1 1" contype="0" conaffinity="0"/>
    <body name="robot"><geom type="box" size=".1 .1 .1" pos="0 0 -.899"/>
      <body name="palm" pos="0 0 1" quat="1 0 0 1"><joint name="lift" type="slide" axis="0 0 1"/>
        <geom size=".01" mass="1"/>
        <body name="left" pos="0 .06 .1"><joint name="a" type="slide" axis="0 1 0"/>
          <geom type="box" size=".02 .01 .02"/></body>
        <body name="right" pos="0 -.06 .1"><joint name="b" type="slide" axis="0 -1 0"/>
          <geom size=".02"/></body>
      </body>
    </body>
    <body name="shelf" pos="2 0 0" quat="0 0 0 1">
      <geom type="capsule" size=".1 .3" euler="90 0 0"/>
      <geom type="cylinder" size=".1 .3" pos="0 .5 0"/>
      <geom type="mesh" mesh="tetrahedron" pos="0 0 3"/>
      <geom name="hills" type="hfield" hfield="hills" pos="0 0 9"/></body>
    <body name="ball" pos="0 0 1.1"><freejoint/><geom size=".03" mass=".2"/></body>
  </worldbody>
  <actuator><motor joint="a"/><motor joint="b"/></actuator>
</mujoco>"""


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(WORLD)


@pytest.fixture
def data(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture
def scene(model):
    return PlanningScene(model, 'robot', {'gripper': ('palm', 'left', 'right')})


def squeeze(model, data, left=-2.0, right=-2.0, steps=300):
    data.ctrl[:] = left, right
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)


def test_all_that_collides_and_is_not_the_robot_is_an_obstacle(scene):
    assert list(scene.obstacles) == ['arena', 'shelf', 'ball']
    assert [[solid.kind for solid in one.solids] for one in scene.obstacles.values()] == [
        ['box'], ['cylinder', 'sphere', 'sphere', 'cylinder', 'mesh'], ['sphere']]
    assert scene.obstacles['ball'].mass == pytest.approx(0.2)
    assert scene.left_out == ['hills']


def test_the_first_look_has_the_world_and_the_next_ones_what_has_moved(scene, model, data):
    changes = scene.look(data)
    assert {name: pose.round(9).tolist() for name, pose in changes.added.items()} == {
        'arena': [0, 0, 0, 0, 0, 0, 1], 'shelf': [2, 0, 0, 0, 0, 1, 0],
        'ball': [0, 0, 1.1, 0, 0, 0, 1]}
    for step_m, moved in ((0.004, []), (0.004, ['ball']), (0.004, [])):
        data.qpos[model.joint(3).qposadr[0]] += step_m
        mujoco.mj_forward(model, data)
        changes = scene.look(data)
        assert list(changes.moved) == moved
        assert not (changes.added or changes.attached or changes.detached)


def test_turning_counts_as_moving(scene, model, data):
    scene.look(data)
    address = model.joint(3).qposadr[0]
    for angle, moved in ((0.015, []), (0.03, ['ball'])):
        data.qpos[address + 3:address + 7] = np.cos(angle / 2), 0, 0, np.sin(angle / 2)
        mujoco.mj_forward(model, data)
        assert list(scene.look(data).moved) == moved


def test_surfaces_agree_with_the_rays_of_mujoco(scene, model, data):
    """From far away along an axis a ray of MuJoCo meets what is told of, where it is told."""
    shelf = scene.obstacles['shelf']
    cylinder, above, below, upright, mesh = shelf.solids
    # The body is turned by half a turn about z; the capsule lies along its y.
    assert (above.pose[:3] - below.pose[:3]).round(9).tolist() in ([0, 0.6, 0], [0, -0.6, 0])
    assert cylinder.dimensions == pytest.approx((0.6, 0.1))
    assert upright.dimensions == pytest.approx((0.6, 0.1))
    reach = mujoco.mj_ray(model, data, [2.0, 5.0, 0.0], [0.0, -1.0, 0.0], None, 1, -1,
                          np.zeros(1, dtype=np.int32))
    assert 5.0 - reach == pytest.approx(0.3 + above.dimensions[0])
    corners = mesh.triangles.reshape(-1, 3) @ np.asarray(_matrix(mesh.pose)).T + mesh.pose[:3]
    np.testing.assert_allclose(corners.min(axis=0), [0, 0, 3], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [1, 1, 4], atol=1e-6)


def _matrix(pose):
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.roll(pose[3:], 1))
    return matrix.reshape(3, 3)


def test_what_the_robot_stands_on_is_told_a_millimetre_away(scene):
    """The lowest point of the robot is 1 mm above the floor; another one would be at -1 m."""
    (floor,) = scene.obstacles['arena'].solids
    top = floor.pose[2] + floor.dimensions[2] / 2.0
    assert top == pytest.approx(-1.0, abs=1e-9)
    lower = mujoco.MjModel.from_xml_string(WORLD.replace('-.899', '-.9'))
    (floor,) = PlanningScene(lower, 'robot', {}).obstacles['arena'].solids
    assert floor.pose[2] + floor.dimensions[2] / 2.0 == pytest.approx(-1.001)


def test_two_fingers_that_press_on_it_from_both_sides_hold_an_object(scene, model, data):
    scene.look(data)
    squeeze(model, data)
    assert scene.look(data).attached == {}
    (name, hold), = scene.look(data).attached.items()
    assert (name, hold.link, hold.touch_links) == ('ball', 'palm', ('palm', 'left', 'right'))
    np.testing.assert_allclose(hold.pose, [0, 0, 0.1, 0, 0, -0.5 ** 0.5, 0.5 ** 0.5], atol=5e-3)
    assert not scene.look(data).attached
    assert 'ball' not in scene.poses(data)


def test_a_held_object_that_slips_is_attached_again(scene, model, data):
    squeeze(model, data)
    scene.look(data), scene.look(data)
    address = model.joint(3).qposadr[0]
    data.qpos[address + 1:address + 3] += 0.004, 0.01
    squeeze(model, data, steps=10)
    np.testing.assert_allclose(scene.look(data).attached['ball'].pose[[0, 2]], [0.004, 0.11],
                               atol=2e-3)


def test_an_object_that_is_let_go_is_detached_and_then_added(scene, model, data):
    squeeze(model, data)
    scene.look(data), scene.look(data)
    start = data.qpos.copy()
    squeeze(model, data, 0.5, 0.5, 100)
    data.qpos[model.joint(3).qposadr[0]:] = start[model.joint(3).qposadr[0]:]
    mujoco.mj_forward(model, data)
    assert [scene.look(data).detached for _ in range(3)] == [[], [], ['ball']]
    assert list(scene.look(data).added) == ['ball']


def test_an_object_that_is_gone_at_once_is_detached_at_once(scene, model, data):
    squeeze(model, data)
    scene.look(data), scene.look(data)
    data.qpos[model.joint(3).qposadr[0]] += 1.0
    mujoco.mj_forward(model, data)
    assert scene.look(data).detached == ['ball']


@pytest.mark.parametrize('forces', [(2.0, -2.0), (-2.0, 2.0)])
def test_a_finger_that_pushes_an_object_does_not_hold_it(forces, scene, model, data):
    scene.look(data)
    touched = False
    for _ in range(30):
        squeeze(model, data, *forces, 10)
        touched |= data.ncon > 0
        assert not scene.look(data).attached
    assert touched


def test_an_object_that_lies_on_both_fingers_is_not_held(scene, model, data):
    scene.look(data)
    data.qpos[:3] = 0.0, -0.035, -0.035
    data.qpos[model.joint(3).qposadr[0] + 2] = 1.143
    data.xfrc_applied[model.body('ball').id, 2] = -2.0
    for _ in range(5):
        squeeze(model, data, 0.0, 0.0, 2)
        pressing = {model.body(b).name for b in model.geom_bodyid[data.contact.geom].flat}
        assert pressing == {'left', 'right', 'ball'}
        assert not scene.look(data).attached
