# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``benchmark/foreign_models.py`` tests the robots that are in any folder."""

from pathlib import Path
import shutil

import pytest

DATA = Path(__file__).parent / 'data' / 'files'


@pytest.fixture
def bench(benchmark_module):
    """Return the module of the script."""
    return benchmark_module('foreign_models')


@pytest.fixture
def folder(tmp_path):
    """Return a folder of a lab: robots, a part of one, a scene, and what is no robot."""
    shutil.copytree(DATA, tmp_path / 'lab' / 'robots')
    for name, text in {
            'scene.xml': '<mujoco><include file="robots/stand_arm.xml"/></mujoco>',
            'whole.xml': '<mujoco><include file="parts/arm.xml"/></mujoco>',
            'parts/arm.xml': (DATA / 'stand_arm.xml').read_text(),
            'cup.xml': '<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>',
            'package.xml': '<package><name>lab</name></package>',
            'macros.xacro': '<robot xmlns:xacro="x"/>',
            'broken.urdf': '<robot name="r"><link name="a"/><joint name="b"/></robot>'}.items():
        file = tmp_path / 'lab' / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    return tmp_path


def test_whole_robots_are_found_anywhere_in_a_folder(bench, folder):
    names = {str(path) for path in bench.find_robots(folder / 'lab')}
    assert {'whole.xml', 'broken.urdf', 'robots/stand_arm.xml', 'robots/parallel_rod.urdf',
            'robots/two_link_description/two_link.urdf.xacro'} <= names
    assert not {'scene.xml', 'parts/arm.xml', 'cup.xml', 'package.xml', 'macros.xacro'} & names


@pytest.mark.full
def test_the_table_has_a_row_for_each_and_the_percentages(bench, folder, capsys):
    bench.check_folder(folder, ['stand_arm', 'two_link.urdf', 'broken'], False)
    text = capsys.readouterr().out
    assert '| lab/robots/stand_arm.xml | yes | - | 0 |' in text
    assert '| lab/robots/two_link_description/two_link.urdf.xacro | yes | - |' in text
    assert '| lab/broken.urdf | no |' in text
    assert '3 models of 1 repositories' in text
    assert 'MJCF: 1 files\n  loads: 1 of 1 (100%)' in text
    assert 'inferred:' not in text


def test_a_folder_that_is_not_there_is_told(bench, tmp_path):
    with pytest.raises(SystemExit, match='no such folder: .*gone'):
        list(bench.find_in_folder(tmp_path / 'gone', []))
