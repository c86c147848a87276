# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Included files take the place of their includes, and errors name the line of the file."""

import time

import pytest

from manip_sim.errors import ModelError
from manip_sim.models.xml_model import declared_first, mended_xml, XmlModel


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


def test_defaults_of_a_document_type_are_not_added_to_each_element(tmp_path):
    found = tree(tmp_path, main='<!DOCTYPE m [<!ATTLIST a b CDATA "c">]>'
                 '<mujoco><a d="e"/></mujoco>')
    assert found[0].attrib == {'d': 'e'}


@pytest.mark.parametrize('text', [
    *(begin + unit * (200_000 // len(unit)) + end for unit in (
        b'<!--', b'<!-- ', b'-->', b'<a ', b'<a "', b"<a '\"", b'<a b=', b'<a b=c ', b'="',
        b'= ', b'&', b'&a', b'"', b' a')
        for begin in (b'', b'<a ', b'<!--') for end in (b'', b'<?xml '))],
    ids=lambda text: f'{text[:10].decode()}..{text[-6:].decode()}')
def test_no_text_takes_time_that_grows_with_its_square(text):
    begin = time.process_time()
    declared_first(text)
    mended_xml(text)
    assert time.process_time() - begin < 2.0
