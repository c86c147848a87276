# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of where models come from: paths, folders of a user, Menagerie and robosuite."""

import os
import sys

import pytest

from files_rig import ARM, HAND, write

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import arena_names, create_arena, load_robot, set_model_path
from manip_sim.models.bases import base_names, create_base
from manip_sim.models.grippers import create_gripper, gripper_names
from manip_sim.models.robots import create_robot, robot_names

FLOOR = '<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
STAND = '<mujoco><worldbody><body name="stand"><geom size="0.1"/></body></worldbody></mujoco>'


@pytest.fixture(autouse=True)
def no_folders(monkeypatch):
    """Begin and end without folders of a user."""
    for variable in ('MANIP_SIM_PATH', 'MENAGERIE_ROOT', 'MENAGERIE'):
        monkeypatch.delenv(variable, raising=False)
    yield
    set_model_path([])


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a model of each kind."""
    write(tmp_path / 'robots' / 'plain.xml', ARM)
    write(tmp_path / 'robots' / 'said.xml', ARM)
    write(tmp_path / 'robots' / 'said.yaml', 'start: {turn: -0.5}')
    write(tmp_path / 'robots' / 'own' / 'own.xml', ARM)
    write(tmp_path / 'robots' / 'named' / 'robot.yaml', 'model: model.xml')
    write(tmp_path / 'robots' / 'named' / 'model.xml', ARM)
    write(tmp_path / 'robots' / 'notes' / 'README.md', '')
    write(tmp_path / 'grippers' / 'grab.xml', HAND)
    write(tmp_path / 'bases' / 'post.xml', STAND)
    write(tmp_path / 'arenas' / 'hall.xml', FLOOR)
    return tmp_path


@pytest.mark.parametrize('how', ['variable', 'call'])
def test_folders_join_the_catalogue(folder, monkeypatch, how, tmp_path_factory):
    empty = tmp_path_factory.mktemp('empty')
    if how == 'call':
        set_model_path([empty, folder])
    else:
        monkeypatch.setenv('MANIP_SIM_PATH', os.pathsep.join([str(empty), str(folder)]))
    assert {'plain', 'said', 'own', 'named', 'Panda'} <= set(robot_names())
    assert 'notes' not in robot_names()
    assert 'grab' in gripper_names() and 'post' in base_names() and 'hall' in arena_names()
    assert create_robot('said', idn=2).init_qpos[0] == -0.5
    assert create_robot('said', idn=2).naming_prefix == 'robot2_'
    assert create_robot('named').name == 'model0'
    for name in ('plain', 'own'):
        assert create_robot(name, prefix='left_').arm_joints[0] == 'left_turn'
    assert create_gripper('grab').dof == 1
    assert create_base('post').root_body == 'fixed_mount0_stand'
    assert create_arena('hall').arena_name == 'hall'


def test_the_first_folder_counts_and_the_package_before_all(folder, tmp_path_factory, monkeypatch):
    first = tmp_path_factory.mktemp('first')
    write(first / 'robots' / 'plain.xml', ARM.replace('"turn"', '"swing"'))
    write(first / 'robots' / 'Panda.xml', ARM)
    set_model_path([first, folder])
    assert create_robot('plain').joints[0] == 'robot0_swing'
    set_model_path([first])
    monkeypatch.setenv('MANIP_SIM_PATH', str(folder))
    assert create_robot('plain').joints[0] == 'robot0_swing'
    assert type(create_robot('Panda')).__name__ == 'Panda'


def test_an_unknown_name_is_told_with_those_of_the_folders(folder):
    set_model_path([folder])
    for create, name, near in ((create_robot, 'plan', 'plain'), (create_gripper, 'grap', 'grab'),
                               (create_base, 'pos', 'post'), (create_arena, 'hal', 'hall')):
        with pytest.raises(UnknownNameError, match=f"did you mean '{near}'"):
            create(name)


def test_a_folder_that_is_missing_is_told(tmp_path, monkeypatch):
    with pytest.raises(ModelError, match='no such folder in the model path: .*gone'):
        set_model_path([tmp_path / 'gone'])
    monkeypatch.setenv('MANIP_SIM_PATH', str(tmp_path / 'gone'))
    with pytest.raises(ModelError, match='no such folder in MANIP_SIM_PATH: .*gone'):
        robot_names()


@pytest.mark.parametrize('create', [create_robot, create_gripper, create_base, create_arena])
def test_a_path_that_is_missing_is_told(tmp_path, create):
    for path in (tmp_path / 'gone.xml', str(tmp_path / 'gone'), 'gone.urdf'):
        with pytest.raises(ModelError, match='no such file: .*gone'):
            create(path)


def test_parameters_are_not_for_files(folder):
    with pytest.raises(ModelError, match='is a file, which takes no parameters, got a'):
        create_arena(str(folder / 'arenas' / 'hall.xml'), a=1)


def test_a_checkout_of_menagerie_is_a_source(tmp_path, monkeypatch):
    monkeypatch.setenv('MENAGERIE_ROOT', str(tmp_path))
    write(tmp_path / 'acme_arm' / 'arm.xml', ARM)
    write(tmp_path / 'acme_arm' / 'mjx_arm.xml', ARM)
    write(tmp_path / 'acme_arm' / 'scene.xml', '<mujoco><include file="arm.xml"/></mujoco>')
    write(tmp_path / 'acme_hand' / 'left_hand.xml', HAND)
    write(tmp_path / 'acme_hand' / 'right_hand.xml', HAND)
    assert create_robot('menagerie:acme_arm').name == 'arm0'
    assert create_robot('menagerie:acme_arm/mjx_arm.xml').name == 'mjx_arm0'
    assert create_gripper('menagerie:acme_hand/left_hand.xml').name == 'left_hand0'
    with pytest.raises(ModelError, match='menagerie:acme_hand has several models, say which: '
                                         'menagerie:acme_hand/left_hand.xml or'):
        create_gripper('menagerie:acme_hand')
    with pytest.raises(UnknownNameError, match="unknown model of MENAGERIE_ROOT .* 'acme_am': did "
                                               "you mean 'acme_arm'"):
        create_robot('menagerie:acme_am')
    with pytest.raises(UnknownNameError, match="unknown file of menagerie:acme_hand 'hand.xml'"):
        create_gripper('menagerie:acme_hand/hand.xml')
    monkeypatch.setenv('MENAGERIE_ROOT', str(tmp_path / 'gone'))
    with pytest.raises(ModelError, match='no such folder in MENAGERIE_ROOT: .*gone'):
        create_robot('menagerie:acme_arm')


@pytest.fixture
def site_packages(tmp_path, monkeypatch):
    """Return a folder that packages are found in before all others."""
    monkeypatch.syspath_prepend(str(tmp_path / 'site'))
    yield tmp_path / 'site'
    for name in [name for name in sys.modules if name.split('.')[0] in (
            'robosuite', 'robosuite_models', 'mujoco_menagerie')]:
        del sys.modules[name]


def test_the_package_of_menagerie_is_a_source(site_packages):
    write(site_packages / 'mujoco_menagerie' / 'models' / 'acme' / 'arm.xml', ARM)
    write(site_packages / 'mujoco_menagerie' / '__init__.py', """
from pathlib import Path
from types import SimpleNamespace

def names():
    return ['acme', 'far', 'wordy', 'away']

def get(name):
    def path():
        if name == 'far':
            raise OSError('no\\nnetwork')
        if name == 'wordy':
            raise OSError(201 * 'x')
        if name == 'away':
            raise type('DownloadError', (Exception,), {})('https://x/away.tar.xz: no route')
        return Path(__file__).parent / 'models' / name
    return SimpleNamespace(path=path, default_model='arm',
                           entry=lambda entry: SimpleNamespace(file=f'{entry}.xml'))
""")
    assert create_robot('menagerie:acme').name == 'arm0'
    with pytest.raises(UnknownNameError, match="unknown model of mujoco_menagerie 'acm': did you"):
        create_robot('menagerie:acm')
    with pytest.raises(ModelError, match=r'menagerie:far cannot be loaded: no\\nnetwork'):
        create_robot('menagerie:far')
    with pytest.raises(ModelError, match=r'menagerie:wordy cannot be loaded: x{200}\.\.\.$'):
        create_robot('menagerie:wordy')
    with pytest.raises(ModelError, match=r'away.tar.xz: no route; without internet, bring a clone '
                                         r"of .* and type 'export MENAGERIE_ROOT=FOLDER', or"):
        create_robot('menagerie:away')


@pytest.mark.parametrize('place', ['', 'mujoco_menagerie'])
def test_a_checkout_of_menagerie_may_be_named_in_several_ways(place, tmp_path, monkeypatch):
    write(tmp_path / place / 'acme_arm' / 'arm.xml', ARM)
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    set_model_path([tmp_path])
    assert create_robot('menagerie:acme_arm').name == 'arm0'
    set_model_path([])
    monkeypatch.setenv('MENAGERIE', str(tmp_path / place))
    assert create_robot('menagerie:acme_arm').name == 'arm0'
    assert load_robot('menagerie:acme_arm/arm.xml').name == 'arm0'
    with pytest.raises(UnknownNameError, match='unknown model of MENAGERIE .*acme_am'):
        create_robot('menagerie:acme_am')


def test_menagerie_without_package_and_checkout_says_what_it_needs(monkeypatch):
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    with pytest.raises(ModelError, match='menagerie:x needs the package mujoco-menagerie, or a '
                                         'checkout of Menagerie in MENAGERIE_ROOT: type .pip '
                                         'install mujoco-menagerie.; without internet, bring a'):
        create_robot('menagerie:x')
    with pytest.raises(ModelError, match='robosuite:x needs the package robosuite or'):
        create_robot('robosuite:x')


def test_the_assets_of_robosuite_are_a_source_without_importing_it(site_packages):
    for package, assets in (('robosuite', 'models/assets'), ('robosuite_models', 'assets')):
        write(site_packages / package / '__init__.py', 'raise RuntimeError("imported")')
        root = site_packages / package / assets
        write(root / 'robots' / f'{package}_arm' / 'robot.xml', ARM)
        write(root / 'grippers' / f'{package}_hand.xml', HAND)
    write(site_packages / 'robosuite' / 'models' / 'assets' / 'bases' / 'post.xml', STAND)
    write(site_packages / 'robosuite' / 'models' / 'assets' / 'arenas' / 'hall.xml', FLOOR)
    assert create_robot('robosuite:robosuite_arm').joints[0] == 'robot0_turn'
    assert create_robot('robosuite:RobosuiteModelsArm').joints[0] == 'robot0_turn'
    assert create_gripper('robosuite:RobosuiteModelsHand').dof == 1
    assert create_base('robosuite:Post').root_body == 'fixed_mount0_stand'
    assert create_arena('robosuite:hall').arena_name == 'hall'
    with pytest.raises(UnknownNameError, match="unknown gripper of robosuite 'hand'"):
        create_gripper('robosuite:hand')
