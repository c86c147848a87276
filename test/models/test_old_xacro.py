# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""xacro files as labs have them: packages around them, files elsewhere, syntax before ROS 2."""

import re

from files_rig import write
from hypothesis import given, strategies
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import load_robot
from manip_sim.models.files.ros_packages import PackageFolders
from manip_sim.models.xml_model import declared_first

xacro = pytest.importorskip('xacro', reason='xacro is not installed')

SOLID = """<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0"
  iyz="0"/></inertial>"""
#: The arm that all files below make.
ARM = f"""<link name="base">{SOLID}</link><link name="tip">{SOLID}</link>
  <joint name="lift" type="revolute"><parent link="base"/><child link="tip"/>
  <origin xyz="0 0 %s"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="60" velocity="2"/></joint>"""
TOP = '<?xml version="1.0"?>\n<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">%s</robot>'


def package(folder, name, **files):
    """Make a package of files, by their names with double underscores for slashes."""
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / 'package.xml', f'<package format="3"><name>{name}</name></package>')
    for key, text in files.items():
        file = folder / f'{key.replace("__", "/")}.xacro'
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file, TOP % text)
    return folder


def reach(file):
    return float(load_robot(file).compile().body('robot0_tip').pos[2])


INCLUDING = '<xacro:include filename="$(find parts)/urdf/reach.xacro"/>' + ARM % '${reach}'
REACH = '<xacro:property name="reach" value="0.3"/>'


@pytest.mark.parametrize('place', [
    'src/repo/parts', 'src/repo/deep/er/parts', 'src/other_repo/manipulators/any_name'])
def test_packages_in_the_workspace_are_found(place, tmp_path):
    name = f'parts_{tmp_path.name}'
    package(tmp_path / place, name, urdf__reach=REACH)
    arm = package(tmp_path / 'src' / 'repo' / 'robots' / 'arm', 'arm',
                  urdf__arm=INCLUDING.replace('find parts', f'find {name}'))
    assert reach(arm / 'urdf' / 'arm.xacro') == pytest.approx(0.3)


def test_packages_below_ros_package_path_are_found(tmp_path, monkeypatch):
    folders = list('abcdefgh')  # So far apart that it is not found around the file.
    package(tmp_path.joinpath('ws', *folders[:3]), 'far_parts', urdf__reach=REACH)
    here = tmp_path.joinpath(*folders)
    here.mkdir(parents=True)
    file = write(here / 'arm.xacro', TOP % INCLUDING.replace('find parts', 'find far_parts'))
    with pytest.raises(ModelError, match="package 'far_parts' is neither"):
        load_robot(file)
    monkeypatch.setenv('ROS_PACKAGE_PATH', f'/nowhere:{tmp_path}/ws')
    assert reach(file) == pytest.approx(0.3)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('ROS_PACKAGE_PATH', 'ws')
    assert reach(file) == pytest.approx(0.3)


def test_folders_that_are_ignored_have_no_packages(tmp_path):
    for name in ('old', '.hidden'):
        package(tmp_path / name / 'parts_copy', 'ignored_parts')
    write(tmp_path / 'old' / 'COLCON_IGNORE', '')
    (tmp_path / 'loop').symlink_to(tmp_path)
    assert PackageFolders(tmp_path / 'a' / 'arm.xacro').find('ignored_parts') == []


def test_a_missing_package_is_told_once_with_what_to_type(tmp_path):
    file = write(tmp_path / 'arm.urdf.xacro', TOP % INCLUDING.replace('parts', 'missing_parts'))
    with pytest.raises(ModelError) as caught:
        load_robot(file)
    text = str(caught.value)
    assert text.count('is neither in AMENT') == 1
    assert text.endswith("source the workspace that has 'missing_parts', or add its folder to "
                         'ROS_PACKAGE_PATH')
    assert '<class' not in text and 'ModelError' not in text


@pytest.mark.parametrize('name', ['urdf/reach.xacro', 'deeper/urdf/reach.xacro'])
def test_a_file_that_is_installed_elsewhere_is_found_in_the_sources(name, tmp_path):
    text = INCLUDING.replace('urdf/reach.xacro', name)
    arm = package(tmp_path / 'parts', 'parts', description__urdf__reach=REACH,
                  description__robots__arm=text)
    assert reach(arm / 'description' / 'robots' / 'arm.xacro') == pytest.approx(0.3)


def test_of_two_files_none_is_taken_and_the_message_says_what_to_do(tmp_path):
    arm = package(tmp_path / 'parts', 'parts', one__urdf__reach=REACH, two__urdf__reach=REACH,
                  robots__arm=INCLUDING)
    with pytest.raises(ModelError, match=r'no such file: .*/parts/urdf/reach.xacro; if package '
                                         r"'parts' makes it .* build and source the package"):
        load_robot(arm / 'robots' / 'arm.xacro')


def test_yaml_files_are_found_in_the_sources_too(tmp_path):
    text = ('<xacro:property name="numbers" value="'
            "${xacro.load_yaml('$(find parts)/config/arm.yaml')}\"/>"
            + ARM % "${numbers['reach']}")
    arm = package(tmp_path / 'parts', 'parts', robots__arm=text)
    (arm / 'description' / 'config').mkdir(parents=True)
    write(arm / 'description' / 'config' / 'arm.yaml', 'reach: 0.4\n')
    assert reach(arm / 'robots' / 'arm.xacro') == pytest.approx(0.4)


def test_meshes_of_the_install_layout_are_found_in_the_sources(tmp_path):
    shape = ('<collision><geometry><mesh filename="package://parts/meshes/tip.obj"/></geometry>'
             '</collision>')
    arm = package(tmp_path / 'parts', 'parts', robots__arm=(
        ARM % '0.2').replace('</inertial>', f'</inertial>{shape}', 1))
    meshes = arm / 'description' / 'meshes'
    meshes.mkdir(parents=True)
    write(meshes / 'tip.obj', 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n'
                              'f 1 4 3\n')
    assert load_robot(arm / 'robots' / 'arm.xacro').compile().nmesh == 1


def test_all_required_arguments_are_named_with_what_to_type(tmp_path):
    text = ('<xacro:arg name="kind"/><xacro:arg name="scale" default="1"/>'
            '<xacro:property name="x" value="$(arg scale) $(arg kind) $(arg side)"/>'
            '<link name="$(arg kind)"/><link name="$(arg side)"/>')
    file = write(tmp_path / 'arm.urdf.xacro', TOP % text)
    with pytest.raises(ModelError, match='Undefined substitution argument kind: give it, as in '
                                         "'arm.urdf.xacro kind:=VALUE side:=VALUE', or by"):
        load_robot(file)
    with pytest.raises(ModelError, match="'arm.urdf.xacro side:=VALUE'"):
        load_robot(f'{file} kind:=a')


def test_an_error_in_an_included_file_names_it(tmp_path):
    write(tmp_path / 'part.xacro', TOP % '<link name="${1 +}"/>')
    file = write(tmp_path / 'arm.xacro', TOP % '<xacro:include filename="part.xacro"/>')
    with pytest.raises(ModelError, match=re.escape(f'by xacro: {tmp_path}/part.xacro: ')):
        load_robot(file)


@pytest.mark.parametrize(('text', 'message'), [
    ('<link name="${far}"/>', "name 'far' is not defined when .* 'far': define it by"),
    ('<xacro:hand/>', 'unknown macro name: xacro:hand: include the file that defines it$'),
    ('<xacro:macro name="m" params="a b"/><xacro:m a="1"/>',
     r"Undefined parameters \[b\] of macro 'm': give them where it is called, or defaults$"),
    ('<xacro:macro name="m" params=""/><xacro:m name="1"/>',
     "Invalid parameter \"name\" of macro 'm': take it out where it is called, or name it in "),
    ('<link name="$(env NO_SUCH_ARM)"/>',
     "environment variable 'NO_SUCH_ARM' is not set: type 'export NAME"),
    ('<link name="${xacro.load_yaml(\'no.yaml\')}"/>',
     'no such file: .*no.yaml; put it there, or correct the name$')])
def test_what_is_wrong_is_told_once_with_a_remedy(text, message, tmp_path):
    with pytest.raises(ModelError, match=f'arm.xacro cannot be expanded by xacro: {message}'):
        load_robot(write(tmp_path / 'arm.xacro', TOP % text))


def test_a_file_that_is_not_utf_8_is_told_with_the_line(tmp_path):
    file = tmp_path / 'arm.xacro'
    file.write_bytes((TOP % '\n<!-- caf\xe9 -->').encode('latin-1'))
    with pytest.raises(ModelError, match='line 3 is not UTF-8: save the file as UTF-8$'):
        load_robot(file)


def test_a_missing_namespace_is_told(tmp_path):
    file = write(tmp_path / 'arm.xacro', '<robot name="r"><xacro:hand/></robot>')
    with pytest.raises(ModelError, match='unbound prefix.*: write xmlns:xacro='):
        load_robot(file)


def test_a_file_that_only_defines_macros_says_so(tmp_path):
    file = write(tmp_path / 'arm.xacro', TOP % f'<xacro:macro name="arm">{ARM}</xacro:macro>')
    with pytest.raises(ModelError, match='makes no link: it only defines what another xacro file'):
        load_robot(file)


OLD = {
    'property, include and if without prefix':
        '<include filename="part.xacro"/><property name="far" value="0.5"/>'
        f'<if value="1">{ARM % "${far}"}</if><unless value="1"><link name="none"/></unless>',
    'macro and call without prefix':
        f'<macro name="arm" params="far *block">{ARM % "${far}"}<insert_block name="block"/>'
        '</macro><arm far="0.5"><link name="more"/></arm>',
    'call before the definition':
        f'<xacro:arm far="0.5"/><xacro:macro name="arm" params="far">{ARM % "${far}"}'
        '</xacro:macro>',
    'call without prefix before the definition':
        f'<arm far="0.5"/><macro name="arm" params="far">{ARM % "${far}"}</macro>',
    'argument without prefix': f'<arg name="far" default="0.5"/>{ARM % "$(arg far)"}',
    'property without a name': f'<property name="" value="1"/>{ARM % "0.5"}'}


@pytest.mark.parametrize('name', OLD)
def test_syntax_of_before_ros_2_is_read(name, tmp_path):
    write(tmp_path / 'part.xacro', TOP % '')
    assert reach(write(tmp_path / 'arm.xacro', TOP % OLD[name])) == pytest.approx(0.5)


def test_what_has_another_meaning_elsewhere_stays(tmp_path):
    text = (f'{ARM % "0.2"}<xacro:macro name="link"><visual/></xacro:macro>'
            '<gazebo><plugin><property name="a" value="b"/></plugin></gazebo>')
    file = write(tmp_path / 'arm.xacro', TOP % text)
    assert load_robot(file).joints == ['robot0_lift']


def test_comments_may_stand_before_the_xml_declaration(tmp_path):
    file = write(tmp_path / 'arm.xacro', f'<!-- licence -->\n{TOP % (ARM % "0.2")}')
    assert reach(file) == pytest.approx(0.2)


def test_xacro_itself_is_as_before_afterwards(tmp_path):
    before = (xacro.parse, xacro.abs_filename_spec, xacro.handle_macro_call)
    with pytest.raises(ModelError):
        load_robot(write(tmp_path / 'arm.xacro', TOP % INCLUDING.replace('parts', 'missing')))
    assert before == (xacro.parse, xacro.abs_filename_spec, xacro.handle_macro_call)


@given(strategies.text(alphabet='<!-?xml> \n"=1.0ab/', max_size=60))
def test_a_document_keeps_its_lines_whatever_stands_before_its_declaration(text):
    content = text.encode()
    assert declared_first(content).count(b'\n') == content.count(b'\n')
    assert len(declared_first(content)) == len(content)
