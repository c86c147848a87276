# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Compiled control and physics of a period: the same bits as interval by interval."""

import mujoco
import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.control.law import stepping
from manip_sim.control.law.stepping import may_step, notes_of
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.simulation.control_period import ControlPeriods

STEPS = 10
PERIOD_S = 0.02


def states_of(name, mode, periods, act):
    """
    Return what is measured after each period, and what has become of commands at the end.

    :param act: is called before each period with robot, its number and random numbers
    """
    simulation = Simulation(compose(name, arena='table', cube=True))
    robot, draw, found = simulation.robot, np.random.default_rng(0), []
    robot.set_control_mode('arm', mode)
    handles = []
    for period in range(periods):
        commands = act(robot, period, draw)
        robot.apply(*commands, period_s=PERIOD_S)
        handles += [command.handle for command in commands]
        simulation.advance(STEPS)
        effectors = robot.state().end_effectors
        found.append((simulation.digest(), repr(effectors), int(simulation.data.ncon)))
    reports = robot.joints.cartesian.reports
    return found, [(handle.status, repr(handle.error)) for handle in handles], [
        (report.counts, report.texts) for report in reports.values()]


def press_and_grip(robot, period, draw):
    """Lead the end effectors down to a table and along it, and close and open the grippers."""
    commands = []
    if period % 3 == 0:
        for arm in robot.end_effectors:
            action = np.clip(0.3 * draw.normal(size=6) - [0, 0, 1.5, 0, 0, 0], -1.0, 1.0)
            commands.append(robot.parse_cartesian.action(arm, action))
    if period % 20 == 15:
        commands += [robot.parse.action(gripper, [1.0 if period < 40 else -1.0]
                                        * robot.grippers[gripper].dof)
                     for gripper in robot.grippers]
    return commands


@pytest.fixture
def runs(monkeypatch):
    """Return a list that grows by how many robots compiled code runs in a part of a period."""
    begun, lets = [], ControlPeriods._lets_laws_step

    def counted(periods, awake):
        by_law = lets(periods, awake)
        if awake:
            begun.append(len(awake) if by_law else 0)
        return by_law
    monkeypatch.setattr(ControlPeriods, '_lets_laws_step', counted)
    return begun


def by_python(monkeypatch):
    """Let Python control each interval and make each step."""
    monkeypatch.setattr(ControlPeriods, '_lets_laws_step', lambda periods, awake: False)


@pytest.mark.parametrize('mode', ['effort', 'position'])
@pytest.mark.parametrize('name', ['Panda', 'Baxter', *(
    pytest.param(name, marks=pytest.mark.full) for name in (
        'UR5e', 'Jaco', 'IIWA', 'SO101', 'Sawyer', 'Kinova3', 'XArm7', 'FR3', 'Tiago'))])
def test_compiled_periods_are_those_of_python_steps_to_the_last_bit(name, mode, monkeypatch, runs):
    found = states_of(name, mode, 60, press_and_grip)
    assert runs.count(1) >= 60 and not runs.count(0)
    by_python(monkeypatch)
    assert found == states_of(name, mode, 60, press_and_grip)
    states, ends, _ = found
    assert len({effectors for _, effectors, _ in states}) > 5
    assert len({digest for digest, *_ in states}) == 60 and len(set(ends)) > 1


def reach(robot, period, draw):
    """Let end effectors come to poses and rest there, near and out of reach."""
    if period % 40 or period > 80:
        return []
    pose = robot.state().end_effectors['right'].pose
    far = 2.0 if period == 80 else 0.1
    return [robot.parse_cartesian.pose('right', pose.position + far * draw.normal(size=3),
                                       pose.quat_xyzw)]


@pytest.mark.full
@pytest.mark.parametrize('mode', ['effort', 'position', 'velocity'])
def test_targets_that_are_reached_or_missed_are_told_as_by_python_steps(mode, monkeypatch, runs):
    found = states_of('Panda', mode, 280, reach)
    assert runs.count(1) > 100
    by_python(monkeypatch)
    assert found == states_of('Panda', mode, 280, reach)
    _, ends, ((counts, _),) = found
    assert Status.DONE in {status for status, _ in ends} and counts['unreachable']


def follow(robot, period, draw):
    """Follow trajectories, some of which begin later, take joints of others or end in a period."""
    if period % 30:
        return []
    names = robot.joints.names[:7]
    positions = robot.joints.setpoints.position[:7] + 0.1 * draw.normal(size=(3, 7))
    times = np.cumsum(draw.uniform(0.05, 0.2, 3))
    if period == 60:
        names, positions = names[:3], positions[:, :3]
    begin_ns = robot._clock.time_ns + 33_000_000 if period % 60 else 0
    return [robot.parse.trajectory('arm', names, times, positions, start_ns=begin_ns)]


@pytest.mark.parametrize('name', ['Panda', pytest.param('Tiago', marks=pytest.mark.full)])
def test_trajectories_are_those_of_python_steps_to_the_last_bit(name, monkeypatch, runs):
    found = states_of(name, 'position', 105, follow)
    assert runs.count(1) > 80 and not runs.count(0)
    by_python(monkeypatch)
    assert found == states_of(name, 'position', 105, follow)
    assert Status.DONE in {status for status, _ in found[1]}


def drive(robot, period, draw):
    """Drive a mobile base, now and then, while its arm goes somewhere."""
    commands = []
    if period % 40 < 25 and period % 2 == 0:
        commands.append(robot.parse.twist(*(0.3 * np.sin(0.1 * period + np.arange(3)))))
    if period == 50:
        commands.append(robot.parse.action('base', [0.0, 0.2, 0.1]))
    if period % 30 == 10:
        commands.append(robot.parse.action('right', draw.uniform(-0.2, 0.2, 7)))
    return commands


@pytest.mark.parametrize('name', ['Tiago', pytest.param('PandaOmron', marks=pytest.mark.full)])
def test_bases_drive_as_by_python_steps_to_the_last_bit(name, monkeypatch, runs):
    found = states_of(name, 'position', 120, drive)
    assert runs.count(1) > 100 and not runs.count(0)
    by_python(monkeypatch)
    assert found == states_of(name, 'position', 120, drive)


def stream(robot, period, draw):
    """Let end effectors follow twists, then poses, then twists that stop, beyond what they can."""
    arms, phase = list(robot.end_effectors), 0.15 * period
    if period < 25 or 60 <= period < 80:
        return [robot.parse_cartesian.twist(
            arm, 0.2 * np.sin(phase + np.arange(3)), 0.5 * np.cos(phase + np.arange(3)),
            'robot0_base' if period % 2 else '') for arm in arms] if period % 3 else []
    if period < 60 and period % 2:
        found = []
        for arm in arms:
            pose = robot.state().end_effectors[arm].pose
            found.append(robot.parse_cartesian.pose(
                arm, pose.position + 0.02 * np.sin(phase + np.arange(3)), pose.quat_xyzw))
        return found
    return []


@pytest.mark.parametrize('mode', ['effort', 'position'])
@pytest.mark.parametrize('name', ['Panda', *(
    pytest.param(name, marks=pytest.mark.full) for name in ('Baxter', 'Kinova3', 'UR5e'))])
def test_streams_of_end_effectors_are_those_of_python_steps_to_the_last_bit(
        name, mode, monkeypatch, runs):
    found = states_of(name, mode, 100, stream)
    assert runs.count(1) >= 99 and runs.count(0) < 2
    by_python(monkeypatch)
    assert found == states_of(name, mode, 100, stream)
    assert len({digest for digest, *_ in found[0]}) == 100


def wrenches_with_a_payload(every):
    """Return wrenches of some periods, and digests, of an arm that streams and then presses."""
    simulation, found = Simulation(compose('Panda', arena='table', cube=True)), []
    robot, names = simulation.robot, simulation.robot.joints.names[:7]
    home = robot.measured('arm')[:7]
    for period in range(110):
        if period == 5:
            robot.set_payload('right', 0.6, [0.01, 0.02, 0.1], [0.01, 0.0, 0.0, 0.02, 0.0, 0.03])
        if period == 40:
            pose = robot.state().end_effectors['right'].pose
            robot.apply(robot.parse_cartesian.pose(
                'right', [*pose.position[:2], 0.78], pose.quat_xyzw), period_s=PERIOD_S)
        elif period % 2 == 0 and period < 40:
            goal = home + 0.002 * period * np.sin(0.1 * period * np.arange(1, 8))
            robot.apply(*robot.parse.joint_command(names, position=goal), period_s=PERIOD_S)
        simulation.advance(STEPS)
        if period % every == 0:
            wrench = robot.state().end_effectors['right'].external_wrench
            found.append((*wrench.force, *wrench.torque))
        if period % 25 == 0:
            found.append(simulation.digest())
    return found


@pytest.mark.parametrize('every', [1, 7])
def test_a_payload_goes_on_without_python_with_the_bits_of_python_steps(every, monkeypatch, runs):
    found = wrenches_with_a_payload(every)
    # Python looks where commands come, digests are taken, and the arm begins to touch the table.
    assert 0 < len(runs) < 75 and not runs.count(0)
    by_python(monkeypatch)
    assert found == wrenches_with_a_payload(every)
    assert abs(found[-1][2]) > 5.0 and len(set(found)) > 0.9 * len(found)


def test_what_pushes_a_tool_is_not_left_out(runs):
    simulation = Simulation(compose('Panda', arena='table', cube=True))
    robot = simulation.robot
    robot.set_control_mode('arm', 'effort')
    robot.apply(robot.parse_cartesian.action('right', np.zeros(6)), period_s=PERIOD_S)
    simulation.advance(STEPS)
    assert runs == [1]
    (tool,) = simulation.periods._steps.tools
    simulation.data.xfrc_applied[tool.bodies.start, 2] = -1.0
    simulation.advance(STEPS)
    assert len(runs) > 1 and not any(runs[1:])


def test_data_that_is_nearly_full_is_left_to_python():
    model = mujoco.MjModel.from_xml_string('<mujoco/>')
    data = mujoco.MjData(model)
    assert may_step(data)
    data.maxuse_arena = int(0.6 * data.narena)
    assert not may_step(data)


def test_the_number_of_contacts_is_found():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .05"><freejoint/>'
        '<geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>')
    data = mujoco.MjData(model)
    notes = notes_of(data, np.zeros((0, 3), dtype=np.int64), 1)
    assert notes.contacts[0] == 0
    mujoco.mj_forward(model, data)
    assert notes.contacts[0] == data.ncon > 0


def test_a_library_of_mujoco_that_is_not_there_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(mujoco, '__path__', [str(tmp_path)])
    assert stepping._library().mj_step  # By its name, as it is loaded.
    monkeypatch.setattr(mujoco, 'mj_versionString', lambda: '0.0.1')
    with pytest.raises(ImportError, match=r'not in .*, and not known as libmujoco\.so\.0\.0\.1'):
        stepping._library()
