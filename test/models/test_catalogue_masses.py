# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Masses and inertias of the catalogue are possible, and robots weigh what datasheets say."""

import numpy as np
import pytest

from catalogue import BASES, equipped, figures, GRIPPERS, ROBOTS

from manip_sim.models.bases import create_base
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import create_robot

DATASHEETS = figures('datasheets.json')
WEIGHED = [('robots', create_robot, name) for name in ROBOTS if name in DATASHEETS['robots']]
WEIGHED += [('grippers', create_gripper, name) for name in GRIPPERS
            if 'mass_kg' in DATASHEETS['grippers'].get(name, {})]
PARTS = [(create_robot, name) for name in ROBOTS] + [(create_gripper, name) for name in GRIPPERS]


def without_prefix(part, name):
    """Return a name as it is in the file."""
    return name.removeprefix(part.naming_prefix)


@pytest.mark.parametrize('create, name', PARTS, ids=[name for _, name in PARTS])
def test_each_inertia_is_one_that_a_rigid_body_can_have(create, name):
    part = create(name)
    assert not part.spec.compiler.balanceinertia, 'that would hide a violation'
    model = part.compile()
    for body in range(1, model.nbody):
        mass, (a, b, c) = model.body_mass[body], np.sort(model.body_inertia[body])
        what = f'{model.body(body).name}: mass {mass:g} kg, inertia {a:g} {b:g} {c:g} kg m²'
        assert (mass > 0.0) == (a > 0.0), what
        assert a + b >= c * (1.0 - 1e-6), what
        if mass > 0.0:
            # A body is not larger than 2 m, nor smaller than 1 mm.
            assert 1e-6 < c / mass < 1.0, what


@pytest.mark.parametrize('create, name', PARTS, ids=[name for _, name in PARTS])
def test_each_link_that_a_joint_moves_has_a_mass(create, name):
    model = create(name).compile()
    for joint in range(model.njnt):
        body = model.jnt_bodyid[joint]
        assert model.body_mass[model.body_weldid == model.body_weldid[body]].sum() > 0.0, \
            model.body(body).name


@pytest.mark.parametrize('name', BASES)
def test_each_inertia_of_a_base_is_one_that_a_rigid_body_can_have(name):
    robot = equipped(ROBOTS[0], base=name)
    base = create_base(name)
    model = robot.compile()
    for raw in base.bodies:
        body = model.body(raw).id
        a, b, c = np.sort(model.body_inertia[body])
        assert (model.body_mass[body] > 0.0) == (a > 0.0), raw
        assert a + b >= c * (1.0 - 1e-6), raw


@pytest.mark.parametrize('kind, create, name', WEIGHED, ids=[name for _, _, name in WEIGHED])
def test_parts_weigh_what_their_datasheets_say(kind, create, name):
    stated = DATASHEETS[kind][name]
    part = create(name)
    model = part.compile()
    weighed = sum(mass for body, mass in enumerate(model.body_mass) if without_prefix(
        part, model.body(body).name) not in stated.get('not_in_mass', []))
    assert weighed == pytest.approx(stated['mass_kg'], rel=0.02), stated['source']
