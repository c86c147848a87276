# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Goals of GripperCommand: reached, or stopped by what is held; the force that they may use."""

import math

import mujoco
import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.models import compose
from manip_sim.models.grippers import gripper_names
from manip_sim.runtime.action_goals import Ending, GoalCode, GoalError, GripperGoal, GripperRequest
from manip_sim.simulation import Simulation

GRIPPER = 'right/gripper'
FINGER, OTHER = 'gripper0_right_finger_joint1', 'gripper0_right_finger_joint2'


class Actor:
    """Runs a simulation in which one goal after the other is watched."""

    def __init__(self, simulation):
        self.simulation = simulation
        self.robot = simulation.robot
        self.goal = None

    def start(self, position, **more):
        self.goal = GripperGoal(self.robot, GRIPPER, GripperRequest(position, **more))
        self.robot.apply(self.goal.command, period_s=0.01)
        return self.goal

    def run(self, seconds=4.0, goal=None):
        """Run so long, or until a goal has ended; return the seconds that it took."""
        for period in range(round(seconds * 100)):
            if goal is not None and goal.outcome is not None:
                return period * 0.01
            self.simulation.advance(5)
            if self.goal is not None:
                self.goal.check(self.simulation)
        return seconds

    def where(self, joint=FINGER):
        return float(self.simulation.data.joint(joint).qpos[0])

    def effort(self, joint=FINGER):
        return float(self.simulation.data.joint(joint).qfrc_actuator[0])


@pytest.fixture
def panda(panda_sim):
    return Actor(panda_sim)


@pytest.fixture
def at_a_cube():
    """Return a Panda with open fingers about a cube of 50 mm that floats between them."""
    simulation = Simulation(compose('Panda', arena='table', cube=True))
    actor = Actor(simulation)
    actor.run(goal=actor.start(0.04))
    model, data = simulation.model, simulation.data
    model.body_gravcomp[model.body('cube').id] = 1.0
    cube = data.joint(int(model.body('cube').jntadr[0]))
    cube.qpos[:3] = data.site('gripper0_right_grip_site').xpos
    mujoco.mju_mat2Quat(cube.qpos[3:], data.site('gripper0_right_grip_site').xmat)
    cube.qvel[:] = 0.0
    return actor


def test_goal_is_reached_with_both_fingers(panda):
    for position in (0.03, 0.0, 0.04):
        goal = panda.start(position)
        panda.run(goal=goal)
        assert goal.outcome.ending is Ending.SUCCEEDED
        assert goal.view.reached is True and goal.view.stalled is False
        panda.run(0.5)
        # Closed, the pads touch.
        assert panda.where() == pytest.approx(position, abs=6e-4)
        assert panda.where(OTHER) == pytest.approx(-position, abs=6e-4)


def test_effort_of_a_goal_is_that_of_the_state(panda):
    goal = panda.start(0.0)
    for _ in range(20):
        panda.run(0.01)
        state, index = panda.robot.state(), panda.robot.joint_names.index(FINGER)
        assert goal.view.effort == state.effort[index]
    assert goal.view.velocity < -0.01


@pytest.mark.parametrize('gripper', [
    name for name in gripper_names()
    if name not in ('NullGripper', 'VacuumGripper', 'WipingGripper')])
def test_every_gripper_of_the_catalogue_reaches_positions_on_the_way(gripper):
    robot = 'GR1' if gripper.startswith('Fourier') else 'Panda'
    actor = Actor(Simulation(compose(robot, gripper=gripper)))
    controller = actor.robot.grippers[GRIPPER]
    joint = controller.joints.names[0]
    low, high = controller.joints.reach(joint)
    for part in (0.3, 0.6):
        goal = actor.start(low + part * (high - low))
        actor.run(goal=goal)
        assert goal.view.reached, (goal.view, goal.outcome)
        assert abs(actor.where(joint) - low - part * (high - low)) < 0.02 * (high - low)


def test_fingers_that_are_not_named_close_as_far_as_the_first_one(panda):
    actor = Actor(Simulation(compose('Panda', gripper='RethinkGripper')))
    right, left = actor.robot.grippers[GRIPPER].joints.names
    # From -0.021 to 0.011 m and from -0.011 to 0.021 m: a quarter of the way from open.
    for joint, other in ((0.003, -0.003), (-0.021, 0.021)):
        actor.run(goal=actor.start(joint))
        actor.run(0.5)
        assert actor.where(right) == pytest.approx(joint, abs=5e-4)
        assert actor.where(left) == pytest.approx(other, abs=5e-4)


def test_fingers_that_close_the_other_way_and_are_not_coupled_close_as_far(
        fingers_sim, fingers_class):
    fingers_class.format_action = lambda self, action: self._integrate(
        np.array([-0.2, 0.2]) * np.sign(self._checked(action)))
    actor = Actor(fingers_sim(
        '<position name="l" joint="left" kp="900" kv="9" ctrlrange="0 0.04"/>'
        '<position name="r" joint="right" kp="900" kv="9" ctrlrange="0 0.04"/>', coupled=False))
    actor.run(goal=actor.start(0.03))
    actor.run(0.5)
    # The left one is open at 0.04, the right one at zero: both are closed by a quarter.
    assert actor.where('gripper0_left') == pytest.approx(0.03, abs=1e-4)
    assert actor.where('gripper0_right') == pytest.approx(0.01, abs=1e-4)


def test_what_does_not_close_stays_where_it_is():
    actor = Actor(Simulation(compose('Panda', gripper='RobotiqThreeFingerGripper')))
    scissor = 'gripper0_right_palm_finger_1_joint'
    actor.robot.apply(*actor.robot.parse.joint_command([scissor], [-0.1]))
    actor.run(1.0)
    actor.run(goal=actor.start(0.5))
    actor.run(0.5)
    assert actor.where(scissor) == pytest.approx(-0.1, abs=0.01)
    assert actor.where('gripper0_right_finger_middle_joint_1') == pytest.approx(0.5, abs=0.05)


def test_position_of_another_joint_may_be_given(panda):
    panda.run(goal=panda.start(-0.01, joint=OTHER))
    panda.run(0.5)
    assert panda.goal.view.joint == OTHER
    assert (panda.where(), panda.where(OTHER)) == pytest.approx((0.01, -0.01), abs=1e-4)


@pytest.mark.full
@pytest.mark.parametrize(('max_effort', 'expected'), [(0.0, 70.0), (12.0, 12.0)])
def test_what_is_held_stalls_the_fingers_with_the_force_that_is_allowed(
        at_a_cube, max_effort, expected):
    goal = at_a_cube.start(0.0, max_effort=max_effort)
    at_a_cube.run(goal=goal)
    assert goal.outcome.ending is Ending.SUCCEEDED
    assert goal.outcome.reason == 'the fingers were stopped before they reached the goal'
    assert goal.view.stalled is True and goal.view.reached is False
    assert goal.view.position == pytest.approx(0.025, abs=5e-4)
    assert goal.view.effort == pytest.approx(-expected, rel=0.01)
    # The grasp lasts.
    at_a_cube.run(1.0)
    assert at_a_cube.effort() == pytest.approx(-expected, rel=0.01)
    assert at_a_cube.effort(OTHER) == pytest.approx(expected, rel=0.01)


def test_fingers_let_go_no_faster_than_they_may_move(at_a_cube):
    at_a_cube.run(goal=at_a_cube.start(0.0, max_effort=20.0))
    goal, speeds = at_a_cube.start(0.04), []
    while goal.outcome is None:
        at_a_cube.run(0.01)
        speeds.append(goal.view.velocity)
    # From 24.5 to 40 mm at 50 mm/s, as the pads give, less the tolerance at the end.
    assert len(speeds) * 0.01 == pytest.approx(0.3, abs=0.03)
    assert max(speeds[5:]) < 0.0525


def test_same_goal_again_does_not_loosen_the_grasp(at_a_cube):
    at_a_cube.run(goal=at_a_cube.start(0.0, max_effort=20.0))
    goal, efforts = at_a_cube.start(0.0, max_effort=20.0), []
    while goal.outcome is None:
        at_a_cube.run(0.01)
        efforts.append(at_a_cube.effort())
    assert goal.view.stalled and max(efforts) < -19.0


def test_limit_of_the_force_ends_with_the_next_command(at_a_cube):
    at_a_cube.run(goal=at_a_cube.start(0.0, max_effort=5.0))
    assert at_a_cube.effort() == pytest.approx(-5.0, rel=0.01)
    at_a_cube.robot.apply(at_a_cube.robot.parse.action(GRIPPER, [1.0]))
    at_a_cube.run(1.0)
    assert at_a_cube.effort() == pytest.approx(-70.0, rel=0.01)


def test_limit_of_the_force_ends_with_a_reset_and_outlives_a_change_of_objects(panda):
    model, ids = panda.simulation.model, panda.robot.parts[GRIPPER].actuator_ids
    before = model.actuator_forcerange[ids].copy()
    panda.start(0.0, max_effort=5.0)
    np.testing.assert_array_equal(model.actuator_forcerange[ids], [[-5.0, 5.0]] * 2)
    panda.simulation.change_objects(panda.simulation.plan)
    model = panda.simulation.model
    np.testing.assert_array_equal(model.actuator_forcerange[ids], [[-5.0, 5.0]] * 2)
    panda.simulation.reset()
    np.testing.assert_array_equal(model.actuator_forcerange[ids], before)


def test_more_than_the_actuators_can_give_is_no_more(panda):
    model, ids = panda.simulation.model, panda.robot.parts[GRIPPER].actuator_ids
    before = model.actuator_forcerange[ids].copy()
    panda.start(0.0, max_effort=1e6)
    np.testing.assert_array_equal(model.actuator_forcerange[ids], before)


def test_actuators_without_a_limit_are_limited_for_a_goal_only(fingers_sim):
    simulation = fingers_sim('<position name="l" joint="left" kp="900" kv="9" ctrlrange="0 0.04"/>'
                             '<position name="r" joint="right" kp="900" kv="9" gear="2"'
                             ' ctrlrange="0 0.08" forcelimited="false" forcerange="-1 1"/>',
                             coupled=False)
    actor, ids = Actor(simulation), simulation.robot.parts[GRIPPER].actuator_ids
    actor.start(0.0, max_effort=4.0)
    # At the joint, behind a gear of two.
    np.testing.assert_array_equal(simulation.model.actuator_forcerange[ids],
                                  [[-4.0, 4.0], [-2.0, 2.0]])
    assert simulation.model.actuator_forcelimited[ids].all()
    actor.start(0.0)
    assert not simulation.model.actuator_forcelimited[ids].any()
    # What the file says of them is there again, though it limits nothing.
    np.testing.assert_array_equal(simulation.model.actuator_forcerange[ids], [[0, 0], [-1, 1]])


def test_goal_is_approached_no_faster_than_the_client_wants(panda):
    panda.run(goal=panda.start(0.04))
    panda.run(0.5)
    goal, speeds = panda.start(0.01, max_velocity=0.02), []
    while goal.outcome is None:
        panda.run(0.01)
        speeds.append(abs(goal.view.velocity))
    assert np.median(speeds) == pytest.approx(0.02, rel=0.02) and max(speeds) < 0.0205


def test_a_goal_of_a_velocity_that_is_where_the_finger_is_leaves_it_there(panda):
    panda.run(goal=panda.start(0.02))
    panda.run(0.5)
    panda.simulation.data.joint(FINGER).qpos[0] = 0.02
    goal = panda.start(0.02, max_velocity=0.02)
    panda.run(0.1)
    assert goal.outcome.ending is Ending.SUCCEEDED
    assert panda.simulation.diverged is None
    assert panda.where() == pytest.approx(0.02, abs=1e-4)


def test_cancelled_goal_stops_the_fingers(panda):
    panda.run(goal=panda.start(0.0))
    goal = panda.start(0.04)
    panda.run(0.4)
    assert goal.cancel() and goal.outcome.ending is Ending.CANCELED
    where = panda.where()
    panda.run(1.0)
    assert 0.01 < panda.where() < 0.03
    assert panda.where() == pytest.approx(where, abs=2e-3)


def test_cancelled_goal_does_not_drop_what_the_fingers_press(at_a_cube):
    goal = at_a_cube.start(0.0)
    at_a_cube.run(0.8)
    assert goal.outcome is None
    pressed = at_a_cube.effort()
    assert pressed < -60.0 and goal.cancel()
    at_a_cube.run(1.0)
    assert at_a_cube.effort() <= pressed + 0.5


def test_weak_servos_that_press_with_full_force_go_on_after_a_cancel(fingers_sim):
    servo = ('<position name="{0}" joint="{0}" kp="200" kv="9" ctrlrange="0 0.04"'
             ' forcerange="-20 20"/>')
    actor = Actor(fingers_sim(servo.format('left') + servo.format('right')))
    actor.run(goal=actor.start(0.04))
    goal = actor.start(0.0)
    # The fingers are stopped at 10 mm, where the stiffness alone would give 2 N.
    for joint in ('gripper0_left', 'gripper0_right'):
        actor.simulation.model.joint(joint).range[0] = 0.01
    for _ in range(200):
        actor.run(0.01)
        if actor.effort('gripper0_left') < -4.0:
            break
    assert goal.outcome is None and goal.cancel()
    actor.run(0.5)
    assert actor.effort('gripper0_left') == pytest.approx(-20.0, rel=0.01)


def action(panda):
    panda.robot.apply(panda.robot.parse.action(GRIPPER, [-1.0]))


@pytest.mark.full
@pytest.mark.parametrize(('interfere', 'reason'), [
    (action, 'a newer command has taken over'),
    (lambda panda: panda.simulation.reset(), 'the simulation was reset')],
    ids=['command', 'reset'])
@pytest.mark.parametrize('seconds', [0.1, 0.8], ids=['on the way', 'pressing'])
def test_what_interferes_ends_the_goal_and_is_told(at_a_cube, interfere, reason, seconds):
    goal = at_a_cube.start(0.0)
    at_a_cube.run(seconds)
    assert goal.outcome is None
    interfere(at_a_cube)
    at_a_cube.run(0.01)
    assert (goal.outcome.ending, goal.outcome.reason) == (Ending.ABORTED, reason)


@pytest.mark.parametrize('offset', [-0.00081, -0.00079, 0.00079, 0.00081])
def test_a_goal_is_reached_within_a_fiftieth_of_the_range(panda, offset):
    goal = panda.start(0.02)
    panda.simulation.data.joint(FINGER).qpos[0] = 0.02 + offset
    goal.check(panda.simulation)
    assert goal.view.reached == (abs(offset) < 0.0008)


@pytest.mark.parametrize('offset', [-0.0101, -0.0099, 0.0099, 0.0101])
def test_a_goal_of_a_joint_without_a_range_is_reached_within_a_hundredth(fingers_sim, offset):
    actor = Actor(fingers_sim(
        '<position tendon="both" kp="900" kv="9" ctrlrange="0 0.08"/>',
        '<tendon><fixed name="both"><joint joint="left" coef="1"/><joint joint="right" coef="1"/>'
        '</fixed></tendon>'))
    actor.simulation.model.jnt_limited[:] = 0
    goal = actor.start(0.02)
    actor.simulation.data.joint('gripper0_left').qpos[0] = 0.02 + offset
    goal.check(actor.simulation)
    assert goal.view.reached == (abs(offset) < 0.01)


def start_still(actor):
    """Start a goal whose command is done and whose fingers stand still far from it."""
    goal = actor.start(0.0)
    goal.command.handle.end(Status.DONE)
    for joint, position in ((FINGER, 0.03), (OTHER, -0.03)):
        actor.simulation.data.joint(joint).qpos[0] = position
    return goal


def periods_until_stalled(actor, goal, speed_of=lambda period: 0.0):
    """Return how many periods of 10 ms it takes; each looks at fingers of a speed."""
    for period in range(100):
        actor.simulation.step_count += 5
        for joint in (FINGER, OTHER):
            actor.simulation.data.joint(joint).qvel[0] = speed_of(period)
        goal.check(actor.simulation)
        if goal.outcome is not None:
            assert goal.view.stalled
            return period
    return None


def test_fingers_have_stalled_after_a_quarter_of_a_second_and_anew_when_they_have_moved(panda):
    assert periods_until_stalled(panda, start_still(panda)) == 25
    assert periods_until_stalled(
        panda, start_still(panda), lambda period: 0.5 * (period == 20)) == 46


@pytest.mark.parametrize(('speed', 'still'), [
    (0.00099, True), (-0.00099, True), (0.00101, False), (-0.00101, False)])
def test_a_finger_that_takes_forty_seconds_to_cross_its_range_stands_still(panda, speed, still):
    goal = start_still(panda)
    assert (periods_until_stalled(panda, goal, lambda period: speed) == 25) == still


def test_fingers_that_stand_still_have_not_stalled_before_the_command_is_done(panda):
    goal = start_still(panda)
    goal.command.handle.status = Status.RUNNING
    assert periods_until_stalled(panda, goal) is None


@pytest.mark.parametrize(('request_', 'code', 'text'), [
    ({'position': math.nan}, 'INVALID_GOAL', 'position must be finite, got nan'),
    ({'position': 0.0, 'max_effort': -1.0}, 'INVALID_GOAL',
     'max_effort must be finite and not negative, got -1'),
    ({'position': 0.0, 'max_velocity': -1e-3}, 'INVALID_GOAL',
     'max_velocity must be finite and not negative, got -0.001'),
    ({'position': 0.0, 'max_velocity': math.inf}, 'INVALID_GOAL', 'max_velocity must be finite'),
    ({'position': 0.0, 'joint': 'thumb'}, 'INVALID_JOINTS', "has no joint 'thumb'")])
def test_goal_that_cannot_be_is_rejected_with_its_code(panda, request_, code, text):
    with pytest.raises(GoalError, match=text) as error:
        GripperGoal(panda.robot, GRIPPER, GripperRequest(**request_))
    assert error.value.code is GoalCode[code]


def test_position_outside_the_range_is_clamped_and_counted(panda):
    goal = panda.start(0.085)
    assert goal.command.clamped == 1
    panda.run(goal=goal)
    assert goal.view.reached


def test_fingers_without_a_range_are_still_where_they_do_not_move(panda, monkeypatch):
    joints, data = panda.robot.grippers[GRIPPER].joints, panda.simulation.data
    monkeypatch.setattr(
        joints, 'ranges', lambda names: np.tile([-math.inf, math.inf], (len(names), 1)))
    assert joints.are_still(data)
    data.joint(OTHER).qvel[0] = 0.5
    assert not joints.are_still(data)
