# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The domain that tests use."""

import os

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
