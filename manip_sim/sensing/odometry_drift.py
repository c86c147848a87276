# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Odometry from wheels that slip, which drifts away from the pose of a base."""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.sensing.sensor_noise import Channel
from manip_sim.sensing.settings import SensingSettings

#: Way that wheels roll while a base turns by 1 rad: half the track of a base of usual width [m].
_HALF_TRACK_M = 0.25
#: A pose in the plane: x and y [m], and the heading [rad].
Planar = tuple[float, float, float]


class OdometryChannel(Channel):
    """
    The drift of the odometry of a base.

    In each control period wheels measure the motion of the base in its own axes, times one and
    the slip, a share that is drawn from the seed for x, y and the heading, and with a random walk
    whose variance grows with the way that wheels roll. The sum of these motions is the measured
    pose. At the start it is the true one.

    :param name: of the odometry, unique in its world
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, 13)
        self._slip = 0.0
        self._spread = (0.0, 0.0, 0.0)
        #: The true and the measured pose in the last period, or None at the start.
        self.poses: tuple[Planar, Planar] | None = None

    def adapt(self, settings: SensingSettings) -> None:
        """Take over the settings of the robot; without any, it begins again."""
        self._slip, drift, heading = (settings[f'noise.{name}'] for name in (
            'odom_slip', 'odom_drift', 'odom_heading_drift'))
        self._spread = drift, drift, heading
        if not self.drifts:
            self.poses = None

    @property
    def drifts(self) -> bool:
        """True if measured poses differ from the truth."""
        return self._slip > 0.0 or any(self._spread)

    def _rates(self) -> list[float]:
        """Return what wheels measure of a motion of 1 along x, along y and of the heading."""
        return [1.0 + self._slip * share for share in self.rows('slip', 3).row(0).tolist()]

    def end_period(self, exact: FloatArray, count: int) -> None:
        """
        Take over the motion in a control period, if it drifts.

        :param exact: true pose and twist, shape (13,)
        :param count: steps since the reset
        """
        present = _planar(exact)
        before, measured = self.poses or (present, present)
        motion = _times(_inverse(before), present)
        motion = *motion[:2], math.remainder(motion[2], 2.0 * math.pi)
        way = math.hypot(*motion[:2]) + _HALF_TRACK_M * abs(motion[2])
        x, y, heading = (
            rate * part + spread * math.sqrt(way) * number for rate, part, spread, number in zip(
                self._rates(), motion, self._spread, self.rows('drift', 3).row(count).tolist()))
        self.poses = present, _times(measured, (x, y, heading))

    @property
    def frame(self) -> Planar:
        """Pose of the frame of the odometry in that where it would be without drift."""
        if self.poses is None:
            return 0.0, 0.0, 0.0
        true, measured = self.poses
        return _times(true, _inverse(measured))

    def measure(self, exact: FloatArray, count: int, timestep_s: float) -> FloatArray:
        """
        Return what wheels measure.

        :param exact: true pose and twist, shape (13,)
        :param count: steps from the reset to their instant
        :returns: shape (13,), a copy
        """
        if not self.drifts:
            return exact.copy()
        values = exact.copy()
        values[:7] = _moved(_inverse(self.frame), exact[:7])
        of_x, of_y, of_heading = self._rates()
        values[7] *= of_x
        values[8] *= of_y
        values[12] *= of_heading
        return values


def _moved(planar: Planar, pose: FloatArray) -> FloatArray:
    """
    Return a pose in another frame.

    :param planar: of its frame in the other one
    :param pose: position [m] and quaternion x, y, z, w, shape (7,)
    """
    x, y, heading = planar
    (px, py, pz), (qx, qy, qz, qw) = pose[:3].tolist(), pose[3:].tolist()
    sine, cosine = math.sin(heading), math.cos(heading)
    half_sine, half_cosine = math.sin(0.5 * heading), math.cos(0.5 * heading)
    return np.array([
        x + cosine * px - sine * py, y + sine * px + cosine * py, pz,
        half_cosine * qx - half_sine * qy, half_cosine * qy + half_sine * qx,
        half_cosine * qz + half_sine * qw, half_cosine * qw - half_sine * qz])


def _planar(exact: FloatArray) -> Planar:
    x, y, _, _, _, qz, qw = exact[:7].tolist()
    return x, y, 2.0 * math.atan2(qz, qw)


def _times(first: Planar, second: Planar) -> Planar:
    sine, cosine = math.sin(first[2]), math.cos(first[2])
    return (first[0] + cosine * second[0] - sine * second[1],
            first[1] + sine * second[0] + cosine * second[1], first[2] + second[2])


def _inverse(pose: Planar) -> Planar:
    x, y, heading = pose
    sine, cosine = math.sin(heading), math.cos(heading)
    return -cosine * x - sine * y, sine * x - cosine * y, -heading
