# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A pytest plugin that records which lines each test runs, and how long each test takes.

Lines count that run in processes which a test starts, unless they are killed.
"""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
import tempfile
from typing import Any

import coverage
import pytest

#: Where the record is written; the folders whose lines are recorded, separated by commas.
RECORD, SOURCES = 'MUTATION_RECORD', 'MUTATION_SOURCES'
#: What ``child/sitecustomize.py`` reads: where it writes to, and whose lines it records.
CHILDREN, CONTEXT = 'MUTATION_CHILDREN', 'MUTATION_CONTEXT'

_durations: dict[str, float] = {}
_failed: set[str] = set()
#: By a fixture that several tests share, those tests.
_sharing: dict[str, set[str]] = {}
_folder = tempfile.TemporaryDirectory(prefix='manip_sim_lines_')
#: Without the settings of ``make coverage``.
_tracer = coverage.Coverage(data_file=None, config_file=False,
                            include=os.environ[SOURCES].split(','))


def pytest_configure() -> None:
    """Begin before the modules are imported: lines of that time belong to no test."""
    child = str(Path(__file__).with_name('child'))
    os.environ.update({
        CHILDREN: f'{_folder.name}/lines', CONTEXT: '',
        'PYTHONPATH': os.pathsep.join([child, os.environ.get('PYTHONPATH', '')])})
    _tracer.start()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Let lines belong to a test while it runs."""
    _tracer.switch_context(item.nodeid)
    for name in getattr(item, 'fixturenames', ()):
        _sharing.setdefault(name, set()).add(item.nodeid)
    os.environ[CONTEXT] = item.nodeid
    try:
        return (yield)
    finally:
        os.environ[CONTEXT] = ''
        _tracer.switch_context('')


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[Any]:
    """Let processes of a fixture that several tests share belong to all of them."""
    before = os.environ[CONTEXT]
    if fixturedef.scope != 'function':
        os.environ[CONTEXT] = f'{fixturedef.baseid} {fixturedef.argname}'
    try:
        return (yield)
    finally:
        os.environ[CONTEXT] = before


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add the time of setup, call and teardown up; a test that does not pass is of no use."""
    _durations[report.nodeid] = _durations.get(report.nodeid, 0.0) + report.duration
    if report.outcome != 'passed':
        _failed.add(report.nodeid)


def _tests_of(context: str) -> set[str]:
    """Return the tests that a process ran for: one, or those that share a fixture."""
    base, _, fixture = context.rpartition(' ')
    if context in _durations:
        return {context}
    return {name for name in _sharing.get(fixture, ()) if name.startswith(base)}


def pytest_sessionfinish() -> None:
    """Write the tests of each line, and their durations [s]."""
    _tracer.stop()
    lines: dict[str, dict[int, set[str]]] = {}
    recorded = [_tracer.get_data()]
    for file in Path(_folder.name).glob('lines.*'):
        recorded.append(coverage.CoverageData(str(file)))
        recorded[-1].read()
    for data in recorded:
        for file in sorted(data.measured_files()):
            of_file = lines.setdefault(os.path.relpath(file), {})
            for line, contexts in data.contexts_by_lineno(file).items():
                of_file.setdefault(line, set()).update(
                    name for context in contexts for name in _tests_of(context)
                    if name not in _failed)
    # Numbers instead of names keep the file short.
    number = {name: n for n, name in enumerate(_durations)}
    Path(os.environ[RECORD]).write_text(json.dumps({
        'tests': list(_durations.items()),
        'lines': {file: {line: sorted(number[name] for name in names)
                         for line, names in tests.items()}
                  for file, tests in lines.items()}}))
    _folder.cleanup()
