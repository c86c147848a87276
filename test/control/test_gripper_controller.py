# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of grippers: one message closes, at a rate that does not depend on the messages."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from manip_sim.errors import CommandError
from manip_sim.models import compose, load_robot
from manip_sim.models.grippers import create_gripper
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

GRIPPER = 'right/gripper'
LEFT, RIGHT = 'gripper0_right_finger_joint1', 'gripper0_right_finger_joint2'


def setpoints(simulation):
    """Return the setpoints of the two fingers [m]."""
    ids = simulation.robot.parts[GRIPPER].actuator_ids
    return simulation.data.act[simulation.model.actuator_actadr[ids]].copy()


def periods_until(simulation, wanted, steps, message_every=None, action=1.0, speeds=None):
    """Count steps until the fingers have a setpoint; a message comes every n-th period."""
    start = simulation.step_count
    for period in range(1000):
        if np.allclose(setpoints(simulation), wanted, atol=1e-9):
            return simulation.step_count - start
        if period == 0 or (message_every and period % message_every == 0):
            simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [action]))
        simulation.advance(steps)
        if speeds is not None:
            speeds.append(np.abs(simulation.robot.state().velocity[-2:]).max())
    raise AssertionError(f'the fingers never had the setpoint {wanted}')


def open_fully(simulation, run):
    simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [-1.0]))
    run(simulation, 1.5)
    np.testing.assert_allclose(setpoints(simulation), [0.04, -0.04])


@pytest.mark.full
@pytest.mark.parametrize(('steps', 'message_every'), [
    (1, None), (1, 1), (5, 3), (5, None), (10, 1), (10, 3), (25, None), (25, 3)])
def test_full_stroke_takes_as_long_as_the_data_sheet_says_whatever_the_message_rate(
        panda_sim, run, steps, message_every):
    open_fully(panda_sim, run)
    # The data sheet: 50 mm/s for each finger, over 40 mm; then they have to settle.
    speeds = []
    elapsed = periods_until(panda_sim, [0.0, 0.0], steps, message_every, speeds=speeds) * 0.002
    assert 0.8 <= elapsed <= 0.9
    assert max(speeds) < 0.0505
    assert np.median(speeds) > 0.0495


@pytest.mark.full
@pytest.mark.parametrize('steps', [1, 4, 5, 25])
def test_format_action_is_called_twenty_times_a_second(panda_sim, run, steps):
    gripper, calls = panda_sim.robot.parts[GRIPPER].gripper, []

    def slowly_open(action):
        if action[0] == 1.0:
            calls.append(panda_sim.step_count)
        return [0.1 + 0.001 * len(calls), -0.1 - 0.001 * len(calls)]

    gripper.format_action = slowly_open
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    for _ in range(1000 // steps):
        panda_sim.advance(steps)
    assert len(calls) == 40
    np.testing.assert_allclose(np.diff(calls), 25, atol=3 if steps == 4 else 0)


def test_fingers_close_after_one_message(panda_sim, run):
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    run(panda_sim, 1.5)
    assert np.abs(panda_sim.robot.state().position[7:]).max() < 1e-3


def test_fingers_are_held_at_the_start_without_a_message(panda_sim, run, reference):
    run(panda_sim, 1.0)
    np.testing.assert_allclose(panda_sim.robot.state().position[7:],
                               reference['gripper']['init_qpos'], atol=1e-5)


def test_idle_action_does_not_move_the_fingers(panda_sim, run):
    before = panda_sim.robot.state().position
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [0.0]))
    run(panda_sim, 0.5)
    np.testing.assert_allclose(panda_sim.robot.state().position, before, atol=1e-5)


def test_idle_action_stops_the_fingers_halfway(panda_sim, run):
    open_fully(panda_sim, run)
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    run(panda_sim, 0.22)
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [0.0]))
    run(panda_sim, 1.0)
    # Five calls of 0.2 from +1.
    np.testing.assert_allclose(setpoints(panda_sim), [0.02, -0.02], atol=1e-9)


def test_reversing_goes_on_from_where_the_fingers_are(panda_sim, run):
    open_fully(panda_sim, run)
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    run(panda_sim, 0.4)
    finger = panda_sim.robot.state().position[-2]
    assert finger == pytest.approx(0.02, abs=0.002)
    # The goal of the action is farther: eight calls are 32 mm. Back it goes without delay.
    steps = periods_until(panda_sim, [0.04, -0.04], 5, action=-1.0)
    assert steps * 0.002 == pytest.approx((0.04 - finger) / 0.05, abs=0.1)


def test_action_goes_on_from_a_joint_command(panda_sim, run):
    robot = panda_sim.robot
    robot.apply(*robot.parse.joint_command([LEFT, RIGHT], [0.03, -0.03], [], []))
    run(panda_sim, 1.0)
    np.testing.assert_allclose(panda_sim.robot.state().position[7:], [0.03, -0.03], atol=1e-3)
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    panda_sim.advance(1)
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [0.0]))
    run(panda_sim, 0.5)
    # One call of 0.2 is a tenth of the stroke of 0.04 m.
    np.testing.assert_allclose(setpoints(panda_sim), [0.026, -0.026], atol=1e-9)


def test_joint_command_is_approached_no_faster_than_the_fingers_may_move(panda_sim, run):
    open_fully(panda_sim, run)
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command([LEFT, RIGHT], [0.0, 0.0], [], []))
    speeds = []
    for _ in range(100):
        panda_sim.advance(5)
        speeds.append(np.abs(panda_sim.robot.state().velocity[-2:]).max())
    assert 0.045 < max(speeds) < 0.055
    run(panda_sim, 0.5)
    np.testing.assert_allclose(setpoints(panda_sim), [0.0, 0.0], atol=1e-12)


def test_fingers_that_are_pushed_ahead_do_not_take_their_setpoints_along(panda_sim, run):
    open_fully(panda_sim, run)
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    run(panda_sim, 0.2)
    before = setpoints(panda_sim)
    address = panda_sim.model.joint(LEFT).qposadr[0]
    panda_sim.data.qpos[address] -= 0.01
    panda_sim.advance(5)
    # 50 mm/s for 10 ms.
    np.testing.assert_allclose(setpoints(panda_sim) - before, [-5e-4, 5e-4], atol=1e-6)


def test_joint_command_ends_an_action(panda_sim, run):
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    run(panda_sim, 0.1)
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command([LEFT], [0.035], [], []))
    run(panda_sim, 1.0)
    assert setpoints(panda_sim)[0] == pytest.approx(0.035)


def test_fingers_cannot_be_pushed_past_their_force_limit(panda_sim, run):
    efforts = []
    panda_sim.robot.apply(panda_sim.robot.parse.action(GRIPPER, [1.0]))
    run(panda_sim, 0.6, lambda: efforts.append(np.abs(panda_sim.robot.state().effort[7:]).max()))
    assert max(efforts) <= 70.0 + 1.0  # The data sheet's, and the weight that is compensated.


@pytest.mark.parametrize(('action', 'message'), [
    ([], r'^right/gripper: an action must have 1 number, got 0$'),
    ([1.0, 1.0], r'^right/gripper: an action must have 1 number, got 2$'),
    ([np.nan], r'^right/gripper: an action must be finite, got nan at index 0$')])
def test_action_that_does_not_fit_is_rejected(panda_sim, action, message):
    with pytest.raises(CommandError, match=message):
        panda_sim.robot.parse.action(GRIPPER, action)


@pytest.mark.parametrize(('names', 'fields', 'message'), [
    (['robot0_joint1'], ([0], [], []), r"^right/gripper has no joint 'robot0_joint1' that can be "
     r'commanded: .*available: gripper0_right_finger_joint1, gripper0_right_finger_joint2$'),
    ([LEFT], ([0, 0], [], []), r'^right/gripper: position must have 1 number, got 2: one for '),
    ([LEFT], ([], [0], []), r"^right/gripper: joint 'gripper0_right_finger_joint1' is in position "
     r'mode, which does not use the field velocity')])
def test_joint_command_that_does_not_fit_is_rejected(panda_sim, names, fields, message):
    with pytest.raises(CommandError, match=message):
        panda_sim.robot.parse.joint_command(names, *fields, part=GRIPPER)


def test_values_past_the_limits_are_clamped_and_counted(panda_sim):
    action = panda_sim.robot.parse.action(GRIPPER, [7.0])
    assert (list(action.action), action.clamped) == ([1.0], 1)
    (goal,) = panda_sim.robot.parse.joint_command([LEFT, RIGHT], [0.5, -0.01], [], [])
    np.testing.assert_allclose(goal.values, [0.04, -0.01])
    assert goal.clamped == 1


@pytest.fixture
def user_sim(one_joint_arm, gripper_class, gripper_file):
    """Return a function that makes a simulation of a user's gripper on a small arm."""
    def make(unlimited=False):
        robot, gripper = one_joint_arm(), gripper_class(gripper_file)
        if unlimited:
            gripper.spec.joint('slide').limited = 0
            gripper.spec.joint('slide').range = [0.0, 0.0]
        robot.add_gripper(gripper)
        return Simulation(World([robot]))
    return make


def test_gripper_that_is_written_for_the_reference_is_driven(user_sim, run):
    simulation = user_sim()
    simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [1.0]))
    run(simulation, 1.5)
    assert simulation.data.joint('gripper0_slide').qpos[0] == pytest.approx(0.03, abs=1e-4)


def test_gripper_that_returns_a_list_is_driven(user_sim, gripper_class, run):
    formatted = gripper_class.format_action
    gripper_class.format_action = lambda self, action: list(formatted(self, action))
    simulation = user_sim()
    simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [-1.0]))
    run(simulation, 1.5)
    assert simulation.data.joint('gripper0_slide').qpos[0] == pytest.approx(-0.02, abs=1e-4)


def test_unlimited_gripper_joint_is_not_clamped_to_zero(user_sim):
    simulation = user_sim(unlimited=True)
    (goal,) = simulation.robot.parse.joint_command(['gripper0_slide'], [0.02], [], [])
    assert (list(goal.values), goal.clamped) == ([0.02], 0)


def test_a_finger_that_is_pushed_past_the_end_of_its_range_does_not_press_on(run):
    file = Path(__file__).resolve().parents[1] / 'data/files/rubbing_fingers.urdf'
    simulation = Simulation(compose(load_robot(file)))
    for action in (-1.0, 1.0, -1.0):
        for _ in range(2):  # It is repeated.
            simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [action] * 2))
            run(simulation, 1.0)
        place, end = simulation.robot.state().position, 0.04 if action < 0.0 else 0.0
        np.testing.assert_allclose(place, [end, end], atol=2e-3)
        np.testing.assert_allclose(setpoints(simulation), [end, end])


def test_no_finger_is_pressed_with_a_force_that_stands_for_no_limit(tmp_path, run):
    text = (Path(__file__).resolve().parents[1] / 'data/files/rubbing_fingers.urdf').read_text()
    file = tmp_path / 'strong.urdf'
    file.write_text(text.replace('effort="70"', 'effort="1e7"').replace(
        'friction="5"', 'friction="100"'))
    simulation = Simulation(compose(load_robot(file)))
    for action in (-1.0, 1.0, -1.0):
        simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [action] * 2))
        run(simulation, 2.0)
        position = simulation.robot.state().position
        assert position.min() > -2e-3 and position.max() < 0.042


def soft_pal_gripper():
    """Return the gripper with two servos as users write them, 20 N at 20 mm."""
    gripper = create_gripper('PalGripper')
    for actuator in gripper.spec.actuators:
        actuator.gainprm[0], actuator.forcerange = 1000.0, [-20.0, 20.0]
        actuator.biasprm[1:3] = -1000.0, -20.0
    return gripper


@pytest.mark.full
@pytest.mark.parametrize(('gripper', 'load_kg', 'offset_m'), [
    ('PalGripper', 0.8 * 2.0, 0.0), ('PalGripper', 0.15, 0.006), ('PandaGripper', 0.8 * 3.0, 0.0),
    ('RethinkGripper', 0.8 * 2.3, 0.0), (soft_pal_gripper, 0.5, 0.003),
    # One finger comes to its end before the other one pushes the box to it.
    (soft_pal_gripper, 0.1, 0.02)])
def test_two_fingers_with_a_drive_each_keep_what_they_hold_in_the_middle(
        gripper, load_kg, offset_m, run):
    simulation = Simulation(compose(gripper=gripper() if callable(gripper) else gripper, objects=[
        {'name': 'box', 'shape': 'box', 'size': [0.03] * 3, 'mass': load_kg,
         'position': [3.0, 0.0, 1.0]}]))
    model, data, robot = simulation.model, simulation.data, simulation.robot
    model.opt.gravity[:] = 0.0
    dof = robot.grippers[GRIPPER].dof
    robot.apply(robot.parse.action(GRIPPER, [-1.0] * dof))
    run(simulation, 1.0)
    site, box = data.site(robot.end_effectors['right'].grip_site), data.body('box')
    joint = model.joint(robot.parts[GRIPPER].joints[0])
    axis = data.xaxis[joint.id].copy()
    start = data.joint('box_joint').qpos
    start[:3] = site.xpos + offset_m * axis
    mujoco.mju_mat2Quat(start[3:], site.xmat)
    simulation.forward()
    robot.apply(robot.parse.action(GRIPPER, [1.0] * dof))
    run(simulation, 1.5)
    assert abs(axis @ (box.xpos - site.xpos)) < 1e-3
    # The weight along the closing axis.
    box_id, ways = model.body('box').id, []
    for _ in range(20):
        data.xfrc_applied[box_id, :3] = -9.81 * load_kg * axis
        run(simulation, 0.05)
        ways.append(axis @ (box.xpos - site.xpos))
    assert np.abs(ways[-10:]).max() < 1e-3
    if not callable(gripper):
        assert np.abs(ways).max() < 1e-3
    force, limit = data.actuator_force[robot.parts[GRIPPER].actuator_ids], np.abs(
        model.actuator_forcerange[robot.parts[GRIPPER].actuator_ids])
    assert np.abs(force).max() == pytest.approx(limit.max(), rel=0.01)


def test_two_fingers_that_press_go_on_at_their_speed_when_the_part_is_gone(run):
    simulation = Simulation(compose(gripper='PalGripper', objects=[
        {'name': 'box', 'shape': 'box', 'size': [0.04] * 3, 'mass': 0.8,
         'position': [3.0, 0.0, 1.0]}]))
    data, robot = simulation.data, simulation.robot
    simulation.model.opt.gravity[:] = 0.0
    robot.apply(robot.parse.action(GRIPPER, [-1.0]))
    run(simulation, 1.0)
    site, start = data.site(robot.end_effectors['right'].grip_site), data.joint('box_joint').qpos
    start[:3] = site.xpos
    mujoco.mju_mat2Quat(start[3:], site.xmat)
    simulation.forward()
    robot.apply(robot.parse.action(GRIPPER, [1.0]))
    run(simulation, 1.5)
    fingers = [data.joint(name) for name in robot.parts[GRIPPER].joints]
    width = sum(float(finger.qpos[0]) for finger in fingers)
    assert width == pytest.approx(0.04, abs=2e-3)
    start[:3] = 3.0, 0.0, 1.0
    run(simulation, 0.3)
    # At 50 mm/s each, once the force has grown; with the force alone that grows it was 3 mm.
    assert width - sum(float(finger.qpos[0]) for finger in fingers) > 0.015


#: A hand of two fast fingers with a soft drive each.
SOFT_HAND = """
<mujoco>
  <compiler autolimits="true"/>
  <default>
    <joint type="slide" range="0 0.04" armature="0.05" damping="1"/>
    <geom type="box" size="0.01 0.004 0.02" mass="0.1" friction="1.2" solref="0.005 1"
      solimp="0.03 0.99 0.001" priority="1"/>
    <position kp="1500" kv="20" forcerange="-30 30" inheritrange="1"/>
  </default>
  <worldbody>
    <body name="mount">
      <geom size="0.02 0.06 0.02" pos="0 0 0.02" mass="0.3"/>
      <body name="eef" pos="0 0 0.085"/>
      <body pos="0 0.04 0.04">
        <joint name="left" axis="0 -1 0"/><geom pos="0 0.004 0.045"/>
      </body>
      <body pos="0 -0.04 0.04">
        <joint name="right" axis="0 1 0"/><geom pos="0 -0.004 0.045"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="left"/><position joint="right"/></actuator>
</mujoco>"""


def test_a_part_that_one_finger_carries_to_the_end_of_the_other_is_centred_too(tmp_path, run):
    (tmp_path / 'hand.xml').write_text(SOFT_HAND)
    simulation = Simulation(compose(gripper=str(tmp_path / 'hand.xml'), objects=[
        {'name': 'box', 'shape': 'box', 'size': [0.02, 0.03, 0.03], 'mass': 0.1,
         'position': [3.0, 0.0, 1.0]}]))
    data, robot = simulation.data, simulation.robot
    simulation.model.opt.gravity[:] = 0.0
    robot.apply(robot.parse.action(GRIPPER, [-1.0, -1.0]))
    run(simulation, 1.0)
    joints = [data.joint(name) for name in robot.parts[GRIPPER].joints]
    site, start = data.site(robot.end_effectors['right'].grip_site), data.joint('box_joint').qpos
    start[:3] = site.xpos + 0.02 * joints[1].xaxis
    mujoco.mju_mat2Quat(start[3:], site.xmat)
    simulation.forward()
    robot.apply(robot.parse.action(GRIPPER, [1.0, 1.0]))
    run(simulation, 1.2)
    places = [float(joint.qpos[0]) for joint in joints]
    assert sum(places) == pytest.approx(0.05, abs=2e-3)
    assert abs(places[0] - places[1]) < 2e-3
