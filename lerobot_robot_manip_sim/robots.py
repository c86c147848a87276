# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots of LeRobot that are robots of a running node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from lerobot.robots import Robot, RobotConfig
from lerobot.robots.utils import ensure_safe_goal_position

from manip_sim.env.ros import NodeRobot
from manip_sim.lerobot_units import plain_scales, POSITION, Scale, SO101_MOTORS, so101_scales


@dataclass(kw_only=True)
class ManipSimCameraConfig:
    """
    A camera of the node, which the key names.

    :ivar width: of its images [pixels]
    :ivar height: of its images [pixels]
    :ivar fps: images per second that the node makes [Hz]
    """

    width: int
    height: int
    fps: int


@dataclass(kw_only=True)
class NodeConfig:
    """
    A robot of a node, whichever side of LeRobot it is on.

    :ivar node: its name, with its namespace
    :ivar robot: name of the robot in a node with several; empty for the only one
    :ivar parts: that are observed and commanded
    :ivar domain_id: of ROS; None for that of the environment
    """

    node: str = '/manip_sim'
    robot: str = ''
    parts: list[str] = field(default_factory=lambda: ['arm', 'right/gripper'])
    domain_id: int | None = None


class NodeDevice:
    """
    A robot of a node as a device of LeRobot; its keys are ``<joint>.pos`` in rad or m.

    The joints are those that the node publishes of the parts, without the finger joints that
    follow others. To name them, the node is asked before :meth:`connect`.

    :param config: names the node, the parts and the cameras
    """

    def __init__(self, config: Any) -> None:
        # Of LeRobot's class beside it.
        super().__init__(config)  # type: ignore[call-arg]
        self.config = config
        #: LeRobot counts them.
        self.cameras: dict[str, ManipSimCameraConfig] = getattr(config, 'cameras', {})
        self._robot = NodeRobot(
            config.node, config.robot, config.parts,
            {name: (camera.height, camera.width) for name, camera in self.cameras.items()},
            self._scales, config.domain_id)

    def _scales(self, ranges: Mapping[str, tuple[float, float]]) -> dict[str, Scale]:
        return plain_scales(ranges)

    @cached_property
    def _keys(self) -> list[str]:
        was_connected = self.is_connected
        if not was_connected:
            self._robot.connect()
        keys = [name + POSITION for name in self._robot.scales]
        if not was_connected:
            self.disconnect()
        return keys

    @property
    def action_features(self) -> dict[str, type]:
        """Keys of an action: positions."""
        return dict.fromkeys(self._keys, float)

    @property
    def is_connected(self) -> bool:
        """True between :meth:`connect` and :meth:`disconnect`."""
        return self._robot.is_connected

    @property
    def is_calibrated(self) -> bool:
        """True: a simulated robot needs no calibration."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """
        Find the node, and configure it.

        :param calibrate: has no effect
        :raises ManipSimError: if the node, a part or a camera is missing
        """
        self._robot.connect()
        self.configure()

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """End the connection; a robot holds its last goal."""
        self._robot.close()


class SO101Device(NodeDevice):
    """An SO-101 of a node, with the keys and units of LeRobot's own SO-101."""

    def _scales(self, ranges: Mapping[str, tuple[float, float]]) -> dict[str, Scale]:
        return so101_scales(ranges, self.config.use_degrees)

    @cached_property
    def _keys(self) -> list[str]:
        return [motor + POSITION for motor in SO101_MOTORS]


@RobotConfig.register_subclass('manip_sim')
@dataclass(kw_only=True)
class ManipSimConfig(RobotConfig, NodeConfig):
    """
    A robot of a node.

    :ivar cameras: of the node that are observed
    :ivar max_relative_target: largest way from the present position to a goal, in LeRobot's
        numbers; one for all, or by key
    """

    cameras: dict[str, ManipSimCameraConfig] = field(default_factory=dict)
    max_relative_target: float | dict[str, float] | None = None


class ManipSim(NodeDevice, Robot):
    """A robot of a running node."""

    config_class = ManipSimConfig
    name = 'manip_sim'

    def configure(self) -> None:
        """
        Put the arm into position mode.

        :raises ManipSimError: if the node rejects that
        """
        self._robot.set_position_mode()

    @property
    def observation_features(self) -> dict[str, Any]:
        """Keys of an observation: positions, and images with their shape."""
        return {**self.action_features, **{name: (camera.height, camera.width, 3)
                                           for name, camera in self.cameras.items()}}

    def get_observation(self) -> dict[str, Any]:
        """
        Return the newest positions and images.

        :raises ManipSimError: if the node is gone, or not connected
        """
        return {**self._robot.positions(), **self._robot.images()}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """
        Lead joints to positions.

        :param action: by key; what is no position is left out
        :returns: the positions that were sent
        :raises ManipSimError: if the node is not connected, or a number cannot be used
        """
        goals = {key: float(value) for key, value in action.items() if key.endswith(POSITION)}
        if self.config.max_relative_target is not None:
            present = self._robot.positions()
            goals = ensure_safe_goal_position(
                {key: (goal, present[key]) for key, goal in goals.items()},
                self.config.max_relative_target)
        self._robot.command(goals)
        return goals


@RobotConfig.register_subclass('manip_sim_so101_follower')
@dataclass(kw_only=True)
class ManipSimSO101FollowerConfig(ManipSimConfig):
    """
    An SO-101 of a node.

    :ivar use_degrees: whether joints of the arm are in degrees; else their ranges are -100 to 100
    """

    use_degrees: bool = True


class ManipSimSO101Follower(SO101Device, ManipSim):
    """
    An SO-101 of a running node with the keys, units and robot type of LeRobot's follower.

    LeRobot compares these before it merges data sets, or runs a policy.
    """

    config_class = ManipSimSO101FollowerConfig
    name = 'so_follower'
