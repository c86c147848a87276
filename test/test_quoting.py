# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Text from outside in messages."""

import time

import pytest

from manip_sim.quoting import one_line, pluralize, quoted, quoted_names

FORGED = 'x\n[ERROR] [1.0] [manip_sim]: the physics diverged\x1b[2J\u202e'


@pytest.mark.parametrize('show', [quoted, one_line, lambda text: quoted_names([text])])
def test_line_ends_escape_sequences_and_text_direction_are_shown_as_escapes(show):
    shown = show(FORGED)
    assert shown.isprintable()
    assert '\\n' in shown
    assert '\\x1b' in shown
    assert '\\u202e' in shown


@pytest.mark.parametrize('name', ['robot0_joint1', 'x' * 60, 'Gelenk-ä'])
def test_a_short_name_is_shown_in_full(name):
    assert quoted(name) == f"'{name}'"
    assert one_line(name) == name


def test_a_long_name_is_cut_and_costs_no_more():
    name = 'a' * 10_000_000
    begin = time.process_time()
    for _ in range(1000):
        assert quoted(name) == "'" + 'a' * 60 + "'..."
        assert one_line(name, 10) == 'a' * 10 + '...'
    assert time.process_time() - begin < 0.5


def test_of_many_names_the_first_are_shown():
    assert quoted_names(['a', 'b']) == "'a', 'b'"
    assert quoted_names(['a'] * 1_000_000) == "'a', 'a', 'a', 'a', 'a' and 999995 more"


def test_what_is_counted_is_singular_or_plural():
    assert [pluralize(n, 'number') for n in (0, 1, 2)] == ['0 numbers', '1 number', '2 numbers']
    assert [pluralize(n, 'body') for n in (0, 1, 2)] == ['0 bodies', '1 body', '2 bodies']
