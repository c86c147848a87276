# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Leader arms of LeRobot that are robots of a running node, which something else moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from lerobot_robot_manip_sim.robots import NodeConfig, NodeDevice, SO101Device


@TeleoperatorConfig.register_subclass('manip_sim_leader')
@dataclass(kw_only=True)
class ManipSimLeaderConfig(TeleoperatorConfig, NodeConfig):
    """A robot of a node."""


class ManipSimLeader(NodeDevice, Teleoperator):
    """A robot of a running node whose positions another one follows."""

    config_class = ManipSimLeaderConfig
    name = 'manip_sim_leader'

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    def get_action(self) -> dict[str, Any]:
        """
        Return the newest positions.

        :raises ManipSimError: if the node is gone, or not connected
        """
        return self._robot.positions()

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """
        Do nothing.

        :param feedback: is ignored
        """


@TeleoperatorConfig.register_subclass('manip_sim_so101_leader')
@dataclass(kw_only=True)
class ManipSimSO101LeaderConfig(ManipSimLeaderConfig):
    """
    An SO-101 of a node.

    :ivar use_degrees: whether joints of the arm are in degrees; else their ranges are -100 to 100
    """

    use_degrees: bool = True


class ManipSimSO101Leader(SO101Device, ManipSimLeader):
    """An SO-101 of a running node with the keys and units of LeRobot's leader."""

    config_class = ManipSimSO101LeaderConfig
    name = 'manip_sim_so101_leader'
