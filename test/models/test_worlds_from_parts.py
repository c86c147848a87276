# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Worlds from parts: meshes, what is only seen, fixtures, areas of placement, robosuite."""

import math
from pathlib import Path
import re
import sys

from hypothesis import given, settings
from hypothesis import strategies as st
import mujoco
import numpy as np
import pytest
import scipy

from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.models import compose, create_object, load_arena, randomization
from manip_sim.models.arenas import TableArena
from manip_sim.models.randomization import draw_places, Extent, Placement, read_placements
from manip_sim.models.user_files import AllowedRoots
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

KITCHEN = Path(__file__).resolve().parents[1] / 'data/files/kitchen'
RING = {'name': 'ring', 'shape': 'mesh', 'file': str(KITCHEN / 'ring.obj'), 'scale': 0.001}
#: Of a prism between two regular polygons of twelve corners [m^2].
AREA = 6 * math.sin(math.pi / 6) * (0.05**2 - 0.03**2)


@pytest.fixture(scope='module')
def kitchen():
    """Return a simulation of a Panda in the kitchen."""
    return Simulation(compose('Panda', arena=load_arena(KITCHEN / 'kitchen.yaml'), seed=3))


def write(path, text):
    path.write_text(text)
    return path


# ---------------------------------------------------------------------- meshes


def test_a_mesh_has_the_frame_of_its_file_and_mass_and_touch_of_its_hull():
    item = create_object({**RING, 'density': 500.0, 'friction': 0.4})
    hull = 6 * math.sin(math.pi / 6) * 0.05**2 * 0.04
    assert item.mass_kg == pytest.approx(500.0 * hull, rel=1e-4)
    assert item.inferred == [f'touched at its convex hull, {item.mass_kg:.4g} kg']
    model = item.compile()
    np.testing.assert_allclose(model.body('ring').ipos, [0, 0, 0.02], atol=1e-8)
    assert model.geom('ring').friction[0] == 0.4
    simulation = Simulation(World([], objects=[item, {
        'name': 'ball', 'shape': 'sphere', 'size': 0.01, 'position': [0.01, 0.004, 0.06]}]))
    simulation.advance(250)
    # It lies on the lid of the hull.
    ring, ball = (simulation.data.body(name).xpos[2] for name in ('ring', 'ball'))
    assert ball - ring == pytest.approx(0.05, abs=2e-3)


@pytest.mark.full
def test_parts_keep_the_hole_of_a_ring_and_its_mass():
    pytest.importorskip('coacd', reason='needs coacd')
    item = create_object({**RING, 'collision': 'parts'})
    assert item.mass_kg == pytest.approx(1000.0 * AREA * 0.04, rel=0.02)
    assert re.fullmatch(r'touched at \d+ convex parts, found by coacd', item.inferred[0])
    heavy = create_object({**RING, 'collision': 'parts', 'mass': 0.7, 'condim': 4})
    assert heavy.mass_kg == pytest.approx(0.7, rel=1e-9)
    model = heavy.compile()
    seen = model.geom('ring_shape')
    assert seen.contype[0] == seen.conaffinity[0] == 0
    assert set(model.geom_condim) == {4}
    simulation = Simulation(World([], objects=[
        {**RING, 'collision': 'parts', 'position': [0, 0, 0.001]},
        {'name': 'ball', 'shape': 'sphere', 'size': 0.01, 'position': [0, 0, 0.06]}]))
    simulation.advance(250)
    assert simulation.data.body('ball').xpos[2] == pytest.approx(0.01, abs=1e-3)  # On the floor.


def test_without_coacd_a_mesh_is_touched_at_its_hull_and_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, 'coacd', None)
    item = create_object({**RING, 'collision': 'parts'})
    assert item.inferred == ['touched at its convex hull, as coacd, which finds convex parts, is '
                             'not installed']
    assert item.compile().ngeom == 1


def test_a_texture_lies_on_the_mesh_as_the_file_says_and_survives_the_archive():
    item = create_object({**RING, 'texture': str(KITCHEN / 'red.png')})
    world = World([], objects=[item])
    model = world.compile()
    material = int(model.geom('ring').matid[0])
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    assert model.tex_height[texture] == model.tex_width[texture] == 4
    assert model.mesh_texcoordnum[0] > 0
    np.testing.assert_array_equal(model.geom('ring').rgba, 1.0)
    again = mujoco.MjModel.from_xml_string(world.to_xml())
    np.testing.assert_allclose(again.body('ring').mass, item.mass_kg, rtol=1e-5)


@pytest.mark.parametrize(('change', 'message'), [
    ({'file': 'ring.dae'}, r"the mesh '.*ring.dae' must be .obj or .stl"),
    ({'file': 'none.obj'}, 'no such mesh file: .*none.obj'),
    ({'texture': 'red.gif'}, r"the texture '.*red.gif' must be .png"),
    ({'scale': 0}, r"'scale'\[0\] must be at least 1e-06, got 0"),
    ({'scale': [1, 1]}, r"'scale' must be a number or \[x, y, z\], got \[1.0, 1.0\]"),
    ({'size': 1}, "unknown key 'size'"),
    ({'collision': 'exact'}, "'collision' must be 'hull' or 'parts', got 'exact'"),
    ({'mass': 1, 'density': 1}, "give 'mass' or 'density', not both")])
def test_a_mesh_that_cannot_be_used_is_rejected_in_one_line(change, message):
    with pytest.raises(ModelError, match=f"^object 'ring': {message}") as error:
        create_object({**RING, **change})
    assert '\n' not in str(error.value)


@pytest.mark.full
def test_a_request_gets_meshes_below_its_folders_only(tmp_path):
    (tmp_path / 'in').mkdir()
    for name in ('ring.obj', 'red.png'):
        (tmp_path / 'in' / name).write_bytes((KITCHEN / name).read_bytes())
    files = AllowedRoots([tmp_path / 'in'], 'spawn_roots')
    inside = {**RING, 'file': str(tmp_path / 'in' / 'ring.obj'),
              'texture': str(tmp_path / 'in' / 'red.png')}
    item = create_object(inside, files)
    (tmp_path / 'in' / 'ring.obj').unlink()  # Nothing is opened later.
    assert item.mass_kg == pytest.approx(create_object(RING).mass_kg)
    assert World([], objects=[item]).compile().nmesh == 1
    for outside in (RING, {**inside, 'file': 'robosuite:milk', 'shape': None}):
        given = {key: value for key, value in outside.items() if value is not None}
        with pytest.raises(ModelError):
            create_object(given, files)
    (tmp_path / 'in' / 'ring.obj').write_bytes((KITCHEN / 'ring.obj').read_bytes())
    with pytest.raises(ModelError, match="'collision: parts' takes long, and is not for requests"):
        create_object({**inside, 'collision': 'parts'}, files)


# ---------------------------------------------------------------------- only seen


def test_what_is_only_seen_stays_where_it_is_and_touches_nothing(kitchen):
    kitchen.reset(seed=3)
    kitchen.surroundings.set_target('goal', kitchen.data.body('can').xpos, [0, 0, 0, 1])
    kitchen.advance(300)
    np.testing.assert_array_equal(kitchen.surroundings.pose('goal')[:3],
                                  kitchen.data.mocap_pos[0])
    bodies = kitchen.model.geom_bodyid[kitchen.data.contact.geom]
    assert len(bodies) and kitchen.model.body('goal').id not in bodies
    poster = load_arena(KITCHEN / 'kitchen.yaml').spec.geom('poster')
    assert poster.contype == poster.conaffinity == 0


def test_a_joint_of_what_is_only_seen_is_rejected(tmp_path):
    file = write(tmp_path / 'ball.xml', '<mujoco><worldbody><body name="ball">'
                 '<freejoint name="j"/><geom size="0.1"/></body></worldbody></mujoco>')
    with pytest.raises(ModelError, match="an object that is only seen has no joint, found 'j'"):
        create_object({'file': str(file), 'visual': True})


# ---------------------------------------------------------------------- fixtures


def test_joints_actuators_and_cameras_of_a_fixture_belong_to_the_arena(kitchen):
    kitchen.reset(seed=3)
    assert kitchen.surroundings.joints == ('cupboard_hinge',)
    np.testing.assert_allclose(kitchen.model.body('cupboard').pos, [0.2, 0, 1.05])
    assert kitchen.model.body('cupboard').weldid[0] == 0
    assert kitchen.model.camera('cupboard_inside').bodyid[0] == kitchen.model.body('cupboard').id
    arena = kitchen.surroundings.commands['arena']
    arena.command(arena.checked(['cupboard_hinge'], [1.2], [], []))
    kitchen.advance(1500)
    assert kitchen.data.joint('cupboard_hinge').qpos[0] == pytest.approx(1.2, abs=1e-3)


def test_an_arena_of_parts_stands_on_another_with_its_parameters(kitchen):
    model, arena = kitchen.model, load_arena(KITCHEN / 'kitchen.yaml')
    robot = compose('Panda').robots[0]
    assert model.geom('table_collision').size[0] == 0.5
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, 'cube') < 0
    table = TableArena(1.0, cube=False)
    np.testing.assert_array_equal(arena.robot_position(robot),
                                  table.robot_position(robot))


def test_parts_alone_stand_on_an_empty_floor_and_beside_a_model(tmp_path):
    parts = 'fixtures: [{name: post, shape: cylinder, size: [0.1, 1], position: [1, 0, 0.5]}]\n'
    alone = load_arena(write(tmp_path / 'alone.yaml', parts))
    assert alone.arena_name == 'alone' and alone.spec.body('post') is not None
    write(tmp_path / 'hall.xml', '<mujoco><worldbody><geom name="ground" type="plane" '
          'size="1 1 1"/></worldbody></mujoco>')
    beside = load_arena(write(tmp_path / 'hall.yaml', f'{parts}robot_position: [0, 1, 0]\n'))
    assert beside.spec.geom('ground') is not None and beside.spec.body('post') is not None
    assert World([], beside).compile().body('post').pos[0] == 1.0


@pytest.mark.parametrize(('text', 'kind', 'message'), [
    ('fixtures: [{name: a, shape: box, size: [1, 1, 1], colour: red}]', ModelError,
     "fixture 'a': unknown key 'colour'"),
    ('fixtures: [{shape: box, size: [1, 1, 1]}]', ModelError, 'fixture without a name: needs '),
    ('fixtures: [{name: floor, shape: box, size: [1, 1, 1]}]', ModelError,
     "geom 'floor' .*exists"),
    ('fixtures: [{name: a, file: loose.xml}]', ModelError,
     "the root body of a fixture is welded to the world, found joint 'j'"),
    ('fixtures: 3', ModelError, "'fixtures' of .*: input should be a valid list, got '3'"),
    ('objects: [none.yaml]', ModelError, 'no such YAML file: .*none.yaml'),
    ('objects: [{name: a, shape: sphere, size: 1}, {name: a, shape: sphere, size: 1}]', ModelError,
     "two objects have the name 'a'"),
    ('arena: tabel', UnknownNameError, "unknown arena 'tabel': did you mean 'table'"),
    ('{arena: table, parameters: {cub: true}}', UnknownNameError, "'cub': did you mean 'cube'"),
    ('{model: loose.xml, arena: table}', ModelError, "give 'model', or 'arena' with its 'param"),
    ('{arena: table, xacro_args: {a: 1}}', ModelError,
     "'xacro_args' is for robots, grippers and bases in xacro; an arena is MJCF"),
    ('{arena: table, meshes: none}', ModelError,
     "'meshes' is for robots, grippers and bases in URDF; an arena is MJCF"),
    ('placements: {a: {objects: [b], x: [0, 1], y: [0, 1], z: 0}}', UnknownNameError,
     "unknown object of placement 'a' 'b'"),
    ('{arena: table, objects: [{name: a, shape: sphere, size: 1, visual: true}], '
     'placements: {p: {objects: [a], x: [0, 1], y: [0, 1], z: 0}}}', ModelError,
     "placement 'p': 'a' is only seen")])
def test_parts_that_do_not_fit_are_rejected_in_one_line(tmp_path, text, kind, message):
    write(tmp_path / 'loose.xml', '<mujoco><worldbody><body><joint name="j"/><geom size="1"/>'
          '</body></worldbody></mujoco>')
    file = write(tmp_path / 'parts.yaml', text)
    with pytest.raises(kind, match=message) as error:
        load_arena(file)
    assert '\n' not in str(error.value)


# ---------------------------------------------------------------------- placement


def places(simulation):
    return {name: simulation.data.body(name).xpos.copy() for name in ('ring', 'can')}


def test_objects_are_placed_from_the_seed_where_they_stand_without_overlap(kitchen):
    seen = []
    for seed in range(20):
        kitchen.reset(seed=seed)
        now = places(kitchen)
        assert now['can'][2] == pytest.approx(0.85) and now['ring'][2] == pytest.approx(0.8)
        assert np.linalg.norm(now['can'][:2] - now['ring'][:2]) >= 0.03 + 0.05 + 0.02
        assert -0.3 <= now['can'][0] <= 0 and abs(now['can'][1]) <= 0.2
        seen.append(now['can'][:2].tolist())
    assert len({tuple(point) for point in seen}) == 20
    kitchen.reset(seed=7)
    digest, drawn = kitchen.digest(), dict(kitchen.randomized.drawn)
    kitchen.advance(50)
    kitchen.reset(seed=7)
    assert kitchen.digest() == digest
    other = Simulation(compose('Panda', arena=load_arena(KITCHEN / 'kitchen.yaml')))
    other.reset(seed=7)
    assert other.digest() == digest
    other.reset(seed=1)
    other.reset(seed=7, drawn=drawn)
    assert other.digest() == digest


def test_a_reset_with_a_seed_that_leaves_no_room_changes_nothing(kitchen, monkeypatch):
    kitchen.reset(seed=7)
    kitchen.advance(50)
    digest, drawn = kitchen.digest(), dict(kitchen.randomized.drawn)
    here = kitchen.data.qpos.copy()
    monkeypatch.setattr(randomization, '_TRIES', 0)
    with pytest.raises(ModelError, match='no room for'):
        kitchen.reset(seed=8)
    assert (kitchen.seed, kitchen.randomized.drawn, kitchen.digest()) == (7, drawn, digest)
    assert np.array_equal(kitchen.data.qpos, here)


def test_each_of_many_worlds_has_places_of_its_own(kitchen):
    worlds = Worlds(compose('Panda', arena=load_arena(KITCHEN / 'kitchen.yaml')), 2)
    worlds.reset([7, 8])
    expected = []
    for seed in (7, 8):
        kitchen.reset(seed=seed)
        expected.append(kitchen.digest())
    assert worlds.digest() == expected


def test_placements_may_also_be_in_the_file_of_the_randomization():
    simulation = Simulation(compose('Panda', arena='table', randomization={
        'placements': {'top': {'objects': ['cube'], 'x': [0.1, 0.2], 'y': [0, 0], 'z': 0.9}},
        'bodies': {'cube': {'mass': {'scale': {'uniform': [2, 2]}}}}}))
    simulation.reset(seed=5)
    x, y, z = simulation.data.body('cube').xpos
    assert 0.1 <= x <= 0.2 and y == 0 and z == pytest.approx(0.925)
    assert simulation.model.body('cube').mass[0] == pytest.approx(0.2)
    with pytest.raises(UnknownNameError, match="'cub': did you mean 'cube'"):
        compose('Panda', arena='table', randomization={
            'placements': {'top': {'objects': ['cub'], 'x': [0, 1], 'y': [0, 1], 'z': 0}}})


def test_an_object_that_was_deleted_is_no_longer_placed(kitchen):
    from manip_sim.physics.object_spawning import plan_without
    simulation = Simulation(compose('Panda', arena=load_arena(KITCHEN / 'kitchen.yaml')))
    simulation.change_objects(plan_without(simulation.physics.plan, 'can'))
    simulation.reset(seed=3)
    assert 'bodies/ring/position' in simulation.randomized.drawn
    assert 'bodies/can/position' not in simulation.randomized.drawn


def area(**changes):
    values = {'objects': ['a'], 'x': [0, 1], 'y': [0, 1], 'z': 0, **changes}
    return read_placements({'p': {key: value for key, value in values.items()
                                  if value is not None}}, 'here')


@pytest.mark.parametrize(('changes', 'message'), [
    ({'objects': []}, "'objects' must be a list of names, each once"),
    ({'objects': ['a', 'a']}, "'objects' must be a list of names, each once"),
    ({'x': [1, 0]}, r"'x' must be \[low, high\] in m, got \[1, 0\]"),
    ({'y': [0, float('nan')]}, "'y' needs numbers from -10000 to 10000, got nan"),
    ({'x': [0, 10**400]}, "'x' needs numbers from -10000 to 10000, got 1000"),
    ({'z': 1e300}, r"'z' needs numbers from -10000 to 10000, got 1e\+300"),
    ({'z': None}, "needs 'z', the height of the surface"),
    ({'margin': -1}, "'margin' needs numbers from 0 to 10000, got -1"),
    ({'yav': 1}, "unknown key 'yav': did you mean 'yaw'")])
def test_areas_that_make_no_sense_are_rejected(changes, message):
    with pytest.raises(ModelError, match=f"^here: placement 'p'.*{message}"):
        area(**changes)


def test_an_area_that_is_too_small_is_told():
    (small,) = area(objects=['a', 'b'], x=[0, 0.1])
    sizes = dict.fromkeys(('a', 'b'), Extent(1.0, 0.0, np.array([1.0, 0, 0, 0])))
    with pytest.raises(ModelError, match="placement 'p': no room for a, b without overlap"):
        draw_places([small], sizes, 0)


@pytest.mark.full
@pytest.mark.parametrize('most', [0.5, 2.0, math.pi])
def test_turns_are_evenly_distributed_up_to_the_greatest(most):
    (one,) = area(yaw=most)
    sizes = {'a': Extent(0.1, 0.0, np.array([1.0, 0, 0, 0]))}
    turns = [2 * math.atan2(quat[3], quat[0]) for _, quat in (
        draw_places([one], sizes, seed)['a'] for seed in range(400))]
    assert scipy.stats.kstest(turns, scipy.stats.uniform(-most, 2 * most).cdf).pvalue > 1e-3


@pytest.mark.full
@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(0.01, 0.2), min_size=1, max_size=6), st.integers(0, 2**32),
       st.floats(0, 0.05))
def test_no_two_cylinders_overlap(radii, seed, margin):
    names = [f'o{number}' for number in range(len(radii))]
    where = Placement('p', tuple(names), (-2.0, -2.0), (2.0, 2.0), 0.3, margin=margin)
    sizes = {name: Extent(radius, -radius, np.array([0.0, 1, 0, 0]))
             for name, radius in zip(names, radii)}
    found = draw_places([where], sizes, seed)
    for first, one in zip(names, radii):
        assert found[first][0][2] == 0.3 + one
        assert np.linalg.norm(found[first][1]) == pytest.approx(1.0)
        for second, two in zip(names, radii):
            if first != second:
                apart = found[first][0][:2] - found[second][0][:2]
                assert np.linalg.norm(apart) >= one + two + margin - 1e-12


@pytest.mark.full
@settings(deadline=None, max_examples=150)
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=4) | st.integers(),
                    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
                        st.sampled_from(['objects', 'x', 'y', 'z', 'yaw', 'margin', 'top']), inner,
                        max_size=5), max_leaves=12))
def test_any_value_is_areas_or_an_error(values):
    try:
        found = read_placements(values, 'here')
    except ManipSimError as error:
        assert '\n' not in str(error)
    else:
        assert read_placements({one.name: one.values for one in found}, 'here') == found


# ---------------------------------------------------------------------- robosuite


def test_objects_and_arenas_of_robosuite_are_found_by_name(tmp_path, monkeypatch):
    assets = tmp_path / 'robosuite/models/assets'
    for kind in ('objects', 'arenas'):
        (assets / kind).mkdir(parents=True)
    write(tmp_path / 'robosuite/__init__.py', 'raise ImportError("nothing is imported")')
    write(assets / 'objects/pop-can.xml', '<mujoco model="can"><worldbody><body>'
          '<body name="object"><geom size="0.03" density="100"/></body></body></worldbody>'
          '</mujoco>')
    write(assets / 'arenas/bins_arena.xml', '<mujoco><worldbody><geom name="floor" type="plane" '
          'size="1 1 1"/></worldbody></mujoco>')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'robosuite', raising=False)
    item = create_object({'file': 'robosuite:PopCan'})
    assert (item.name, item.mass_kg) == ('can', pytest.approx(100 * 4 / 3 * math.pi * 0.03**3))
    file = write(tmp_path / 'lab.yaml', 'arena: robosuite:bins_arena\n'
                 'objects: [{name: cup, file: "robosuite:pop_can", position: [0, 0, 1]}]\n'
                 'fixtures: [{name: stand, file: "robosuite:pop_can"}]\n')
    model = World([], load_arena(file)).compile()
    assert model.body('cup').pos[2] == 1.0 and model.body('stand').weldid[0] == 0
    with pytest.raises(UnknownNameError, match="unknown object of robosuite 'pop_cam'"):
        create_object({'file': 'robosuite:pop_cam'})


def test_parts_of_robosuite_need_robosuite(monkeypatch):
    monkeypatch.setattr('manip_sim.models.registry.importlib.util.find_spec', lambda name: None)
    with pytest.raises(ModelError, match='robosuite:milk needs the package robosuite or '):
        create_object({'file': 'robosuite:milk'})
