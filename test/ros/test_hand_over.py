# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Three arms hand a cube over; a controller in another process knows them by their topics."""

from itertools import groupby
import re

from geometry_msgs.msg import PoseStamped
from harness import DOMAIN, Served
import numpy as np
import pytest
import rclpy
from rclpy.parameter import parameter_dict_from_yaml_file
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from manip_sim.physics.poses_and_twists import Pose
from manip_sim.resources import share_directory

EXAMPLE = 'manip_sim.examples'
CONFIG = share_directory() / 'config' / 'hand_over.yaml'
GOAL = (-0.05, -0.5, 0.825)
ARMS = ('left', 'middle', 'right')


@pytest.fixture(scope='module')
def served():
    """Return a running node with the parameters that are shipped."""
    parameters = {name: rclpy.parameter.parameter_value_to_python(parameter.value)
                  for name, parameter in parameter_dict_from_yaml_file(
                      str(CONFIG), use_wildcard=True).items()}
    served = Served({**parameters, 'real_time_factor': 4.0})
    yield served
    served.close()


@pytest.fixture
def node(served, client):
    """Return the node at its start."""
    assert client.call(Trigger, 'manip_sim/reset').success
    return served.node


@pytest.fixture
def touches(node):
    """Return a list that is filled with what touches what: pairs of arm, ``cube`` or ``table``."""
    model, seen = node.simulation.model, []
    whose = [next((name for name in (*ARMS, 'cube', 'table') if
                   model.body(body).name.startswith(name)), '') for body in model.geom_bodyid]

    def look(simulation):
        pairs = {frozenset((whose[c.geom1], whose[c.geom2])) for c in simulation.data.contact}
        seen.append({pair for pair in pairs if len(pair) == 2 and '' not in pair})
    node.thread.observe(look)
    return seen


def place_cube(node, position, yaw=0.0):
    pose = Pose(np.array(position), np.array([0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0)]))
    simulation = node.simulation
    node.thread.call(lambda: simulation.entities.place(simulation.data, 'cube', pose, None))


def finish(client, controller):
    client.spin_until(lambda: controller.poll() is not None)
    return controller.communicate(timeout=300.0)


def distance_from_goal(poses):
    position = poses[-1].pose.position
    return np.linalg.norm(np.subtract((position.x, position.y, position.z), GOAL))


@pytest.mark.full
def test_the_cube_gets_from_the_first_arm_to_the_third_and_none_lets_go_too_early(
        node, touches, process, client):
    poses = client.listen(PoseStamped, 'objects/cube/pose')
    place_cube(node, (0.05, 0.6, 0.826), yaw=0.4)
    controller = process('hand_over', module=EXAMPLE)
    output, errors = finish(client, controller)
    assert controller.returncode == 0, output + errors
    assert 'done: the cube stands at' in output
    assert distance_from_goal(poses) < 0.01
    assert max(pose.pose.position.z for pose in poses) > 1.39
    assert [word for word, _ in groupby(re.findall(r'(\w+) holds the cube', output))] == [*ARMS]
    holders = [frozenset(arm for arm in ARMS if {arm, 'cube'} in pairs) for pairs in touches]
    # A finger that touches first or last for an instant is no grasp.
    lasting = [held for held, times in groupby(holders) if len(list(times)) >= 10]
    assert [set(held) for held, _ in groupby(lasting)] == [
        set(), {'left'}, {'left', 'middle'}, {'middle'}, {'middle', 'right'}, {'right'}, set()]
    assert not set().union(*touches) - {frozenset((arm, 'cube')) for arm in ARMS} - {
        frozenset(('cube', 'table'))}


@pytest.mark.full
def test_a_gripper_that_does_not_close_is_told(node, process, client):
    # The example's commands for this gripper arrive here and nowhere else.
    client.node.create_subscription(Float64MultiArray, 'unplugged', lambda _: None, 1)
    controller = process('hand_over', '--ros-args', '-r',
                         'middle/right/gripper/command:=unplugged', module=EXAMPLE)
    _, errors = finish(client, controller)
    assert controller.returncode == 1
    assert 'hand_over: the gripper of middle does not close' in errors


@pytest.mark.full
def test_a_cube_that_is_lost_on_the_way_is_told(node, process, client):
    poses = client.listen(PoseStamped, 'objects/cube/pose')
    controller = process('hand_over', module=EXAMPLE)
    client.spin_until(lambda: poses and poses[-1].pose.position.z > 1.0)
    place_cube(node, (-0.05, 0.5, 0.826))
    _, errors = finish(client, controller)
    assert controller.returncode == 1
    assert 'the cube is not held by left: it is at (-0.0' in errors


@pytest.mark.full
def test_an_arm_that_does_not_move_is_told(node, process, client):
    robot = node.simulation.robots['left']
    node.thread.call(lambda: robot.set_control_mode('arm', 'velocity'))
    controller = process('hand_over', module=EXAMPLE)
    _, errors = finish(client, controller)
    node.thread.call(lambda: robot.set_control_mode('arm', 'position'))
    assert controller.returncode == 1
    assert 'left does not reach its goal: its joints are off by' in errors


def test_a_cube_that_does_not_stand_at_the_goal_is_told():
    from manip_sim.examples.demonstration import TaskFailed
    from manip_sim.examples.hand_over import CUBE, HandOverDemonstration
    rclpy.init(domain_id=DOMAIN)
    task = HandOverDemonstration()
    try:
        pose = PoseStamped()
        pose.pose.position.z = 0.825
        task.latest[CUBE] = pose
        task.wait = lambda _: None
        with pytest.raises(TaskFailed, match=r'the cube is at .*, 0\.502 m from the goal'):
            task._check_goal()
    finally:
        task.destroy_node()
        rclpy.shutdown()
