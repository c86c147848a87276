# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The tables of topics, services and parameters against running nodes."""

import re

import pytest
from rcl_interfaces.srv import ListParameters
from sensor_msgs.msg import JointState

from manip_sim.errors import ManipSimError
from manip_sim.interface.composition import compose_world, declare_cameras, declare_parts
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.interface.topics import PUBLISHED, SERVICES, SUBSCRIBED, TOPICS, topics_of_world
from manip_sim.ros import visualization_topics
from manip_sim.ros.messages import message_class

OF_ROS = {'/rosout', '/parameter_events'}
#: Services that every node of rclpy has, and optional ones.
OWN_SERVICES = ('rcl_interfaces', 'type_description_interfaces', 'simulation_interfaces')


def as_seen(name):
    """Return the full name of a topic or service of the node ``/manip_sim``."""
    if name.startswith('~/'):
        return f'/manip_sim/{name[2:]}'
    return name if name.startswith('/') else f'/{name}'


@pytest.mark.full
@pytest.mark.parametrize('parameters', [
    {}, {'gripper': 'none'}, {'arena': 'table'}, {'robot': 'PandaOmron'}, {'robot': 'GR1'},
    {'robot': 'UR5e', 'gripper': 'WipingGripper'},
    {'robots': ['a', 'b'], 'a.robot': 'PandaOmron', 'b.robot': 'Baxter', 'arena': 'table',
     'b.gripper': '{right: PandaGripper, left: none}'},
    {'cameras': ['birdview', 'agentview'], 'camera.agentview.depth': False},
    {'task': 'pick_cube'}], ids=str)
def test_a_node_has_the_topics_and_parameters_of_the_tables(parameters, serve, client):
    node = serve(**parameters)
    client.state('a/joint_states' if 'robots' in parameters else 'joint_states')
    simulation, given = node.simulation, GivenParameters(parameters)
    composition, robots = compose_world(given), simulation.robots.values()
    scopes = composition.scopes
    declare_parts(given, [(scope, robot.parts) for scope, robot in zip(scopes, robots)])
    cameras = declare_cameras(given, composition.world, simulation.model)
    expected = topics_of_world(
        simulation, dict(zip(scopes, robots)),
        {name: images.depth for name, images in cameras.items()}, composition.task is not None)
    missing = [package for package, types in (
        ('tf2_msgs', visualization_topics.TFMessage),
        ('moveit_msgs', visualization_topics.moveit_msgs))
        if types is None]
    for direction, seen in (
            (PUBLISHED, client.node.get_publisher_names_and_types_by_node),
            (SUBSCRIBED, client.node.get_subscriber_names_and_types_by_node)):
        wanted = {as_seen(t.name): t.type for t in expected if t.direction == direction
                  and t.type.partition('/')[0] not in missing}

        def found(seen=seen):
            return {name: _either(kinds[0].replace('/msg/', '/'))
                    for name, kinds in seen('manip_sim', '/')
                    if name not in OF_ROS and '/_action/' not in name}
        client.spin_until(lambda found=found, wanted=wanted: len(found()) >= len(wanted))
        assert found() == wanted
    services = {name: kinds[0].replace('/srv/', '/') for name, kinds
                in client.node.get_service_names_and_types_by_node('manip_sim', '/')
                if kinds[0].partition('/')[0] not in OWN_SERVICES and '/_action/' not in name}
    assert services == {as_seen(s.name): s.type for s in SERVICES}
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    ours = {n for n in names if not re.match('qos_overrides|use_sim_time|start_type', n)}
    assert ours == set(given.specs)


@pytest.mark.full
@pytest.mark.parametrize('make, direction', [
    (lambda node: node.create_publisher(JointState, 'more', 10), PUBLISHED),
    (lambda node: node.create_subscription(JointState, 'joint_states', print, 10), SUBSCRIBED)])
def test_a_topic_that_is_not_in_the_table_cannot_be_made(make, direction, serve):
    with pytest.raises(ManipSimError, match=f"^'[a-z_]+' is {direction} but not in the table of "
                                            'topics$'):
        make(serve())


@pytest.mark.parametrize('row', TOPICS, ids=lambda row: row.name)
def test_a_row_has_a_type_that_exists_and_functions_of_its_own_direction(row):
    package = row.type.partition('/')[0]
    if package not in ('tf2_msgs', 'moveit_msgs'):
        assert message_class(row.type).__name__ == row.type.partition('/')[2]
    assert bool(row.rate) == (row.direction == PUBLISHED)
    assert row.latched <= (row.depth == 1)


def _either(kind):
    """Return the type of a state of controllers as it is without control_msgs."""
    return kind.replace('control_msgs/JointTrajectoryControllerState',
                        'trajectory_msgs/JointTrajectory')
