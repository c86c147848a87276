# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A policy in a ROS node, in a process of its own: it moves the end effector to the goal."""

import json
import os
import signal
import sys

from geometry_msgs.msg import PoseStamped
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String


class Towards(Node):
    """Answers each pose of the end effector; ``dies_after`` answers it kills itself."""

    def __init__(self, kind, dies_after):
        super().__init__('towards', namespace='/policy')
        self._kind, self._left = kind, dies_after
        self._about = {}
        self._answers = self.create_publisher(JointState, 'action', 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, 'episode', self._begin, latched)
        self.create_subscription(PoseStamped, 'right/eef_pose', self._act, 10)

    def _begin(self, message):
        self._about = json.loads(message.data)

    def _act(self, pose):
        stamp = pose.header.stamp
        if not self._about or stamp.sec * 10**9 + stamp.nanosec < self._about['begins_ns']:
            return
        if self._left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        self._left -= 1
        here = pose.pose.position
        way = (np.array(self._about['goal']) - [here.x, here.y, here.z]) / 0.05
        numbers = [*np.clip(way, -1.0, 1.0), 0.0, 0.0, 0.0, 0.0]
        answer = JointState(position=[float(number) for number in numbers])
        if self._kind == 'names':
            answer.name = self._about['names'][::-1]
            answer.position = answer.position[::-1]
        if self._kind == 'nan':
            answer.position[0] = float('nan')
        if self._kind == 'short':
            answer.position = answer.position[:3]
        if self._kind == 'unknown':
            answer.name = ['elbow']
        if self._kind != 'unstamped':
            answer.header.stamp = stamp
        self._answers.publish(answer)


rclpy.init()
rclpy.spin(Towards(sys.argv[1], int(sys.argv[2])))
