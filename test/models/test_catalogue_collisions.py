# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Collision shapes of the catalogue fit the links and do not touch each other falsely."""

import mujoco
import numpy as np
import pytest

from catalogue import (
    AtRest, colliding_geoms, figures, ROBOTS, robots_with_figures, support)

from manip_sim.models import compose
from manip_sim.models.arenas import arena_names
from manip_sim.models.robots import create_robot

N_POSES = 200
#: A primitive may stand off a face of the link's bounding box by this [m].
FIT_TOLERANCE_M = 0.06
EXCEPTIONS = figures('collision_exceptions.json')


def contacts(model, data):
    """Return the contacts as sorted lines of geom names."""
    return sorted(f'{model.geom(c.geom1).name} touches {model.geom(c.geom2).name} '
                  f'({1000.0 * c.dist:.1f} mm)' for c in data.contact)


@pytest.mark.parametrize('arena', arena_names())
@pytest.mark.parametrize('name', ROBOTS)
def test_nothing_touches_where_a_robot_starts(name, arena):
    rest = AtRest(name, arena)
    assert contacts(rest.model, rest.data) == []


def links_between(model, link, other):
    """
    Return how many joints apart two links are, or None if no chain goes through both.

    :param link: the body that stands for all that is welded to it, ``body_weldid``
    :param other: another one
    """
    for lower, upper in ((link, other), (other, link)):
        distance = 0
        while lower != upper and lower != 0:
            lower = model.body_weldid[model.body_parentid[lower]]
            distance += 1
        if lower == upper:
            return distance
    return None


@pytest.mark.parametrize('name', ROBOTS)
def test_links_next_to_each_other_never_touch(name):
    """Neither a link and the next one nor, as far as joints leave it apart, the one after it."""
    rest = AtRest(name)
    model, data, robot = rest.model, rest.data, rest.robot
    base = set(robot.base.bodies if robot.base else [])
    bodies = base | set(robot.bodies)
    may_touch = {frozenset(pair.split()) for pair in EXCEPTIONS['may_touch'].get(name, {})}
    joints = rest.joint_ids(robot.joints)
    low, high = np.where(model.jnt_limited[joints, None], model.jnt_range[joints],
                         [-np.pi, np.pi]).T
    random = np.random.default_rng(2)
    false_contacts = set()
    for _ in range(N_POSES):
        data.qpos[model.jnt_qposadr[joints]] = random.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact:
            pair = (contact.geom1, contact.geom2)
            links = [model.body_weldid[model.geom_bodyid[geom]] for geom in pair]
            apart = links_between(model, *links)
            touching = [model.body(model.geom_bodyid[geom]).name for geom in pair]
            # The second link may well meet the base.
            nearest = 1 if base & set(touching) else 2
            names = [body.removeprefix(robot.naming_prefix) for body in touching]
            if bodies >= set(touching) and apart in range(1, nearest + 1) \
                    and frozenset(names) not in may_touch:
                false_contacts.add(f'{" ".join(names)}: ' + ' touches '.join(
                    model.geom(geom).name for geom in pair))
    assert sorted(false_contacts) == []


def faces_apart(model, geoms, box):
    """
    Return how far each face of the hull of shapes is from that of a bounding box [m].

    :param geoms: ids of shapes of one body
    :param box: orientation (w, x, y, z) in the body's frame, lower and upper corner in its own
    :returns: of the faces -x, -y, -z, +x, +y, +z; positive where the hull is larger
    """
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.array(box[0], dtype=float))
    axes = rotation.reshape(3, 3).T
    upper = np.array([max(support(model, geom, axis) for geom in geoms) for axis in axes])
    lower = np.array([max(support(model, geom, -axis) for geom in geoms) for axis in axes])
    return np.concatenate([lower + np.array(box[1]), upper - np.array(box[2])])


@pytest.mark.parametrize('name', robots_with_figures())
def test_collision_shapes_fill_the_bounding_boxes_of_the_links(name):
    robot = create_robot(name)
    model = robot.compile()
    solid = colliding_geoms(model)
    exceptions = EXCEPTIONS['fit'].get(name, {})
    misfits = {}
    for raw, box in figures(f'robots/{name}.json')['boxes'].items():
        body = model.body(robot.correct_naming(raw)).id
        geoms = [geom for geom in solid if model.geom_bodyid[geom] == body]
        if raw in exceptions or '*' in exceptions:
            continue
        if not geoms:
            misfits[raw] = 'no collision shape'
            continue
        apart = faces_apart(model, geoms, box)
        if np.abs(apart).max() > FIT_TOLERANCE_M:
            misfits[raw] = np.round(apart, 3).tolist()
    assert misfits == {}


@pytest.mark.parametrize('name', ROBOTS)
def test_exceptions_name_links_that_exist(name):
    bodies = {body.name for body in create_robot(name).spec.bodies}
    assert set(EXCEPTIONS['fit'].get(name, {})) <= bodies | {'*'}
    for pair in EXCEPTIONS['may_touch'].get(name, {}):
        assert set(pair.split()) <= bodies


@pytest.mark.parametrize('name', ROBOTS)
def test_links_and_grippers_that_move_do_not_collide_as_long_cylinders(name):
    # MuJoCo's several contacts of a cylinder have other normals than the cylinder meets there.
    model = compose(name).compile()
    long = [model.geom(geom).name for geom in colliding_geoms(model)
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER
            and model.body_weldid[model.geom_bodyid[geom]] != 0
            and model.geom_size[geom][1] > model.geom_size[geom][0]]
    assert long == []
