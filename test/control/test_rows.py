# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Arguments of laws are read from rows as they were written, and wrong ones are not."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from manip_sim.control.law.compiling import Layout, Row

RECORD = np.dtype([('number', np.int64), ('value', np.float64), ('flag', np.bool_)], align=True)


class Inner(NamedTuple):
    records: Any
    matrix: Any


class Arguments(NamedTuple):
    numbers: Any
    pair: tuple[Inner, Inner]
    count: int
    scale: float


def arguments(count=3, rows=2):
    inner = Inner(np.zeros(count, RECORD), np.arange(4.0 * rows).reshape(rows, 4))
    other = Inner(np.zeros(1, RECORD), np.ones((1, 1)))
    return Arguments(np.arange(count), (inner, other), 7, -2.5)


LAYOUT = Layout(arguments())
read = LAYOUT.reader()


@numba.njit
def law(row):
    """Write what is read into the arrays."""
    given = read(row)
    first, second = given.pair[0], given.pair[1]
    for k in range(len(first.records)):
        first.records[k].number = given.numbers[k] * given.count
        first.records[k].value = given.scale * first.matrix[-1, k]
        first.records[k].flag = k == 1
    second.matrix[0, 0] = first.matrix.size


@pytest.mark.parametrize(('count', 'rows'), [(3, 2), (1, 5), (4, 1)])
def test_arguments_of_any_size_are_read_from_a_row(count, rows):
    given, row = arguments(count, rows), Row(LAYOUT)
    row.write(given)
    law(row.address)
    first, second = given.pair
    assert first.records['number'].tolist() == [7 * k for k in range(count)]
    assert first.records['value'].tolist() == [-2.5 * (4 * rows - 4 + k) for k in range(count)]
    assert first.records['flag'].tolist() == [k == 1 for k in range(count)]
    assert second.matrix.item() == 4 * rows


def test_a_part_that_is_replaced_is_written_anew():
    given, row = arguments(), Row(LAYOUT)
    row.write(given)
    other = given._replace(pair=arguments(2).pair, count=3, numbers=np.array([5, 6]))
    row.write(other)
    law(row.address)
    assert other.pair[0].records['number'].tolist() == [15, 18]
    assert not given.pair[0].records['number'].any()


@pytest.mark.parametrize('wrong', [
    {'numbers': np.arange(3.0)}, {'numbers': np.arange(6).reshape(2, 3)},
    {'numbers': np.arange(6)[::2]}, {'count': 7.0}, {'scale': 2}, {'scale': True},
    {'pair': (arguments().pair[0], Inner(np.zeros(1), np.ones((1, 1))))}])
def test_arguments_of_another_type_are_rejected(wrong):
    row = Row(LAYOUT)
    with pytest.raises(TypeError, match='row of a law'):
        row.write(arguments()._replace(**wrong))
    # Nothing of that stays.
    row.write(given := arguments())
    law(row.address)
    assert given.pair[0].records['number'].tolist() == [0, 7, 14]


def test_an_array_that_must_not_be_written_is_rejected():
    numbers = np.arange(3)
    numbers.flags.writeable = False
    with pytest.raises(TypeError, match='cannot be written'):
        Row(LAYOUT).write(arguments()._replace(numbers=numbers))
