# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of loading one MJCF file, naming its elements and listing them."""

import copy

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.mjcf import MujocoXMLModel

PENDULUM = """
<body name="base">
  <geom name="foot" size="0.1"/>
  <body name="arm" pos="0 0 1">
    <joint name="pivot" axis="0 1 0"/>
    <geom name="rod" type="capsule" fromto="0 0 0 1 0 0" size="0.02"/>
    <site name="tip" pos="1 0 0"/>
    <camera name="eye"/>
  </body>
</body>
"""
ELEMENTS = """
<actuator><motor name="torque" joint="pivot"/></actuator>
<sensor><jointpos name="angle" joint="pivot"/></sensor>
"""


def assert_equal_models(ours, plain):
    """Compare what makes the motion; names and order of other tables may differ."""
    for field in ('body_mass', 'body_inertia', 'body_ipos', 'body_pos', 'body_quat', 'jnt_range',
                  'dof_damping', 'dof_armature', 'geom_size', 'geom_pos', 'geom_quat',
                  'actuator_gainprm', 'actuator_ctrlrange'):
        np.testing.assert_allclose(getattr(ours, field), getattr(plain, field), atol=1e-12,
                                   err_msg=field)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ModelError, match=r'^no such MJCF file: .*nowhere\.xml$'):
        MujocoXMLModel(tmp_path / 'nowhere.xml')


def test_file_that_is_not_mjcf_is_named_on_one_line(tmp_path):
    path = tmp_path / 'broken.xml'
    path.write_text('<mujoco><worldbudy/></mujoco>')
    with pytest.raises(ModelError, match=r'broken\.xml is not MJCF that MuJoCo can read: .+'
                       ) as error:
        MujocoXMLModel(path)
    assert '\n' not in str(error.value)


def test_model_that_does_not_compile_says_why(mjcf):
    path = mjcf(PENDULUM, '<actuator><motor joint="elbow"/></actuator>')
    with pytest.raises(ModelError, match=r'^MujocoXMLModel0 does not compile: .*elbow'):
        MujocoXMLModel(path)


@pytest.mark.parametrize(('worldbody', 'message'), [
    ('', 'must have exactly one root body, found 0: none'),
    ('<body name="a"/><body name="b"/>', 'must have exactly one root body, found 2: a, b')])
def test_root_body_must_be_the_only_one(mjcf, worldbody, message):
    with pytest.raises(ModelError, match=message):
        MujocoXMLModel(mjcf(worldbody)).root_body  # noqa: B018


def test_ranges_are_told_by_name_and_follow_edits(mjcf):
    path = mjcf('<body name="a"><geom size="1"/><joint name="free_to_turn"/>'
                '<body><geom size="1"/><joint name="hinge" range="-1 2"/></body></body>',
                '<actuator><motor name="torque" joint="hinge" ctrlrange="-3 4"/>'
                '<motor name="endless" joint="free_to_turn"/></actuator>')
    model = MujocoXMLModel(path, idn='b')
    joints, controls = model.joint_ranges, model.control_ranges
    assert list(joints) == model.joints and list(controls) == model.actuators
    np.testing.assert_array_equal(joints['b_hinge'], [-1.0, 2.0])
    np.testing.assert_array_equal(joints['b_free_to_turn'], [-np.inf, np.inf])
    np.testing.assert_array_equal(controls['b_torque'], [-3.0, 4.0])
    np.testing.assert_array_equal(controls['b_endless'], [0.0, 0.0])
    joints['b_hinge'][:] = 7.0
    model.spec.joint('hinge').range = [-0.5, 0.5]
    model.refresh()
    np.testing.assert_array_equal(model.joint_ranges['b_hinge'], [-0.5, 0.5])


def test_every_element_is_listed_with_the_prefix(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM, ELEMENTS), idn='a')
    assert model.name == 'MujocoXMLModela'
    assert model.root_body == 'a_base'
    assert model.bodies == ['a_base', 'a_arm']
    assert model.joints == ['a_pivot']
    assert model.actuators == ['a_torque']
    assert model.sites == ['a_tip']
    assert model.sensors == ['a_angle']
    assert model.cameras == ['a_eye']
    assert model.contact_geoms == ['a_foot', 'a_rod']
    assert model.dof == 1


def test_listed_names_are_those_of_the_compiled_model(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM, ELEMENTS))
    compiled = model.compile()
    assert [compiled.body(i).name for i in range(1, compiled.nbody)] == model.bodies
    assert compiled.sensor(0).name == model.sensors[0]
    assert compiled.joint(compiled.actuator_trnid[0, 0]).name == model.joints[0]


def test_name_that_begins_with_the_prefix_gets_it_again_in_list_and_model(mjcf):
    model = MujocoXMLModel(mjcf('<body name="0_base"><geom size="0.1"/></body>'))
    assert model.bodies == ['0_0_base']
    assert model.compile().body(1).name == '0_0_base'


def test_unnamed_elements_get_names_that_are_free(mjcf):
    model = MujocoXMLModel(mjcf("""
        <body>
          <joint/>
          <geom size="0.1"/><geom name="g1_col" size="0.1"/><geom size="0.1"/>
          <geom size="0.1" contype="0" conaffinity="0"/>
          <site/><site name="site1"/><site/>
          <camera/>
        </body>""", '<actuator><motor site="site1"/></actuator>'))
    assert model.joints == ['0_joint0']
    assert model.sites == ['0_site0', '0_site1', '0_site2']
    assert model.contact_geoms == ['0_g0_col', '0_g1_col', '0_g2_col']
    assert model.visual_geoms == ['0_g0_vis']
    assert len(model.bodies) == len(model.cameras) == len(model.actuators) == 1
    assert all(model.bodies + model.cameras + model.actuators)


def test_free_joint_is_no_joint_and_ball_joint_counts_once(mjcf):
    model = MujocoXMLModel(mjcf("""
        <body><freejoint name="free"/><geom size="0.1"/>
          <body><joint name="ball" type="ball"/><geom size="0.1"/></body>
        </body>"""))
    assert model.joints == ['0_ball']


def test_contact_geoms_are_told_by_collision_and_not_by_group(mjcf):
    model = MujocoXMLModel(mjcf("""
        <body>
          <geom name="seen" group="0" size="0.1" contype="0" conaffinity="0"/>
          <geom name="hit" group="3" size="0.1"/>
          <geom name="only_affinity" group="1" size="0.1" contype="0"/>
        </body>"""))
    assert model.contact_geoms == ['0_hit', '0_only_affinity']
    assert model.visual_geoms == ['0_seen']


def test_body_in_a_frame_is_the_root_and_stands_where_the_frame_is(mjcf):
    model = MujocoXMLModel(mjcf('<frame pos="0 0 2"><body name="base" pos="1 0 0">'
                                '<geom size="0.1"/></body></frame>'))
    assert model.root_body == '0_base'
    np.testing.assert_allclose(model.base_offset, [1, 0, 2])
    np.testing.assert_allclose(model.compile().body('0_base').pos, [1, 0, 2])


def test_a_part_stands_with_its_root_and_what_it_carries_stands_at_its_origin(mjcf):
    model = MujocoXMLModel(mjcf('<body name="base" pos="1 2 3"><geom size="0.1"/></body>'))
    np.testing.assert_array_equal(model.bottom_offset, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(model.top_offset, [0.0, 0.0, 0.0])


@pytest.mark.parametrize('angle', ['degree', 'radian'])
def test_composed_model_equals_the_plain_one(mjcf, angle):
    path = mjcf("""
        <body name="base" childclass="arm" euler="0.3 0.2 0.1">
          <geom size="0.1"/>
          <frame pos="0 0 1" euler="0.1 0 0">
            <body name="link"><joint range="-1 2"/><geom class="thin"/>
              <body name="tip" pos="0 0 1"><joint class="stiff" axis="1 0 0"/>
                <geom class="thin"/></body>
            </body>
          </frame>
        </body>""", """
        <default>
          <joint damping="5"/>
          <default class="arm"><joint armature="0.1"/>
            <default class="stiff"><joint damping="7" range="0 1"/></default>
            <default class="thin"><geom type="capsule" size="0.02 0.4" mass="0.5"/></default>
          </default>
        </default>
        """, angle=angle)
    plain = mujoco.MjModel.from_xml_path(str(path))
    ours = MujocoXMLModel(path).compile()
    assert_equal_models(ours, plain)
    damping = np.asarray(ours.dof_damping).reshape(ours.nv, -1)[:, 0]
    np.testing.assert_allclose(damping, [5, 7])


def test_xml_compiles_to_an_equal_model(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM, ELEMENTS), idn=3)
    from_xml, ours = mujoco.MjModel.from_xml_string(model.to_xml()), model.compile()
    assert_equal_models(from_xml, ours)
    assert from_xml.names == ours.names


def test_xml_with_sensors_of_no_element_loads(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM, '<sensor><user name="own" dim="3"/><clock/></sensor>'))
    from_xml = mujoco.MjModel.from_xml_string(model.to_xml())
    assert [from_xml.sensor(i).name for i in range(2)] == model.sensors == ['0_own', '0_sensor0']
    np.testing.assert_array_equal(from_xml.sensor_dim, [3, 1])


def test_total_mass_of_a_file_is_that_of_the_part_alone(mjcf):
    path = mjcf(PENDULUM, '<compiler settotalmass="7"/>')
    ours = MujocoXMLModel(path).compile()
    plain = mujoco.MjModel.from_xml_string(
        path.read_text().replace('<compiler settotalmass="7"/>', ''))
    assert ours.body_mass.sum() == pytest.approx(7.0)
    scale = 7.0 / plain.body_mass.sum()
    assert scale != pytest.approx(1.0)
    np.testing.assert_allclose(ours.body_mass, scale * plain.body_mass)
    np.testing.assert_allclose(ours.body_inertia, scale * plain.body_inertia)
    np.testing.assert_allclose(ours.body_ipos, plain.body_ipos)


def test_edits_of_the_spec_are_compiled(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM))
    model.spec.geom('rod').size[0] = 0.05
    assert model.compile().geom('0_rod').size[0] == 0.05


def test_options_of_the_file_are_kept_where_it_stands_alone(mjcf):
    path = mjcf(PENDULUM, '<option timestep="0.004"/><keyframe><key qpos="1"/></keyframe>')
    assert MujocoXMLModel(path).compile().opt.timestep == 0.004


def test_part_of_the_same_prefix_is_rejected_before_anything_is_added(mjcf):
    first, second = MujocoXMLModel(mjcf(PENDULUM)), MujocoXMLModel(mjcf(PENDULUM))
    spec = first.compose()
    with pytest.raises(ModelError, match=r"^body '0_base' already exists, MujocoXMLModel0 "
                                         r'cannot bring another: change the idn or prefix of '
                                         r'MujocoXMLModel0, or the name in its file$'):
        second.attach_to(spec, spec.worldbody.add_frame())
    assert len(spec.bodies) == 3


def test_correct_naming_copies_strings_sequences_and_mappings(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM))
    names = ['a', 'b']
    assert model.correct_naming('a') == '0_a'
    assert model.correct_naming(names) == ['0_a', '0_b']
    assert model.correct_naming(('a',)) == ['0_a']
    assert model.correct_naming({'k': names, 'm': {'n': 'c'}}) == {
        'k': ['0_a', '0_b'], 'm': {'n': '0_c'}}
    assert names == ['a', 'b']


def test_correct_naming_rejects_other_types(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM))
    with pytest.raises(TypeError, match=r'^names must be a str, a list, a tuple or a dict of '
                                        r'them, not int$'):
        model.correct_naming(3)


@pytest.mark.parametrize(('attribute', 'value', 'kind'), [
    ('_important_sites', {'tip': 'tp'}, 'site'), ('_important_sensors', {'a': 'tp'}, 'sensor'),
    ('_important_geoms', {'rods': ['foot', 'tp']}, 'geom')])
def test_declared_names_must_exist(mjcf, attribute, value, kind):
    declaring = type('Declaring', (MujocoXMLModel,), {attribute: value})
    with pytest.raises(UnknownNameError,
                       match=rf"^unknown {kind} of Declaring0 in .*model\.xml 'tp': .*available"):
        declaring(mjcf(PENDULUM, ELEMENTS))


def test_lists_are_copies(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM))
    model.joints.clear()
    model.base_offset[:] = 9.0
    assert model.joints == ['0_pivot']
    np.testing.assert_array_equal(model.base_offset, np.zeros(3))


@pytest.mark.parametrize(('name', 'instead'), [
    ('root', r'use spec \(a mujoco\.MjSpec\)'), ('worldbody', r'use spec\.worldbody'),
    ('asset', r'spec\.meshes'), ('merge', 'compose or World'), ('get_element_names', 'joints'),
    ('contact_geom_rgba', 'contact_geoms'), ('grasp_qpos', 'format_action')])
def test_what_robosuite_has_and_is_not_here_names_its_replacement(mjcf, name, instead):
    model = MujocoXMLModel(mjcf(PENDULUM))
    with pytest.raises(AttributeError, match=f"'MujocoXMLModel' .* '{name}': .*{instead}"):
        getattr(model, name)
    assert not hasattr(model, name)


def test_the_error_of_a_property_is_not_hidden(mjcf):
    class Broken(MujocoXMLModel):
        @property
        def merge(self):
            return {}.nothing

    with pytest.raises(AttributeError, match="'dict' object has no attribute 'nothing'"):
        assert not Broken(mjcf(PENDULUM)).merge


def test_models_are_written_under_the_names_of_robosuite(mjcf, tmp_path):
    model = MujocoXMLModel(mjcf(PENDULUM))
    model.save_model(tmp_path / 'model.xml', pretty=True)
    assert (tmp_path / 'model.xml').read_text() == model.get_xml() == model.to_xml()
    with pytest.raises(ModelError, match='cannot write .*: No such file or directory'):
        model.save_model(tmp_path / 'nowhere' / 'model.xml')


def test_a_copy_has_the_same_elements(mjcf):
    model = MujocoXMLModel(mjcf(PENDULUM))
    assert copy.copy(model).joints == model.joints
