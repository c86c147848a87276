# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Malformed messages of any node to the viewer: rejected, counted and logged once a second."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
import re
import signal
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, WrenchStamped
from hostile_node import archive, HostileNode, LATCHED, NAME
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from page_client import page_client  # noqa: E402
from test_viewer import end, start_viewer  # noqa: E402

from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.viewer.discovery import Readers  # noqa: E402

NAN = float('nan')


def diagnostics(name, **values):
    return DiagnosticArray(status=[DiagnosticStatus(name=f'{NAME}: {name}', values=[
        KeyValue(key=key, value=value) for key, value in values.items()])])


def pose_of(x=0.0, w=1.0):
    message = PoseStamped()
    message.pose.position.x, message.pose.orientation.w = x, w
    return message


def wrench_of(x):
    message = WrenchStamped()
    message.wrench.force.x = x
    return message


#: Messages that cannot be shown, and what is logged.
MALFORMED = {
    'no numbers': ('/joint_states', JointState(name=['a', 'b']), 'position: 0 numbers'),
    'few velocities': ('/joint_states', JointState(name=['a', 'b'], position=[0.0, 0.0],
                                                   velocity=[1.0]), 'velocity: 1 number'),
    'no names': ('/joint_states', JointState(), '0 names'),
    'a name twice': ('/joint_states', JointState(name=['a', 'a'], position=[0.0, 0.0]), '2 names'),
    'nan': ('/joint_states', JointState(name=['a'], position=[NAN]), 'position: nan cannot'),
    'infinite effort': ('/joint_states', JointState(name=['a'], position=[0.0],
                                                    effort=[float('inf')]), 'effort: inf cannot'),
    'pose': ('/right/eef_pose', pose_of(NAN), 'position: nan cannot'),
    'no orientation': ('/objects/cube/pose', pose_of(w=0.0), 'the quaternion has the norm 0'),
    'wrench': ('/right/external_wrench', wrench_of(1e300), r'wrench: 1e\+300 cannot'),
    'statuses': ('/diagnostics', DiagnosticArray(
        status=[DiagnosticStatus(name=f'{NAME}: x')] * 200), '200 statuses'),
    'garbage': (f'/{NAME}/mjcf_archive', UInt8MultiArray(data=b'garbage'),
                'the archive cannot be unpacked'),
    'a file of the host': (f'/{NAME}/mjcf_archive', UInt8MultiArray(data=archive(
        '<mujoco><asset><texture name="t" file="/etc/passwd"/></asset></mujoco>')),
        'the archive (does not compile|is not MJCF)'),
    'not serialized': ('/right/eef_pose', b'\0\1\0\0abc', 'cannot be read as a message'),
    'large': ('/diagnostics', DiagnosticArray(status=[DiagnosticStatus(message='x' * 2**20)]),
              'what is shown has 1048576 at most')}
#: Messages that are odd, and are shown.
ODD = {
    'size of actions': ('/diagnostics', diagnostics('right/gripper', action_size='abc')),
    'many actions': ('/diagnostics', diagnostics('right/gripper', action_size='9' * 30)),
    'age': ('/diagnostics', diagnostics('arm', accepted='1', age='abc')),
    'mode': ('/diagnostics', diagnostics(
        'arm', control_mode='<b>', command_interface='<b>')),
    'level': ('/diagnostics', DiagnosticArray(status=[DiagnosticStatus(
        name=f'{NAME}: x', level=b'\xff', message='\u202e\x00\x1b[31m')])),
    'unknown joints': ('/joint_states', JointState(name=['a'], position=[1.0])),
    'empty world': (f'/{NAME}/mjcf_archive', UInt8MultiArray(data=archive('<mujoco/>')))}


@pytest.mark.full
def test_malformed_messages_are_logged_once_a_second_and_the_viewer_goes_on(client):
    """The page of the next test shows that it goes on to show what is right."""
    process, address = start_viewer('--node', NAME)
    hostile = HostileNode(lambda what: what)
    log = client.log()
    try:
        # What is on the topics of a layout is only listened to when there is one.
        client.spin_until(lambda: client.node.count_subscribers('/joint_states') > 0)
        client.spin_until(lambda: client.node.count_subscribers('/objects/cube/pose') > 0)
        for topic, message, text in [*MALFORMED.values(), *((*odd, '') for odd in ODD.values())]:
            kind = PoseStamped if isinstance(message, bytes) else type(message)
            publisher = client.node.create_publisher(
                kind, topic, LATCHED if 'archive' in topic else 10)
            client.spin_until(lambda: publisher.get_subscription_count() > 0)  # noqa: B023

            def is_logged():
                publisher.publish(message)  # noqa: B023
                return any(line.startswith(topic) and re.search(text, line)  # noqa: B023
                           for line in log) or not text  # noqa: B023
            client.spin_until(is_logged)
            client.node.destroy_publisher(publisher)
            assert process.poll() is None, (topic, text)
        # Beside the hundreds that were sent, and a few of each kind at the turn of a second.
        assert len(log) < 3 * len(MALFORMED)
    finally:
        hostile.close()
        output, errors = end(process)
    assert process.returncode == 0
    assert 'Traceback' not in errors + output


#: The viewer with more time for checks of models: a page on a busy machine is slow to show them.
PATIENT = """
import sys
from manip_sim.models import untrusted_models
from manip_sim.viewer.__main__ import main
untrusted_models.MAX_WALL_S = 1e4
sys.exit(main())
"""


def trials(process):
    """Return the processes in which another one compiles models."""
    found = []
    for status in Path('/proc').glob('[0-9]*/stat'):
        try:
            parent = status.read_text().rpartition(')')[2].split()[1]
            # As soon as it is a program of its own.
            program = (status.parent / 'cmdline').read_bytes()
            if parent == str(process.pid) and b'untrusted_models' in program:
                found.append(int(status.parent.name))
        except OSError:  # It has just ended.
            continue
    return found


@pytest.mark.full
@pytest.mark.skipif(not Path('/proc/self/stat').exists(), reason='needs /proc')
def test_a_model_that_takes_long_is_checked_beside_the_page_and_given_up_at_the_end(client):
    # MuJoCo works for a quarter of a minute on it.
    slow = archive('<mujoco><worldbody>' + 30_000 * '<body><geom size="1"/></body>'
                   + '</worldbody></mujoco>')
    words = {}
    hostile = HostileNode(lambda what: words.get(what, what))
    process, address = start_viewer('--node', NAME, program=('-c', PATIENT))
    held = []

    def hold():
        held.extend(trials(process))
        return bool(held)

    async def look_at_the_check():
        async with page_client(address) as page:
            def shows(state):
                return any(re.search(state, found) for found in page.texts.values())
            running = r'[0-9] s, [0-9.]+ × real time'
            await page.read_until(lambda: shows(running))
            hostile.model.publish(UInt8MultiArray(data=slow))
            await page.read_until(hold)
            # It does not end by itself any more.
            os.kill(held[0], signal.SIGSTOP)
            await page.read_until(lambda: shows(running + ', checking a new model'))
            # What comes meanwhile is shown.
            page.texts.clear()
            await page.read_until(lambda: shows(running))
            words['state'] = 'paused'
            await page.read_until(lambda: shows('paused at [0-9.]+ s, checking a new model'))
    try:
        asyncio.run(look_at_the_check())
        _, errors = end(process)
        assert (process.returncode, errors) == (0, '')
        client.spin_until(lambda: not Path(f'/proc/{held[0]}').exists())
    finally:
        hostile.close()
        process.kill()
        for pid in held:
            if Path(f'/proc/{pid}').exists():
                os.kill(pid, signal.SIGKILL)


def test_readers_have_rejected_nothing_at_first_and_count_each():
    warnings = []
    logger = SimpleNamespace(warn=warnings.append, warning=warnings.append)
    readers = Readers(SimpleNamespace(get_logger=lambda: logger))
    assert readers.rejected == 0
    for count in (1, 2):
        readers.reject('/joint_states', ManipSimError('no'))
        assert readers.rejected == count
    assert len(warnings) == 1
