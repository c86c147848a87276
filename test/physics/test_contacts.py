# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Forces of contacts against the weight of what lies on something, whichever comes first."""

import mujoco
import numpy as np
import pytest

from manip_sim.physics.entities import read_contacts

FLOOR = '<geom name="floor" type="plane" size="1 1 0.1"/>'
BALL = ('<body name="{}" pos="0 0 {}"><freejoint/>'
        '<geom type="box" size="0.1 0.1 0.1" mass="{}"/></body>')


def settled(worldbody, seconds=1.0):
    model = mujoco.MjModel.from_xml_string(f'<mujoco><worldbody>{worldbody}</worldbody></mujoco>')
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    return model, data, read_contacts(model, data)


@pytest.mark.parametrize('table', [
    FLOOR, f'<body name="table">{FLOOR}</body>',
    '<body name="table"><geom type="box" size="1 1 0.1" pos="0 0 -0.1"/></body>'])
@pytest.mark.parametrize('table_first', [True, False])
def test_the_forces_on_a_box_carry_its_weight(table, table_first):
    box = BALL.format('box', 0.1, 2.0)
    model, _, contacts = settled(table + box if table_first else box + table)
    assert (contacts.body == model.body('box').id).all() and len(contacts.body) == 4
    np.testing.assert_allclose(contacts.force.sum(axis=0), [0.0, 0.0, 2.0 * 9.81], atol=1e-3)
    np.testing.assert_allclose(contacts.position[:, 2], 0.0, atol=2e-3)
    np.testing.assert_allclose(np.abs(contacts.position[:, :2]), 0.1, atol=1e-3)


def test_of_two_boxes_that_move_the_force_on_the_later_one_is_told():
    model, _, contacts = settled(FLOOR + BALL.format('lower', 0.1, 2.0)
                                 + BALL.format('upper', 0.3, 1.0))
    upper = contacts.body == model.body('upper').id
    np.testing.assert_allclose(contacts.force[upper].sum(axis=0), [0.0, 0.0, 9.81], atol=1e-3)
    np.testing.assert_allclose(contacts.force[~upper].sum(axis=0), [0.0, 0.0, 29.43], atol=1e-3)


def test_the_axes_of_a_force_are_those_of_world():
    # On a slope the normal is not vertical, and friction holds the box.
    slope = '<geom type="plane" size="5 5 0.1" euler="0 15 0"/>'
    box = ('<body name="box" pos="0 0 0.11" euler="0 15 0"><freejoint/>'
           '<geom type="box" size="0.1 0.1 0.1" mass="2"/></body>')
    _, _, contacts = settled(slope + box, seconds=0.5)
    np.testing.assert_allclose(contacts.force.sum(axis=0), [0.0, 0.0, 2.0 * 9.81], atol=0.05)


def test_nothing_that_touches_gives_no_contacts():
    contacts = settled(BALL.format('box', 0.5, 1.0), seconds=0.01)[2]
    assert contacts.position.shape == contacts.force.shape == (0, 3)
