# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""MoveIt packages: their files agree with one another, the model and Coal's collisions."""

import ast
from itertools import combinations
from pathlib import Path
import re
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml

from manip_sim.errors import ModelError
from manip_sim.interface.topics import topics_of
from manip_sim.models import compose
from manip_sim.models.urdf_writer import choose_robot
from manip_sim.moveit import write_package
from manip_sim.moveit.package import describe, write_files
from manip_sim.simulation import Simulation
from manip_sim.simulation.planning_scene import PlanningScene

pytestmark = pytest.mark.full

#: One arm, two, a lift on a mobile base, a hand of many fingers, a tool without, a prefix.
COMPOSITIONS = {
    'panda': {'robot': 'Panda', 'prefix': 'left_'}, 'baxter': {'robot': 'Baxter'},
    'omron': {'robot': 'PandaOmron', 'gripper': 'WipingGripper'},
    'jaco': {'robot': 'Jaco'}, 'humanoid': {'robot': 'GR1'},
    'bare': {'robot': 'UR5e', 'gripper': 'none', 'base': 'none'}}


class Package:
    """A package that was written, with its files read."""

    def __init__(self, folder, composition):
        self.folder, self.world = folder, compose(**composition)
        self.notes = write_package(self.world, folder)
        (self.urdf_file,), (srdf,) = ([*folder.glob(f'config/*.{end}')] for end in
                                      ('urdf', 'srdf'))
        self.urdf, self.srdf = ElementTree.parse(self.urdf_file), ElementTree.parse(srdf)
        self.srdf_file = srdf
        self.links = {link.get('name') for link in self.urdf.findall('link')}
        self.joints = {joint.get('name'): joint for joint in self.urdf.findall('joint')}
        self.following = {name for name, joint in self.joints.items()
                          if joint.find('mimic') is not None}
        self.groups = {group.get('name'): group for group in self.srdf.findall('group')}
        self.disabled = {frozenset((pair.get('link1'), pair.get('link2'))): pair.get('reason')
                         for pair in self.srdf.findall('disable_collisions')}

    def config(self, name):
        text = (self.folder / 'config' / f'{name}.yaml').read_text()
        assert '&' not in text  # The parser of ROS knows no aliases.
        return yaml.safe_load(text)

    def chain(self, group):
        """Return the joints of a chain, the first one first."""
        chain, joints = self.groups[group].find('chain'), []
        link = chain.get('tip_link')
        while link != chain.get('base_link'):
            joint = next(j for j in self.joints.values() if j.find('child').get('link') == link)
            joints.insert(0, joint)
            link = joint.find('parent').get('link')
        return [joint.get('name') for joint in joints if joint.get('type') != 'fixed']

    def members(self, group):
        """Return the joints of a group that can move."""
        element = self.groups[group]
        if element.find('chain') is not None:
            return self.chain(group)
        names = [joint.get('name') for joint in element.findall('joint')]
        for below in element.findall('group'):
            names += self.members(below.get('name'))
        return names


@pytest.fixture(scope='module')
def packages(tmp_path_factory):
    """Return a function that writes the package of a composition, once."""
    folder, written = tmp_path_factory.mktemp('src'), {}

    def get(name):
        if name not in written:
            written[name] = Package(folder / f'{name}_moveit_config', COMPOSITIONS[name])
        return written[name]
    return get


@pytest.fixture(params=COMPOSITIONS)
def package(request, packages):
    """Return the package of each composition."""
    return packages(request.param)


def test_every_name_of_the_srdf_is_in_the_urdf(package):
    assert package.srdf.getroot().get('name') == package.urdf.getroot().get('name')
    srdf = package.srdf
    links = {e.get(key) for e in srdf.iter() for key in ('link1', 'link2', 'base_link', 'tip_link',
                                                         'parent_link') if e.get(key)}
    links |= {e.get('name') for e in srdf.iter('link')}
    joints = {e.get('name') for kind in ('joint', 'passive_joint') for e in srdf.iter(kind)}
    groups = {e.get(key) for e in srdf.iter() for key in ('group', 'parent_group') if e.get(key)}
    groups |= {e.get('name') for e in srdf.findall('group/group')}
    assert links <= package.links and joints <= package.joints.keys()
    assert groups <= package.groups.keys() and package.groups
    # MoveIt rejects an end effector that has the link that it is on.
    for effector in srdf.findall('end_effector'):
        own = {e.get('name') for e in package.groups[effector.get('group')].findall('link')}
        chain = package.groups[effector.get('parent_group')].find('chain')
        assert effector.get('parent_link') == chain.get('tip_link') and chain.get(
            'tip_link') not in own


def test_groups_are_the_parts_of_the_robot(packages):
    expected = {
        'panda': {'arm': 7, 'gripper': 2}, 'bare': {'arm': 6}, 'jaco': {'arm': 7, 'gripper': 6},
        'baxter': {'right': 7, 'left': 7, 'arm': 14, 'right_gripper': 2, 'left_gripper': 2},
        'omron': {'arm': 7, 'torso': 1, 'gripper': 0},
        'humanoid': {'right': 7, 'left': 7, 'arm': 14, 'torso': 3, 'head': 3, 'legs': 12,
                     'right_gripper': 11, 'left_gripper': 11}}
    for name, groups in expected.items():
        package = packages(name)
        assert {group: len(package.members(group)) for group in package.groups} == groups
        robot = Simulation(package.world).robot
        for group in groups:
            part = group.replace('_', '/') if '_' in group else group
            part = 'right/gripper' if part == 'gripper' else part
            assert set(package.members(group)) == set(robot.parts[part].joints)
    assert len(packages('omron').srdf.findall('end_effector')) == 1
    assert not packages('bare').srdf.findall('end_effector')


def test_group_states_are_within_the_limits_and_of_joints_that_are_planned_for(package):
    passive = {joint.get('name') for joint in package.srdf.findall('passive_joint')}
    states = package.srdf.findall('group_state')
    assert {state.get('group') for state in states} == {
        group for group in package.groups if package.members(group)}
    start = Simulation(package.world).robot
    positions = dict(zip(start.joint_names, start.state().position))
    for state in states:
        values = {joint.get('name'): float(joint.get('value')) for joint in state}
        assert values.keys() == (set(package.members(state.get('group'))) - passive
                                 - package.following)
        for name, value in values.items():
            limit = package.joints[name].find('limit')
            if limit.get('lower') is not None:
                assert float(limit.get('lower')) <= value <= float(limit.get('upper'))
            if state.get('name') == 'start':
                assert value == pytest.approx(positions[name], abs=1e-9)


def test_grippers_have_states_open_and_closed(packages):
    def width(name):
        (joint,) = packages('panda').srdf.findall(
            f'group_state[@group="gripper"][@name="{name}"]/joint')
        return float(joint.get('value'))
    # Of each finger of the Panda, half of 80 mm.
    assert width('open') == pytest.approx(0.04, abs=2e-4)
    assert width('closed') == pytest.approx(0.0, abs=1e-3)
    names = {(s.get('group'), s.get('name')) for s in
             packages('baxter').srdf.findall('group_state')}
    assert {('left_gripper', 'open'), ('right_gripper', 'closed')} <= names


def test_joints_that_nothing_drives_are_passive(packages):
    passive = packages('jaco').srdf.findall('passive_joint')
    assert len(passive) == 3 and all('distal' in joint.get('name') for joint in passive)
    assert not packages('panda').srdf.findall('passive_joint')


def test_limits_are_those_of_the_urdf_and_complete_for_time_parameterization(package):
    limits = package.config('joint_limits')['joint_limits']
    planned = {joint.get('name') for joint in package.srdf.findall('group_state/joint')}
    passive = {joint.get('name') for joint in package.srdf.findall('passive_joint')}
    assert limits.keys() == planned | passive
    for name, limit in limits.items():
        assert limit['has_velocity_limits'] is limit['has_acceleration_limits'] is True
        assert limit['max_velocity'] == float(package.joints[name].find('limit').get('velocity'))
        # rclcpp takes no integer for a double.
        assert isinstance(limit['max_velocity'], float) and limit['max_acceleration'] > 0.0
        assert isinstance(limit['max_acceleration'], float)


def test_accelerations_are_those_that_the_node_keeps_to(packages):
    limits = packages('panda').config('joint_limits')['joint_limits']
    # Franka's limits for the Panda.
    assert [limits[f'left_joint{n}']['max_acceleration'] for n in range(1, 8)] == [
        15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]


def test_controllers_are_the_actions_of_the_node_and_move_each_joint_once(package):
    config = package.config('moveit_controllers')
    manager = config['moveit_simple_controller_manager']
    names = manager['controller_names']
    assert set(manager) == {'controller_names', *names}
    robot = Simulation(package.world).robot
    commands = {topic.name for topic in topics_of(robot.parts, False)}
    driven = []
    for name in names:
        controller = manager[name]
        # Actions stand beside the part's own commands: arm/..., right/gripper/...
        assert f'{name}/joint_command' in commands and controller['default'] is True
        kind = (('GripperCommand', 'gripper_cmd') if name.endswith('/gripper')
                else ('FollowJointTrajectory', 'follow_joint_trajectory'))
        assert (controller['type'], controller['action_ns']) == kind
        driven += controller['joints']
        if name in robot.grippers:
            # The action means the first joint that takes positions.
            assert controller['command_joint'] == robot.grippers[name].joints.names[0]
            assert controller['command_joint'] in controller['joints']
    assert len(set(driven)) == len(driven)
    # MoveIt sends a trajectory only if controllers cover all of its joints.
    planned = {joint.get('name') for joint in package.srdf.findall('group_state/joint')}
    assert planned <= set(driven)


def test_arms_have_a_solver_and_all_groups_planners(package):
    chains = {name for name, group in package.groups.items() if group.find('chain') is not None}
    assert package.config('kinematics').keys() == chains
    ompl = package.config('ompl_planning')
    assert {state.get('group') for state in package.srdf.findall('group_state')} <= ompl.keys()
    for name in package.groups:
        if name in ompl:
            assert set(ompl[name]['planner_configs']) == set(ompl['planner_configs'])
            assert ompl[name]['default_planner_config'] in ompl['planner_configs']
    pilz = package.config('pilz_industrial_motion_planner_planning')
    assert pilz['planning_plugins'] == ['pilz_industrial_motion_planner/CommandPlanner']
    assert package.config('pilz_cartesian_limits')['cartesian_limits']['max_trans_dec'] < 0.0


def test_the_package_can_be_built_and_names_itself_alike_everywhere(package):
    folder = package.folder
    catkin_pkg = pytest.importorskip('catkin_pkg.package', reason='needs catkin_pkg')
    # As colcon does, which takes no underscore in the domain of an e-mail address.
    catkin_pkg.parse_package(str(folder / 'package.xml'))
    manifest = ElementTree.parse(folder / 'package.xml')
    assert manifest.find('name').text == folder.name
    cmake = (folder / 'CMakeLists.txt').read_text()
    assert f'project({folder.name})' in cmake
    for name in re.search(r'DIRECTORY (.*) DESTINATION', cmake).group(1).split():
        assert any((folder / name).iterdir()), name
    launch = ast.parse((folder / 'launch' / 'moveit.launch.py').read_text())
    strings = {node.value for node in ast.walk(launch) if isinstance(node, ast.Constant)}
    name = package.urdf.getroot().get('name')
    assert {name, folder.name, 'config/moveit_controllers.yaml'} <= strings
    needed = {e.text for e in manifest.findall('exec_depend')}
    assert {node.module.split('.')[0] for node in ast.walk(launch)
            if isinstance(node, ast.ImportFrom)} <= needed
    config = yaml.safe_load((folder / '.setup_assistant').read_text())
    for kind, file in (('urdf', package.urdf_file), ('srdf', package.srdf_file)):
        assert folder / config['moveit_setup_assistant_config'][kind]['relative_path'] == file
    view = yaml.safe_load((folder / 'rviz' / 'moveit.rviz').read_text())
    displays = view['Visualization Manager']['Displays']
    assert displays[1]['Planning Request']['Planning Group'] in package.groups


def test_the_package_has_its_own_meshes(package):
    for mesh in package.urdf.iter('mesh'):
        start, _, rest = mesh.get('filename').partition(f'package://{package.folder.name}/')
        assert not start and (package.folder / rest).is_file()


# Collisions.

def model_of(package):
    """Return the URDF in MuJoCo, where everything collides with everything."""
    root = ElementTree.fromstring(package.urdf_file.read_text())
    ElementTree.SubElement(ElementTree.SubElement(root, 'mujoco'), 'compiler', {
        'fusestatic': 'false', 'discardvisual': 'true', 'inertiafromgeom': 'false',
        'boundmass': '1e-9', 'boundinertia': '1e-9'})
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding='unicode'))
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return spec.compile()


def sampled_collisions(package, samples, seed):
    """Yield the pairs of links that collide in random configurations, followers in place."""
    model, random = model_of(package), np.random.default_rng(seed)
    data = mujoco.MjData(model)
    for _ in range(samples):
        for joint in range(model.njnt):
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-3.1, 3.1)
            data.qpos[model.jnt_qposadr[joint]] = random.uniform(low, high)
        for name in package.following:
            mimic = package.joints[name].find('mimic')
            data.joint(name).qpos[0] = float(mimic.get('offset')) + float(
                mimic.get('multiplier')) * data.joint(mimic.get('joint')).qpos[0]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        deep = data.contact.geom[data.contact.dist < -1e-4]
        yield {frozenset(model.body(int(model.geom_bodyid[g])).name for g in pair)
               for pair in deep}


@pytest.mark.parametrize('name', ['panda', 'baxter', 'bare', 'omron'])
def test_what_is_said_never_to_collide_does_not_and_what_does_is_looked_at(name, packages):
    package = packages(name)
    seen = list(sampled_collisions(package, 600, seed=11))
    found = set().union(*seen)
    never = {pair for pair, reason in package.disabled.items() if reason == 'Never'}
    always = {pair for pair, reason in package.disabled.items() if reason == 'Always'}
    assert never and not never & found
    assert all(always <= pairs for pairs in seen)
    # Those that do collide and are not looked at are neighbours, or the model's own exceptions.
    assert found - package.disabled.keys()
    assert {package.disabled[pair] for pair in found & package.disabled.keys()} <= {
        'Adjacent', 'User', 'Default', 'Always'}


def test_collisions_that_matter_are_looked_at(packages):
    disabled = packages('panda').disabled
    for hand in ('left_gripper_right_gripper', 'left_gripper_leftfinger'):
        for other in ('left_link0', 'left_link1', 'left_link2', 'left_base_pedestal'):
            assert frozenset((hand, other)) not in disabled
    disabled = packages('baxter').disabled
    assert frozenset(('robot0_right_lower_forearm', 'robot0_left_lower_forearm')) not in disabled


def test_exceptions_of_the_model_are_kept_and_neighbours_left_alone(packages):
    disabled = packages('panda').disabled
    # The Panda's MJCF excludes these two, which are no neighbours.
    assert disabled[frozenset(('left_link5', 'left_link7'))] == 'User'
    assert disabled[frozenset(('left_link1', 'left_link2'))] == 'Adjacent'
    # Rigidly connected through the flange, which has no shape.
    assert disabled[frozenset(('left_link7', 'left_gripper_right_gripper'))] == 'Adjacent'
    # The tips of the fingers meet.
    tips = frozenset(f'left_gripper_finger_joint{n}_tip' for n in (1, 2))
    assert disabled[tips] == 'Default'


def test_in_all_group_states_coal_finds_no_collision(package):
    pinocchio = pytest.importorskip('pinocchio', reason='pin is a tool of the extra test')
    model = pinocchio.buildModelFromUrdf(str(package.urdf_file))
    shapes = pinocchio.buildGeomFromUrdf(
        model, str(package.urdf_file), pinocchio.GeometryType.COLLISION,
        package_dirs=[str(package.folder.parent)])
    shapes.addAllCollisionPairs()
    pinocchio.removeCollisionPairs(model, shapes, str(package.srdf_file))
    assert len(shapes.collisionPairs)
    data, found = model.createData(), shapes.createData()
    states = package.srdf.findall('group_state')
    start = {joint.get('name'): float(joint.get('value')) for state in states
             if state.get('name') == 'start' for joint in state}
    robot = Simulation(package.world).robot
    everything = {**dict(zip(robot.joint_names, robot.state().position)), **start}
    for state in states:
        q = pinocchio.neutral(model)
        position = {**everything, **{j.get('name'): float(j.get('value')) for j in state}}
        for name in package.following:
            mimic = package.joints[name].find('mimic')
            position[name] = float(mimic.get('offset')) + float(
                mimic.get('multiplier')) * position[mimic.get('joint')]
        for name, value in position.items():
            joint = model.joints[model.getJointId(name)]
            q[joint.idx_q:joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value)))
        pinocchio.computeCollisions(model, data, shapes, found, q, False)
        hit = [tuple(shapes.geometryObjects[i].name for i in (pair.first, pair.second))
               for pair, result in zip(shapes.collisionPairs, found.collisionResults)
               if result.isCollision()]
        assert not hit, (state.attrib, hit)


@pytest.mark.parametrize(('robot', 'arena'), [
    ('Panda', 'table'), ('UR5e', 'drawer'), ('PandaOmron', 'bins')])
def test_at_the_start_coal_finds_no_collision_with_the_planning_scene(robot, arena, tmp_path):
    pinocchio = pytest.importorskip('pinocchio', reason='pin is a tool of the extra test')
    import coal
    world = compose(robot=robot, arena=arena)
    simulation = Simulation(world)
    urdf, meshes = describe(simulation.model, choose_robot(world), 'own')
    write_files(tmp_path / 'own', {'urdf': urdf.xml.encode(), **meshes})
    model = pinocchio.buildModelFromXML(urdf.xml)
    shapes = pinocchio.buildGeomFromUrdfString(
        model, urdf.xml, pinocchio.GeometryType.COLLISION, package_dirs=[str(tmp_path)])
    state, q = simulation.robot.state(), pinocchio.neutral(model)
    for name, value in zip(simulation.robot.joint_names, state.position):
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q:joint.idx_q + joint.nq] = (
            value if joint.nq == 1 else (np.cos(value), np.sin(value)))
    data, placed = model.createData(), shapes.createData()
    pinocchio.updateGeometryPlacements(model, data, shapes, placed, q)
    scene = PlanningScene(simulation.model, simulation.robot.robot_model.root_body, {})
    distances = {}
    for name, pose in scene.poses(simulation.data).items():
        for solid in scene.obstacles[name].solids:
            place = pinocchio.XYZQUATToSE3(pose) * pinocchio.XYZQUATToSE3(solid.pose)
            at = coal.Transform3s(place.rotation, place.translation)
            sizes = solid.dimensions
            shape = (coal.Box(*sizes) if solid.kind == 'box' else coal.Sphere(*sizes)
                     if solid.kind == 'sphere' else coal.Cylinder(*reversed(sizes)))
            for number, link in enumerate(shapes.geometryObjects):
                own = placed.oMg[number]
                distances[name, link.name] = coal.distance(
                    shape, at, link.geometry, coal.Transform3s(own.rotation, own.translation),
                    coal.DistanceRequest(), coal.DistanceResult())
    assert min(distances.values()) > 5e-4, min(distances, key=distances.get)
    if (robot, arena) == ('Panda', 'table'):
        # The mount stands against the table in the simulation.
        assert distances['table', 'fixed_mount0_pedestal_0'] == pytest.approx(0.02, abs=1e-6)


# What cannot be.

def test_the_same_robot_has_the_same_files(packages, tmp_path):
    first = packages('bare').folder
    write_package(compose(**COMPOSITIONS['bare']), tmp_path / first.name)
    files = [path.relative_to(first) for path in first.rglob('*') if path.is_file()]
    assert len(files) > 10
    for file in files:
        assert (tmp_path / first.name / file).read_bytes() == (first / file).read_bytes(), file


def test_the_present_folder_becomes_a_package_of_its_name(tmp_path, monkeypatch):
    folder = tmp_path / 'panda_config'
    folder.mkdir()
    monkeypatch.chdir(folder)
    write_package(compose('Panda'), Path('.'))
    assert ElementTree.parse(folder / 'package.xml').findtext('name') == 'panda_config'
    assert [path.name for path in tmp_path.iterdir()] == ['panda_config']


@pytest.mark.parametrize(('name', 'what'), [
    ('Panda-Config', "'Panda-Config' cannot be the name of a ROS package: it needs lower-case"),
    ('lost/panda', 'no such folder: '), ('full', 'is not empty: give a new folder'),
    ('file', 'is a file, give the name of a folder')])
def test_a_folder_that_cannot_be_used_is_told(name, what, tmp_path):
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'kept').write_text('kept')
    (tmp_path / 'file').write_text('kept')
    with pytest.raises(ModelError, match=what):
        write_package(compose('Panda'), tmp_path / name)
    assert (tmp_path / 'full' / 'kept').read_text() == 'kept'


def test_a_robot_without_joints_to_plan_for_is_told(one_joint_arm, tmp_path):
    from manip_sim.models import World
    robot = one_joint_arm(worldbody="""
        <body name="base"><geom size="0.05" mass="1"/>
          <body name="link1"><joint name="joint1_mobile" axis="0 1 0"/><geom size="0.05"/>
            <body name="right_hand"/></body></body>""", actuators="""
        <motor joint="joint1_mobile" ctrlrange="-1 1"/>""")
    with pytest.raises(ModelError, match='has no joints that MoveIt could plan for'):
        write_package(World([robot]), tmp_path / 'config')
    assert not [*Path(tmp_path).glob('config')]


def test_every_pair_of_links_with_shapes_is_either_disabled_or_looked_at_once(packages):
    package = packages('bare')
    shaped = [link.get('name') for link in package.urdf.findall('link')
              if link.find('collision') is not None]
    pairs = {frozenset(pair) for pair in combinations(shaped, 2)}
    assert package.disabled.keys() <= pairs
    assert len(package.srdf.findall('disable_collisions')) == len(package.disabled)


def test_a_mesh_is_in_the_package_also_where_no_file_held_it(one_joint_arm, tmp_path):
    from manip_sim.models import World
    robot = one_joint_arm(worldbody="""
        <body name="base"><geom size="0.05"/>
          <body name="link1"><joint name="joint1" axis="0 1 0"/><geom type="mesh" mesh="wedge"/>
            <body name="right_hand"/></body></body>""", sections="""
        <asset><mesh name="wedge" vertex="0 0 0 0.3 0 0 0 0.1 0 0.02 0.03 0.2"/></asset>""")
    folder = tmp_path / 'arm_moveit_config'
    assert write_package(World([robot]), folder) == []
    (urdf,) = folder.glob('config/*.urdf')
    (mesh,) = ElementTree.parse(urdf).findall('link/collision/geometry/mesh')
    assert mesh.get('filename') == 'package://arm_moveit_config/meshes/mesh_0.stl'
    spec = mujoco.MjSpec()
    spec.add_mesh(name='m', file=str(folder / 'meshes' / 'mesh_0.stl'))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname='m')
    size = np.sort(2.0 * spec.compile().geom_aabb[0, 3:])
    compiled = World([robot]).compile()
    geom = compiled.body('robot0_link1').geomadr[0]
    np.testing.assert_allclose(size, np.sort(2.0 * compiled.geom_aabb[geom, 3:]), atol=1e-6)
