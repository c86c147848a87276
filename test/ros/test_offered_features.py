# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Features that other packages add, through the node's interface."""

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3
import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from spawning_node import ask, SpawningByParameters
from std_srvs.srv import Trigger

from manip_sim.errors import ParameterError

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
SOURCE = """
from geometry_msgs.msg import Vector3
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.interface.topics import PUBLISHED, SUBSCRIBED, Topic
from manip_sim.ros.feature import create_output, Feature
from std_srvs.srv import Trigger
"""
#: Features that cannot be used, and a part of the message about each.
BROKEN = {
    'Raises': ('def __init__(self, context): 1 / 0', 'ZeroDivisionError: division by zero'),
    'Needy': ('def __init__(self): pass', 'TypeError'),
    'TakenTopic': ("topics = [Topic('<arm>/wrench', 'std_msgs/String', PUBLISHED, 'text')]",
                   "its topic 'right/wrench' exists already"),
    'TakenParameter': ("parameters = [ParameterSpec('seed', 1, 'text')]",
                       "its parameter 'seed' exists already"),
    'WrongRows': ("topics = ['right/text']", "its Topic rows must be a list of these, got ['r"),
    'Unlisted': ("def __init__(self, context): context.node.create_publisher(Vector3, '~/a', 1)",
                 "'~/a' is published but not in the table of topics"),
}


@pytest.fixture
def package(package_on_path):
    """Return a function that puts a package with features, by name, on the path."""
    return lambda name, code, points: package_on_path(
        'manip_sim.features', name, code, dict(zip(points, points)))


@pytest.mark.full
def test_an_installed_feature_answers_and_its_parameter_acts(
        install_example, monkeypatch, serve, client):
    monkeypatch.syspath_prepend(install_example('go_home'))
    node = serve(start_paused=True)
    start = node.simulation.robot.state().position[:7]
    client.publish('arm/joint_command', JointState(name=ARM, position=list(start + 0.1)))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)

    def after(periods):
        """Return how far the arm is from its start after some control periods [rad]."""
        for _ in range(periods):
            node.thread.step()
        return np.abs(node.simulation.robot.state().position[:7] - start).max()

    assert after(300) == pytest.approx(0.1, abs=1e-3)
    (changed,) = node.set_parameters([Parameter('go_home.duration', value=1.0)])
    assert changed.successful
    (refused,) = node.set_parameters([Parameter('go_home.duration', value=0.0)])
    assert not refused.successful and 'Min: 0.1, Max: 60.0' in refused.reason
    assert client.call(Trigger, 'manip_sim/go_home', Trigger.Request()).success
    assert after(50) == pytest.approx(0.05, abs=2e-3)  # The middle of the spline.
    assert after(60) < 1e-3


@pytest.mark.full
def test_the_given_value_of_a_parameter_of_a_feature_is_checked(
        install_example, monkeypatch, serve):
    monkeypatch.syspath_prepend(install_example('go_home'))
    assert serve(go_home__duration=2).get_parameter('go_home.duration').value == 2.0
    with pytest.raises(ParameterError, match="parameter 'go_home.duration' must be .*60"):
        serve(go_home__duration=100.0)


@pytest.mark.full
def test_a_feature_takes_a_topic_of_each_arm_also_of_robots_that_come(
        install_example, monkeypatch, serve, client, tmp_path):
    monkeypatch.syspath_prepend(install_example('nudge'))
    node = serve(stepping='free', arena='table')
    assert [row.name for row in node.table if row.name.endswith('nudge')] == ['right/nudge']
    nudged = client.listen(Vector3, 'manip_sim/nudged')
    client.publish('right/nudge', Vector3(x=0.2))
    first = node.simulation.robot.state().position[0]
    client.spin_until(
        lambda: abs(node.simulation.robot.state().position[0] - first - 0.2) < 1e-3)
    assert [turn.x for turn in nudged] == [0.2]

    SpawningByParameters(node, tmp_path)
    assert ask(client, 'spawn_entity', name='left', resource_string='{robot: UR5e}',
               position=[0.0, 1.5, 0.0]).successful
    left = node.simulation.robots['left']
    before = left.state().position[0]
    client.publish('left/right/nudge', Vector3(x=-0.1))
    client.spin_until(lambda: abs(left.state().position[0] - before + 0.1) < 1e-3)
    assert ask(client, 'delete_entity', entity='left').successful
    assert not any(row.name.startswith('left/') for row in node.table)
    assert node.count_subscribers('left/right/nudge') == 0
    assert node.rejections.failed['features'] == 0


@pytest.mark.full
def test_features_that_cannot_be_used_are_named_in_a_line_and_the_node_serves_the_rest(
        package, install_example, monkeypatch, serve, client):
    lines = client.log()
    package('their_features', SOURCE + '\n'.join(
        f'class {name}(Feature):\n    {code}\n' for name, (code, _) in BROKEN.items())
        + 'Wrong = Topic\n', [*BROKEN, 'Wrong'])
    package('their_import', 'import does_not_exist', ['Lost'])
    monkeypatch.syspath_prepend(install_example('nudge'))
    node = serve(start_paused=True)
    broken = {**BROKEN, 'Lost': ('', 'does_not_exist'),
              'Wrong': ('', 'must be a class that derives from Feature')}
    client.spin_until(lambda: sum('cannot be used' in line for line in lines) == len(broken))
    for name, (_, what) in broken.items():
        (line,) = [line for line in lines if f"'{name}' of the package their_" in line]
        assert ' 1.2 ' in line and what in line, line
    assert node.get_parameter('seed').value == 0
    nudged = client.listen(Vector3, 'manip_sim/nudged')
    client.publish('right/nudge', Vector3(x=0.2))
    client.spin_until(lambda: nudged != [])
    assert len(client.state().position) == 9


@pytest.mark.full
def test_methods_and_callbacks_that_raise_are_counted_and_the_node_goes_on(
        package, serve, client):
    package('late_features', SOURCE + """
class Late(Feature):
    def __init__(self, context):
        context.node.create_service(Trigger, '~/late', lambda request, response: 1 / 0)
    def fail(self, *arguments):
        1 / 0
    start = started = robot_added = robot_removed = world_changed = parameters_changed = fail
    close = fail
""", ['Late'])
    node = serve(start_paused=True)
    assert node.rejections.failed['features'] == 3  # Parameters, start, started.
    (changed,) = node.set_parameters([Parameter('real_time_factor', value=2.0)])
    assert changed.successful and node.rejections.failed['features'] == 4
    statuses = client.listen(DiagnosticArray, '/diagnostics')
    late = client.node.create_client(Trigger, 'manip_sim/late')
    client.spin_until(late.service_is_ready)
    late.call_async(Trigger.Request())
    client.spin_until(lambda: node.rejections.failed['callbacks'] == 1)
    assert len(client.state().position) == 9
    client.spin_until(lambda: any(
        value.key == 'failed_features' and value.value == '4'
        for array in statuses for status in array.status for value in status.values))
    node.stop()
    assert node.rejections.failed['features'] == 5
