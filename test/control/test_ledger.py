# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Who owns joints and grippers: the newest command, until it is withdrawn or replaced."""

import numpy as np

from manip_sim.control.commands import Status
from manip_sim.control.ledger import Ledger
from manip_sim.models import compose
from manip_sim.simulation import Simulation

HAND = 'right/gripper'


def test_a_command_is_withdrawn_from_its_own_joints_and_once(panda_sim):
    parse, names = panda_sim.robot.parse, panda_sim.robot.joints.names
    (older,) = parse.joint_command(names[:3], position=[0.1, 0.2, 0.3])
    (newer,) = parse.joint_command(names[2:4], position=[0.1, 0.2])
    ledger = Ledger(len(names))
    for command in (older, newer):
        ledger.take(command)
        ledger.running.append(command)
    assert ledger.rival(older) is newer.handle and ledger.rival(newer) is None
    assert ledger.withdraw(older.handle, 'no more').tolist() == [0, 1]
    assert ledger.withdraw(older.handle, 'no more').tolist() == []
    assert ledger.running == [newer] and newer.handle.is_active
    assert (older.handle.status, older.handle.reason) == (Status.ABORTED, 'no more')
    assert ledger.rival(older).reason == 'no more'


def test_a_command_for_one_finger_takes_the_gripper_and_goes_on_when_the_older_one_is_withdrawn():
    simulation = Simulation(compose('Jaco'))
    robot, gripper = simulation.robot, simulation.robot.grippers[HAND]
    older = robot.parse.action(HAND, np.ones(gripper.dof))
    robot.apply(older)
    simulation.advance(50)
    finger = gripper.joints.names[0]
    low, high = gripper.joints.ranges((finger,))[0]
    goal = 0.5 * (low + high)
    (newer,) = robot.parse.joint_command([finger], position=[goal])
    assert 0 < len(newer.indices) < len(older.indices)
    robot.apply(newer)
    robot.withdraw(older, 'no more')
    assert (older.handle.status, newer.handle.status) == (Status.REPLACED, Status.RUNNING)
    for _ in range(300):
        simulation.advance(5)
    assert newer.handle.status is Status.DONE
    assert abs(float(simulation.data.joint(finger).qpos[0]) - goal) < 0.02 * (high - low)


def test_a_newer_action_replaces_that_of_a_gripper_without_actuators():
    robot = Simulation(compose('Panda', gripper='WipingGripper')).robot
    actions = [robot.parse.action(HAND, []) for _ in range(2)]
    robot.apply(*actions)
    assert [a.handle.status for a in actions] == [Status.REPLACED, Status.RUNNING]
    robot.reset()
    assert actions[1].handle.status is Status.ABORTED
