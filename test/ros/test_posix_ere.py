# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""POSIX Extended regular expressions, against grep."""

import itertools
import os
import random
import subprocess
import time

import pytest

from manip_sim.ros.posix_ere import PosixExpression

TEXTS = ['', 'a', 'b', 'ab', 'ba', 'aab', 'abb', 'abab', 'bbb', 'cube', 'robot0_link1', 'a-b',
         'a]b', 'a.b', 'A1', '^a', 'a$', 'a\\b', '0.5', 'a b']
PATTERNS = [
    'a', '^a', 'a$', '^a$', '^$', 'a|b', '^(a|b)$', '(ab)+$', 'a*', '^a+b?$', 'a{2}', '^a{1,2}b$',
    'a{0}b', '^(a|b){3,}$', '[ab]', '[^ab]', '[]a]', '[^]a]', '[a-c]', '[a-]', '[-a]', 'a[-.]b',
    '[[:digit:]]', '[[:alpha:]_]+[0-9]', '[[:upper:]][^[:alpha:]]', '.', '^..$', r'a\.b', r'\^a',
    r'a\$', r'a\\b', '(a|)b', '()', '((a|b)(a|b))+', 'robot0_(link|joint)[1-7]', 'x|cube', 'a|^b$',
    '(^a|b$)', 'a^b', '(a*)*b', '(a|b)*abb', '[[:space:]]',
    '^[[:graph:]]+$', '^[[:print:]]+$', '[+--]', 'a+*']


def grep(pattern):
    """Return in which texts grep finds a pattern, or None if it is none."""
    found = subprocess.run(
        ['grep', '-n', '-E', '-e', pattern], input='\n'.join(TEXTS), capture_output=True,
        text=True, env={**os.environ, 'LC_ALL': 'C'}, timeout=300.0)
    if found.returncode > 1:
        return None
    return [TEXTS[int(line.split(':')[0]) - 1] for line in found.stdout.splitlines()]


def ours(pattern):
    expression = PosixExpression(pattern)
    return [text for text in TEXTS if expression.found_in(text)]


@pytest.mark.parametrize('pattern', PATTERNS)
def test_an_expression_finds_what_grep_finds(pattern):
    assert ours(pattern) == grep(pattern)


@pytest.mark.full
def test_random_expressions_find_what_grep_finds():
    rng = random.Random(3)
    pieces = ['a', 'b', '.', '[ab]', '[^a]', '(a|b)', '(ab|b)', '(a*b|)', '^', '$', '|', '1', '_']
    suffixes = ['', '', '', '*', '+', '?', '{2}', '{0,2}', '{1,}']
    for _ in range(300):
        pattern = ''.join(
            piece + (rng.choice(suffixes) if piece not in '^$|' else '')
            for piece in rng.choices(pieces, k=rng.randint(1, 6)))
        assert ours(pattern) == grep(pattern), pattern


@pytest.mark.parametrize('pattern, reason', [
    ('(', "unmatched '\\('"), ('a)', "unmatched '\\)'"), ('[a', "unmatched '\\['"),
    ('*a', 'nothing to repeat'), ('^*', 'nothing to repeat'), ('a{2', 'bad bounds'),
    ('a{3,2}', 'bad bounds'), ('a{x}', 'bad bounds'), ('[b-a]', 'bad range'),
    ('[[:no:]]', 'unknown class'), ('[[=a=]]', 'not supported'), ('(a)\\1', 'backslash'),
    ('a\\', 'backslash'), ('\\w', 'backslash'), ('a' * 201, 'longer than 200'),
    ('(' * 30 + ')' * 30, 'nested more than 20 deep'),
    ('((a{99}){99}){99}', 'more than 500 parts'), ('(a{99}){5}aaaaa', 'more than 500 parts'),
    ('a{256}{1000}', "bad bounds after '{'"), ('a{999}', 'more than 500 parts')])
def test_what_is_no_expression_or_too_long_is_rejected(pattern, reason):
    with pytest.raises(ValueError, match=reason):
        PosixExpression(pattern)


def test_an_expression_of_as_many_parts_as_may_be_is_used():
    expression = PosixExpression('(a{99}){5}aaaa')
    assert expression.found_in('a' * 499) and not expression.found_in('a' * 498)


@pytest.mark.parametrize('pattern', [
    '(a*)*b', '(a|a)*b', '(a|aa)+$b', '(.*a){40}b', '(a?){100}a{100}', '((a*)*)*b',
    '|'.join(itertools.repeat('a*b', 45))])
def test_no_expression_takes_long(pattern):
    expression = PosixExpression(pattern)
    begin = time.process_time()
    for _ in range(20):
        expression.found_in('a' * 50)
    assert time.process_time() - begin < 1.0
