# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files of the node's parameters, read without ROS."""

import pytest

from manip_sim.errors import ManipSimError
from manip_sim.interface.parameter_spec import read_parameters


def test_sections_of_nodes_in_namespaces_are_left_out(written):
    file = written('cell:\n  manip_sim:\n    ros__parameters: {a: {b: 1}}\n'
                   'manip_sim:\n  ros__parameters: {a: {c: 2}}\n')
    assert read_parameters(file) == {'a.c': 2}


@pytest.mark.parametrize(('text', 'what'), [
    ('', "it has no key 'ros__parameters' below the name of a node"),
    ('robot: Panda\n', "it has no key 'ros__parameters'"),
    ('other:\n  ros__parameters: {a: 1}\n', "has no parameters for /manip_sim, it is for 'other'"),
    ('/**:\n  ros__parameters: 3\n', r"'\*\*': ros__parameters must hold names and values"),
    ('/**:\n  ros__parameters: {a: 1, a: 2}\n', "'a' appears twice"),
    ('/**:\n  ros__parameters: {a: !!python/name:os.system }\n', 'is invalid or unsafe YAML'),
    ('- 1\n', 'must hold keys and values')])
def test_a_file_that_cannot_be_used_is_told(text, what, written):
    with pytest.raises(ManipSimError, match=what):
        read_parameters(written(text))


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ManipSimError, match='no such YAML file'):
        read_parameters(tmp_path / 'none.yaml')
