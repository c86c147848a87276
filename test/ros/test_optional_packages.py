# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A node without the ROS packages that pip does not have."""

import pytest

from manip_sim.ros import action_servers, scene, standard_services, transforms
from manip_sim.ros.optional_packages import import_optional


def test_a_package_that_is_not_installed_is_none_and_one_that_is_broken_an_error(
        tmp_path, monkeypatch):
    (tmp_path / 'broken_msgs').mkdir()
    (tmp_path / 'broken_msgs' / '__init__.py').write_text('import not_there_at_all\n')
    monkeypatch.syspath_prepend(tmp_path)
    assert import_optional('not_there_msgs.msg') is None
    assert import_optional('std_msgs.msg').String
    with pytest.raises(ModuleNotFoundError, match='not_there_at_all'):
        import_optional('broken_msgs.msg')


def test_each_package_that_is_missing_is_noted_with_the_way_to_get_it(
        serve, client, monkeypatch):
    monkeypatch.setattr(action_servers, 'ACTION_TYPES', None)
    monkeypatch.setattr(standard_services, 'AVAILABLE', False)
    monkeypatch.setattr(transforms, 'TFMessage', None)
    monkeypatch.setattr(scene, 'PLANS', False)
    log = client.log()
    serve()
    end = 'is not installed; it is not available from pip: apt install'
    expected = {f'no /tf and /tf_static: tf2_msgs {end} ros-jazzy-tf2-msgs, or build it',
                f'no planning scene for MoveIt: moveit_msgs {end} ros-jazzy-moveit-msgs, or '
                'build it',
                f'no actions: control_msgs {end} ros-jazzy-control-msgs, or build it',
                f'no standard simulation services: simulation_interfaces {end} '
                'ros-jazzy-simulation-interfaces, or build it'}
    client.spin_until(lambda: expected <= set(log))
