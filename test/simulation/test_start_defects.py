# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The start of a robot is looked at: contacts, ranges, and what its actuators can do."""

import re

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.models.arenas import arena_names
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import create_robot, robot_names
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.start_defect import _full_force, find_start_defects

BALL = '<geom name="{}" size="0.05" pos="{} 0 0"/>'


def told(simulation):
    """Return what is wrong with the start of a simulation's robot."""
    return [defect.text for defect in find_start_defects(
        simulation.model, simulation.data, [simulation.robot.robot_model.root_body])]


def defects_of(worldbody, sections='', gravity=0.0):
    """Return what is wrong with the start of a model whose robot is its body ``root``."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 {-gravity}"/><worldbody>{worldbody}</worldbody>{sections}'
        '</mujoco>')
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return find_start_defects(model, data, ['root'])


def told_of(worldbody, sections=''):
    """Return what is wrong with where a robot starts, not with its actuators."""
    return [defect.text for defect in defects_of(worldbody, sections)
            if defect.kind in ('overlap', 'blocked', 'range')]


def arm(inner, outer='', joint='', extra=''):
    """Return two links; the second one has a joint."""
    return f"""<body name="root"><joint name="root"/>{BALL.format('root', 0)}
        <body name="middle" pos="0.2 0 0"><joint name="middle" type="slide" axis="1 0 0"/>
        {BALL.format('middle', 0)}<body name="tip" pos="0.2 0 0">
        <joint name="tip" type="slide" axis="1 0 0" range="-1 1" {joint}/>{inner}</body></body>
        {outer}</body>{extra}"""


ACTUATORS = '<actuator><position joint="tip" kp="100" forcerange="-50 50"/></actuator>'


@pytest.mark.parametrize('arena', arena_names())
@pytest.mark.parametrize('name', robot_names())
def test_nothing_is_wrong_with_the_start_of_the_robots_of_the_catalogue(name, arena):
    assert told(Simulation(compose(name, arena=arena))) == []


def test_a_hand_that_starts_inside_the_flange_is_told_with_names_and_depth():
    robot = create_robot('Panda')
    robot.add_gripper(create_gripper('FourierRightHand'))
    sentences = told(Simulation(World([robot])))
    assert sentences[0] == (
        "geom 'gripper0_R_middle_proximal_link_col' of body 'gripper0_R_middle_proximal_link' "
        "starts 47.4 mm inside geom 'robot0_link6_flange_collision' of body 'robot0_link6'")
    assert ("joint 'gripper0_R_middle_proximal_joint' starts blocked by geom "
            "'robot0_link6_flange_collision' of body 'robot0_link6'") in sentences


@pytest.mark.parametrize('depth_mm', [1.0, 20.0])
def test_depth_is_that_of_the_deepest_contact_of_two_bodies(depth_mm):
    # The tip's second ball reaches back to the root's, which is two bodies away.
    ball = BALL.format('far', -0.4 + 0.1 - depth_mm * 1e-3) + BALL.format('near', -0.301)
    assert told_of(arm(ball))[0] == (f"geom 'far' of body 'tip' starts {depth_mm:.1f} mm inside "
                                     "geom 'root' of body 'root'")
    assert len(told_of(arm(ball))) == 1


def test_what_only_touches_is_not_told():
    assert told_of(arm(BALL.format('far', -0.3 - 0.0002))) == []


def test_what_starts_inside_something_that_is_no_robot_is_told():
    wall = '<body name="wall" pos="0.45 0 0"><geom name="wall" type="box" size=".04 1 1"/></body>'
    assert told_of(arm(BALL.format('tip', 0), extra=wall)) == [
        "geom 'tip' of body 'tip' starts 40.0 mm inside geom 'wall' of body 'wall'"]


def test_what_is_no_robot_may_be_inside_each_other():
    balls = ''.join(f'<body pos="{x} 5 0"><freejoint/><geom size="0.1"/></body>' for x in (0, 0.1))
    assert told_of(arm(BALL.format('tip', 0), extra=balls)) == []


def block(x):
    return f'<geom name="block{x}" type="box" size="0.05 0.1 0.1" pos="{x} 0 0"/>'


def test_joint_between_two_neighbours_is_told_as_blocked():
    # The tip stands between two stops of the root and touches both.
    stops = block(0.3001) + block(0.4999)
    worldbody = arm(BALL.format('tip', 0), outer=f'<body name="stops">{stops}</body>')
    sentence, = told_of(worldbody, ACTUATORS)
    assert sentence.startswith("joint 'tip' starts blocked by geom 'block0.")
    assert sentence.endswith("of body 'stops'")


def test_joint_that_can_leave_its_neighbour_is_not_told():
    worldbody = arm(BALL.format('tip', 0), outer=f'<body name="stops">{block(0.3001)}</body>')
    assert told_of(worldbody, ACTUATORS) == []


@pytest.mark.parametrize('mass', [0.02, 0.2, 2.0, 20.0])
@pytest.mark.parametrize(('push', 'blocked'), [(30.0, False), (300.0, True)])
def test_joint_without_a_force_limit_is_tried_with_an_acceleration_whatever_its_mass(
        mass, push, blocked):
    # A stop inside the tip pushes it away: MuJoCo's reference acceleration k * depth, where k is
    # 1 / (dmax * timeconst * dampratio)^2. While the trial, of 100 m/s^2, cannot overcome it, the
    # joint feels the stop in both directions.
    depth = push * (0.95 * 0.005)**2
    worldbody = f"""<body name="root"><geom name="root" type="box" size="0.05 0.1 0.1"
          solref="0.005 1"/>
        <body name="tip" pos="{0.1 - depth} 0 0"><joint name="tip" type="slide" axis="1 0 0"/>
          <geom name="tip" size="0.05" mass="{mass}" solref="0.005 1"/></body></body>"""
    kinds = [defect.kind for defect in defects_of(
        worldbody, '<actuator><motor joint="tip"/></actuator>')]
    assert ('blocked' in kinds) is blocked


@pytest.mark.parametrize(('ties', 'held'), [
    ('<joint joint1="tip"/>', ["'tip'"]), ('<joint joint1="tip" active="false"/>', []),
    ('<joint joint1="tip" joint2="middle"/><joint joint1="root"/>', [])])
def test_what_an_equality_constraint_holds_and_an_actuator_drives_is_told(ties, held):
    sentences = told_of(arm(BALL.format('tip', 0)), f'{ACTUATORS}<equality>{ties}</equality>')
    assert sentences == ['equality constraints hold in place what actuators drive: joints '
                         f'{name}' for name in held]


def test_joint_without_an_actuator_is_not_told_as_blocked():
    stops = block(0.3001) + block(0.4999)
    assert told_of(arm(BALL.format('tip', 0), outer=f'<body name="stops">{stops}</body>')) == []


@pytest.mark.parametrize(('kind', 'unit'), [('slide', 'm'), ('hinge', 'rad')])
def test_joint_outside_its_range_is_told(kind, unit):
    worldbody = f"""<body name="root">{BALL.format('root', 0)}<body name="link" pos="1 0 0">
        <joint name="j" type="{kind}" range="-0.5 0.5"/>{BALL.format('link', 0)}</body></body>"""
    compiler = '<compiler angle="radian"/>'
    assert told_of(worldbody, f'{compiler}<keyframe><key qpos="0.75"/></keyframe>') == [
        f"joint 'j' starts at 0.75 {unit}, 0.25 outside its range of -0.5 to 0.5"]
    assert told_of(worldbody, f'{compiler}<keyframe><key qpos="0.5"/></keyframe>') == []


def test_each_joint_outside_its_range_is_told_whatever_those_before_it_do():
    starts = {'endless': 9.0, 'low': -1.5, 'lowest': -1.0019, 'within': 0.5, 'highest': 1.0019,
              'high': 1.0021}
    links = ''.join(
        f'<body pos="{3 * index} 5 0"><joint name="{name}" type="slide" axis="0 0 1" '
        f'limited="{str(name != "endless").lower()}" range="-1 1"/>{BALL.format(name, 0)}</body>'
        for index, name in enumerate(starts))
    door = (f'<body pos="0 9 0"><joint name="door" type="slide" range="-1 1"/>'
            f'{BALL.format("door", 0)}</body>')
    qpos = ' '.join(map(str, [7.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *starts.values()]))
    sentences = told_of(
        f'{door}<body name="root"><freejoint/>{BALL.format("root", 0)}{links}</body>',
        f'<keyframe><key qpos="{qpos}"/></keyframe>')
    assert [sentence.split("'")[1] for sentence in sentences] == ['low', 'high']


def test_check_changes_neither_the_model_nor_the_state():
    robot = create_robot('Panda')
    robot.add_gripper(create_gripper('FourierRightHand'))
    simulation = Simulation(World([robot]))
    flags, force = simulation.model.opt.disableflags, simulation.data.qfrc_applied.copy()
    before = simulation.robot.state().position.copy()
    assert told(simulation) == told(simulation)
    assert simulation.model.opt.disableflags == flags
    assert (simulation.data.qfrc_applied == force).all()
    assert (simulation.robot.state().position == before).all()


def test_every_defect_comes_with_what_mends_it():
    wall = '<body name="wall" pos="0.45 0 0"><geom name="wall" type="box" size=".04 1 1"/></body>'
    ball = BALL.format('far', -0.35) + BALL.format('tip', 0)
    own, other, _ = defects_of(arm(ball, extra=wall))
    assert 'start in another pose' in own.remedy and 'exclude' not in own.remedy
    assert "move 'wall'" in other.remedy and 'exclude' not in other.remedy


def test_excluding_neighbours_as_told_mends_an_overlap():
    # The base does not move, so MuJoCo lets it collide with the first link.
    neighbours = f"""<body name="root">{BALL.format('root', 0)}<body name="link" pos="0.05 0 0">
        <joint name="a" axis="0 1 0"/>{BALL.format('link', 0)}</body></body>"""
    exclude = defects_of(neighbours)[0].remedy.split('write ')[1].split(' into')[0]
    assert exclude == '<exclude body1="root" body2="link"/>'
    kinds = [d.kind for d in defects_of(neighbours, f'<contact>{exclude}</contact>')]
    assert kinds == ['undriven']


# ---------------------------------------------------------------------- joints without actuator


def chain(*joints, inside=''):
    """Return links one after another, each on its joint; the attributes of a joint may follow."""
    opened = ''.join(f'<body pos="0.3 0 0"><joint axis="0 1 0" name={joint}/>'
                     '<geom size="0.01" mass="1" contype="0"/>' for joint in joints)
    return (f'<body name="root"><geom size="0.01" mass="1"/>{opened}{inside}'
            f'{"</body>" * len(joints)}</body>')


def undriven(worldbody, sections=''):
    """Return the sentences on joints that nothing holds."""
    return [d.text for d in defects_of(worldbody, sections) if d.kind == 'undriven']


MOTOR_OF_A = '<actuator><motor joint="a"/></actuator>'


def test_joints_without_actuator_are_told_in_one_sentence():
    assert undriven(chain('"a"', '"b"', '"c"'), MOTOR_OF_A) == [
        "joints 'b', 'c' have no actuator, and no spring or coupling to a joint that has one: "
        'nothing holds them']
    assert undriven(chain('"a"', '"b"'), MOTOR_OF_A) == [
        "joint 'b' has no actuator, and no spring or coupling to a joint that has one: nothing "
        'holds it']


def test_writing_what_is_told_mends_a_joint_without_actuator():
    defect, = defects_of(chain('"a"'))
    motor = defect.remedy.split('write ')[1].split(' into')[0].replace('LIMIT', '50')
    assert defects_of(chain('"a"'), f'<actuator>{motor}</actuator>') == []


def test_what_mends_one_joint_without_actuator_is_told_to_be_for_each_of_several():
    one, several = (defects_of(chain(*joints))[0].remedy for joints in (('"a"',), ('"a"', '"b"')))
    assert ', and so for each of them' not in one
    assert ', and so for each of them' in several


TENDON = '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed>'
SPRING = TENDON.replace('<fixed ', '<fixed stiffness="1" ')
SPATIAL = """<tendon><spatial name="s"><site site="at_root"/><site site="at_tip"/></spatial>
    </tendon><actuator><position tendon="s"/></actuator>"""


@pytest.mark.parametrize(('joint', 'sections'), [
    ('"b"', f'<equality><joint joint1="b" joint2="a"/></equality>{MOTOR_OF_A}'),
    ('"b"', f'<equality><joint joint1="a" joint2="b"/></equality>{MOTOR_OF_A}'),
    ('"b"', f'<equality><joint joint1="b"/></equality>{MOTOR_OF_A}'),
    ('"b"', f'{TENDON}</tendon><actuator><motor tendon="t"/></actuator>'),
    ('"b"', f'{TENDON}</tendon><equality><tendon tendon1="t"/></equality>{MOTOR_OF_A}'),
    ('"b"', f'{SPRING}</tendon>{MOTOR_OF_A}'),
    ('"b" stiffness="5"', MOTOR_OF_A), ('"b"', SPATIAL),
    ('"b"', '<actuator><motor site="at_tip" refsite="at_root"/></actuator>'),
    ('"b"', '<equality><weld body1="tip"/></equality>'),
    ('"b"', f'<equality><connect site1="at_tip" site2="at_root"/></equality>{MOTOR_OF_A}')])
def test_a_joint_that_something_else_holds_is_not_told(joint, sections):
    site = '<body name="tip" pos="0.3 0 0"><site name="at_tip"/></body>'
    worldbody = chain('"a"', joint, inside=site).replace(
        '<geom', '<site name="at_root"/><geom', 1)
    assert undriven(worldbody, sections) == []


@pytest.mark.parametrize('sections', [
    f'{MOTOR_OF_A}<equality><joint joint1="b" joint2="a" active="false"/></equality>',
    f'{MOTOR_OF_A}{TENDON}</tendon>',
    f'{MOTOR_OF_A}<equality><joint joint1="b" joint2="c"/></equality>',
    '<actuator><motor joint="a"/><adhesion body="tip" ctrlrange="0 1"/></actuator>'])
def test_a_coupling_that_does_not_hold_a_joint_is_no_excuse(sections):
    tip = '<body name="tip" pos="0.3 0 0"><geom size="0.01"/></body>'
    sentence, = undriven(chain('"a"', '"b"', '"c"', inside=tip), sections)
    assert sentence.startswith("joints 'b', 'c' have no actuator")


def test_the_free_joint_of_a_walking_robot_needs_no_actuator():
    assert undriven('<body name="root"><freejoint/><geom size="0.1"/></body>') == []


# ---------------------------------------------------------------------- two actuators


def test_two_actuators_on_one_joint_are_told():
    two = '<position name="p" joint="a" kp="9"/><velocity name="v" joint="a"/>'
    defect, = defects_of(chain('"a"'), f'<actuator>{two}</actuator>')
    assert defect.text == "joint 'a' is driven by 2 actuators, 'p', 'v'"
    assert "delete 'v'" in defect.remedy


def test_a_tendon_beside_an_actuator_of_the_joint_is_no_second_actuator():
    both = '<actuator><motor joint="a"/><motor joint="b"/><motor tendon="t"/></actuator>'
    assert defects_of(chain('"a"', '"b"'), f'{TENDON}</tendon>{both}') == []


# ---------------------------------------------------------------------- effort at the start


def efforts(worldbody, sections):
    """Return the defects of effort under a gravity of 10 m/s^2."""
    return [d for d in defects_of(worldbody, sections, 10.0) if d.kind == 'effort']


def hanging(actuator, joint=''):
    """Return a ball of 2 kg that is held out by 0.4 m, which takes 8 N m, and its actuator."""
    body = (f'<body name="root"><body><joint name="a" axis="0 1 0" {joint}/>'
            '<geom pos="0.4 0 0" size="0.01" mass="2"/></body></body>')
    return body, f'<actuator>{actuator}</actuator>'


@pytest.mark.parametrize(('actuator', 'joint', 'limit'), [
    ('<motor name="m" joint="a" ctrlrange="-{0} {0}" ctrllimited="true"/>', '', 7.9),
    ('<motor name="m" joint="a" gear="2" ctrlrange="-{0} {0}" ctrllimited="true"/>', '', 3.95),
    ('<position name="m" joint="a" kp="100" forcerange="-{0} {0}"/>', '', 7.9),
    ('<position name="m" joint="a" kp="100"/>', 'actuatorfrcrange="-{0} {0}"', 7.9)])
def test_an_actuator_that_cannot_carry_the_weight_at_the_start_is_told(actuator, joint, limit):
    defect, = efforts(*hanging(actuator.format(limit), joint.format(limit)))
    assert defect.text == ("joint 'a' needs -8 N m to keep its start pose, its actuator 'm' has "
                           '-7.9 N m')
    enough = limit * 8.1 / 7.9
    assert efforts(*hanging(actuator.format(enough), joint.format(enough))) == []


def test_what_is_told_to_write_for_a_weak_actuator_lets_the_joint_hold():
    defect, = efforts(*hanging('<position name="m" joint="a" kp="100"/>',
                               'actuatorfrcrange="-5 5"'))
    advice = defect.remedy.split('such as ')[1].split(' on the joint')[0]
    assert advice == 'actuatorfrcrange="-8.8 8.8"'
    body, sections = hanging('<position joint="a" kp="1e4" kv="100"/>', advice)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{body}</worldbody>{sections}</mujoco>')
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    assert abs(data.qpos[0]) < 0.01


def test_a_slide_is_told_in_newtons_and_gravity_compensation_counts_against_its_limit():
    slide = """<body name="root"><body gravcomp="1"><joint name="z" type="slide" axis="0 0 1"
        actuatorgravcomp="true" {}/><geom size="0.01" mass="2"/></body></body>"""
    motor = '<actuator><motor name="m" joint="z" ctrlrange="-5 5"/></actuator>'
    assert efforts(slide.format(''), motor) == []
    defect, = efforts(slide.format('actuatorfrcrange="-19 19"'), motor)
    assert "joint 'z' needs 20 N to keep" in defect.text


def test_an_equal_actuator_that_is_turned_round_by_its_gear_is_as_strong():
    motor = '<motor joint="a" gear="-1" ctrllimited="true" ctrlrange="{}"/>'
    assert efforts(*hanging(motor.format('0 9'))) == []
    assert len(efforts(*hanging(motor.format('-9 0')))) == 1


def test_the_same_limit_serves_a_pose_that_needs_less():
    weak = hanging('<motor joint="a" ctrllimited="true" ctrlrange="-5 5"/>')
    upright = f'{weak[1]}<keyframe><key qpos="1.5707963"/></keyframe>'
    assert len(efforts(*weak)) == 1 and efforts(weak[0], upright) == []


def test_a_servo_whose_control_is_far_from_the_start_is_told():
    servo = hanging('<position name="m" joint="a" kp="1000" forcerange="-50 50"/>')
    key = '<keyframe><key qpos="1.2" {}/></keyframe>'
    defect, = efforts(servo[0], servo[1] + key.format(''))
    assert defect.text == ("actuator 'm' starts with its full force of -50 N m: its control is 0, "
                           'at 1.2 it would exert none')
    assert 'write 1.2 for it into ctrl of the keyframe' in defect.remedy
    assert efforts(servo[0], servo[1] + key.format('ctrl="1.2"')) == []


def test_the_control_that_is_told_holds_a_servo_whose_control_is_no_position():
    general = ('<general name="m" joint="a" gainprm="10" biastype="affine" biasprm="100 -1000 0" '
               'ctrlrange="-100 {}" forcerange="-50 50"/>')
    servo, key = hanging(general.format(255)), '<keyframe><key qpos="1.2" {}/></keyframe>'
    defect, = efforts(servo[0], servo[1] + key.format(''))
    # 10 u + 100 - 1000 * 1.2 = 0
    assert 'write 110 for it into ctrl of the keyframe' in defect.remedy
    assert efforts(servo[0], servo[1] + key.format('ctrl="110"')) == []
    # Out of its range; and a velocity, where the servo integrates.
    integrating = ('<intvelocity name="m" joint="a" kp="1000" ctrlrange="-1 1" actrange="-2 2" '
                   'forcerange="-50 50"/>')
    for actuator in (general.format(100), integrating):
        servo = hanging(actuator)
        defect, = efforts(servo[0], servo[1] + key.format(''))
        assert defect.text.endswith('its control is 0')
        assert defect.remedy == 'start the joint where the control holds it'


def test_each_servo_that_pushes_is_told_whatever_those_before_it_do():
    servos = ''.join(f'<position name="{name}" joint="{name}" kp="1000" forcerange="-50 50"/>'
                     for name in ('door', *'abcd'))
    door = '<body pos="0 5 0"><joint name="door"/><geom size="0.1"/></body>'
    sections = f'<actuator>{servos}</actuator><keyframe><key qpos="1 0 1 0.01 1"/></keyframe>'
    defects = defects_of(door + chain('"a"', '"b"', '"c"', '"d"'), sections)
    # The door is no robot; a and c need less than their full force.
    assert [defect.text.split(' starts')[0] for defect in defects if defect.kind == 'effort'] == [
        "actuator 'b'", "actuator 'd'"]


def test_two_actuators_of_one_joint_are_told_and_neither_is_called_too_weak():
    one, other = (f'<motor name="{name}" joint="a" ctrllimited="true" ctrlrange="-5 5"/>'
                  for name in 'mn')
    defect, = defects_of(*hanging(one + other), gravity=10.0)
    assert defect.kind == 'actuators'
    assert "driven by 2 actuators, 'm', 'n'" in defect.text


def test_the_full_force_of_a_joint_is_that_of_its_own_actuators():
    model = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/>
  <body><joint name="b"/><geom size="0.1"/></body></body></worldbody>
  <actuator><position joint="a" gear="2" forcerange="-3 5"/><motor joint="a"/>
    <position joint="b" forcerange="-40 30"/></actuator></mujoco>""")
    assert [_full_force(model, joint) for joint in (0, 1)] == [10.0, 40.0]


def test_an_actuator_that_is_too_weak_is_told_once_though_its_servo_pushes_too():
    servo = hanging('<position joint="a" kp="1000" forcerange="-5 5"/>')
    defect, = efforts(servo[0], servo[1] + '<keyframe><key qpos="0.1"/></keyframe>')
    assert 'needs' in defect.text


def test_a_servo_that_only_pulls_and_rests_is_not_at_its_full_force():
    pulling = '<position joint="a" kp="1000" forcerange="-50 0"/>'
    assert efforts(*hanging(pulling)) == []


def test_a_spring_that_carries_the_weight_leaves_nothing_to_the_actuator():
    weak = '<motor joint="a" ctrllimited="true" ctrlrange="-1 1"/>'
    spring = 'stiffness="{}" springref="-90"'.format
    assert efforts(*hanging(weak, spring(8.0 / (np.pi / 2.0)))) == []
    assert len(efforts(*hanging(weak, spring(1.0)))) == 1


def test_a_robot_of_the_catalogue_with_a_weak_joint_is_told():
    world = compose('Panda', base='none', gravity_compensation=False)
    simulation = Simulation(world)
    shoulder = simulation.model.joint('robot0_joint2')
    needed = abs(simulation.data.qfrc_bias[shoulder.dofadr[0]])
    for share, told_count in ((0.99, 1), (1.01, 0)):
        simulation.model.jnt_actfrcrange[shoulder.id] = -share * needed, share * needed
        sentences = [text for text in told(simulation) if 'needs' in text]
        assert len(sentences) == told_count
        assert all("joint 'robot0_joint2' needs" in text for text in sentences)
    assert np.isfinite(needed) and needed > 5.0


@pytest.mark.parametrize(('gravcomp', 'carried_by', 'weak'), [
    (0.0, 'false', True), (1.0, 'false', False), (1.0, 'true', False)])
def test_weight_that_is_compensated_asks_nothing_of_a_weak_actuator(gravcomp, carried_by, weak):
    defects = defects_of(
        f'<body name="root" gravcomp="{gravcomp}"><joint name="lift" type="slide" axis="0 0 1" '
        f'range="-1 1" limited="true" actuatorgravcomp="{carried_by}"/>'
        '<geom size="0.05" mass="2"/></body>',
        '<actuator><motor joint="lift" ctrlrange="-1 1" ctrllimited="true" forcerange="-1 1" '
        'forcelimited="true"/></actuator>', gravity=9.81)
    assert [defect.text for defect in defects if 'lift' in defect.text] != [] if weak else (
        defects == [])


LIMB = ('<body name="root"><geom size="0.05"/><body name="link" pos="0 0 0.1">'
        '<joint name="turn" axis="0 1 0"/><inertial pos="0 0 0.05" mass="{mass}" '
        'diaginertia="{moment} {moment} {moment}"/><geom type="box" size="0.02 0.02 0.05" '
        'pos="0 0 0.05"/></body></body>')


def inertias(mass, moment):
    """Return the defects of a limb of 10 cm that concern its inertia."""
    worldbody = LIMB.format(mass=mass, moment=moment)
    return [defect for defect in defects_of(
        worldbody, '<actuator><motor joint="turn" ctrlrange="-9 9"/></actuator>')
        if defect.kind == 'inertia']


@pytest.mark.parametrize(('mass', 'moment'), [(0.08, 0.5), (1.0, 30.0), (1e-4, 0.02)])
def test_an_inertia_that_no_link_of_its_mass_and_size_can_have_is_told(mass, moment):
    (defect,) = inertias(mass, moment)
    assert f"body 'link' has a moment of inertia of {moment:.3g} kg m^2" in defect.text
    assert f'its mass of {mass:.3g} kg within 57 mm of its centre' in defect.text
    likely = float(re.search('diaginertia="([^ ]*) ', defect.remedy)[1])
    assert likely == pytest.approx(0.4 * mass * 0.0574**2, rel=0.05)
    assert inertias(mass, likely) == []


@pytest.mark.parametrize(('mass', 'moment'), [
    (0.08, 1e-4), (1.0, 0.05), (1.0, 1e-9), (1e-4, 5e-3)])
def test_an_inertia_that_is_a_rough_guess_is_not_told(mass, moment):
    assert inertias(mass, moment) == []


def test_absurd_inertias_are_told_in_one_sentence_that_begins_with_the_worst():
    link = LIMB.format(mass=0.1, moment=1.0)
    other = LIMB.format(mass=0.1, moment=9.0).replace('"link"', '"worse"').replace(
        '"turn"', '"turn2"').replace('<body name="root"><geom size="0.05"/>', '')
    worldbody = link[:-len('</body>')] + other
    (defect,) = [defect for defect in defects_of(worldbody) if defect.kind == 'inertia']
    assert defect.text.startswith("body 'worse' has a moment of inertia of 9 kg m^2")
    assert defect.text.endswith("; so have 'link'")


def test_a_link_without_shapes_has_no_size_to_compare_an_inertia_with():
    worldbody = re.sub('<geom type="box"[^>]*>', '', LIMB.format(mass=0.1, moment=1.0))
    assert [defect for defect in defects_of(worldbody) if defect.kind == 'inertia'] == []


def wedged_hand(depth, sideways):
    """Return a URDF hand: the outer link of a finger is wedged between two posts of the palm."""
    def link(name, *boxes):
        shapes = ''.join(
            f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry>'
            '</collision>' for size, xyz in boxes)
        return (f'<link name="{name}"><inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5"'
                f' izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>{shapes}</link>')

    def joint(name, parent, xyz, axis):
        return (f'<joint name="{name}_joint" type="revolute"><parent link="{parent}"/><child '
                f'link="{name}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/><limit lower="-0.6" '
                'upper="0.6" effort="5" velocity="2"/></joint>')
    away = 0.015 - depth
    posts = [('.02 .02 .06', f'{x} 0 .13') for x in (away, 1e-5 - away)]
    return ('<robot name="hand">' + link('palm', ('.08 .06 .04', '0 0 0'), *posts)
            + link('inner', ('.01 .02 .04', '0 0 .02')) + link('outer', ('.01 .02 .05', '0 0 .02'))
            + link('other', ('.01 .02 .08', '0 0 .04'))
            + joint('inner', 'palm', '0 0 .05', '0 1 0')
            + joint('outer', 'inner', '0 0 .05', '1 0 0' if sideways else '0 1 0')
            + joint('other', 'palm', '0 .05 .03', '1 0 0') + '</robot>')


@pytest.mark.parametrize(('depth', 'sideways'), [(4e-5, False), (8e-4, True)])
def test_a_hand_of_a_file_has_the_same_defects_alone_and_on_an_arm(depth, sideways, tmp_path):
    file = tmp_path / 'hand.urdf'
    file.write_text(wedged_hand(depth, sideways))
    alone, mounted = (
        [sentence.replace(prefix, '') for sentence in Simulation(world).start_defects]
        for prefix, world in (('robot0_', compose(str(file))),
                              ('gripper0_right_', compose('UR5e', gripper=str(file)))))
    assert alone == mounted
    assert any("'inner_joint' starts blocked" in sentence for sentence in alone)
