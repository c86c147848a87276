# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The configuration for RViz: it parses, and shows topics that the node has."""

import yaml

from manip_sim.interface.topics import PUBLISHED, Scope, topics_of_world
from manip_sim.models import compose
from manip_sim.resources import share_directory
from manip_sim.simulation import Simulation

CONFIG = yaml.safe_load((share_directory() / 'config/manip_sim.rviz').read_text())
#: Displays of rviz_default_plugins in ROS 2 Jazzy that show what the node publishes, and the type
#: of their topic.
DISPLAYS = {
    'Grid': None, 'TF': None, 'RobotModel': 'std_msgs/String',
    'MarkerArray': 'visualization_msgs/MarkerArray', 'Wrench': 'geometry_msgs/WrenchStamped',
    'Odometry': 'nav_msgs/Odometry', 'Pose': 'geometry_msgs/PoseStamped'}
TOOLS = {'MoveCamera', 'Select', 'FocusCamera', 'Measure', 'Interact'}


def displays():
    """Return class and properties of each display."""
    return [(display['Class'].removeprefix('rviz_default_plugins/'), display)
            for display in CONFIG['Visualization Manager']['Displays']]


def as_seen(name):
    return f'/manip_sim/{name[2:]}' if name.startswith('~/') else f'/{name.lstrip("/")}'


def test_displays_and_tools_are_those_of_rviz():
    classes = [name for name, _ in displays()]
    assert set(classes) == set(DISPLAYS)
    manager = CONFIG['Visualization Manager']
    assert {tool['Class'].removeprefix('rviz_default_plugins/')
            for tool in manager['Tools']} <= TOOLS
    assert manager['Views']['Current']['Class'] == 'rviz_default_plugins/Orbit'
    assert manager['Global Options']['Fixed Frame'] == 'world'
    names = [display['Name'] for _, display in displays()]
    assert len(set(names)) == len(names)


def test_each_topic_is_one_that_the_node_publishes_with_that_type():
    published = {}
    for robot in ('PandaOmron', 'Baxter'):
        sim = Simulation(compose(robot, arena='table'))
        published |= {as_seen(topic.name): topic.type for topic in topics_of_world(
            sim, {Scope(): sim.robot})
            if topic.direction == PUBLISHED}
    shown = [(name, display.get('Topic') or display.get('Description Topic'))
             for name, display in displays()]
    for name, topic in shown:
        if DISPLAYS[name] is None:
            assert topic is None, name
        else:
            assert published[topic['Value']] == DISPLAYS[name], name
            latched = topic['Value'] == '/robot_description'
            assert topic['Durability Policy'] == ('Transient Local' if latched else 'Volatile')
