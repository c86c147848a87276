# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Replace inertias of a URDF that no body can have by the nearest ones that a body can have."""

from __future__ import annotations

from itertools import combinations_with_replacement
from xml.etree import ElementTree

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.quoting import quoted_names

#: Of a moving link whose file gives none, and the least moment of inertia [kg, kg m^2].
_LEAST_KG, _LEAST_INERTIA = 1e-4, 1e-8
#: Moments up to this one, or up to this share of the greatest, may be zero to MuJoCo [kg m^2].
_ZERO, _ZERO_SHARE = 1e-14, 1e-7
_PAIRS = [''.join(pair) for pair in combinations_with_replacement('xyz', 2)]


def make_physical(robot: ElementTree.Element) -> list[str]:
    """
    Make the masses of moving links positive and the moments of inertia of all links possible.

    An inertia matrix keeps its axes; a moment below the least becomes that. MuJoCo itself corrects
    moments of which one is greater than the sum of the others.

    :param robot: root of the URDF, changed in place; numbers that are none are left to MuJoCo
    :returns: a sentence for each kind of change
    """
    moved = {child.get('link') for joint in robot.iter('joint') if joint.get('type') != 'fixed'
             for child in joint.findall('child')}
    weightless, projected = [], []
    for link in robot.iter('link'):
        mass, inertia = link.find('inertial/mass'), link.find('inertial/inertia')
        if mass is None or inertia is None:
            continue
        try:
            moments, axes = np.linalg.eigh(_matrix(inertia))
            kilograms = float(mass.get('value', 0.0))
        except (ValueError, np.linalg.LinAlgError):
            continue
        name = str(link.get('name'))
        needs_mass = kilograms <= 0.0 and link.get('name') in moved
        if needs_mass:
            mass.set('value', repr(_LEAST_KG))
            weightless.append(name)
        zero = max(_ZERO, _ZERO_SHARE * moments.max())
        if moments.min() < 0.0 or (moments.min() <= zero and (kilograms > 0.0 or needs_mass)):
            _write(inertia, axes * np.maximum(moments, _LEAST_INERTIA) @ axes.T)
            projected.append(name)
    notes = []
    if weightless:
        notes.append(f'{_LEAST_KG * 1e3:g} g for moving links of mass 0: '
                     f'{quoted_names(weightless)}')
    if projected:
        notes.append('moments of inertia that are not positive became '
                     f'{_LEAST_INERTIA:g} kg m^2: {quoted_names(projected)}')
    return notes


def _matrix(inertia: ElementTree.Element) -> FloatArray:
    matrix = np.zeros((3, 3))
    for pair in _PAIRS:
        row, column = ('xyz'.index(letter) for letter in pair)
        matrix[row, column] = matrix[column, row] = float(inertia.get(f'i{pair}', 0.0))
    if not np.isfinite(matrix).all():
        raise ValueError('not finite')
    return matrix


def _write(inertia: ElementTree.Element, matrix: FloatArray) -> None:
    for pair in _PAIRS:
        row, column = ('xyz'.index(letter) for letter in pair)
        inertia.set(f'i{pair}', repr(float(matrix[row, column])))
