# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Settings of noise, resolution and latency of a robot; all is zero by default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from types import MappingProxyType

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.quoting import format_value


@dataclass(frozen=True)
class SensingQuantity:
    """
    Something that can be set.

    :ivar maximum: greatest value; the least is 0, which is off
    """

    meaning: str
    unit: str
    maximum: float


#: Torques have the bias and drift of forces times this [m]: the ratio of the precisions of torque
#: and force of the sensor in the flange of the UR5e, 0.2 N m and 3.5 N in its data sheet, as
#: others quote it.
TORQUE_PER_FORCE_M = 0.2 / 3.5

_SD = 'Standard deviation of the white noise on'
_OFFSET = 'Standard deviation of the constant offset, drawn from the seed, of'
_WALK = 'Standard deviation after one second of the random walk of'
QUANTITIES: Mapping[str, SensingQuantity] = MappingProxyType({
    'noise.joint_position': SensingQuantity(f'{_SD} positions of hinges.', 'rad', 1.0),
    'noise.joint_velocity': SensingQuantity(f'{_SD} velocities of hinges.', 'rad/s', 10.0),
    'noise.joint_effort': SensingQuantity(f'{_SD} efforts of hinges.', 'N m', 1000.0),
    'noise.slide_position': SensingQuantity(f'{_SD} positions of slide joints.', 'm', 1.0),
    'noise.slide_velocity': SensingQuantity(f'{_SD} velocities of slide joints.', 'm/s', 10.0),
    'noise.slide_effort': SensingQuantity(f'{_SD} efforts of slide joints.', 'N', 1000.0),
    'noise.wrench_force': SensingQuantity(f'{_SD} forces.', 'N', 1000.0),
    'noise.wrench_torque': SensingQuantity(f'{_SD} torques.', 'N m', 1000.0),
    'noise.wrench_bias': SensingQuantity(
        f'{_OFFSET} forces; that of torques is 0.057 m times this.', 'N', 1000.0),
    'noise.wrench_drift': SensingQuantity(
        f'{_WALK} forces; that of torques is 0.057 m times this.', 'N/sqrt(s)', 100.0),
    'noise.imu_orientation': SensingQuantity(
        f'{_SD} each axis of orientations of IMUs.', 'rad', 1.0),
    'noise.imu_gyro': SensingQuantity(f'{_SD} angular velocities of IMUs.', 'rad/s', 10.0),
    'noise.imu_gyro_bias': SensingQuantity(
        f'{_OFFSET} angular velocities of IMUs.', 'rad/s', 10.0),
    'noise.imu_gyro_drift': SensingQuantity(
        f'{_WALK} angular velocities of IMUs.', 'rad/s/sqrt(s)', 1.0),
    'noise.imu_accelerometer': SensingQuantity(f'{_SD} accelerations of IMUs.', 'm/s^2', 100.0),
    'noise.imu_accelerometer_bias': SensingQuantity(
        f'{_OFFSET} accelerations of IMUs.', 'm/s^2', 100.0),
    'noise.imu_accelerometer_drift': SensingQuantity(
        f'{_WALK} accelerations of IMUs.', 'm/s^2/sqrt(s)', 10.0),
    'noise.range': SensingQuantity(f'{_SD} distances of rangefinders and lidars.', 'm', 10.0),
    'noise.pixel': SensingQuantity(
        f'{_SD} each colour of each pixel of images, of 255.', '', 255.0),
    'noise.depth': SensingQuantity(
        f'{_SD} depth images at 1 m; it grows with the square of the depth.', '1/m', 10.0),
    'noise.odom_slip': SensingQuantity(
        'Standard deviation of the share, drawn from the seed, by which wheels measure more than '
        'a base moves along x, along y and in its heading.', '', 1.0),
    'noise.odom_drift': SensingQuantity(
        'Standard deviation along x and along y of the random walk of the odometry of a base '
        'after wheels have rolled 1 m.', 'm/sqrt(m)', 1.0),
    'noise.odom_heading_drift': SensingQuantity(
        'Standard deviation of the heading in that random walk.', 'rad/sqrt(m)', 1.0),
    'noise.files': SensingQuantity(
        'Factor for the attribute noise, a standard deviation, that sensors have in the files; '
        'it is added to that of their kind.', '', 1000.0),
    'resolution.joint_position': SensingQuantity(
        'Step of the encoders: positions of hinges are rounded to multiples of it.', 'rad', 1.0),
    'resolution.slide_position': SensingQuantity(
        'Step of the encoders: positions of slide joints are rounded to multiples of it.', 'm',
        1.0),
    'latency.state': SensingQuantity(
        'Age of the states, wrenches and sensor values that are published, in simulation time.',
        's', 10.0),
    'latency.state_jitter': SensingQuantity(
        'Standard deviation of that age; the newest state that has arrived is published.', 's',
        10.0),
    'latency.image': SensingQuantity(
        'Age of what images show, in simulation time.', 's', 10.0),
    'latency.image_jitter': SensingQuantity(
        'Standard deviation of that age; the newest image that has arrived is published.', 's',
        10.0),
    'latency.command': SensingQuantity(
        'Delay from the arrival of a command until it takes effect, in simulation time.', 's',
        10.0),
    'latency.command_jitter': SensingQuantity(
        'Standard deviation of that delay; commands that arrive late do not replace newer ones.',
        's', 10.0),
})


class SensingSettings:
    """
    The values of :data:`QUANTITIES` for one robot.

    :ivar measures: whether any measurement, but for images, differs from the truth
    :ivar measures_images: whether images differ from the truth
    :ivar delays_images: whether images show the world before the present instant
    :ivar delays: whether measurements are older than the present instant
    :ivar delays_commands: whether commands take effect later
    """

    def __init__(self) -> None:
        self._values = dict.fromkeys(QUANTITIES, 0.0)
        self._look()

    def _look(self) -> None:
        of_commands = ('latency.command', 'latency.command_jitter')
        of_images = ('latency.image', 'latency.image_jitter', 'noise.pixel', 'noise.depth')
        self.measures = any(value for name, value in self._values.items()
                            if name not in of_commands + of_images)
        self.measures_images = any(self._values[name] for name in of_images)
        self.delays_images = any(self._values[name] for name in of_images[:2])
        self.delays = bool(self['latency.state'] or self['latency.state_jitter'])
        self.delays_commands = any(self._values[name] for name in of_commands)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def set(self, name: str, value: float) -> None:
        """
        Change a quantity.

        :param name: one of :data:`QUANTITIES`
        :param value: from 0 to the maximum of the quantity
        :raises UnknownNameError: if the quantity is unknown
        :raises CommandError: if the value is out of range
        """
        if name not in QUANTITIES:
            raise UnknownNameError('quantity', name, QUANTITIES)
        most = QUANTITIES[name].maximum
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
                math.isfinite(value) and 0.0 <= value <= most):
            raise CommandError(f'{name} must be a number from 0 to {most:g}, '
                               f'got {format_value(value)}')
        self._values[name] = float(value)
        self._look()

    @property
    def all(self) -> dict[str, float]:
        """All values, by name, a copy."""
        return dict(self._values)

    def as_dict(self) -> dict[str, float]:
        """Return the values that are not zero, by name."""
        return {name: value for name, value in self._values.items() if value}

    def replace(self, values: Mapping[str, float]) -> None:
        """Set all quantities; those that are not named to zero."""
        self._values = dict.fromkeys(QUANTITIES, 0.0)
        self._look()
        for name, value in values.items():
            self.set(name, value)
