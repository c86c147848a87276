# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The start of a robot is looked at: what is inside something, blocked or out of its range."""

import mujoco
import pytest

from manip_sim.models import compose
from manip_sim.models.arenas import arena_names
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import create_robot, robot_names
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.start_check import check_start

BALL = '<geom name="{}" size="0.05" pos="{} 0 0"/>'


def told(simulation):
    """Return what is wrong with the start of a simulation's robot."""
    return check_start(simulation.model, simulation.data, [simulation.robot.robot_model.root_body])


def told_of(worldbody, sections=''):
    """Return what is wrong with the start of a model whose robot is its body ``root``."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0"/><worldbody>{worldbody}</worldbody>{sections}</mujoco>')
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return check_start(model, data, ['root'])


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
