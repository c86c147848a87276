# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Points and arrows over the scene: whatever was shown before, the last ones are."""

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, strategies as st  # noqa: E402
from hypothesis.extra import numpy as arrays_of  # noqa: E402

from manip_sim.viewer.page.model_scene import Overlays  # noqa: E402


class Scene:
    """What is in the scene, by name: points and how often they were sent."""

    def __init__(self):
        self.drawn, self.sent = {}, 0

    def add_arrows(self, name, points, color, **sizes):
        assert name not in self.drawn and len(points) and min(sizes.values()) > 0.0
        return Sample(self, name, points)

    def add_point_cloud(self, name, points, color, **looks):
        assert name not in self.drawn and len(points)
        return Sample(self, name, points)


class Sample:
    """An element of the scene."""

    def __init__(self, scene, name, points):
        self._scene, self._name = scene, name
        self.points = points

    @property
    def points(self):
        return self._scene.drawn[self._name]

    @points.setter
    def points(self, points):
        self._scene.drawn[self._name] = np.array(points)
        self._scene.sent += 1

    def remove(self):
        del self._scene.drawn[self._name]


def some(shape):
    """Return arrays of up to two rows that are near each other or far."""
    return st.integers(0, 2).flatmap(lambda rows: arrays_of.arrays(
        float, (rows, *shape), elements=st.sampled_from([0.0, 1e-4, 1.5e-4, 3e-4, 1.0, -2.0])))


KINDS = st.sampled_from(['contact_forces', 'force', 'torque'])


@given(st.lists(st.tuples(some((3,)), st.dictionaries(KINDS, some((2, 3)))), max_size=6))
def test_what_was_shown_last_is_drawn_and_nothing_else(shown):
    scene = Scene()
    overlays = Overlays(scene)
    for points, arrows in shown:
        overlays.show(points, arrows)
        last = {'contacts': points, **arrows}
        assert scene.drawn.keys() == {
            f'/overlays/{what}' for what, drawn in last.items() if len(drawn)}
        for name, drawn in scene.drawn.items():
            wanted = last[name.rpartition('/')[2]]
            assert drawn.shape == wanted.shape
            # A quarter of a millimetre cannot be seen.
            np.testing.assert_allclose(drawn, wanted, atol=2.5e-4, rtol=0.0)
    overlays.clear()
    assert not scene.drawn


def test_what_hardly_changes_is_not_sent_again_and_does_not_creep_away():
    scene = Scene()
    overlays = Overlays(scene)
    points, arrows = np.zeros((2, 3)), np.ones((1, 2, 3))
    for _ in range(20):
        overlays.show(points, {'force': arrows})
        points, arrows = points + 4e-5, arrows + 4e-5
    # 0.8 mm in all, in steps that are more than 0.2 mm.
    assert scene.sent == 2 * (1 + 3)
