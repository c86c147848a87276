# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Topics that other packages add, through the node's interface."""

import math

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, JointState
from spawning_node import ask, SpawningByParameters
from std_msgs.msg import Float64, String

from manip_sim.ros.messages import nanoseconds_of

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
GRAVITY, GYRO, ACCELEROMETER = 9.81, 0.002, 0.05
#: Sensors that cannot be used, and a part of the message about each.
BROKEN = {
    'Raises': ('def write(self, message, simulation): 1 / 0', 'ZeroDivisionError'),
    'Wrong': ("def write(self, message, simulation): message.data = 'text'", 'AssertionError'),
    'Needy': ('def write(self, message, simulation): pass\n'
              '    def __init__(self): pass', 'TypeError'),
    'Unmade': ('', 'must be a class that derives from Sensor or TopicSource'),
    'Taken': ("topic = replace(TOPIC, name='<arm>/wrench')\n"
              '    def write(self, message, simulation): pass',
              "its topic 'right/wrench' is that of manip_sim"),
    'Typeless': ("topic = replace(TOPIC, name='~/nothing', type='std_msgs/Nothing')\n"
                 '    def write(self, message, simulation): pass', "'Nothing'"),
}
SOURCE = """
from dataclasses import replace
from manip_sim.interface.offered_sensors import Sensor, TopicSource
from manip_sim.interface.topics import PUBLISHED, Topic
TOPIC = Topic('~/one', 'std_msgs/Float64', PUBLISHED, 'one')
"""


@pytest.fixture
def package(package_on_path):
    """Return a function that puts a package with sensors, by name, on the path."""
    return lambda name, code, points: package_on_path(
        'manip_sim.sensors', name, code, dict(zip(points, points)))


@pytest.mark.full
def test_an_installed_imu_measures_gravity_and_turning_with_its_noise(
        install_example, monkeypatch, serve, client):
    monkeypatch.syspath_prepend(install_example('end_effector_imu'))
    node = serve(start_paused=True, publish_clock=False, control_mode__arm='velocity',
                 command_timeout__arm=0.0)
    assert [row.type for row in node.table if row.name == 'right/imu'] == ['sensor_msgs/Imu']
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], velocity=[0.3]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    messages = client.listen(Imu, 'right/imu')
    client.spin_until(lambda: len(messages) > 1)
    repeated = messages[-1]
    client.spin_until(lambda: messages[-1] is not repeated)
    assert messages[-1] == repeated, 'a state that is repeated has other noise'

    for _ in range(300):
        node.thread.step()
        last = node.simulation.time_ns
        client.spin_until(lambda last=last: nanoseconds_of(messages[-1].header.stamp) == last)
    by_time = {nanoseconds_of(message.header.stamp): message for message in messages}
    steady = list(by_time.values())[-200:]
    assert steady[0].header.frame_id == 'gripper0_right_grip_site'
    turn, force = (np.array([[v.x, v.y, v.z] for v in (getattr(m, field) for m in steady)])
                   for field in ('angular_velocity', 'linear_acceleration'))
    # Joint 1 turns about the vertical, and so does the hand.
    np.testing.assert_allclose(np.linalg.norm(turn.mean(axis=0)), 0.3, atol=1e-3)
    radius = np.hypot(*node.simulation.data.site('gripper0_right_grip_site').xpos[:2]
                      - node.simulation.data.body('robot0_link1').xpos[:2])
    np.testing.assert_allclose(np.linalg.norm(force.mean(axis=0)),
                               math.hypot(GRAVITY, 0.3**2 * radius), atol=0.02)
    np.testing.assert_allclose(turn.std(axis=0), GYRO, rtol=0.3)
    np.testing.assert_allclose(force.std(axis=0), ACCELEROMETER, rtol=0.3)


@pytest.mark.full
def test_an_installed_topic_is_latched_and_published_when_it_changes(
        install_example, monkeypatch, serve, client):
    monkeypatch.syspath_prepend(install_example('touched_bodies'))
    node = serve(arena='table', start_paused=True)
    texts, states = client.listen(String, 'manip_sim/touched', LATCHED), client.listen(
        JointState, 'joint_states')
    client.spin_until(lambda: len(texts) == 1)
    for _ in range(20):
        node.thread.step()
    last = node.simulation.time_ns
    client.spin_until(lambda: len(texts) > 1 and bool(states)
                      and nanoseconds_of(states[-1].header.stamp) == last)
    # The cube begins to touch the table in the first step, and then lies on it.
    assert [text.data for text in texts] == ['', 'cube table']
    late = client.listen(String, 'manip_sim/touched', LATCHED)
    client.spin_until(lambda: late == texts[1:])
    assert node.rejections.failed['sensors'] == 0


@pytest.mark.full
def test_packages_that_cannot_be_used_are_named_in_a_line_and_the_node_serves_the_rest(
        package, serve, client):
    lines = client.log()
    package('their_sensors', SOURCE + '\n'.join(
        f'class {name}(TopicSource):\n    topic = replace(TOPIC, name="~/{name}")\n    {code}\n'
        for name, (code, _) in BROKEN.items()), BROKEN)
    package('their_import', 'import does_not_exist', ['Lost'])
    package('our_sensors', SOURCE + 'class Works(TopicSource):\n    topic = TOPIC\n'
            '    def write(self, message, simulation): message.data = 4.0\n', ['Works'])
    node = serve(start_paused=True)
    broken = {**BROKEN, 'Lost': ('', 'does_not_exist')}
    client.spin_until(lambda: sum('cannot be used' in line for line in lines) == len(broken))
    for name, (_, what) in broken.items():
        (line,) = [line for line in lines if f"'{name}' of the package their_" in line]
        assert ' 1.2 ' in line and what in line, line
    assert [row.name for row in node.table if row.type == 'std_msgs/Float64'] == ['~/one']
    values = client.listen(Float64, 'manip_sim/one')
    client.spin_until(lambda: values != [])
    assert values[0].data == 4.0 and len(client.state().position) == 9


@pytest.mark.full
def test_sensors_that_fail_later_end_and_are_counted_and_the_node_goes_on(
        package, serve, client):
    fails = ['1 / 0', "float('nan')", "'text'"]
    package('late_sensors', SOURCE + '\n'.join(f"""
class Late{number}(Sensor):
    topic = replace(TOPIC, name='~/late{number}')
    def read(self, simulation):
        return [1.0 if simulation.time_s < 0.05 else {fail}]
    def fill(self, message, values):
        message.data = float(values[0])
""" for number, fail in enumerate(fails)), ['Late0', 'Late1', 'Late2'])
    node = serve(start_paused=True)
    lines, statuses = client.log(), client.listen(DiagnosticArray, '/diagnostics')
    values = [client.listen(Float64, f'manip_sim/late{number}') for number in range(3)]
    client.spin_until(lambda: all(values))
    # Periods follow each other faster than subscribers are looked for.
    node.thread.pause(False)
    client.spin_until(lambda: sum(' ends, sensor' in line for line in lines) == 3)
    client.spin_until(lambda: node.simulation.time_s > 0.5)
    assert node.rejections.failed['sensors'] == 3
    for number, what in enumerate(('ZeroDivisionError', 'finite', 'ValueError')):
        (line,) = [line for line in lines if f'~/late{number} ends' in line]
        assert what in line and f"'Late{number}' of the package late_sensors 1.2" in line
    assert {value.data for messages in values for value in messages} == {1.0}
    client.spin_until(lambda: bool(statuses) and any(
        (pair.key, pair.value) == ('failed_sensors', '3')
        for status in statuses[-1].status for pair in status.values))
    assert len(client.state().position) == 9


@pytest.mark.full
def test_a_robot_that_is_spawned_has_sensors_of_other_packages_until_it_goes(
        package, serve, client, tmp_path):
    package('arm_sensors', SOURCE + """
class OfArm(TopicSource):
    topic = replace(TOPIC, name='<arm>/height')
    def write(self, message, simulation):
        site = self.robot.end_effectors[self.of].grip_site
        message.data = float(simulation.data.site(site).xpos[2])

class OfWorld(TopicSource):
    topic = TOPIC
    def write(self, message, simulation): message.data = 4.0
""", ['OfArm', 'OfWorld'])
    node, lines = serve(real_time_factor=2.0), client.log()
    SpawningByParameters(node, tmp_path)
    assert ask(client, 'spawn_entity', name='left', resource_string='{robot: UR5e}',
               position=[0.0, 2.0, 0.0]).successful
    assert [row.name for row in node.table if row.type == 'std_msgs/Float64'] == [
        'right/height', '~/one', 'left/right/height']
    heights = client.listen(Float64, 'left/right/height')
    client.spin_until(lambda: heights != [])
    site = node.simulation.robots['left'].end_effectors['right'].grip_site
    assert heights[-1].data == pytest.approx(node.simulation.data.site(site).xpos[2], abs=1e-3)
    assert ask(client, 'delete_entity', entity='left').successful
    client.spin_until(lambda: client.node.count_publishers('left/right/height') == 0)
    assert client.node.count_publishers('right/height') == 1
    assert not [line for line in lines if 'cannot be used' in line]
    assert node.rejections.failed['sensors'] == 0
