# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""When control periods come: after a pause, while nothing moves, as fast as possible."""

import statistics
import time

from builtin_interfaces.msg import Duration
from harness import START_S
import numpy as np
import pytest
from rclpy.duration import Duration as WaitDuration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


def listen_with_times(client):
    """Return a list that is filled with wall time [s] and simulation time [ns] of each clock."""
    ticks = []
    client.node.create_subscription(Clock, '/clock', lambda m: ticks.append(
        (time.monotonic(), m.clock.sec * 10**9 + m.clock.nanosec)), 1000)
    client.spin_until(lambda: bool(ticks))
    return ticks


def wait(client, seconds):
    """Take in what comes for so long, because the time itself is what is tested."""
    end = time.monotonic() + seconds
    client.spin_until(lambda: time.monotonic() > end)


def until_next_period(client, ticks, last_ns, begin_s):
    """Return how long after an instant the period came that follows a simulation time [s]."""
    client.spin_until(lambda: ticks[-1][1] > last_ns)
    return next(wall_s for wall_s, time_ns in ticks if time_ns > last_ns) - begin_s


def test_a_node_pauses_at_the_time_that_it_was_started_with(serve, client):
    node = serve(stepping='free', pause_at=0.205)
    client.spin_until(lambda: node.thread.paused)
    assert node.simulation.time_ns == 210_000_000


def test_time_that_passed_in_a_pause_is_not_made_up_for(serve, client):
    node = serve(publish_rate=2.0)
    ticks = listen_with_times(client)
    client.spin_until(lambda: len(ticks) > 1)
    node.thread.pause(True)
    wait(client, 0.7)
    last_ns, begin_s = node.simulation.time_ns, time.monotonic()
    node.thread.pause(False)
    # The deadline that the pause swallowed is past; the next one is a whole period from now.
    assert until_next_period(client, ticks, last_ns, begin_s) > 0.49


def test_the_state_after_a_reset_lasts_a_whole_period(serve, client):
    node = serve(publish_rate=2.0)
    ticks = listen_with_times(client)
    seen = len(ticks)
    client.spin_until(lambda: len(ticks) > seen)
    wait(client, 0.3)

    def reset():
        """Return the simulation time of the state after it: no period comes in between."""
        node.thread.reset()
        return node.simulation.time_ns
    begin_s = time.monotonic()
    assert until_next_period(client, ticks, node.thread.call(reset), begin_s) > 0.49


@pytest.mark.full
@pytest.mark.parametrize('how', [{'start_paused': True}, {'stepping': 'lockstep'}])
def test_a_state_is_repeated_ten_times_a_second(how, serve, client):
    node = serve(**how)
    ticks, shown, waits = listen_with_times(client), [], []
    sleep = node.thread._inbox.wait
    node.thread._inbox.wait = lambda timeout_s: (waits.append(timeout_s), sleep(timeout_s))
    node.thread.observe(lambda _: shown.append(time.monotonic()))
    client.spin_until(lambda: len(ticks) > 12 and len(shown) > 12)
    assert len({time_ns for _, time_ns in ticks}) == 1
    # A busy machine may be late, and early after that, but does not wait for longer.
    assert statistics.median(
        after - before for before, after in zip(shown[1:], shown[2:])) > 0.09
    assert 0.05 < max(waits) <= 0.1


@pytest.mark.full
def test_free_stepping_waits_for_nothing(serve, client):
    node = serve(stepping='free')
    client.listen(JointState, 'joint_states')
    client.state()
    advance, calls, waits = node.simulation.advance, [], []
    node.simulation.advance = lambda steps: (calls.append(steps), advance(steps))
    node.thread._inbox.wait = waits.append
    client.spin_until(lambda: len(calls) > 300)
    assert not waits


def test_ten_commands_at_once_are_all_taken(serve, client):
    node = serve()
    publisher = client.publisher(JointState, 'joint_command')
    accepted = node.commands.robots[0].statistics['joint_command']
    for burst in range(1, 4):
        released = []
        # The executor takes nothing meanwhile, as if the machine were busy.
        node.executor.create_task(lambda done=released: until(lambda: done))
        for n in range(10):
            publisher.publish(JointState(name=[f'robot0_joint{n % 7 + 1}'],
                                         position=[0.01 * burst]))
        assert publisher.wait_for_all_acked(WaitDuration(seconds=10))
        released.append(True)
        client.spin_until(lambda n=burst: accepted.accepted == 10 * n)


@pytest.mark.parametrize('service', ['reset', 'step'])
def test_trajectories_that_came_before_a_call_are_taken_before_it(service, serve, client):
    node = serve(start_paused=True)
    publisher = client.publisher(JointTrajectory, 'arm/joint_trajectory')
    call = client.node.create_client(Trigger, f'manip_sim/{service}')
    client.spin_until(call.service_is_ready)
    released = []
    node.executor.create_task(lambda: until(lambda: released))
    for number in (1, 2, 3):
        publisher.publish(JointTrajectory(
            joint_names=[f'robot0_joint{number}'], points=[JointTrajectoryPoint(
                positions=[0.2], time_from_start=Duration(nanosec=100_000_000))]))
    assert publisher.wait_for_all_acked(WaitDuration(seconds=10))
    answer = call.call_async(Trigger.Request())
    wait(client, 0.3)  # The request has to come while the executor is busy.
    released.append(True)
    client.spin_until(answer.done)
    assert node.commands.robots[0].statistics['arm'].accepted == 3
    node.thread.step()
    assert len(node.simulation.robot.joints.busy_parts) == (service == 'step')


def until(condition):
    end = time.monotonic() + START_S
    while not condition():
        assert time.monotonic() < end, 'timed out'
        time.sleep(0.001)


@pytest.mark.full
def test_a_trajectory_with_a_stamp_ahead_starts_at_that_instant(serve, client):
    node = serve(start_paused=True)
    start = node.simulation.robot.state().position[0]
    message = JointTrajectory(joint_names=['robot0_joint1'], points=[JointTrajectoryPoint(
        positions=[start + 0.2], velocities=[0.0],
        time_from_start=Duration(nanosec=500_000_000))])
    message.header.stamp.nanosec = 310_000_000
    client.publish('arm/joint_trajectory', message)
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    way = {}
    for _ in range(100):
        node.thread.step()
        way[node.simulation.time_ns] = node.simulation.robot.state().position[0] - start
    assert abs(way[310_000_000]) < 1e-4
    # The smooth step of a cubic, which the servo follows within a hundredth of the way.
    for part in (0.1, 0.3, 0.5, 0.7, 1.0):
        expected = 0.2 * (3.0 * part**2 - 2.0 * part**3)
        assert way[310_000_000 + round(part * 50) * 10_000_000] == pytest.approx(
            expected, abs=0.002)
    assert np.diff(list(way.values())).min() > -1e-4


def test_a_start_that_is_paused_is_told(serve, client):
    log = client.log()
    serve(start_paused=True)
    client.spin_until(lambda: any('paused until ~/pause is called' in line for line in log))


def test_commands_that_came_before_a_step_count_in_it(serve, client):
    node = serve(start_paused=True)
    client.state()
    # The thread that takes commands is late, and takes none by itself.
    node.shared.inbox.wait = lambda timeout_s: time.sleep(0.01)
    publisher = client.publisher(JointState, 'joint_command')
    for goal in (0.3, -0.2, 0.4):
        publisher.publish(JointState(name=['robot0_joint1'], position=[goal]))
        assert publisher.wait_for_all_acked()
        client.call(Trigger, 'manip_sim/step')
        (command,) = node.simulation.robot.joints.commands.running
        assert command.values.tolist() == [goal]
    publisher.publish(JointState(name=['robot0_joint1'], position=[0.1]))
    assert publisher.wait_for_all_acked()
    client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=True))
    assert node.thread.call(lambda: node.simulation.robot.joints.commands.running) == [command]
    client.call(Trigger, 'manip_sim/step')
    assert node.simulation.robot.joints.commands.running[0].values.tolist() == [0.1]
