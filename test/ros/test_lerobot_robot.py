# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A robot of a node as a robot of LeRobot: keys, units, images, commands; with LeRobot, if any."""

import math
import signal
import time

from harness import DOMAIN
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState

from manip_sim.errors import CommandError, ManipSimError, UnknownNameError
from manip_sim.lerobot_units import joint_of, SO101_MOTORS, so101_scales

pytest.importorskip('gymnasium', reason='gymnasium is not installed')
from manip_sim.env.ros import NodeRobot  # noqa: E402

#: Ranges of an SO-101 [rad].
RANGES = {'a_shoulder_pan': (-1.92, 1.92), 'a_shoulder_lift': (-1.75, 1.75),
          'a_elbow_flex': (-1.69, 1.69), 'a_wrist_flex': (-1.66, 1.66),
          'a_wrist_roll': (-2.74, 2.84), 'a_hand_gripper': (-0.17, 1.75)}
TICKS = 4096


def calibrated(motor, position):
    """Return what LeRobot 0.6.1's bus of motors makes of a position, of the motor's ticks."""
    low, high = RANGES[joint_of(motor, RANGES)]
    if motor == 'wrist_roll':
        low, high = -math.pi, math.pi
    ticks, lowest, highest = (TICKS / 2 + angle / (2 * math.pi) * TICKS
                              for angle in (position, low, high))
    return {'degrees': (ticks - (lowest + highest) / 2) * 360 / TICKS,
            '100': (ticks - lowest) / (highest - lowest) * 200 - 100,
            'gripper': (ticks - lowest) / (highest - lowest) * 100}


@pytest.mark.parametrize('degrees', [True, False])
def test_an_so101_has_the_units_that_lerobots_bus_makes_of_ticks(degrees):
    scales = so101_scales(RANGES, degrees)
    assert tuple(scales) == SO101_MOTORS
    for motor, scale in scales.items():
        kind = 'gripper' if motor == 'gripper' else 'degrees' if degrees else '100'
        for position in (-0.1, 0.0, 1.2):
            assert scale.number(position) == pytest.approx(calibrated(motor, position)[kind])
            assert scale.position(scale.number(position)) == pytest.approx(position)


def test_a_motor_is_one_joint_whatever_its_prefix():
    assert joint_of('roll', ['robot0_roll', 'robot0_flex']) == 'robot0_roll'
    assert joint_of('elbow', ['elbow', 'low_elbows']) == 'elbow'
    for joints in (['left_elbow', 'right_elbow'], ['shoulder']):
        with pytest.raises(ManipSimError, match="joints are called 'elbow'"):
            joint_of('elbow', joints)


def reached(robot, goals, tolerance):
    """Command goals until they are reached, as a loop of LeRobot does; return the positions."""
    end = time.monotonic() + 60.0
    while True:
        robot.command(goals)
        positions = robot.positions()
        if all(abs(positions[key] - goal) < tolerance for key, goal in goals.items()):
            return positions
        assert time.monotonic() < end, positions
        time.sleep(0.03)


def test_an_so101_of_a_node_goes_where_lerobots_numbers_say(serve, client):
    serve(robot='SO101', control_mode__arm='velocity')
    robot = NodeRobot(scales=so101_scales, domain_id=DOMAIN)
    robot.connect()
    with pytest.raises(ManipSimError, match='/manip_sim is connected already'):
        robot.connect()
    robot.set_position_mode()
    modes = client.call(GetParameters, '/manip_sim/get_parameters',
                        GetParameters.Request(names=['control_mode.arm']))
    assert modes.values[0].string_value == 'position'
    reached(robot, {'shoulder_pan.pos': 30.0, 'gripper.pos': 75.0}, 0.5)
    state = client.state()
    positions = dict(zip(state.name, state.position))
    assert positions['robot0_shoulder_pan'] == pytest.approx(math.radians(30.0), abs=0.01)
    low, high = -0.17453, 1.74533
    assert positions['gripper0_right_gripper'] == pytest.approx(
        low + 0.75 * (high - low), abs=0.01)
    with pytest.raises(UnknownNameError, match="unknown key 'shoulder_pan'"):
        robot.command({'shoulder_pan': 0.0})
    with pytest.raises(CommandError, match='elbow_flex.pos is not finite'):
        robot.command({'elbow_flex.pos': math.nan})
    robot.close()
    robot.close()
    for method in (robot.positions, lambda: robot.command({})):
        with pytest.raises(ManipSimError, match='is not connected'):
            method()


def test_an_arm_of_a_node_has_its_own_names_without_fingers_that_follow(serve):
    serve(robot='Kinova3', gripper='Robotiq85Gripper')
    robot = NodeRobot(domain_id=DOMAIN)
    robot.connect()
    assert list(robot.positions()) == [
        *(f'robot0_Actuator{number}.pos' for number in range(1, 8)),
        'gripper0_right_finger_joint.pos']
    reached(robot, {'gripper0_right_finger_joint.pos': 0.4}, 0.01)
    robot.close()


@pytest.mark.full
def test_images_are_those_of_the_nodes_cameras_in_their_size(serve, gl):
    serve(robot='SO101', arena='table', cameras=['agentview'], camera__agentview__width=40,
          camera__agentview__height=30)
    robot = NodeRobot(cameras={'agentview': (30, 40)}, domain_id=DOMAIN)
    robot.connect()
    image = robot.images()['agentview']
    assert image.shape == (30, 40, 3) and image.dtype == np.uint8 and image.std() > 10.0
    robot.close()
    other = NodeRobot(cameras={'agentview': (40, 30)}, domain_id=DOMAIN)
    with pytest.raises(ManipSimError, match='agentview: the node has images of 40 x 30 pixels, '
                                            'not 30 x 40'):
        other.connect()
    assert not other.is_connected


@pytest.mark.full
def test_what_a_node_lacks_is_told(serve, monkeypatch):
    monkeypatch.setattr('manip_sim.env.ros._ROBOT_PATIENCE_S', 2.0)
    serve(robot='SO101')
    with pytest.raises(ManipSimError, match="nothing on '/left/gripper/joint_states' for 2 s"):
        NodeRobot(parts=['arm', 'left/gripper'], domain_id=DOMAIN).connect()


def test_a_node_that_has_ended_is_told(serve, client, monkeypatch):
    monkeypatch.setattr('manip_sim.env.ros._OLDEST_S', 0.0)
    serve(robot='SO101')
    robot = NodeRobot(domain_id=DOMAIN)
    robot.connect()
    with pytest.raises(ManipSimError, match='/manip_sim has published no joints for'):
        robot.positions()
    robot.close()


@pytest.mark.full
def test_nothing_of_an_earlier_connection_is_taken_for_the_present(sim_process, monkeypatch):
    node = sim_process('robot:=SO101')
    robot = NodeRobot(domain_id=DOMAIN)
    robot.connect()
    robot.close()
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=60.0)
    monkeypatch.setattr('manip_sim.env.ros._ROBOT_PATIENCE_S', 2.0)
    with pytest.raises(ManipSimError, match="nothing on '/robot_description', '/joint_states', "):
        robot.connect()


@pytest.mark.full
def test_robots_of_a_node_with_several_are_told_apart(serve):
    serve(robots=['one', 'two'], one__robot='SO101', two__robot='SO101',
          two__position=[0.0, 1.0, 0.0])
    two = NodeRobot(robot='two', scales=so101_scales, domain_id=DOMAIN)
    one = NodeRobot(robot='one', scales=so101_scales, domain_id=DOMAIN)
    for robot in (one, two):
        robot.connect()
        robot.set_position_mode()
    reached(two, {'shoulder_pan.pos': 20.0}, 0.5)
    assert abs(one.positions()['shoulder_pan.pos']) < 1.0
    one.close()
    two.close()


@pytest.fixture
def plugin():
    """Return our plugin, as LeRobot finds it by its name."""
    pytest.importorskip('lerobot.robots', reason='LeRobot is not installed')
    from lerobot.configs.parser import load_plugin
    load_plugin('lerobot_robot_manip_sim')
    import lerobot_robot_manip_sim
    return lerobot_robot_manip_sim


def test_lerobot_makes_a_follower_that_follows_a_leader(serve, client, plugin, tmp_path):
    pytest.importorskip('scservo_sdk', reason="LeRobot's extra feetech is not installed")
    from lerobot.robots import make_robot_from_config, RobotConfig
    from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig
    from lerobot.teleoperators import make_teleoperator_from_config, TeleoperatorConfig
    serve(robots=['leader', 'follower'], leader__robot='SO101', follower__robot='SO101',
          follower__position=[0.0, 1.0, 0.0])
    where = {'domain_id': DOMAIN, 'calibration_dir': tmp_path}
    follower = make_robot_from_config(RobotConfig.get_choice_class('manip_sim_so101_follower')(
        robot='follower', cameras={}, **where))
    leader = make_teleoperator_from_config(TeleoperatorConfig.get_choice_class(
        'manip_sim_so101_leader')(robot='leader', **where))
    real = SO101Follower(SO101FollowerConfig(port='none', calibration_dir=tmp_path))
    for name in ('name', 'robot_type', 'observation_features', 'action_features'):
        assert getattr(follower, name) == getattr(real, name), name
    assert leader.action_features == real.action_features
    with leader, follower:
        goal = JointState(name=['leader_shoulder_pan'], position=[0.5])
        end = time.monotonic() + 60.0
        while follower.get_observation()['shoulder_pan.pos'] < math.degrees(0.49):
            assert time.monotonic() < end
            client.publish('leader/joint_command', goal)
            follower.send_action(leader.get_action())
            time.sleep(0.03)


def test_lerobot_limits_the_way_to_a_goal(serve, plugin, tmp_path):
    serve(robot='Panda')
    robot = plugin.ManipSim(plugin.ManipSimConfig(
        max_relative_target=0.1, domain_id=DOMAIN, calibration_dir=tmp_path))
    # They are known before the connection.
    assert list(robot.observation_features) == list(robot.action_features) == [
        *(f'robot0_joint{number}.pos' for number in range(1, 8)),
        'gripper0_right_finger_joint1.pos']
    with robot:
        present = robot.get_observation()['robot0_joint1.pos']
        sent = robot.send_action({'robot0_joint1.pos': present + 1.0, 'task': 'none'})
        assert sent['robot0_joint1.pos'] == pytest.approx(present + 0.1, abs=0.01)
        assert list(sent) == ['robot0_joint1.pos']
