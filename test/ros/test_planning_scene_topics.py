# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The planning scene over DDS, with subscriptions as those of MoveIt's PlanningSceneMonitor."""

import importlib
import importlib.util
import re
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from rclpy.qos import qos_profile_services_default
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
import yaml

from manip_sim.models.object_creation import create_object
from manip_sim.models.urdf_writer import urdf_of
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.ros import visualization_topics
from manip_sim.simulation.planning_scene import BOX, MESH, Obstacle, Solid

needs_moveit_msgs = pytest.mark.skipif(
    importlib.util.find_spec('moveit_msgs') is None,
    reason='the optional package moveit_msgs is not installed')
BALL = '{name: ball, shape: sphere, size: 0.05, mass: 0.2, position: [0.9, 0.0, 0.05]}'
PART = '{name: part, shape: box, size: [0.04, 0.04, 0.04], mass: 0.05}'


class Planner:
    """What MoveIt makes of the messages, by its rules for the operations."""

    def __init__(self, client, namespace=''):
        messages = importlib.import_module('moveit_msgs.msg')
        self.world, self.attached, self.problems = {}, {}, []
        self.messages, self.client = messages, client
        for kind, topic, take in (
                ('PlanningSceneWorld', 'planning_scene_world', self._take_world),
                ('CollisionObject', 'collision_object', self._take_object),
                ('AttachedCollisionObject', 'attached_collision_object', self._take_attached)):
            client.node.create_subscription(getattr(messages, kind), namespace + topic, take,
                                            qos_profile_services_default)

    def _take_world(self, world):
        self.world.clear()
        for message in world.collision_objects:
            self._take_object(message)

    def _take_object(self, message):
        kind = self.messages.CollisionObject
        if message.operation == kind.ADD:
            assert message.primitives or message.meshes
            self.world[message.id] = message
        elif message.id not in self.world:
            self.problems.append(f'{message.id} is not there')
        elif message.operation == kind.MOVE:
            assert not (message.primitives or message.meshes)
            self.world[message.id].pose = message.pose
        else:
            del self.world[message.id]

    def _take_attached(self, message):
        if message.object.operation == self.messages.CollisionObject.ADD:
            self.world.pop(message.object.id, None)
            self.attached[message.object.id] = message
        elif message.object.id in self.attached:
            held = self.attached.pop(message.object.id)
            self.world.setdefault(held.object.id, held.object)

    def height(self, name):
        return self.world[name].pose.position.z


@pytest.fixture
def planner(client):
    return lambda namespace='': Planner(client, namespace)


def test_the_shapes_of_an_obstacle_are_primitives_or_meshes(monkeypatch):
    def message(**fields):
        return SimpleNamespace(header=SimpleNamespace(), primitives=[], primitive_poses=[],
                               meshes=[], mesh_poses=[], **fields)
    message.ADD = b'\0'
    monkeypatch.setattr(visualization_topics, 'moveit_msgs',
                        SimpleNamespace(CollisionObject=message))
    places = np.arange(14.0).reshape(2, 7)
    added = visualization_topics._added(Obstacle('part', 1, (
        Solid(BOX, (0.1, 0.2, 0.3), places[0]), Solid(MESH, (), places[1], np.eye(3)[None])), 1.0),
        'world', places[0], None)
    assert [(shape.type, list(shape.dimensions)) for shape in added.primitives] == [
        (SolidPrimitive.BOX, [0.1, 0.2, 0.3])]
    assert [len(mesh.vertices) for mesh in added.meshes] == [3]
    assert (added.primitive_poses[0].position.x, added.mesh_poses[0].position.x) == (0.0, 7.0)


@needs_moveit_msgs
def test_a_planner_that_comes_later_is_told_of_arena_and_objects(serve, client, planner):
    serve(arena='table')
    client.state()
    for _ in range(2):
        told = planner()
        client.spin_until(lambda told=told: told.world)
        assert set(told.world) == {'arena', 'table', 'cube'} and not told.attached
        table = told.world['table']
        assert table.header.frame_id == 'world'
        (top,), (place,) = table.primitives, table.primitive_poses
        # As high as the arena says; what the robot's mount touches is 1 mm smaller.
        assert table.pose.position.z + place.position.z + top.dimensions[2] / 2.0 == \
            pytest.approx(0.8, abs=1.1e-3)
        assert told.height('cube') == pytest.approx(0.825, abs=1e-3)
        assert not told.problems


@needs_moveit_msgs
def test_several_robots_have_a_scene_each_with_the_other_one_in_it(serve, client, planner):
    serve(robots=['a', 'b'], a__robot='Panda', b__robot='UR5e', b__position=[0.0, 1.5, 0.0])
    scenes = {name: planner(f'{name}/') for name in 'ab'}
    client.spin_until(lambda: all(scene.world for scene in scenes.values()))
    for name, other in ('ab', 'ba'):
        assert any(one.startswith(other) for one in scenes[name].world)
        assert not any(one.startswith(f'{name}_') for one in scenes[name].world)


@needs_moveit_msgs
def test_objects_that_fall_come_and_go_are_told(serve, client, planner):
    node = serve(objects=[BALL.replace('0.05]', '1.0]')])
    told = planner()
    client.spin_until(lambda: 'ball' in told.world and told.height('ball') < 0.06)
    simulation = node.simulation
    box = create_object(yaml.safe_load('{name: box, shape: box, size: [0.1, 0.2, 0.3], '
                                       'mass: 1.0, position: [0.9, 0.9, 0.2]}'))
    start = simulation.plan
    for plan, names in ((plan_with(start, box), {'arena', 'ball', 'box'}),
                        (start, {'arena', 'ball'})):
        node.thread.call(lambda plan=plan: simulation.change_objects(plan))
        node.executor.create_task(node.shared.world_changed)
        client.spin_until(lambda names=names: set(told.world) == names)


def grasp(node, client):
    """Close the gripper on a weightless object that is placed between the fingers."""
    simulation = node.simulation
    model, data = simulation.model, simulation.data
    body, grip_site = model.body('part'), simulation.robot.end_effectors['right'].grip_site

    def place():
        address = model.jnt_qposadr[body.jntadr[0]]
        model.body_gravcomp[body.id] = 1.0
        data.qpos[address:address + 3] = data.site(grip_site).xpos
        mujoco.mju_mat2Quat(data.qpos[address + 3:address + 7], data.site(grip_site).xmat)

    node.thread.call(place)
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    assert client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=False)).success


@needs_moveit_msgs
def test_what_the_fingers_hold_is_attached_until_they_let_go(serve, client, planner):
    node = serve(objects=[PART], start_paused=True)
    told, data = planner(), node.simulation.data
    grasp(node, client)
    client.spin_until(lambda: 'part' in told.attached)
    assert 'part' not in told.world
    held = told.attached['part']
    urdf = urdf_of(node.simulation.world, node.simulation.robot.name).xml
    assert held.object.header.frame_id == held.link_name
    assert {held.link_name} < set(held.touch_links) <= set(
        re.findall('<link name="([^"]+)"', urdf))
    assert held.weight == pytest.approx(0.05)
    link, part = data.body(held.link_name), data.body('part')
    at = held.object.pose.position
    np.testing.assert_allclose(
        [at.x, at.y, at.z], link.xmat.reshape(3, 3).T @ (part.xpos - link.xpos), atol=5e-3)
    client.publish('right/gripper/command', Float64MultiArray(data=[-1.0]))
    client.spin_until(lambda: not told.attached and told.world.get('part') is not None
                      and told.world['part'].header.frame_id == 'world')


@needs_moveit_msgs
def test_a_held_object_that_is_deleted_is_neither_attached_nor_in_the_world(
        serve, client, planner):
    node = serve(objects=[PART], start_paused=True)
    told, simulation = planner(), node.simulation
    grasp(node, client)
    client.spin_until(lambda: 'part' in told.attached)
    without = plan_without(simulation.plan, 'part')
    node.thread.call(lambda: simulation.change_objects(without))
    client.spin_until(lambda: not told.attached and set(told.world) == {'arena'})


@needs_moveit_msgs
def test_messages_agree_with_the_physics_while_the_arm_works(serve, client, planner):
    """A cube that is pushed about is told of within the thresholds, when it lies still."""
    node = serve(arena='table')
    told, simulation = planner(), node.simulation
    client.spin_until(lambda: 'cube' in told.world)

    def push():
        simulation.data.joint('cube_joint').qvel[:2] = 0.4, 0.2
    start = simulation.data.body('cube').xpos.copy()
    node.thread.call(push)
    client.spin_until(lambda: np.linalg.norm(simulation.data.body('cube').xpos - start) > 0.01
                      and not np.any(np.abs(simulation.data.joint('cube_joint').qvel) > 1e-4))

    def error():
        at = told.world['cube'].pose.position
        return np.linalg.norm(simulation.data.body('cube').xpos - [at.x, at.y, at.z])
    client.spin_until(lambda: error() <= 0.005)
    assert not told.problems


def test_a_mesh_has_each_corner_once_and_the_same_triangles():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]],
                       dtype=float)
    mesh = visualization_topics._mesh(Solid(MESH, (), np.zeros(7), corners))
    assert len(mesh.vertices) == 4
    again = [[(mesh.vertices[i].x, mesh.vertices[i].y, mesh.vertices[i].z)
              for i in triangle.vertex_indices] for triangle in mesh.triangles]
    np.testing.assert_array_equal(again, corners)
