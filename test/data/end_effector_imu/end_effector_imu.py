# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An IMU at each end effector: angular velocity and specific force in grip_site, with noise."""

import mujoco
import numpy as np

from manip_sim.interface.offered_sensors import Sensor
from manip_sim.interface.topics import PUBLISHED, Topic

#: Standard deviations of angular velocity [rad/s] and specific force [m/s^2].
GYRO, ACCELEROMETER = 0.002, 0.05


class EndEffectorImu(Sensor):
    """Angular velocity [rad/s] and specific force [m/s^2], in the axes of grip_site."""

    topic = Topic('<arm>/imu', 'sensor_msgs/Imu', PUBLISHED,
                  'IMU at the end effector, in grip_site', rate='publish_rate')

    def __init__(self, simulation, robot, of):
        super().__init__(simulation, robot, of)
        self.frame = robot.end_effectors[of].grip_site

    def read(self, simulation):
        model, data = simulation.model, simulation.data
        site, velocity, acceleration = model.site(self.frame).id, np.empty(6), np.empty(6)
        mujoco.mj_rnePostConstraint(model, data)  # Accelerations of bodies; physics reads none.
        for compute, result in ((mujoco.mj_objectVelocity, velocity),
                                (mujoco.mj_objectAcceleration, acceleration)):
            compute(model, data, mujoco.mjtObj.mjOBJ_SITE, site, result, True)
        return np.concatenate([velocity[:3], acceleration[3:]])

    def add_noise(self, values, random):
        return values + random.normal(scale=np.repeat([GYRO, ACCELEROMETER], 3))

    def fill(self, message, values):
        turn, force = message.angular_velocity, message.linear_acceleration
        turn.x, turn.y, turn.z, force.x, force.y, force.z = values.tolist()
        message.angular_velocity_covariance[::4] = [GYRO**2] * 3
        message.linear_acceleration_covariance[::4] = [ACCELEROMETER**2] * 3
        message.orientation_covariance[0] = -1.0  # There is no orientation.
