# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The usage example of the README and the public interface, as written, without ROS."""

import subprocess
import sys

USAGE = """
import sys

from manip_sim.models.robots import Panda
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.bases import RethinkMount

robot = Panda(idn=0)
robot.add_gripper(PandaGripper(), arm_name=robot.eef_name['right'])
robot.add_base(RethinkMount())
robot.arm_type, robot.eef_name, robot.dof, robot.cameras, robot.models
robot.update_joints(); robot.update_actuators()
robot.arm_joints, robot.base_joints, robot.torso_joints, robot.head_joints, robot.legs_joints
robot.arm_actuators, robot.base_actuators, robot.torso_actuators, robot.head_actuators
robot.default_gripper, robot.default_base, robot.default_controller_config
robot.init_qpos, robot.base_xpos_offset
assert robot.format_action('arm', [0.0] * 7).shape == (7,)
model = robot.compile()
assert (model.nq, model.nu) == (9, 9)
assert not [name for name in sys.modules if name.split('.')[0] in ('rclpy', 'sensor_msgs')]
"""


def test_the_usage_example_runs_and_imports_no_ros():
    subprocess.run([sys.executable, '-c', USAGE], check=True)
