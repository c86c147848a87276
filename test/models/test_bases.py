# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the bases, and of robots on mobile ones."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose_robot
from manip_sim.models.bases import base_names, BASES, create_base, MobileBaseModel
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import create_robot, PandaOmron, RobotModel
from manip_sim.models.robots.robot_model import ROBOTS
from manip_sim.models.world import World

# Of robosuite 1.5.2: prefix, bodies, joints, (actuator, range of its control) and sites.
PLANAR = ['joint_mobile_forward', 'joint_mobile_side', 'joint_mobile_yaw']
DRIVES = [('actuator_mobile_forward', (-1.0, 1.0)), ('actuator_mobile_side', (-1.0, 1.0)),
          ('actuator_mobile_yaw', (-1.5, 1.5))]
REFERENCE_BASES = {
    'NoActuationBase': ('mobilebase', ['support'], [], [], ['center']),
    'NullMobileBase': ('mobilebase', ['support'], PLANAR, DRIVES, ['center']),
    'NullMount': ('fixed_mount', ['base'], [], [], []),
    'OmronMobileBase': ('mobilebase', ['base', 'fixed_support', 'support', 'wheeled_base'],
                        [*PLANAR, 'joint_torso_height'], DRIVES, ['center'])}
# Of robosuite 1.5.2: PandaOmron with its base; there manipulator_mount has no prefix.
REFERENCE_PARENTS = {
    'robot0_base': 'world', 'mobilebase0_base': 'robot0_base',
    'mobilebase0_fixed_support': 'mobilebase0_base',
    'mobilebase0_wheeled_base': 'mobilebase0_base',
    'mobilebase0_support': 'mobilebase0_fixed_support',
    'robot0_manipulator_mount': 'mobilebase0_support', 'robot0_link0': 'robot0_manipulator_mount',
    'robot0_link1': 'robot0_link0', 'robot0_link2': 'robot0_link1',
    'robot0_link3': 'robot0_link2', 'robot0_link4': 'robot0_link3',
    'robot0_link5': 'robot0_link4', 'robot0_link6': 'robot0_link5',
    'robot0_link7': 'robot0_link6', 'robot0_right_hand': 'robot0_link7',
    'gripper0_right_right_gripper': 'robot0_right_hand',
    'gripper0_right_eef': 'gripper0_right_right_gripper',
    'gripper0_right_leftfinger': 'gripper0_right_right_gripper',
    'gripper0_right_finger_joint1_tip': 'gripper0_right_leftfinger',
    'gripper0_right_rightfinger': 'gripper0_right_right_gripper',
    'gripper0_right_finger_joint2_tip': 'gripper0_right_rightfinger'}
REFERENCE_JOINTS = [
    *[f'mobilebase0_{joint}' for joint in PLANAR], 'mobilebase0_joint_torso_height',
    *[f'robot0_joint{i}' for i in range(1, 8)],
    'gripper0_right_finger_joint1', 'gripper0_right_finger_joint2']
REFERENCE_ACTUATORS = [
    *[f'robot0_torq_j{i}' for i in range(1, 8)], 'mobilebase0_actuator_mobile_forward',
    'mobilebase0_actuator_mobile_side', 'mobilebase0_actuator_mobile_yaw',
    'mobilebase0_actuator_torso_height',
    'gripper0_right_gripper_finger_joint1', 'gripper0_right_gripper_finger_joint2']
REFERENCE_HAND_POS = [0.4466586348568316, 0.0, 1.1644877610055633]
REFERENCE_HAND_XYZW = [0.9979766064600605, 0.0002458138065242199, 0.0635816977499661,
                       1.5660947409009553e-05]

FOOTED = """
<body name="pelvis" pos="0 0 0.8">
  <freejoint/>
  <geom name="pelvis" size="0.1" mass="5"/>
  <geom name="foot" type="box" size="0.1 0.1 0.02" pos="0 0 -0.78" mass="2"/>
  <body name="chest" pos="0 0 0.3">
    <joint name="waist" axis="0 0 1"/>
    <geom name="chest" size="0.1" mass="3"/>
  </body>
</body>
"""
LIFT = """
<body name="column">
  <joint name="joint_torso_lift" type="slide" axis="0 0 1"/>
  <geom size="0.05" pos="0 0 0.2" mass="4"/>
  <body name="{support}" pos="0 0 0.3"/>
</body>
"""


@pytest.fixture(autouse=True)
def _own_registries(monkeypatch):
    """Forget the classes that a test defines."""
    for registry in (BASES, ROBOTS):
        monkeypatch.setattr(registry, '_classes', dict(registry._classes))


def write(folder, worldbody, sections=''):
    """Write an MJCF file and return its path."""
    path = Path(folder, 'model.xml')
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{worldbody}</worldbody>'
                    f'{sections}</mujoco>')
    return path


def footed_robot(folder, sections=''):
    """Return a robot whose root is authored where it stands, 0.8 m above the floor."""
    class Footed(RobotModel):
        default_base = None
        default_controller_config = {}
        base_xpos_offset = {}
        init_qpos = np.zeros(1)

    return Footed(write(folder, FOOTED, sections))


def lift_base(folder, support='support'):
    """Return a mobile base that only lifts."""
    class Lift(MobileBaseModel):
        pass

    return Lift(write(folder, LIFT.format(support=support),
                      '<actuator><motor name="lift" joint="joint_torso_lift"/></actuator>'))


def equipped(name='PandaOmron', base='OmronMobileBase', idn=0):
    """Return a robot with a base and a gripper, named as the node names them."""
    return compose_robot(name, 'PandaGripper', base, idn=idn)


class AtRest:
    """A world whose joints start where they should and whose position servos hold them."""

    def __init__(self, *robots, **options):
        self.world = World(robots, **options)
        self.model = self.world.compile()
        self.data = mujoco.MjData(self.model)
        for joint, position in self.world.init_qpos().items():
            self.data.joint(joint).qpos = position
        for actuator in np.flatnonzero(self.model.actuator_biasprm[:, 1] < 0.0):
            joint = self.model.actuator_trnid[actuator, 0]
            self.data.ctrl[actuator] = self.data.qpos[self.model.jnt_qposadr[joint]]
        mujoco.mj_forward(self.model, self.data)

    def command(self, actuator, value):
        """Set the command of an actuator."""
        self.data.ctrl[self.model.actuator(actuator).id] = value

    def run(self, seconds):
        """Advance the simulation."""
        mujoco.mj_step(self.model, self.data, round(seconds / self.model.opt.timestep))


def names(kind, count):
    """Return the names of a model's elements in its order."""
    return [kind(i).name for i in range(count)]


# ---------------------------------------------------------------------- the bases themselves

@pytest.mark.parametrize('name', REFERENCE_BASES)
def test_bases_have_the_names_and_control_ranges_of_the_reference(name):
    prefix, bodies, joints, actuators, sites = REFERENCE_BASES[name]
    base = create_base(name, idn='7')
    assert base.naming_prefix == f'{prefix}7_'
    assert base.bodies == base.correct_naming(bodies)
    assert base.joints == base.correct_naming(joints)
    assert base.actuators[:len(actuators)] == base.correct_naming([a for a, _ in actuators])
    # The IMU is ours.
    assert [s for s in base.sites if not s.endswith('_imu')] == base.correct_naming(sites)
    for raw, ctrlrange in actuators:
        np.testing.assert_array_equal(base.spec.actuator(raw).ctrlrange, ctrlrange)
    np.testing.assert_array_equal(base.top_offset, np.zeros(3))
    np.testing.assert_array_equal(base.bottom_offset, np.zeros(3))


def test_lift_takes_positions_over_the_whole_range_of_its_joint():
    robot = equipped()
    model = robot.compile()
    np.testing.assert_allclose(model.actuator('mobilebase0_actuator_torso_height').ctrlrange,
                               [0.0, 0.34])
    np.testing.assert_allclose(robot.format_action('torso', [0.0]), [0.17])


def test_drives_and_lift_belong_to_different_subsystems():
    robot = equipped()
    assert robot.base_joints == [f'mobilebase0_{joint}' for joint in PLANAR]
    assert robot.torso_joints == ['mobilebase0_joint_torso_height']
    assert robot.torso_actuators == ['mobilebase0_actuator_torso_height']
    assert robot.base_actuators == [f'mobilebase0_{actuator}' for actuator, _ in DRIVES]
    assert robot.arm_joints == robot.joints


# ---------------------------------------------------------------------- mounted on a mobile base

def test_bodies_joints_and_actuators_of_panda_omron_are_those_of_the_reference():
    robot = equipped()
    model = robot.compile()
    parents = {model.body(i).name: model.body(model.body_parentid[i]).name
               for i in range(1, model.nbody)}
    assert parents == REFERENCE_PARENTS
    assert names(model.joint, model.njnt) == REFERENCE_JOINTS
    assert names(model.actuator, model.nu) == REFERENCE_ACTUATORS
    assert [part.name for part in robot.models] == ['OmronMobileBase0', 'PandaGripper0_right']
    assert robot.all_joints == robot.joints + robot.base.joints
    assert robot.all_actuators == robot.actuators + robot.base.actuators


def test_hand_of_panda_omron_starts_where_the_reference_has_it():
    rest = AtRest(equipped())
    root, hand = rest.data.body('robot0_base'), rest.data.body('robot0_right_hand')
    np.testing.assert_allclose(root.xpos, [-0.6, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(hand.xpos - root.xpos, REFERENCE_HAND_POS, atol=1e-9)
    assert abs(np.roll(hand.xquat, -1) @ REFERENCE_HAND_XYZW) == pytest.approx(1.0, abs=1e-9)
    assert rest.data.joint('mobilebase0_joint_torso_height').qpos == 0.2
    assert rest.data.ncon == 0


def test_each_actuator_keeps_its_parameters_below_its_name():
    robot = equipped()
    model = robot.compile()
    for part in (robot, *robot.models):
        # The file alone, without the composing that is tested; a base has a part without mass.
        spec = mujoco.MjSpec.from_file(str(part.file))
        spec.compiler.boundmass, spec.compiler.boundinertia = 1e-6, 1e-9
        alone = spec.compile()
        for i in range(alone.nu):
            ours = model.actuator(part.correct_naming(alone.actuator(i).name))
            for field in ('gainprm', 'biasprm', 'ctrlrange', 'forcerange', 'gear', 'trntype'):
                np.testing.assert_array_equal(getattr(ours, field),
                                              getattr(alone.actuator(i), field))
            assert model.joint(ours.trnid[0]).name == part.correct_naming(
                alone.joint(alone.actuator_trnid[i, 0]).name)


def test_gripper_before_or_after_the_base_gives_the_same_model():
    later = create_robot('PandaOmron')
    later.add_gripper(create_gripper('PandaGripper', idn='0_right'))
    later.add_base(create_base('OmronMobileBase'))
    assert later.to_xml() == equipped().to_xml()


def test_two_mobile_robots_move_one_by_one_in_one_world():
    class Neighbour(PandaOmron):
        base_xpos_offset = {'empty': (-0.6, -2.0, 0.0)}

    rest = AtRest(equipped('Neighbour', idn='b'), equipped(idn=0))
    rest.command('mobilebaseb_actuator_mobile_side', 0.5)
    rest.run(1.0)
    # A lag of a tenth of a second at most.
    assert rest.data.body('robotb_right_hand').xpos[1] == pytest.approx(-1.525, abs=0.025)
    assert rest.data.body('robot0_right_hand').xpos[1] == pytest.approx(0.0, abs=1e-6)


def test_two_mobile_robots_of_one_number_are_rejected():
    spec = mujoco.MjSpec()
    equipped().attach_to(spec, spec.worldbody.add_frame())
    with pytest.raises(ModelError, match="^body 'robot0_base' already exists, PandaOmron0 "):
        equipped().attach_to(spec, spec.worldbody.add_frame())


@pytest.mark.parametrize('base', ['OmronMobileBase', 'NullMobileBase', 'NoActuationBase'])
def test_joint_attributes_set_after_mounting_reach_the_model(base):
    robot = equipped(base=base)
    robot.set_joint_attribute('damping', np.arange(1.0, 8.0))
    model = robot.compile()
    for i, joint in enumerate(robot.joints):
        assert model.dof_damping[model.joint(joint).dofadr[0]] == i + 1.0


def test_turned_root_turns_the_way_the_base_drives():
    robot = equipped()
    robot.set_base_ori([0.0, 0.0, np.pi / 2.0])
    rest = AtRest(robot)
    rest.data.joint('mobilebase0_joint_mobile_forward').qpos = 1.0
    mujoco.mj_kinematics(rest.model, rest.data)
    np.testing.assert_allclose(rest.data.body('robot0_link0').xpos, [-0.6, 1.0, 0.9], atol=1e-9)


def test_robot_stands_with_its_feet_on_a_base_that_does_not_move(tmp_path):
    robot = footed_robot(tmp_path)
    robot.add_base(create_base('NoActuationBase'))
    rest = AtRest(robot)
    np.testing.assert_allclose(rest.data.body('robot0_manipulator_mount').xpos, [0, 0, 0.8])
    assert rest.data.geom('robot0_foot').xpos[2] == pytest.approx(0.02)
    rest.run(0.1)
    assert rest.data.body('robot0_chest').xpos[2] == pytest.approx(1.1), 'no free joint is left'


def test_robot_stands_with_its_feet_on_the_support_of_a_lift(tmp_path):
    robot = footed_robot(tmp_path)
    robot.add_base(lift_base(tmp_path))
    rest = AtRest(robot)
    assert rest.data.geom('robot0_foot').xpos[2] == pytest.approx(0.3 + 0.02)


def test_what_refers_to_the_root_refers_to_the_part_that_moves(tmp_path):
    robot = footed_robot(tmp_path, """
        <contact><exclude body1="pelvis" body2="chest"/></contact>
        <equality><weld body1="chest" body2="pelvis" active="false"/></equality>
        <sensor>
          <framepos name="pos" objtype="xbody" objname="pelvis"/>
          <framepos name="relative" objtype="body" objname="chest" reftype="body"
            refname="pelvis"/>
        </sensor>
        <deformable>
          <skin vertex="0 0 0 0.1 0 0 0 0.1 0" face="0 1 2">
            <bone body="chest" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0" vertweight="1"/>
            <bone body="pelvis" bindpos="0 0 0" bindquat="1 0 0 0" vertid="1 2" vertweight="1 1"/>
          </skin>
          <flex name="rope" dim="1" radius="0.01" body="chest pelvis" vertex="0 0 0 0 0 0"
            element="0 1"><edge stiffness="1"/></flex>
        </deformable>
        <custom><tuple name="both"><element objtype="body" objname="pelvis"/>
          <element objtype="sensor" objname="pos"/></tuple></custom>""")
    robot.spec.body('chest').add_camera(name='eye', targetbody='pelvis')
    robot.add_base(lift_base(tmp_path))
    rest = AtRest(robot)
    model, mount = rest.model, rest.model.body('robot0_manipulator_mount').id
    chest = rest.model.body('robot0_chest').id
    assert model.exclude_signature.tolist() == [(min(mount, chest) << 16) + max(mount, chest)]
    assert [int(model.eq_obj1id[0]), int(model.eq_obj2id[0])] == [chest, mount]
    assert model.sensor_objid.tolist() == [mount, chest]
    assert model.sensor_refid.tolist()[1] == mount
    assert int(model.cam_targetbodyid[model.camera('robot0_eye').id]) == mount
    assert model.skin_bonebodyid.tolist() == [chest, mount]
    assert model.flex_vertbodyid.tolist() == [chest, mount]
    assert model.tuple_objid.tolist() == [mount, model.sensor('robot0_pos').id]


def test_actuator_sensors_survive_the_order_of_actuators(tmp_path):
    robot = footed_robot(tmp_path, """
        <actuator><motor name="twist" joint="waist" gear="3"/></actuator>
        <sensor><actuatorfrc name="effort" actuator="twist"/></sensor>""")
    robot.add_base(create_base('OmronMobileBase'))
    rest = AtRest(robot)
    assert names(rest.model.actuator, rest.model.nu)[0] == 'robot0_twist'
    rest.command('robot0_twist', 2.0)
    rest.command('mobilebase0_actuator_mobile_forward', 0.1)
    mujoco.mj_forward(rest.model, rest.data)
    np.testing.assert_allclose(rest.data.sensor('robot0_effort').data, 2.0)
    assert rest.data.joint('robot0_waist').qfrc_actuator[0] == pytest.approx(6.0)


def test_base_without_its_support_is_rejected_with_the_bodies_it_has(tmp_path):
    robot = footed_robot(tmp_path)
    with pytest.raises(UnknownNameError, match=r"unknown body of Lift0 to mount a robot on "
                       r"'support': .*available: column, plate"):
        robot.add_base(lift_base(tmp_path, support='plate'))
    assert robot.base is None


# ---------------------------------------------------------------------- where joints start

def test_lift_of_panda_omron_starts_at_the_height_of_the_reference():
    robot = equipped()
    np.testing.assert_array_equal(robot.init_torso_qpos, [0.2])
    np.testing.assert_array_equal(robot.init_base_qpos, [0.0, 0.0, 0.0, 0.2])


@pytest.mark.parametrize(('base', 'count'), [
    ('RethinkMount', 0), ('NullMount', 0), ('NoActuationBase', 0), ('NullMobileBase', 3)])
def test_panda_omron_starts_at_zero_on_a_base_without_a_lift(base, count):
    robot = equipped(base=base)
    np.testing.assert_array_equal(robot.init_base_qpos, np.zeros(count))
    assert len(World([robot]).init_qpos()) == 7 + count + 2


def test_panda_omron_without_a_base_has_no_start_for_it():
    robot = create_robot('PandaOmron')
    assert robot.init_base_qpos is None
    assert list(World([robot]).init_qpos()) == robot.joints


# ---------------------------------------------------------------------- motion

@pytest.mark.parametrize('base', ['OmronMobileBase', 'NullMobileBase'])
@pytest.mark.parametrize(('direction', 'axis'), [('forward', 0), ('side', 1)])
def test_drives_keep_the_commanded_speed(base, direction, axis):
    rest = AtRest(equipped(base=base))
    rest.command(f'mobilebase0_actuator_mobile_{direction}', 0.5)
    rest.run(0.5)
    begin = rest.data.body('robot0_link0').xpos.copy()
    rest.run(2.0)
    way = rest.data.body('robot0_link0').xpos - begin
    np.testing.assert_allclose(way, np.eye(3)[axis], atol=1e-3)


@pytest.mark.parametrize('base', ['OmronMobileBase', 'NullMobileBase'])
def test_yaw_turns_about_a_point_behind_the_robot(base):
    rest = AtRest(equipped(base=base))
    begin = rest.data.body('robot0_link0').xpos.copy()
    rest.command('mobilebase0_actuator_mobile_yaw', 1.0)
    rest.run(1.5)
    angle = rest.data.joint('mobilebase0_joint_mobile_yaw').qpos[0]
    assert angle == pytest.approx(1.5, abs=0.05)
    # The robot stands 0.21 m before the axis: joint_mobile_yaw of robosuite. Of the 10 N that
    # hold it on its circle the drives give way by 1 mm/s.
    moved = 0.21 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])
    np.testing.assert_allclose(rest.data.body('robot0_link0').xpos - begin, moved, atol=3e-3)


def test_lift_raises_the_hand_by_what_is_commanded_no_faster_than_its_limit():
    rest = AtRest(equipped())
    begin = rest.data.body('robot0_right_hand').xpos.copy()
    joint = rest.model.joint('mobilebase0_joint_torso_height')
    rest.command('mobilebase0_actuator_torso_height', 0.34)
    fastest = 0.0
    for _ in range(300):
        rest.run(0.01)
        fastest = max(fastest, rest.data.qvel[joint.dofadr[0]])
    np.testing.assert_allclose(rest.data.body('robot0_right_hand').xpos - begin,
                               [0.0, 0.0, 0.14], atol=1e-4)
    assert fastest == pytest.approx(joint.user[0], rel=0.05)


def test_mobile_robot_stays_where_it_is_while_it_holds():
    rest = AtRest(equipped())
    begin = rest.data.qpos.copy()
    rest.run(5.0)
    np.testing.assert_allclose(rest.data.qpos, begin, atol=1e-6)
    assert sum(int(warning.number) for warning in rest.data.warning) == 0


def test_base_comes_back_after_the_arm_has_thrown_it_about():
    rest = AtRest(equipped())
    for target in (0.8, 0.0):
        rest.command('robot0_torq_j1', target)
        rest.run(1.5)
    # Forces within a robot have no net impulse, so a velocity servo ends where it began.
    assert abs(rest.data.joint('mobilebase0_joint_mobile_side').qpos[0]) < 1e-4
    assert abs(rest.data.joint('mobilebase0_joint_mobile_yaw').qpos[0]) < 1e-4


# ---------------------------------------------------------------------- gravity

def test_lift_feels_no_weight_with_gravity_compensation_also_of_the_root(tmp_path):
    robot = footed_robot(tmp_path)
    robot.add_base(lift_base(tmp_path))
    rest = AtRest(robot)
    lift = rest.model.joint('mobilebase0_joint_torso_lift').dofadr[0]
    # The column's 4 kg, the root's 5 kg and 2 kg, the chest's 3 kg.
    assert rest.data.qfrc_actuator[lift] == pytest.approx(14.0 * 9.81)
    rest.run(1.0)
    assert rest.data.joint('mobilebase0_joint_torso_lift').qpos[0] == pytest.approx(0.0, abs=1e-9)


def test_lift_falls_freely_without_gravity_compensation(tmp_path):
    robot = footed_robot(tmp_path)
    robot.add_base(lift_base(tmp_path))
    rest = AtRest(robot, gravity_compensation=False)
    lift = rest.model.joint('mobilebase0_joint_torso_lift').dofadr[0]
    assert rest.data.qacc[lift] == pytest.approx(-9.81)


@pytest.mark.parametrize('name', base_names())
def test_collision_shapes_of_bases_are_flat_or_capsules(name):
    # Arms that press on cylinders, whose contacts are found by iterations, rest less well.
    types = {int(geom.type) for geom in create_base(name).spec.geoms
             if geom.contype or geom.conaffinity}
    assert types <= {int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE)}
