# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Included files take the place of their includes, and errors name the line of the file."""

import pytest

from manip_sim.errors import ModelError
from manip_sim.models.xml_model import XmlModel


def tree(tmp_path, **files):
    for name, content in files.items():
        (tmp_path / f'{name}.xml').write_text(content)
    return XmlModel(tmp_path / 'main.xml').tree


def test_an_included_file_takes_the_place_of_the_include(tmp_path):
    found = tree(tmp_path, main='<mujoco><b/><include file="a.xml"/><e/></mujoco>',
                 a='<any><c><d/></c><include file="c.xml"/></any>', c='<any><f/></any>')
    assert [element.tag for element in found.iter()] == ['mujoco', 'b', 'c', 'd', 'f', 'e']


def test_what_an_include_that_is_a_root_includes_takes_its_place_too(tmp_path):
    found = tree(tmp_path, main='<mujoco><b/><include file="a.xml"/><e/></mujoco>',
                 a='<include file="c.xml"/>', c='<any><f><g/></f></any>')
    assert [element.tag for element in found.iter()] == ['mujoco', 'b', 'f', 'g', 'e']


def test_the_line_behind_an_include_is_that_of_its_own_file(tmp_path):
    with pytest.raises(ModelError, match=r'main\.xml, line 4: <model> needs a file$'):
        tree(tmp_path, a='<any>\n\n\n<b/>\n<b/></any>',
             main='<mujoco>\n<include file="a.xml"/>\n<b/>\n<model/></mujoco>')
