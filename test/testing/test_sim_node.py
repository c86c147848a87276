# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The fixture for tests of controllers: simulated time, lock-step, records of failures."""

import contextlib
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

import pytest

pytest.importorskip('rclpy', reason='the fixture sim_node needs ROS 2')

import numpy as np  # noqa: E402
import rclpy  # noqa: E402
from rclpy.executors import MultiThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import QoSDurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.task import Future  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from manip_sim.errors import ManipSimError, UnknownNameError  # noqa: E402
from manip_sim.testing import simulation_under_test  # noqa: E402
from manip_sim.testing.simulation_under_test import SimulationStalled  # noqa: E402


@pytest.mark.full
@pytest.mark.parametrize('as_process', [False, True])
def test_time_passes_only_while_the_test_lets_it(sim_node, as_process):
    sim = sim_node(robot='UR5e', as_process=as_process)
    assert sim.time_s == pytest.approx(0.01)
    sim.run_for(0.37)
    sim.publish('arm/joint_command', JointState(name=['robot0_wrist_3_joint'], position=[0.2]))
    sim.run_for(1.0)
    states = sim.states('arm/joint_states')
    # No control period is missing, and none comes twice.
    np.testing.assert_allclose(states.time_s, 0.01 * np.arange(1, 139), atol=1e-12)
    assert sim.time_s == pytest.approx(1.38)
    last = states.names.index('robot0_wrist_3_joint')
    start = states.position[37, last]
    assert np.abs(states.position[:38, last] - start).max() < 1e-4
    # The command that was published before the time went on counts from its first period on.
    assert abs(states.velocity[38, last]) > 1e-3
    assert states.position[-1, last] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.full
def test_commands_between_short_runs_wait_for_no_heartbeat(sim_node):
    sim = sim_node(as_process=True)
    sim.run_for(0.1)
    name, start = sim.messages('joint_states')[-1].name[0], time.monotonic()
    for command in range(6):
        # Two in a row both arrive.
        sim.publish('arm/joint_command', JointState(name=[name], position=[0.5]))
        sim.publish('arm/joint_command', JointState(name=[name], position=[0.01 * command]))
        sim.run_for(0.01)
    # Fast DDS sends one every 3 s.
    assert time.monotonic() - start < 6.0
    sim.run_for(1.0)
    assert sim.messages('joint_states')[-1].position[0] == pytest.approx(0.05, abs=1e-3)


def test_waiting_ends_in_the_period_in_which_it_becomes_true(sim_node):
    sim = sim_node()
    sim.publish('joint_command', JointState(name=['robot0_joint1'], position=[0.5]))
    sim.wait_for(lambda: sim.states().position[-1, 0] > 0.25, limit_s=2.0)
    position = sim.states().position[:, 0]
    assert position[-1] > 0.25 >= position[-2]
    with pytest.raises(AssertionError, match=r'not true within 0\.1 s of simulated time, at '):
        sim.wait_for(lambda: False, limit_s=0.1)


class Follower(Node):
    """Answers each state with a sine, as a controller of somebody else does."""

    def __init__(self):
        super().__init__('follower')
        self.publisher = self.create_publisher(JointState, 'arm/joint_command', 10)
        self.create_subscription(JointState, 'arm/joint_states', self.answer, 10)
        self.start, self.stamp = None, None

    def answer(self, state):
        stamp = (state.header.stamp.sec, state.header.stamp.nanosec)
        if stamp == self.stamp or not self.publisher.get_subscription_count():
            return
        self.stamp = stamp
        self.start = self.start or state.position
        sway = 0.1 * math.sin(2.0 * math.pi * (stamp[0] + stamp[1] * 1e-9))
        command = JointState(name=state.name, position=[p + sway for p in self.start])
        command.header.stamp = state.header.stamp
        self.publisher.publish(command)


@pytest.fixture
def ros(monkeypatch):
    """Let a test create nodes as controllers do, in the domain of its environment."""
    yield rclpy.init
    rclpy.try_shutdown()


@pytest.mark.full
def test_a_controller_in_lock_step_gives_the_same_states_to_the_last_bit(sim_node, ros):
    def run():
        sim = sim_node(stepping='lockstep')
        ros()
        follower = Follower()
        sim.spin(follower)
        sim.run_for(0.5)
        sim.run_for(0.5)
        states = sim.states('arm/joint_states')
        rclpy.shutdown()
        return states
    first, again = run(), run()
    assert len(first.time_s) == 101
    assert np.ptp(first.position[:, 0]) > 0.15
    for field in ('time_s', 'position', 'velocity', 'effort'):
        assert getattr(first, field).tobytes() == getattr(again, field).tobytes()


def test_lock_step_without_a_controller_fails_after_the_patience_of_the_fixture(sim_node):
    sim = sim_node(stepping='lockstep', patience=1.5)
    begin_s = time.monotonic()
    with pytest.raises(SimulationStalled, match=(
            r'stands still at 0\.010 s: lock-step waits for a command of the parts arm; no node '
            r'publishes what it takes; waited for 1\.5 s of wall time$')):
        sim.run_for(0.1)
    assert time.monotonic() - begin_s >= 1.5
    for patience in (0.0, -1.0, math.nan):
        with pytest.raises(ManipSimError, match='patience must be above 0 s'):
            sim_node(patience=patience)


@pytest.mark.parametrize(('name', 'meant'), [
    ('patience_s', 'patience'), ('patients', 'patience'), ('as_proces', 'as_process')])
def test_a_mistyped_argument_of_the_fixture_is_no_parameter_of_the_node(name, meant, sim_node):
    with pytest.raises(UnknownNameError, match=f"'{name}': did you mean '{meant}'"):
        sim_node(**{name: 1})


class Raises(Node):
    """Fails at the third state."""

    def __init__(self):
        super().__init__('raises')
        self.states = 0
        self.create_subscription(JointState, 'arm/joint_states', self.answer, 1)

    def answer(self, state):
        self.states += 1
        if self.states == 3:
            raise ZeroDivisionError('a defect of the controller')


def spin_in_own_thread(sim):
    executor = MultiThreadedExecutor()
    executor.add_node(Raises())
    threading.Thread(target=executor.spin, daemon=True).start()


def fail_in_a_thread(sim):
    threading.Thread(target=lambda: {}['no such key']).start()


def fail_in_a_process(sim):
    # Its own child processes keep its standard error open.
    sim.start([sys.executable, '-c', 'import subprocess; subprocess.Popen(["sleep", "1000"]); '
               'raise RuntimeError("in a process")'])


@pytest.mark.full
@pytest.mark.parametrize('fail, error', [
    (lambda sim: sim.spin(Raises()), (ZeroDivisionError, 'a defect of the controller')),
    (spin_in_own_thread, (ZeroDivisionError, 'a defect of the controller')),
    (fail_in_a_thread, (KeyError, 'no such key')),
    (fail_in_a_process, (ManipSimError, r'has ended with exit code 1: Traceback \(most recent '
                         r'call last\):\n(.*\n)+RuntimeError: in a process$'))])
def test_a_controller_that_raises_fails_the_test_with_its_own_exception(
        sim_node, ros, fail, error):
    sim = sim_node(stepping='lockstep', patience=250.0)
    ros()
    fail(sim)
    kind, text = error
    with pytest.raises(kind, match=text):
        sim.run_for(1.0)
    # It has been raised, and is no reason why the test could not end, or save what it has.
    assert len(sim.nodes()) >= 2
    sim.call(Trigger, 'manip_sim/tare_wrench')


def test_an_exception_after_the_last_wait_of_a_test_is_raised_at_its_end(sim_node, ros):
    hook_before = threading.excepthook
    sim = sim_node()
    ros()
    failing = Raises()
    sim.spin(failing)
    while failing.states < 3:
        time.sleep(0.01)
    with pytest.raises(ZeroDivisionError, match='a defect of the controller'):
        sim.close()
    assert threading.excepthook == hook_before


@pytest.mark.full
def test_a_controller_that_never_returns_is_named_with_the_line_where_it_is(sim_node, ros):
    sim = sim_node(stepping='lockstep', patience=1.0)
    ros()
    node = rclpy.create_node('hangs')
    node.create_publisher(JointState, 'arm/joint_command', 1)
    entered, never = threading.Event(), threading.Event()
    node.create_subscription(
        JointState, 'joint_states', lambda _: (entered.set(), never.wait()), 1)
    sim.spin(node)
    sim.wait_for_publisher('arm/joint_command')
    assert entered.wait(300.0)
    with pytest.raises(SimulationStalled, match=(
            r"'hangs' publishes arm/joint_command; .*; node 'hangs' is in <lambda> "
            r'\(.*test_sim_node\.py:\d+\)$')):
        sim.run_for(0.1)
    with pytest.raises(ManipSimError, match='a callback of the nodes hangs does not return'):
        sim.close()
    never.set()


@pytest.mark.full
def test_an_end_that_the_test_knows_of_is_no_failure_of_a_controller(sim_node):
    sim = sim_node(control_mode__arm='velocity')
    killed = sim.start(['sleep', '1000'])
    killed.kill()
    known = sim.start([sys.executable, '-c', 'raise SystemExit(3)'])
    assert known.wait() == 3
    sim.start(['true'])
    sim.run_for(0.5)
    assert killed.poll() == -signal.SIGKILL
    with pytest.raises(ManipSimError, match=r"\['true'\] has ended with exit code 0"):
        sim.wait_for_publisher('arm/joint_command')


def test_a_process_that_fails_is_reported_while_another_one_runs(sim_node):
    sim = sim_node(patience=250.0)
    sim.start([sys.executable, '-c', 'raise SystemExit(3)'])
    sim.start(['sleep', '1000'])
    with pytest.raises(ManipSimError, match='has ended with exit code 3'):
        sim.wait_for_publisher('arm/joint_command')


UNKNOWN = [
    (lambda sim: sim.publish('arm/joint_comand', JointState()),
     "subscribed topic .* 'arm/joint_comand': did you mean 'arm/joint_command'"),
    # The fixture subscribes to these itself.
    (lambda sim: sim.publish('joint_states', JointState()),
     "of the type sensor_msgs/msg/JointState 'joint_states': did you mean 'joint_command'"),
    (lambda sim: sim.publish('arm/joint_state', JointState()),
     'available: arm/joint_command, joint_command, right/gripper/joint_command, '
     'right/joint_command$'),
    (lambda sim: sim.publish('joint_comand', String()), 'of the type std_msgs/msg/String'),
    (lambda sim: sim.publish('arm/joint_command', String()),
     'arm/joint_command has the type sensor_msgs/msg/JointState, not std_msgs/msg/String'),
    (lambda sim: sim.receive(String, 'manip_sim/mjfc'),
     "published topic .* 'manip_sim/mjfc': did you mean 'manip_sim/mjcf'"),
    (lambda sim: sim.receive(String, 'joint_states'), 'has the type sensor_msgs/msg/JointState'),
    (lambda sim: sim.wait_for_publisher('joint_state'), "did you mean 'joint_states'"),
    (lambda sim: sim.call(Trigger, 'manip_sim/tare_wrenches'),
     "did you mean 'manip_sim/tare_wrench'"),
    (lambda sim: sim.call(Trigger, 'manip_sim/pause'), 'has the type std_srvs/srv/SetBool')]


@pytest.mark.full
def test_names_that_nobody_has_are_unknown_after_three_seconds(sim_node, monkeypatch):
    sim = sim_node(patience=250.0)
    begin_s = time.monotonic()
    for asks, text in UNKNOWN:
        with pytest.raises(ManipSimError, match=text):
            asks(sim)
        # Enough for this list; the first one waits as long as a user does.
        monkeypatch.setattr(simulation_under_test, '_UNKNOWN_S', 0.3)
    assert time.monotonic() - begin_s >= 3.0


@pytest.mark.full
def test_a_topic_or_service_that_keeps_silent_fails_after_the_patience(sim_node, ros):
    sim = sim_node(patience=1.0)
    ros()
    silent = rclpy.create_node('silent')
    silent.create_publisher(String, 'silent', 1)
    with pytest.raises(ManipSimError, match='no message on silent within 1 s'):
        sim.receive(String, 'silent')
    silent.create_service(Trigger, 'silent', print)
    with pytest.raises(ManipSimError, match='no answer of the service silent within 1 s'):
        sim.call(Trigger, 'silent')


STARTS_A_NODE = """
import multiprocessing
import sys
import time

def test_that_is_killed(sim_node):
    sim = sim_node(as_process=True)
    sim.start([sys.executable, '-c', %r])
    # A fork has all that is open, and is not ended by its parent's end.
    multiprocessing.get_context('fork').Process(target=time.sleep, args=(1000,)).start()
    print('started', flush=True)
    sim.run_for(1e6)
"""


def wait_until(condition):
    """Fail where a condition is not met in half a minute."""
    end_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def processes_with(mark):
    """Return the processes whose environment has a text."""
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError):
            if mark.encode() in (process / 'environ').read_bytes():
                found.append(process.name)
    return found


@pytest.mark.full
@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_processes_of_a_fixture_end_with_a_killed_pytest(tmp_path, number):
    (tmp_path / 'test_of_mine.py').write_text(STARTS_A_NODE % STARTS_ANOTHER)
    mark = f'of_pytest_{os.getpid()}_{number}'
    with subprocess.Popen(
            [sys.executable, '-m', 'pytest', '-qs', '-p', 'no:cacheprovider'], cwd=tmp_path,
            stdout=subprocess.PIPE, env={**os.environ, 'MARK': mark}) as killed:
        try:
            while b'started' not in killed.stdout.readline():
                assert killed.poll() is None
            # With the node, the controller and what that starts.
            wait_until(lambda: len(processes_with(mark)) >= 5)
            killed.send_signal(number)
            # The fork is none of those of the fixture.
            wait_until(lambda: len(processes_with(mark)) <= 1)
        finally:
            killed.kill()
    for fork in processes_with(mark):
        os.kill(int(fork), signal.SIGKILL)


def test_what_a_test_asks_wrongly_is_told(sim_node, ros):
    with pytest.raises(ManipSimError, match=r'parameter .robot.: unknown value'):
        sim_node(robot='Pandaa')
    sim = sim_node()
    for duration in (-1.0, math.nan, math.inf):
        with pytest.raises(ManipSimError, match='must be finite and 0 or more'):
            sim.run_for(duration)
    with pytest.raises(UnknownNameError, match='unknown recorded topic'):
        sim.states('leg/joint_states')
    with pytest.raises(ManipSimError, match='pause_at out of range'):
        sim.set_parameter('pause_at', -1.0)
    ros(domain_id=sim.domain + 1)
    with pytest.raises(ManipSimError, match=(
            f"'follower' is in ROS domain {sim.domain + 1}, and the simulation in {sim.domain}: "
            'call rclpy.init')):
        sim.spin(Follower())


def test_a_simulation_ends_after_a_signal_has_shut_its_context_down(sim_node):
    sim = sim_node()
    sim.run_for(0.1)
    # As rclpy's handlers of signals do.
    sim.node.context.shutdown()
    sim.close()


STARTS_ANOTHER = """
import subprocess, sys
subprocess.run([sys.executable, '-c', 'print(flush=True); import time; time.sleep(1000)'])
"""


def test_what_a_controller_has_started_ends_with_it(sim_node):
    sim = sim_node()
    controller = sim.start([sys.executable, '-c', STARTS_ANOTHER], stdout=subprocess.PIPE)
    with controller.stdout as output:
        assert output.read(1)
        # As 'ros2 run' ends when it is killed.
        controller.kill()
        sim.close()
        # The pipe ends with the last process that has it.
        assert not output.read()


TELLS_ITS_DOMAIN = "import os; print(os.environ['ROS_DOMAIN_ID'])"


@pytest.mark.full
def test_a_process_is_in_the_domain_of_the_simulation_that_starts_it(sim_node):
    first, second = sim_node(), sim_node()
    for sim in (first, second):
        with sim.start([sys.executable, '-c', TELLS_ITS_DOMAIN], stdout=subprocess.PIPE) as told:
            assert int(told.stdout.read()) == sim.domain


@pytest.mark.full
def test_a_model_that_does_not_come_costs_the_picture_alone(sim_node, monkeypatch, tmp_path):
    sim = sim_node(patience=1.0)
    publishers = {p.topic_name: p for p in sim.server.node.publishers}
    sim.server.node.destroy_publisher(publishers['/manip_sim/mjcf_archive'])
    monkeypatch.setattr(simulation_under_test, '_AGAIN_S', 0.1)
    *_, states, picture = sim.save_evidence(tmp_path / 'failed')
    assert picture.startswith('no picture: unknown published topic')
    assert states.endswith('states.npz') and (tmp_path / 'failed' / 'states.npz').is_file()


@pytest.mark.full
def test_a_message_that_is_lost_is_asked_for_again(sim_node, monkeypatch):
    sim = sim_node()
    subscribe, subscriptions = sim.node.create_subscription, []

    def lose_the_first(message_type, topic, callback, qos):
        subscriptions.append(topic)
        return subscribe(message_type, topic, callback if len(subscriptions) > 1 else
                         lambda message: None, qos)
    monkeypatch.setattr(sim.node, 'create_subscription', lose_the_first)
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    assert sim.receive(String, 'manip_sim/mjcf', latched).data.startswith('<mujoco')
    assert len(subscriptions) == 2


def test_a_question_whose_answer_is_lost_is_asked_again(sim_node, monkeypatch):
    monkeypatch.setattr(simulation_under_test, '_AGAIN_S', 0.1)
    sim = sim_node()
    ask, asked = sim._ask, []

    def lose_the_first(service_type, name, request):
        asked.append(name)
        future = ask(service_type, name, request)
        return future if asked.count(name) > 1 else Future()
    monkeypatch.setattr(sim, '_ask', lose_the_first)
    sim.run_for(0.05)
    assert sim.time_s == pytest.approx(0.06)
    assert asked.count('manip_sim/set_parameters_atomically') >= 2
    # It is not told twice to let time pass.
    assert asked.count('manip_sim/pause') == 1
    sim.reset()
    assert sim.time_s == pytest.approx(0.07)
    answer = sim.call(Trigger, 'manip_sim/tare_wrench', again=True)
    assert answer.success and asked.count('manip_sim/tare_wrench') >= 2


@pytest.mark.full
def test_a_node_that_crashes_comes_back_and_what_was_recorded_begins_anew(sim_node):
    sim = sim_node(as_process=True, control_mode__arm='velocity')
    command = JointState(name=['robot0_joint1'], velocity=[0.2])

    def turns():
        sim.publish('arm/joint_command', command)
        return sim.states().velocity[-1, 0] > 0.15
    sim.wait_for(turns)
    sim.crash()
    assert len(sim.states().time_s) == 1 and sim.time_s < 0.1
    # The same controller goes on with the node that is new.
    sim.wait_for(turns)
    assert np.ptp(np.round(np.diff(sim.states().time_s), 9)) == 0.0


def test_a_node_in_the_process_of_the_test_cannot_crash(sim_node):
    with pytest.raises(ManipSimError, match='start it with as_process=True'):
        sim_node().crash()
