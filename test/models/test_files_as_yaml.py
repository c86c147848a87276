# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What was inferred of a file, as a description that leaves nothing to infer."""

from pathlib import Path
import shutil

from files_rig import ARM, ARM_WITH_HAND, TWO_ARMS, write
import numpy as np
import pytest
import yaml

from manip_sim.errors import ModelError
from manip_sim.models import compose, load_robot
from manip_sim.models.robots import ManipulatorModel
from manip_sim.simulation import Simulation

LASER = Path(__file__).resolve().parents[1] / 'data/files/turning_laser.xml'


def again(file, description, folder):
    """Return the robot of a file with a description beside it."""
    folder.mkdir()
    shutil.copy(file, folder)
    write(folder / f'{file.stem}.yaml', description)
    return load_robot(folder / file.name)


@pytest.mark.parametrize('text', [ARM, ARM_WITH_HAND, TWO_ARMS], ids=['arm', 'hand', 'two arms'])
def test_the_description_of_a_robot_gives_the_same_robot(text, tmp_path):
    file = write(tmp_path / 'arm.xml', text)
    first = load_robot(file)
    other = again(file, yaml.safe_dump(first.described), tmp_path / 'other')
    assert other.described == first.described
    assert other.arm_joints == first.arm_joints and other.eef_name == first.eef_name
    assert other.own_hands == first.own_hands
    for one, two in zip(first.grippers.values(), other.grippers.values()):
        np.testing.assert_array_equal(one.format_action([0.5]), two.format_action([0.5]))
    np.testing.assert_array_equal(first.init_qpos, other.init_qpos)
    states = []
    for robot in (first, other):
        simulation = Simulation(compose(robot))
        simulation.advance(20)
        states.append(simulation.data.qpos.tobytes())
    assert states[0] == states[1]


def test_a_robot_can_be_declared_to_have_no_arms(tmp_path):
    file = write(tmp_path / 'arm.xml', ARM)
    robot = again(file, 'arms: none', tmp_path / 'other')
    assert not isinstance(robot, ManipulatorModel) and robot.described['arms'] == 'none'
    assert list(Simulation(compose(robot)).robot.parts) == ['other']


def test_what_belongs_to_no_arm_is_not_driven_as_the_arm(tmp_path):
    robot = load_robot(LASER)
    assert 'other: tilt' in robot.inferred
    simulation = Simulation(compose(robot))
    parts = {name: part.joints for name, part in simulation.robot.parts.items()}
    arm = ('robot0_joint1', 'robot0_joint2', 'robot0_joint3')
    assert parts == {'arm': arm, 'right': arm, 'other': ('robot0_tilt',)}
    simulation.robot.apply(*simulation.robot.parse.joint_command(
        ['robot0_tilt'], [0.4], [], [], 'other'))
    for _ in range(200):
        simulation.advance(5)
    assert simulation.data.joint('robot0_tilt').qpos[0] == pytest.approx(0.4, abs=5e-3)
    assert again(LASER, 'subsystems: {tilt: arm}', tmp_path / 'declared').other_joints == []


@pytest.mark.parametrize('text', [
    'rarm:\n - R_JOINT0 : shoulder\n\thead:\n', 'joint_limits:\n  lift: {max: 1.0}\n',
    '# of another tool\nurdf-path: arm.urdf\n!!python/object:os.system\n'])
def test_the_yaml_file_of_another_tool_beside_a_model_is_left_alone(tmp_path, text, caplog):
    plain = load_robot(write(tmp_path / 'plain.xml', ARM))
    file = write(tmp_path / 'arm.xml', ARM)
    write(tmp_path / 'arm.yaml', text)
    robot = load_robot(file)
    assert robot.inferred == plain.inferred and robot.joints == plain.joints
    assert f'{file.with_suffix(".yaml")} is not read: it has no key of a description' in (
        caplog.text)


@pytest.mark.parametrize(('text', 'said'), [
    ('arms: none\n\tstart: home\n', 'invalid or unsafe YAML'), ('subsystem: {}\n', 'subsystems'),
    ('[]\n', 'must hold keys and values'), ('arm: {}\njoint_limits: {}\n', 'arm')])
def test_a_misspelled_description_is_an_error(tmp_path, text, said):
    file = write(tmp_path / 'arm.xml', ARM)
    write(tmp_path / 'arm.yaml', text)
    with pytest.raises(ModelError, match=said):
        load_robot(file)
