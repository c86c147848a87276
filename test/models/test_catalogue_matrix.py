# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every two of a robot, a base and a gripper of the catalogue compile together."""

from itertools import product

import pytest

from catalogue import BASES, equipped, GRIPPERS, ROBOTS

#: With what a robot is mounted where the other two are varied.
BASE, GRIPPER = 'RethinkMount', 'PandaGripper'


def check(name, base, gripper):
    """Compile a robot and compare what is in the model with what its parts tell."""
    robot = equipped(name, base, gripper)
    model = robot.compile()
    mounted = list(robot.grippers.values())
    assert len(mounted) == len(robot.arms), (base, gripper)
    names = [model.joint(joint).name for joint in range(model.njnt)]
    expected = robot.all_joints + [joint for part in mounted for joint in part.joints]
    assert sorted(names) == sorted(expected), (base, gripper)
    actuators = [model.actuator(actuator).name for actuator in range(model.nu)]
    assert sorted(actuators) == sorted(
        robot.all_actuators + [a for part in mounted for a in part.actuators]), (base, gripper)


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS)
def test_robots_compile_on_every_base_and_with_every_gripper(name):
    for base in BASES:
        check(name, base, GRIPPER)
    for gripper in GRIPPERS:
        check(name, BASE, gripper)


@pytest.mark.full
def test_every_base_and_every_gripper_compile_with_an_arm_between_them():
    for base, gripper in product(BASES, GRIPPERS):
        check('Panda', base, gripper)
