# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of objects: shapes, MJCF files, lists in YAML, and what is wrong with them."""

import math
import re

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose, spec_edits
from manip_sim.models.arenas import TableArena
from manip_sim.models.object_creation import create_object, create_objects, load_objects
from manip_sim.models.world import World

BOX = {'name': 'brick', 'shape': 'box', 'size': [0.1, 0.2, 0.3], 'mass': 2.0}
MUG = """<mujoco>
  <compiler angle="degree" meshdir="meshes"/>
  <default><geom solref="0.03 1"/><default class="clay"><geom friction="0.7"/></default></default>
  <asset>
    <mesh file="tetrahedron.obj"/>
    <material name="clay" rgba="0.6 0.3 0.2 1"/>
  </asset>
  <worldbody>
    <frame pos="0 0 1">
      <body name="mug" pos="1 0 0" euler="0 0 90">
        {joint}
        <geom class="clay" type="mesh" mesh="tetrahedron" material="clay" mass="0.2"/>
        <body name="lid" pos="0 0 0.1">
          <joint name="hinge" range="0 90" limited="true"/>
          <geom name="lid" size="0.02" mass="0.1"/>
        </body>
      </body>
    </frame>
    {beside}
  </worldbody>
  <contact><exclude body1="mug" body2="lid"/></contact>
  <sensor><framepos objtype="body" objname="mug"/></sensor>
  {sections}
</mujoco>"""
TETRAHEDRON = """v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1
f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"""


@pytest.fixture
def mug_file(tmp_path):
    """Return a function that writes the file of an object with a mesh of its own."""
    def write(joint='', beside='', sections='', name='mug.xml'):
        folder = tmp_path / 'parts'
        (folder / 'meshes').mkdir(parents=True, exist_ok=True)
        (folder / 'meshes' / 'tetrahedron.obj').write_text(TETRAHEDRON)
        (folder / name).write_text(MUG.format(joint=joint, beside=beside, sections=sections))
        return folder / name
    return write


# ---------------------------------------------------------------------- shapes


def test_a_box_has_the_extents_the_mass_and_the_inertia_of_its_description():
    model = create_object(BOX).compile()
    np.testing.assert_allclose(2.0 * model.geom('brick').size, [0.1, 0.2, 0.3])
    assert model.body('brick').mass[0] == pytest.approx(2.0)
    x, y, z = 0.1, 0.2, 0.3
    expected = 2.0 / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(sorted(model.body('brick').inertia), sorted(expected))
    assert int(model.joint('brick_joint').type[0]) == int(mujoco.mjtJoint.mjJNT_FREE)


@pytest.mark.parametrize(('shape', 'size', 'volume', 'highest'), [
    ('box', [0.2, 0.3, 0.4], 0.024, 0.2),
    ('sphere', 0.1, 4.0 / 3.0 * math.pi * 0.001, 0.1),
    ('cylinder', [0.1, 0.4], math.pi * 0.004, 0.2),
    ('capsule', [0.1, 0.4], math.pi * 0.004 + 4.0 / 3.0 * math.pi * 0.001, 0.3),
    ('ellipsoid', [0.1, 0.2, 0.3], 4.0 / 3.0 * math.pi * 0.006, 0.3)])
def test_size_and_density_are_in_the_units_of_users(shape, size, volume, highest):
    item = create_object({'name': 'thing', 'shape': shape, 'size': size, 'density': 500.0})
    assert item.mass_kg == pytest.approx(500.0 * volume)
    model = item.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    down = mujoco.mj_ray(model, data, np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -1.0]),
                         None, 1, -1, np.zeros(1, dtype=np.int32))
    assert 5.0 - down == pytest.approx(highest)


def test_what_is_not_said_of_a_shape_is_as_in_mujoco():
    item = create_object({'name': 'ball', 'shape': 'sphere', 'size': 0.1})
    geom = item.compile().geom('ball')
    assert item.mass_kg == pytest.approx(1000.0 * 4.0 / 3.0 * math.pi * 0.001)
    np.testing.assert_array_equal(geom.friction, [1.0, 0.005, 0.0001])
    assert geom.condim == 3


def test_friction_colour_and_contact_dimension_are_set():
    geom = create_object({**BOX, 'friction': [0.4, 0.02], 'rgba': [1, 0, 0], 'condim': 4}
                         ).compile().geom('brick')
    np.testing.assert_allclose(geom.friction, [0.4, 0.02, 0.0001])
    np.testing.assert_allclose(geom.rgba, [1, 0, 0, 1])
    assert geom.condim == 4
    assert create_object({**BOX, 'friction': 0.3}).compile().geom('brick').friction[0] == 0.3


@pytest.mark.parametrize('orientation', [
    {'rpy': [0.0, 0.0, math.pi / 2.0]}, {'quat_xyzw': [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]}])
def test_an_object_starts_where_it_is_placed(orientation):
    model = create_object({**BOX, 'position': [1, 2, 3], **orientation}).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body('brick').xpos, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(data.body('brick').xmat.reshape(3, 3) @ [1, 0, 0], [0, 1, 0],
                               atol=1e-12)


# ---------------------------------------------------------------------- files


def test_an_object_of_a_file_brings_its_own_mesh_and_its_place(mug_file, monkeypatch):
    item = create_object(mug_file())
    monkeypatch.chdir('/')
    model = World([], objects=[item, {**BOX, 'position': [0, 0, 1]}]).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body('mug').xpos, [1.0, 0.0, 1.0])
    np.testing.assert_allclose(data.body('mug').xquat, [math.sqrt(0.5), 0, 0, math.sqrt(0.5)])
    assert [model.joint(i).name for i in range(3)] == ['mug_joint', 'mug_hinge', 'brick_joint']
    np.testing.assert_allclose(model.joint('mug_hinge').range, [0.0, math.pi / 2.0])
    assert model.mesh('mug_tetrahedron').vertnum == 4
    assert model.geom('mug_g0_col').friction[0] == 0.7
    np.testing.assert_allclose(model.geom('mug_lid').solref, [0.03, 1.0])
    assert model.body('mug_lid').parentid[0] == model.body('mug').id
    assert item.mass_kg == pytest.approx(0.3)
    # What refers to the body finds it by its new name.
    assert model.sensor('mug_sensor0').objid[0] == model.body('mug').id
    assert model.nexclude == 1


def test_a_tuple_of_a_file_has_the_root_by_its_name_in_the_world(mjcf):
    file = mjcf('<body name="mug"><geom name="mug" size="0.03"/></body>',
                '<custom><tuple name="all"><element objtype="body" objname="mug"/>'
                '<element objtype="geom" objname="mug"/></tuple></custom>')
    model = create_object({'name': 'cup', 'file': str(file)}).compile()
    assert model.tuple_objid.tolist() == [model.body('cup').id, model.geom('cup_mug').id]


def test_an_object_of_a_file_may_have_another_name_and_place(mug_file):
    item = create_object({'name': 'cup', 'file': str(mug_file()), 'position': [0, 0, 2],
                          'rpy': [0, 0, 0]})
    model = World([], objects=[item, mug_file()]).compile()
    np.testing.assert_allclose(model.body('cup').pos, [0.0, 0.0, 2.0])
    np.testing.assert_allclose(model.body('cup').quat, [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    assert {'cup', 'cup_lid', 'mug', 'mug_lid'} <= {
        model.body(i).name for i in range(model.nbody)}


@pytest.mark.parametrize('joint', ['<freejoint/>', '<freejoint name="root"/>'])
def test_a_free_joint_that_a_file_has_is_kept(mug_file, joint):
    item = create_object(mug_file(joint))
    assert item.free_joint == ('mug_root' if 'root' in joint else 'mug_joint')
    model = item.compile()
    assert (model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).sum() == 1
    assert model.joint(item.free_joint).bodyid[0] == model.body('mug').id


@pytest.mark.parametrize(('parts', 'message'), [
    ({'joint': '<joint name="slide" type="slide"/>'},
     "must be free, found joint 'slide': remove the joint"),
    ({'beside': '<body name="saucer"><geom size="0.1"/></body>'},
     'an object is one root body, found 2: mug, saucer'),
    ({'beside': '<geom size="0.1"/>'},
     'an object is one root body, found geoms beside it: put them into the body mug'),
    ({'sections': '<asset><hfield name="hill" nrow="2" ncol="2" size="1 1 1 1"/></asset>'},
     'an object cannot have height fields')])
def test_a_file_that_is_no_object_is_rejected(mug_file, parts, message):
    path = mug_file(**parts)
    with pytest.raises(ModelError, match=f'^{re.escape(str(path))}.*{message}') as error:
        create_object(path)
    assert '\n' not in str(error.value)


def test_a_missing_mesh_is_told(mug_file):
    path = mug_file()
    (path.parent / 'meshes' / 'tetrahedron.obj').unlink()
    said, mass = create_object(path).inferred
    assert re.search(r'no such file: .*tetrahedron\.obj', said)
    assert mass.startswith('guessed: the mass of 1 body of ')


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(ModelError, match=r'^no such MJCF file: .*nothing\.xml$'):
        create_object(tmp_path / 'nothing.xml')


def test_a_file_that_is_too_heavy_is_rejected(mjcf):
    path = mjcf('<body name="moon"><geom size="10" mass="1e6"/></body>')
    with pytest.raises(ModelError, match=r'weighs 1e\+06 kg, it must be 1e-05 to 100000 kg$'):
        create_object(path)


def test_a_file_without_a_name_of_its_body_needs_one(mjcf):
    with pytest.raises(ModelError, match="'MuJoCo Model' cannot be the name of an object"):
        create_object(mjcf('<body><geom size="0.1"/></body>'))


def test_options_and_keyframes_of_a_file_stay_behind(mug_file):
    item = create_object(mug_file(sections=(
        '<option timestep="0.1" gravity="0 0 1" integrator="RK4"/><keyframe><key/></keyframe>')))
    plain, model = World([]).compile(), World([], objects=[item]).compile()
    assert model.opt.timestep == plain.opt.timestep
    assert model.opt.integrator == plain.opt.integrator
    np.testing.assert_array_equal(model.opt.gravity, plain.opt.gravity)
    assert model.nkey == 0


# ---------------------------------------------------------------------- YAML


def test_a_written_lists_objects_with_files_beside_it(mug_file, written, monkeypatch):
    mug_file()
    monkeypatch.chdir('/')
    path = written("""
objects:
- name: brick
  shape: box
  size: [0.1, 0.2, 0.3]
  mass: 2
  position: [0.5, 0, 1]
- {file: parts/mug.xml}
- {name: ball, shape: sphere, size: 0.05, density: 200.0, condim: 6}
""")
    assert [item.name for item in load_objects(path)] == ['brick', 'mug', 'ball']
    assert [item.name for item in create_objects([path, {**BOX, 'name': 'other'}])] == [
        'brick', 'mug', 'ball', 'other']
    model = compose(arena='table', cube=False, objects=[path]).compile()
    assert [model.body(i).name for i in range(model.nbody)][-4:] == [
        'brick', 'mug', 'mug_lid', 'ball']


def test_a_yaml_file_with_one_object_is_an_object(written):
    one = '- {name: ball, shape: sphere, size: 0.1}\n'
    assert create_object(written(f'objects:\n{one}')).name == 'ball'
    with pytest.raises(ModelError, match=r'must list one object here, it lists 2'):
        create_object(written(f'objects:\n{one}{one.replace("ball", "other")}'))


GOOD = '{name: brick, shape: box, size: [0.1, 0.1, 0.1]'


@pytest.mark.parametrize(('text', 'message'), [
    (f'objects: [{GOOD}, mas: 1}}]', "object 'brick': unknown key 'mas': did you mean 'mass'"),
    ('objects: [{name: brick, shape: box, sise: 1}]',
     "object 'brick': unknown key 'sise': did you mean 'size'"),
    ('objects: [{shape: box, size: [1, 1, 1]}]', "object 1: needs 'name'"),
    ('objects: [{name: brick, size: [1, 1, 1]}]', "object 'brick': needs 'shape'"),
    ('objects: [{name: brick, shape: bax, size: 1}]',
     "object 'brick': 'shape' is unknown: did you mean 'box'"),
    ('objects: [{name: brick, shape: box, size: [1, 1]}]',
     r"object 'brick': 'size' of a box is \[x, y, z\], its full extents \[m\], got 2 numbers"),
    ('objects: [{name: can, shape: cylinder, size: 0.1}]',
     r"'size' of a cylinder is \[radius, length\] \[m\], got 1 number"),
    ('objects: [{name: brick, shape: box, size: [1, 0, 1]}]',
     r"'size'\[1\] must be at least 0.0001, got 0"),
    ('objects: [{name: brick, shape: box, size: [1, 1, true]}]',
     r"'size'\[2\] must be a number, got True"),
    (f'objects: [{GOOD}, mass: -1}}]', "'mass' must be at least 1e-05, got -1"),
    (f'objects: [{GOOD}, mass: .nan}}]', "'mass' must be .*, got nan"),
    (f'objects: [{GOOD}, mass: .inf}}]', "'mass' must be .*, got inf"),
    (f'objects: [{GOOD}, mass: heavy}}]', "'mass' must be a number, got 'heavy'"),
    (f'objects: [{GOOD}, mass: 1e-3}}]', "'mass' must be a number, which YAML reads as a string: "
     "write 1.0e-3, got '1e-3'"),
    (f'objects: [{GOOD}, mass: {"9" * 400}}}]', 'integers have at most 64 bits'),
    (f'objects: [{GOOD}, mass: 1, density: 1}}]', "give 'mass' or 'density', not both"),
    (f'objects: [{GOOD}, density: 0.001}}]', 'weighs 1e-06 kg by its density, it must be 1e-05'),
    (f'objects: [{GOOD}, friction: [1, 2, 3, 4]}}]', "'friction' must have at most 3 of them"),
    (f'objects: [{GOOD}, friction: -0.1}}]', r"'friction'\[0\] must be at least 0, got -0.1"),
    (f'objects: [{GOOD}, rgba: [1, 1]}}]', "'rgba' must have at least 3 of them"),
    (f'objects: [{GOOD}, rgba: red}}]', "'rgba' must be a list, got 'red'"),
    (f'objects: [{GOOD}, rgba: [0, 0, 255]}}]', r"'rgba'\[2\] must be at most 1, got 255"),
    (f'objects: [{GOOD}, condim: 2}}]', "'condim' must be 1, 3, 4 or 6, got 2"),
    (f'objects: [{GOOD}, position: [0, 0]}}]', "'position' must have at least 3 of them"),
    (f'objects: [{GOOD}, position: [0, 0, 1.0e+9]}}]', r"'position'\[2\] must be at most 10000"),
    (f'objects: [{GOOD}, rpy: [0, 0, 0], quat_xyzw: [0, 0, 0, 1]}}]',
     "give 'rpy' or 'quat_xyzw', not both"),
    (f'objects: [{GOOD}, quat_xyzw: [1, 1, 0, 0]}}]',
     r"'quat_xyzw' must be a quaternion x, y, z, w of length 1, got .* of length 1\.41421"),
    (f'objects: [{GOOD}, file: mug.xml}}]', "object 'brick': give 'shape' or 'file', not both"),
    ('objects: [{name: mug, file: 3}]', "object 'mug': 'file' must be a string, got 3"),
    ('objects: [{name: mug, file: mug.xml, mass: 1}]',
     "object 'mug': unknown key 'mass': .*available: name, position, .*, quat_xyzw, visual, file"),
    ('objects: [{name: mug, file: none.xml}]', "object 'mug': no such MJCF file: .*none.xml"),
    ('objects: [{name: 3cpo, shape: sphere, size: 1}]', "'3cpo' cannot be the name of an object"),
    ('objects: [{name: a-b, shape: sphere, size: 1}]', "'a-b' cannot be the name of an object"),
    ('objects: [{name: world, shape: sphere, size: 1}]', "'world' cannot be the name"),
    (f'objects: [{GOOD}}}, {GOOD}}}]', "two objects have the name 'brick'"),
    ('objects: {brick: 1}', "'objects' must be a list, got {'brick': 1}"),
    ('objects: [brick]', "object 1 must be keys and values, got 'brick'"),
    ('objekts: []', "unknown key 'objekts': the only one here is 'objects'"),
    ('[1, 2]', 'must hold keys and values'),
    ('objects: [', 'is invalid or unsafe YAML'),
    ('objects: !!python/object/apply:os.system [ls]', 'tags are not read, found one in line 1'),
    ('objects: []\nobjects: []', "'objects' appears twice, again in line 2"),
    ('a: &a [1]\nobjects: *a', "anchors and aliases are not read, found 'a' in line 1"),
    ('objects: ' + 3000 * '[', 'is invalid or unsafe YAML'),
    ('objects: ' + 3000 * '[' + 3000 * ']', 'it is nested too deeply'),
    ('1: 2', 'a key must be a string, got 1 in line 1'),
    ('objects: []' + 1_000_000 * ' ', r'parameters\.yaml is larger than 1000000 bytes')])
def test_a_bad_list_is_rejected_in_one_line_with_file_object_and_key(written, text, message):
    path = written(text)
    with pytest.raises(ModelError, match=message) as error:
        load_objects(path)
    assert str(error.value).count(str(path)) >= 1
    assert '\n' not in str(error.value)
    assert len(str(error.value)) < 700
    assert 'nput' not in str(error.value)  # Not pydantic's words.


def test_a_written_that_cannot_be_read_is_told(tmp_path):
    with pytest.raises(ModelError, match=r'^no such YAML file: .*none\.yaml$'):
        load_objects(tmp_path / 'none.yaml')
    with pytest.raises(ModelError, match=r' cannot be read: it is a folder$'):
        load_objects(tmp_path)


def test_a_bad_mapping_is_told_without_a_file():
    with pytest.raises(ModelError, match="^object 'brick': unknown key 'colour'"):
        create_object({**BOX, 'colour': 'red'})
    with pytest.raises(ModelError, match="^object without a name: needs 'name'$"):
        create_object({'shape': 'box', 'size': [1, 1, 1]})


# ---------------------------------------------------------------------- in a world


def test_objects_never_move_the_addresses_of_a_robot(panda):
    alone = World([panda], TableArena(cube=False)).compile()
    full = World([panda], TableArena(cube=True), objects=[BOX]).compile()
    assert (alone.nq, full.nq) == (9, 23)
    for kind in ('body', 'joint', 'actuator', 'sensor', 'site', 'geom'):
        count = {'body': alone.nbody, 'joint': alone.njnt, 'actuator': alone.nu,
                 'sensor': alone.nsensor, 'site': alone.nsite, 'geom': alone.ngeom}[kind]
        names = [[getattr(m, kind)(i).name for i in range(count)] for m in (alone, full)]
        assert names[0] == names[1], kind
    np.testing.assert_array_equal(full.jnt_qposadr[:alone.njnt], alone.jnt_qposadr)
    np.testing.assert_array_equal(full.jnt_dofadr[:alone.njnt], alone.jnt_dofadr)


def test_objects_of_the_arena_come_before_those_of_the_world(panda):
    world = World([panda], TableArena(cube=True), objects=[BOX])
    assert [item.name for item in world.objects] == ['cube', 'brick']
    assert world.compose(objects=False).body('cube') is None


def test_the_names_of_a_world_are_collected_once_for_all_its_objects(monkeypatch):
    collected = []
    collect = spec_edits.TakenNames.__init__

    def count(taken, spec):
        collected.append(spec)
        collect(taken, spec)
    world = compose('Panda', objects=[{**BOX, 'name': f'brick{k}', 'position': [2.0 + k, 0.0, 1.0]}
                                      for k in range(20)])
    monkeypatch.setattr(spec_edits.TakenNames, '__init__', count)
    world.compose(objects=False)
    without = len(collected)
    world.compose()
    assert len(collected) == 2 * without + 1


def test_an_object_falls_by_its_own_weight(panda):
    model = World([panda], objects=[{**BOX, 'position': [2, 2, 5]}]).compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    assert data.body('brick').xipos[2] == pytest.approx(5.0 - 9.81 * 0.2**2 / 2.0, abs=0.01)


@pytest.mark.parametrize(('name', 'taken'), [
    ('cube', "two objects have the name 'cube' .*: give one of them another name"),
    ('table', "body 'table' already exists"),
    ('floor', "geom 'floor' already exists")])
def test_a_name_that_the_world_has_already_is_rejected(panda, name, taken):
    with pytest.raises(ModelError, match=taken):
        World([panda], TableArena(cube=True), objects=[{**BOX, 'name': name}]).compile()


def test_elements_whose_names_meet_are_rejected(mug_file):
    lid = {**BOX, 'name': 'mug_lid'}
    for objects in ([mug_file(), lid], [lid, mug_file()]):
        with pytest.raises(ModelError, match="^body 'mug_lid' already exists, .* (needs another "
                                             'name|cannot bring another)'):
            World([], objects=objects).compile()


def test_one_object_can_be_in_two_worlds():
    item = create_object(BOX)
    models = [World([], objects=[item]).compile() for _ in range(2)]
    assert [model.body('brick').mass[0] for model in models] == pytest.approx([2.0, 2.0])


def test_a_world_with_objects_in_xml_is_the_same_model(panda):
    world = World([panda], TableArena(cube=True), objects=[BOX])
    from_xml, ours = mujoco.MjModel.from_xml_string(world.to_xml()), world.compile()
    assert from_xml.names.split(b'\0', 1)[1] == ours.names.split(b'\0', 1)[1]
    np.testing.assert_allclose(from_xml.body_mass, ours.body_mass, rtol=1e-5)


@pytest.mark.parametrize(('length', 'accepted'), [(0.996, True), (1.004, True), (0.99, False),
                                                  (1.01, False)])
def test_a_quaternion_may_be_off_its_length_by_half_a_percent(length, accepted):
    values = {'name': 'ball', 'shape': 'sphere', 'size': 0.1, 'quat_xyzw': [0.0, 0.0, 0.0, length]}
    if accepted:
        create_object(values)
    else:
        with pytest.raises(ModelError, match="'quat_xyzw' must be a quaternion x, y, z, w of"):
            create_object(values)
