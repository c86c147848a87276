# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node as a process: its start, its end, and real time."""

from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from harness import END_SIGNALS
from pages import blocks
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def catches(process, number):
    """Return whether a process has come as far as to catch a signal."""
    status = Path(f'/proc/{process.pid}/status').read_text()
    return bool(int(status.split('SigCgt:')[1].split()[0], 16) >> (number - 1) & 1)


@pytest.mark.full
@pytest.mark.skipif(not Path('/proc/self/status').is_file(), reason='needs the /proc of Linux')
@pytest.mark.parametrize('number', END_SIGNALS)
@pytest.mark.parametrize('delay_s', [0.0, 0.3, None])
def test_a_signal_ends_the_process_cleanly_at_any_moment(number, delay_s, sim_process, client):
    # `make soak` takes 200 moments, more than one signal, and sim_view too.
    begin = time.monotonic()
    node = sim_process(fresh=True)
    if delay_s is None:
        client.state()
    else:
        # Python itself catches SIGINT from the beginning, and SIGTERM never.
        client.spin_until(lambda: catches(node, signal.SIGTERM))
        time.sleep(delay_s)  # Not to wait for something, but to hit another phase of the start.
    asked = time.monotonic()
    node.send_signal(number)
    _, errors = node.communicate(timeout=300.0)
    # On a machine that is slow a start takes long too.
    assert time.monotonic() - asked < 5.0 + 10.0 * (asked - begin)
    assert node.returncode == 0, errors
    assert 'Traceback' not in errors


@pytest.mark.full
@pytest.mark.parametrize('number', END_SIGNALS)
def test_a_signal_ends_the_first_start_while_it_compiles_control_laws(
        number, sim_process, client, monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    log = client.log()
    node = sim_process(fresh=True)
    client.spin_until(lambda: any('Compiling control laws' in line for line in log))
    node.send_signal(number)
    _, errors = node.communicate(timeout=20.0)  # All laws take a minute or more.
    assert node.returncode == 0, errors
    assert 'Traceback' not in errors


@pytest.mark.full
def test_a_node_without_standard_streams_serves_until_it_is_ended(client):
    node = subprocess.Popen(['sh', '-c', 'exec "$0" -m manip_sim <&- >&- 2>&-', sys.executable])
    try:
        before = client.state().header.stamp
        client.spin_until(lambda: client.state().header.stamp.sec > before.sec + 1)
        assert node.poll() is None
        node.send_signal(signal.SIGTERM)
        assert node.wait(timeout=300.0) == 0
    finally:
        node.kill()
        node.wait()


@pytest.mark.full
def test_several_signals_are_as_good_as_one(sim_process, client):
    for _ in range(3):
        node = sim_process()
        client.state()
        while node.poll() is None:
            for number in END_SIGNALS:
                node.send_signal(number)
            time.sleep(0.001)
        _, errors = node.communicate(timeout=300.0)
        assert node.returncode == 0, errors
        assert 'Traceback' not in errors


#: The node, one thread of which fails as soon as there is a certain file.
FAILS = """
import os
import sys
from manip_sim.ros import process
from manip_sim.ros.command_inbox import CommandInbox
from manip_sim.ros.executor import GuardedExecutor
from manip_sim.ros.feature import PublishingThread
from manip_sim.simulation import Simulation

def fails(owner, name, fail):
    function = getattr(owner, name)
    setattr(owner, name, lambda *arguments: (
        fail() if os.path.exists(sys.argv[2]) else function(*arguments)))

def out_of_memory():
    raise MemoryError('no memory for the physics')

if sys.argv[1] == 'physics':
    fails(Simulation, 'advance', out_of_memory)
elif sys.argv[1] == 'commands':
    fails(CommandInbox, 'wait', sys.exit)
elif sys.argv[1] == 'publishing':
    add = PublishingThread.add
    PublishingThread.add = lambda self, publish: add(
        self, sys.exit if os.path.exists(sys.argv[2]) else publish)
else:
    fails(GuardedExecutor, 'spin_once', sys.exit)
sys.exit(process.run([]))
"""


@pytest.mark.full
@pytest.mark.parametrize('what, told', [
    ('physics', 'MemoryError: no memory for the physics'),
    ('executor', 'sim_node: the executor ended unexpectedly'),
    ('commands', 'sim_node: the thread that takes commands ended unexpectedly'),
    ('publishing', 'sim_node: the thread that publishes ended unexpectedly')],
    ids=['physics', 'executor', 'commands', 'publishing'])
def test_a_process_whose_thread_dies_ends_and_says_so(what, told, client, script, tmp_path):
    now = tmp_path / 'fail_now'
    node = script(FAILS, what, str(now))
    # It stays subscribed: without subscribers nothing is published that could fail.
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: bool(states))
    now.touch()
    # A controller must not go on with a node that only seems to live.
    _, errors = node.communicate(timeout=300.0)
    assert node.returncode == 1
    assert told in errors.splitlines()[-1]


#: The node; prints what has come of the start when it begins to describe its model, then fails.
DESCRIBES = """
import gc
import sys
from manip_sim import __main__
from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.runtime.simulation_thread import Observers

shown = []
show = Observers.show
Observers.show = lambda *arguments, **named: (shown.append(1), show(*arguments, **named))

def fail(world):
    while not shown:
        pass
    print(gc.isenabled(), gc.get_freeze_count() > 50_000)
    raise ModelError('no archive of this world')

World.to_xml_and_archive = fail
sys.argv[1:] = []
sys.exit(__main__.main())
"""


@pytest.mark.full
def test_the_first_state_waits_for_no_description_and_one_that_fails_ends_the_node():
    done = subprocess.run([sys.executable, '-c', DESCRIBES], text=True, capture_output=True,
                          timeout=300.0)
    assert done.stdout == 'True True\n'
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == 'sim_node: no archive of this world'


def rate(clock, wall):
    simulated_s = (clock[-1].clock.sec - clock[0].clock.sec
                   + (clock[-1].clock.nanosec - clock[0].clock.nanosec) * 1e-9)
    return simulated_s / (wall[-1] - wall[0])


@pytest.mark.full
@pytest.mark.parametrize('factor', [1.0, 4.0])
def test_simulation_time_follows_wall_time_at_the_factor_asked_for(factor, sim_process, client):
    sim_process(f'real_time_factor:={factor}')
    wall = []
    clock = []

    def take(message):
        clock.append(message)
        wall.append(time.monotonic())
    client.node.create_subscription(Clock, '/clock', take, 10)
    missed = client.listen(DiagnosticArray, '/diagnostics')

    def lost_s():
        """Return the simulation time that the machine was too slow for, as the node counts it."""
        seen = len(missed)
        client.spin_until(lambda: len(missed) > seen)
        return 0.01 * float(next(pair.value for pair in missed[-1].status[0].values
                                 if pair.key == 'missed_deadlines'))
    client.spin_until(lambda: len(clock) > 10)
    # Other processes may slow the machine for a while; a wrong factor would be wrong every time.
    rates = []
    while not any(abs(measured / factor - 1.0) < 0.02 for measured in rates):
        assert len(rates) < 20, rates
        lost_before_s, first, end = lost_s(), len(clock), time.monotonic() + 4.0
        client.spin_until(lambda until=end: time.monotonic() > until)
        lost = lost_s() - lost_before_s
        rates.append(rate(clock[first:], wall[first:])
                     + lost / (wall[-1] - wall[first]))


def flood(publisher, message, client, duration_s, most=None):
    """Publish at 10 kHz for a while, and take in what comes; return how many were sent."""
    begin, sent = time.monotonic(), 0
    while time.monotonic() < begin + duration_s:
        if sent != most and sent < (time.monotonic() - begin) * 10_000:
            publisher.publish(message)
            sent += 1
        else:
            client.executor.spin_once(timeout_sec=0.0)
    return sent


@pytest.mark.full
def test_a_flood_of_commands_does_not_slow_the_simulation(sim_process, client):
    sim_process()
    wall, clock, rates = [], [], []

    def take(message):
        clock.append(message)
        wall.append(time.monotonic())
    publisher = client.publisher(Float64MultiArray, 'arm/command', 1)
    client.node.create_subscription(Clock, '/clock', take, 10)
    client.spin_until(lambda: len(clock) > 10)
    message = Float64MultiArray(data=[0.0] * 7)
    # Other processes may slow the machine, then without the flood too.
    for _ in range(10):
        for flooded in (True, False):
            first = len(clock)
            sent = flood(publisher, message, client, 4.0, most=None if flooded else 0)
            assert not flooded or sent > 500
            seen = len(clock)
            client.spin_until(lambda n=seen: len(clock) > n + 10)
            rates.append(rate(clock[first:], wall[first:]))
            if rates[-1] > 0.99:
                break
        if flooded or rates[-2] > 0.95 * rates[-1]:
            return
    raise AssertionError(rates)


@pytest.mark.full
@pytest.mark.parametrize('mode, value, slow', [('velocity', 0.2, 1e-3), ('effort', 2.0, 0.02)])
def test_a_dead_publisher_leaves_the_arm_at_rest_and_a_new_one_takes_over(
        mode, value, slow, sim_process, client, script):
    sim_process(f'control_mode.arm:={mode}')
    client.state()
    for _ in range(2):
        publisher = script(PUBLISH, mode, str(value))
        client.spin_until(lambda: client.state().velocity[0] > 0.15)
        publisher.send_signal(signal.SIGKILL)
        publisher.wait(timeout=300.0)
        client.spin_until(lambda: abs(client.state().velocity[0]) < slow)
        assert client.state().position[0] < 2.8  # Not because it came to the end of its range.


PUBLISH = """
import sys
import time
import rclpy
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node('publisher')
publisher = node.create_publisher(JointState, 'arm/joint_command', 1)
end = time.monotonic() + 600.0
while time.monotonic() < end:
    publisher.publish(JointState(name=['robot0_joint1'], **{sys.argv[1]: [float(sys.argv[2])]}))
    time.sleep(0.02)
"""


DESTROYED = """
import rclpy
from manip_sim.ros.sim_node import SimNode
rclpy.init()
node = SimNode()
node.start()
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.full
def test_a_program_ends_that_destroys_a_running_node_without_stopping_it():
    done = subprocess.run([sys.executable, '-c', DESTROYED], capture_output=True, text=True,
                          check=True, timeout=300.0)
    assert 'Panda in arena empty' in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr


def segments(process):
    """Return the files of shared memory that a process maps."""
    maps = Path(f'/proc/{process.pid}/maps').read_text()
    return set(re.findall(r'/dev/shm/fastrtps_[0-9a-f]{16}$', maps, re.MULTILINE))


@pytest.mark.full
def test_a_killed_node_leaves_memory_that_the_command_of_the_page_removes(sim_process, client):
    page = Path(__file__).parents[2] / 'docs/how_to/security.md'
    (command,) = (block.text for block in blocks(page) if 'flock' in block.text)
    process = sim_process()
    client.state()
    # Those of others that it writes to are theirs.
    found = {file for file in segments(process) if Path(f'{file}_el').exists()}
    if not found:
        pytest.skip('this middleware has no shared memory here')

    def remove():
        """Run the command for the files of this node alone, and return which are left."""
        pattern = '/dev/shm/fastrtps_????????????????_el'
        assert pattern in command
        subprocess.run(['sh', '-c', command.replace(pattern, ' '.join(
            f'{file}_el' for file in sorted(found)))], check=False, timeout=300.0)
        return {file for file in found if Path(file).exists()}
    assert remove() == found
    process.kill()
    process.wait(timeout=300.0)
    left = remove()
    assert left < found
    assert not any(Path(f'{file}_el').exists() for file in found - left)
