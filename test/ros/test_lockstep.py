# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Physics that advances with the commands of a controller in another process."""

import hashlib
import math
from pathlib import Path
import subprocess
import sys
from threading import Event

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from harness import Client, START_S
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.errors import CommandError
from manip_sim.ros.channel_publishers import Publication

CYCLES = 250
PERIOD_NS = 2_000_000
BUSY = 'import time; end = time.time() + 120\nwhile time.time() < end: pass'


def nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def drive_by_effort(client, cycles):
    """Run a PD controller that answers each state once, and hash all states."""
    publisher = client.publisher(JointState, 'arm/joint_command', 1)
    digest = hashlib.sha256()
    seen = []
    goal = np.array([0.3, 0.5, -0.2, -2.0, 0.2, 2.4, 0.5])
    stiffness = np.array([200.0, 200.0, 150.0, 150.0, 40.0, 40.0, 20.0])

    def answer(state):
        if seen and nanoseconds(state) <= seen[-1]:
            return
        seen.append(nanoseconds(state))
        position, velocity = np.array(state.position), np.array(state.velocity)
        for values in (position, velocity, np.array(state.effort)):
            digest.update(values.tobytes())
        effort = stiffness * (goal - position) - 0.2 * stiffness * velocity
        command = JointState(name=state.name, effort=effort.tolist())
        command.header.stamp = state.header.stamp
        publisher.publish(command)

    client.node.create_subscription(JointState, 'arm/joint_states', answer, 10)
    client.spin_until(lambda: len(seen) >= cycles)
    assert seen[:cycles] == [(n + 1) * PERIOD_NS for n in range(cycles)]
    return digest.hexdigest()


def run(sim_process, client_factory):
    node = sim_process('stepping:=lockstep', 'control_mode.arm:=effort', 'publish_rate:=500')
    client = client_factory()
    try:
        return drive_by_effort(client, CYCLES)
    finally:
        client.close()
        node.terminate()
        node.wait(timeout=300.0)


@pytest.mark.full
@pytest.mark.timeout(300)
def test_the_same_controller_gives_the_same_states_to_the_last_bit(sim_process):
    quiet = run(sim_process, Client)
    busy = subprocess.Popen([sys.executable, '-c', BUSY])
    try:
        loaded = run(sim_process, Client)
    finally:
        busy.kill()
        busy.wait()
    assert quiet == loaded


@pytest.mark.full
def test_a_state_is_repeated_until_the_command_comes(serve, client):
    serve(stepping='lockstep')
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) >= 3)
    # A stamp of zero would mean none, so the first state is that after one period.
    assert {nanoseconds(state) for state in states} == {10_000_000}
    client.publish('arm/command', Float64MultiArray(data=[0.0] * 7))
    client.spin_until(lambda: nanoseconds(states[-1]) == 20_000_000)


def test_a_command_for_another_instant_does_not_count(serve, client):
    log = client.log()
    node = serve(stepping='lockstep')
    stale = JointState(name=['robot0_joint1'], position=[0.1])
    stale.header.stamp.sec = 7
    client.publish('arm/joint_command', stale)
    client.spin_until(lambda: any('the present state is that of' in line for line in log))
    assert node.simulation.step_count == 5
    assert node.commands.robots[0].statistics['arm'].rejected == 1


def test_every_lockstep_part_needs_a_command(serve, client):
    node = serve(stepping='lockstep', lockstep_parts=['arm', 'right/gripper'])
    client.publish('arm/command', Float64MultiArray(data=[0.0] * 7))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    client.state()
    assert node.simulation.step_count == 5
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    client.spin_until(lambda: node.simulation.step_count == 10)


def run_two_controllers(sim_process, cycles):
    """Run a controller for each arm of Baxter in lock-step, each in its process."""
    node = sim_process('stepping:=lockstep', 'robot:=Baxter')
    script = str(Path(__file__).with_name('arm_controller.py'))
    controllers = [subprocess.Popen([sys.executable, script, arm, str(cycles)], text=True,
                                    stdout=subprocess.PIPE) for arm in ('right', 'left')]
    client = Client()
    diagnostics = client.listen(DiagnosticArray, '/diagnostics')
    try:
        client.spin_until(lambda: all(c.poll() is not None for c in controllers))
        count = len(diagnostics)
        client.spin_until(lambda: len(diagnostics) > count + 1)
        values = {value.key: value.value for status in diagnostics[-1].status
                  if status.name.endswith(('right', 'left')) for value in status.values}
        return [c.communicate()[0].split() for c in controllers], values['dropped']
    finally:
        client.close()
        for process in (*controllers, node):
            process.kill()
            process.wait()


@pytest.mark.full
@pytest.mark.timeout(300)
def test_two_controllers_of_one_arm_each_lose_nothing_and_repeat_to_the_last_bit(sim_process):
    cycles = CYCLES // 2
    runs = [run_two_controllers(sim_process, cycles) for _ in range(2)]
    for reports, dropped in runs:
        assert dropped == '0'
        for first, last, _ in reports:
            assert (int(first), int(last)) == (10_000_000, cycles * 10_000_000)
    assert runs[0] == runs[1]


def test_a_second_answer_to_a_state_is_stale(serve, client):
    log = client.log()
    node = serve(stepping='lockstep', lockstep_parts=['right', 'right/gripper'])
    answer = JointState(name=['robot0_joint1'], position=[0.1])
    answer.header.stamp.nanosec = 10_000_000
    client.publish('arm/joint_command', answer)
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    client.spin_until(lambda: node.simulation.step_count == 10)
    client.publish('arm/joint_command', answer)
    client.spin_until(lambda: any('answers the state of 0.01' in line for line in log))
    assert node.simulation.step_count == 10


def test_an_answer_that_comes_while_its_period_runs_is_stale(serve, client):
    node = serve(stepping='lockstep')
    entered, released = Event(), Event()
    advance = node.simulation.advance

    def held(steps):
        entered.set()
        assert released.wait(START_S)
        advance(steps)
    node.simulation.advance = held
    answer = JointState(name=['robot0_joint1'], position=[0.1])
    answer.header.stamp.nanosec = 10_000_000
    try:
        client.publish('arm/joint_command', answer)
        assert entered.wait(START_S)
        client.publish('arm/joint_command', answer)
    finally:
        released.set()
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].rejected == 1)
    client.state()
    assert node.simulation.step_count == 10
    # Late answers are told from early ones.
    with pytest.raises(CommandError, match=r'answers the state of 0\.010000000 s, the present '
                                           r'state is that of 0\.020000000 s$'):
        node.thread.submit([], 10_000_000)


def test_a_reset_has_a_stamp_of_its_own_and_makes_answers_to_older_ones_stale(serve, client):
    node = serve(stepping='lockstep')
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: bool(states))
    assert client.call(Trigger, 'manip_sim/reset').success
    client.spin_until(lambda: nanoseconds(states[-1]) == 20_000_000)
    statistics = node.commands.robots[0].statistics['arm']
    answer = JointState(name=['robot0_joint1'], position=[0.1])
    answer.header.stamp.nanosec = 10_000_000
    client.publish('arm/joint_command', answer)
    client.spin_until(lambda: statistics.rejected == 1)
    answer.header.stamp.nanosec = 20_000_000
    client.publish('arm/joint_command', answer)
    client.spin_until(lambda: nanoseconds(states[-1]) == 30_000_000)


def test_a_trajectory_is_the_command_of_its_part_until_it_ends(serve, client):
    node = serve(stepping='lockstep')
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[JointTrajectoryPoint(
            positions=[0.2], time_from_start=Duration(nanosec=500_000_000))]))
    client.spin_until(lambda: node.simulation.step_count >= 255)
    client.state()
    # Then the part waits for its next command.
    assert node.simulation.step_count == 255
    assert abs(node.simulation.robot.state().position[0] - 0.2) < 0.01


def test_a_late_client_sees_a_paused_state(serve, client):
    serve(start_paused=True)
    assert nanoseconds(client.state()) == 10_000_000


@pytest.mark.full
@pytest.mark.parametrize('position', [[], [math.nan]])
def test_names_without_a_number_answer_for_their_part_and_it_goes_on(position, serve, client):
    node = serve(stepping='lockstep', lockstep_parts=['arm', 'right/gripper'])
    states = client.listen(JointState, 'joint_states')

    def answered(count):
        client.spin_until(lambda: bool(states)
                          and states[-1].header.stamp.nanosec == 10**7 * count)
        return states[-1].header.stamp
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], position=[0.3]))
    answered(2)
    for count in range(2, 40):
        answer = JointState(name=['robot0_joint1'], position=position)
        answer.header.stamp = answered(count)
        client.publish('arm/joint_command', answer)
        fingers = JointState(name=['gripper0_right_finger_joint1'])
        fingers.header.stamp = answer.header.stamp
        client.publish('joint_command', fingers)
    answered(40)
    assert node.simulation.robot.state().position[0] > 0.1
    assert not any(s.rejected for s in node.commands.robots[0].statistics.values())


def test_publishers_are_asked_for_subscribers_once_some_have_come_not_for_each_state(
        serve, client, monkeypatch):
    asked, look = [], Publication.look
    monkeypatch.setattr(
        Publication, 'look', lambda publication: asked.append(publication) or look(publication))
    serve(stepping='lockstep')
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) > 5)
    asked.clear()
    client.spin_until(lambda: len(states) > 10)
    assert not asked
    wrenches = client.listen(WrenchStamped, 'right/wrench')
    client.spin_until(lambda: wrenches)
    assert asked
