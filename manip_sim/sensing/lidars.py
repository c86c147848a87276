# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Measurements of lidars: distances along their rays to the shapes that can collide."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
import functools
import math
from typing import Protocol

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.sensing.instruments import Present
from manip_sim.sensing.randomness import generator
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.sensing.sensor_noise import Channel, SensingSettings

#: Rays of one lidar at most, as many as the densest ones on the market have: 128 rings of 2048.
MAX_RAYS = 128 * 2048
MAX_RINGS, MAX_RANGE_M, MAX_NOISE_M = 128, 1000.0, 10.0
#: By how much the field of view may miss a full turn, which would have its first ray twice [rad].
_FULL_TURN_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Rays:
    """
    The rays of a lidar, and how far they go.

    :ivar samples: rays of a ring
    :ivar rings: one is a planar scanner
    :ivar angle_min: of the first ray of a ring, about z from x [rad]
    :ivar angle_max: of the last one; of a full turn, of the one after the last one [rad]
    :ivar elevation_min: of the first ring, above the plane of x and y [rad]
    :ivar elevation_max: of the last one [rad]
    :ivar range_min: below it is too near to measure [m]
    :ivar range_max: beyond it is nothing [m]
    """

    samples: int = 360
    rings: int = 1
    angle_min: float = -math.pi
    angle_max: float = math.pi
    elevation_min: float = -math.pi / 12.0
    elevation_max: float = math.pi / 12.0
    range_min: float = 0.1
    range_max: float = 30.0

    @property
    def angle_increment(self) -> float:
        """Angle between two rays of a ring [rad]."""
        span = self.angle_max - self.angle_min
        full = span > 2.0 * math.pi - _FULL_TURN_TOLERANCE
        return span / (self.samples if full else self.samples - 1)

    def directions(self) -> FloatArray:
        """Return unit vectors in the frame of the lidar, shape (rings, samples, 3)."""
        angles = self.angle_min + self.angle_increment * np.arange(self.samples)
        elevations = (np.zeros(1) if self.rings == 1 else
                      np.linspace(self.elevation_min, self.elevation_max, self.rings))
        up, along = np.sin(elevations)[:, np.newaxis], np.cos(elevations)[:, np.newaxis]
        return np.stack([along * np.cos(angles), along * np.sin(angles),
                         up + np.zeros(self.samples)], axis=-1)

    def limited(self, ranges: FloatArray) -> FloatArray:
        """Return ranges as REP 117 has them: +Inf beyond the greatest, -Inf below the least."""
        return np.where(ranges > self.range_max, np.inf,
                        np.where(ranges < self.range_min, -np.inf, ranges))


class Lidar:
    """
    A lidar in a world.

    :param name: of the lidar and of its site, whose x is ahead and whose z is up
    :ivar directions: of the rays in the frame of the site, shape (rings, samples, 3)
    """

    def __init__(self, name: str, rays: Rays) -> None:
        self.name = name
        self.rays = rays
        self.directions = rays.directions()
        self._flat = self.directions.reshape(-1, 3)

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
        """
        Return the exact distances to the first hits, at the instant of the last forward.

        The body that carries the lidar is transparent to it.

        :returns: ring by ring [m], limited as :meth:`Rays.limited`, shape (rings * samples,)
        """
        site, count = int(model.site(self.name).id), len(self._flat)
        body = int(model.site_bodyid[site])
        vectors = np.einsum('ij,nj->ni', data.site_xmat[site].reshape(3, 3), self._flat)
        ranges, geoms = np.empty(count), np.empty(count, np.int32)
        # Elements of other bodies stand before the floor, which belongs to the world too.
        mujoco.mj_multiRay(
            model, data, data.site_xpos[site], vectors.ravel(), None, 1, body or -1, geoms,
            ranges, None, count, self.rays.range_max)
        ranges[geoms < 0] = np.inf
        return self.rays.limited(ranges)


class LidarChannel(Channel):
    """
    The noise of a lidar: white, on each distance.

    :param own_sd: standard deviation that it has in any case [m]
    """

    def __init__(self, lidar: Lidar, own_sd: float) -> None:
        super().__init__(f'lidar {lidar.name}', lidar.rays.samples * lidar.rays.rings)
        self._rays = lidar.rays
        self._own_sd = own_sd
        self.is_noisy = own_sd > 0.0

    def adapt(self, settings: SensingSettings) -> None:
        """Take over the settings of the robot."""
        self.sd = np.full(self.width, self._own_sd + settings['noise.range'])

    def measure(self, exact: FloatArray, count: int, timestep_s: float) -> FloatArray:
        """Return what the lidar makes of exact distances, as :meth:`Channel.measure`."""
        if not self.sd[0]:
            return exact
        noise = generator(self.seed, self.name, count).standard_normal(self.width)
        # Rays that hit nothing have no noise.
        return self._rays.limited(exact + self.sd * noise)


class FixedLidar(Protocol):
    """A lidar that is fixed to a body."""

    @property
    def name(self) -> str:
        """Of the lidar and its site."""

    @property
    def body(self) -> str:
        """Name of the body."""

    @property
    def rays(self) -> Rays:
        """Its rays."""

    @property
    def noise(self) -> float:
        """Standard deviation that it has in any case [m]."""


class Lidars(Mapping[str, Lidar]):
    """
    The lidars of a running world, by name; each has the seed, noise and latency of a robot.

    :param sensing_of: returns the measurements of the robot that has a body
    """

    def __init__(self, present: Present, fixed_lidars: Iterable[FixedLidar],
                 sensing_of: Callable[[str], RobotSensing]) -> None:
        self._present = present
        self._all: dict[str, Lidar] = {}
        self._sensing: dict[str, RobotSensing] = {}
        for fixed in fixed_lidars:
            lidar = self._all[fixed.name] = Lidar(fixed.name, fixed.rays)
            sensing = self._sensing[fixed.name] = sensing_of(fixed.body)
            sensing.add(self._channel(fixed.name), functools.partial(self.exact, fixed.name),
                        LidarChannel(lidar, fixed.noise))

    @staticmethod
    def _channel(name: str) -> str:
        return f'lidar {name}'

    def sensing(self, name: str) -> RobotSensing:
        """Return the measurements of the robot whose noise and latency a lidar has."""
        return self._sensing[name]

    def exact(self, name: str) -> FloatArray:
        """Return the exact distances at present [m], shape (rings * samples,)."""
        return self._all[name].read(self._present.model, self._present.data)

    def measured(self, name: str) -> FloatArray:
        """Return the distances with noise and latency [m], shape (rings * samples,)."""
        return self._sensing[name].measured(self._channel(name))

    def __getitem__(self, name: str) -> Lidar:
        return self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)
