# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every robot and base of the catalogue has robosuite's names, frames and ranges."""

import mujoco
import numpy as np
import pytest
import yaml

from catalogue import BASES, equipped, figures, GRIPPERS, ROBOTS, robots_with_figures

from manip_sim.errors import UnknownNameError
from manip_sim.models import grippers, mjcf, robots
from manip_sim.models.bases import create_base
from manip_sim.models.robots import create_robot
from manip_sim.models.user_files import read_yaml
from manip_sim.resources import asset_path, share_directory

WITH_FIGURES = robots_with_figures()
BASES_WITH_FIGURES = [name for name in BASES if name in figures('bases.json')['bases']]
N_POSES = 1000


def rotations(axis, angles):
    """Return Rodrigues' rotation matrices about a unit axis, shape (n, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)


def rotation_of_quat(quat_wxyz):
    """Return the rotation matrix of a quaternion, shape (3, 3)."""
    w, *vector = np.array(quat_wxyz) / np.linalg.norm(quat_wxyz)
    norm = np.linalg.norm(vector)
    if norm == 0.0:
        return np.eye(3)
    return rotations(np.array(vector) / norm, np.array([2.0 * np.arctan2(norm, w)]))[0]


def forward_kinematics(chain, qpos):
    """
    Follow a chain of bodies.

    :param chain: per body its name, position, quaternion and joint (name, type, axis, position)
    :param qpos: joint positions by joint name, each of shape (n,)
    :returns: positions (n, 3) and rotations (n, 3, 3) of the last body in the root frame
    """
    n = len(next(iter(qpos.values())))
    position, rotation = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
    for _, pos, quat, joint in chain:
        position = position + rotation @ np.array(pos, dtype=float)
        rotation = rotation @ rotation_of_quat(quat)
        if joint is None:
            continue
        name, kind, axis, anchor = joint
        if kind == 'slide':
            position = position + (rotation @ np.array(axis, dtype=float)) * qpos[name][:, None]
            continue
        turn = rotations(np.array(axis, dtype=float), qpos[name])
        position = position + rotation @ np.array(anchor, dtype=float)
        rotation = rotation @ turn
        position = position - rotation @ np.array(anchor, dtype=float)
    return position, rotation


@pytest.mark.full
@pytest.mark.parametrize('name', WITH_FIGURES)
def test_end_effectors_are_where_the_reference_has_them(name):
    expected = figures(f'robots/{name}.json')
    robot = create_robot(name)
    model = robot.compile()
    data = mujoco.MjData(model)
    random = np.random.default_rng(1)
    qpos = {joint: random.uniform(*(limits or (-np.pi, np.pi)), N_POSES)
            for joint, _, limits in expected['joints']}
    for arm, chain in expected['chains'].items():
        positions, orientations = forward_kinematics(chain, qpos)
        for i in range(N_POSES):
            for joint, values in qpos.items():
                data.qpos[model.joint(robot.correct_naming(joint)).qposadr] = values[i]
            mujoco.mj_kinematics(model, data)
            root, eef = data.body(robot.root_body), data.body(robot.eef_name[arm])
            turn = root.xmat.reshape(3, 3).T
            assert np.abs(turn @ (eef.xpos - root.xpos) - positions[i]).max() < 1e-6
            assert np.abs(turn @ eef.xmat.reshape(3, 3) - orientations[i]).max() < 1e-6


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_joints_actuators_cameras_and_bodies_have_the_names_of_the_reference(name):
    expected = figures(f'robots/{name}.json')
    robot = create_robot(name)
    model = robot.compile()
    assert robot.joints == robot.correct_naming([joint for joint, _, _ in expected['joints']])
    assert robot.actuators == robot.correct_naming([a for a, _ in expected['actuators']])
    assert sorted(robot.cameras) == sorted(robot.correct_naming(expected['cameras']))
    assert set(robot.correct_naming(expected['bodies'])) <= set(robot.bodies)
    assert set(robot.correct_naming(expected['sites'])) <= set(robot.sites)
    for actuator, target in expected['actuators']:
        joint = model.actuator(robot.correct_naming(actuator)).trnid[0]
        assert model.joint(joint).name == robot.correct_naming(target)


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_joints_have_the_type_and_the_range_of_the_reference(name):
    robot = create_robot(name)
    model = robot.compile()
    kinds = {'hinge': mujoco.mjtJoint.mjJNT_HINGE, 'slide': mujoco.mjtJoint.mjJNT_SLIDE}
    for raw, kind, limits in figures(f'robots/{name}.json')['joints']:
        joint = model.joint(robot.correct_naming(raw))
        assert int(joint.type[0]) == int(kinds[kind])
        assert bool(model.jnt_limited[joint.id]) == (limits is not None)
        if limits is not None:
            np.testing.assert_allclose(joint.range, limits, atol=1e-6, err_msg=raw)


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_declarations_are_those_of_the_reference(name):
    declared = figures(f'robots/{name}.json')['declared']
    robot = create_robot(name)
    for attribute in ('arm_type', 'default_gripper', 'default_base', 'default_controller_config',
                      'gripper_mount_pos_offset', 'gripper_mount_quat_offset'):
        assert getattr(robot, attribute) == declared[attribute], attribute
    np.testing.assert_allclose(robot.init_qpos, declared['init_qpos'], atol=1e-12)
    np.testing.assert_allclose(robot.top_offset, declared['top_offset'], atol=1e-12)
    assert robot.eef_name == robot.correct_naming(declared['eef_name'])
    for arm, quat_xyzw in declared['hand_rotation_offset_xyzw'].items():
        ours = robot.hand_rotation_offset[arm]
        assert abs(abs(np.dot(ours, quat_xyzw)) - 1.0) < 1e-9


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_robots_stand_in_the_arenas_where_the_reference_puts_them(name):
    declared = figures(f'robots/{name}.json')['declared']['base_xpos_offset']
    ours = create_robot(name).base_xpos_offset
    assert set(declared) <= set(ours)
    for arena, place in declared.items():
        if callable(ours[arena]):
            for length, position in place.items():
                np.testing.assert_allclose(ours[arena](float(length)), position, atol=1e-12)
        else:
            np.testing.assert_allclose(ours[arena], place, atol=1e-12)


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_robots_on_their_base_have_the_subsystems_and_offsets_of_the_reference(name):
    expected = figures(f'robots/{name}.json')
    robot = equipped(name)
    for subsystem in ('arm', 'base', 'torso', 'head', 'legs'):
        names = expected['subsystems_on_default_base'].get(
            subsystem, {'joints': [], 'actuators': []})
        assert robot.joints_of(subsystem) == names['joints']
        assert robot.actuators_of(subsystem) == names['actuators']
    on_base = expected['declared']['with_default_base']
    np.testing.assert_allclose(robot.bottom_offset, on_base['bottom_offset'], atol=1e-9)
    assert robot.horizontal_radius == pytest.approx(on_base['horizontal_radius'])


@pytest.mark.parametrize('name', BASES_WITH_FIGURES)
def test_bases_have_the_names_and_offsets_of_the_reference(name):
    expected = figures('bases.json')['bases'][name]
    base = create_base(name)
    assert base.naming_prefix == expected['naming_prefix']
    assert set(base.correct_naming(expected['bodies'])) <= set(base.bodies)
    assert set(base.correct_naming(expected['sites'])) <= set(base.sites)
    assert base.joints == base.correct_naming([joint for joint, _, _ in expected['joints']])
    assert base.actuators == base.correct_naming([a for a, _, _ in expected['actuators']])
    for raw, _, limits in expected['joints']:
        if limits and limits[0] < limits[1]:
            np.testing.assert_allclose(base.spec.joint(raw).range, limits, atol=1e-6)
    np.testing.assert_allclose(base.top_offset, expected['top_offset'], atol=1e-9)
    np.testing.assert_allclose(base.bottom_offset, expected['bottom_offset'], atol=1e-9)
    assert base.horizontal_radius == pytest.approx(expected['horizontal_radius'])


@pytest.mark.parametrize('name', ROBOTS)
def test_robots_state_a_force_and_a_velocity_limit_for_each_actuated_joint(name):
    robot = create_robot(name)
    model = robot.compile()
    for actuator in range(model.nu):
        joint = model.joint(model.actuator_trnid[actuator, 0])
        assert model.actuator_forcelimited[actuator], model.actuator(actuator).name
        assert model.actuator_forcerange[actuator, 1] > 0.0
        if model.jnt_actfrclimited[joint.id]:
            np.testing.assert_allclose(model.jnt_actfrcrange[joint.id],
                                       model.actuator_forcerange[actuator])
        assert joint.user.size and joint.user[0] > 0.0, f'{joint.name} has no velocity limit'


def assets():
    """Return the folders of all parts."""
    return sorted(folder for kind in ('robots', 'grippers', 'bases')
                  for folder in (share_directory() / 'assets' / kind).iterdir()
                  if folder.is_dir())


@pytest.mark.parametrize('folder', assets(), ids=lambda folder: folder.name)
def test_asset_folders_hold_one_model_from_primitives_and_say_where_numbers_come_from(folder):
    described = folder / 'part.yaml'
    named = read_yaml(described).get('model') if described.is_file() else None
    file = folder / named if named else asset_path(folder.parent.name, folder.name)
    assert file.is_file(), f'{folder} has no {file.name}'
    xml = file.read_text()
    assert '<mesh' not in xml and 'type="mesh"' not in xml
    readme = (folder / 'README.md').read_text()
    assert '| origin |' in readme and 'Apache-2.0' in readme


#: What a class of the catalogue reads from ``part.yaml``, and no description of a user has.
OWN_KEYS = {'radius', 'table_placement', 'torso_start', 'action', 'each_action', 'cups'}


@pytest.mark.parametrize(
    'folder', [folder for folder in assets() if (folder / 'part.yaml').is_file()],
    ids=lambda folder: folder.name)
def test_a_part_of_the_catalogue_is_described_as_a_file_of_a_user_is(folder, tmp_path):
    pytest.importorskip('pydantic', reason='descriptions of files need pydantic')
    from manip_sim.models.files import part_descriptions as d
    kind = {'robots': d.RobotDescription, 'grippers': d.GripperDescription,
            'bases': d.BaseDescription}[folder.parent.name]
    own = OWN_KEYS | ({'top'} if kind is d.RobotDescription else set())
    values = read_yaml(folder / 'part.yaml')
    values.get('fingers', {}).pop('corners', None)
    copy = tmp_path / 'part.yaml'
    copy.write_text(yaml.safe_dump({key: v for key, v in values.items() if key not in own}))
    d.read_description(copy, kind)


def test_a_key_that_no_attribute_reads_is_an_error(monkeypatch, tmp_path):
    folder = tmp_path / 'panda'
    folder.mkdir()
    (folder / 'part.yaml').write_text('radios: 0.5\n')
    monkeypatch.setattr(mjcf, 'asset_path', lambda kind, name: folder / 'panda.xml')

    class Other(robots.Panda):
        pass
    with pytest.raises(UnknownNameError, match="unknown key of .*part.yaml 'radios'.*radius"):
        Other.data()


def test_a_start_names_joints_of_the_model():
    for name in ROBOTS:
        cls = getattr(robots, name)
        assert set(cls.data()['start']) <= set(cls()._joints), name
    for name in GRIPPERS:
        cls = getattr(grippers, name)
        assert set(cls.data().get('start', {})) <= set(cls()._joints), name
