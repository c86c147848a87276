# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Run the tests that are the most likely to see what has changed, for half a minute.

Run it by ``make test-fast``. A test file is near to a changed module if it imports it, by few
steps, is named as it is, or names the functions that have changed. The nearest files run first,
with one case of each test before further cases, until the time is over; the rest is skipped. Files
that are not modules are near to the tests that name them. ``make test`` decides.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter, deque
from collections.abc import Iterable, Iterator
import fnmatch
from functools import cache
import os
from pathlib import Path
import re
import subprocess
import sys
import time

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'manip_sim'
#: How many files are collected at most; collecting all takes several seconds.
_MOST_FILES = 60
#: Further cases of the tests of a file begin until they have taken so long [s].
_FURTHER_CASES_S = 3.0
#: When the time is over, as of :func:`time.time`; for the workers of pytest.
_END = 'TEST_FAST_END'
#: Steps to a module that a test does not come to by imports.
_NOT_IMPORTED = 4
#: Imports: a module and names in parentheses or on a line, or modules.
_IMPORT = re.compile(r'(?m)^ *(?:from ([\w.]+) import (?:\(([^)]*)\)|(.+))|import (.+))')
_NAME = re.compile(rf'\b{PACKAGE}(?:\.\w+)*')


def git(*words: str) -> list[str]:
    """Return the lines that git prints, none if it fails."""
    done = subprocess.run(['git', *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.splitlines() if done.returncode == 0 else []


def changed_lines(since: str) -> dict[str, list[int]]:
    """Return the lines that differ from a revision, by file; new files have none."""
    changed: dict[str, list[int]] = {name: [] for name in git(
        'ls-files', '--others', '--exclude-standard')}
    lines: list[int] = []
    for line in git('diff', '--unified=0', '--no-color', '--no-ext-diff', since):
        if line.startswith(('--- a/', '+++ b/')):
            lines = changed.setdefault(line[6:], [])
        elif hunk := re.match(r'@@ .* \+(\d+)(?:,(\d+))? @@', line):
            begin, count = int(hunk[1]), int(hunk[2] or 1)
            lines += range(begin, begin + max(count, 1))
    return changed


@cache
def text_of(file: Path) -> str:
    """Return the text of a file without lines of comments, none if it cannot be read."""
    try:
        return re.sub(r'(?m)^ *#.*', '', file.read_text())
    except (OSError, UnicodeDecodeError):
        return ''


@cache
def file_of(name: str) -> Path | None:
    """Return the file of a module of the package by its dotted name."""
    path = ROOT.joinpath(*name.split('.'))
    if name.split('.')[0] != PACKAGE:
        return None
    return next((file for file in (path.with_suffix('.py'), path / '__main__.py',
                                   path / '__init__.py') if file.is_file()), None)


@cache
def imports_of(file: Path) -> tuple[tuple[str, str | None], ...]:
    """Return the modules that a file imports, each with a name from it, or with None."""
    found: list[tuple[str, str | None]] = []
    for module, several, one, modules in _IMPORT.findall(text_of(file)):
        listed = re.sub('#.*', '', several or one or modules).split(',')
        names = [words.split()[0] for words in listed if words.strip()]
        found += [(module, name) if module else (name, None) for name in names]
    return tuple(found)


@cache
def defining(module: str, name: str) -> Path | None:
    """Return the file of what a module, or the package that passes it on, has by a name."""
    of_submodule = file_of(f'{module}.{name}')
    if of_submodule is not None:
        return of_submodule
    init = ROOT.joinpath(*module.split('.'), '__init__.py')
    for source, passed_on in imports_of(init):
        if passed_on == name and source != module:
            return defining(source, name)
    return init if init.is_file() else file_of(module)


@cache
def used_by(file: Path) -> frozenset[Path]:
    """Return the files of what a file imports, names in other text, and of its conftest."""
    found = {(file_of(module) if name is None else defining(module, name))
             if module.startswith(PACKAGE) else beside(file.parent, module)
             for module, name in imports_of(file)}
    # Programs in processes of their own.
    found.update(map(file_of, _NAME.findall(_IMPORT.sub('', text_of(file)))))
    if 'test' in file.relative_to(ROOT).parts[:1]:
        found.update(folder / 'conftest.py' for folder in file.parents
                     if folder.is_relative_to(ROOT / 'test'))
    return frozenset(path for path in found if path is not None and path.is_file()) - {file}


@cache
def beside(folder: Path, name: str) -> Path | None:
    """Return a module of the tests that is not in the package."""
    places = [at / f'{name}.py' for at in (folder, *folder.parents) if at.is_relative_to(ROOT)]
    return next((place for place in places if place.is_file()), None)


def steps_to(target: Path, tests: Iterable[Path]) -> dict[Path, int]:
    """Return by how many steps of imports tests come to a file; those that never do are absent."""
    users: dict[Path, set[Path]] = {}
    # What a package passes on is used where it is defined; whoever names the package uses both.
    package = '.'.join(target.parent.relative_to(ROOT).parts) if target.stem == '__init__' else ''
    files, waiting = set(tests), deque(tests)
    while waiting:
        file = waiting.popleft()
        if any(module == package for module, _ in imports_of(file)):
            users.setdefault(target, set()).add(file)
        for used in used_by(file):
            users.setdefault(used, set()).add(file)
            if used not in files:
                files.add(used)
                waiting.append(used)
    steps, waiting = {target: 0}, deque([target])
    while waiting:
        file = waiting.popleft()
        for user in users.get(file, ()):
            if user not in steps:
                steps[user] = steps[file] + 1
                waiting.append(user)
    return steps


def names_at(file: Path, lines: Iterable[int]) -> set[str]:
    """Return the public functions and classes that lines of a module are in."""
    wanted = set(lines)
    try:
        tree = ast.parse(text_of(file))
    except SyntaxError:
        return set()
    return {node.name for node in ast.walk(tree)
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
            and not node.name.startswith('_')
            and wanted.intersection(range(node.lineno, (node.end_lineno or node.lineno) + 1))}


def distances(name: str, lines: Iterable[int], tests: list[Path]) -> dict[Path, float]:
    """
    Return how far tests are from a changed file: less is nearer.

    :param name: of the file, relative to the root
    :param lines: those that have changed
    """
    file, parts = ROOT / name, Path(name).parts
    if file in tests:
        return {file: -10.0}
    texts = {test: test.read_text() for test in tests}
    if file.suffix != '.py':
        words = [(-4.0, re.escape(file.name))]
        if len(parts) > 1:
            words += [(-2.0, rf"'{parts[0]}'|{parts[0]}/"), (-1.0, rf'\b{re.escape(parts[-2])}\b')]
        nearness = {test: sum(weight for weight, word in words if re.search(word, text))
                    for test, text in texts.items()}
        return {test: distance for test, distance in nearness.items() if distance}
    steps, names = steps_to(file, tests), names_at(file, lines)
    found = {}
    for test in tests:
        room, alike = test.relative_to(ROOT / 'test').parts[0], _is_named_as(test, file)
        # What is found by its name at run time, such as a command, is imported by nobody.
        if test in steps or alike or (not steps.keys() & set(tests) and room in parts):
            named = sum(bool(re.search(rf'\b{re.escape(word)}\b', texts[test])) for word in names)
            found[test] = (steps.get(test, _NOT_IMPORTED) - 3.0 * alike - (room in parts)
                           - min(named, 3))
    return found


def _is_named_as(test: Path, module: Path) -> bool:
    stem = module.parent.name if module.stem.startswith('__') else module.stem
    return any(fnmatch.fnmatch(test.stem, f'test_*{form}*') for form in {stem, stem.rstrip('s')})


def nearest(changed: dict[str, list[int]], tests: list[Path]) -> Iterator[Path]:
    """Yield tests, the nearest first; each changed file has its turn."""
    ranked = [sorted(found, key=lambda test, found=found: (  # type: ignore[misc]
        found[test], test.stat().st_size)) for found in (
            distances(name, lines, tests) for name, lines in changed.items())]
    seen: set[Path] = set()
    for place in range(max(map(len, ranked), default=0)):
        for files in ranked:
            if place < len(files) and files[place] not in seen:
                seen.add(files[place])
                yield files[place]


# ------------------------------------------------------------------ as a plugin of pytest

class TimeLimit:
    """
    Let each file begin with one case of each of its tests, and skip what comes too late.

    :param end_s: when no test begins any more, as of :func:`time.time` [s]
    """

    def __init__(self, end_s: float) -> None:
        self._end_s = end_s
        self._further: Counter[Path] = Counter()
        self._first: set[str] = set()

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]
                                      ) -> None:
        rank = {Path(argument).resolve(): place for place, argument in enumerate(config.args)}
        cases: Counter[tuple[Path, str]] = Counter()
        place = {}
        for item in items:
            function = item.path, item.nodeid.partition('[')[0]
            if not cases[function]:
                self._first.add(item.nodeid)
            place[item] = rank.get(item.path, len(rank)), cases[function] > 0
            cases[function] += 1
        items.sort(key=place.__getitem__)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        begin = time.monotonic()
        result = yield
        if item.nodeid not in self._first:
            self._further[item.path] += time.monotonic() - begin  # type: ignore[assignment]
        return result

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if time.time() > self._end_s:
            pytest.skip('the time of make test-fast is over')
        if item.nodeid not in self._first and self._further[item.path] > _FURTHER_CASES_S:
            pytest.skip('make test-fast has run other cases of this test')

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        reporter = session.config.pluginmanager.get_plugin('terminalreporter')
        if reporter is not None and not {'passed', 'failed', 'error'} & reporter.stats.keys():
            session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED


def pytest_configure(config: pytest.Config) -> None:
    """Register the plugin, in the workers too."""
    config.pluginmanager.register(TimeLimit(float(os.environ[_END])), 'time-limit')


def main() -> int:
    """
    Choose tests and run them.

    :returns: the exit code of pytest; 0 if nothing has changed, 5 if no test has run
    """
    parser = argparse.ArgumentParser(prog='make test-fast', description=__doc__)
    parser.add_argument('--since', metavar='REVISION', help='what changes are against; by default '
                        'where this branch left main, or the last commit if nothing differs')
    parser.add_argument('--seconds', type=float, default=30.0,
                        help='after which no test begins, 30 by default')
    parser.add_argument('--list', action='store_true', help='only print the files')
    options = parser.parse_args()
    end_s = time.time() + options.seconds
    since = options.since or next(iter(git('merge-base', 'HEAD', 'main')), 'HEAD')
    changed = changed_lines(since) or ({} if options.since else changed_lines('HEAD~1'))
    tests = sorted((ROOT / 'test').rglob('test_*.py'))
    chosen = [str(path.relative_to(ROOT)) for path in nearest(changed, tests)][:_MOST_FILES]
    print(f'{len(changed)} changed files, {len(chosen)} of {len(tests)} test files:',
          *chosen[:5], '...' * (len(chosen) > 5), flush=True)
    if options.list or not chosen:
        print(*chosen, sep='\n')
        return 0
    os.chdir(ROOT)
    code = subprocess.run([
        sys.executable, '-m', 'pytest', '-q', '-r', 'fE', '-p', 'fast', '--numprocesses', '2',
        '--dist', 'loadfile', '--no-loadscope-reorder', *chosen], check=False,
        env={**os.environ, _END: str(end_s), 'PYTHONPATH': os.pathsep.join(
            [str(ROOT / 'test'), os.environ.get('PYTHONPATH', '')])}).returncode
    if code == pytest.ExitCode.NO_TESTS_COLLECTED:
        print("no test has run: give them more time, such as FAST_ARGS='--seconds 60'")
    return code


if __name__ == '__main__':
    sys.exit(main())
