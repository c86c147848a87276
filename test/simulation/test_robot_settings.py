# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Settings of a robot that would break later control periods are rejected at once."""

import pytest

from manip_sim.errors import CommandError

SETTINGS = {
    'timeout_s': lambda robot, value: robot.set_command_timeout('arm', value),
    'longest_s': lambda robot, value: robot.set_stream('arm', longest_s=value),
    'hold_s': lambda robot, value: robot.set_stream('arm', hold_s=value),
    'a limit': lambda robot, value: robot.set_reflex('arm', 'velocity', value),
    'integral_gain': lambda robot, value: robot.set_integral_gain('arm', value),
    'the mass of a payload': lambda robot, value: robot.set_payload('right', value),
    'the cutoff of a wrench': lambda robot, value: robot.set_wrench_cutoff('right', value),
    'stiffness': lambda robot, value: robot.joints.cartesian.set('right', 'stiffness', value)}


@pytest.mark.parametrize('value', [-1.0, float('nan'), float('inf'), '1', True])
@pytest.mark.parametrize('name', SETTINGS)
def test_a_setting_that_is_no_number_in_its_range_is_rejected_by_its_name(panda_sim, name, value):
    digest = panda_sim.digest()
    with pytest.raises(CommandError, match=f'^{name} must be positive and finite.*, got '):
        SETTINGS[name](panda_sim.robot, value)
    assert panda_sim.digest() == digest


@pytest.mark.parametrize('name', SETTINGS)
def test_zero_switches_off_what_can_be_switched_off(panda_sim, name):
    SETTINGS[name](panda_sim.robot, 1.0)
    switched_on = panda_sim.digest()
    if name in ('longest_s', 'stiffness'):
        with pytest.raises(CommandError, match=', got 0'):
            SETTINGS[name](panda_sim.robot, 0.0)
    else:
        SETTINGS[name](panda_sim.robot, 0)
    assert (panda_sim.digest() == switched_on) is (name in ('longest_s', 'stiffness'))
