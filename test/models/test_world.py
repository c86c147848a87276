# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of arenas and of robots placed in them."""

import math
from xml.etree import ElementTree

from catalogue import ROBOTS
import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose, compose_robot
from manip_sim.models.arenas import Arena, create_arena, EmptyArena, TableArena
from manip_sim.models.bases import RethinkMount
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.object_creation import create_object
from manip_sim.models.robots import Panda
from manip_sim.models.world import World
from manip_sim.physics.object_spawning import plan_with, plan_world


@pytest.fixture
def hall():
    """Return the class of an arena of a file, which the catalogue lists as long as it exists."""
    class Hall(Arena):
        arena_name = 'hall'

    return Hall


def height_above_floor(model, geom_name):
    """Return the lowest and the highest corner of a box geom whose body is not turned [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    middle, half = data.geom(geom_name).xpos[2], model.geom(geom_name).size[2]
    return middle - half, middle + half


@pytest.mark.parametrize(('arena', 'place'), [
    (EmptyArena(), (-0.6, 0.0, 0.912)),
    (TableArena(), (-0.56, 0.0, 0.912)),
    (TableArena(table_length_m=1.0), (-0.66, 0.0, 0.912))])
def test_robot_is_placed_by_the_arena(panda, arena, place):
    np.testing.assert_allclose(World([panda], arena).compile().body('robot0_base').pos, place)


def test_robot_without_an_entry_for_the_arena_stands_at_the_origin(one_joint_arm):
    robot = one_joint_arm()
    np.testing.assert_array_equal(World([robot]).compile().body('robot0_base').pos, [0, 0, 0])


@pytest.mark.parametrize(('length', 'height'), [(0.8, 0.8), (1.2, 0.5)])
def test_table_has_the_size_asked_for(length, height):
    model = TableArena(table_length_m=length, table_height_m=height).compile()
    assert 2.0 * model.geom('table_collision').size[0] == pytest.approx(length)
    assert height_above_floor(model, 'table_collision')[1] == pytest.approx(height)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    leg = model.geom('table_leg1_visual')
    assert data.geom('table_leg1_visual').xpos[2] - leg.size[1] == pytest.approx(0.0, abs=1e-9)
    assert abs(leg.pos[0]) + leg.size[0] < length / 2.0


@pytest.mark.parametrize(('length', 'height', 'message'), [
    (0.0, 0.8, 'table_length.* must be 0.3 to 5 m, got 0.0$'),
    (0.8, 0.05, 'table_height.* must be 0.1 to 2 m, got 0.05$'),
    (-1.0, 0.8, 'table_length.* got -1.0$'), (float('nan'), 0.8, 'table_length.* got nan$')])
def test_table_without_a_size_is_rejected(length, height, message):
    with pytest.raises(ModelError, match=f"^parameter '{message}"):
        TableArena(table_length_m=length, table_height_m=height)


def test_cube_lies_free_on_the_table():
    model = TableArena(table_height_m=0.6, cube=True).compile()
    assert height_above_floor(model, 'cube') == pytest.approx((0.6, 0.65))
    assert model.body('cube').mass[0] == pytest.approx(0.1)
    assert int(model.joint('cube_joint').type[0]) == int(mujoco.mjtJoint.mjJNT_FREE)
    with pytest.raises(KeyError):
        TableArena(cube=False).compile().body('cube')


def test_two_robots_of_different_idn_share_a_world(panda):
    other = Panda(idn=1)
    other.add_base(RethinkMount(idn=1))
    other.add_gripper(PandaGripper(idn='1_right'))
    world = World([panda, other])
    model = world.compile()
    assert model.nq == 18
    assert set(world.init_qpos()) == {model.joint(i).name for i in range(18)}


def test_a_robot_that_was_placed_stays_there_and_another_goes_with_the_arena(panda):
    other = Panda(idn=1)
    other.add_base(RethinkMount(idn=1))
    other.set_base_xpos((-0.6, 1.0, 0.0))
    for arena, x in ((EmptyArena(), -0.6), (TableArena(), -0.56)):
        model = World([panda, other], arena).compile()
        np.testing.assert_allclose(model.body('robot0_base').pos, [x, 0.0, 0.912])
        np.testing.assert_allclose(model.body('robot1_base').pos, [-0.6, 1.0, 0.912])


def test_two_robots_of_one_idn_are_rejected(panda):
    with pytest.raises(ModelError, match=r'^robots in one world need different idn or prefix, got '
                                         r'robot0_, robot0_$'):
        World([panda, Panda()])


@pytest.mark.parametrize('prefixes', [('left', 'left_'), ('robot0', ''), ('a_', 'a__')])
def test_prefixes_that_differ_in_underscores_at_the_end_alone_are_rejected(prefixes):
    robots = [compose_robot('Panda', prefix=prefix) for prefix in prefixes]
    with pytest.raises(ModelError, match=r'^robots in one world need different idn or prefix, '
                                         r'underscores at the end apart, got '):
        World(robots)


def test_two_grippers_of_one_idn_in_a_world_are_rejected(panda):
    other = Panda(idn=1)
    other.add_gripper(PandaGripper(idn='0_right'))
    with pytest.raises(ModelError, match=r"^body 'gripper0_right_right_gripper' already "
                                         r'exists, PandaGripper0_right cannot bring another'):
        World([panda, other]).compile()


def test_gravity_is_compensated_in_every_moving_body_of_robot_and_gripper(panda):
    model = World([panda], TableArena(cube=True)).compile()
    for body in range(1, model.nbody):
        name = model.body(body).name
        assert model.body_gravcomp[body] == float(name not in ('table', 'cube')), name
    scalar = model.jnt_type != int(mujoco.mjtJoint.mjJNT_FREE)
    np.testing.assert_array_equal(model.jnt_actgravcomp, scalar)


def test_gravity_compensation_can_be_left_out(panda):
    assert not World([panda], gravity_compensation=False).compile().body_gravcomp.any()


@pytest.mark.parametrize('arm_at_rest_q', [0.0, 1.0])
def test_gravity_compensation_carries_all_of_a_robot_on_a_mobile_base(one_joint_arm, mobile_base,
                                                                      arm_at_rest_q):
    robot = one_joint_arm()
    robot.add_base(mobile_base)
    model = World([robot]).compile()
    data = mujoco.MjData(model)
    data.joint('robot0_joint1').qpos[0] = arm_at_rest_q
    mujoco.mj_forward(model, data)
    lift = model.joint('mobilebase0_joint_torso_height').dofadr[0]
    above_lift_kg = 1.0 + 1.0 + 1.0  # The support, the robot's root and its link.
    assert data.qfrc_gravcomp[lift] == pytest.approx(above_lift_kg * 9.81)
    np.testing.assert_allclose(data.qfrc_gravcomp, data.qfrc_bias, atol=1e-9)


def test_robot_with_a_free_joint_falls_and_does_not_float(one_joint_arm, panda):
    worldbody = """
      <body name="base" pos="0 0 2"><freejoint/><geom size="0.1" mass="2"/>
        <body name="link1"><joint name="joint1" axis="0 1 0" range="-2 2"/>
          <geom size="0.05" pos="0.3 0 0" mass="1"/><body name="right_hand"/></body></body>"""
    model = World([one_joint_arm(worldbody=worldbody)]).compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    mujoco.mj_kinematics(model, data)
    time_s = 100 * model.opt.timestep
    height = (2.0 * data.body('robot0_base').xipos[2] + data.body('robot0_link1').xipos[2]) / 3.0
    assert height == pytest.approx(2.0 - 9.81 * time_s**2 / 2.0, abs=0.01)
    # Another robot in the same world has its compensation.
    other = World([one_joint_arm(worldbody=worldbody, idn=1), panda]).compile()
    assert other.body_gravcomp[other.body('robot0_link3').id] == 1.0
    assert other.body_gravcomp[other.body('robot1_link1').id] == 0.0


@pytest.mark.full
@pytest.mark.parametrize('name', [*ROBOTS, 'TwoPandas'])
def test_the_robot_is_the_first_body_and_its_addresses_are_those_of_any_arena(name):
    pandas = [compose_robot('Panda', idn=idn) for idn in (0, 1)]
    robots = pandas if name == 'TwoPandas' else [compose_robot(name)]
    places = []
    for arena in (EmptyArena(), TableArena(cube=True), create_arena('bins')):
        world = World(robots, arena)
        (worldbody,) = ElementTree.fromstring(world.to_xml()).iter('worldbody')
        assert worldbody.find('body').get('name') == robots[0].root_body
        model = world.compile()
        assert model.body(1).name == robots[0].root_body
        joints = [model.joint(name) for name in world.init_qpos()]
        places.append([(joint.name, int(joint.qposadr[0]), int(joint.dofadr[0]))
                       for joint in joints])
        assert len(places[-1]) == len({address for _, address, _ in places[-1]})
    assert places[0] == places[1] == places[2]


def test_options_and_visual_settings_are_those_of_the_arena(panda):
    arena = TableArena()
    arena.spec.option.gravity = [0.0, 0.0, -3.0]
    arena.spec.stat.extent = 7.0
    arena.spec.visual.map.znear = 0.25
    arena.spec.memory = 50_000_000
    arena.spec.add_numeric(name='answer', data=[42.0])
    model = World([panda], arena).compile()
    assert model.opt.gravity[2] == -3.0
    assert (model.stat.extent, model.vis.map.znear) == (7.0, 0.25)
    assert (model.narena, model.numeric('answer').data[0]) == (50_000_000, 42.0)
    assert model.vis.global_.offwidth == 1920


def test_defaults_of_an_arena_stay_its_own_and_are_written(panda, mjcf, hall):
    path = mjcf('<geom name="ground" type="plane" size="1 1 0.1"/>'
                '<body name="post" childclass="arena"><geom name="post" size="0.1"/></body>',
                '<default><geom friction="0.3 0.1 0.1"/><default class="arena">'
                '<geom friction="0.2 0.1 0.1"/></default></default>')
    world = World([panda], hall(path))
    for model in (world.compile(), mujoco.MjModel.from_xml_string(world.to_xml())):
        assert model.geom('ground').friction[0] == 0.3
        assert model.geom('post').friction[0] == 0.2
        assert model.geom('robot0_link1_collision').friction[0] == 1.0


def test_composing_warns_of_nothing(one_joint_arm, caplog):
    robot = one_joint_arm(sections="""
        <option integrator="RK4" impratio="3"/><size memory="20M" nuserdata="3" nuser_geom="2"/>
        <visual><map znear="0.3"/></visual><statistic extent="9"/>""")
    model = World([robot]).compile()
    assert caplog.records == []
    assert (model.narena, model.nuserdata) == (20 * 2**20, 3)
    assert model.opt.impratio == 300.0


def test_a_part_keeps_its_own_options_against_slip(one_joint_arm, panda):
    own = '<option noslip_iterations="{}" noslip_tolerance="{}"/>'
    weak, strong = (one_joint_arm(sections=own.format(*values), idn=number)
                    for number, values in ((1, (2, 1e-3)), (2, (30, 1e-5))))
    for robots, wanted in (([panda], (50, 1e-10)), ([panda, weak], (2, 1e-3)),
                           ([weak, strong], (30, 1e-5))):
        option = World(robots).compile().opt
        assert (option.noslip_iterations, option.noslip_tolerance) == wanted


def test_friction_holds_what_can_slide_in_one_direction_only(panda, mjcf, hall):
    """There, MuJoCo's iterations against slip do nothing."""
    path = mjcf('<geom name="ground" type="plane" size="1 1 0.1"/>'
                '<body name="block" pos="0 0 0.1"><joint name="x" type="slide" axis="1 0 0"/>'
                '<joint type="slide" axis="0 0 1"/>'
                '<geom type="sphere" size="0.1" mass="2"/></body>')
    model = World([panda], hall(path)).compile()
    data = mujoco.MjData(model)
    data.body('block').xfrc_applied[:3] = 350.0, 0.0, -500.0  # Friction has a coefficient of 1.
    mujoco.mj_step(model, data, 500)
    assert 0.0 < data.joint('x').qvel[0] < 1e-3


@pytest.mark.parametrize(('own', 'tolerance'), [
    ('', 1e-12), ('<option timestep="0.001"/>', 1e-12), ('<option ccd_tolerance="1e-4"/>', 1e-4),
    ('<option ccd_tolerance="1e-6"/>', 1e-12), ('<include file="options.xml"/>', 1e-5)])
def test_convex_shapes_collide_exactly_unless_a_file_has_its_own_tolerance(
        one_joint_arm, panda, tmp_path, own, tolerance):
    (tmp_path / 'options.xml').write_text(
        '<mujoco><option ccd_iterations="60" ccd_tolerance="1e-5"/></mujoco>')
    world = World([panda, one_joint_arm(sections=own, idn=1)], TableArena(cube=True))
    assert world.compile().opt.ccd_tolerance == tolerance
    assert mujoco.MjModel.from_xml_string(world.to_xml()).opt.ccd_tolerance == tolerance


def test_the_least_tolerance_of_several_files_applies(tmp_path):
    file = '<mujoco><option ccd_tolerance="{}"/><worldbody><body name="it"><geom size="0.1"/>' \
        '</body></worldbody></mujoco>'
    for name, tolerance in (('arena', 1e-3), ('object', 1e-8)):
        (tmp_path / f'{name}.xml').write_text(file.format(tolerance))
    world = compose(arena=tmp_path / 'arena.xml',
                    objects=[{'name': 'thing', 'file': str(tmp_path / 'object.xml')}])
    assert world.compile().opt.ccd_tolerance == 1e-8
    assert world.with_objects([]).compile().opt.ccd_tolerance == 1e-3


def test_contacts_of_long_timesteps_last_at_least_four_of_them(one_joint_arm, tmp_path):
    robot = one_joint_arm(worldbody="""
        <body name="base"><geom size="0.05" mass="1"/><body name="link1"><joint name="joint1"/>
          <body name="right_hand"/>
          <geom name="stiff" size="0.1" mass="1" solref="0.005 1"/>
          <geom name="soft" size="0.1" mass="1" solref="0.05 1"/>
          <geom name="direct" size="0.1" mass="1" solref="-9000 -60"/></body></body>""",
                          sections="""<contact>
          <pair geom1="stiff" geom2="soft" solref="0.004 1"/></contact>""")
    (tmp_path / 'it.xml').write_text('<mujoco><worldbody><body name="it"><geom name="shape" '
                                     'size="0.1" solref="0.01 1"/></body></worldbody></mujoco>')
    item = create_object({'name': 'it', 'file': str(tmp_path / 'it.xml')})
    for timestep_s, stiff, pair, shape in ((0.001, 0.005, 0.004, 0.01),
                                           (0.002, 0.005, 0.004, 0.01), (0.005, 0.02, 0.02, 0.02)):
        world = World([robot], timestep_s=timestep_s)
        with_object = plan_with(plan_world(world.compose(), ()), item).compiled
        for model in (world.compile(), mujoco.MjModel.from_xml_string(world.to_xml()),
                      with_object):
            found = [model.geom(f'robot0_{name}').solref[0] for name in (
                'stiff', 'soft', 'direct')]
            assert found == pytest.approx([stiff, 0.05, -9000.0])
            assert model.pair_solref[0, 0] == pytest.approx(pair)
        assert with_object.geom('it').solref[0] == pytest.approx(shape)


def test_couplings_of_long_timesteps_are_stiff_in_one_step_or_damped_in_two(one_joint_arm):
    robot = one_joint_arm(worldbody="""
        <body name="base"><geom size="0.05" mass="1"/><body name="link1"><joint name="joint1"/>
          <geom size="0.1" mass="1"/>
          <body pos="0.3 0 0"><joint name="a"/><geom size="0.1" mass="1"/>
            <body name="right_hand" pos="0.3 0 0"><joint name="b"/><geom size="0.1" mass="1"/>
            </body></body></body></body>""",
                          sections="""<equality>
          <joint joint1="a" joint2="joint1" solref="0.001 1"/>
          <joint joint1="b" joint2="a" solref="0.005 1"/>
          <joint joint1="b" joint2="joint1" solref="0.02 1"/>
          <joint joint1="a" solref="-9000 -60"/></equality>""")
    for timestep_s, first, second in ((0.001, (0.001, 1.0), (0.005, 1.0)),
                                      (0.002, (-2.5e5, -500.0), (0.005, 1.0)),
                                      (0.005, (-4e4, -200.0), (0.005, 1.5))):
        found = World([robot], timestep_s=timestep_s).compile().eq_solref
        assert found == pytest.approx(np.array([first, second, (0.02, 1.0), (-9000.0, -60.0)]))


def test_composing_compiles_no_part_again(panda, monkeypatch):
    world, compiled = World([panda]), []
    compile_alone = MujocoXMLModel._compile_alone
    monkeypatch.setattr(MujocoXMLModel, '_compile_alone',
                        lambda part: (compiled.append(part.name), compile_alone(part))[1])
    for _ in range(2):
        world.compose()
    assert compiled == []
    panda.spec.body('link1').gravcomp = 0.5
    world.compose()
    assert panda.name in compiled


def test_physics_is_set_for_grasping(panda):
    option = World([panda], timestep_s=0.001).compile().opt
    assert option.timestep == 0.001
    assert int(option.integrator) == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    assert int(option.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC)


def test_world_in_xml_is_the_same_model(panda):
    world = World([panda], TableArena(cube=True))
    from_xml, ours = mujoco.MjModel.from_xml_string(world.to_xml()), world.compile()
    assert from_xml.names.split(b'\0', 1)[1] == ours.names.split(b'\0', 1)[1]
    # MuJoCo writes six digits.
    for field in ('body_mass', 'body_pos', 'body_gravcomp', 'jnt_range', 'actuator_biasprm'):
        np.testing.assert_allclose(getattr(from_xml, field), getattr(ours, field), rtol=1e-5,
                                   atol=1e-9)


def test_start_that_does_not_fit_the_joints_is_rejected(one_joint_arm, arm_class):
    arm_class.init_qpos = np.zeros(3)
    with pytest.raises(ModelError, match=r'^init_qpos of Arm0 must have 1 number, got 3$'):
        World([one_joint_arm()]).init_qpos()


def test_start_of_a_gripper_without_one_is_left_out(one_joint_arm, gripper_class, gripper_file):
    gripper_class.init_qpos = None
    robot = one_joint_arm()
    robot.add_gripper(gripper_class(gripper_file))
    assert World([robot]).init_qpos() == {'robot0_joint1': 0.0}


def test_names_of_an_arena_have_no_prefix():
    arena = TableArena()
    assert arena.naming_prefix == ''
    assert 'table' in arena.bodies


def test_shapes_that_cannot_collide_change_no_state(panda):
    world = World([panda], TableArena(cube=True))
    states = []
    for visual in (True, False):
        model = world.compile(visual)
        data = mujoco.MjData(model)
        for joint, position in world.init_qpos().items():
            data.joint(joint).qpos[0] = position
        mujoco.mj_step(model, data, 200)
        states.append((model.ngeom, model.body_mass.sum(), data.qpos.tobytes()))
    assert states[0][1:] == states[1][1:]
    assert states[0][0] > 2 * states[1][0]


@pytest.mark.parametrize('timestep_s, nearest', [
    (1 / 600, '0.001666667'), (0.0012345678912, '0.001234568')])
def test_a_timestep_that_stamps_cannot_count_is_rejected(timestep_s, nearest):
    with pytest.raises(ModelError, match=f'whole number of nanoseconds.* nearest is {nearest}'):
        World([Panda()], timestep_s=timestep_s)
    assert World([Panda()], timestep_s=float(nearest)).timestep_s == float(nearest)


@pytest.mark.parametrize('timestep_s', [0.0, -0.002, math.nan, math.inf])
def test_a_timestep_that_is_no_time_is_rejected(timestep_s):
    with pytest.raises(ModelError, match='positive and finite'):
        World([Panda()], timestep_s=timestep_s)


@pytest.mark.parametrize(
    'nanoseconds', [100_000, 300_000, 333_333, 1_000_001, 1_666_667, 9_999_999])
def test_any_whole_number_of_nanoseconds_is_a_timestep(nanoseconds):
    assert World([Panda()], timestep_s=nanoseconds / 1e9).timestep_s == nanoseconds / 1e9
    assert World([Panda()], timestep_s=nanoseconds * 1e-9).timestep_s == nanoseconds * 1e-9
