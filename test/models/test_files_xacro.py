# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""xacro files become robots, with arguments from the command line or the YAML file."""

from pathlib import Path
import shlex
import shutil
import sys

from hypothesis import given, strategies
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose, load_robot
from manip_sim.models.registry import is_path
from manip_sim.models.untrusted_models import load_self_contained
from manip_sim.models.user_files import AllowedRoots, split_arguments

xacro = pytest.importorskip('xacro', reason='xacro is not installed')

FILE = (Path(__file__).parents[1]
        / 'data' / 'files' / 'two_link_description' / 'two_link.urdf.xacro')


def height_of(robot, body):
    return float(robot.compile().body(body).pos[2])


def test_a_xacro_file_is_a_robot_with_the_defaults_of_its_arguments():
    robot = load_robot(FILE)
    assert robot.arm_joints == ['robot0_upper_joint', 'robot0_lower_joint']
    assert height_of(robot, 'robot0_lower') == pytest.approx(0.2)


def test_arguments_follow_the_file_where_it_is_named():
    model = compose(f'{FILE} reach:=1.0 with_tool:=true', base='none').compile()
    assert model.body('robot0_lower').pos[2] == pytest.approx(0.5)
    assert model.body('robot0_tool').pos[2] == pytest.approx(0.5)


def test_arguments_in_a_yaml_file_give_way_to_those_behind_the_name(tmp_path):
    folder = tmp_path / 'two_link_description'
    shutil.copytree(FILE.parent, folder)
    (folder / 'two_link.yaml').write_text('xacro_args: {reach: 0.6, with_tool: true}\n')
    for named in (folder / 'two_link.yaml', folder / FILE.name):
        robot = load_robot(named)
        assert height_of(robot, 'robot0_lower') == pytest.approx(0.3)
        assert robot.eef_name['right'] == 'robot0_tool'
    robot = load_robot(f'{folder / FILE.name} reach:=0.8')
    assert height_of(robot, 'robot0_lower') == pytest.approx(0.4)
    assert robot.described['xacro_args'] == {'reach': '0.8', 'with_tool': True}


def test_a_package_is_found_by_the_name_in_its_package_xml(tmp_path):
    folder = tmp_path / 'checkout'
    shutil.copytree(FILE.parent, folder)
    with pytest.raises(ModelError, match="package 'two_link_description' is neither in AMENT"):
        load_robot(folder / FILE.name)
    (folder / 'package.xml').write_text('<package><name>two_link_description</name></package>')
    assert height_of(load_robot(folder / FILE.name), 'robot0_lower') == pytest.approx(0.2)


@pytest.mark.parametrize('marker', ['.git', 'docs'])
def test_a_package_is_found_anywhere_in_the_repository_of_the_file(tmp_path, marker):
    repository = tmp_path / 'repository'
    (repository / marker).mkdir(parents=True)
    sources = repository / 'ros' / 'two_link_description'
    shutil.copytree(FILE.parent, sources)
    (sources / 'package.xml').write_text('<package><name>two_link_description</name></package>')
    copied = repository / 'old' / 'backups' / '2026' / 'urdf' / FILE.name
    copied.parent.mkdir(parents=True)
    shutil.move(sources / FILE.name, copied)
    if marker == '.git':
        assert height_of(load_robot(copied), 'robot0_lower') == pytest.approx(0.2)
    else:
        with pytest.raises(ModelError, match="package 'two_link_description' is neither in AMENT"):
            load_robot(copied)


@pytest.mark.parametrize('named, error, message', [
    ('reech:=1.0', UnknownNameError, "unknown argument of .*two_link.urdf.xacro 'reech': did you "
     "mean 'reach'"),
    ('reach', ModelError, "arguments of .*: 'reach' is not name:=value"),
    ('reach:=1 reach:=2', ModelError, "'reach' is given twice"),
    ('reach:="1', ModelError, 'No closing quotation'),
    ('reach:=wide', ModelError, 'cannot be expanded by xacro: .*wide')])
def test_a_wrong_argument_is_explained(named, error, message):
    with pytest.raises(error, match=message):
        load_robot(f'{FILE} {named}')


def test_an_argument_without_a_value_is_explained(tmp_path):
    file = tmp_path / 'arm.xacro'
    file.write_text('<robot name="$(arg kind)" xmlns:xacro="http://www.ros.org/wiki/xacro"/>')
    with pytest.raises(ModelError, match="kind.*: give it, as in 'arm.xacro kind:=VALUE'"):
        load_robot(file)


def test_arguments_of_a_urdf_are_rejected(tmp_path):
    (tmp_path / 'arm.urdf').write_text('<robot name="r"><link name="base"/></robot>')
    (tmp_path / 'arm.yaml').write_text('xacro_args: {reach: 0.6}\n')
    with pytest.raises(ModelError, match="'xacro_args' are for a .xacro file, not for .*arm.urdf"):
        load_robot(tmp_path / 'arm.yaml')


def test_without_xacro_a_file_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, 'xacro', None)
    with pytest.raises(ModelError, match='needs xacro: pip install xacro'):
        load_robot(FILE)


def test_a_file_that_a_request_names_is_not_expanded(monkeypatch):
    def expand(*_, **__):
        raise AssertionError('it was expanded')

    monkeypatch.setattr(xacro, 'process_file', expand)
    with pytest.raises(ModelError):
        load_self_contained(FILE, AllowedRoots([FILE.parent], 'spawn_roots')).load()


@given(strategies.dictionaries(strategies.from_regex(r'[a-z_]\w{0,8}', fullmatch=True).filter(
    str.isascii), strategies.text(max_size=20)))
def test_arguments_are_what_was_written(arguments):
    name = ' '.join(['a b/arm.urdf.xacro', *(shlex.quote(f'{key}:={value}')
                                             for key, value in arguments.items())])
    assert is_path(name)
    assert split_arguments(name) == ('a b/arm.urdf.xacro', arguments)


@given(strategies.text())
def test_any_text_behind_a_file_is_arguments_or_an_error(text):
    try:
        file, _ = split_arguments(f'arm.xacro {text}')
    except ModelError as error:
        assert '\n' not in str(error)
    else:
        assert file.startswith('arm.xacro')
