# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""YAML of strangers is plain data, or an error in one line."""

import pytest

from manip_sim.errors import ModelError
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import format_value

hypothesis = pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402

TAGS, LARGE, ANCHORS = 'tags are not read', 'integers have at most 64 bits', 'anchors and aliases'


@pytest.mark.parametrize(('text', 'message'), [
    ('a: !!bool maybe', TAGS), ('a: !!timestamp never', TAGS), ('a: !!int ""', TAGS),
    ('a: !!float ""', TAGS), ('a: !!set [b]', TAGS), ('!!map {a: 1}', TAGS),
    ('a: !!python/name:os.system', TAGS), ('a: ! 3', TAGS),
    ('a: 0x' + 5000 * 'f', LARGE), ('a: ' + ':'.join(5000 * '1'), LARGE),
    ('a: 9223372036854775808', LARGE), ('a: -9223372036854775809', LARGE),
    (f'a: 1{5000 * "0"}', 'integer string conversion'),
    (f'a: {":".join(400 * "1")}.5', 'int too large to convert to float'),
    ('a: "\\UFFFFFFFF"', 'too large to convert to C int'),
    ('a: &b [1]', ANCHORS), ('a: *b', ANCHORS), ('a: 2020-99-99', 'month must be in'),
    (f'a: {3000 * "["}', 'it is nested too deeply')])
def test_what_is_no_plain_data_is_an_error_in_one_line(text, message):
    with pytest.raises(ModelError, match=f'^here is invalid or unsafe YAML: .*{message}') as found:
        parse_yaml(text, 'here')
    assert str(found.value).isprintable()


@pytest.mark.parametrize('number', [2**63 - 1, -2**63, 0, 7])
def test_an_integer_of_64_bits_is_read(number):
    assert parse_yaml(f'a: {number}', 'here') == {'a': number}


_PIECES = st.sampled_from([
    *'!&*{}[]:,-?|>%@`"\'# \n\t', '!!int', '!!bool ', '!!timestamp ', '!!set ', ': ', '- ', '? ',
    '0x', '1:1', '1e5', '2020-01-01', '.nan', '~', '<<', '=', '\\UFFFFFFFF', '"\\x', 'a', '\x85',
    '\0', '---\n', '%TAG ! x\n'])


@pytest.mark.full
@settings(max_examples=1000)
@given(st.lists(_PIECES | st.text(max_size=3), max_size=12).map(''.join))
def test_any_text_is_a_mapping_or_an_error_in_one_line(text):
    try:
        found = parse_yaml(f'a: {text}', 'here')
    except ModelError as error:
        assert str(error).isprintable()
    else:
        assert isinstance(found, dict) and format_value(found).isprintable()
