# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A node without the ROS packages that pip does not have."""

import pytest

from manip_sim.ros import action_servers, standard_services, visualization_topics
from manip_sim.ros.messages import import_optional


def test_a_package_that_is_not_installed_is_none_and_one_that_is_broken_an_error(
        tmp_path, monkeypatch):
    (tmp_path / 'broken_msgs').mkdir()
    (tmp_path / 'broken_msgs' / '__init__.py').write_text('import not_there_at_all\n')
    monkeypatch.syspath_prepend(tmp_path)
    assert import_optional('not_there_msgs.msg') is None
    assert import_optional('std_msgs.msg').String
    with pytest.raises(ModuleNotFoundError, match='not_there_at_all'):
        import_optional('broken_msgs.msg')


def test_packages_that_are_missing_are_noted_in_one_line_with_the_way_to_get_them(
        serve, client, monkeypatch):
    monkeypatch.setenv('ROS_DISTRO', 'kilted')
    monkeypatch.setattr(action_servers, 'ACTION_TYPES', None)
    monkeypatch.setattr(standard_services, 'AVAILABLE', False)
    monkeypatch.setattr(visualization_topics, 'TFMessage', None)
    monkeypatch.setattr(visualization_topics, 'PLANS', False)
    log = client.log()
    serve()
    client.spin_until(lambda: any('not installed' in line for line in log))
    assert [line for line in log if 'not installed' in line] == [
        'without packages that are not installed, there are no planning scene for MoveIt '
        '(moveit_msgs), /tf and /tf_static (tf2_msgs), actions (control_msgs), standard '
        'simulation services (simulation_interfaces); they are not available from pip: apt '
        'install ros-kilted-moveit-msgs ros-kilted-tf2-msgs ros-kilted-control-msgs '
        'ros-kilted-simulation-interfaces, or build them']
