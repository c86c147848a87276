# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The command as a user meets it: help, exit codes, errors, pipes."""

import json
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest

import manip_sim
from manip_sim.cli.command_line import COMPOSITION

COMMANDS = ('list', 'describe', 'export', 'render', 'check', 'compare', 'record', 'replay',
            'convert')
#: Raises what a class of another package may raise, in place of a command.
FAILING = """
import sys
from manip_sim.cli import main
class Command:
    @staticmethod
    def run(options):
        raise KeyError('lost\\nand found')
sys.modules['manip_sim.cli.describe'] = Command
sys.exit(main.run())
"""


def test_help_names_every_command(command):
    done = command('--help')
    assert done.returncode == 0 and done.stderr == ''
    for name in COMMANDS:
        assert re.search(rf'^ +{name} +\w', done.stdout, re.MULTILINE), name


@pytest.mark.parametrize('name', COMMANDS)
def test_help_of_each_command_tells_all_options_and_exit_codes(name, here, monkeypatch):
    monkeypatch.setenv('COLUMNS', '80')
    code, text, errors = here(name, '--help')
    assert code == 0 and errors == ''
    assert 'Exit codes: 0' in text and 'example' in text
    description = text.split('\n\n')[1].splitlines()
    assert re.match(r'([A-Z])(?!(?i:\1))[a-z]', description[0])
    # Each line is as long as the next word allows.
    for line, following in zip(description, description[1:]):
        assert len(line) <= 78 < len(line) + 1 + len(following.split()[0])
    composes = name not in ('list', 'compare', 'record', 'replay', 'convert')
    for option in COMPOSITION:
        assert (f'--{option.replace("_", "-")}' in text) == composes


@pytest.mark.parametrize('columns', ['1', '13', '10000'])
def test_help_is_given_in_terminals_of_all_widths(columns, here, monkeypatch):
    monkeypatch.setenv('COLUMNS', columns)
    code, text, errors = here('list', '--help')
    assert (code, errors) == (0, '')
    assert ' List the available parts and tasks, and where they' in ' '.join(text.split())


@pytest.mark.parametrize(('arguments', 'what', 'of'), [
    ((), 'COMMAND', ''), (('--robot', 'Panda'), "a COMMAND comes before '--robot'", ''),
    (('sim_node', '--ros-args'), "type 'sim_node' without 'manip_sim'", ''),
    (('lst',), 'invalid choice', ''), (('list', 'cars'), 'cars', ' list'),
    (('describe', '--robt', 'Panda'), '--robt', ' describe'),
    (('describe', '--rob', 'Panda'), '--rob', ' describe'),
    (('describe', 'Panda'), 'Panda (options name the parts: --robot NAME)', ' describe'),
    (('list', 'robots', 'Panda'), 'unrecognized arguments: Panda;', ' list'),
    (('export',), 'FILE', ' export'),
    (('describe', '--position', '1', '2'), '--position', ' describe'),
    (('describe', '--position', '1', '2', 'nan'), "finite number, got 'nan'", ' describe'),
    (('describe', '--arena-param', 'cube'), "must be like NAME=VALUE, got 'cube'", ' describe'),
    (('render', 'a.png', '--size', '800'), "must be like 800x540, got '800'", ' render'),
    (('render', 'a.png', '--size', '15x16'), "from 16 to 8192 pixels each way, got '15x16'",
     ' render'),
    (('run', 'reach', '--policy', 'zero', '--seeds', '0:1'),
     'the following arguments are required: --out', ' run'),
    (('render', 'a.png', '--size', '8x9000'), 'from 16 to 8192 pixels', ' render'),
    (('render', 'a.png', '--camera', 'c', '--azimuth', '3'), 'either --camera or', ' render'),
    (('render', 'a.png', '--robot', 'none'), 'give one of --gripper, --base and', ' render'),
    (('render', 'a.png', '--robot', 'none', '--base', 'B', '--arena', 'a'), 'one of', ' render'),
    (('check', 'a.xml', '--robot', 'Panda'), 'either a FILE or a composition', ' check')])
def test_a_wrong_command_line_is_one_line_and_exit_code_2(arguments, what, of, rejected):
    line = rejected(*arguments, code=2)
    assert what in line
    assert line.endswith(f'; see manip_sim{of} --help')


def test_a_long_text_is_told_by_its_beginning(here):
    code, _, errors = here('describe', '--arena-param', 200 * 'x')
    assert code == 2 and f"got '{60 * 'x'}'" in errors


@pytest.mark.parametrize(('arguments', 'what'), [
    (('describe', '--robot', 'Pnda'), "'robot': unknown value 'Pnda': did you mean 'Panda'"),
    (('describe', '--robot', 'none'), "'robot': unknown value 'none'"),
    (('check', '--gripper', 'Robotiq'), "'gripper': unknown value 'Robotiq'"),
    (('check', '--base', 'Retink'), "'base': unknown value 'Retink': did you mean"),
    (('check', '--arena', 'tabel'), "'arena': unknown value 'tabel': did you mean 'table'"),
    (('check', '--arena', 'tabel', '--arena-param', 'a=1'), "unknown arena 'tabel'"),
    (('check', '--arena', 'table', '--arena-param', 'friction=x'),
     "friction must be a number, got 'x'"),
    (('check', '--arena', 'table', '--arena-param', 'cub=true'),
     "unknown parameter of arena 'table' 'cub': did you mean 'cube'"),
    (('check', '--arena', 'table', '--arena-param', 'cube=maybe'),
     "table: cube must be true or false, got 'maybe'"),
    (('check', '--arena', 'table', '--arena-param', 'table_height=high'),
     "table: table_height must be a number, got 'high'"),
    (('check', '--arena', 'table', '--arena-param', 'table_height=-1'), 'must be from 0.1 to 2 m'),
    (('check', '--prefix', 'left/'), "prefix 'left/'"),
    (('check', '--timestep', '0'), "'timestep' must be from 0.0001 to 0.01 s, got 0")])
def test_what_cannot_be_composed_is_one_line_and_exit_code_1(arguments, what, rejected):
    assert what in rejected(*arguments)


@pytest.mark.full
def test_a_process_ends_with_the_exit_code_and_one_line(command):
    for arguments, code in ((('check',), 0), (('check', '--robot', 'Pnda'), 1), (('chek',), 2)):
        done = command(*arguments)
        assert done.returncode == code
        assert done.stderr.count('\n') == (code != 0)


def test_composition_options_reach_the_world(here):
    code, text, _ = here('describe', '--json', '--robot', 'UR5e', '--gripper', 'none', '--base',
                         'none', '--arena', 'table', '--arena-param', 'cube=true', '--arena-param',
                         'table_height=1.25', '--idn', '3', '--position', '1', '-2', '0.5',
                         '--orientation', '0', '0', '1.5707963', '--timestep', '0.001',
                         '--no-gravity-compensation')
    found = json.loads(text)
    values = {parameter['name']: parameter['value'] for parameter in found['parameters']}
    assert code == 0 and found['arena'] == 'table'
    assert [model['class'] for model in found['models']] == ['UR5e']
    assert found['joints'][0]['name'].startswith('robot3_')
    root = found['frames'][0]
    assert root['position_m'] == pytest.approx([1.0, -2.0, 0.5])
    assert root['quat_xyzw'] == pytest.approx([0.0, 0.0, 0.5**0.5, 0.5**0.5], abs=1e-6)
    assert found['objects'] == [{'name': 'cube', 'mass_kg': pytest.approx(0.1)}]
    assert {'gripper': 'none', 'base': 'none', 'idn': 3, 'timestep': 0.001, 'cube': True,
            'gravity_compensation': False}.items() <= values.items()


def test_a_prefix_begins_all_names(here):
    _, text, _ = here('describe', '--prefix', 'left_')
    assert 'left_joint1' in text and 'left_gripper_finger_joint1' in text
    assert 'robot0_' not in text.replace('such as robot0_joint1', '')


@pytest.mark.full
@pytest.mark.parametrize('unbuffered', ['', '1'])
@pytest.mark.parametrize('arguments', [('describe', '--robot', 'GR1'), ('--help',)])
def test_a_reader_that_has_seen_enough_is_no_error(arguments, unbuffered, environment):
    process = subprocess.Popen([sys.executable, '-m', 'manip_sim.cli', *arguments],
                               env={**environment, 'PYTHONUNBUFFERED': unbuffered},
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.stderr.read() == b''
    process.stderr.close()
    assert process.wait(timeout=300.0) == 0


@pytest.mark.full
def test_defects_are_the_exit_code_though_nobody_reads_them(environment):
    process = subprocess.Popen(
        [sys.executable, '-m', 'manip_sim.cli', 'check', '--robot', 'UR5e', '--gripper',
         'FourierRightHand'], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.stderr.read() == b''
    process.stderr.close()
    assert process.wait(timeout=300.0) == 1


@pytest.mark.full
@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
@pytest.mark.parametrize('unbuffered', ['', '1'])
def test_output_that_cannot_be_written_is_one_line(unbuffered, environment):
    with Path('/dev/full').open('w') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'manip_sim.cli', 'list', 'arenas'], text=True, stdout=full,
            env={**environment, 'PYTHONUNBUFFERED': unbuffered}, stderr=subprocess.PIPE,
            timeout=300.0)
    assert done.returncode == 1
    assert done.stderr == 'manip_sim: cannot write the output: No space left on device\n'


@pytest.mark.full
def test_no_output_at_all_is_no_error(environment):
    shell = f'exec {sys.executable} -m manip_sim.cli list arenas >&-'
    done = subprocess.run(['sh', '-c', shell], env=environment, capture_output=True, timeout=300.0)
    assert (done.returncode, done.stderr) == (0, b'')


@pytest.mark.full
def test_characters_that_the_terminal_does_not_have_are_escaped(command, tmp_path):
    done = command('check', tmp_path / 'grün.xml', PYTHONIOENCODING='ascii', PYTHONUTF8='0')
    assert done.returncode == 1 and 'gr\\xfcn.xml' in done.stderr


@pytest.mark.full
@pytest.mark.parametrize(('encoding', 'text'), [
    ('ascii', b'gr\\xfcn'), ('latin-1', b'gr\xfcn'), ('utf-8', b'gr\xc3\xbcn')])
def test_an_output_is_in_the_encoding_of_the_terminal(encoding, text, environment, mjcf):
    file = mjcf('<body><joint name="joint"/><geom size="0.1"/></body>', name='grün')
    done = subprocess.run(
        [sys.executable, '-m', 'manip_sim.cli', 'check', file], capture_output=True, timeout=300.0,
        env={**environment, 'PYTHONIOENCODING': encoding, 'PYTHONUTF8': '0'})
    assert done.stderr == b'' and text in done.stdout


def test_what_nobody_expected_is_one_line_too(environment):
    def run(*options):
        return subprocess.run([sys.executable, *options, '-c', FAILING, 'describe'], text=True,
                              env=environment, capture_output=True, timeout=300.0)
    done = run()
    assert done.returncode == 1 and done.stderr.count('\n') == 1
    assert done.stderr.startswith('manip_sim: unexpected KeyError: ')
    assert 'python3 -X dev -m manip_sim.cli' in done.stderr
    assert 'Traceback' in run('-X', 'dev').stderr


@pytest.mark.full
def test_ctrl_c_ends_it_without_a_traceback(environment):
    slow = ("import sys, time; from manip_sim.cli import __main__, describe; "
            "describe.run = lambda options: (print('ready', flush=True), time.sleep(60)); "
            'sys.exit(__main__.run())')
    process = subprocess.Popen([sys.executable, '-c', slow, 'describe'], env=environment,
                               text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == 'ready\n'
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=300.0)[1] == ''
    assert process.returncode == -signal.SIGINT


def test_help_needs_neither_mujoco_nor_numpy_nor_ros(environment):
    script = ("import sys; from manip_sim.cli.main import main\n"
              "try: main(['render', '--help'])\nexcept SystemExit: pass\n"
              "print({'mujoco', 'numpy', 'rclpy', 'PIL'} & set(sys.modules))")
    done = subprocess.run([sys.executable, '-c', script], env=environment, text=True,
                          capture_output=True, timeout=300.0)
    assert done.stdout.splitlines()[-1] == 'set()'


@pytest.mark.full
def test_no_command_needs_ros_or_a_renderer_but_render(environment):
    script = ("import sys; sys.modules['rclpy'] = None; from manip_sim.cli.main import main\n"
              "assert main(['list']) == main(['describe']) == main(['check']) == 0\n"
              "print({'OpenGL', 'glfw', 'PIL'} & set(sys.modules))")
    done = subprocess.run([sys.executable, '-c', script], text=True, capture_output=True,
                          env={**environment, 'MUJOCO_GL': 'nonsense'}, timeout=300.0)
    assert done.stdout.splitlines()[-1] == 'set()', done.stderr


def test_the_version_is_that_of_the_package(command):
    done = command('--version')
    assert (done.returncode, done.stdout) == (0, f'manip_sim {manip_sim.__version__}\n')
