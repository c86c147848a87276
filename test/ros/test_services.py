# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Services that control the simulation."""

import subprocess
import sys
import threading

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from harness import START_S
import numpy as np
from pages import blocks, PAGES
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
import yaml

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
#: A node in a process that cannot import the package.
WITHOUT = """
import sys
sys.modules['simulation_interfaces'] = None
import rclpy
from manip_sim.ros.sim_node import SimNode
rclpy.init()
node = SimNode()
print(*(service.srv_name for service in node.services))
node.destroy_node()
rclpy.shutdown()
"""


def nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def pause(client, paused):
    return client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=paused))


def set_parameter(client, name, value):
    parameter = Parameter(name, value=value).to_parameter_msg()
    request = SetParameters.Request(parameters=[parameter])
    return client.call(SetParameters, 'manip_sim/set_parameters', request).results[0]


def trigger(client, name):
    return client.call(Trigger, f'manip_sim/{name}')


@pytest.mark.full
@pytest.mark.parametrize('stepping', ['realtime', 'free', 'lockstep'])
def test_pause_is_idempotent_and_step_advances_by_one_period(stepping, serve, client):
    serve(stepping=stepping)
    states = client.listen(JointState, 'joint_states', 1)
    client.spin_until(lambda: len(states) > 0)
    rejected = trigger(client, 'step')
    assert not rejected.success
    assert 'pause it first' in rejected.message
    assert pause(client, True).success
    again = pause(client, True)
    assert again.success and again.message == 'already paused'
    before = trigger(client, 'step')
    assert before.success
    client.spin_until(lambda: len(states) > 0)
    client.executor.spin_once(timeout_sec=0.2)
    last = nanoseconds(states[-1])
    for n in (1, 2, 3):
        assert trigger(client, 'step').success
        client.spin_until(lambda n=n: nanoseconds(states[-1]) == last + n * 10_000_000)
    assert pause(client, False).success


def test_start_paused_waits_at_the_first_instant(serve, client):
    serve(start_paused=True)
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) > 1)
    assert {nanoseconds(state) for state in states} == {10_000_000}
    trigger(client, 'step')
    client.spin_until(lambda: nanoseconds(states[-1]) == 20_000_000)


def test_a_command_that_came_while_paused_is_used_by_the_next_step(serve, client):
    node = serve(start_paused=True)
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    for _ in range(8):
        trigger(client, 'step')
    assert node.simulation.robot.state().position[0] > 0.01


@pytest.mark.full
def test_reset_puts_the_robot_back_while_time_goes_on(serve, client):
    node = serve(arena='table')
    start = client.state()
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    client.spin_until(lambda: client.state().position[0] > 0.45)
    assert trigger(client, 'reset').success
    after = client.state()
    assert nanoseconds(after) > nanoseconds(start)
    np.testing.assert_allclose(after.position, start.position, atol=1e-3)
    assert not node.simulation.robot.grippers['right/gripper'].moving


def test_commands_that_wait_are_dropped_by_a_reset(serve, client):
    node = serve(start_paused=True)
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    trigger(client, 'reset')
    for _ in range(5):
        trigger(client, 'step')
    assert abs(node.simulation.robot.state().position[0]) < 1e-4


@pytest.mark.full
@pytest.mark.parametrize('kind, name', [
    (Trigger, 'reset'), (Trigger, 'save_state'), (SetBool, 'pause')])
def test_a_command_that_came_before_a_call_takes_effect_before_it(serve, client, kind, name):
    node = serve()
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.1]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    take, begun, goes_on = node.shared.inbox._take, threading.Event(), threading.Event()

    def taken_slowly(subscription):
        begun.set()
        assert goes_on.wait(START_S)
        take(subscription)
    node.shared.inbox._take = taken_slowly
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
    client.spin_until(begun.is_set)
    caller = client.node.create_client(kind, f'manip_sim/{name}')
    client.spin_until(caller.service_is_ready)
    answer = caller.call_async(kind.Request())
    for _ in range(20):
        client.executor.spin_once(timeout_sec=0.02)
        assert not answer.done()
    goes_on.set()
    client.spin_until(answer.done)
    assert answer.result().success
    assert node.commands.robots[0].statistics['arm'].accepted == 2
    if name == 'reset':
        client.settled(lambda: node.simulation.time_ns > 0)
        assert abs(node.simulation.robot.state().position[0]) < 1e-3


def test_a_diverged_simulation_is_held_told_and_mended_by_reset(serve, client):
    log = client.log()
    node = serve()
    client.state()

    def explode():
        node.simulation.data.qvel[0] = 1e9
    node.thread.call(explode)
    client.spin_until(lambda: any('the physics diverged' in line for line in log))
    state = client.state()
    assert np.isfinite([state.position, state.velocity, state.effort]).all()
    assert nanoseconds(client.state()) == nanoseconds(client.state())
    assert 'reset it first' in trigger(client, 'step').message
    pause(client, True)
    assert 'reset it first' in trigger(client, 'step').message
    assert trigger(client, 'reset').success
    pause(client, False)
    first = client.state()
    client.spin_until(lambda: nanoseconds(client.state()) > nanoseconds(first))


@pytest.mark.full
def test_a_held_simulation_repeats_its_state_and_leaves_the_machine_alone(serve, client):
    node = serve(stepping='free')
    client.state()

    def explode():
        node.simulation.data.qvel[0] = 1e9
    node.thread.call(explode)
    client.spin_until(lambda: node.simulation.diverged is not None)
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) >= 5)
    assert len({nanoseconds(state) for state in states[-5:]}) == 1
    shown = []
    node.thread.observe(shown.append)
    count = len(states)
    client.spin_until(lambda: len(states) >= count + 5)
    assert len(shown) < 20
    assert trigger(client, 'reset').success
    client.spin_until(lambda: nanoseconds(states[-1]) > nanoseconds(states[0]))


def test_tare_lets_the_external_wrench_read_zero(serve, client):
    node = serve()
    wrenches = client.listen(WrenchStamped, 'right/external_wrench')

    def push():
        body = node.simulation.model.body('gripper0_right_right_gripper').id
        node.simulation.data.xfrc_applied[body, 2] = 5.0

    def norm(message):
        force = message.wrench.force
        return np.linalg.norm([force.x, force.y, force.z])
    node.thread.call(push)
    client.spin_until(lambda: bool(wrenches) and abs(norm(wrenches[-1]) - 5.0) < 0.1)
    assert trigger(client, 'tare_wrench').success
    client.spin_until(lambda: norm(wrenches[-1]) < 0.05)


@pytest.mark.full
def test_without_simulation_interfaces_only_its_services_are_missing():
    done = subprocess.run([sys.executable, '-c', WITHOUT], capture_output=True, text=True,
                          check=True, timeout=300.0)
    assert '~/reset' in done.stdout
    assert 'get_entities' not in done.stdout
    assert 'simulation_interfaces' not in done.stdout + done.stderr


def test_parameters_change_while_the_node_runs(serve, client):
    node = serve()
    state = client.state()

    def set_parameter(name, value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return client.call(SetParameters, 'manip_sim/set_parameters', request).results[0]
    assert set_parameter('control_mode.arm', 'effort').successful
    client.spin_until(lambda: node.simulation.robot.joints.mode_of('robot0_joint1') == 'effort')
    np.testing.assert_allclose(client.state().position, state.position, atol=1e-3)
    assert set_parameter('real_time_factor', 2).successful
    wrong = set_parameter('control_mode.arm', 'torque')
    assert not wrong.successful and 'effort' in wrong.reason
    fixed = set_parameter('robot', 'Panda')
    assert not fixed.successful


def test_a_call_to_a_simulation_that_has_ended_is_rejected(serve, client):
    node = serve()
    client.state()
    node.stop()
    assert trigger(client, 'reset').message == 'the simulation has ended'


@pytest.mark.full
@pytest.mark.parametrize('stepping', ['realtime', 'lockstep'])
def test_a_reflex_stops_an_arm_which_refuses_commands_until_it_is_reset(stepping, serve, client):
    log = client.log()
    node = serve(stepping=stepping, reflex__arm__velocity=0.05)
    arrays = client.listen(DiagnosticArray, '/diagnostics')
    statistics, robot = node.commands.robots[0].statistics['arm'], node.simulation.robot

    def go():
        client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[1.0]))

    def send_until(condition):
        def cycle():
            go()
            return condition()
        client.spin_until(cycle)
    send_until(lambda: bool(robot.reflexes.tripped))
    send_until(lambda: statistics.rejected > 20)
    assert 0.0 < robot.state().position[0] < 0.2
    assert np.abs(robot.state().velocity).max() < 0.01
    client.spin_until(lambda: any('was stopped by a reflex: the velocity' in line for line in log))
    client.spin_until(lambda: any(
        status.level == DiagnosticStatus.ERROR and 'call ~/reset_reflex' in status.message
        for array in arrays for status in array.status))
    assert trigger(client, 'reset_reflex').success
    before = statistics.rejected
    set_parameter = Parameter('reflex.arm.velocity', value=0.0)
    (result,) = node.set_parameters([set_parameter])
    assert result.successful
    assert statistics.rejected == before
    send_until(lambda: robot.state().position[0] > 0.5)


@pytest.mark.full
def test_a_saved_state_is_restored_to_the_last_bit_while_time_goes_on(serve, client):
    node = serve(arena='table', start_paused=True)
    states = client.listen(JointState, 'joint_states')
    client.publish('arm/joint_trajectory', JointTrajectory(joint_names=[ARM[0]], points=[
        JointTrajectoryPoint(positions=[0.5], time_from_start=Duration(sec=1))]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)

    def steps():
        for _ in range(10):
            assert trigger(client, 'step').success
        last = node.simulation.time_ns
        client.spin_until(lambda: states and nanoseconds(states[-1]) == last)
        return states[-1]

    steps()
    digest = trigger(client, 'save_state').message
    assert digest.startswith('mujoco-')
    first = steps()
    assert trigger(client, 'restore_state').message == digest
    again = steps()
    assert again.position == first.position and again.effort == first.effort
    assert nanoseconds(again) == nanoseconds(first) + 110_000_000
    assert again.position[0] > 0.01


def test_without_a_saved_state_nothing_is_restored(serve, client):
    node = serve(start_paused=True)
    before = node.simulation.robot.state().position
    answer = trigger(client, 'restore_state')
    assert not answer.success and answer.message == 'no state has been saved'
    np.testing.assert_array_equal(node.simulation.robot.state().position, before)


def test_a_diverged_simulation_keeps_the_state_that_was_saved_before(serve, client):
    node = serve(start_paused=True)
    digest = trigger(client, 'save_state').message
    node.thread.call(lambda: node.simulation.data.qvel.fill(1e9))
    trigger(client, 'step')
    answer = trigger(client, 'save_state')
    assert not answer.success and 'the physics diverged' in answer.message
    assert 'the state saved before is kept' in answer.message
    assert trigger(client, 'restore_state').message == digest


def test_a_new_seed_draws_the_start_anew_at_the_next_reset(serve, client):
    serve(start_paused=True, seed=3, **{'initialization_noise.magnitude': 0.1})

    def start(seed):
        assert set_parameter(client, 'seed', seed).successful
        assert trigger(client, 'reset').success
        return client.state().position

    first = client.state().position
    other = start(4)
    assert list(start(3)) == list(first) != list(other)
    assert list(start(4)) == list(other)


def test_an_emergency_stop_is_told_and_lasts_until_recovery(serve, client):
    node = serve()
    states = client.listen(String, 'manip_sim/safety_state', QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def told(state):
        client.spin_until(lambda: bool(states) and states[-1].data == state)
    told('running')
    assert trigger(client, 'emergency_stop').success
    told('emergency_stop')
    answer = trigger(client, 'reset_reflex')
    assert not answer.success and 'call recover' in answer.message
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], position=[0.5]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].rejected == 1)
    assert trigger(client, 'recover').success
    told('running')


@pytest.mark.full
def test_a_goal_passes_the_limits_that_the_page_for_agents_sets(serve, client):
    (page,) = [page for page in PAGES if page.stem == 'agents']
    (file,) = [yaml.safe_load(block.text) for block in blocks(page) if block.file == 'safe.yaml']
    node = serve(stepping='free')
    given = {}
    for name, value in file['/**']['ros__parameters'].items():
        if name in ('robot', 'arena'):
            given[name] = value
        else:
            (changed,) = node.set_parameters([Parameter(name, value=value)])
            assert changed.successful, changed.reason
    assert given == {'robot': 'Panda', 'arena': 'table'}
    robot = node.simulation.robot

    def ended():
        """Send the goal again, as it ends with its timeout."""
        client.publish('joint_command', JointState(name=['robot0_joint1'], position=[1.0]))
        return bool(robot.reflexes.tripped) or abs(robot.state().position[0] - 1.0) < 1e-3
    client.spin_until(ended)
    assert not robot.reflexes.tripped
