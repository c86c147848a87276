# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Whatever is commanded to the joints of an arena: it is clamped and used, or it is an error."""

import math
from pathlib import Path

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models import compose
from manip_sim.simulation import Simulation

ROOM = Path(__file__).resolve().parents[1] / 'data/files/room.xml'
NAMES = st.lists(st.sampled_from(['slide', 'hinge', 'sldie', '']) | st.text(), max_size=3)
NUMBERS = st.lists(st.floats() | st.floats(-1.0, 1.0), max_size=3)


@pytest.fixture(scope='module')
def room():
    return Simulation(compose('Panda', arena=str(ROOM))).surroundings


@pytest.mark.full
@settings(max_examples=300)
@given(NAMES, NUMBERS, NUMBERS, NUMBERS)
def test_what_is_accepted_is_a_position_of_the_drawer_in_its_range(
        room, names, position, velocity, effort):
    try:
        controls = room.commands['arena'].checked(names, position, velocity, effort)
    except (CommandError, UnknownNameError) as error:
        assert str(error)
        return
    assert set(names) == {'slide'}
    (value,) = position or [math.nan]
    assert controls == ({} if math.isnan(value) else {'slide': min(max(value, 0.0), 0.3)})
    assert not any(math.isfinite(number) for number in [*velocity, *effort])


@pytest.mark.full
@settings(max_examples=300)
@given(NUMBERS, st.lists(st.floats(), min_size=4, max_size=4) | st.just([0.0, 0.0, 0.0, 1.0]))
def test_a_mocap_body_is_moved_to_a_pose_or_not_at_all(room, position, quat_xyzw):
    before = room.pose('marker')
    try:
        room.set_target('marker', position, quat_xyzw)
    except CommandError:
        np.testing.assert_array_equal(room.pose('marker'), before)
        return
    np.testing.assert_array_equal(room.pose('marker')[:3], position)
    assert np.linalg.norm(room.pose('marker')[3:]) == pytest.approx(1.0)
