# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks: starts from seeds, success in the physics, rewards, experts."""

import json
from pathlib import Path
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.robots import create_robot
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode, Setting, Task, task_names
from manip_sim.tasks.placing import bodies_of_gripper, held_only_by, place, pressure
from manip_sim.tasks.task import TASKS

ARMS = ('Panda', 'UR5e', 'IIWA', 'Sawyer', 'Kinova3', 'FR3', 'XArm7')
#: Those of the package: later, tests may have added others to the process.
NAMES = task_names()
_episodes = {}


def episode_of(name, robot='Panda'):
    """Return episodes of a task; a simulation is made once."""
    if (name, robot) not in _episodes:
        task = create_task(name, robot)
        _episodes[name, robot] = Episode(task, Simulation(task.world))
    return _episodes[name, robot]


@pytest.mark.full
@pytest.mark.parametrize('robot', ['UR5e', 'Panda', 'Kinova3', 'Baxter'])
def test_the_agentview_of_a_handover_shows_both_grippers_from_the_front(robot):
    episode = episode_of('hand_over', robot)
    episode.reset(3)
    simulation = episode.simulation
    model, data = simulation.model, simulation.data
    camera = model.camera('agentview').id
    eye, axes = data.cam_xpos[camera], data.cam_xmat[camera].reshape(3, 3)
    grippers = [of.pose(data)[:3] for item in simulation.robots.values()
                for of in dict.fromkeys(item.end_effectors.values())]
    assert len(grippers) == 2
    slope = np.tan(np.radians(model.cam_fovy[camera]) / 2.0)
    for point in grippers:
        x, y, depth = (point - eye) @ axes * [1.0, 1.0, -1.0]
        assert depth > 0.5 and max(abs(x), abs(y)) < 0.9 * slope * depth
        # Nothing is in between: what is hit first is not far before the point between fingers.
        hit = mujoco.mj_ray(model, data, eye, (point - eye) / np.linalg.norm(point - eye), None,
                            1, -1, np.zeros(1, dtype=np.int32))
        assert hit < 0.0 or hit > np.linalg.norm(point - eye) - 0.15
    assert axes[2, 1] > 0.7  # Upright.


@pytest.mark.full
@pytest.mark.parametrize('robot', ['Panda', 'Baxter'])
@pytest.mark.parametrize('name', NAMES)
def test_the_agentview_shows_what_a_task_is_about(name, robot):
    episode = episode_of(name, robot)
    model, data = episode.simulation.model, episode.simulation.data
    camera = model.camera('agentview').id
    slope = np.tan(np.radians(model.cam_fovy[camera]) / 2.0)
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    shown = [*free, *np.flatnonzero(model.body_mocapid >= 0)]
    assert shown or name == 'wipe_table'
    for seed in range(8):
        episode.reset(seed)
        points = [*data.xpos[shown], episode.task.work_area]
        x, y, depth = ((points - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)).T
        assert (-depth > 0.3).all() and max(*abs(x / depth), *abs(y / depth)) < slope


#: Two robots do all tasks, each other one a third of them, so that each task has three or four.
BY_EXPERTS = [(name, robot) for number, name in enumerate(task_names())
              for place, robot in enumerate(ARMS)
              if robot in ('Panda', 'UR5e') or (number + place) % 3 == 0]


@pytest.mark.full
@pytest.mark.parametrize(('name', 'robot'), BY_EXPERTS)
def test_an_expert_does_its_task(name, robot):
    episode = episode_of(name, robot)
    expert = episode.task.expert(episode.simulation)
    assert episode.run(expert, 11)
    assert episode.reward == 1.0


@pytest.mark.full
@pytest.mark.parametrize('seed', [3, 4])
def test_slow_fingers_are_open_before_the_arm_goes_down_and_hold_before_it_goes_up(seed):
    # In the first one they would open on the cube, in the second one stand on the table.
    episode = episode_of('pick_cube', 'Jaco')
    assert episode.run(episode.task.expert(episode.simulation), seed)


@pytest.mark.full
@pytest.mark.parametrize('seed', [0, 2])
def test_fingers_side_by_side_go_down_between_the_handle_and_the_drawer(seed):
    # Turned as hands with two fingers are, one of the three stands on the front of the drawer.
    episode = episode_of('open_drawer', 'Jaco')
    assert episode.run(episode.task.expert(episode.simulation), seed)
    assert episode.periods * episode.period_s < 7.0


def test_an_expert_whose_hand_rests_on_the_cabinet_waits_no_longer_and_pulls():
    # The hand of a Panda touches the cabinet above the depth at which its fingers are to pull.
    episode = episode_of('open_drawer', 'Panda')
    assert episode.run(episode.task.expert(episode.simulation), 0)
    assert episode.periods * episode.period_s < 2.5


def test_an_expert_whose_fingers_slip_off_the_handle_tries_again():
    episode = episode_of('open_drawer', 'Jaco')
    assert episode.run(episode.task.expert(episode.simulation), 1)


def test_the_pressure_on_a_cube_is_its_weight_until_fingers_press():
    episode = episode_of('pick_cube')
    episode.reset(0)
    simulation = episode.simulation
    cube = {simulation.model.body('cube').id}
    for _ in range(5):
        episode.step(np.zeros(episode.actions.size))
    assert pressure(simulation, cube) == pytest.approx(0.1 * 9.81, rel=1e-2)
    assert pressure(simulation, cube, {'table'}) == pressure(simulation, cube)
    assert pressure(simulation, cube, but={'table'}) == 0.0
    assert episode.run(episode.task.expert(simulation), 0)
    fingers = bodies_of_gripper(simulation, simulation.robot, 'right')
    assert pressure(simulation, fingers, {'cube'}) > 4.0 * 0.1 * 9.81


def test_an_expert_says_why_a_gripper_of_a_user_does_not_hold_the_cube(tmp_path, caplog):
    # Fingers of 50 g with 5 N m go through the cube within a step.
    fingers = ''.join(
        f'<body name="{name}" pos="{x} 0 0.04"><joint name="{name}" axis="0 {y} 0" '
        'range="-0.4 0.6"/><geom type="box" size="0.006 0.012 0.05" pos="0 0 0.05" mass="0.05"/>'
        '</body>' for name, x, y in (('left', -0.045, 1), ('right', 0.045, -1)))
    servos = ''.join(f'<position joint="{name}" kp="20" kv="0.5" ctrlrange="-0.4 0.6" '
                     'forcerange="-5 5"/>' for name in ('left', 'right'))
    file = tmp_path / 'hinges.xml'
    file.write_text(f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm">
        <geom type="box" size="0.05 0.03 0.02" pos="0 0 0.02" mass="0.3"/>
        <site name="grip_site" pos="0 0 0.14"/>{fingers}</body></worldbody>
        <actuator>{servos}</actuator></mujoco>""")
    task = create_task('pick_cube', gripper=str(file))
    episode = Episode(task, Simulation(task.world))
    assert not episode.run(task.expert(episode.simulation), 0)
    message, = [record.message for record in caplog.records if 'expert' in record.name]
    assert "cannot grasp 'cube'" in message and 'none of its bodies touches' in message
    assert 'too strong for the inertia of the fingers' in message


@pytest.mark.full
@pytest.mark.parametrize('tip_m', [0.02, 0.045])
def test_an_expert_raises_fingers_that_stand_on_the_table_until_they_close(tip_m, tmp_path):
    # Jaws of a user, whose ends are this far beyond the grasp point that is inferred.
    jaws = ''.join(
        f'<body name="{name}_jaw" pos="0 {y} 0.06"><joint name="{name}_jaw" axis="{turn} 0 0" '
        f'range="-0.6 0.05" armature="0.002" damping="0.2"/><geom name="{name}_pad" type="box" '
        f'size="0.01 0.004 {tip_m}" pos="0 {y / 5} {tip_m}" mass="0.03"/></body>'
        for name, y, turn in (('left', 0.02, 1), ('right', -0.02, -1)))
    file = tmp_path / 'tongs.xml'
    file.write_text(f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
        <body name="palm"><geom type="cylinder" size="0.04 0.03" pos="0 0 0.03" mass="0.25"/>{jaws}
        </body></worldbody><equality><joint joint1="right_jaw" joint2="left_jaw"/></equality>
        <actuator><position joint="left_jaw" kp="20" kv="1" forcerange="-1.5 1.5"
        inheritrange="1"/></actuator></mujoco>""")
    task = create_task('pick_cube', gripper=str(file))
    episode = Episode(task, Simulation(task.world))
    assert all(episode.run(task.expert(episode.simulation), seed) for seed in range(3))


def test_the_page_on_experts_has_enough_successes_of_each_task_and_robot():
    page = Path(__file__).parents[2] / 'docs' / 'reference' / 'experts.md'
    found = {(row[1].strip('` '), row[2].strip()): row[3].split() for row in (
        line.split('|') for line in page.read_text().splitlines() if line.startswith('| `'))}
    for name in NAMES:
        for robot in ARMS:
            successes, _, count = found[name, robot]
            assert int(count) == 200 and int(successes) >= (190 if robot == 'Panda' else 180)


@pytest.mark.full
@pytest.mark.parametrize('name', task_names())
def test_doing_nothing_is_no_success(name):
    episode = episode_of(name)
    episode.reset(3)
    while not episode.time_is_up:
        episode.step(np.zeros(episode.actions.size))
        assert not episode.success
        assert 0.0 <= episode.reward < 1.0


@pytest.mark.full
@pytest.mark.parametrize('name', task_names())
def test_a_seed_draws_the_same_start_and_another_one_another(name):
    episode = episode_of(name)

    def start(seed):
        episode.reset(seed)
        return episode.digest

    first = start(1)
    assert start(2) != first
    assert start(1) == first
    task = create_task(name)
    other = Episode(task, Simulation(task.world))
    other.reset(1)
    assert other.digest == first


@pytest.mark.full
def test_an_episode_is_the_same_in_another_process():
    episode = episode_of('pick_cube')
    expert = episode.task.expert(episode.simulation)
    episode.run(expert, 5)
    program = ('import json; from manip_sim.simulation import Simulation; '
               'from manip_sim.tasks import create_task, Episode; '
               "task = create_task('pick_cube'); e = Episode(task, Simulation(task.world)); "
               'e.run(task.expert(e.simulation), 5); print(json.dumps([e.periods, e.digest]))')
    found = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                           check=True)
    assert json.loads(found.stdout) == [episode.periods, episode.digest]


@pytest.mark.full
@pytest.mark.parametrize('name', task_names())
def test_rewards_rise_while_the_expert_works(name):
    episode = episode_of(name)
    expert = episode.task.expert(episode.simulation)
    episode.reset(4)
    expert.reset(4)
    rewards = [episode.reward]
    while not episode.over:
        episode.step(expert.act())
        rewards.append(episode.reward)
    assert rewards[-1] == 1.0 and max(rewards[:-1]) < 1.0
    half = len(rewards) // 2
    assert np.mean(rewards[half:]) > np.mean(rewards[:half])


def test_a_cube_in_the_air_is_picked_only_if_it_is_held():
    episode = episode_of('pick_cube')
    episode.reset(1)
    place(episode.simulation, 'cube', np.array([0.0, 0.3, 1.1]))
    assert not episode.success


def test_a_cube_is_stacked_only_when_it_lies_there_alone():
    episode = episode_of('stack_cubes')
    episode.reset(1)
    simulation = episode.simulation
    base = simulation.data.body('base').xpos.copy()
    place(simulation, 'cube', base + [0.0, 0.0, 0.045])
    episode.advance()
    assert episode.success
    place(simulation, 'cube', base + [0.0, 0.0, 0.06])
    assert not episode.success  # In the air.
    place(simulation, 'cube', base + [0.0, 0.0, 0.045])
    simulation.data.joint('cube_joint').qvel[0] = 0.1
    simulation.forward()
    assert not episode.success  # It moves.


def test_a_cube_is_pushed_only_when_it_lies_on_the_disc():
    episode = episode_of('push_cube')
    episode.reset(1)
    simulation, disc = episode.simulation, episode.task.goal(episode.simulation)
    for off, lies in (([0.02, 0.0, 0.0299], True), ([0.04, 0.0, 0.0299], False),
                      ([0.0, 0.0, 0.05], False)):
        place(simulation, 'cube', disc + off)
        assert episode.success == lies


def test_a_peg_beside_the_hole_or_at_its_mouth_is_not_inserted():
    episode = episode_of('insert_peg')
    episode.reset(1)
    simulation, hole = episode.simulation, episode.task.goal(episode.simulation)
    for off, inserted in (([0.0, 0.0, 0.05], True), ([0.0, 0.0, 0.065], False),
                          ([0.05, 0.0, 0.05], False)):
        place(simulation, 'peg', hole[:3] + off, hole[3:])
        assert episode.success == inserted


@pytest.mark.full
def test_spots_are_wiped_off_only_by_a_gripper_that_presses_on_them():
    episode = episode_of('wipe_table')
    task, simulation = episode.task, episode.simulation
    expert = task.expert(simulation)
    episode.reset(1)
    expert.reset(1)
    pressed = []
    while not episode.over:
        before = task.left(simulation)
        episode.step(expert.act())
        wiped = before & ~task.left(simulation)
        touch = sum(simulation.data.sensor(f'gripper0_right_touch{corner}').data[0]
                    for corner in range(1, 5))
        pressed += [touch > 0.5] * int(wiped.sum())
    assert len(pressed) == 12 and all(pressed)


def test_spots_that_were_wiped_off_are_part_of_a_saved_state():
    episode = episode_of('wipe_table')
    task, simulation = episode.task, episode.simulation
    expert = task.expert(simulation)
    episode.reset(1)
    expert.reset(1)
    while task.left(simulation).sum() > 8:
        episode.step(expert.act())
    state, left = simulation.save(), task.left(simulation)
    episode.reset(1)
    assert task.left(simulation).all()
    simulation.restore(state)
    np.testing.assert_array_equal(task.left(simulation), left)


def test_a_drawer_is_open_by_its_joint():
    episode = episode_of('open_drawer')
    episode.reset(1)
    slide = episode.simulation.data.joint('drawer_slide')
    for opened_m, is_open in ((0.11, False), (0.13, True)):
        slide.qpos[0] = opened_m
        episode.simulation.forward()
        assert episode.success == is_open
        assert episode.task.goal(episode.simulation)[-1] == opened_m


@pytest.mark.full
def test_a_bar_is_handed_over_only_when_the_second_gripper_alone_holds_it():
    episode = episode_of('hand_over')
    expert = episode.task.expert(episode.simulation)
    episode.reset(1)
    expert.reset(1)
    held = []
    while not episode.over:
        episode.step(expert.act())
        held.append([held_only_by(episode.simulation, 'bar', robot, 'right')
                     for robot in episode.simulation.robots.values()])
    assert [True, False] in held and held[-1] == [False, True]
    assert not any(taker for _, taker in held[:-1])
    place(episode.simulation, 'bar', np.array([0.0, 0.3, 1.1]))
    assert not episode.success


@pytest.mark.full
def test_a_robot_with_two_arms_hands_over_alone():
    episode = episode_of('hand_over', 'Baxter')
    assert len(episode.simulation.robots) == 1
    assert episode.run(episode.task.expert(episode.simulation), 3)


def test_two_robots_of_a_task_are_given_by_name():
    with pytest.raises(ModelError, match='hand_over has two robots of Panda: give robot and'):
        create_task('hand_over', create_robot('Panda'))
    with pytest.raises(ModelError, match='two robots of Panda, for which there is no idn'):
        create_task('hand_over', 'Panda', idn=3)


def test_a_saved_state_holds_what_an_episode_has_drawn():
    episode = episode_of('reach')
    episode.reset(1)
    goal, state = episode.task.goal(episode.simulation), episode.simulation.save()
    episode.reset(2)
    assert not np.array_equal(episode.task.goal(episode.simulation), goal)
    episode.simulation.restore(state)
    np.testing.assert_array_equal(episode.task.goal(episode.simulation), goal)


def test_an_action_moves_the_end_effector_and_the_gripper():
    episode = episode_of('reach')
    episode.reset(1)
    robot, data = episode.simulation.robot, episode.simulation.data
    before, width = robot.end_effectors['right'].pose(data), robot.measured('right/gripper')[0]
    for _ in range(8):
        episode.step([0.0, 0.2, 0.0, 0.0, 0.0, 0.0, -1.0])
    moved = robot.end_effectors['right'].pose(data) - before
    assert moved[1] > 0.03 and abs(moved[0]) < 0.01 and abs(moved[2]) < 0.01
    assert robot.measured('right/gripper')[0] > width


@pytest.mark.parametrize('rate_hz, timestep_s', [
    (20.0, 0.002), (30.0, 0.001960784), (15.0, 0.001960784), (60.0, 0.001851852),
    (24.0, 0.001984127), (1000.0, 0.001), (29.97, 0.001962747)])
def test_a_control_period_is_a_whole_number_of_timesteps_at_any_rate(rate_hz, timestep_s):
    setting = Setting('reach', control_hz=rate_hz)
    episode = setting.create_episode()
    assert episode.simulation.timestep_s == timestep_s
    assert 1.0 / episode.period_s == pytest.approx(rate_hz, rel=1e-6)
    episode.reset(0)
    episode.step(np.zeros(7))
    assert episode.simulation.time_s == pytest.approx(1.0 / rate_hz, rel=1e-6)
    with pytest.raises(ModelError, match='control_hz must be above 0'):
        Setting('reach', control_hz=-rate_hz)


def test_a_timestep_that_is_taken_for_a_rate_is_logged_once(caplog):
    for _ in range(2):
        Setting('reach', control_hz=28.0).create_task()
    assert [record.getMessage() for record in caplog.records] == [
        'control rate of 28 Hz: the timestep is 0.001984127 s instead of 0.002 s, so that a '
        'control period is 18 whole timesteps']


def test_what_cannot_be_used_is_said():
    episode = episode_of('reach')
    with pytest.raises(CommandError, match='an action'):
        episode.step([0.0] * 6)
    with pytest.raises(CommandError, match='finite'):
        episode.step([np.nan] * 7)
    with pytest.raises(ModelError, match='seed must be a whole number from 0, got -1'):
        episode.reset(-1)
    with pytest.raises(ModelError, match='whole number of timesteps of 0.002 s, got 0.0033 s'):
        Episode(episode.task, episode.simulation, 0.0033)
    with pytest.raises(ModelError, match='whole number of timesteps'):
        Episode(episode.task, episode.simulation, float('nan'))
    with pytest.raises(ModelError, match=r'timesteps above 0 s, got 0 s'):
        Episode(episode.task, episode.simulation, 0.0)
    with pytest.raises(ModelError, match=r'got 0\.0011 s; the nearest are 0\.001 or 0\.002 s'):
        Setting('reach', control_hz=100.0, latency=0.0011,
                composition={'timestep_s': 0.001}).create_episode()
    with pytest.raises(UnknownNameError, match="task 'pick_cub': did you mean 'pick_cube'"):
        create_task('pick_cub')
    with pytest.raises(UnknownNameError, match='unknown robot'):
        create_task('reach', 'Pandda')


@pytest.mark.full
@pytest.mark.parametrize('name, robot, text', [
    *((name, 'GR1', f'{name}: GR1 cannot do it, its hands do not reach the middle of the table')
      for name in task_names()),
    ('hand_over', 'Jaco', 'hand_over: Jaco cannot do it, its fingers need 3 s to close')])
def test_a_robot_that_cannot_do_a_task_where_it_stands_is_rejected(name, robot, text):
    with pytest.raises(ModelError, match=text) as error:
        create_task(name, robot)
    able = str(error.value).partition('own grippers: ')[2].split(', ')
    assert {*ARMS, 'Baxter', 'PandaOmron'} <= {*able} and robot not in able


def test_a_robot_that_does_not_reach_the_table_can_stand_nearer():
    assert create_task('reach', 'GR1', position=[-0.3, 0.0, 0.0]).robot.name == 'GR10'


@pytest.mark.full
@pytest.mark.parametrize('name, robot', [
    ('insert_peg', 'Jaco'), ('reach', 'Jaco'), ('wipe_table', 'PandaOmron'),
    ('hand_over', 'Baxter'), ('pick_from_belt', 'PandaOmron')])
def test_experts_of_other_robots_do_tasks(name, robot):
    episode = episode_of(name, robot)
    assert episode.run(episode.task.expert(episode.simulation), 1)


def test_a_robot_that_cannot_do_a_task_is_told_those_that_can():
    with pytest.raises(ModelError, match=(
            'pick_cube needs 1 arm with grippers that grasp, Panda has 0 here; '
            'these can do it with their own grippers: .*UR5e')):
        create_task('pick_cube', 'Panda', 'none')
    with pytest.raises(ModelError, match='pick_cube needs 1 arm with grippers that grasp'):
        create_task('pick_cube', 'Panda', 'WipingGripper')


def test_a_class_of_ones_own_is_a_task_by_its_name():
    class Wave(type(create_task('reach'))):
        name = 'wave'

    try:
        assert isinstance(create_task('wave', 'UR5e'), Wave) and 'wave' in task_names()
    finally:
        del TASKS._classes['wave']
    assert issubclass(Wave, Task)


def test_the_numbers_of_numpy_that_a_task_returns_become_those_of_python():
    class Numbers(type(create_task('reach'))):
        name = 'numbers'

        def success(self, simulation):
            return simulation.time_s > np.float64(0.07)

        def reward(self, simulation):
            return np.float32(0.5)

    try:
        task = create_task('numbers')
        episode = Episode(task, Simulation(task.world))
        episode.reset(0)
        for _ in range(2):
            json.dumps([episode.success, episode.reward])
            assert episode.success is False
            episode.step(np.zeros(7))
        assert episode.success is True and type(episode.reward) is float
    finally:
        del TASKS._classes['numbers']
