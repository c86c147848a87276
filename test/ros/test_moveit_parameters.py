# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""ROS takes the parameters of a MoveIt package under the names that MoveIt asks for."""

from harness import DOMAIN
import pytest
import rclpy
import yaml

from manip_sim.models import compose
from manip_sim.moveit import write_package


@pytest.mark.full
def test_move_group_gets_controllers_with_a_slash_in_their_names(tmp_path):
    write_package(compose('Panda'), tmp_path / 'panda_moveit_config')
    config = tmp_path / 'panda_moveit_config' / 'config'
    parameters = {
        **yaml.safe_load((config / 'moveit_controllers.yaml').read_text()),
        'robot_description_planning': yaml.safe_load((config / 'joint_limits.yaml').read_text()),
        'ompl': yaml.safe_load((config / 'ompl_planning.yaml').read_text())}
    file = tmp_path / 'parameters.yaml'
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': parameters}}))
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN, args=['--ros-args', '--params-file', str(file)])
    node = rclpy.create_node('move_group', context=context,
                             automatically_declare_parameters_from_overrides=True)
    try:
        def value(name):
            return node.get_parameter(name).value
        manager = 'moveit_simple_controller_manager'
        # The action is <controller>/<action_ns>.
        actions = {f'{name}/{value(f"{manager}.{name}.action_ns")}'
                   for name in value(f'{manager}.controller_names')}
        assert actions == {'arm/follow_joint_trajectory', 'right/gripper/gripper_cmd'}
        assert value(f'{manager}.right/gripper.joints') == ['gripper0_right_finger_joint1']
        limit = 'robot_description_planning.joint_limits.robot0_joint1'
        assert value(f'{limit}.max_velocity') == 2.175
        assert value(f'{limit}.has_acceleration_limits') is True
        assert value('ompl.arm.planner_configs')[0] == 'RRTConnect'
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
