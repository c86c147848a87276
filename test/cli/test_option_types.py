# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What options of the command line take, up to their limits."""

import argparse

import pytest

from manip_sim.cli import command_line


@pytest.mark.parametrize(('kind', 'text', 'value'), [
    ('positive', '0.001', 0.001), ('positive', '1', 1.0), ('positive', '5e-324', 5e-324),
    ('whole', '0', 0), ('whole', '12', 12), ('count', '1', 1), ('number', '-0.5', -0.5),
    ('numbers', '0,0.1', [0.0, 0.1]), ('assignment', 'a=b=c', ('a', 'b=c')),
    ('assignment', 'a=', ('a', '')), ('image_size', '16x8192', (16, 8192)),
    ('image_size', '8192X16', (8192, 16))])
def test_a_value_that_fits_is_taken(kind, text, value):
    assert getattr(command_line, kind)(text) == value


@pytest.mark.parametrize(('kind', 'text', 'message'), [
    ('positive', '0', 'must be above 0'), ('positive', '-1', 'must be above 0'),
    ('positive', 'nan', 'must be a finite number'), ('number', '1e999', 'must be a finite number'),
    ('whole', '-1', 'must be a whole number'), ('whole', '\u0663', 'must be a whole number'),
    ('count', '0', 'must be at least 1'), ('assignment', '=b', 'must be like NAME=VALUE'),
    ('assignment', 'ab', 'must be like NAME=VALUE'), ('image_size', '800', 'must be like'),
    ('image_size', 'x800', 'must be like'), ('image_size', '15x100', 'must be from 16 to 8192'),
    ('image_size', '100x8193', 'must be from 16 to 8192'),
    ('image_size', '100x10000000000', 'must be from 16 to 8192')])
def test_a_value_that_does_not_fit_is_rejected(kind, text, message):
    with pytest.raises(argparse.ArgumentTypeError, match=f'^{message}.*{text[:1]}'):
        getattr(command_line, kind)(text)


@pytest.mark.parametrize(('kind', 'text'), [
    ('number', 'x'), ('positive', '-1'), ('whole', 'x'), ('count', '0'), ('image_size', 'x'),
    ('image_size', '9x'), ('assignment', 'x')])
def test_of_a_long_text_the_first_sixty_characters_are_quoted(kind, text):
    text = text[:-1] + text[-1] * (61 - len(text[:-1]))
    with pytest.raises(argparse.ArgumentTypeError) as error:
        getattr(command_line, kind)(text)
    assert str(error.value).endswith(f", got '{text[:60]}'")
