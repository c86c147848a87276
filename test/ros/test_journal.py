# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records of nodes in processes of their own are repeated to the bit, also after a kill."""

from collections import Counter
import json
import signal

import pytest

for needed in ('mcap', 'rosbags'):
    pytest.importorskip(needed, reason='needs the extras records and test')

from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from manip_sim.records.recorded import Record  # noqa: E402

WAIT_S = 300.0


@pytest.fixture
def record(process, client, tmp_path):
    """Return a function that starts to record all, and waits for the beginning of the journal."""
    def start():
        path = tmp_path / 'node.mcap'
        command = process('record', str(path), module='manip_sim.cli')
        client.spin_until(lambda: client.node.count_subscribers('/manip_sim/journal') > 0)
        return path, command
    return start


def replayed(process, path):
    """Verify a record, and return the exit code and the lines."""
    command = process('replay', str(path), '--verify', module='manip_sim.cli')
    out, errors = command.communicate(timeout=WAIT_S)
    return command.returncode, (out + errors).replace(f'{path}: ', '').splitlines()


def await_journal(client, path, **least):
    """Wait until a record holds so many entries of some kinds: a recorder may lag behind."""
    def found():
        kinds = Counter(entry[0] for text in Record(path).journal()
                        for entry in json.loads(text)['entries'])
        return all(kinds[kind] >= count for kind, count in least.items())
    while not found():
        size = path.stat().st_size
        client.spin_until(lambda before=size: path.stat().st_size > before)


def drive(client, states, lockstep):
    """Command all parts for some states, and call services between."""
    joints = client.node.create_publisher(JointState, 'joint_command', 10)
    hand = client.node.create_publisher(Float64MultiArray, 'right/gripper/command', 10)
    client.spin_until(lambda: joints.get_subscription_count() and hand.get_subscription_count())
    latest = [client.state()]
    client.node.create_subscription(
        JointState, 'joint_states', lambda message: latest.__setitem__(0, message), 10)
    start, stamp = latest[0], None
    names = [name for name in start.name if name.startswith('robot0')]
    places = dict(zip(start.name, start.position))
    for number in range(states):
        client.spin_until(lambda before=stamp: latest[0].header.stamp != before)
        stamp = latest[0].header.stamp
        command = JointState(name=names, position=[
            places[name] + 0.004 * (number % 50) for name in names])
        if lockstep:
            command.header.stamp = stamp
        joints.publish(command)
        if number % 20 == 5:
            hand.publish(Float64MultiArray(data=[1.0 if number % 40 == 5 else -1.0]))
        if number == states // 2:
            assert client.call(Trigger, 'manip_sim/reset').success
        if number == states // 3:
            assert client.call(Trigger, 'manip_sim/tare_wrench').success


@pytest.mark.full
@pytest.mark.parametrize('parameters', [
    ('stepping:=lockstep', 'arena:=table', 'latency.command:=0.02', 'noise.joint_position:=0.001'),
    ('robot:=PandaOmron', 'latency.state:=0.02'), ('stepping:=free', 'task:=pick_cube')],
    ids=['lockstep', 'realtime', 'free'])
def test_the_record_of_a_node_is_repeated(parameters, sim_process, record, process, client):
    sim_process(*parameters)
    client.state()
    path, command = record()
    lockstep = 'stepping:=lockstep' in parameters
    drive(client, 90, lockstep)
    # Off lock-step, how much arrives in time is up to the machine.
    await_journal(client, path, period=61, commands=21 if lockstep else 1)
    command.send_signal(signal.SIGINT)
    out, errors = command.communicate(timeout=WAIT_S)
    assert (command.returncode, errors) == (0, ''), out
    code, lines = replayed(process, path)
    assert (code, lines[-1]) == (0, '1 of 1 equal'), lines
    periods, changes = (int(word) for word in lines[0].split() if word.isdigit())
    assert periods > 60 and changes > (20 if lockstep else 0)


@pytest.mark.full
@pytest.mark.parametrize('victim', ['node', 'recorder'])
def test_a_record_that_ends_early_is_repeated_up_to_there(
        victim, sim_process, record, process, client):
    node = sim_process('robot:=UR5e', 'stepping:=lockstep')
    client.state()
    path, command = record()
    drive(client, 60, True)
    await_journal(client, path, period=21)
    (node if victim == 'node' else command).send_signal(signal.SIGKILL)
    if victim == 'node':
        command.send_signal(signal.SIGINT)
    command.communicate(timeout=WAIT_S)
    code, lines = replayed(process, path)
    assert lines[-1] == '1 of 1 equal', lines
    assert code == (victim == 'recorder')
    assert ('the file ends early, and was read up to there' in lines) == (victim == 'recorder')
    assert int(lines[0].split()[0]) > 20
