# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The domain that tests use."""

import os
import subprocess
import sys

from manip_sim.testing.domains import lives, reserve_domain
from harness import DOMAIN


def test_a_domain_with_a_node_in_it_is_not_taken(client):
    assert lives(DOMAIN)


def test_two_runs_reserve_different_domains():
    first, first_lock = reserve_domain()
    second, second_lock = reserve_domain()
    assert len({first, second, DOMAIN}) == 3
    assert not lives(first)
    os.close(first_lock)
    again, again_lock = reserve_domain()
    assert again == first
    os.close(again_lock)
    os.close(second_lock)


def test_a_process_of_another_user_finds_a_reserved_domain_taken(tmp_path):
    domain, lock = reserve_domain()
    # Another temporary folder stands for another container: only the loopback is shared.
    other = subprocess.run([sys.executable, '-c', (
        'import os; os.getpid = lambda: int(os.environ["AS_PID"])\n'
        'from manip_sim.testing.domains import reserve_domain\n'
        'print(reserve_domain()[0])')], capture_output=True, text=True, check=True,
        env={**os.environ, 'TMPDIR': str(tmp_path), 'AS_PID': str(domain - 1)})
    assert int(other.stdout) != domain
    os.close(lock)
