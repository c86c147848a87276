# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure how fast the node is, and print a table of the figures against their targets.

Figures are ratios to a bare baseline in the same run, or what another process sees of the node.
Each is the median of several rounds, in which the compared programs take turns (A B A B); that of
memory is the median of the last samples of one run. All processes
stay on two cores of this machine, in a ROS domain that nobody else uses. The column "plain loop"
is a loop of rclpy and MuJoCo without this package, "C++ loop" the same in C++, a yardstick where
CMake finds rclcpp. The rows are explained in docs/explanation/performance.md.

Writes bench.json, each figure when it is measured, and, where matplotlib is installed, pictures.
A row that fails leaves the others. The exit code is 0 if no
target is missed, no figure is behind the plain loop and no row fails; else 1. It is 2 if the
command line is wrong. Rows that need ROS are skipped without it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import contextlib
import importlib
import importlib.util
import json
import os
from pathlib import Path
import platform
import signal
import sys
import time
from typing import Any

_HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(_HERE))

import mujoco  # noqa: E402
from targets.cpp_loop import build  # noqa: E402
from targets.figures import Figure, MeasureError, Settings, table  # noqa: E402
from targets.pictures import draw  # noqa: E402

#: By row: module, function, whether it needs ROS, and the most time that it may take [s].
ROWS = {
    'free': ('free', 'measure', True, 300.0),
    'realtime': ('realtime', 'measure', True, 240.0),
    'effect': ('answers', 'measure_effect', True, 90.0),
    'lockstep': ('answers', 'measure_lockstep', True, 60.0),
    'robots': ('robots', 'measure', False, 90.0),
    'start': ('start', 'measure', True, 360.0),
    'memory': ('memory', 'measure', True, 200.0),
    'period': ('period', 'measure', False, 60.0),
    'worlds': ('many_worlds', 'measure', False, 150.0),
    'rates': ('free', 'measure_rates', True, 180.0),
}
#: Of the durations: for a first look, and to see that a row runs.
_QUICK, _SMOKE = 0.2, 0.01
#: Of the cores; where others use more, the figures are not to be trusted.
_OF_OTHERS = 0.05


def read_arguments() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--only', nargs='+', metavar='ROW', choices=ROWS, default=list(ROWS),
                        help=f'rows to measure, of {", ".join(ROWS)}')
    parser.add_argument('--quick', action='store_true',
                        help='three short rounds, to look; figures are less certain')
    parser.add_argument('--smoke', action='store_true',
                        help='one round, of a fraction of a second, of the first figure of each '
                        'row: whether it runs; the figures mean nothing')
    parser.add_argument('--rounds', type=int, default=0,
                        help='of each figure (5; quick: 3; smoke: 1)')
    parser.add_argument('--hours', type=float, default=0.0,
                        help='simulated time of the row memory [h]; 0: what fits into 90 s')
    parser.add_argument('--output', type=Path, default=Path('build/bench'), metavar='FOLDER',
                        help='for bench.json and the pictures (%(default)s)')
    parser.add_argument('--draw', type=Path, metavar='JSON',
                        help='measure nothing, and draw the pictures of a bench.json')
    return parser.parse_args()


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise :class:`MeasureError` in what takes longer than this; 0 is no limit."""
    def end(*_: object) -> None:
        raise MeasureError(f'not done after {seconds:g} s')
    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


class Results:
    """
    The figures so far, in a file as soon as they are measured.

    :param path: of the JSON file
    :param about: the machine and the settings
    :param series: data for the pictures
    """

    def __init__(self, path: Path, about: dict[str, Any], series: dict[str, Any]) -> None:
        self.path, self.about, self.series = path, about, series
        self.figures: list[Figure] = []
        self.missing: dict[str, str] = {}
        self.failed = False

    def write(self) -> None:
        """Replace the file; an interrupted write leaves the previous one."""
        new = self.path.with_suffix('.new')
        new.write_text(json.dumps({
            'about': self.about, 'figures': [figure.as_json() for figure in self.figures],
            'missing': self.missing, 'series': self.series}, indent=1))
        new.replace(self.path)

    def measure(self, names: list[str], settings: Settings) -> None:
        """Measure rows; one that fails keeps its figures so far, and the next one follows."""
        for name in names:
            module, function, needs_ros, limit_s = ROWS[name]
            if needs_ros and importlib.util.find_spec('rclpy') is None:
                self._miss(name, 'skipped: it needs ROS 2', settings)
                continue
            try:
                row: Callable[[Settings], Iterator[Figure]] = getattr(
                    importlib.import_module(f'targets.{module}'), function)
                with limited(0.0 if settings.hours and name == 'memory' else limit_s):
                    for figure in row(settings):
                        self.figures.append(figure)
                        self.write()
                        if settings.smoke:
                            break
            except Exception as error:  # The other rows are measured all the same.
                self.failed = True
                self._miss(name, f'failed: {type(error).__name__}: {error}', settings)

    def _miss(self, name: str, why: str, settings: Settings) -> None:
        self.missing[name] = why
        settings.report(f'{name}: {why}')
        self.write()


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    lines = Path('/proc/cpuinfo').read_text().splitlines()
    model = next((line.split(':', 1)[1].strip() for line in lines
                  if line.startswith('model name')), platform.machine())
    return {'processor': model, 'cores': len(os.sched_getaffinity(0)),
            'python': platform.python_version(), 'mujoco': mujoco.__version__}


def save(series: dict[str, Any], folder: Path) -> None:
    """Draw the pictures, or say why not."""
    try:
        for path in draw(series, folder):
            print(f'drawn: {path}')
    except ImportError:
        print('pictures skipped: matplotlib is not installed (pip install matplotlib)')


def settle_down() -> None:
    """Set the environment and the CPU affinity of this process and all that it starts."""
    from manip_sim.testing.domains import reserve_domain
    from targets.processes import stay_on_two_cores
    os.environ['ROS_DOMAIN_ID'] = str(reserve_domain()[0])
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['PYTHONPATH'] = os.pathsep.join(
        [str(_HERE.parent), *filter(None, [os.environ.get('PYTHONPATH')])])
    # Byte code is kept, as it is where the node is installed.
    os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
    stay_on_two_cores()


def report(results: Results) -> None:
    """Print the table, the rows that are missing, and a warning if the machine was busy."""
    about = results.about
    print(f'{about["processor"]}, {about["cores"]} cores, Python {about["python"]}, '
          f'MuJoCo {about["mujoco"]}, {about["rounds"]} rounds, '
          f'durations times {about["scale"]}\n')
    if results.figures:
        print(f'{table(results.figures)}\n')
    for name, why in results.missing.items():
        print(f'{name}: {why}')
    if about['of_others'] > _OF_OTHERS:
        print(f'others used {100 * about["of_others"]:.0f} % of the cores meanwhile: '
              'measure again')
    if any(figure.cpp is None for figure in results.figures):
        print(build()[1])
    print(f'written: {results.path}')
    save(results.series, results.path.parent)
    missed = [figure for figure in results.figures if figure.missed]
    print(f'{len(results.figures)} figures in {about["seconds"]:.0f} s: {len(missed)} miss their '
          'target or are behind the plain loop')


def main() -> int:
    """Measure, print and write."""
    arguments = read_arguments()
    folder: Path = arguments.output
    folder.mkdir(parents=True, exist_ok=True)
    if arguments.draw is not None:
        save(json.loads(arguments.draw.read_text())['series'], folder)
        return 0
    # Processes that were started are ended with this one, also where it runs in the background.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    settle_down()
    from targets.processes import busy_s, own_s
    begin, of_all_s = time.time(), busy_s()
    rounds, scale = (3, _QUICK) if arguments.quick else (5, 1.0)
    if arguments.smoke:
        rounds, scale = 1, _SMOKE
    about = {'begin': time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime(begin)), **machine(),
             'rounds': arguments.rounds or rounds, 'scale': scale}

    def progress(what: str) -> None:
        print(f'{time.time() - begin:5.0f} s  {what}', file=sys.stderr, flush=True)
    settings = Settings(about['rounds'], scale, arguments.hours, progress, arguments.smoke)
    results = Results(folder / 'bench.json', about, settings.series)
    try:
        if any(ROWS[name][2] for name in arguments.only):
            progress('C++ loop, its build')
            build()
        results.measure(arguments.only, settings)
    finally:  # Also of a run that is interrupted.
        about['seconds'] = round(time.time() - begin, 1)
        of_others_s = max(0.0, busy_s() - of_all_s - own_s())
        about['of_others'] = round(of_others_s / (about['cores'] * about['seconds']), 3)
        results.write()
        report(results)
    return 1 if results.failed or any(figure.missed for figure in results.figures) else 0


if __name__ == '__main__':
    sys.exit(main())
