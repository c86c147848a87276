# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""ROS domains that no other process uses: a node and its clients find nobody else there."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import socket
import tempfile


def reserve_domain() -> tuple[int, int]:
    """
    Find a domain that nobody lives in, and keep it from other tests that call this.

    :returns: its number, and a file descriptor that reserves it until it is closed
    """
    for n in range(100):
        domain = 1 + (os.getpid() + n) % 100
        lock = _locked(Path(tempfile.gettempdir(), f'manip_sim_test_domain_{domain}'))
        if lock is None:
            continue
        if not lives(domain):
            return domain, lock
        os.close(lock)
    raise RuntimeError('no free ROS domain')


def _locked(path: Path) -> int | None:
    try:
        lock = os.open(path, os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC)
    except OSError:
        # It belongs to somebody else.
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


def lives(domain: int) -> bool:
    """Return whether a participant of a domain has bound a port (DDSI-RTPS 2.2, 9.6.1.1)."""
    for participant in range(20):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', 7410 + 250 * domain + 2 * participant))
            except OSError:
                return True
    return False
