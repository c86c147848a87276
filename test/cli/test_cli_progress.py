# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The line that shows on a terminal how far long work has come."""

import io

import pytest

from manip_sim.cli import output
from manip_sim.cli.output import ProgressBar


class Screen(io.StringIO):
    """A terminal, or a file."""

    def __init__(self, terminal):
        super().__init__()
        self.isatty = lambda: terminal


@pytest.mark.parametrize('terminal', [True, False])
def test_a_terminal_shows_five_numbers_a_second_and_nothing_at_the_end(terminal, monkeypatch):
    screen, now_s = Screen(terminal), [100.0]
    monkeypatch.setattr('sys.stderr', screen)
    monkeypatch.setattr(output.time, 'monotonic', lambda: now_s[0])
    with ProgressBar('episodes') as shown:
        for done in range(21):
            shown.show(done, ', well')
            now_s[0] += 0.05
    monkeypatch.undo()
    lines = [line for line in screen.getvalue().split('\r\x1b[K') if line]
    if not terminal:
        assert screen.getvalue() == ''
        return
    numbers = [int(line.removesuffix(' episodes, well')) for line in lines]
    assert numbers[0] == 0
    assert 4 <= len(numbers) <= 6
    assert all(after - before >= 4 for before, after in zip(numbers, numbers[1:]))
    assert screen.getvalue().endswith('\r\x1b[K')
