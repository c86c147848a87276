# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Faults by plan: what fails, when, and that nothing else does; the same bits whatever way."""

import math

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.faults import fault_from_text, FaultPlan
from manip_sim.simulation import Simulation
from manip_sim.simulation.journal_entries import plain_state, restore_plain
from manip_sim.tasks import create_task
from manip_sim.worlds import Worlds

JOINT, ELBOW = 'robot0_joint1', 'robot0_joint4'
FINGER = 'gripper0_right_finger_joint1'


def fault(what, begin=0.2, end=0.4, part='arm', **more):
    return {'what': what, 'part': part, 'from': begin, 'until': end, **more}


def swinging(*faults, seconds=0.6, seed=0, **composition):
    """Let a joint swing; return the simulation, and measured and true positions of each period."""
    simulation = Simulation(compose('Panda', faults=faults, **composition))
    simulation.reset(seed)
    return simulation, *swing(simulation, seconds)


def swing(simulation, seconds):
    robot, seen, true = simulation.robot, [], []
    for _ in range(round(seconds * 100)):
        goal = 0.3 * math.sin(5.0 * (simulation.data.time + 0.01))
        robot.apply(*robot.parse.joint_command([JOINT], [goal], [], []), period_s=0.01)
        simulation.advance(5)
        seen.append(robot.state().position)
        true.append(robot.true_state().position)
    return np.array(seen), np.array(true)


PERIODS = np.arange(1, 61)
ACTS = (PERIODS >= 20) & (PERIODS < 40)


def test_a_frozen_state_stays_as_it_was_and_the_motion_goes_on():
    simulation, seen, true = swinging(fault('frozen_state'))
    np.testing.assert_array_equal(seen[~ACTS], true[~ACTS])
    np.testing.assert_array_equal(seen[ACTS, 7:], true[ACTS, 7:])  # Those of the gripper.
    assert (seen[ACTS, :7] == true[19, :7]).all() and np.ptp(true[ACTS, 0]) > 0.05
    simulation.reset()
    swing(simulation, 0.3)
    assert simulation.robot.measured('arm')[0] != simulation.data.joint(JOINT).qpos[0]
    assert simulation.robot.measured('right/gripper')[0] == simulation.data.joint(FINGER).qpos[0]


def test_offset_noise_and_age_of_states_are_what_is_planned():
    _, seen, true = swinging(fault('offset_state', value=0.05))
    np.testing.assert_allclose((seen - true)[ACTS, :7], 0.05, atol=1e-12)
    np.testing.assert_array_equal((seen - true)[:, 7:], 0.0)
    _, seen, true = swinging(fault('noisy_state', 0.0, 0.59, value=0.01))
    assert np.std((seen - true)[:58, :7]) == pytest.approx(0.01, rel=0.15)
    _, seen, true = swinging(fault('late_state', value=0.05))
    held = ACTS & (PERIODS < 25)
    assert (seen[held, :7] == true[19, :7]).all()
    np.testing.assert_array_equal(seen[24:39, :7], true[19:34, :7])
    np.testing.assert_array_equal(seen[~ACTS], true[~ACTS])


def test_a_share_of_the_states_is_lost_and_those_before_are_repeated():
    _, seen, true = swinging(fault('lost_state', 0.1, 0.6, value=0.5))
    arrived = (seen == true).all(axis=1)
    arm = seen[:, :7]
    assert arrived[:10].all() and 12 < arrived[10:].sum() < 38
    for period in np.flatnonzero(~arrived):
        np.testing.assert_array_equal(arm[period], arm[period - 1])


def test_limp_joints_fall_without_effort_and_are_held_again():
    simulation, _, true = swinging(fault('limp'), seconds=1.5)
    efforts = []
    simulation.reset()
    for _ in range(35):
        simulation.advance(5)
        efforts.append(simulation.robot.true_state().effort[:7])
    np.testing.assert_array_equal(efforts[21:], 0.0)
    assert np.abs(efforts[:19]).max() > 5.0
    elbow = true[:, 3]
    assert abs(elbow[38] - elbow[18]) > 0.01 and abs(elbow[149] - elbow[145]) < 1e-3
    model = simulation.model
    before = Simulation(compose('Panda')).model
    simulation.advance(100)  # It ends within this period, which it acts in to its end.
    simulation.advance(5)
    np.testing.assert_array_equal(model.jnt_actfrcrange, before.jnt_actfrcrange)


def test_lost_commands_change_nothing_and_are_counted_and_a_share_of_them_arrives():
    simulation, _, true = swinging(fault('lost_commands', 0.2, 1.0), seconds=1.0)
    lost, = simulation.faults.summary()
    assert lost['lost'] == 80 and lost['state'] == 'over'
    # It ends where it was sent last.
    assert true[98, 0] == pytest.approx(0.3 * math.sin(5.0 * 0.2), abs=1e-3)
    _, true = swing(simulation, 0.3)
    assert np.ptp(true[:, 0]) > 0.1
    simulation, *_ = swinging(fault('lost_commands', 0.0, 0.5, value=0.3))
    assert 5 <= simulation.faults.summary()[0]['lost'] <= 25
    simulation.faults.inject({'what': 'lost_commands', 'part': 'right'})
    robot = simulation.robot
    command = robot.parse.action('arm', np.zeros(7))
    grip = robot.parse.action('right/gripper', [1.0])
    robot.apply(command, grip)
    assert command.handle.status is Status.ABORTED and 'a fault has lost' in command.handle.reason
    assert grip.handle.status is Status.RUNNING


def test_a_stuck_gripper_stays_and_lets_go_later():
    simulation = Simulation(compose('Panda', faults=[fault('stuck', 0.0, 1.0, 'right/gripper')]))
    robot = simulation.robot
    start = simulation.data.joint(FINGER).qpos[0]
    robot.apply(robot.parse.action('right/gripper', [1.0]))
    for _ in range(95):
        simulation.advance(5)
        assert abs(simulation.data.joint(FINGER).qpos[0] - start) < 5e-4
    for _ in range(100):
        simulation.advance(5)
    assert simulation.data.joint(FINGER).qpos[0] < 0.005


PLAN = [fault('limp', [0.1, 0.3], 0.4, chance=0.5), fault('frozen_state', 0.1, 0.35),
        fault('late_state', 0.35, value=[0.01, 0.03]), fault('lost_commands', 0.2, 0.5, value=0.5),
        fault('noisy_state', 0.1, 0.5, 'right/gripper', value=1e-3)]


def test_a_seed_draws_the_same_plan_and_another_one_another_in_many_worlds_too():
    world = compose('Panda', faults=PLAN)
    one, worlds = Simulation(world), Worlds(world, 4)
    worlds.reset([0, 1, 2, 3])
    command = np.tile([0.2], (4, 1))
    for _ in range(45):
        worlds.robots['robot0'].command.joint_command([JOINT], position=command, period_s=0.01)
        worlds.advance(5)
    plans = []
    for seed, digest in enumerate(worlds.digest()):
        one.reset(seed)
        for _ in range(45):
            one.robot.apply(*one.robot.parse.joint_command([JOINT], [0.2], [], []), period_s=0.01)
            one.advance(5)
        assert one.digest() == digest
        np.testing.assert_array_equal(worlds.simulations[seed].robot.state().position,
                                      one.robot.state().position)
        plans.append([(found['what'], found['from'], found.get('value'))
                      for found in one.faults.summary()])
    assert len({len(plan) for plan in plans}) == 2  # The chance of the first.
    assert len({plan[-3] for plan in plans}) == 4


@pytest.mark.parametrize('moment', [0.05, 0.25, 0.38])
def test_a_restored_state_goes_on_to_the_bit_here_and_elsewhere_also_from_json(moment):
    simulation, *_ = swinging(*PLAN, seconds=moment)
    state, text = simulation.save(), plain_state(simulation)[0]
    ends = []
    for other in (simulation, Simulation(compose('Panda', faults=PLAN)),
                  Simulation(compose('Panda', faults=PLAN))):
        if other is not simulation:
            other.advance(7)
            other.restore(state) if len(ends) == 1 else restore_plain(other, text)
            effort = other.robot.true_state().effort
            np.testing.assert_array_equal(effort, ends[0][2])
        effort = other.robot.true_state().effort
        seen, _ = swing(other, 0.2)
        ends.append((other.digest(), seen, effort, other.faults.summary()))
    for digest, seen, _, summary in ends[1:]:
        assert digest == ends[0][0] and summary == ends[0][3]
        np.testing.assert_array_equal(seen, ends[0][1])


def test_sensors_are_those_of_a_restored_state_where_joints_go_limp_and_are_held_again():
    simulation = Simulation(compose('Panda', faults=[fault('limp')]))
    for period in range(45):
        simulation.advance(5)
        before = simulation.data.sensordata.copy(), simulation.data.qacc.copy()
        simulation.restore(simulation.save())
        for numbers, now in zip(before, (simulation.data.sensordata, simulation.data.qacc)):
            np.testing.assert_array_equal(numbers, now, err_msg=f'after period {period}')


def test_an_injected_fault_acts_from_now_on_and_ends_with_a_reset():
    simulation, *_ = swinging(seconds=0.1)
    assert simulation.faults.summary() == []
    simulation.faults.inject(fault_from_text('{what: offset_state, part: right, value: 0.1, '
                                             'from: 0.05, until: 0.1}'))
    assert simulation.faults.summary() == [{
        'what': 'offset_state', 'robot': 'robot0', 'part': 'right', 'from': 0.15, 'until': 0.2,
        'value': 0.1, 'state': 'waits'}]
    seen, true = swing(simulation, 0.15)
    off = np.abs(seen - true)[:, 0] > 0.05
    assert off.tolist() == [4 <= period < 9 for period in range(15)]
    simulation.faults.inject({'what': 'limp', 'part': 'arm'})
    simulation.advance(5)
    simulation.reset()
    simulation.advance(5)
    assert simulation.faults.summary() == []
    assert np.abs(simulation.robot.true_state().effort).max() > 5.0


def test_objects_may_come_while_joints_are_limp():
    from manip_sim.models.object_creation import create_described, ObjectModel
    from manip_sim.physics.object_spawning import plan_with
    simulation = Simulation(compose('Panda', faults=[fault('limp', 0.0, 0.2)]))
    simulation.advance(5)
    simulation.change_objects(plan_with(simulation.plan, create_described(
        {'name': 'late', 'shape': 'box', 'size': [0.04] * 3, 'position': [1.0, 1.0, 0.02]},
        ObjectModel, 'late')))
    simulation.advance(5)
    np.testing.assert_array_equal(simulation.robot.true_state().effort[:7], 0.0)
    for _ in range(30):
        simulation.advance(5)
    assert np.abs(simulation.robot.true_state().effort).max() > 5.0


@pytest.mark.parametrize('given, text', [
    ([fault('limb')], "number 1: unknown fault 'limb': did you mean 'limp'"),
    ([{'what': 'limp'}], "'part' must be a name"),
    ([fault('limp', until_s=3)], "unknown key 'until_s': did you mean 'until'"),
    ([fault('limp', 0.4, 0.4)], "'until' must be after 'from'"),
    ([fault('limp', [0.1, 0.5], 0.4)], "'until' must be after 'from'"),
    ([fault('limp', value=1.0)], 'limp has no value'),
    ([fault('late_state')], "late_state needs a 'value': age"),
    ([fault('late_state', value=-1.0)], "'value' must be a number from 0 to 10"),
    ([fault('offset_state', value=math.nan)], "'value' must be a number from -10 to 10"),
    ([fault('noisy_state', value=[0.2, 0.1])], 'low must not be above high'),
    ([fault('limp', 'soon')], "'from' must be a number from 0"),
    ([fault('limp', chance=2.0)], "'chance' must be a number from 0 to 1"),
    ([fault('limp', chance=[0.0, 1.0])], "'chance' must be one number"),
    (['limp'], "expected keys such as 'what'"),
    ({'what': 'limp'}, 'must be a list of faults')])
def test_a_plan_that_makes_no_sense_is_rejected(given, text):
    with pytest.raises(ModelError, match=text):
        FaultPlan(given)


def test_a_fault_that_fits_no_robot_is_rejected_and_changes_nothing():
    simulation = Simulation(compose('Panda'))
    for given, text, error in (
            (fault('limp', part='arms'), "unknown part of a fault 'arms': did you mean 'arm'",
             UnknownNameError),
            (fault('limp', robot='robot1'), "unknown robot of a fault 'robot1'", UnknownNameError),
            (fault('stuck'), 'only fingers of a gripper can be stuck', ModelError),
            (fault('limp', math.inf), "'from' must be", ModelError),
            (fault('limp', chance=0.5), "injected has no 'chance'", ModelError)):
        with pytest.raises(error, match=text):
            simulation.faults.inject(given)
    assert simulation.faults.summary() == []
    for text in ('', '[limp]', '{what: limp', 'what: &a [*a]'):
        with pytest.raises(ModelError):
            fault_from_text(text)
    with pytest.raises(UnknownNameError, match='part of a fault'):
        Simulation(compose('Panda', faults=[fault('limp', part='torso')]))
    for _ in range(1000):
        simulation.faults.inject(fault('frozen_state', 50.0, 60.0))
    with pytest.raises(ModelError, match='1000 faults at most'):
        simulation.faults.inject(fault('limp'))


def test_a_file_names_faults_and_tasks_keep_what_it_holds(tmp_path):
    file = tmp_path / 'faults.yaml'
    file.write_text('faults:\n- {what: limp, part: arm, from: 1.0}\n')
    assert FaultPlan(file).given == [{'what': 'limp', 'part': 'arm', 'from': 1.0}]
    task = create_task('reach', faults=file)
    assert task.arguments['faults'] == FaultPlan(file).given
    assert Simulation(task.world).faults.summary()[0]['until'] is None
    file.write_text('fault: []\n')
    with pytest.raises(ModelError, match="faults.yaml: expected the key 'faults'"):
        FaultPlan(file)
