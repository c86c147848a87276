# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""That ``benchmark/bench.py`` starts, and how it judges, prints and writes figures."""

import json
from pathlib import Path
import re
import subprocess
import sys

import mujoco
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def bench(benchmark_module):
    """Return the modules of the figures and of the entrance."""
    return benchmark_module('targets.figures'), benchmark_module('bench')


def test_help_names_every_row(bench):
    _, entrance = bench
    done = subprocess.run([sys.executable, ROOT / 'benchmark' / 'bench.py', '--help'],
                          capture_output=True, text=True, timeout=60, check=True)
    assert all(name in done.stdout for name in entrance.ROWS)


#: Starts all programs of a folder with --help in one process, as imports take most of the time.
HELP = """
import contextlib, io, json, pathlib, runpy, sys
folder, found = pathlib.Path(sys.argv[1]), {}
sys.path.insert(0, str(folder))
for path in sorted(folder.glob('*.py')):
    if '__main__' not in path.read_text():
        continue
    out, sys.argv = io.StringIO(), [str(path), '--help']
    try:
        with contextlib.redirect_stdout(out):
            runpy.run_path(str(path), run_name='__main__')
        found[path.name] = f'it ran: {out.getvalue()}'
    except SystemExit as end:
        found[path.name] = end.code, out.getvalue()
    except ModuleNotFoundError as error:
        found[path.name] = error.name
print(json.dumps(found))
"""


@pytest.mark.full
def test_every_program_answers_help_and_does_nothing_else():
    done = subprocess.run([sys.executable, '-c', HELP, ROOT / 'benchmark'], capture_output=True,
                          text=True, timeout=300, check=True)
    found = json.loads(done.stdout)
    assert len(found) > 15
    for name, answer in found.items():
        if answer in ('rclpy', 'diagnostic_msgs'):
            continue  # There is no ROS here.
        assert answer[0] == 0 and answer[1].startswith('usage: '), f'{name}: {answer}'


def test_every_row_of_the_entrance_has_its_function(bench):
    _, entrance = bench
    for module, function, _, limit_s in entrance.ROWS.values():
        source = (ROOT / 'benchmark' / 'targets' / f'{module}.py').read_text()
        assert f'\ndef {function}(settings: Settings)' in source
        assert limit_s > 0.0
    # All rows together end within half an hour, whatever hangs.
    assert sum(limit_s for *_, limit_s in entrance.ROWS.values()) < 1800.0


@pytest.mark.parametrize('sign, value, rounds, ok', [
    ('>=', 0.8, [0.9, 0.79, 0.81], True), ('>=', 0.8, [0.9, 0.79, 0.7], False),
    ('<=', 1.3, [1.2, 1.31, 1.3], True), ('<=', 1.3, [1.2, 1.31, 1.4], False)])
def test_the_median_of_the_rounds_is_judged(bench, sign, value, rounds, ok):
    figures, _ = bench
    figure = figures.Figure('free', 'what', rounds, target=figures.Target(sign, value))
    assert figure.ok is ok
    assert figure.missed is not ok


@pytest.mark.parametrize('ours, theirs, more, verdict', [
    (0.5, 0.4, True, 'ahead'), (0.4, 0.5, True, 'behind'), (0.4, 0.5, False, 'ahead'),
    (0.5, 0.4, False, 'behind'), (1.0, 0.99, True, 'level'), (0.99, 1.0, True, 'level')])
def test_figures_are_compared_with_those_of_the_plain_loop(bench, ours, theirs, more, verdict):
    figures, _ = bench
    figure = figures.Figure('free', 'what', [ours], plain=[theirs], more_is_better=more)
    assert figure.against_plain == verdict
    assert figure.missed is (verdict == 'behind')


def test_the_table_has_a_line_of_equal_length_for_each_figure(bench):
    figures, _ = bench
    lines = figures.table([
        figures.Figure('free', 'of bare', [0.7, 0.9, 0.81], '', figures.Target('>=', 0.8),
                       plain=[0.25], cpp=[0.5, 0.7]),
        figures.Figure('effect', 'soon', [3.26, 3.0, 4.0], 'periods', figures.Target('<=', 3.0),
                       more_is_better=False, cpp=None)]).splitlines()
    assert len({len(line) for line in lines}) == 1
    cells = [re.split(r' *\| *', line)[1:-1] for line in lines]
    assert cells[0] == list(figures.COLUMNS)
    assert cells[2] == ['of bare', '>= 0.8', '0.81', '0.70 to 0.90', '0.25, ahead', '0.60', 'ok']
    assert cells[3] == ['soon', '<= 3 periods', '3.26 periods', '3.00 to 4.00', '-',
                        '- (no rclcpp)', '**misses**']


@pytest.mark.full
def test_a_row_without_ros_is_measured_and_written(tmp_path):
    done = subprocess.run(
        [sys.executable, ROOT / 'benchmark' / 'bench.py', '--quick', '--rounds', '1',
         '--only', 'robots', '--output', tmp_path / 'out'], capture_output=True, text=True,
        timeout=100)
    assert done.returncode in (0, 1), done.stderr
    assert '| 8 Pandas in one world' in done.stdout
    assert 'robots, a world of 8' in done.stderr
    written = json.loads((tmp_path / 'out' / 'bench.json').read_text())
    assert set(written) == {'about', 'figures', 'missing', 'series'}
    for figure in written['figures']:
        assert figure['row'] == 'robots'
        assert figure['spread'][0] <= figure['figure'] <= figure['spread'][1]
    assert written['about']['cores'] <= 2
    assert 0.0 <= written['about']['of_others'] <= 1.0


@pytest.fixture
def results(bench, tmp_path):
    """Return results without any figure, and settings that note what is reported."""
    figures, entrance = bench
    told = []
    settings = figures.Settings(1, 1.0, 0.0, told.append)
    return entrance.Results(tmp_path / 'bench.json', {}, settings.series), settings, told


def test_a_row_that_fails_leaves_its_figures_and_the_other_rows(bench, results, monkeypatch):
    figures, _ = bench
    from targets import period, robots
    results, settings, told = results

    def fail(settings):
        yield figures.Figure('robots', 'before', [2.0])
        raise figures.MeasureError('no answer')

    def measure(settings):
        written = json.loads(results.path.read_text())
        assert [figure['what'] for figure in written['figures']] == ['before']
        yield figures.Figure('period', 'what', [1.0])
    monkeypatch.setattr(robots, 'measure', fail)
    monkeypatch.setattr(period, 'measure', measure)
    results.measure(['robots', 'period'], settings)
    assert [figure.row for figure in results.figures] == ['robots', 'period']
    assert results.missing == {'robots': 'failed: MeasureError: no answer'}
    assert results.failed
    assert told == ['robots: failed: MeasureError: no answer']
    assert len(json.loads(results.path.read_text())['figures']) == 2


def test_a_row_whose_module_cannot_be_imported_leaves_the_others(bench, results, monkeypatch):
    figures, entrance = bench
    from targets import period
    results, settings, _ = results

    def measure(settings):
        yield figures.Figure('period', 'what', [1.0])
    monkeypatch.setattr(period, 'measure', measure)
    monkeypatch.setitem(entrance.ROWS, 'robots', ('not_there', 'measure', False, 60.0))
    results.measure(['robots', 'period'], settings)
    assert [figure.row for figure in results.figures] == ['period']
    assert 'not_there' in results.missing['robots']


@pytest.mark.full
def test_every_row_runs(bench, tmp_path):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    _, entrance = bench
    done = subprocess.run(
        [sys.executable, ROOT / 'benchmark' / 'bench.py', '--smoke', '--output', tmp_path],
        capture_output=True, text=True, timeout=500)
    assert done.returncode in (0, 1), done.stderr
    written = json.loads((tmp_path / 'bench.json').read_text())
    assert written['missing'] == {}, done.stderr
    assert [figure['row'] for figure in written['figures']] == list(entrance.ROWS)


def test_the_loop_in_cpp_has_the_topics_of_the_plain_loop():
    plain, cpp = ((ROOT / 'benchmark' / path).read_text()
                  for path in ('targets/plain_loop.py', 'cpp_loop/main.cpp'))
    theirs = re.findall(r"create_(\w+)\((\w+), '([\w/]+)'", plain)
    assert len(theirs) == 3
    assert re.findall(r'create_(\w+)<(\w+)>\(\s*"([\w/]+)"', cpp) == theirs


def test_without_rclcpp_the_remedy_for_the_loop_in_cpp_is_said():
    done = subprocess.run(
        [sys.executable, '-c', 'from targets.cpp_loop import build; print(*build())'],
        cwd=ROOT / 'benchmark', env={'PATH': '/usr/bin:/bin'}, capture_output=True, text=True,
        timeout=60)
    assert done.stdout.startswith('None C++ loop: '), done.stderr
    assert 'is not found; install CMake and a ROS 2 with rclcpp' in done.stdout


def test_a_step_of_the_bare_physics_shows_the_effort_of_a_motor(bench):
    from targets import answers, physics
    bare = physics.Bare(physics.panda(answers.PERIOD_S))
    bare.make_motor(answers.JOINT)
    joint = bare.model.joint(answers.JOINT)
    bare.data.ctrl[bare.model.actuator_trnid[:, 0] == joint.id] = 0.2
    mujoco.mj_step(bare.model, bare.data)
    assert bare.data.qfrc_actuator[joint.dofadr[0]] == pytest.approx(0.2, abs=0.01)


@pytest.mark.full
def test_the_loop_in_cpp_publishes_in_real_time_and_obeys_a_controller(bench, tmp_path):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    from targets import answers, cpp_loop, physics, processes
    program, why = cpp_loop.build()
    if 'is not found' in why:
        pytest.skip(why)
    assert program is not None, why
    bare = physics.Bare(physics.panda(answers.PERIOD_S))
    bare.make_motor(answers.JOINT)
    model = bare.save(tmp_path)
    command = processes.loops(model, '1', '1')[1]
    with processes.Process(command, apart=1) as loop, \
            processes.start_script('commander.py', 'effect', answers.JOINT, apart=1) as client:
        client.line()
        delays = client.ask('effect 20')
        loop.check()
    assert len(delays) == 20
    assert max(delays) < 1.0


@pytest.mark.full
def test_two_programs_in_one_domain_are_not_measured(bench, tmp_path):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    figures, _ = bench
    from targets import physics, processes, watched
    model = physics.Bare(physics.panda()).save(tmp_path)
    command = processes.loops(model, '10', '1')[0]
    with processes.Process(command, apart=1), \
            watched.watched_loop(watched.ONE_CLIENT, 0.1, command, 1) as loop, \
            pytest.raises(figures.MeasureError, match='2 publishers of joint_states'):
        loop.watch(1.0)


def test_only_to_see_that_rows_run_processes_are_not_waited_for_to_be_fast(bench):
    figures, _ = bench
    assert figures.Settings(3, 0.2, 0.0, print).wait_scale == 1.0
    assert figures.Settings(1, 0.01, 0.0, print, smoke=True).wait_scale == 0.01


def test_a_row_that_takes_too_long_is_ended(bench):
    figures, entrance = bench
    with pytest.raises(figures.MeasureError, match='not done after 0.05 s'), \
            entrance.limited(0.05):
        while True:
            pass
