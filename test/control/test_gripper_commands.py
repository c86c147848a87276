# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Grippers with couplings, tendons, motors and other actuators are driven right or rejected."""

import mujoco
import numpy as np
import pytest

from manip_sim.control.gripper_actuators import ForceLimit
from manip_sim.errors import CommandError, ModelError
from manip_sim.models import compose
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import Baxter, create_robot
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

GRIPPER = 'right/gripper'
LEFT, RIGHT = 'gripper0_left', 'gripper0_right'
SERVO = '<position name="{0}" joint="{0}" kp="1000" kv="20" inheritrange="1" forcerange="-20 20"/>'
SERVOS = SERVO.format('left') + SERVO.format('right')
TENDON = """<tendon><fixed name="both"><joint joint="left" coef="0.5"/>
    <joint joint="right" coef="0.5"/></fixed></tendon>"""
#: Controls of 0 to 255 stand for 0 to 0.04 m.
TENDON_SERVO = ('<general name="fingers" tendon="both" biastype="affine" ctrlrange="0 255" '
                'gainprm="0.1568627451 0 0" biasprm="0 -1000 -20" forcerange="-20 20"/>')
MOTORS = ('<motor name="left_motor" joint="left" ctrlrange="-3 3"/>'
          '<motor name="right_motor" joint="right" ctrlrange="-3 3"/>')


def fingers(simulation):
    """Return where the fingers of a gripper are [m], shape (2,)."""
    return np.array([simulation.data.joint(joint).qpos[0] for joint in (LEFT, RIGHT)])


def command(simulation, **positions):
    """Command fingers by the names of their file [m]."""
    simulation.robot.apply(*simulation.robot.parse.joint_command(
        [f'gripper0_{side}' for side in positions], list(positions.values()), [], []))


def act(simulation, action):
    simulation.robot.apply(simulation.robot.parse.action(GRIPPER, [action]))


def speeds_during(simulation, run, seconds):
    """Return the greatest speed of either finger, sampled at each physics step [m/s]."""
    dofs = [simulation.model.joint(joint).dofadr[0] for joint in (LEFT, RIGHT)]
    speeds = []
    for _ in range(round(seconds / simulation.timestep_s)):
        simulation.advance(1)
        speeds.append(np.abs(simulation.data.qvel[dofs]).max())
    return max(speeds)


def coupled_joints():
    """Return gripper, joint and goal of a joint that is coupled to another one with a motor."""
    return [('PandaGripper', 'finger_joint1', 0.03, {'finger_joint2': -0.03}),
            ('PandaGripper', 'finger_joint2', -0.01, {'finger_joint1': 0.01}),
            ('RethinkGripper', 'l_finger_joint', 0.01, {'r_finger_joint': -0.01}),
            ('Robotiq85Gripper', 'finger_joint', 0.4, {'right_outer_knuckle_joint': 0.4}),
            ('Robotiq140Gripper', 'right_outer_knuckle_joint', -0.4, {'finger_joint': 0.4}),
            ('FourierLeftHand', 'L_index_proximal_joint', 0.5,
             {'L_index_intermediate_joint': 0.5 * 1.10828025, 'L_middle_proximal_joint': 0.0}),
            ('FourierLeftHand', 'L_index_intermediate_joint', 0.5,
             {'L_index_proximal_joint': 0.5 / 1.10828025})]


@pytest.mark.parametrize(('name', 'joint', 'goal', 'others'), coupled_joints())
def test_unnamed_finger_follows_the_one_that_it_is_coupled_to(one_joint_arm, run, name, joint,
                                                              goal, others):
    robot = one_joint_arm()
    robot.add_gripper(create_gripper(name))
    simulation = Simulation(World([robot]))
    simulation.robot.apply(*simulation.robot.parse.joint_command(
        [f'gripper0_{joint}'], [goal], [], []))
    run(simulation, 2.0)
    for other, position in {joint: goal, **others}.items():
        assert simulation.data.joint(f'gripper0_{other}').qpos[0] == pytest.approx(
            position, abs=2e-3), other
    # Motors that fight would use a good part of their force, which none needs to hold still.
    ids = simulation.robot.parts[GRIPPER].actuator_ids
    limit = simulation.model.actuator_forcerange[ids, 1]
    assert (np.abs(simulation.data.actuator_force[ids]) < 0.02 * limit).all()


@pytest.mark.parametrize('forces', ['-inf 20', '-20 inf'])
def test_a_servo_whose_force_has_no_limit_on_one_side_goes_and_presses_as_others_do(
        forces, fingers_sim, run):
    simulation = fingers_sim(SERVOS.replace('-20 20', forces))
    for goal in (0.03, 0.0, 0.04):
        command(simulation, left=goal)
        run(simulation, 1.5)
        np.testing.assert_allclose(fingers(simulation), goal, atol=5e-4)


def test_fingers_that_nothing_couples_move_one_by_one(fingers_sim, run):
    simulation = fingers_sim(SERVOS, coupled=False)
    command(simulation, left=0.035)
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), [0.035, 0.02], atol=1e-4)


def test_of_two_commands_in_one_period_for_coupled_fingers_the_newer_one_counts(fingers_sim, run):
    simulation = fingers_sim(SERVOS)
    command(simulation, left=0.035)
    command(simulation, right=0.01)
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), [0.01, 0.01], atol=1e-4)


@pytest.mark.parametrize('polynomial', ['0 0.5 0 0 0', '0.005 0.2 10 0 0'])
def test_coupled_finger_follows_any_polynomial_both_ways(
        fingers_sim, fingers_class, run, polynomial):
    a, b, c = [float(number) for number in polynomial.split()[:3]]
    sections = (f'<equality><joint joint1="right" joint2="left" polycoef="{polynomial}"/>'
                '</equality>')
    fingers_class.init_qpos = [0.02, a + b * 0.02 + c * 0.02**2]
    simulation = fingers_sim(SERVOS, sections, coupled=False)
    expected = [0.03, a + b * 0.03 + c * 0.03**2]
    command(simulation, left=expected[0])
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), expected, atol=2e-4)
    command(simulation, left=0.01)
    run(simulation, 1.5)
    command(simulation, right=expected[1])
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), expected, atol=2e-4)


@pytest.mark.full
@pytest.mark.parametrize('named', [{'left': 0.03}, {'right': 0.03},
                                   {'left': 0.03, 'right': 0.03}])
def test_fingers_on_a_tendon_follow_joint_commands_at_their_speed(fingers_sim, run, named):
    simulation = fingers_sim(TENDON_SERVO, TENDON)
    np.testing.assert_allclose(fingers(simulation), [0.02, 0.02], atol=1e-4)
    assert simulation.robot.grippers[GRIPPER].joints.names == (LEFT, RIGHT)
    command(simulation, left=0.0)
    assert speeds_during(simulation, run, 0.3) == pytest.approx(0.05, rel=0.02)
    run(simulation, 1.0)
    command(simulation, **named)
    assert speeds_during(simulation, run, 0.3) == pytest.approx(0.05, rel=0.02)
    run(simulation, 1.0)
    np.testing.assert_allclose(fingers(simulation), [0.03, 0.03], atol=2e-4)


def test_coupled_setpoints_keep_their_ratio_on_the_way(fingers_sim, fingers_class):
    fingers_class.init_qpos = [0.02, 0.01]
    simulation = fingers_sim(SERVOS, '<equality><joint joint1="right" joint2="left" '
                             'polycoef="0 0.5 0 0 0"/></equality>', coupled=False)
    command(simulation, right=0.02)
    for _ in range(100):
        simulation.advance(5)
        left, right = simulation.data.act[-2:]
        assert right == pytest.approx(0.5 * left, abs=1e-4)
    assert right == pytest.approx(0.02)


def test_coupling_that_is_switched_off_does_not_count(fingers_sim, run):
    simulation = fingers_sim(SERVOS, '<equality><joint joint1="right" joint2="left" '
                             'active="false"/></equality>', coupled=False)
    command(simulation, left=0.035)
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), [0.035, 0.02], atol=1e-4)


def test_coupling_counts_from_where_the_joints_are_in_the_file(fingers_sim, fingers_class, run):
    def refer(gripper):
        gripper.spec.joint('left').ref = 0.01

    # The left finger is at 0.01 where the right one is at 0.
    fingers_class.init_qpos = [0.03, 0.02]
    simulation = fingers_sim(SERVOS, before=refer)
    for named, expected in (({'left': 0.035}, [0.035, 0.025]), ({'right': 0.005}, [0.015, 0.005])):
        command(simulation, **named)
        run(simulation, 1.5)
        np.testing.assert_allclose(fingers(simulation), expected, atol=1e-4)


def test_slow_actions_move_evenly_and_a_joint_command_after_them_at_full_speed(
        fingers_sim, fingers_class, run):
    # 0.05 of a range of 2 is 1 mm of 0.04 m: at 20 Hz 0.02 m/s.
    fingers_class.speed = 0.05
    simulation = fingers_sim(SERVOS)
    act(simulation, -1.0)
    assert speeds_during(simulation, run, 0.7) == pytest.approx(0.02, rel=0.02)
    command(simulation, left=0.0)
    assert speeds_during(simulation, run, 0.3) == pytest.approx(0.05, rel=0.02)


def test_fingers_on_a_tendon_follow_actions_at_their_speed(fingers_sim, run):
    simulation = fingers_sim(TENDON_SERVO, TENDON)
    act(simulation, -1.0)
    run(simulation, 2.0)
    np.testing.assert_allclose(fingers(simulation), [0.04, 0.04], atol=1e-3)
    act(simulation, 1.0)
    assert speeds_during(simulation, run, 2.0) == pytest.approx(0.05, rel=0.02)
    np.testing.assert_allclose(fingers(simulation), [0.0, 0.0], atol=1e-3)


def test_joints_on_a_tendon_take_joint_commands_beside_those_of_other_parts(fingers_sim, run):
    simulation = fingers_sim(TENDON_SERVO, TENDON)
    for goal in simulation.robot.parse.joint_command([LEFT, 'robot0_joint1'], [0.03, 0.1]):
        simulation.robot.apply(goal)
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), [0.03, 0.03], atol=2e-4)


def test_no_joint_of_an_uncoupled_tendon_is_faster_than_it_may_be(fingers_sim, run):
    # One finger is held, so the other one has to do all of the way of the tendon.
    sections = TENDON + '<equality><joint joint1="right" polycoef="0.02 0 0 0 0"/></equality>'
    simulation = fingers_sim(TENDON_SERVO, sections, coupled=False)
    command(simulation, left=0.035)
    assert speeds_during(simulation, run, 1.0) < 0.052
    assert fingers(simulation)[0] == pytest.approx(0.035, abs=1e-3)


def test_a_finger_that_moves_less_than_its_partner_leaves_the_partner_at_its_speed(
        fingers_sim, run):
    # The tendon is half of both: while the left finger moves by 1, it gets longer by 0.75.
    sections = TENDON + ('<equality><joint joint1="right" joint2="left" polycoef="0 0.5 0 0 0"/>'
                         '</equality>')
    simulation = fingers_sim(TENDON_SERVO, sections, coupled=False)
    command(simulation, left=0.0)
    run(simulation, 2.0)
    command(simulation, left=0.03)
    assert speeds_during(simulation, run, 0.5) == pytest.approx(0.05, rel=0.02)


def test_speed_limit_counts_at_the_joint_whatever_the_gear(fingers_sim, run):
    geared = ''.join(f'<position name="{side}" joint="{side}" kp="{1000 / gear**2}" '
                     f'kv="{20 / gear**2}" gear="{gear}" ctrlrange="{low} {high}"/>'
                     for side, gear, low, high in (('left', 3, 0, 0.12), ('right', -2, -0.08, 0)))
    simulation = fingers_sim(geared, coupled=False)
    command(simulation, left=0.04, right=0.0)
    assert speeds_during(simulation, run, 0.3) == pytest.approx(0.05, rel=0.02)
    run(simulation, 1.0)
    np.testing.assert_allclose(fingers(simulation), [0.04, 0.0], atol=1e-3)


def test_motors_take_actions_as_forces(fingers_sim, run):
    simulation = fingers_sim(MOTORS)
    act(simulation, 1.0)
    run(simulation, 1.0)
    actuators = simulation.robot.parts[GRIPPER].actuator_ids
    np.testing.assert_array_equal(simulation.data.ctrl[actuators], [-3.0, -3.0])
    np.testing.assert_allclose(fingers(simulation), [0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize(('actuators', 'reason'), [
    (MOTORS, "actuator 'gripper0_left_motor' is no position servo, its control is a force"),
    ('<velocity name="wheel" joint="left" kv="5" ctrlrange="-1 1"/>',
     "actuator 'gripper0_wheel' is no position servo, its control is a velocity"),
    # A spring, on which no control acts.
    ('<general name="spring" joint="left" gainprm="0" biastype="affine" biasprm="0 -100 0"'
     ' ctrlrange="0 0.04"/>',
     "actuator 'gripper0_spring' is no position servo, its control is a force")])
def test_joint_command_to_what_is_no_position_servo_is_rejected(fingers_sim, actuators, reason):
    simulation = fingers_sim(actuators)
    with pytest.raises(CommandError, match=f"^right/gripper: joint '{LEFT}' takes no position, "
                                           f'{reason}: use actions$'):
        command(simulation, left=0.01)
    with pytest.raises(CommandError, match='takes no position'):
        simulation.robot.parse.joint_command([LEFT], [0.01])


def test_a_start_that_violates_a_coupling_is_one_that_satisfies_it(fingers_sim, fingers_class):
    fingers_class.init_qpos = [0.03, 0.01]
    simulation = fingers_sim(SERVO.format('left'))
    left, right = fingers(simulation)
    assert left == pytest.approx(right, abs=1e-5)
    assert 0.01 < left < 0.03
    simulation.reset()
    np.testing.assert_array_equal(fingers(simulation), [left, right])


@pytest.mark.parametrize('second', [
    '<velocity name="damper" joint="left" kv="5" ctrlrange="-1 1"/>',
    '<position name="damper" joint="left" kp="5" ctrlrange="0 1"/>'])
def test_two_actuators_on_one_joint_end_the_start(fingers_sim, second):
    with pytest.raises(ModelError, match=(
            "^actuators 'gripper0_left' and 'gripper0_damper' of right/gripper both drive joint "
            "'gripper0_left' and one of them is a position servo, which the other one disturbs: "
            'keep only one$')):
        fingers_sim(SERVO.format('left') + second)


def test_two_actuators_on_one_joint_are_seen_behind_one_that_drives_none(fingers_sim):
    with pytest.raises(ModelError, match="'gripper0_left' and 'gripper0_right' of right/gripper "
                                         "both drive joint 'gripper0_left'"):
        fingers_sim('<motor name="thruster" site="grip_site" ctrlrange="0 1"/>'
                    + SERVO.format('left')
                    + SERVO.format('right').replace('joint="right"', 'joint="left"'))


def test_two_motors_on_one_joint_are_driven_one_by_one(fingers_sim, run):
    simulation = fingers_sim('<motor name="pull" joint="left" ctrlrange="0 3"/>'
                             '<motor name="push" joint="left" gear="-1" ctrlrange="0 1"/>')
    act(simulation, -1.0)
    run(simulation, 1.0)
    assert fingers(simulation)[0] == pytest.approx(0.04, abs=1e-3)


def test_servo_with_a_velocity_as_control_goes_to_positions(fingers_sim, run):
    simulation = fingers_sim(''.join(
        f'<intvelocity name="{side}" joint="{side}" kp="1000" kv="20" actrange="0 0.04" '
        'forcerange="-20 20" ctrlrange="-0.03 0.03"/>' for side in ('left', 'right')))
    run(simulation, 0.5)
    np.testing.assert_allclose(fingers(simulation), [0.02, 0.02], atol=1e-4)
    act(simulation, -1.0)
    assert speeds_during(simulation, run, 1.5) == pytest.approx(0.03, rel=0.03)
    np.testing.assert_allclose(fingers(simulation), [0.04, 0.04], atol=1e-3)
    command(simulation, right=0.01)
    run(simulation, 2.0)
    np.testing.assert_allclose(fingers(simulation), [0.01, 0.01], atol=1e-3)
    block(simulation, 0.015)
    act(simulation, 1.0)
    run(simulation, 3.0)
    assert not simulation.robot.grippers[GRIPPER].moving


def test_servo_with_a_filter_of_its_own_keeps_it(fingers_sim, run):
    simulation = fingers_sim(''.join(
        f'<position name="{side}" joint="{side}" kp="1000" kv="20" ctrlrange="0 0.04" '
        'timeconst="0.1"/>' for side in ('left', 'right')))
    kinds = simulation.model.actuator_dyntype[simulation.robot.parts[GRIPPER].actuator_ids]
    assert {int(kind) for kind in kinds} == {int(mujoco.mjtDyn.mjDYN_FILTEREXACT)}
    run(simulation, 0.5)
    np.testing.assert_allclose(fingers(simulation), [0.02, 0.02], atol=1e-4)
    command(simulation, left=0.035)
    assert speeds_during(simulation, run, 2.0) < 0.055
    np.testing.assert_allclose(fingers(simulation), [0.035, 0.035], atol=1e-3)


def test_actuator_without_a_control_range_takes_that_of_its_joint(fingers_sim, run):
    simulation = fingers_sim('<position name="left" joint="left" kp="1000" kv="20"/>')
    act(simulation, -1.0)
    run(simulation, 2.0)
    assert fingers(simulation)[0] == pytest.approx(0.04, abs=1e-3)


def test_motor_without_a_control_range_ends_the_start(fingers_sim):
    with pytest.raises(ModelError, match="^actuator 'gripper0_m' of right/gripper needs a control "
                                         r'range, to which actions in \[-1, 1\] are mapped$'):
        fingers_sim('<motor name="m" joint="left"/>')


def test_force_range_of_one_side_only_closes_and_does_not_open(fingers_sim, run):
    one_sided = SERVOS.replace('forcerange="-20 20"', 'forcerange="-20 0"')
    simulation = fingers_sim(one_sided)
    act(simulation, 1.0)
    run(simulation, 2.0)
    np.testing.assert_allclose(fingers(simulation), [0.0, 0.0], atol=1e-3)
    act(simulation, -1.0)
    run(simulation, 2.0)
    np.testing.assert_allclose(fingers(simulation), [0.0, 0.0], atol=1e-3)


def block(simulation, width_m):
    """Stop the fingers at some place."""
    for joint in (LEFT, RIGHT):
        simulation.model.joint(joint).range[0] = width_m / 2.0


@pytest.mark.full
@pytest.mark.parametrize(('force_range', 'force'), [('-20 20', 20.0), ('-20 5', 20.0),
                                                    ('-5 20', 5.0)])
@pytest.mark.parametrize('width_m', [0.003, 0.02, 0.05])
def test_fingers_that_are_stopped_press_with_the_full_force_of_their_side(
        fingers_sim, run, force_range, force, width_m):
    simulation = fingers_sim(SERVOS.replace('-20 20', force_range))
    act(simulation, -1.0)
    run(simulation, 1.5)
    block(simulation, width_m)
    act(simulation, 1.0)
    run(simulation, 1.5)
    pressing = simulation.data.actuator_force[simulation.robot.parts[GRIPPER].actuator_ids]
    np.testing.assert_allclose(pressing, [-force, -force], rtol=1e-3)
    assert not simulation.robot.grippers[GRIPPER].moving
    before = fingers(simulation)
    act(simulation, -1.0)
    run(simulation, 0.1)
    # 0.05 m/s after the lag of the servo, 0.03 s.
    assert (fingers(simulation) - before > 0.0025).all()


def test_force_limit_of_the_joint_counts_as_well(fingers_sim, run):
    def limit(gripper):
        for side in ('left', 'right'):
            gripper.spec.joint(side).actfrcrange = [-8.0, 30.0]
            gripper.spec.joint(side).actfrclimited = 1

    simulation = fingers_sim(SERVOS, before=limit)
    block(simulation, 0.02)
    act(simulation, 1.0)
    run(simulation, 1.5)
    np.testing.assert_allclose(simulation.robot.state().effort[-2:], [-8.0, -8.0], rtol=1e-3)
    lead = fingers(simulation) - simulation.data.act[-2:]
    np.testing.assert_allclose(lead, 8e-3 + fingers(simulation), rtol=1e-3)


def test_joint_command_presses_no_more_than_its_error_asks_for(fingers_sim, run):
    simulation = fingers_sim(SERVOS)
    act(simulation, -1.0)
    run(simulation, 1.5)
    command(simulation, left=0.0)
    block(simulation, 0.01)
    run(simulation, 2.0)
    np.testing.assert_allclose(simulation.data.actuator_force[
        simulation.robot.parts[GRIPPER].actuator_ids], [-5.0, -5.0], rtol=0.02)


@pytest.mark.parametrize(('returned', 'what'), [
    (lambda action: np.zeros(3), r'it returned the shape \(3,\)'),
    (lambda action: 0.0, r'it returned the shape \(\)'),
    (lambda action: [np.nan, 0.0], r'it returned \[nan, 0.0\]'),
    (lambda action: None, r'it returned the shape \(\)'),
    (lambda action: action['left'], r'it raised IndexError: .*')])
def test_format_action_that_does_not_fit_ends_the_start(
        fingers_sim, fingers_class, returned, what):
    fingers_class.format_action = lambda self, action: returned(action)
    with pytest.raises(ModelError, match=(
            '^format_action of OneActionGripper must return 2 finite numbers, one for each '
            f'actuator, but with an action of 1 zeros {what}$')):
        fingers_sim(SERVOS)


def test_check_at_the_start_changes_no_state_of_the_gripper(fingers_sim, fingers_class):
    calls = []

    def counted(self, action):
        self.count = getattr(self, 'count', 0) + 1
        self.current_action += 0.5
        calls.append(self.count)
        return np.zeros(2)

    fingers_class.format_action = counted
    fingers_class.start_at = lambda self, command: None
    simulation = fingers_sim(SERVOS)
    gripper = simulation.robot.parts[GRIPPER].gripper
    np.testing.assert_array_equal(gripper.current_action, [0.0, 0.0])
    assert calls == [1]
    assert not hasattr(gripper, 'count')


def test_simulations_of_one_world_close_and_open_apart(run):
    world = compose('Panda')
    state = world.robots[0].grippers['right'].current_action.copy()
    closing, opening = Simulation(world), Simulation(world)
    for _ in range(20):
        for simulation, action in ((closing, 1.0), (opening, -1.0)):
            act(simulation, action)
            run(simulation, 0.1)
    names = [f'gripper0_right_finger_joint{number}' for number in (1, 2)]
    for simulation, position in ((closing, 0.0), (opening, 0.04)):
        found = [abs(float(simulation.data.joint(name).qpos[0])) for name in names]
        np.testing.assert_allclose(found, position, atol=1e-3)
    np.testing.assert_array_equal(world.robots[0].grippers['right'].current_action, state)


def test_grippers_of_two_arms_have_arrays_of_their_own(gripper_class, gripper_file):
    class Counting(gripper_class, registered=False):
        def __init__(self, file):
            super().__init__(file)
            self.moved = np.zeros(1)

        def format_action(self, action):
            self.moved += action
            return self.moved

    robot = Baxter()
    robot.add_gripper(Counting(gripper_file))
    robot.grippers['right'].format_action([0.5])
    np.testing.assert_array_equal(robot.grippers['left'].moved, [0.0])


@pytest.mark.full
@pytest.mark.parametrize('bad', [[np.nan, np.nan], [0.0], [[0.0], [0.0]], 'nonsense'])
def test_bad_return_at_run_time_holds_and_is_counted(fingers_sim, fingers_class, run, bad):
    simulation = fingers_sim(SERVOS)
    gripper = simulation.robot.parts[GRIPPER].gripper
    good = gripper.format_action
    act(simulation, -1.0)
    run(simulation, 0.2)
    gripper.format_action = lambda action: bad
    run(simulation, 0.2)
    held = simulation.data.act.copy()
    assert simulation.robot.grippers[GRIPPER].faults == 4
    run(simulation, 0.5)
    np.testing.assert_array_equal(simulation.data.act, held)
    assert simulation.diverged is None
    assert np.isfinite(simulation.data.ctrl).all()
    assert simulation.robot.grippers[GRIPPER].last_fault.startswith('format_action: it r')
    gripper.format_action = good
    run(simulation, 1.5)
    np.testing.assert_allclose(fingers(simulation), [0.04, 0.04], atol=1e-3)
    assert simulation.robot.grippers[GRIPPER].faults == 14


def test_gripper_that_raises_at_run_time_is_counted_and_held(fingers_sim, run):
    simulation = fingers_sim(SERVOS)

    def raising(*args):
        raise RuntimeError('broken')

    gripper = simulation.robot.parts[GRIPPER].gripper
    gripper.format_action = gripper.start_at = raising
    act(simulation, -1.0)
    run(simulation, 0.5)
    assert simulation.robot.grippers[GRIPPER].faults == 10
    simulation.reset()
    assert simulation.robot.grippers[GRIPPER].faults == 11
    assert simulation.robot.grippers[GRIPPER].last_fault == (
        'start_at: it raised RuntimeError: broken')
    np.testing.assert_allclose(fingers(simulation), [0.02, 0.02], atol=1e-4)


def test_start_that_is_not_finite_ends_it(fingers_sim, fingers_class):
    fingers_class.init_qpos = [0.01, np.nan]
    with pytest.raises(
            ModelError, match=r'^init_qpos of OneActionGripper0 must be finite, got nan'):
        fingers_sim(SERVOS)


def test_resting_fingers_need_no_ticks(fingers_sim, run):
    simulation = fingers_sim(SERVOS)
    drive = simulation.robot.grippers[GRIPPER]
    assert not drive.moving
    for action in (-1.0, 1.0):
        act(simulation, action)
        assert drive.moving
        run(simulation, 2.5)
        assert not drive.moving
        ids = simulation.robot.parts[GRIPPER].actuator_ids
        np.testing.assert_array_equal(simulation.data.ctrl[ids], [0.0, 0.0])


@pytest.mark.parametrize('name', ['Panda', 'UR5e', 'Baxter'])
def test_activation_leaves_the_forces_of_servos_as_they_are(name):
    robot = create_robot(name)
    robot.add_gripper(create_gripper('RethinkGripper'))
    simulation = Simulation(World([robot]))
    ids = simulation.robot.parts[GRIPPER].actuator_ids
    goal = np.array([0.004, 0.002])
    simulation.data.act[simulation.model.actuator_actadr[ids]] = goal
    mujoco.mj_forward(simulation.model, simulation.data)
    plain = World([robot]).compile()
    data = mujoco.MjData(plain)
    data.qpos[:] = simulation.data.qpos
    data.ctrl[ids] = goal
    mujoco.mj_forward(plain, data)
    np.testing.assert_allclose(simulation.data.actuator_force[ids], data.actuator_force[ids])


def test_an_effort_at_a_finger_is_the_force_of_its_actuator_by_gear_and_tendon(fingers_sim):
    simulation = fingers_sim(TENDON_SERVO.replace('tendon=', 'gear="3" tendon='), TENDON)
    actuators = simulation.robot.grippers[GRIPPER]._actuators
    limit = ForceLimit(simulation.physics, actuators)
    limit.set(6.0)
    # 4 N of the actuator are 12 N in the tendon, half of them at each finger.
    (actuator,) = actuators.ids
    assert simulation.model.actuator_forcerange[actuator] == pytest.approx([-4.0, 4.0])
    limit.set(60.0)
    assert simulation.model.actuator_forcerange[actuator] == pytest.approx([-20.0, 20.0])
    limit.set(0.0)
    assert simulation.model.actuator_forcerange[actuator] == pytest.approx([-20.0, 20.0])


@pytest.mark.full
@pytest.mark.parametrize('name', [
    'PandaGripper', 'RobotiqThreeFingerGripper', 'JacoThreeFingerDexterousGripper',
    'FourierLeftHand'])
def test_the_rule_of_a_gripper_does_what_its_format_action_does(name, one_joint_arm):
    simulations = []
    for _ in range(2):
        robot = one_joint_arm()
        robot.add_gripper(create_gripper(name))
        simulations.append(Simulation(World([robot])))
    gripper = simulations[1].robot.parts[GRIPPER].gripper
    assert gripper.action_rule is not None
    gripper.format_action = gripper.format_action  # No rule stands for what a user has changed.
    assert gripper.action_rule is None
    draw = np.random.default_rng(0)
    for period in range(80):
        steps = int(draw.integers(3, 40))
        if draw.random() < 0.5:
            action = draw.choice([-1.0, -0.3, 0.0, 0.5, 1.0], size=gripper.dof)
            for simulation in simulations:
                simulation.robot.apply(simulation.robot.parse.action(GRIPPER, action))
        for simulation in simulations:
            simulation.advance(steps)
        assert simulations[0].digest() == simulations[1].digest(), period
