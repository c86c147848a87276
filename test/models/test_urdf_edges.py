# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""URDF of robots that are not as simple as those of the catalogue."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from urdf_rig import data_at, frames, mass_matrix, random_position, read_by_mujoco, scalar_joints

from manip_sim.algebra import rpy_of
from manip_sim.models import compose, World
from manip_sim.models.urdf_writer import Hardware, OWN_PLUGIN, urdf_of
from manip_sim.models.urdf_writer.links import binary_stl, stl_of, text_of, unit_sphere
from manip_sim.resources import share_directory

LIMB = '<inertial mass="1.3" pos=".1 .02 .03" fullinertia=".02 .03 .025 .004 -.003 .002"/>'
ODD = f"""
<body name="base" pos=".1 .2 .3" quat=".9 .1 .2 .3">{LIMB}
  <body name="many" pos=".1 0 .2" quat=".7 .1 .7 .1">{LIMB}
    <joint name="a" axis="1 0 0" pos=".01 .02 .03" ref=".3" range="-1 1"/>
    <joint name="b" type="slide" axis="0 1 1" ref=".1" range="-.2 .3"/>
    <joint name="c" axis="0 0 1" pos="0 0 .1"/>
    <body name="upright" euler=".3 1.5707963267948966 .4">{LIMB}
      <joint name="d" axis=".3 .4 .5" ref="-.7" range="-2 2"/>
      <body name="e" pos="0 0 .1">{LIMB}<joint name="e" axis="0 1 0" ref=".2"/>
        <body name="f" pos="0 0 .1">{LIMB}<joint name="f" type="slide" ref=".05"/></body>
      </body>
    </body>
  </body>
</body>"""


@pytest.fixture
def written(robot_class, mjcf):
    """Return a function that writes the URDF of a robot of a few lines."""
    def write(worldbody, sections='', **options):
        world = World([robot_class(mjcf(worldbody, sections))])
        return world.compile(), urdf_of(world, **options)
    return write


def joint_of(urdf, name):
    return ElementTree.fromstring(urdf.xml).find(f'joint[@name="robot0_{name}"]')


def limit_of(urdf, name):
    return {key: float(value) for key, value in joint_of(urdf, name).find('limit').items()}


def mimics_of(urdf):
    return {joint.get('name').removeprefix('robot0_'): (
        joint.find('mimic').get('joint').removeprefix('robot0_'),
        float(joint.find('mimic').get('multiplier')), float(joint.find('mimic').get('offset')))
        for joint in ElementTree.fromstring(urdf.xml).iter('joint')
        if joint.find('mimic') is not None}


def test_joints_off_the_origin_with_references_and_several_in_a_body_move_the_same(written):
    model, urdf = written(ODD)
    read, random = read_by_mujoco(urdf.xml), np.random.default_rng(0)
    for _ in range(20):
        position = random_position(model, scalar_joints(model, urdf.tree), random)
        ours, theirs = data_at(model, position), data_at(read, position)
        for link, place, rotation in frames(model, ours, urdf.tree):
            np.testing.assert_allclose(theirs.body(link).xpos, place, rtol=0, atol=1e-14)
            np.testing.assert_allclose(theirs.body(link).xmat.reshape(3, 3), rotation, rtol=0,
                                       atol=1e-14)
        expected = mass_matrix(model, ours, position)
        # MuJoCo gives the links without mass a little, and diagonalises each inertia.
        np.testing.assert_allclose(mass_matrix(read, theirs, position), expected, atol=1e-10)
    links = [link.name for link in urdf.tree.links if link.body is None]
    assert links == ['world', 'robot0_a_link', 'robot0_b_link', 'robot0_c_link']


@pytest.mark.parametrize('pitch', [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 0.3, np.pi / 2 - 1e-6])
def test_roll_pitch_and_yaw_are_exact_also_where_the_pitch_is_a_right_angle(pitch):
    random = np.random.default_rng(0)
    for roll, yaw in random.uniform(-3.0, 3.0, (200, 2)):
        wanted = about('z', yaw) @ about('y', pitch) @ about('x', roll)
        r, p, y = rpy_of(wanted)
        np.testing.assert_allclose(about('z', y) @ about('y', p) @ about('x', r), wanted, rtol=0,
                                   atol=3e-16 * 4)


@pytest.mark.parametrize(('number', 'text'), [
    (0.1, '0.1'), (-3.0, '-3'), (1e-16, '1e-16'), (-0.9e-16, '0'), (1e15 - 1, '999999999999999'),
    (1e15, '1000000000000000.0'), ([1.0, 0.5], '1 0.5')])
def test_numbers_are_written_as_short_as_they_can_be_read_again(number, text):
    assert text_of(number) == text


def about(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    return {'x': np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
            'y': np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
            'z': np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])}[axis]


def test_a_free_robot_and_ball_joints_are_left_to_tf(written):
    model, urdf = written("""
        <body name="base" pos="0 0 1"><freejoint name="free"/><geom size=".1"/>
          <body name="ball" pos="0 0 .3"><joint name="ball" type="ball"/><geom size=".1"/>
            <body name="arm"><joint name="swing" axis="0 1 0"/><geom size=".1"/></body>
        </body></body>""")
    first, ball = joint_of(urdf, 'free'), joint_of(urdf, 'ball')
    assert (first.get('type'), first.find('parent').get('link')) == ('floating', 'world')
    assert first.find('origin').get('xyz') == '0 0 1'
    # robot_state_publisher publishes nothing for a floating joint.
    assert ball.get('type') == 'floating' and ball.find('limit') is None
    assert joint_of(urdf, 'swing').get('type') == 'continuous'
    assert len(scalar_joints(model, urdf.tree)) == 1


def test_a_slide_follows_the_ball_joint_of_the_same_body(written):
    _, urdf = written("""
        <body name="base"><geom size=".1"/><body name="hand" pos="0 0 .3"><geom size=".1"/>
          <joint name="ball" type="ball"/><joint name="slide" type="slide" axis="1 0 0" ref=".5"/>
        </body></body>""")
    places = {name: [joint_of(urdf, name).find(part).get(key) for part, key in (
        ('parent', 'link'), ('child', 'link'), ('origin', 'xyz'))] for name in ('ball', 'slide')}
    assert places == {'ball': ['robot0_base', 'robot0_ball_link', '0 0 0.3'],
                      'slide': ['robot0_ball_link', 'robot0_hand', '-0.5 0 0']}


CHAIN = ''.join(f'<body name="{n}"><joint name="{n}" type="slide" ref="{r}" user="0.5"/>'
                '<geom size=".1"/>' for n, r in (('p', 0.1), ('q', 0.2), ('r', 0))) + '</body>' * 3
CHAIN = f'<body name="base">{CHAIN}</body>'


@pytest.mark.parametrize(('equalities', 'actuators', 'expected'), [
    # q - 0.2 = 0.3 + 2 (p - 0.1)
    (['q p 0.3 2'], '', {'q': ('p', 2.0, 0.3)}),
    # r = 0.5 (q - 0.2), so it follows p by half of that.
    (['r q 0 0.5', 'q p 0.3 2'], '', {'q': ('p', 2.0, 0.3), 'r': ('p', 1.0, 0.05)}),
    # Only q has an actuator: p = (q - 0.3) / 2
    (['q p 0.3 2'], 'q', {'p': ('q', 0.5, -0.15)}),
    (['q p 0.3 2'], 'pq', {'q': ('p', 2.0, 0.3)}),
    # The joint with the first actuator leads.
    (['q p 0.3 2'], 'qp', {'p': ('q', 0.5, -0.15)}),
    (['r q 0 0.5', 'q p 0.3 2'], 'rp', {'q': ('r', 2.0, 0.2), 'p': ('r', 1.0, -0.05)}),
    # The same one twice, and a circle that contradicts itself.
    (['q p 0.3 2', 'p q -0.15 0.5'], '', {'q': ('p', 2.0, 0.3)}),
    (['q p 0.3 2', 'r q 0 1', 'p r 0 1'], '', {'q': ('p', 2.0, 0.3), 'r': ('p', 1.0, -0.1)})])
def test_linear_couplings_become_mimics_of_one_leader(equalities, actuators, expected, written):
    words = [equality.split() for equality in equalities]
    ties = ''.join(f'<joint joint1="{a}" joint2="{b}" polycoef="{c} {k} 0 0 0"/>'
                   for a, b, c, k in words)
    motors = ''.join(f'<position joint="{name}" kp="9"/>' for name in actuators)
    model, urdf = written(CHAIN, f'<equality>{ties}</equality><actuator>{motors}</actuator>')
    found = mimics_of(urdf)
    assert found.keys() == expected.keys()
    for name, (leader, multiplier, offset) in expected.items():
        assert found[name][0] == leader
        assert found[name][1:] == pytest.approx((multiplier, offset))
    # MuJoCo agrees: where the followers are where they belong, no equality is violated.
    position = random_position(model, scalar_joints(model, urdf.tree), np.random.default_rng(0),
                               urdf.mimics)
    data = data_at(model, position)
    mujoco.mj_forward(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert len(data.efc_pos[rows]) == len(words)
    told = sum('follows two joints' in note for note in urdf.notes)
    assert told == len(words) - len(expected)
    if told == 0:
        np.testing.assert_allclose(data.efc_pos[rows], 0.0, atol=1e-12)


def test_couplings_that_are_off_or_curved_or_fixed_are_no_mimics(written):
    _, urdf = written(CHAIN, """<equality>
        <joint joint1="q" joint2="p" active="false"/><joint joint1="r"/>
        <joint joint1="p" joint2="q" polycoef="0 1 0.5 0 0"/></equality>""")
    assert mimics_of(urdf) == {}
    assert [note for note in urdf.notes if 'curve' in note]


def test_closed_loops_stay_a_tree_and_are_told(written):
    _, urdf = written(ODD, '<equality><connect body1="f" body2="base" anchor="0 0 0"/></equality>')
    assert '1 constraints between bodies close loops: a URDF is a tree' in urdf.notes


def test_efforts_are_those_of_the_actuators_through_their_gears(written):
    _, urdf = written(CHAIN, """
        <tendon><fixed name="both"><joint joint="q" coef="0.5"/><joint joint="r" coef="2"/></fixed>
        </tendon>
        <actuator><motor joint="p" gear="3" ctrlrange="-2 2" ctrllimited="true"/>
        <position tendon="both" kp="5" forcerange="-10 10" forcelimited="true"/></actuator>""")
    assert limit_of(urdf, 'p')['effort'] == pytest.approx(6.0)
    assert limit_of(urdf, 'q')['effort'] == pytest.approx(5.0)
    assert limit_of(urdf, 'r')['effort'] == pytest.approx(20.0)
    assert limit_of(urdf, 'r')['velocity'] == 0.5
    assert (limit_of(urdf, 'p')['lower'], limit_of(urdf, 'p')['upper']) == (-1000.0, 1000.0)


def test_a_joint_without_actuator_has_no_effort_and_one_without_limits_a_large_one(written):
    body = """<body name="base"><geom size=".1"/><body name="l"><joint name="j"/><geom size=".1"/>
        <body name="m"><joint name="k"/><geom size=".1"/></body></body></body>"""
    _, urdf = written(body, '<actuator><position joint="j" kp="100"/></actuator>'
                      '<equality><joint joint1="k" joint2="j" polycoef="0 2 0 0 0"/></equality>')
    assert limit_of(urdf, 'j') == {'effort': 1000.0, 'velocity': pytest.approx(np.pi)}
    assert limit_of(urdf, 'k') == {'effort': 0.0, 'velocity': pytest.approx(2.0 * np.pi)}


def test_sites_and_cameras_give_way_to_bodies_of_the_same_name(written):
    _, urdf = written("""
        <body name="base"><geom size=".1"/><camera name="eye"/>
          <camera name="watcher" mode="targetbody" target="eye"/>
          <body name="eye"><joint name="j"/><geom size=".1"/></body></body>""")
    names = [link.name for link in urdf.tree.links]
    assert names == ['world', 'robot0_base', 'robot0_eye', 'robot0_eye_camera',
                     'robot0_eye_camera_optical_frame']


def test_a_capsule_is_a_cylinder_and_two_spheres_at_its_ends(written):
    _, urdf = written('<body name="base"><geom type="capsule" size=".1" '
                      'fromto="1 0 .5 1 3 .5"/></body>')
    shapes = {}
    for shape in ElementTree.fromstring(urdf.xml).findall('link/collision'):
        place = [float(v) for v in shape.find('origin').get('xyz').split()]
        (solid,) = shape.find('geometry')
        shapes.setdefault(solid.tag, []).append((place, {
            key: float(value) for key, value in solid.items()}))
    assert shapes['cylinder'] == [([1.0, 1.5, 0.5], {'radius': 0.1, 'length': 3.0})]
    places = sorted(place for place, size in shapes['sphere'] if size == {'radius': 0.1})
    np.testing.assert_allclose(places, [[1.0, 0.0, 0.5], [1.0, 3.0, 0.5]], atol=1e-12)


@pytest.mark.parametrize(('geom', 'tag', 'expected'), [
    ('type="box" size=".1 .2 .3"', 'box', {'size': [0.2, 0.4, 0.6]}),
    ('type="cylinder" size=".1 .2"', 'cylinder', {'radius': [0.1], 'length': [0.4]}),
    ('type="sphere" size=".1"', 'sphere', {'radius': [0.1]}),
    ('type="ellipsoid" size=".1 .2 .3"', 'mesh', {'scale': [0.1, 0.2, 0.3]})])
def test_shapes_have_the_size_of_their_geoms(geom, tag, expected, written):
    _, urdf = written(f'<body name="base"><geom {geom}/></body>')
    (solid,) = ElementTree.fromstring(urdf.xml).findall('link/collision/geometry/*')
    assert solid.tag == tag
    assert {key: pytest.approx([float(word) for word in text.split()])
            for key, text in solid.items() if key != 'filename'} == expected


def test_what_has_no_like_in_urdf_is_told(written):
    _, urdf = written('<body name="base"><geom type="plane" size="1 1 1"/></body>')
    assert urdf.notes == ('robot0_base: a plane is left out',)


def test_a_robot_that_shows_nothing_else_shows_what_collides(written):
    _, urdf = written('<body name="base"><geom size=".1" group="3"/></body>')
    root = ElementTree.fromstring(urdf.xml)
    assert len(root.findall('link/visual')) == len(root.findall('link/collision')) == 1
    _, urdf = written("""<body name="base"><geom size=".1" group="3"/>
        <geom size=".2" contype="0" conaffinity="0"/>
        <geom size=".3" contype="0" conaffinity="0" rgba="1 1 1 0"/>
        <geom size=".4" contype="0" conaffinity="0" group="4"/></body>""")
    root = ElementTree.fromstring(urdf.xml)
    for tag, radius in (('visual', '0.2'), ('collision', '0.1')):
        (sphere,) = root.findall(f'link/{tag}/geometry/sphere')
        assert sphere.get('radius') == radius


# Meshes.

def write_wedge(file):
    """Write a wedge that has no symmetry as binary STL, and return its corners."""
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.1, 0], [0.02, 0.03, 0.2]])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    file.write_bytes(binary_stl(corners[np.array(faces)]))
    return corners


@pytest.mark.parametrize('how', [
    'scale="2 2 2"', 'scale="1 0.5 2"', 'refpos="0.1 0.2 0.3" scale="1 0.5 2"',
    'refpos="0.1 0.2 0.3" refquat="0.7 0.1 0.2 0.3" scale="2 2 2"'])
def test_a_mesh_file_stands_where_mujoco_has_it(how, written, tmp_path):
    corners = write_wedge(tmp_path / 'wedge.stl')
    model, urdf = written(
        '<body name="base"><geom type="mesh" mesh="w" pos=".1 .2 .3" euler=".4 .5 .6"/></body>',
        f'<asset><mesh name="w" file="wedge.stl" {how}/></asset>')
    shape = ElementTree.fromstring(urdf.xml).find('link/visual')
    mesh, origin = shape.find('geometry/mesh'), shape.find('origin')
    assert mesh.get('filename') == f'file://{tmp_path.resolve()}/wedge.stl'
    scale, place, (roll, pitch, yaw) = (
        np.array(text.split(), dtype=float) for text in (
            mesh.get('scale'), origin.get('xyz'), origin.get('rpy')))
    turn = about('z', yaw) @ about('y', pitch) @ about('x', roll)
    found = (corners * scale) @ turn.T + place
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = model.body('robot0_base').geomadr[0]
    body = data.body('robot0_base')
    expected = (model.mesh_vert @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
                - body.xpos) @ body.xmat.reshape(3, 3)
    # The compiler may change the order of the corners.
    nearest = np.linalg.norm(found[:, None] - expected[None], axis=2).min(axis=1)
    np.testing.assert_allclose(nearest, 0.0, atol=1e-7)


def test_meshes_that_no_file_holds_are_told(written):
    _, urdf = written(
        '<body name="base"><geom type="mesh" mesh="w"/><geom size=".1"/></body>',
        '<asset><mesh name="w" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>')
    assert urdf.notes == ('robot0_base: a mesh is left out',)


def test_a_compiled_mesh_is_written_as_it_is(written, tmp_path):
    write_wedge(tmp_path / 'wedge.stl')
    model, _ = written('<body name="base"><geom type="mesh" mesh="w"/></body>',
                       '<asset><mesh name="w" file="wedge.stl"/></asset>')
    (tmp_path / 'again.stl').write_bytes(stl_of(model, 0))
    spec = mujoco.MjSpec.from_string(
        '<mujoco><asset><mesh name="w" file="again.stl"/></asset><worldbody>'
        '<geom type="mesh" mesh="w"/></worldbody></mujoco>',
        assets={'again.stl': (tmp_path / 'again.stl').read_bytes()})
    again = spec.compile()
    np.testing.assert_allclose(again.mesh_pos[0], 0.0, atol=1e-7)
    assert again.geom_aabb[0] == pytest.approx(model.geom_aabb[-1], abs=1e-6)


def test_the_sphere_for_ellipsoids_is_round_closed_and_turned_outwards():
    triangles = unit_sphere()
    file = share_directory() / 'assets' / 'meshes' / 'unit_sphere.stl'
    assert file.read_bytes() == binary_stl(triangles)
    np.testing.assert_allclose(np.linalg.norm(triangles, axis=2), 1.0, atol=1e-12)
    assert np.linalg.norm(triangles.mean(axis=1), axis=1).min() > 0.994
    # By the divergence theorem, the volume within a closed surface that is turned outwards.
    volume = np.linalg.det(triangles).sum() / 6.0
    assert 0.985 < volume / (4.0 / 3.0 * np.pi) < 1.0
    edges = {(tuple(np.round(t[i], 9)), tuple(np.round(t[(i + 1) % 3], 9)))
             for t in triangles for i in range(3)}
    assert len(edges) == 3 * len(triangles) and edges == {(b, a) for a, b in edges}


# ros2_control.

def test_the_tag_of_ros2_control_commands_driven_joints_and_observes_all():
    hardware = Hardware({'robot0_joint1': 'position', 'robot0_joint2': 'velocity',
                         'gripper0_right_finger_joint1': 'position',
                         'gripper0_right_finger_joint2': 'position'}, '/s', '/c')
    root = ElementTree.fromstring(urdf_of(compose('Panda'), hardware=hardware).xml)
    tag = root.find('ros2_control')
    assert tag.find('hardware/plugin').text == (
        'joint_state_topic_hardware_interface/JointStateTopicSystem')
    assert {p.get('name'): p.text for p in tag.findall('hardware/param')} == {
        'joint_states_topic': '/s', 'joint_commands_topic': '/c',
        'trigger_joint_command_threshold': '-1'}
    commands = [[c.get('name') for c in joint.findall('command_interface')]
                for joint in tag.findall('joint')]
    # Joints that are only observed come after the others; a follower has no command.
    assert commands == [['position'], ['velocity'], ['position'], [], [], [], [], [], []]
    assert {joint.get('name') for joint in tag.findall('joint')} == {
        joint.get('name') for joint in root.findall('joint') if joint.find('limit') is not None}
    for joint in tag.findall('joint'):
        assert [s.get('name') for s in joint.findall('state_interface')] == [
            'position', 'velocity', 'effort']


def test_the_tag_for_the_own_plugin_has_all_modes_and_the_sensors():
    hardware = Hardware(
        {'robot0_joint1': 'position', 'gripper0_right_finger_joint1': 'position'}, '/s', '/c',
        OWN_PLUGIN, '/cell/sim', {'robot0_joint1': 'control_mode.arm'},
        {'right_wrench': '/right/wrench'}, lockstep=True, imu_topics={'imu': '/sensors/imu/imu'})
    tag = ElementTree.fromstring(urdf_of(compose('Panda'), hardware=hardware).xml).find(
        'ros2_control')
    assert tag.find('hardware/plugin').text == 'manip_sim_hardware/ManipSimSystem'
    assert {p.get('name'): p.text for p in tag.findall('hardware/param')} == {
        'joint_states_topic': '/s', 'joint_commands_topic': '/c', 'node': '/cell/sim',
        'lockstep': 'true'}
    arm, finger = tag.findall('joint')[:2]
    assert [c.get('name') for c in arm.findall('command_interface')] == [
        'position', 'velocity', 'effort']
    assert {p.get('name'): p.text for p in arm.findall('param')} == {
        'mode_parameter': 'control_mode.arm'}
    assert [c.get('name') for c in finger.findall('command_interface')] == ['position']
    assert finger.find('param') is None
    sensor, imu = tag.findall('sensor')
    assert (imu.get('name'), imu.find('param').text) == ('imu', '/sensors/imu/imu')
    assert [s.get('name') for s in imu.findall('state_interface')] == [
        'orientation.x', 'orientation.y', 'orientation.z', 'orientation.w',
        'angular_velocity.x', 'angular_velocity.y', 'angular_velocity.z',
        'linear_acceleration.x', 'linear_acceleration.y', 'linear_acceleration.z']
    assert (sensor.get('name'), sensor.find('param').text) == ('right_wrench', '/right/wrench')
    assert [s.get('name') for s in sensor.findall('state_interface')] == [
        'force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z']
