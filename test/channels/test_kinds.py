# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Channels of worlds: which there are, in which order, what they read and what messages hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from manip_sim.channels.contents import OF_INSTRUMENTS
from manip_sim.channels.kinds import (
    clock_channel, instrument_channels, object_channels, robot_channels)
from manip_sim.interface.topics import Scope
from manip_sim.models import compose, compose_robot, create_arena, World
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation

FILES = Path(__file__).resolve().parents[1] / 'data/files'
BALL = {'shape': 'sphere', 'size': 0.1, 'mass': 0.2, 'name': 'ball', 'position': [1.0, 1.0, 0.5]}
HEAD = {'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': 'hand'}


@pytest.fixture(scope='module')
def two():
    robots = [compose_robot('Panda', prefix=f'{name}_', idn=name) for name in ('a', 'b')]
    robots[1].set_base_xpos([0.0, 2.0, 0.0])
    return Simulation(World(robots, create_arena('table')))


def scopes(simulation):
    return {Scope(name): robot for name, robot in simulation.robots.items()}


def names(channels):
    return [channel.topic.name for channel in channels]


def test_a_channel_reads_the_state_and_its_exact_one_has_no_noise():
    simulation = Simulation(compose('Panda'))
    joints = robot_channels(simulation.robot, Scope())[0]
    assert joints.topic.name == 'joint_states' and not joints.differs
    np.testing.assert_array_equal(joints.read(simulation), simulation.robot.measured())
    simulation.robot.sensing.set('noise.joint_position', 0.1)
    assert joints.differs and joints.exact.topic.name == 'truth/joint_states'
    exact = simulation.robot.true_state()
    np.testing.assert_array_equal(joints.exact.read(simulation)[:len(exact.position)],
                                  exact.position)
    assert (joints.read(simulation) != joints.exact.read(simulation)).any()


def test_channels_of_arms_have_their_frames_with_the_prefix_and_the_scope(two):
    channels = {channel.topic.name: channel for channel in robot_channels(
        two.robots['b'], Scope('b'), 'x/')}
    assert channels['b/right/wrench'].frame == 'x/b_gripper_ft_frame'
    assert channels['b/right/eef_pose'].frame == 'x/world'
    assert channels['b/right/eef_pose'].exact.topic.name == 'b/truth/right/eef_pose'
    assert channels['b/arm/controller_state'].exact is None


def test_instruments_of_robots_that_are_left_out_have_no_channels(two):
    of_both = names(instrument_channels(two, scopes(two), {}, ()))
    of_first = names(instrument_channels(two, {Scope('a'): two.robots['a']}, {}, ()))
    assert of_first == [name for name in of_both if name.startswith('a/')]
    assert len(of_both) == 2 * len(of_first) > 0


def test_instruments_have_their_own_rate_and_noise(two):
    first, *others = instrument_channels(two, scopes(two), {'a_right_imu': 2}, ['a_right_imu'])
    assert (first.topic.name, first.every, first.differs) == ('a/sensors/a_right_imu/imu', 2, True)
    assert {(channel.every, channel.differs) for channel in others} == {(1, False)}


def test_actuators_of_no_part_come_last_and_nothing_is_read_of_objects_that_are_gone():
    simulation = Simulation(compose(
        str(FILES / 'differential_wrist.xml'), arena=str(FILES / 'room.xml')))
    simulation.change_objects(plan_with(simulation.plan, create_object(BALL)))
    channels = object_channels(simulation, 'x/')
    ours = names(channels)
    assert ours[:2] == ['objects/ball/pose', 'objects/ball/twist']
    assert 'objects/marker/pose' in ours and ours[-1] == 'actuators/states'
    assert channels[0].frame == 'x/world' and len(channels[0].read(simulation)) == 7
    simulation.change_objects(plan_without(simulation.plan, 'ball'))
    assert [channel.read(simulation) is None for channel in channels] == [
        name.startswith('objects/ball/') for name in ours]


def test_an_imu_without_an_orientation_says_so_by_its_covariance(two):
    imu = next(found for found in two.sensors.instruments if found.kind == 'imu')
    types = tuple(kind for kind in imu.types if kind != 'framequat')
    fields = OF_INSTRUMENTS['imu'](replace(imu, types=types))(HEAD, np.arange(10.0))
    assert fields['orientation_covariance'] == [-1.0] + [0.0] * 8
    assert fields['angular_velocity_covariance'] == [0.0] * 9
    assert fields['orientation'] == {'x': 0.0, 'y': 1.0, 'z': 2.0, 'w': 3.0}
    assert fields['linear_acceleration'] == {'x': 7.0, 'y': 8.0, 'z': 9.0}


def test_the_clock_has_whole_seconds_and_the_nanoseconds_that_are_left():
    fields = clock_channel().fields(12_000_000_034, np.empty(0))
    assert fields == {'clock': {'sec': 12, 'nanosec': 34}}
