# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A pytest plugin that records which lines each test runs, and how long each test takes."""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
from typing import Any

import coverage
import pytest

#: Where the record is written; the folders whose lines are recorded, separated by commas.
RECORD, SOURCES = 'MUTATION_RECORD', 'MUTATION_SOURCES'

_durations: dict[str, float] = {}
_failed: set[str] = set()
#: Without the settings of ``make coverage``.
_tracer = coverage.Coverage(data_file=None, config_file=False,
                            include=os.environ[SOURCES].split(','))


def pytest_configure() -> None:
    """Begin before the modules are imported: lines of that time belong to no test."""
    _tracer.start()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Let lines belong to a test while it runs."""
    _tracer.switch_context(item.nodeid)
    try:
        return (yield)
    finally:
        _tracer.switch_context('')


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add the time of setup, call and teardown up; a test that does not pass is of no use."""
    _durations[report.nodeid] = _durations.get(report.nodeid, 0.0) + report.duration
    if report.outcome != 'passed':
        _failed.add(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write the tests of each line, and their durations [s]."""
    _tracer.stop()
    data, lines = _tracer.get_data(), {}
    for file in sorted(data.measured_files()):
        of_file: dict[int, Any] = {
            line: [name for name in names if name and name not in _failed]
            for line, names in data.contexts_by_lineno(file).items()}
        lines[os.path.relpath(file)] = of_file
    # Numbers instead of names keep the file short.
    number = {name: n for n, name in enumerate(_durations)}
    Path(os.environ[RECORD]).write_text(json.dumps({
        'tests': list(_durations.items()),
        'lines': {file: {line: [number[name] for name in names] for line, names in tests.items()}
                  for file, tests in lines.items()}}))
