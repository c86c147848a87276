# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""POSIX Extended regular expressions that filter entities, against grep."""

import itertools
import os
import random
import subprocess
import time

import pytest

from manip_sim.ros import standard_services
from manip_sim.ros.spawning_services import Rejection, ResultCode
from manip_sim.ros.standard_services import matching

TEXTS = ['', 'a', 'b', 'ab', 'ba', 'aab', 'abb', 'abab', 'bbb', 'cube', 'robot0_link1', 'a-b',
         'a]b', 'a.b', 'A1', '^a', 'a$', 'a\\b', '0.5', 'a b']
PATTERNS = [
    'a', '^a', 'a$', '^a$', '^$', 'a|b', '^(a|b)$', '(ab)+$', 'a*', '^a+b?$', 'a{2}', '^a{1,2}b$',
    'a{0}b', '^(a|b){3,}$', '[ab]', '[^ab]', '[]a]', '[^]a]', '[a-c]', '[a-]', '[-a]', 'a[-.]b',
    '[[:digit:]]', '[[:alpha:]_]+[0-9]', '[[:upper:]][^[:alpha:]]', '.', '^..$', r'a\.b', r'\^a',
    r'a\$', r'a\\b', '(a|)b', '()', '((a|b)(a|b))+', 'robot0_(link|joint)[1-7]', 'x|cube', 'a|^b$',
    '(^a|b$)', 'a^b', '(a*)*b', '(a|b)*abb', '[[:space:]]',
    '^[[:graph:]]+$', '^[[:print:]]+$', '[+--]', 'a+*']


@pytest.fixture
def with_re2():
    pytest.importorskip('re2', reason='needs the extra filters')


def grep(pattern):
    """Return in which texts grep finds a pattern."""
    found = subprocess.run(
        ['grep', '-n', '-E', '-e', pattern], input='\n'.join(TEXTS), capture_output=True,
        text=True, env={**os.environ, 'LC_ALL': 'C'}, timeout=300.0)
    assert found.returncode < 2, found.stderr
    return [TEXTS[int(line.split(':')[0]) - 1] for line in found.stdout.splitlines()]


@pytest.mark.parametrize('pattern', PATTERNS)
def test_an_expression_finds_what_grep_finds(pattern, with_re2):
    assert matching(pattern, TEXTS) == grep(pattern)


@pytest.mark.full
def test_random_expressions_find_what_grep_finds(with_re2):
    rng = random.Random(3)
    pieces = ['a', 'b', '.', '[ab]', '[^a]', '(a|b)', '(ab|b)', '(a*b|)', '^', '$', '|', '1', '_']
    suffixes = ['', '', '', '*', '+', '?', '{2}', '{0,2}', '{1,}']
    for _ in range(300):
        pattern = ''.join(
            piece + (rng.choice(suffixes) if piece not in '^$|' else '')
            for piece in rng.choices(pieces, k=rng.randint(1, 6)))
        assert matching(pattern, TEXTS) == grep(pattern), pattern


@pytest.mark.parametrize('pattern, reason', [
    ('(', 'missing )'), ('a)', 'unexpected )'), ('[a', 'missing ]'), ('*a', 'no argument'),
    ('a{3,2}', 'repetition size'), ('[b-a]', 'character class range'),
    ('[[:no:]]', 'character class range'), ('(a)\\1', 'escape'), ('a\\', 'trailing'),
    ('\\w', 'escape'), ('a' * 200_000, 'longer than 1000'),
    ('((a{99}){99}){99}', 'repetition size'), ('a{1000}' * 140, 'too large'),
    ('\udc80', 'surrogates')])
def test_what_is_no_expression_or_too_large_is_rejected_with_the_reason(pattern, reason, with_re2):
    with pytest.raises(Rejection, match=r'^filter ') as caught:
        matching(pattern, TEXTS)
    assert caught.value.code == ResultCode.RESULT_OPERATION_FAILED
    assert reason in str(caught.value) and len(str(caught.value)) < 500


@pytest.mark.parametrize('pattern', [
    '(a*)*b', '(a|a)*b', '(a|aa)+$b', '(.*a){40}b', '(a?){100}a{100}', '((a*)*)*b',
    '|'.join(itertools.repeat('a*b', 45)), '(' * 500 + ')' * 500, '[[:alpha:]]{1000}' * 50])
def test_no_expression_takes_long(pattern, with_re2):
    begin = time.process_time()
    for _ in range(20):
        matching(pattern, ['a' * 50])
    assert time.process_time() - begin < 1.0


def test_without_the_package_an_expression_is_refused_with_the_remedy(monkeypatch):
    monkeypatch.setattr(standard_services, 're2', None)
    assert matching('', TEXTS) == TEXTS
    with pytest.raises(Rejection, match=r"'cube': .*pip install 'manip_sim\[filters\]'") as caught:
        matching('cube', TEXTS)
    assert caught.value.code == ResultCode.RESULT_FEATURE_UNSUPPORTED
