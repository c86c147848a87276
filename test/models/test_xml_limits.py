# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the XML of a model may ask for: the limit itself passes, one more does not."""

import pytest

from manip_sim.errors import ModelError
from manip_sim.models.object_creation import create_object
from manip_sim.models.regular_files import AllowedRoots
from manip_sim.models.untrusted_models import load_self_contained
from manip_sim.models.xml_check import Budget, excess, Limits, product, XmlModel

USERS = [f'nuser_{kind}' for kind in (
    'body', 'jnt', 'geom', 'site', 'cam', 'tendon', 'actuator', 'sensor')]


@pytest.mark.parametrize(('tag', 'most', 'more', 'told'), [
    ('hfield', {'nrow': 4000, 'ncol': 4000}, {'nrow': 4000, 'ncol': 4001}, 'nrow times ncol'),
    ('numeric', {'size': 1_000_000}, {'size': 1_000_001}, 'size of numeric is more than 1e+06'),
    ('size', {'nkey': 1000}, {'nkey': 1001}, 'nkey of size is more than 1000'),
    ('size', {'nuserdata': 10_000_000}, {'nuserdata': 10_000_001}, 'nuserdata of size'),
    *(('size', {name: 1000}, {name: 1001}, f'{name} of size is more than 1000')
      for name in USERS),
    ('mesh', {'params': '3 500'}, {'params': '3 501'}, 'a parameter of a builtin mesh'),
    ('texture', {'type': '2d', 'width': 12_000, 'height': 10_000},
     {'type': '2d', 'width': 12_000, 'height': 10_001}, 'the number of pixels of a texture'),
    ('texture', {'width': 4472}, {'width': 4473}, 'the number of pixels of a texture')])
def test_the_greatest_number_passes_and_the_next_one_does_not(tag, most, more, told):
    def found(numbers):
        return excess(tag, {name: str(number) for name, number in numbers.items()})
    assert found(most) == '' and told in found(more)
    # The same attributes of another element mean something else.
    assert excess('geom', {name: str(number) for name, number in more.items()}) == ''


@pytest.mark.parametrize(('text', 'expected'), [
    ('2 3', 6), ('', 1), ('0.5 -7 0', 1), ('nonsense', 1), ('1e9 1e9', 10**15), ('nan', 1)])
def test_a_product_is_of_what_is_above_one_and_has_an_end(text, expected):
    assert product({'count': text}, 'count', 'other') == expected


def model(tmp_path, limits, **files):
    for name, content in files.items():
        (tmp_path / f'{name}.xml').write_text(content)
    return XmlModel(tmp_path / 'main.xml', Budget(Limits(**limits)))


MAIN = '<mujoco><include file="a.xml"/><include file="a.xml"/></mujoco>'
REPLICATED = '<mujoco><replicate count="3"><geom/><geom/></replicate></mujoco>'


@pytest.mark.parametrize(('limit', 'most', 'files'), [
    ('files', 3, {'main': MAIN, 'a': '<a/>'}), ('depth', 1, {'main': MAIN, 'a': '<a/>'}),
    ('bytes', len(MAIN) + 8, {'main': MAIN, 'a': '<a/>'}),
    ('keys', 2, {'main': '<mujoco><keyframe><key/><key/></keyframe></mujoco>'}),
    ('made', 6, {'main': REPLICATED}), ('nested', 3, {'main': REPLICATED}),
    ('made', 4, {'main': '<mujoco><composite count="2 2 1"/></mujoco>'}),
    ('flex', 24, {'main': '<mujoco><replicate count="2"><flexcomp count="2 3 2"/></replicate>'
                          '</mujoco>'}),
    ('flex', 2, {'main': '<mujoco><flexcomp type="direct" point="0 0 0 1 1 1"/></mujoco>'}),
    ('flex', 5, {'main': '<mujoco><flex body="a b c"/><flex body="a" vertex="0 0 0 1 1 1"/>'
                         '</mujoco>'}),
    ('made', 3, {'main': '<mujoco><asset><model name="m" file="a.xml"/></asset>'
                         '<attach model="m"/><replicate count="2"><attach model="m"/></replicate>'
                         '</mujoco>', 'a': '<mujoco/>'})])
def test_a_limit_of_a_whole_model_is_reached_but_not_passed(limit, most, files, tmp_path):
    model(tmp_path, {limit: most}, **files)
    with pytest.raises(ModelError, match='more than|at most'):
        model(tmp_path, {limit: most - 1}, **files)


def test_a_flex_that_takes_minutes_is_rejected_before_it_is_compiled(tmp_path):
    file = tmp_path / 'soft.xml'
    file.write_text('<mujoco><worldbody><body name="o"><geom size="0.1"/><flexcomp name="f" '
                    'type="grid" count="25 25 25" spacing="1 1 1" dim="3" mass="1"/></body>'
                    '</worldbody></mujoco>')
    with pytest.raises(ModelError, match=r'soft.xml, line 1: flexes with more than 5000 vertices'):
        create_object({'name': 'o', 'file': str(file)})


def test_the_text_of_a_stranger_has_a_thousand_elements_at_most(tmp_path):
    file = tmp_path / 'many.xml'
    file.write_text('<mujoco><worldbody><body name="o">' + 20_000 * '<geom size="0.1"/>'
                    + '</body></worldbody></mujoco>')
    with pytest.raises(ModelError, match='a model may have at most 1000 elements'):
        load_self_contained(file, AllowedRoots([tmp_path], 'spawn_roots'))


def test_elements_of_copies_and_of_attached_models_count(tmp_path):
    files = {'main': '<mujoco><asset><model name="m" file="a.xml"/></asset>'
                     '<replicate count="2"><attach model="m"/></replicate></mujoco>',
             'a': '<mujoco><geom/></mujoco>'}
    # Those of the file: 4 and 2 copies of attach; of the model: 2 in each copy.
    assert model(tmp_path, {}, **files).elements == 6 + 2 * 2


def test_an_included_file_takes_the_place_of_the_include(tmp_path):
    found = model(tmp_path, {}, main='<mujoco><b/><include file="a.xml"/><e/></mujoco>',
                  a='<any><c><d/></c><include file="c.xml"/></any>', c='<any><f/></any>').tree
    assert [element.tag for element in found.iter()] == ['mujoco', 'b', 'c', 'd', 'f', 'e']


def test_what_an_include_that_is_a_root_includes_takes_its_place_too(tmp_path):
    found = model(tmp_path, {}, main='<mujoco><b/><include file="a.xml"/><e/></mujoco>',
                  a='<include file="c.xml"/>', c='<any><f><g/></f></any>').tree
    assert [element.tag for element in found.iter()] == ['mujoco', 'b', 'f', 'g', 'e']


def test_the_line_behind_an_include_is_that_of_its_own_file(tmp_path):
    with pytest.raises(ModelError, match=r'main\.xml, line 4: nkey of size is more than 1000$'):
        model(tmp_path, {}, a='<any>\n\n\n<b/>\n<b/></any>',
              main='<mujoco>\n<include file="a.xml"/>\n<b/>\n<size nkey="1001"/></mujoco>')
