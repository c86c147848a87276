# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Types of options, each a ``type`` of argparse."""

from __future__ import annotations

import argparse
import math

#: The least and the greatest edge of a picture [pixels].
SMALLEST, LARGEST = 16, 8192


def number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f'must be a finite number, got {text[:60]!r}')
    return value


def numbers(text: str) -> list[float]:
    return [number(part) for part in text.split(',')]


def positive(text: str) -> float:
    value = number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f'must be above 0, got {text[:60]!r}')
    return value


def whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f'must be a whole number, got {text[:60]!r}')
    return int(text[:9])


def count(text: str) -> int:
    value = whole(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'must be at least 1, got {text[:60]!r}')
    return value


def image_size(text: str) -> tuple[int, int]:
    """Return width and height of a picture [pixels] from text such as ``800x540``."""
    width, _, height = text.lower().partition('x')
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f'must be like 800x540, got {text[:60]!r}')
    size = int(width[:9]), int(height[:9])
    if not all(SMALLEST <= edge <= LARGEST for edge in size):
        raise argparse.ArgumentTypeError(
            f'must be from {SMALLEST} to {LARGEST} pixels each way, got {text[:60]!r}')
    return size


def assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition('=')
    if not (name and equals):
        raise argparse.ArgumentTypeError(f'must be like NAME=VALUE, got {text[:60]!r}')
    return name, value
