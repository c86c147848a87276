# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a model's XML files may ask MuJoCo for: limits, and what is above them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
import sys

#: Number of keyframes, which MuJoCo takes long to remove.
MAX_KEYS = 1000
_MAX_USER = 1000
#: Largest products of the numbers in attributes, by element.
_MAX_PRODUCTS: Mapping[str, tuple[tuple[tuple[str, ...], float], ...]] = {
    'hfield': ((('nrow', 'ncol'), 4000**2),),
    'numeric': ((('size',), 1e6),),
    'size': ((('nkey',), MAX_KEYS), (('nuserdata',), 1e7), *(
        ((f'nuser_{kind}',), _MAX_USER) for kind in (
            'body', 'jnt', 'geom', 'site', 'cam', 'tendon', 'actuator', 'sensor')))}
#: The elements that :func:`excess` and :func:`flex_vertices` look at, and keyframes.
LIMITED = frozenset(
    ['mesh', 'texture', 'flexcomp', 'flex', 'key', *_MAX_PRODUCTS])
#: Larger textures and meshes take many seconds and gigabytes.
_MAX_PIXELS = 120_000_000
_MAX_MESH_PARAMETER = 500


@dataclass(frozen=True)
class Limits:
    """
    What all files of a model together may use.

    :ivar files: that it is loaded from; one that is used twice counts twice
    :ivar depth: to which files may load each other
    :ivar made: bodies, geoms and so on that ``replicate``, ``composite`` and the like make
    :ivar flex: vertices of flexes, for which MuJoCo takes time that grows with their square
    :ivar keys: keyframes, which MuJoCo takes long to remove
    :ivar elements: of a model, copies included
    :ivar nested: depth to which these may be in each other
    """

    bytes: int = 50_000_000
    files: int = 1000
    depth: int = 50
    made: int = 20_000
    flex: int = 5000
    keys: int = MAX_KEYS
    elements: int = sys.maxsize
    nested: int = sys.maxsize


@dataclass
class Budget:
    """
    What all files of a model together may still use; below zero it is spent.

    :ivar limits: what it was at the start
    """

    limits: Limits = Limits()

    def __post_init__(self) -> None:
        self.bytes, self.files = self.limits.bytes, self.limits.files
        self.made, self.keys = self.limits.made, self.limits.keys
        self.flex = self.limits.flex


def excess(tag: str, attributes: Mapping[str, str]) -> str:
    """
    Return which number in an element's attributes is too great.

    :returns: what is more than how much; empty if nothing is
    """
    for names, most in _MAX_PRODUCTS.get(tag, ()):
        if product(attributes, *names) > most:
            return _more(f'{" times ".join(names)} of {tag}', most)
    if tag == 'mesh' and max(_numbers(attributes, 'params'), default=0) > _MAX_MESH_PARAMETER:
        return _more('a parameter of a builtin mesh', _MAX_MESH_PARAMETER)
    if tag == 'texture':
        width, height = (product(attributes, name) for name in ('width', 'height'))
        if width * (height if attributes.get('type') == '2d' else 6 * width) > _MAX_PIXELS:
            return _more('the number of pixels of a texture', _MAX_PIXELS)
    return ''


def flex_vertices(tag: str, attributes: Mapping[str, str]) -> int:
    """Return how many vertices an element makes, but for those in a file."""
    if tag == 'flexcomp':
        return max(product(attributes, 'count'), len(attributes.get('point', '').split()) // 3)
    if tag == 'flex':
        return max(len(attributes.get('vertex', '').split()) // 3,
                   len(attributes.get('body', '').split()))
    return 0


def _more(what: str, most: float) -> str:
    return f'{what} is more than {most:g}'


def product(attributes: Mapping[str, str], *names: str) -> int:
    """
    Return the product of the numbers in attributes.

    :param names: of those to multiply; one that is missing or below 1 counts as 1
    :returns: the product, at most 1e15
    """
    result = math.prod(number if number > 1.0 else 1.0 for name in names
                       for number in _numbers(attributes, name))
    return int(min(result, 1e15))


def _numbers(attributes: Mapping[str, str], name: str) -> list[float]:
    try:
        return [float(word) for word in attributes.get(name, '').split()]
    except ValueError:
        return []  # MuJoCo reports it.
