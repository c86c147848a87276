# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Errors that one sensor adds to the exact numbers that it reads: white noise, offset, drift, steps.

Everything depends on the settings of its robot, the seed, the name and the count of steps since
the reset only. All settings are zero by default, those of latency included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from types import MappingProxyType

import mujoco
import numpy as np

from manip_sim.algebra import wxyz_to_xyzw, xyzw_to_wxyz
from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.quoting import format_value
from manip_sim.sensing.instruments import (
    ACCELEROMETER, GYRO, IMU, Instrument, ORIENTATION, RANGE, WRENCH)
from manip_sim.sensing.randomness import NormalRows


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
        self.replace({})

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


#: Of wrenches: factors of bias and drift, which are given for forces.
_WRENCH_SCALE = np.repeat([1.0, TORQUE_PER_FORCE_M], 3)
#: By type of sensor: the quantity whose standard deviation it has, for sensors that stand alone.
_ALONE = {'jointpos': 'joint_position', 'jointvel': 'joint_velocity',
          'jointactfrc': 'joint_effort', 'force': 'wrench_force',
          'torque': 'wrench_torque'}
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


class Channel:
    """
    The noise of one sensor.

    :param name: of the sensor, unique in its world
    :ivar sd: standard deviation of the white noise, shape (width,), as the others are
    :ivar bias: standard deviation of the offset
    :ivar drift: standard deviation of the random walk after one second
    :ivar step: to whose multiples the numbers are rounded, 0 for none; None if none is
    :ivar is_noisy: whether it has noise when all settings are zero
    """

    is_noisy = False

    def __init__(self, name: str, width: int) -> None:
        self.name = name
        self.width = width
        self.sd: FloatArray = np.zeros(width)
        self.bias: FloatArray = np.zeros(width)
        self.drift: FloatArray = np.zeros(width)
        self.step: FloatArray | None = None
        self.seed = 0
        #: Random numbers by what they are for; most sensors need none.
        self._rows: dict[str, NormalRows] = {}

    def set_seed(self, seed: int) -> None:
        """Draw other numbers from now on, unless this is the seed already."""
        if seed != self.seed:
            self.seed, self._rows = seed, {}

    def rows(self, purpose: str, width: int) -> NormalRows:
        """Return random numbers of a purpose, the same ones until the seed changes."""
        rows = self._rows.get(purpose)
        if rows is None:
            rows = self._rows[purpose] = NormalRows(
                self.seed, f'{self.name} {purpose}'.rstrip(), width)
        return rows

    def adapt(self, settings: SensingSettings) -> None:
        """Take over the settings of the robot; by default there are none."""

    def noise(self, count: int, timestep_s: float) -> FloatArray:
        """
        Return white noise, offset and drift.

        :param count: steps since the reset
        :returns: in the units of the reading, shape (width,)
        """
        total = np.zeros(self.width)
        if self.sd.any():
            total += self.sd * self.rows('', self.width).row(count)
        if self.bias.any():
            total += self.bias * self.rows('bias', self.width).row(0)
        if self.drift.any():
            total += self.drift * np.sqrt(timestep_s) * self.rows('drift', self.width).sum(count)
        return total

    def measure(self, exact: FloatArray, count: int, timestep_s: float) -> FloatArray:
        """
        Return what the sensor makes of exact numbers.

        :param exact: shape (width,)
        :param count: steps from the reset to their instant
        :returns: shape (width,), a copy
        """
        values = exact + self.noise(count, timestep_s)
        if self.step is not None:
            steps = np.where(self.step > 0.0, self.step, 1.0)
            values = np.where(self.step > 0.0, np.round(values / steps) * steps, values)
        return values


class JointChannel(Channel):
    """
    Positions, velocities and efforts of all joints of a robot, shape (3 n,).

    :param is_slide: whether each joint is a slide, so that it has metres for radians, shape (n,)
    """

    def __init__(self, name: str, is_slide: BoolArray) -> None:
        self._is_slide = is_slide
        super().__init__(name, 3 * len(is_slide))

    def adapt(self, settings: SensingSettings) -> None:
        """Take over the settings of the robot."""
        def of_each(kind: str, quantity: str) -> FloatArray:
            return np.where(self._is_slide, settings[f'{kind}.slide_{quantity}'],
                            settings[f'{kind}.joint_{quantity}'])
        self.sd = np.concatenate([
            of_each('noise', quantity) for quantity in ('position', 'velocity', 'effort')])
        step = of_each('resolution', 'position')
        self.step = np.concatenate([step, 0.0 * step, 0.0 * step]) if step.any() else None


def _wrench_noise(settings: SensingSettings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return standard deviation, offset and drift of force and torque, each of shape (6,)."""
    return (np.repeat([settings['noise.wrench_force'], settings['noise.wrench_torque']], 3),
            settings['noise.wrench_bias'] * _WRENCH_SCALE,
            settings['noise.wrench_drift'] * _WRENCH_SCALE)


class WrenchChannel(Channel):
    """Force and torque, shape (6,)."""

    def adapt(self, settings: SensingSettings) -> None:
        """Take over the settings of the robot."""
        self.sd, self.bias, self.drift = _wrench_noise(settings)


class InstrumentChannel(Channel):
    """
    Reading of an instrument of the model.

    :param model: the ``mujoco.MjModel``
    :param own_sd: standard deviation that each of its numbers has in any case, in its unit
    """

    def __init__(self, instrument: Instrument, model: mujoco.MjModel, own_sd: float = 0.0) -> None:
        self._kind, self._types, self._reach = instrument.kind, instrument.types, instrument.reach
        sensors = np.repeat(np.arange(model.nsensor), model.sensor_dim)[instrument.sources]
        self._quantity = _quantity(instrument, model, int(sensors[0]))
        #: The attribute ``noise`` of the sensors in the file.
        self._of_file, self._own_sd = np.zeros((2, instrument.length))
        self._of_file[instrument.targets] = model.sensor_noise[sensors]
        self._own_sd[instrument.targets] = own_sd
        self.is_noisy = own_sd > 0.0
        super().__init__(instrument.name, instrument.length)

    def adapt(self, settings: SensingSettings) -> None:
        """Take over the settings of the robot."""
        self.sd = self._own_sd + settings['noise.files'] * self._of_file
        if self._kind == IMU:
            for places, kind in ((GYRO, 'gyro'), (ACCELEROMETER, 'accelerometer')):
                if kind in self._types:
                    self.sd[places] += settings[f'noise.imu_{kind}']
                    self.bias[places] = settings[f'noise.imu_{kind}_bias']
                    self.drift[places] = settings[f'noise.imu_{kind}_drift']
            if 'framequat' in self._types:
                self.sd[ORIENTATION] += settings['noise.imu_orientation']
        elif self._kind == WRENCH:
            white, self.bias, self.drift = _wrench_noise(settings)
            self.sd += white
        elif self._quantity:
            self.sd += settings[f'noise.{self._quantity}']

    def measure(self, exact: FloatArray, count: int, timestep_s: float) -> FloatArray:
        """Return what the instrument makes of exact numbers, as :meth:`Channel.measure`."""
        noise = self.noise(count, timestep_s)
        if self._kind == RANGE:  # Rays that hit nothing have no noise.
            return np.where((exact >= 0.0) & (exact < self._reach),
                            np.maximum(exact + noise, 0.0), exact)
        values: FloatArray = exact + noise
        if self._kind == IMU:
            values[ORIENTATION] = _turned(exact[ORIENTATION], noise[ORIENTATION][:3])
        elif self._types[0] in ('framequat', 'ballquat'):
            values = xyzw_to_wxyz(_turned(wxyz_to_xyzw(exact), noise[:3]))
        elif self._types[0] == 'touch':
            values = np.maximum(values, 0.0)
        return values


def _turned(quat_xyzw: FloatArray, by: FloatArray) -> FloatArray:
    """Return an orientation that is turned by a small rotation vector in its own axes [rad]."""
    angle = float(np.sqrt((by**2).sum()))
    if not angle:
        return quat_xyzw
    small, product = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(small, by / angle, angle)
    mujoco.mju_mulQuat(product, xyzw_to_wxyz(quat_xyzw), small)
    return wxyz_to_xyzw(product)


def _quantity(instrument: Instrument, model: mujoco.MjModel, sensor: int) -> str:
    """Return the quantity whose noise a sensor has that stands alone; empty if there is none."""
    if instrument.kind == RANGE:
        return 'range'
    name = _ALONE.get(instrument.types[0], '')
    if name.startswith('joint') and model.jnt_type[model.sensor_objid[sensor]] == _SLIDE:
        return name.replace('joint', 'slide')
    return name


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
