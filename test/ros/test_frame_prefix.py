# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the parameter ``frame_prefix`` puts before names is understood in commands too."""

import copy

from geometry_msgs.msg import PoseStamped, TwistStamped
import pytest


@pytest.mark.full
@pytest.mark.parametrize('prefix', ['cell/', ''])
def test_commands_take_frames_as_the_messages_of_the_node_call_them(prefix, serve, client):
    serve(robot='UR5e', frame_prefix='cell/')
    poses = client.listen(PoseStamped, 'right/eef_pose')
    client.spin_until(lambda: poses)
    target = copy.deepcopy(poses[-1])
    assert target.header.frame_id == 'cell/world'
    target.header.frame_id = f'{prefix}world'
    goal = target.pose.position.z = target.pose.position.z + 0.05
    client.publish('right/target_pose', target)
    client.spin_until(lambda: abs(poses[-1].pose.position.z - goal) < 1e-3)
    twist = TwistStamped()
    twist.header.frame_id, twist.twist.linear.z = f'{prefix}robot0_base', 0.05

    def has_moved():
        client.publish('right/target_twist', twist)
        return poses[-1].pose.position.z > goal + 0.01
    client.spin_until(has_moved)
