# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The action servers in a running node, with an action type that has wheels: Fibonacci."""

import threading
import time

from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from harness import Client, Served
import pytest
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

pytest.importorskip('test_msgs', reason='test_msgs is not installed')

from test_msgs.action import Fibonacci  # noqa: E402

from manip_sim.ros import executor, sim_node  # noqa: E402
from manip_sim.ros.action_servers import ActionMessages, ActionServers  # noqa: E402
from manip_sim.runtime.action_goals import GoalCode, GoalError  # noqa: E402
from manip_sim.runtime.trajectory_goal import TrajectoryGoal, TrajectoryRequest  # noqa: E402

J1 = 'robot0_joint1'
NAME = 'arm/swing'


class Swing(ActionMessages):
    """An order is a way of the first joint in tenths of a second; negative ones are rejected."""

    name = 'swing'

    def goal_of(self, request):
        if request.order < 0:
            raise GoalError(GoalCode.INVALID_GOAL, f'the order is {request.order}')
        where = float(self.robot.state().position[0])
        return TrajectoryGoal(self.robot, self.part, TrajectoryRequest(
            [J1], [request.order * 0.1], [[0.4 if where < 0.2 else 0.0]]), self._now_ns())

    def feedback_of(self, goal):
        return Fibonacci.Feedback(sequence=[goal.view.time_ns // 10**6])

    def result_of(self, goal):
        return Fibonacci.Result(sequence=[goal.outcome.code])


def offer(context, commands):
    return ActionServers(context, commands, lambda robot: [
        Swing(Fibonacci, robot, 'arm', lambda: context.thread.progress.time_ns)])


class Swinger:
    """A client of the action."""

    def __init__(self, client, name=NAME):
        self.client = client
        self.action = ActionClient(client.node, Fibonacci, name)
        client.spin_until(self.action.server_is_ready)
        self.told = []

    def close(self):
        # rclpy leaves this to the user, and the node with it.
        self.action.destroy()

    def wait(self, future):
        self.client.spin_until(future.done)
        return future.result()

    def send(self, order):
        def tell(message):
            self.told.append((time.monotonic(), message.feedback.sequence[0]))
        return self.wait(self.action.send_goal_async(Fibonacci.Goal(order=order), tell))

    def result(self, handle):
        answer = self.wait(handle.get_result_async())
        return answer.status, list(answer.result.sequence)

    def run(self, order):
        return self.result(self.send(order))


SUCCEEDED = (GoalStatus.STATUS_SUCCEEDED, [0])
ABORTED = (GoalStatus.STATUS_ABORTED, [-1])
CANCELED = (GoalStatus.STATUS_CANCELED, [0])


@pytest.fixture(scope='module')
def served():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sim_node, 'offer_actions', offer)
        node = Served({})
    yield node.node
    node.close()


@pytest.fixture
def swinger(served, client):
    swinger = Swinger(client)
    yield swinger
    swinger.close()
    assert served.actions.tracker.goals == ()
    client.spin_until(lambda: not any(s._running for s in served.actions._servers))
    # Without goals nothing wakes the executor.
    client.spin_until(served.actions._timer.is_canceled)


@pytest.mark.full
def test_goal_succeeds_and_its_client_hears_of_it_twenty_times_a_second(swinger):
    assert swinger.run(10) == SUCCEEDED
    # On a busy machine, the simulation takes longer than its time.
    seconds = max(1.0, swinger.told[-1][0] - swinger.told[0][0])
    assert 10 <= len(swinger.told) <= 26 * seconds
    times = [time_ms for _, time_ms in swinger.told]
    assert times == sorted(set(times))


@pytest.mark.full
def test_a_goal_of_a_paused_simulation_has_no_feedback(swinger):
    handle = swinger.send(50)
    swinger.client.spin_until(lambda: len(swinger.told) > 2)
    assert swinger.client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=True)).success
    states = swinger.client.listen(JointState, 'joint_states')
    # What was on its way has come.
    swinger.client.spin_until(lambda: len(states) > 3)
    told, seen = len(swinger.told), len(states)
    swinger.client.spin_until(lambda: len(states) > seen + 5)
    assert len(swinger.told) == told
    assert swinger.client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=False)).success
    swinger.client.spin_until(lambda: len(swinger.told) > told)
    swinger.wait(handle.cancel_goal_async())
    assert swinger.result(handle) == CANCELED


def test_goal_that_is_rejected_changes_nothing_and_is_counted_and_told(served, swinger):
    log, counts = swinger.client.log(), swinger.client.listen(DiagnosticArray, '/diagnostics')
    assert not swinger.send(-3).accepted
    swinger.client.spin_until(lambda: any(
        text == f'rejected a goal of {NAME}: INVALID_GOAL (-1): the order is -3' for text in log))

    def rejected():
        values = {v.key: v.value for status in counts[-1].status for v in status.values
                  if status.name.endswith('arm')} if counts else {}
        return int(values.get('dropped', 0))
    swinger.client.spin_until(lambda: rejected() >= 1)


def test_cancelled_goal_is_told_at_once_and_an_ended_one_cannot_be_cancelled(swinger):
    handle = swinger.send(50)
    assert len(swinger.wait(handle.cancel_goal_async()).goals_canceling) == 1
    assert swinger.result(handle) == CANCELED
    assert not swinger.wait(handle.cancel_goal_async()).goals_canceling


def test_newer_goal_and_command_abort_a_goal(swinger):
    log = swinger.client.log()
    older = swinger.send(50)
    newer = swinger.send(50)
    assert swinger.result(older) == ABORTED
    swinger.client.publish('arm/joint_command', JointState(name=[J1], position=[0.1]))
    assert swinger.result(newer) == ABORTED
    swinger.client.spin_until(lambda: any('a newer command has taken over' in t for t in log))


def test_reset_aborts_a_goal_also_of_a_client_that_asks_later(swinger):
    handle = swinger.send(50)
    assert swinger.client.call(Trigger, 'manip_sim/reset').success
    assert swinger.result(handle) == ABORTED
    assert swinger.result(handle) == ABORTED


@pytest.mark.full
def test_many_goals_in_a_row_all_end(swinger):
    assert {str(swinger.run(1)) for _ in range(10)} == {str(SUCCEEDED)}


@pytest.mark.full
def test_client_that_leaves_does_not_keep_others_from_the_action(served, swinger):
    other = Client()
    leaving = Swinger(other)
    leaving.send(5).get_result_async()
    leaving.close()
    other.close()
    swinger.client.spin_until(lambda: not served.actions.tracker.goals)
    assert swinger.run(1) == SUCCEEDED


def test_clients_are_told_when_the_node_ends(served, swinger):
    handle = swinger.send(50)
    future = handle.get_result_async()
    swinger.client.spin_until(lambda: len(swinger.told) > 2)
    served.end_goals()
    swinger.client.spin_until(future.done)
    assert (future.result().status, list(future.result().result.sequence)) == ABORTED
    served.end_goals()


@pytest.mark.full
def test_client_that_waits_for_its_goal_in_lockstep_gets_there(client, monkeypatch):
    monkeypatch.setattr(sim_node, 'offer_actions', offer)
    # Another node may serve the action of the same name, and would answer too.
    node = Served({'stepping': 'lockstep'}, ['--ros-args', '-r', '__ns:=/alone'])
    swinger = Swinger(client, f'/alone/{NAME}')
    assert swinger.run(5) == SUCCEEDED
    ends = node.node.simulation.time_ns
    assert 500_000_000 < ends < 700_000_000
    assert swinger.run(5) == SUCCEEDED
    swinger.close()
    node.close()


@pytest.mark.full
def test_a_node_that_is_gone_leaves_nothing_behind(served, client, monkeypatch):
    monkeypatch.setattr(sim_node, 'offer_actions', offer)

    def nodes():
        return client.node.get_node_names().count('manip_sim')
    before = client.settled(nodes)
    passing = Served({})
    client.spin_until(lambda: nodes() == before + 1)
    passing.close()
    client.spin_until(lambda: nodes() == before)


@pytest.mark.full
def test_the_end_waits_until_clients_are_told_and_no_longer(client, monkeypatch):
    monkeypatch.setattr(sim_node, 'offer_actions', offer)
    monkeypatch.setattr(executor, '_END_S', 1e4)
    node = Served({}, ['--ros-args', '-r', '__ns:=/alone'])
    swinger = Swinger(client, f'/alone/{NAME}')
    future = swinger.send(50).get_result_async()
    client.spin_until(lambda: len(swinger.told) > 2)

    def end():
        node.node.end_goals()
        node.close()
    ending = threading.Thread(target=end, daemon=True)
    ending.start()
    client.spin_until(lambda: future.done() and not ending.is_alive())
    assert (future.result().status, list(future.result().result.sequence)) == ABORTED
    swinger.close()
