# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Break the code on purpose, one place at a time, and tell which changes no test sees.

Run it by ``make mutate``. The changes are those of cosmic-ray. They are made in a copy of the
sources; a change is tried by the files of tests that run the line that it is in. All changes take
many hours, so give the size of a sample: ``make mutate MUTATE_ARGS='--sample 150'``.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator, Sequence
import contextlib
from dataclasses import dataclass
import difflib
import hashlib
import importlib
import json
import math
import os
from pathlib import Path
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
import pytest

ROOT = Path(__file__).resolve().parents[2]
#: What fails at once wherever it is, as bits of a float do, says nothing about tests.
_LEFT_OUT = re.compile(r'RemoveDecorator|BinaryOperator.*_(BitAnd|BitOr|BitXor|LShift|RShift)$')
#: What most tests import, and what takes long.
_IMPORTED = ('hypothesis', 'mujoco', 'pydantic', 'scipy.spatial.transform', 'yaml',
             'hypothesis.strategies', 'numpy.testing', 'rclpy.serialization', 'sensor_msgs.msg')
RECORDS = ROOT / '.mutation'


@dataclass(frozen=True)
class Scope:
    """
    Code to change, and the tests that changes are tried by.

    :ivar areas: by name, sources and how much of a sample is taken from them
    :ivar tests: arguments of pytest, without tests of rendering and those that run other tests
    """

    areas: dict[str, tuple[list[str], float]]
    tests: list[str]

    @property
    def sources(self) -> list[str]:
        """The sources of all areas."""
        return [source for sources, _ in self.areas.values() for source in sources]


SCOPES = {
    'physics': Scope(
        {'simulation': (['manip_sim/physics', 'manip_sim/control', 'manip_sim/simulation'], 0.6),
         'models': (['manip_sim/models'], 0.3),
         'messages': (['manip_sim/ros/messages.py'], 0.1)},
        ['test/models', 'test/physics', 'test/control', 'test/simulation', 'test/cli',
         'test/moveit', 'test/viewer/test_scene.py',
         'test/runtime/test_change_queue.py', 'test/ros/test_camera_thread.py',
         'test/ros/test_serialized.py', 'test/ros/test_message_fields.py',
         'test/test_parameter_properties.py', '--ignore=test/models/test_add_your_own.py']),
    'node': Scope(
        {'ros': (['manip_sim/ros'], 0.45), 'runtime': (['manip_sim/runtime'], 0.1),
         'viewer': (['manip_sim/viewer'], 0.3), 'cli': (['manip_sim/cli'], 0.15)},
        ['test/ros', 'test/runtime', 'test/viewer', 'test/cli', 'test/records',
         'test/experiments', 'test/test_startup.py',
         '--ignore=test/ros/test_documentation.py', '--ignore=test/ros/test_soak.py'])}


@dataclass(frozen=True)
class Mutant:
    """
    A change of a source file.

    :ivar file: relative to the root
    :ivar operator: name of cosmic-ray's operator
    :ivar occurrence: which of the places where the operator can be applied
    :ivar line: where the change begins
    """

    file: str
    operator: str
    occurrence: int
    line: int

    @property
    def code(self) -> str:
        """The changed source."""
        changed = mutate_code((ROOT / self.file).read_text(), get_operator(self.operator)(),
                              self.occurrence)
        return str(changed)

    @property
    def difference(self) -> str:
        """The lines that differ."""
        lines = difflib.unified_diff((ROOT / self.file).read_text().splitlines(),
                                     self.code.splitlines(), lineterm='', n=0)
        return '\n'.join(f'    {line}' for line in list(lines)[3:])

    @property
    def has_effect(self) -> bool:
        """Whether more than annotations differ, and the code can be compiled."""
        try:
            return _meaning(self.code) != _meaning((ROOT / self.file).read_text())
        except SyntaxError:
            return False


def _meaning(code: str) -> str:
    """Return a source without what annotations and docstrings say: they are never evaluated."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            node.returns = None
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
    return ast.dump(tree)


def mutants_of(file: str) -> Iterator[Mutant]:
    """Yield all changes of a file."""
    nodes = list(ast_nodes(get_ast((ROOT / file).read_text())))
    for name in sorted(operator_names()):
        operator_class = get_operator(name)
        if _LEFT_OUT.search(name) or operator_class.arguments():
            continue
        operator = operator_class()
        places = (place for node in nodes for place in operator.mutation_positions(node))
        for occurrence, (begin, _) in enumerate(places):
            yield Mutant(file, name, occurrence, begin[0])


def files_of(sources: Sequence[str]) -> list[str]:
    """Return the Python files of folders and files, relative to the root."""
    return [path.relative_to(ROOT).as_posix() for source in sources
            for path in ([ROOT / source] if source.endswith('.py')
                         else sorted((ROOT / source).rglob('*.py')))]


def sampled(scope: Scope, sample: int | None, seed: int, only: str) -> list[Mutant]:
    """
    Return changes to try, a part of them from each area.

    A place is drawn first and then one of its changes, since some places have many.

    :param sample: how many; None is all
    :param only: files whose names contain it
    """
    chosen = []
    for sources, share in scope.areas.values():
        random_of_area = random.Random(seed)
        by_place: dict[tuple[str, int, str], list[Mutant]] = {}
        for file in files_of(sources):
            for mutant in mutants_of(file) if only in file else ():
                kind = mutant.operator.split('_')[0]
                by_place.setdefault((file, mutant.line, kind), []).append(mutant)
        if sample is None:
            chosen += [mutant for place in by_place.values() for mutant in place
                       if mutant.has_effect]
            continue
        wanted, places = round(sample * share), sorted(by_place)
        random_of_area.shuffle(places)
        for place in places:
            mutant = random_of_area.choice(by_place[place])
            if wanted and mutant.has_effect:
                chosen.append(mutant)
                wanted -= 1
    return chosen


class Laboratory:
    """
    A copy of the sources, in which tests run.

    :param folder: where the copy is made
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in subprocess.run(['git', 'ls-files', '--cached', '--others',
                                    '--exclude-standard'], cwd=ROOT, check=True, text=True,
                                   stdout=subprocess.PIPE).stdout.splitlines():
            if (ROOT / name).is_file():
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, target)

    def pytest(self, arguments: Sequence[str], timeout_s: float = math.inf, **environment: str
               ) -> int | None:
        """
        Run tests in a fork of this process, which has imported what takes long to import.

        :returns: the exit code of pytest, None if they take longer than a time or crash
        """
        child = os.fork()
        if not child:
            self._become_pytest(arguments, environment)
        end_s = time.monotonic() + timeout_s
        while True:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                # What tests have started and left behind ends with them.
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() > end_s:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return None
            time.sleep(0.02)

    def _become_pytest(self, arguments: Sequence[str], environment: dict[str, str]) -> None:
        """Run tests and end this process."""
        code = 3
        try:
            os.setsid()
            os.chdir(self.folder)
            nothing = os.open(os.devnull, os.O_RDWR)
            for descriptor in range(3):
                os.dup2(nothing, descriptor)
            paths = [str(self.folder), str(self.folder / 'test')]
            sys.path[:0] = paths
            sys.dont_write_bytecode = True
            os.environ.update(
                environment, PYTHONDONTWRITEBYTECODE='1',
                PYTHONPATH=os.pathsep.join([*paths, os.environ.get('PYTHONPATH', '')]))
            # Of what is imported already pytest cannot rewrite the assertions.
            code = int(pytest.main(['-q', '-p', 'no:cacheprovider', '-W',
                                    'ignore::pytest.PytestAssertRewriteWarning', *arguments]))
        finally:
            os._exit(code)

    def record(self, scope: Scope, file: Path) -> None:
        """Run all tests once and write which lines each of them runs."""
        file.parent.mkdir(exist_ok=True)
        sources = [f'{self.folder}/{source}' + ('' if source.endswith('.py') else '/*')
                   for source in scope.sources]
        self.pytest(['-p', 'mutation.recorder', *scope.tests], MUTATION_RECORD=str(file),
                    MUTATION_SOURCES=','.join(sources))

    def outcome(self, mutant: Mutant, tests: Sequence[str], duration_s: float) -> str:
        """
        Return what becomes of a change under tests that take so long without it [s].

        :returns: SURVIVED, 'killed', 'killed by time' if the tests take much longer than without
            the change, or 'undecided' if without it they take as long at present
        """
        changed, original = self.folder / mutant.file, ROOT / mutant.file
        changed.write_text(mutant.code)
        try:
            code = self.pytest(['-x', *tests], 30.0 + 5.0 * duration_s)
        finally:
            shutil.copy2(original, changed)
        if code is None and self.pytest(['-x', *tests], 30.0 + 5.0 * duration_s) is None:
            return 'undecided'
        return {0: 'SURVIVED', None: 'killed by time'}.get(code, 'killed')


class Record:
    """
    Which tests run each line.

    :param text: what the recorder wrote
    """

    def __init__(self, text: str) -> None:
        record = json.loads(text)
        self._tests: list[tuple[str, float]] = [tuple(test) for test in record['tests']]
        self._lines: dict[str, dict[str, list[int]]] = record['lines']
        self._durations_s: dict[str, float] = {}
        for name, duration_s in self._tests:
            of = name.partition('::')[0]
            self._durations_s[of] = self._durations_s.get(of, 0.0) + duration_s

    def files_of(self, file: str, line: int, most_s: float) -> list[tuple[str, float]]:
        """
        Return whole files of tests that run a line and how long they take.

        Whole files, because what runs for a fixture or in a process that several tests share is
        recorded for the first of them only. Files that are named as the module come first, then
        the shortest ones. A line that runs only as its module is imported is left to the tests of
        the module.

        :param most_s: how long they may take together, except for the first file [s]
        """
        of_file = self._lines.get(file, {})
        numbers = of_file.get(str(line)) or sorted(
            {n for tests in of_file.values() for n in tests}) or range(len(self._tests))
        parts = set(Path(file).stem.split('_'))
        found = {self._tests[n][0].partition('::')[0] for n in numbers}
        ranked = sorted(found, key=lambda name: (
            -len(parts & set(Path(name).stem.split('_'))), self._durations_s[name]))
        chosen, sum_s = [], 0.0
        for name in ranked:
            if sum_s + self._durations_s[name] <= most_s or not chosen:
                chosen.append((name, self._durations_s[name]))
                sum_s += self._durations_s[name]
        return chosen


def _sources_digest(scope: Scope) -> str:
    digest = hashlib.sha256()
    for file in files_of(scope.sources):
        digest.update((ROOT / file).read_bytes())
    return digest.hexdigest()


def _import_early() -> None:
    """Import what the tests of every change would import again."""
    for name in _IMPORTED:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    assert not any(name.split('.')[0] == 'manip_sim' for name in sys.modules)


def _recorded(laboratory: Laboratory, name: str, again: bool) -> Record:
    """Return the record of a scope's sources as they are; it is kept from run to run."""
    file, scope = RECORDS / f'{name}.json', SCOPES[name]
    digest_file = file.with_suffix('.sha256')
    if again or not file.exists() or digest_file.read_text() != _sources_digest(scope):
        print('recording which lines each test runs (some minutes)', flush=True)
        file.unlink(missing_ok=True)
        laboratory.record(scope, file)
        if not file.exists():
            sys.exit('the tests could not be recorded: try them with -p mutation.recorder')
        digest_file.write_text(_sources_digest(scope))
    return Record(file.read_text())


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='make mutate', description=__doc__)
    parser.add_argument('--scope', choices=SCOPES, default='physics',
                        help='physics (simulation, models; default) or node (ros, runtime, '
                        'viewer, cli)')
    parser.add_argument('--sample', type=int, help='try so many changes, chosen at random')
    parser.add_argument('--seed', type=int, default=1, help='of the sample, 1 by default')
    parser.add_argument('--begin', type=int, default=1, metavar='N',
                        help='begin with the N-th change, as to go on with a sample')
    parser.add_argument('--only', default='', help='part of the names of files')
    parser.add_argument('--seconds', type=float, default=100.0,
                        help='of tests for each change at most, 100 by default')
    parser.add_argument('--record', action='store_true',
                        help='find out again which lines each test runs, as tests have changed')
    return parser.parse_args()


def main() -> int:
    """Try changes and tell those that survive."""
    options = _arguments()
    mutants = sampled(SCOPES[options.scope], options.sample, options.seed, options.only)
    survivors, undecided, begin_s = 0, 0, time.monotonic()
    with tempfile.TemporaryDirectory(prefix='manip_sim_mutation_') as folder:
        laboratory = Laboratory(Path(folder).resolve())
        _import_early()
        record = _recorded(laboratory, options.scope, options.record)
        for count, mutant in list(enumerate(mutants, 1))[options.begin - 1:]:
            tests = record.files_of(mutant.file, mutant.line, options.seconds)
            names = [name for name, _ in tests]
            outcome = laboratory.outcome(mutant, names, sum(
                duration_s for _, duration_s in tests)) if tests else 'SURVIVED'
            survived = outcome == 'SURVIVED'
            survivors, undecided = survivors + survived, undecided + (outcome == 'undecided')
            print(f'{count}/{len(mutants)} {outcome} {mutant.file}:'
                  f'{mutant.line} {mutant.operator.removeprefix("core/")} #{mutant.occurrence}, '
                  f'{len(tests)} files of tests, {time.monotonic() - begin_s:.0f} s', flush=True)
            if survived:
                print(mutant.difference, flush=True)
    tried = len(mutants) - options.begin + 1 - undecided
    killed = tried - survivors
    print(f'{killed} of {tried} changes were seen by tests ({killed / max(1, tried):.1%})'
          + (f'; {undecided} more took too long without the change too' if undecided else ''))
    return 0


if __name__ == '__main__':
    sys.exit(main())
