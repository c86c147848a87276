# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Errors that one sensor adds to the exact numbers that it reads: white noise, offset, drift, steps.

Everything depends on the seed, the name and the count of steps since the reset only.
"""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.algebra import wxyz_to_xyzw, xyzw_to_wxyz
from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.sensing.instruments import (
    ACCELEROMETER, GYRO, IMU, Instrument, ORIENTATION, RANGE, WRENCH)
from manip_sim.sensing.randomness import NormalRows
from manip_sim.sensing.settings import SensingSettings, TORQUE_PER_FORCE_M

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
