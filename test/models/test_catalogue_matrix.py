# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every robot of the catalogue compiles on every base and with every gripper."""

import pytest

from catalogue import BASES, equipped, GRIPPERS, ROBOTS

from manip_sim.errors import ModelError


@pytest.mark.parametrize('base', BASES)
@pytest.mark.parametrize('name', ROBOTS)
def test_robots_compile_on_every_base_with_every_gripper(name, base):
    failures = {}
    for gripper in GRIPPERS:
        robot = equipped(name, base, gripper)
        try:
            model = robot.compile()
        except ModelError as error:
            failures[gripper] = str(error)
            continue
        mounted = list(robot.grippers.values())
        assert len(mounted) == len(robot.arms)
        names = [model.joint(joint).name for joint in range(model.njnt)]
        expected = robot.all_joints + [joint for part in mounted for joint in part.joints]
        assert sorted(names) == sorted(expected), gripper
        actuators = [model.actuator(actuator).name for actuator in range(model.nu)]
        assert sorted(actuators) == sorted(
            robot.all_actuators + [a for part in mounted for a in part.actuators]), gripper
    assert failures == {}
