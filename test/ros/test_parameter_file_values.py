# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files of the node's parameters: what is read without ROS is what rclpy reads."""

from harness import DOMAIN
import pytest
import rclpy
from rclpy.node import Node

from manip_sim.errors import ManipSimError
from manip_sim.interface.parameter_spec import read_parameters

SCALARS = ('1', '-2', '+3', '0x10', '010', '1.5', '.5', '5.', '1e3', '1E-3', '-.inf', 'inf',
           'yes', 'No', 'on', 'OFF', 'y', 'true', 'null', '~', '1:30', '2020-01-01', '1_000',
           'nano', '"1"', "'true'", '1.2.3', 'a b', '[1, 2]', '[1.0, 2.5]', '[a, "b"]',
           '[true, off]', '{b: 1, c: {d: x}}', '"{b: 1}"')
NODES = ('/**', 'manip_sim', '/manip_sim', '/*', '**', '*', '/**/manip_sim', '/*/manip_sim', 'sim',
         '/cell/manip_sim')


def as_rclpy_has_them(file):
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(file)], context=context,
               domain_id=DOMAIN)
    node = Node('manip_sim', context=context, enable_rosout=False, start_parameter_services=False)
    found = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    node.destroy_node()
    rclpy.shutdown(context=context)
    return found


def test_values_are_what_rclpy_reads(written):
    lines = ''.join(f'    p{number}: {scalar}\n' for number, scalar in enumerate(SCALARS))
    file = written(f'/**:\n  ros__parameters:\n{lines}')
    ours, theirs = read_parameters(file), as_rclpy_has_them(file)
    assert ours == theirs
    assert {name: type(value) for name, value in ours.items()} == {
        name: type(value) for name, value in theirs.items()}


@pytest.mark.parametrize('node', NODES)
def test_a_section_is_for_the_nodes_that_rclpy_takes_it_for(node, written):
    file = written(f"'{node}':\n  ros__parameters: {{a: 1}}\n")
    if as_rclpy_has_them(file):
        assert read_parameters(file) == {'a': 1}
    else:
        with pytest.raises(ManipSimError, match='has no parameters for /manip_sim, it is for '):
            read_parameters(file)


@pytest.mark.parametrize('nodes', [
    ('/**', 'manip_sim'), ('manip_sim', '/**'), ('/*', '/manip_sim')])
def test_of_two_sections_the_lower_one_counts(nodes, written):
    file = written(''.join(f"'{node}':\n  ros__parameters: {{a: {number}, n{number}: 0}}\n"
                           for number, node in enumerate(nodes)))
    assert read_parameters(file) == as_rclpy_has_them(file) == {'a': 1, 'n0': 0, 'n1': 0}
