# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Priority, processors and memory of the process of a node."""

import contextlib
import ctypes
import os
from pathlib import Path
import resource
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(
    not hasattr(os, 'sched_setscheduler'), reason='needs the scheduler of Linux')
#: ``PR_CAPBSET_DROP`` and the capabilities that permit priorities and locked memory.
_DROP, _IPC_LOCK, _NICE = 24, 14, 23


def may_have_priority():
    """Return whether this process may give itself a real-time priority."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def priorities(process):
    """Return the priorities of the threads of a process; threads that end meanwhile have none."""
    found = []
    for task in Path(f'/proc/{process.pid}/task').iterdir():
        with contextlib.suppress(ProcessLookupError):
            found.append(os.sched_getparam(int(task.name)).sched_priority)
    return found


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason='needs two processors')
def test_threads_have_the_priority_that_is_permitted_and_run_where_they_should(
        sim_process, client):
    if not may_have_priority():
        pytest.skip('this user may not have real-time priorities')
    last = max(os.sched_getaffinity(0))
    node = sim_process('thread_priority:=7', f'cpu_affinity:=[{last}]')
    client.state()
    client.spin_until(lambda: priorities(node).count(7) > 3)
    assert os.sched_getaffinity(node.pid) == {last}


@pytest.mark.parametrize('parameters', [('thread_priority:=0',), ('stepping:=free',)])
def test_no_thread_has_a_priority_where_none_is_wanted(parameters, sim_process, client):
    node = sim_process(*parameters)
    client.state()
    assert set(priorities(node)) == {0}


def start(*parameters):
    """Run a node without the right to priorities and locked memory; return its output."""
    def give_up_rights():
        resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        for capability in (_NICE, _IPC_LOCK):
            ctypes.CDLL(None).prctl(_DROP, capability, 0, 0, 0)
    words = [word for parameter in parameters for word in ('-p', parameter)]
    with subprocess.Popen(
            [sys.executable, '-m', 'manip_sim', '--ros-args', *words],
            stderr=subprocess.PIPE, text=True, preexec_fn=give_up_rights) as node:
        lines = []
        for line in node.stderr:
            lines.append(line)
            if 'real-time priority' in line:
                node.terminate()
        return node.wait(), ''.join(lines)


@pytest.mark.full
def test_a_priority_that_is_not_permitted_is_told_with_its_remedy():
    code, output = start()
    assert code == 0 and output.count('real-time priority') == 1
    assert 'real-time priority 50 is not permitted' in output and 'rtprio 99' in output


@pytest.mark.full
@pytest.mark.parametrize(('parameter', 'message'), [
    ('cpu_affinity:=[4095]', "parameter 'cpu_affinity': this process may use the processors [0"),
    ('lock_memory:=true', '65536 bytes may be locked'),
    ('thread_priority:=100', 'must be from 0 to 99'),
    ('cpu_affinity:=1', 'must be of type integer_array')])
def test_values_that_cannot_be_used_end_the_start(parameter, message):
    code, output = start(parameter)
    assert code == 1 and message in output and 'Traceback' not in output
