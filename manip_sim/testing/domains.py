# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""ROS domains that no other process uses: a node and its clients find nobody else there."""

from __future__ import annotations

import os
import socket

#: Domains whose ports lie below those that Linux gives to sockets without one (32768).
_DOMAINS = 100
#: Port of a domain that no participant binds: DDSI-RTPS uses offsets 0, 1 and from 10 on.
_RESERVATION = 5
_PARTICIPANTS = 120


def reserve_domain() -> tuple[int, int]:
    """
    Find a domain that nobody lives in, and keep it from other tests that call this.

    A reservation is a port on loopback. So it holds between users, checkouts and containers that
    share the loopback interface, as DDS does, and ends with the process.

    :returns: its number, and a file descriptor that reserves it until it is closed
    """
    for n in range(_DOMAINS):
        domain = 1 + (os.getpid() + n) % _DOMAINS
        lock = _bound('127.0.0.1', _first_port(domain) + _RESERVATION)
        if lock is None:
            continue
        if not lives(domain):
            return domain, lock.detach()
        lock.close()
    raise RuntimeError('no free ROS domain')


def lives(domain: int) -> bool:
    """Return whether a participant of a domain has bound a port (DDSI-RTPS 2.2, 9.6.1.1)."""
    for participant in range(_PARTICIPANTS):
        probe = _bound('', _first_port(domain) + 10 + 2 * participant)
        if probe is None:
            return True
        probe.close()
    return False


def _first_port(domain: int) -> int:
    return 7400 + 250 * domain


def _bound(address: str, port: int) -> socket.socket | None:
    """Bind a port, unless somebody else has."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.bind((address, port))
    except OSError:
        bound.close()
        return None
    return bound
