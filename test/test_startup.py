# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How the programs start: signals, standard streams, NumPy; each in a process of its own."""

import itertools
import os
import signal
import subprocess
import sys

import pytest

from manip_sim.examples import __main__ as examples
from manip_sim.startup import processors

IMPORT = """
import os, sys
from manip_sim.startup import import_mujoco
import_mujoco()
print('OpenGL' in sys.modules or 'glfw' in sys.modules, os.environ.get('MUJOCO_GL'),
      os.environ.get('OPENBLAS_NUM_THREADS'))
"""
#: Runs a program, and tells what NumPy finds when it is imported.
WATCH = """
import os, sys

class Watch:
    def find_spec(self, name, *_):
        if name == 'numpy':
            print('numpy', os.environ.get('OPENBLAS_NUM_THREADS'))

sys.meta_path.insert(0, Watch())
sys.argv[1:] = {arguments}
from {module} import {main}
print('code', {main}())
"""
WRONG = ['--ros-args', '-r', 'nonsense']


def seen(script, **variables):
    """Return the lines that a script prints, without our variables but those given."""
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('MUJOCO_GL', 'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')}
    done = subprocess.run([sys.executable, '-c', script], env={**environment, **variables},
                          capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_mujoco_is_imported_without_opengl_and_without_threads_for_linear_algebra():
    assert seen(IMPORT) == ['False None 1']


@pytest.mark.full
def test_what_the_user_chose_stands():
    assert seen(IMPORT, MUJOCO_GL='nonsense', OPENBLAS_NUM_THREADS='2') == ['False nonsense 2']
    assert seen(IMPORT, OMP_NUM_THREADS='2') == ['False None None']


@pytest.mark.full
@pytest.mark.parametrize(('module', 'main', 'arguments', 'needed', 'code'), [
    ('manip_sim.cli.__main__', 'run', ['describe'], (), 0),
    ('manip_sim.__main__', 'main', WRONG, ('rclpy',), 1),
    ('manip_sim.viewer.__main__', 'main', WRONG, ('rclpy', 'viser'), 1)])
def test_numpy_is_imported_when_one_thread_is_chosen(module, main, arguments, needed, code):
    for package in needed:
        pytest.importorskip(package, reason=f'the program needs {package}')
    lines = seen(WATCH.format(module=module, main=main, arguments=arguments))
    assert (lines[0], lines[-1]) == ('numpy 1', f'code {code}')


#: Runs a program that gets a signal when it imports a module.
INTERRUPTED = """
import signal, sys
module, main, wanted, number, *sys.argv[1:] = sys.argv[1:]
signal.signal(int(number), signal.SIG_DFL)  # nohup ignores SIGHUP.

class Interrupt:
    def find_spec(self, name, *_):
        if name == wanted:
            signal.raise_signal(int(number))

sys.meta_path.insert(0, Interrupt())
sys.exit(getattr(__import__(module, fromlist=[main]), main)())
"""
NODE, PAGE, COMMAND = (('manip_sim.__main__', 'main'), ('manip_sim.viewer.__main__', 'main'),
                       ('manip_sim.cli.__main__', 'run'))
PICK, HAND = (('manip_sim.examples.__main__', name) for name in ('pick_cube', 'hand_over'))


@pytest.mark.parametrize(('program', 'module', 'number', 'code'), [
    (NODE, 'mujoco', signal.SIGINT, 0), (NODE, 'numpy', signal.SIGTERM, 0),
    (NODE, 'manip_sim.ros.process', signal.SIGHUP, 0),
    (PAGE, 'argparse', signal.SIGINT, 0), (PAGE, 'manip_sim.errors', signal.SIGHUP, 0),
    (PAGE, 'numpy', signal.SIGTERM, 0),
    (PICK, 'manip_sim.ros_environment', signal.SIGINT, 0), (PICK, 'mujoco', signal.SIGHUP, 0),
    (HAND, 'manip_sim.examples.hand_over', signal.SIGINT, 0), (HAND, 'numpy', signal.SIGTERM, 0),
    # Who calls a command learns that it was interrupted.
    (COMMAND, 'manip_sim.cli.main', signal.SIGINT, -signal.SIGINT),
    (COMMAND, 'numpy', signal.SIGINT, -signal.SIGINT)])
def test_a_signal_during_an_import_ends_a_program_at_once(program, module, number, code):
    if program is PAGE and module == 'numpy':
        pytest.importorskip('viser', reason='the page needs viser')
    arguments = ['describe'] if program is COMMAND else []
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED, *program, module, str(number), *arguments],
        capture_output=True, text=True, timeout=300.0)
    assert (done.returncode, done.stdout, done.stderr) == (code, '', '')


#: Raises a signal before or after one of the calls by which EndSignals takes over, in a child
#: process for each; the child ends at once, or knows of the signal afterwards.
TAKE_OVER = """
import os, signal
from manip_sim import startup

def child(number, place):
    signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # Where nohup runs the tests.
    calls = 0
    def interrupted(function):
        def call(*arguments, **named):
            nonlocal calls
            if calls == place:
                signal.raise_signal(number)
            result = function(*arguments, **named)
            if calls + 0.5 == place:
                signal.raise_signal(number)
            calls += 1
            return result
        return call
    startup.exit_on_signals()
    for owner, name in ((os, 'pipe'), (os, 'set_blocking'), (signal, 'set_wakeup_fd'),
                        (signal, 'signal')):
        setattr(owner, name, interrupted(getattr(owner, name)))
    ended = startup.EndSignals()
    for _ in range(2):
        assert ended.wait(0.0) == (place < calls), (number, place, calls)
    signal.raise_signal(number)
    assert ended.wait(0.0)
    os._exit(3 if place >= calls else 0)

codes = []
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    for place in range(14):
        pid = os.fork()
        if not pid:
            try:
                child(number, place / 2)
            finally:
                os._exit(1)
        codes.append(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
print(*codes)
"""


def test_no_signal_is_lost_while_the_signals_of_the_end_take_over():
    # Six calls, each interrupted before and after it; then a signal when all is in place.
    assert seen(TAKE_OVER) == [' '.join((['0'] * 12 + ['3'] * 2) * 3)]


#: A program that has been asked to end gets more signals, up to its last line of Python.
ENDING = """
import atexit, signal
from manip_sim import startup
numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

def interrupt():
    for number in numbers:
        signal.raise_signal(number)

class Last:
    def __del__(self, interrupt=interrupt):
        interrupt()

startup.last = Last()
atexit.register(interrupt)
startup.exit_on_signals()
ended = startup.EndSignals()
interrupt()
assert ended.wait(10.0)
interrupt()
startup.ignore_end_signals()
interrupt()
print('ended')
"""


def test_more_signals_do_not_disturb_the_end():
    assert seen(ENDING) == ['ended']


def test_what_nohup_starts_outlives_its_terminal():
    script = ('import signal; from manip_sim import startup; startup.exit_on_signals(); '
              'ended = startup.EndSignals(); signal.raise_signal(signal.SIGHUP); '
              'print(ended.wait(0.0)); signal.raise_signal(signal.SIGTERM); '
              'print(ended.wait(0.0))')
    done = subprocess.run(['nohup', sys.executable, '-c', script], capture_output=True, text=True,
                          stdin=subprocess.DEVNULL, timeout=300.0)
    assert done.stdout.splitlines() == ['False', 'True']


def test_what_a_script_starts_in_the_background_can_be_interrupted():
    # A shell without job control lets it ignore SIGINT.
    script = ('import signal; from manip_sim import startup; signal.raise_signal(signal.SIGINT); '
              'startup.exit_on_signals(); signal.raise_signal(signal.SIGINT); print("ignored")')
    done = subprocess.run(['sh', '-c', 'trap "" INT; exec "$0" -c "$1"', sys.executable, script],
                          capture_output=True, text=True, timeout=300.0)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


STREAMS = """
import os, sys
from manip_sim.startup import open_standard_streams
closed = [descriptor for descriptor, stream in enumerate((sys.stdin, sys.stdout, sys.stderr))
          if stream is None]
open_standard_streams()
null = os.stat(os.devnull)
found = []
for descriptor, stream in enumerate((sys.stdin, sys.stdout, sys.stderr)):
    assert stream.fileno() == descriptor and os.get_inheritable(descriptor)
    if os.path.samestat(os.fstat(descriptor), null):
        found.append(descriptor)
assert found == closed, (found, closed)
print('to nobody', file=sys.stdout if 1 in closed else sys.stderr, flush=True)
first = os.open('/', os.O_RDONLY)
os._exit(10 * first + len(closed))
"""


@pytest.mark.parametrize('closed', [
    closed for count in range(4) for closed in itertools.combinations(range(3), count)])
def test_standard_streams_that_are_closed_become_the_null_device(closed):
    redirections = ''.join(f' {descriptor}{"<" if descriptor == 0 else ">"}&-'
                           for descriptor in closed)
    done = subprocess.run(
        ['sh', '-c', f'exec "$0" -c "$1"{redirections}', sys.executable, STREAMS],
        stdin=subprocess.PIPE, capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 30 + len(closed), done.stderr


@pytest.mark.parametrize('program', ['pick_cube', 'hand_over'])
def test_the_help_of_an_example_waits_for_no_node(program, monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', [program, '--help'])
    assert vars(examples)['_run'](program) == 0
    assert f'usage: {program} ' in capsys.readouterr().out


def test_a_program_begins_and_ends_without_looking_for_garbage():
    script = ('import atexit, gc; from manip_sim.startup import run_program; '
              'atexit.register(lambda: print(gc.get_freeze_count() > 1000)); '
              'run_program(lambda: print(gc.isenabled()) or 0)')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True)
    assert done.stdout == 'False\nTrue\n'


@pytest.mark.full
def test_a_command_looks_for_garbage_while_it_runs():
    script = ('import gc, sys; sys.argv = ["manip_sim", "list", "bases"]; '
              'from manip_sim.cli.__main__ import run; run(); '
              'print(gc.isenabled(), gc.get_freeze_count() > 1000)')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.splitlines()[-1] == 'True True'


def processors_with(root, monkeypatch, allowed=64, **files):
    """Return the processors of a process in a file tree of its own, by paths below its root."""
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: set(range(allowed)), raising=False)
    for path, text in files.items():
        file = root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode() if isinstance(text, str) else text)
    return processors(str(root))


CGROUP, V2, V1 = 'proc/self/cgroup', 'sys/fs/cgroup/', 'sys/fs/cgroup/cpu,cpuacct/'


@pytest.mark.parametrize('files, expected', [
    ({}, 64),
    # Version 2: in a container, of which the root is the cgroup; below limits; without one.
    ({CGROUP: '0::/\n', f'{V2}cpu.max': '800000 100000\n'}, 8),
    ({CGROUP: '0::/\n', f'{V2}cpu.max': 'max 100000\n'}, 64),
    ({CGROUP: '0::/\n', f'{V2}cpu.max': '150000 100000\n'}, 2),
    ({CGROUP: '0::/\n', f'{V2}cpu.max': '1000 100000\n'}, 1),
    ({CGROUP: '0::/\n', f'{V2}cpu.max': '9900000 100000\n'}, 64),
    ({CGROUP: '0::/job/step\n', f'{V2}job/cpu.max': '300000 100000\n',
      f'{V2}job/step/cpu.max': '700000 100000\n'}, 3),
    ({CGROUP: '0::/job/step\n', f'{V2}job/cpu.max': 'max 100000\n',
      f'{V2}job/step/cpu.max': '700000 100000\n', f'{V2}other/cpu.max': '1 1\n'}, 7),
    ({CGROUP: '0::/docker/0123\n', f'{V2}cpu.max': '400000 100000\n'}, 4),
    ({CGROUP: '0::/../other\n', f'{V2}cpu.max': '400000 100000\n',
      'sys/fs/other/cpu.max': '1 1'}, 4),
    ({CGROUP: '0::/a:b/c d\n', f'{V2}a:b/c d/cpu.max': '500000 100000\n'}, 5),
    # Version 1, alone and beside version 2.
    ({CGROUP: '3:cpu,cpuacct:/job\n2:cpuset:/\n', f'{V1}job/cpu.cfs_quota_us': '600000\n',
      f'{V1}job/cpu.cfs_period_us': '100000\n'}, 6),
    ({CGROUP: '3:cpu,cpuacct:/docker/0123\n', f'{V1}cpu.cfs_quota_us': '250000\n',
      f'{V1}cpu.cfs_period_us': '50000\n'}, 5),
    ({CGROUP: '1:cpu:/\n0::/\n', 'sys/fs/cgroup/cpu/cpu.cfs_quota_us': '-1\n',
      'sys/fs/cgroup/cpu/cpu.cfs_period_us': '100000\n',
      f'{V2}unified/cpu.max': '900000 100000\n'}, 9),
    # Odd files are no limit, and hide none.
    *[({CGROUP: '0::/a\n', f'{V2}cpu.max': '600000 100000', f'{V2}a/cpu.max': odd}, 6)
      for odd in ('', '5', '0 100000', '-5 100000', '5 0', '5 100000 9', 'many few', b'\xff\x00',
                  f'{"9" * 5000} 1')],
    *[({CGROUP: odd, f'{V2}cpu.max': '600000 100000'}, 64) for odd in ('', 'cpu', '5:pids:/')],
    ({CGROUP: 'odd\n0::/\n\xfc', f'{V2}cpu.max': '600000 100000'}, 6)])
def test_processors_are_as_many_as_quotas_of_cgroups_allow(files, expected, tmp_path, monkeypatch):
    assert processors_with(tmp_path, monkeypatch, **files) == expected


def test_a_quota_allows_no_more_processors_than_the_affinity(tmp_path, monkeypatch):
    files = {CGROUP: '0::/\n', f'{V2}cpu.max': '800000 100000\n'}
    assert processors_with(tmp_path, monkeypatch, 2, **files) == 2


def test_files_of_cgroups_that_cannot_be_read_are_no_limit(tmp_path, monkeypatch):
    (tmp_path / V2 / 'cpu.max').mkdir(parents=True)
    assert processors_with(tmp_path, monkeypatch, 3, **{CGROUP: '0::/\0/\n'}) == 3
