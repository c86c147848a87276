# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cartesian commands of a robot's arms over topics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

from geometry_msgs.msg import PoseStamped, TwistStamped
from std_msgs.msg import Float64MultiArray

from manip_sim.control.cartesian.reports import CartesianReport
from manip_sim.control.commands import Command
from manip_sim.ros.command_subscribers import CommandSubscribers
from manip_sim.ros.messages import numbers_of

if TYPE_CHECKING:
    from manip_sim.ros.sim_node import SimNode


class CartesianSubscribers:
    """
    Subscriptions to the Cartesian command topics of the arms of a robot.

    :param node: the node, with the parameters of the robot
    :param commands: the subscriptions of the robot, which count the messages
    """

    def __init__(self, node: SimNode, commands: CommandSubscribers) -> None:
        self._node, self._robot = node, commands.robot
        self._parse = commands.robot.parse_cartesian
        commands.subscribe({'target_pose': self._pose, 'target_twist': self._twist,
                            'pose_command': self._action})

    def _pose(self, arm: str, message: PoseStamped) -> Sequence[Command]:
        return [self._parse.pose(arm, numbers_of(message.pose.position),
                                 numbers_of(message.pose.orientation), self._frame_of(message))]

    def _twist(self, arm: str, message: TwistStamped) -> Sequence[Command]:
        return [self._parse.twist(arm, numbers_of(message.twist.linear),
                                  numbers_of(message.twist.angular), self._frame_of(message))]

    def _frame_of(self, message: PoseStamped | TwistStamped) -> str:
        frame_id: str = message.header.frame_id
        return frame_id.removeprefix(self._node.frame_prefix)

    def _action(self, arm: str, message: Float64MultiArray) -> Sequence[Command]:
        return [self._parse.action(arm, message.data)]


def reports_of(commands: CommandSubscribers, part: str) -> list[CartesianReport]:
    """Return the reports of a part's arms: what kept end effectors from their targets."""
    robot = commands.robot
    if part not in robot.parts:
        return []
    return [report for arm, report in robot.joints.cartesian.reports.items()
            if robot.parts[arm].atomic == robot.parts[part].atomic]


def counts_of(reports: Sequence[CartesianReport]) -> dict[str, Any]:
    """Return the counts of reports as values of a diagnostic status."""
    return {f'cartesian_{kind}': sum(report.counts[kind] for report in reports)
            for kind in (reports[0].counts if reports else ())}
