# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What parameters change in the physics and its pace, at the start and while the node runs."""

import json

from geometry_msgs.msg import PoseStamped, WrenchStamped
import mujoco
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

ARM = [f'robot0_joint{n}' for n in range(1, 8)]


def published_model(client):
    """Return the model that the node publishes."""
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    xml = client.listen(String, '/manip_sim/mjcf', latched)
    client.spin_until(lambda: bool(xml))
    return mujoco.MjModel.from_xml_string(xml[0].data)


def set_live(client, name, value):
    """Change a parameter as ``ros2 param set`` does."""
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    (result,) = client.call(SetParameters, 'manip_sim/set_parameters', request).results
    assert result.successful, result.reason


def steps(node, count):
    for _ in range(count):
        node.thread.step()


@pytest.mark.full
@pytest.mark.parametrize('compensated', [True, False])
def test_an_arm_without_effort_falls_unless_gravity_is_compensated(compensated, serve, client):
    node = serve(start_paused=True, control_mode__arm='effort', gravity_compensation=compensated)
    start = node.simulation.robot.state().position[:7]
    client.publish('arm/joint_command', JointState(name=ARM, effort=[0.0] * 7))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    steps(node, 50)
    moved = np.abs(node.simulation.robot.state().position[:7] - start).max()
    if compensated:
        assert moved < 1e-3
    else:
        # Half a second of free fall of a link of half a metre.
        assert moved > 0.5
    model = published_model(client)
    assert model.body_gravcomp[model.body('robot0_link5').id] == compensated


def test_static_friction_holds_a_joint_and_is_reported(serve, client):
    node = serve(start_paused=True, control_mode__arm='effort',
                 friction__arm='{coulomb: 0.5, static: 1.0, stribeck_velocity: 0.1}',
                 armature__arm='[0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.3]')
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    told = client.listen(String, 'manip_sim/dynamics', latched)
    client.spin_until(lambda: bool(told))
    (joint,) = [dynamics for name, dynamics in json.loads(told[0].data)['joints'].items()
                if name == 'robot0_joint7']
    assert (joint['armature'], joint['friction_loss'], joint['static_friction']) == (0.3, 0.5, 1.0)
    velocities = []
    for count, effort in enumerate((0.97, 1.03), 1):
        client.publish('arm/joint_command', JointState(name=[ARM[-1]], effort=[effort]))
        client.spin_until(
            lambda count=count: node.commands.robots[0].statistics['arm'].accepted == count)
        steps(node, 10)
        velocities.append(abs(node.simulation.robot.state().velocity[6]))
    assert velocities[0] < 1e-6 < 0.005 < velocities[1]


@pytest.mark.full
@pytest.mark.parametrize('cube', [True, False])
def test_the_cube_lies_on_the_table_where_it_is_wanted(cube, serve, client):
    serve(arena='table', cube=cube)
    model = published_model(client)
    bodies = {model.body(index).name for index in range(model.nbody)}
    assert 'table' in bodies
    assert ('cube' in bodies) == cube


def test_the_timestep_is_that_of_the_physics_and_the_stamps(serve, client):
    node = serve(timestep=0.0005, publish_rate=200.0)
    clock = client.listen(Clock, '/clock')
    client.spin_until(lambda: len(clock) > 20)
    stamps = [tick.clock.sec * 10**9 + tick.clock.nanosec for tick in clock]
    assert set(np.diff(stamps)) == {5_000_000}
    assert node.simulation.model.opt.timestep == published_model(client).opt.timestep == 0.0005
    node.thread.pause(True)
    before = node.simulation.data.time
    node.thread.step()
    # MuJoCo's own time, not that which is counted.
    assert node.simulation.data.time - before == pytest.approx(0.005, abs=1e-9)


def test_the_real_time_factor_changes_while_the_node_runs(serve, client):
    node = serve(publish_rate=20.0, real_time_factor=0.1)
    clock = client.listen(Clock, '/clock')
    client.spin_until(lambda: bool(clock))
    # A period took 0.5 s of wall time, and takes 5 ms now.
    set_live(client, 'real_time_factor', 10.0)
    before = len(clock)
    waits, wait = [], node.thread._inbox.wait
    node.thread._inbox.wait = lambda timeout_s: (waits.append(timeout_s), wait(timeout_s))
    client.spin_until(lambda: len(clock) > before + 50)
    assert max(waits, default=0.0) <= 0.0051
    assert node.thread.real_time_factor == 10.0


def test_the_cutoff_of_a_wrench_changes_while_the_node_runs(serve, client):
    node = serve(start_paused=True, wrench_cutoff__right=1.0)
    wrenches = client.listen(WrenchStamped, 'right/external_wrench')
    node.simulation.data.body('gripper0_right_eef').xfrc_applied[:3] = [0.0, 0.0, 5.0]

    def force():
        steps(node, 1)
        # A paused node repeats its state, so older ones may still arrive.
        client.spin_until(lambda: wrenches and Time.from_msg(
            wrenches[-1].header.stamp).nanoseconds == node.simulation.time_ns)
        force = wrenches[-1].wrench.force
        return np.linalg.norm([force.x, force.y, force.z])
    assert force() == pytest.approx(5.0 * -np.expm1(-2.0 * np.pi * 0.01), rel=1e-3)
    set_live(client, 'wrench_cutoff.right', 10.0)
    assert 2.0 < force() < 4.0
    set_live(client, 'wrench_cutoff.right', 0.0)
    assert force() == pytest.approx(5.0, abs=1e-6)


@pytest.mark.full
def test_a_command_timeout_changes_while_the_node_runs(serve, client):
    node = serve(start_paused=True, control_mode__arm='velocity', command_timeout__arm=0.0)
    command = JointState(name=ARM[:1], velocity=[0.2])

    def velocity_after(seconds):
        accepted = node.commands.robots[0].statistics['arm'].accepted
        client.publish('arm/joint_command', command)
        client.spin_until(
            lambda: node.commands.robots[0].statistics['arm'].accepted == accepted + 1)
        steps(node, round(seconds * 100))
        return node.simulation.robot.state().velocity[0]
    assert velocity_after(1.0) == pytest.approx(0.2, abs=0.004)
    set_live(client, 'command_timeout.arm', 0.3)
    assert velocity_after(0.28) == pytest.approx(0.2, abs=0.004)
    assert abs(velocity_after(1.0)) < 1e-3
    set_live(client, 'command_timeout.arm', 0.0)
    assert velocity_after(1.0) == pytest.approx(0.2, abs=0.004)


def test_the_timeout_of_commands_follows_the_mode_until_it_is_set(serve, client):
    node = serve(robot='PandaOmron', start_paused=True, control_mode__torso='velocity',
                 command_timeout__torso=0.0)

    def timeouts(*parts):
        return [node.get_parameter(f'command_timeout.{part}').value for part in parts]
    parts = ('arm', 'right', 'base', 'torso')
    assert timeouts(*parts) == [0.0, 0.0, 0.5, 0.0]
    set_live(client, 'control_mode.arm', 'effort')
    set_live(client, 'control_mode.base', 'position')
    set_live(client, 'control_mode.torso', 'effort')
    assert timeouts(*parts) == [0.2, 0.2, 0.0, 0.0]
    set_live(client, 'control_mode.arm', 'position')
    set_live(client, 'control_mode.base', 'effort')
    assert timeouts(*parts) == [0.0, 0.0, 0.5, 0.0]
    set_live(client, 'command_timeout.right', 0.7)
    set_live(client, 'control_mode.arm', 'velocity')
    assert timeouts(*parts) == [0.7, 0.7, 0.5, 0.0]


def test_a_timeout_that_is_rejected_is_not_set(serve, client):
    node = serve(start_paused=True)
    (result,) = node.set_parameters([Parameter('command_timeout.arm', value=-1.0)])
    assert not result.successful
    set_live(client, 'control_mode.arm', 'velocity')
    assert node.get_parameter('command_timeout.arm').value == 0.2


@pytest.mark.full
@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_a_part_whose_commands_stop_comes_to_rest_by_default(mode, serve, client):
    node = serve(start_paused=True)
    steps(node, 100)
    set_live(client, 'control_mode.arm', mode)
    robot = node.simulation.robot
    client.publish('arm/joint_command', JointState(name=ARM[:1], **{mode: [0.2]}))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    steps(node, 18)
    assert robot.joints.timeouts['arm'] == 0
    assert robot.state().velocity[0] > 0.01
    steps(node, 5)
    assert robot.joints.timeouts['arm'] == 1
    (reference,) = robot.controller_state('arm').reference.effort[:1]
    assert reference == 0.0
    if mode == 'velocity':
        steps(node, 20)
        assert abs(robot.state().velocity[0]) < 1e-3


@pytest.mark.full
def test_the_default_timeout_does_not_end_a_target_pose_in_effort_mode(serve, client):
    node = serve(start_paused=True, control_mode__arm='effort')
    robot = node.simulation.robot
    pose = robot.state().end_effectors['right'].pose
    goal = PoseStamped()
    goal.header.frame_id = 'world'
    goal.pose.position.x, goal.pose.position.y = pose.position[0] - 0.05, pose.position[1]
    goal.pose.position.z = pose.position[2]
    for axis, value in zip('xyzw', pose.quat_xyzw):
        setattr(goal.pose.orientation, axis, float(value))
    client.publish('right/target_pose', goal)
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    steps(node, 200)
    reached = robot.state().end_effectors['right'].pose.position[0]
    assert reached == pytest.approx(pose.position[0] - 0.05, abs=5e-3)
    assert robot.joints.timeouts['arm'] == 0
    set_live(client, 'command_timeout.arm', 0.2)
    steps(node, 1)
    assert robot.joints.timeouts['arm'] == 1
