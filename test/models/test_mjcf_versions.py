# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""MJCF of earlier versions of MuJoCo loads, and a mistake is found in the file that has it."""

import re

import mujoco
import numpy as np
import pytest

from files_rig import write

from manip_sim.errors import ModelError
from manip_sim.models import load_robot
from manip_sim.models.arenas import create_arena
from manip_sim.models.files.requested_robot import load_requested
from manip_sim.models.loading import _ATTRIBUTES, _ELEMENTS
from manip_sim.models.object_creation import create_object
from manip_sim.models.user_files import AllowedRoots

ARM = """<mujoco model="old">
  {top}
  <worldbody><body name="base"><geom size="0.05"/>
    <body name="link" pos="0 0 0.1"><joint name="lift" axis="0 1 0" range="-1 1" {joint}/>
      <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02"/>{inside}</body></body></worldbody>
  <actuator><position joint="lift" kp="50" kv="2"/></actuator>
</mujoco>"""


def arm(top='', joint='', inside=''):
    return ARM.format(top=top, joint=joint, inside=inside)


#: The part of each file that MuJoCo has dropped, and the beginning of its note.
OLD = {
    'option apirate': (arm('<option apirate="200"/>'), "ignored: apirate='200' of <option>"),
    'option collision': (arm('<option collision="all"/>'), "ignored: collision='all'"),
    'option impedance': (arm('<option impedance="a"/>'), "ignored: impedance='a'"),
    'option reference': (arm('<option reference="v"/>'), "ignored: reference='v'"),
    'option mpr_iterations': (arm('<option mpr_iterations="7"/>'), 'read as ccd_iterations: '),
    'option mpr_tolerance': (arm('<option mpr_tolerance="1e-3"/>'), 'read as ccd_tolerance: '),
    'flag sensornoise': (arm('<option><flag sensornoise="enable"/></option>'),
                         "ignored: sensornoise='enable' of <flag>"),
    'flag passive': (arm('<option><flag passive="disable"/></option>'),
                     'read as spring and damper: '),
    'compiler convexhull': (arm('<compiler convexhull="false"/>'), 'ignored: convexhull'),
    'compiler exactmeshinertia': (arm('<compiler exactmeshinertia="true"/>'),
                                  'ignored: exactmeshinertia'),
    'lengthrange inteval': (arm('<compiler><lengthrange inteval="2"/></compiler>'),
                            'read as interval: '),
    'joint actuatorforcerange': (arm(joint='actuatorforcerange="-3 4"'),
                                 'read as actuatorfrcrange: '),
    'joint actuatorforcelimited': (arm(joint='actuatorforcelimited="false"'),
                                   'read as actuatorfrclimited: '),
    'camera orthographic': (arm(inside='<camera name="eye" orthographic="true"/>'),
                            'read as projection: '),
    'quality numarrows': (arm('<visual><quality numarrows="3"/></visual>'),
                          'ignored: numarrows'),
    'contact internal': (arm('<deformable><flex name="f" dim="1" body="base base" element="0 1" '
                             'vertex="0 0 0 0 0 1"><contact internal="true"/></flex>'
                             '</deformable>'),
                         "ignored: internal='true' of <contact>"),
    'contact vertcollide': (arm('<deformable><flex name="f" dim="1" body="base base" element="0 1"'
                                ' vertex="0 0 0 0 0 1"><contact vertcollide="true"/></flex>'
                                '</deformable>'), "ignored: vertcollide='true' of <contact>"),
    'flexcomp class': (arm(inside='<flexcomp class="c" name="rope" dim="1" count="3 1 1" '
                                  'spacing="0.1 0.1 0.1" rigid="true"/>'), 'ignored: class'),
    'plugin name': (arm(inside='<plugin name="p" plugin="mujoco.elasticity.none"/>'), None),
    'equality distance': (arm('<equality><distance geom1="a" geom2="b"/></equality>'),
                          'ignored: <distance>'),
    'equality flexvert': (arm('<equality><flexvert flex="a"/></equality>'),
                          'ignored: <flexvert>'),
    'extension required': (arm('<extension><required plugin="mujoco.pid"/></extension>'),
                           'read as <plugin>: <required>'),
    'composite': (arm(inside='<composite type="cloth" count="9 9 1" spacing="0.05" '
                             'flatinertia="0.01"><pin coord="0 0"/></composite>'),
                  'ignored: <composite>'),
    'material emissive': (arm('<asset><material name="m"><emissive texture="t"/></material>'
                              '</asset>'), 'ignored: <emissive>'),
    'default main': (arm('<default class="robot"><geom density="400"/></default>',
                         inside='<geom class="robot" size="0.01"/>'), "read as 'main': class="),
    'inertial quat': (arm(inside='<inertial pos="0 0 0" mass="1" quat="1 0 0 0" '
                                 'fullinertia="1 1 1 0.1 0 0"/>'), 'ignored: quat of an'),
    'plugin elasticity': (arm(
        '<extension><plugin plugin="mujoco.elasticity.cable"><instance name="soft"/></plugin>'
        '</extension>', inside='<plugin instance="soft"/><composite type="cable" curve="s" '
        'count="9 1 1" size="1"><plugin plugin="mujoco.elasticity.cable"/></composite>'),
        'ignored: <composite>'),
    'site commas': (arm(inside='<site name="s" size="0.01, 0.02, 0.03"/>'),
                    "ignored: the commas in size='0.01, 0.02, 0.03' of <site>"),
}
LOADING = {name: values for name, values in OLD.items() if values[1]}


def notes_of(robot):
    return [sentence for sentence in robot.inferred if 'which MuJoCo reads no longer' in sentence]


@pytest.mark.parametrize('name', OLD)
def test_mujoco_rejects_what_is_listed_as_dropped(name):
    with pytest.raises(ValueError, match='unrecognized|renamed|at most one|bad format|not found'):
        mujoco.MjSpec.from_string(OLD[name][0])


def test_each_dropped_attribute_and_element_has_an_example():
    texts = ' '.join(text for text, _ in OLD.values())
    assert not [key for key in _ATTRIBUTES if f'{key[1]}="' not in texts]
    layers = {parent for parent, _ in _ELEMENTS}
    assert not [parent for parent in layers if parent and f'<{parent}' not in texts]


@pytest.mark.parametrize('name', LOADING)
def test_what_mujoco_has_dropped_is_left_out_with_file_and_line(name, tmp_path):
    text, begin = LOADING[name]
    file = write(tmp_path / 'arm.xml', text)
    note, *_ = notes_of(load_robot(file))
    assert note.startswith(begin)
    assert re.search(rf' in {re.escape(str(file))}, line \d, ', note)


@pytest.mark.parametrize('name', LOADING)
def test_in_an_included_file_the_note_names_that_file(name, tmp_path):
    text, begin = LOADING[name]
    (tmp_path / 'parts').mkdir()
    part = write(tmp_path / 'parts' / 'part.xml', text)
    file = write(tmp_path / 'arm.xml', '<mujoco>\n\n\n<include file="parts/part.xml"/></mujoco>')
    note, *_ = notes_of(load_robot(file))
    assert note.startswith(begin)
    line = text[:text.index('link' if begin.startswith('read as act') else '  <')].count('\n') + 1
    assert int(re.search(rf' in {re.escape(str(part))}, line (\d+), ', note)[1]) >= line


def test_the_line_is_that_of_the_element(tmp_path):
    text = arm('<compiler angle="radian"/>\n\n  <option\n    apirate="200"/>')
    note, = notes_of(load_robot(write(tmp_path / 'arm.xml', text)))
    assert f'{tmp_path}/arm.xml, line 4, ' in note


def test_what_has_another_name_now_keeps_its_value(tmp_path):
    text = arm('<option mpr_iterations="7" mpr_tolerance="1e-3"/>',
               'actuatorforcerange="-3 4"', '<camera name="eye" orthographic="true"/>')
    spec = load_robot(write(tmp_path / 'arm.xml', text)).spec
    np.testing.assert_array_equal(spec.joint('lift').actfrcrange, [-3.0, 4.0])
    assert (spec.option.ccd_iterations, spec.option.ccd_tolerance) == (7, 1e-3)
    assert int(spec.camera('eye').proj) == int(mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC)


def test_an_outermost_default_class_of_another_name_still_holds(tmp_path):
    text = arm('<default class="robot"><geom density="400"/></default>',
               inside='<body name="tip"><geom class="robot" size="0.1" /></body>')
    model = load_robot(write(tmp_path / 'arm.xml', text)).compile()
    np.testing.assert_allclose(model.body('robot0_tip').mass[0], 400 * np.pi * 4e-3 / 3)


def test_a_sensor_of_the_name_of_a_dropped_element_stays(tmp_path):
    text = arm('<equality><distance geom1="a" geom2="b"/></equality><sensor><distance name="gap" '
               'body1="base" body2="link" cutoff="1"/></sensor>')
    assert load_robot(write(tmp_path / 'arm.xml', text)).sensors == ['robot0_gap']


def test_files_beside_an_included_file_are_found(tmp_path):
    (tmp_path / 'parts').mkdir()
    (tmp_path / 'parts' / 'tip.obj').write_text(
        'v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n')
    write(tmp_path / 'parts' / 'part.xml',
          '<mujoco><option apirate="3"/><asset><mesh file="tip.obj"/></asset></mujoco>')
    text = arm('<include file="parts/part.xml"/>', inside='<geom type="mesh" mesh="tip"/>')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert not [sentence for sentence in robot.inferred if 'left out' in sentence]


def test_a_model_that_another_one_attaches_may_be_old_too(tmp_path):
    write(tmp_path / 'tool.xml', '<mujoco model="tool">\n<option apirate="3"/><worldbody>'
                                 '<body name="b"><geom size="0.01"/></body></worldbody></mujoco>')
    text = arm('<asset><model name="tool" file="tool.xml"/></asset>',
               inside='<attach model="tool" body="b" prefix="t_"/>')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert f'{tmp_path}/tool.xml, line 2' in notes_of(robot)[0]
    assert 'robot0_t_b' in robot.bodies


def test_arenas_and_objects_may_be_old_too(tmp_path):
    room = write(tmp_path / 'room.xml', '<mujoco><option apirate="3"/><worldbody>'
                                        '<geom type="plane" size="1 1 1"/></worldbody></mujoco>')
    ball = write(tmp_path / 'ball.xml', '<mujoco><option apirate="3"/><worldbody><body name="b">'
                                        '<geom size="0.1"/></body></worldbody></mujoco>')
    for found in (create_arena(str(room)), create_object(ball),
                  create_object(ball, AllowedRoots([tmp_path], 'spawn_roots')),
                  load_requested(write(tmp_path / 'arm.xml', arm('<option apirate="3"/>')),
                                 AllowedRoots([tmp_path], 'spawn_roots'))):
        assert notes_of(found)[0].startswith("ignored: apirate='3' of <option>")


def test_a_licence_may_stand_before_the_xml_declaration(tmp_path):
    text = f'<!-- A licence -->\n\n<?xml version="1.0"?>\n{arm()}'
    assert load_robot(write(tmp_path / 'arm.xml', text)).joints == ['robot0_lift']


@pytest.mark.parametrize(('inside', 'message'), [
    ('<geom size="1" colour="1"/>', "<geom> has no attribute 'colour': correct its name, or "),
    ('\n<widget size="1"/>', 'there is no element <widget> here: correct its name or its place'),
    ('<geom type="spere" size="1"/>', "<geom>: invalid keyword: 'spere'"),
    ('<site size="1" apirate="1"/>', "<site> has no attribute 'apirate': correct its name")])
@pytest.mark.parametrize('top', ['', '<option apirate="2"/>'])
def test_a_mistake_is_told_with_file_line_and_element(inside, message, top, tmp_path):
    (tmp_path / 'parts').mkdir()
    part = write(tmp_path / 'parts' / 'part.xml', arm(top, inside=inside))
    line = 5 + inside.count('\n')
    whole = write(tmp_path / 'arm.xml', '<mujoco><include file="parts/part.xml"/></mujoco>')
    for file in (part, whole):
        expected = f'{file} is not MJCF that MuJoCo can read: {part}, line {line}: {message}'
        with pytest.raises(ModelError, match=re.escape(expected)):
            load_robot(file)


def test_what_is_requested_names_file_and_line_too(tmp_path):
    (tmp_path / 'parts').mkdir()
    part = write(tmp_path / 'parts' / 'part.xml', '<mujoco>\n\n<option apirate="3"/></mujoco>')
    tool = write(tmp_path / 'tool.xml', '<mujoco model="tool">\n<option apirate="9"/>'
                 '<worldbody><body name="b"><geom size="0.01"/></body></worldbody></mujoco>')
    text = arm('<size/><include file="parts/part.xml"/><asset><model name="tool" '
               'file="tool.xml"/></asset>\n<option collision="all"/>',
               inside='<attach model="tool" body="b" prefix="t_"/>')
    file = write(tmp_path / 'arm.xml', text)
    notes = ' '.join(notes_of(load_requested(file, AllowedRoots([tmp_path], 'spawn_roots'))))
    line = text[:text.index('collision')].count('\n') + 1
    for place in (f'{part}, line 3', f'{tool}, line 2', f'{file}, line {line}'):
        assert f' in {place}, which' in notes


def test_a_name_that_occurs_twice_is_told_with_a_remedy(tmp_path):
    file = write(tmp_path / 'arm.xml', arm(inside='\n<site name="s"/>\n<site name="s"/>'))
    with pytest.raises(ModelError, match=r"arm.xml, line 7: <site>: repeated name 's' in site: "
                                         'give one of them another name'):
        load_robot(file)
