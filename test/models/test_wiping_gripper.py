# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The felt of the wiping gripper stays on a table and slides with its own friction."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.simulation import Simulation


@pytest.mark.full
def test_felt_stays_on_a_table_and_slides_with_its_own_friction():
    simulation = Simulation(compose('Panda', gripper='WipingGripper', arena='table'))
    robot, data = simulation.robot, simulation.data
    table = simulation.model.geom('table_collision')
    pose = robot.state().end_effectors['right'].pose
    place = np.array([pose.position[0], 0.0, 0.83])

    def go(seconds, speed=0.0):
        forces = []
        for _ in range(round(seconds * 100)):
            place[1] += 0.01 * speed
            robot.apply(robot.parse_cartesian.pose('right', place, pose.quat_xyzw),
                        period_s=0.01)
            for _ in range(5):
                simulation.advance(1)
                total, force = np.zeros(2), np.empty(6)
                for index, contact in enumerate(data.contact):
                    if table.id in contact.geom:
                        mujoco.mj_contactForce(simulation.model, data, index, force)
                        total += [force[0], np.hypot(*force[1:3])]
                forces.append(total)
        return np.array(forces)
    go(2.0)
    robot.set_control_mode('arm', 'effort')
    # 5 mm below where the corners touch, so that it presses with a few newtons.
    place[2] = 0.795
    go(1.5)
    normal, friction = go(1.0, 0.05)[250:].T
    assert normal.mean() > 2.0
    assert (normal > 0.05).mean() > 0.95
    # The table has 1.0.
    assert 0.3 < friction.sum() / normal.sum() < 0.401
