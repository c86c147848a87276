# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Random messages and requests of any type, most often invalid, and damaged data."""

from __future__ import annotations

import importlib
import random
import re
from typing import Any

NUMBERS = (0.0, 1.0, -1.0, 1e308, -1e308, 5e-324, float('nan'), float('inf'), -float('inf'))
TEXTS = ('', 'robot0_joint1', 'arm', 'position', "x'y'z", 'a\nb', '\x1b[2J', 'j' * 5000,
         '<b>', 'manip_sim', '\u202e', 'use_sim_time')
_SEQUENCE = re.compile(r'sequence<(?P<kind>[^,]+)(, (?P<most>\d+))?>|(?P<of>.+)\[(?P<count>\d+)\]')
_BITS = re.compile(r'(u?)int(\d+)')
_MAX_LENGTH = 4


def load_type(name: str) -> Any:
    """Return the class of a type such as ``std_srvs/srv/SetBool``."""
    package, kind, cls = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), cls)


def random_message(rng: random.Random, cls: Any) -> Any:
    """Return a message, or the request of a service, with random fields."""
    message = cls()
    for field, kind in cls.get_fields_and_field_types().items():
        setattr(message, field, _value(rng, kind))
    return message


def _value(rng: random.Random, kind: str) -> Any:
    several = _SEQUENCE.fullmatch(kind)
    if several:
        inner = several['kind'] or several['of']
        most = min(int(several['most'] or _MAX_LENGTH), _MAX_LENGTH)
        count = int(several['count']) if several['count'] else rng.randint(0, most)
        values = [_value(rng, inner) for _ in range(count)]
        return bytes(values) if inner == 'uint8' and several['kind'] else values
    bits = _BITS.fullmatch(kind)
    if bits:
        low, high = (0, 2 ** int(bits[2]) - 1) if bits[1] else (
            -2 ** (int(bits[2]) - 1), 2 ** (int(bits[2]) - 1) - 1)
        return rng.choice((low, high, 0, 1, rng.randint(low, high)))
    if kind == 'float':
        return rng.choice((0.0, 1.0, float('nan'), float('inf'), 3e38))
    if kind in ('octet', 'byte'):
        return bytes([rng.randrange(256)])
    if kind.startswith('string'):
        return rng.choice(TEXTS)
    if '/' in kind:
        package, _, name = kind.partition('/')
        return random_message(rng, load_type(f'{package}/msg/{name}'))
    return {'double': rng.choice(NUMBERS), 'boolean': rng.random() < 0.5}[kind]


def mutate(rng: random.Random, message: Any) -> None:
    """Replace one field of a message, or of a message in it, by a random value."""
    field, kind = rng.choice(list(message.get_fields_and_field_types().items()))
    value = getattr(message, field)
    inner = rng.choice(value) if kind.startswith('sequence') and len(value) else value
    if hasattr(inner, 'get_fields_and_field_types') and rng.random() < 0.8:
        mutate(rng, inner)
    else:
        setattr(message, field, _value(rng, kind))


def damaged(rng: random.Random, data: bytes) -> bytes:
    """Return serialized data that is cut, or has other bytes in some places."""
    changed = bytearray(data[:rng.randint(4, len(data))] if rng.random() < 0.3 else data)
    for _ in range(rng.randint(0, 6)):
        changed[rng.randrange(min(4, len(changed) - 1), len(changed))] = rng.choice(
            (0, 1, 2, 7, 0x7f, 0x80, 0xff, rng.randrange(256)))
    return bytes(changed)
