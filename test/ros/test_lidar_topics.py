# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Lidars over topics: messages, frames, rates, truth, and what cannot be asked for."""

import math

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState, LaserScan, PointCloud2

from manip_sim.errors import ManipSimError
from manip_sim.sensing.lidars import Lidar

BALL = '{name: ball, shape: sphere, size: 0.5, mass: 0.1, position: [8.0, 5.0, 1.0]}'
FLAT = '{name: flat, position: [5.0, 5.0, 1.0], samples: 8, range_max: 20.0, rate: 50.0}'
ROUND = '{name: round, position: [5.0, 5.0, 1.0], samples: 4, rings: 3, elevation_min: -0.5}'


def nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def listen(client, kind, topic):
    return client.listen(kind, topic, qos_profile_sensor_data)


def test_a_scan_has_the_ball_ahead_and_its_angles(serve, client):
    node = serve(objects=[BALL], lidars=[FLAT], start_paused=True)
    assert 'lidar flat: 1 x 8 rays, 50 Hz, on flat/scan' in node.shared.notes
    scans = listen(client, LaserScan, 'flat/scan')
    client.spin_until(lambda: scans != [])
    scan = scans[-1]
    assert scan.header.frame_id == 'flat'
    assert (scan.range_min, scan.range_max) == pytest.approx((0.1, 20.0))
    assert scan.scan_time == pytest.approx(0.02)
    assert scan.time_increment == 0.0
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    assert angles[-1] == pytest.approx(scan.angle_max)
    assert angles == pytest.approx(np.arange(-4, 4) * math.pi / 4, abs=1e-6)
    ahead = int(np.abs(angles).argmin())
    assert scan.ranges[ahead] == pytest.approx(2.5, abs=1e-3)
    assert math.isinf(scan.ranges[ahead + 1])
    assert len(scan.intensities) == 0


def test_a_cloud_has_a_row_for_each_ring_with_points_on_the_floor(serve, client):
    serve(objects=[BALL], lidars=[ROUND], start_paused=True)
    clouds = listen(client, PointCloud2, 'round/points')
    client.spin_until(lambda: clouds != [])
    cloud = clouds[-1]
    assert (cloud.header.frame_id, cloud.height, cloud.width) == ('round', 3, 4)
    assert [field.name for field in cloud.fields] == ['x', 'y', 'z', 'ring']
    points = np.frombuffer(cloud.data, np.dtype({
        'names': [field.name for field in cloud.fields],
        'formats': ['<f4', '<f4', '<f4', '<u2'],
        'offsets': [field.offset for field in cloud.fields],
        'itemsize': cloud.point_step})).reshape(3, 4)
    assert points['ring'].tolist() == [[0] * 4, [1] * 4, [2] * 4]
    assert points['z'][0] == pytest.approx(-1.0, abs=1e-5)
    assert np.isnan(points['x'][2]).all()


def test_rays_are_cast_only_while_somebody_listens_and_at_the_rate(serve, client, monkeypatch):
    cast, read = [], Lidar.read
    monkeypatch.setattr(Lidar, 'read', lambda self, *world: cast.append(1) or read(self, *world))
    serve(lidars=[FLAT])
    client.spin_until(lambda: nanoseconds(client.state()) > 200_000_000)
    assert not cast
    scans = listen(client, LaserScan, 'flat/scan')
    client.spin_until(lambda: len(scans) > 5)
    assert cast
    stamps = [nanoseconds(scan) for scan in scans]
    assert {stamp % 20_000_000 for stamp in stamps[1:]} == {0}
    assert set(np.diff(stamps[1:])) == {20_000_000}


def test_with_noise_the_truth_is_beside_it_with_the_same_stamps(serve, client):
    noisy = FLAT[:-1] + ', noise: 0.05}'
    node = serve(objects=[BALL], lidars=[noisy, ROUND], start_paused=True)
    measured = listen(client, LaserScan, 'flat/scan')
    exact = listen(client, LaserScan, 'truth/flat/scan')
    client.spin_until(lambda: measured and exact)
    assert nanoseconds(measured[-1]) == nanoseconds(exact[-1])
    assert exact[-1].ranges[4] == pytest.approx(2.5, abs=1e-3)
    assert 1e-4 < abs(measured[-1].ranges[4] - exact[-1].ranges[4]) < 0.3
    assert math.isinf(measured[-1].ranges[5])
    # The other one is exact until the robot has noise.
    assert client.node.count_publishers('truth/round/points') == 0
    node.set_parameters([Parameter('noise.range', value=0.01)])
    clouds = listen(client, PointCloud2, 'truth/round/points')
    client.spin_until(lambda: clouds != [])


def test_in_lockstep_scans_are_of_due_states_only(serve, client):
    serve(lidars=[FLAT], stepping='lockstep')
    scans = listen(client, LaserScan, 'flat/scan')
    states = client.listen(JointState, 'joint_states')
    name = client.state().name[0]
    for period in range(1, 6):
        client.spin_until(lambda t=10_000_000 * period: nanoseconds(states[-1]) == t)
        if period % 2 == 0:
            client.spin_until(lambda t=10_000_000 * period: scans and nanoseconds(scans[-1]) == t)
        client.publish('joint_command', JointState(name=[name], position=[0.1]))
    assert {nanoseconds(scan) // 10_000_000 for scan in scans} <= {1, 2, 4}


@pytest.mark.parametrize('parameters, what', [
    ({'lidars': ['scan']}, "one of 'lidars' must be a description such as"),
    ({'lidars': ['{name: scan']}, "one of 'lidars' is invalid or unsafe YAML"),
    ({'lidars': ['{name: scan, sample: 3}']}, "unknown key 'sample': did you mean 'samples'"),
    ({'lidars': ['{name: scan, rate: 200.0}']},
     "parameter 'lidars: scan': 200 Hz is not possible, because publish_rate is 100 Hz"),
    ({'lidars': ['{name: scan, body: hand}']}, "unknown body of the lidar 'scan' 'hand'")],
    ids=str)
def test_what_cannot_be_is_told_on_one_line(serve, parameters, what):
    with pytest.raises(ManipSimError, match=what) as error:
        serve(**parameters)
    assert '\n' not in str(error.value)
