# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The tables of topics, services and parameters against running nodes."""

import re

import pytest
from rcl_interfaces.srv import ListParameters

from manip_sim.interface import (
    PARAMETERS, parameters_of, PUBLISHED, SERVICES, SUBSCRIBED, topics_of)
from manip_sim.ros.parameters import node_parameters, robot_parameters

OF_ROS = {'/rosout', '/parameter_events'}


def as_seen(name):
    """Return the full name of a topic or service of the node ``/manip_sim``."""
    if name.startswith('~/'):
        return f'/manip_sim/{name[2:]}'
    return name if name.startswith('/') else f'/{name}'


@pytest.mark.parametrize('parameters', [
    {}, {'gripper': 'none'}, {'robot': 'PandaOmron'}, {'robot': 'GR1'},
    {'robot': 'UR5e', 'gripper': 'WipingGripper'}], ids=str)
def test_a_node_has_the_topics_and_parameters_of_the_tables(parameters, serve, client):
    node = serve(**parameters)
    client.state()
    simulation = node.simulation
    expected = topics_of(simulation.parts, simulation.joints.twist_indices is not None)
    for direction, seen in (
            (PUBLISHED, client.node.get_publisher_names_and_types_by_node),
            (SUBSCRIBED, client.node.get_subscriber_names_and_types_by_node)):
        found = {name: kinds[0].replace('/msg/', '/') for name, kinds in seen('manip_sim', '/')
                 if name not in OF_ROS}
        wanted = {as_seen(t.name): t.type for t in expected if t.direction == direction}
        assert {name: _either(kind) for name, kind in found.items()} == wanted
    services = dict(client.node.get_service_names_and_types_by_node('manip_sim', '/'))
    assert {as_seen(s.name): s.type for s in SERVICES}.items() <= {
        name: kinds[0].replace('/srv/', '/') for name, kinds in services.items()}.items()
    names = client.call(ListParameters, 'manip_sim/list_parameters').result.names
    ours = {n for n in names if not re.match('qos_overrides|use_sim_time|start_type', n)}
    assert ours == {parameter.name for parameter in parameters_of(simulation.parts)}


def _either(kind):
    """Return the type of a state of controllers as it is without control_msgs."""
    return kind.replace('control_msgs/JointTrajectoryControllerState',
                        'trajectory_msgs/JointTrajectory')


def test_defaults_and_units_are_those_that_the_node_declares():
    declared = [*node_parameters(), *robot_parameters(['arm', 'base'])]
    listed = {p.name: p for p in PARAMETERS if '<part>' not in p.name}
    for part in ('arm', 'base'):
        for pattern in (p for p in PARAMETERS if '<part>' in p.name):
            listed[pattern.name.replace('<part>', part)] = pattern
    assert [spec.name for spec in declared] == [
        *(p.name for p in PARAMETERS if '<part>' not in p.name),
        'control_mode.arm', 'command_timeout.arm', 'control_mode.base', 'command_timeout.base']
    for spec in declared:
        ours = listed[spec.name]
        default = ours.of_base if spec.name.endswith('.base') else ours.default
        assert (default, type(default)) == (spec.default, type(spec.default)), spec.name
        assert (ours.unit, ours.live) == (spec.unit, spec.live), spec.name
