# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``<arm>/nudge`` turns the first joint of a robot; ``~/nudged`` repeats what has come."""

from geometry_msgs.msg import Vector3

from manip_sim.interface.topics import PUBLISHED, SUBSCRIBED, Topic
from manip_sim.ros.feature import create_output, Feature


class Nudge(Feature):
    """Turns the first joint by ``x`` [rad]."""

    topics = [Topic('<arm>/nudge', 'geometry_msgs/Vector3', SUBSCRIBED, 'turn of joint 1 [rad]'),
              Topic('~/nudged', 'geometry_msgs/Vector3', PUBLISHED, 'the last turn [rad]')]

    def __init__(self, context):
        self._context, self._subscriptions = context, {}
        self._output = create_output(context, self.topics[1])
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)

    def robot_added(self, scope, robot):
        self._subscriptions[scope] = [self._context.node.create_subscription(
            Vector3, scope.topic(f'{arm}/nudge'),
            lambda turn: self._nudge(robot, turn), 10) for arm in robot.end_effectors]

    def robot_removed(self, scope):
        for subscription in self._subscriptions.pop(scope):
            self._context.node.destroy_subscription(subscription)

    def _nudge(self, robot, turn):
        joint = robot.joint_names[:1]
        goal = self._context.thread.call(lambda: robot.state().position[:1] + turn.x)
        command = robot.parse.joint_command(joint, position=goal)
        self._context.thread.submit(command, robot=robot.name)
        self._output.publish(turn)
