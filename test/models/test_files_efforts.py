# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Effort limits of a URDF that are placeholders: reported, and replaced where a line says so."""

from __future__ import annotations

from files_rig import ARM, write
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose, load_robot
from manip_sim.simulation import Simulation


def arm(*efforts):
    """Return a URDF of links of 2 kg and 0.3 m in a row that stretch along x at zero."""
    text = '<link name="base"/>'
    for i, effort in enumerate(efforts, 1):
        parent, x = ('base', 0.0) if i == 1 else (f'link{i - 1}', 0.3)
        text += (f'<link name="link{i}"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>'
                 '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
                 '<collision><origin xyz="0.15 0 0"/><geometry><box size="0.2 0.04 0.04"/>'
                 f'</geometry></collision></link><joint name="j{i}" type="revolute">'
                 f'<parent link="{parent}"/><child link="link{i}"/><origin xyz="{x} 0 0"/>'
                 '<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="2" '
                 f'effort="{effort}"/></joint>')
    return f'<robot name="arm">{text}</robot>'


def limits_of(robot):
    """Return the highest efforts of the joints [N m]."""
    model = robot.compile()
    return np.array([model.jnt_actfrcrange[model.joint(name).id, 1] for name in robot.joints])


def test_efforts_that_cannot_hold_the_start_are_reported_with_the_line(tmp_path):
    file = write(tmp_path / 'arm.urdf', arm(1, 100, 1))
    robot = load_robot(file)
    told = [note for note in robot.inferred if 'effort' in note]
    assert told == ["the effort limits of 2 joints cannot hold the start pose: 'j1', 'j3'; if "
                    'they are placeholders, efforts: guess in a YAML file replaces those that '
                    'are too low']
    np.testing.assert_array_equal(limits_of(robot), [1.0, 100.0, 1.0])
    assert not any('effort' in note for note in load_robot(
        write(tmp_path / 'strong.urdf', arm(100, 100, 100))).inferred)


def test_guessed_efforts_hold_and_those_that_do_stay(tmp_path):
    file = write(tmp_path / 'arm.urdf', arm(1, 100, 1))
    write(tmp_path / 'arm.yaml', 'efforts: guess\n')
    robot = load_robot(file)
    first, second, third = limits_of(robot)
    # At zero, the weights of all links are at levers of 0.15, 0.45 and 0.75 m from the first.
    assert 1.6 * 9.81 * 2.0 * (0.15 + 0.45 + 0.75) < first < 200.0
    assert second == 100.0 and 1.6 * 9.81 * 2.0 * 0.15 < third < 15.0
    told = [note for note in robot.inferred if 'effort limits are guesses' in note]
    assert told and f'j1 1 to {first:g}' in told[0] and 'j2' not in told[0]
    simulation = Simulation(compose(file, position=[0, 0, 2]))
    assert simulation.start_defects == []
    start = simulation.robot.state().position
    simulation.advance(1000)
    np.testing.assert_allclose(simulation.robot.state().position, start, atol=2e-3)


def test_the_efforts_of_actuators_are_no_placeholders(tmp_path):
    file = write(tmp_path / 'arm.xml', ARM)
    write(tmp_path / 'arm.yaml', 'efforts: guess\n')
    with pytest.raises(ModelError, match="'efforts: guess' of .* is for files without actuators; "
                                         '.*arm.xml has 3 actuators'):
        load_robot(file)
