# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tables of plain text."""

import pytest

from manip_sim.cli.output import number, span, table, terminal_width

HEADER = ('joint', 'range', 'mass kg', 'meaning')
ROWS = [('robot0_right_elbow_joint', '-2.5 to 2.5', '1.25', 'what turns the forearm about y'),
        ('robot0_b', '-', '12', 'a word')]


def test_columns_are_aligned_and_numbers_stand_to_the_right():
    assert table('Joints', HEADER, ROWS, 200).splitlines() == [
        'Joints',
        '  joint                     range        mass kg  meaning',
        '  robot0_right_elbow_joint  -2.5 to 2.5     1.25  what turns the forearm about y',
        '  robot0_b                  -                 12  a word']


@pytest.mark.parametrize('width', range(46, 82))
def test_no_line_is_wider_than_asked_for_and_nothing_is_lost(width):
    lines = table('Joints', HEADER, ROWS, width).splitlines()
    assert max(map(len, lines)) <= width
    assert lines == [line.rstrip() for line in lines]
    begins = [lines[1].index(name) for name in HEADER]
    for begin, end, *cells in zip(begins, [*begins[1:], None], HEADER, *ROWS, strict=True):
        assert ''.join(line[begin:end] for line in lines[1:]).replace(' ', '') == ''.join(
            cells).replace(' ', '')


def test_numbers_and_spans_are_never_wrapped():
    for width in (1, 20, 40):
        text = table('Joints', HEADER, ROWS, width)
        assert ' -2.5 to 2.5 ' in text and ' 1.25 ' in text


def test_a_word_longer_than_its_column_is_cut_into_pieces():
    text = table('T', ('a', 'b'), [('x', 'm' * 25)], 15)
    assert [line.split()[-1] for line in text.splitlines()[2:]] == ['m' * 10, 'm' * 10, 'm' * 5]


def test_a_table_without_rows_is_nothing():
    assert table('Cameras', HEADER, [], 80) == ''


@pytest.mark.parametrize(('value', 'text'), [
    (None, '-'), (0.0, '0'), (-1e-9, '0'), (1.23456, '1.235'), (-87.0, '-87'), (1500.0, '1500')])
def test_numbers_have_four_digits(value, text):
    assert number(value) == text


def test_spans_tell_the_lowest_and_the_highest_value():
    assert span([-0.0698, 2.0]) == '-0.0698 to 2' and span(None) == '-'


def test_the_width_is_that_of_the_terminal_or_endless(monkeypatch):
    monkeypatch.setenv('COLUMNS', '77')
    assert terminal_width() == 77
    monkeypatch.delenv('COLUMNS')
    monkeypatch.setattr('sys.__stdout__', None)
    assert terminal_width() > 10_000
