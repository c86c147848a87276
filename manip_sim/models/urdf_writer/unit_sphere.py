# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Make the mesh that represents ellipsoids: a sphere of radius 1.

``python3 -m manip_sim.models.urdf_writer.unit_sphere`` writes it into the assets.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.urdf_writer.meshes import binary_stl
from manip_sim.resources import share_directory

#: How often each triangle of the icosahedron is divided into four.
_LEVELS = 3


def unit_sphere(levels: int = _LEVELS) -> FloatArray:
    """Return a subdivided icosahedron of radius 1 as triangles, shape (20 * 4**levels, 3, 3)."""
    triangles = _icosahedron()
    for _ in range(levels):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q, axis=1, keepdims=True)
                      for p, q in ((a, b), (b, c), (c, a)))
        triangles = np.concatenate([np.stack(corners, axis=1) for corners in (
            (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return triangles


def _icosahedron() -> FloatArray:
    """Return the icosahedron, by three orthogonal golden rectangles, shape (20, 3, 3)."""
    golden = (1.0 + 5.0**0.5) / 2.0
    rectangle = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    corners = np.array([np.roll(corner, shift) for shift in range(3) for corner in rectangle])
    faces = [three for three in combinations(corners, 3)
             if all(np.isclose(np.linalg.norm(p - q), 2.0) for p, q in combinations(three, 2))]
    outward = [three if np.linalg.det(three) > 0.0 else three[::-1] for three in faces]
    return np.asarray(np.array(outward) / np.hypot(1.0, golden))


def main() -> None:
    """Write the mesh into the assets."""
    file: Path = share_directory() / 'assets' / 'meshes' / 'unit_sphere.stl'
    file.write_bytes(binary_stl(unit_sphere()))


if __name__ == '__main__':
    main()
