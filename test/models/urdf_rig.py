# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read a URDF as others do, and compare it with the model that it was written from."""

from functools import cache
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.models import compose
from manip_sim.models.urdf_writer import urdf_of

SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_READER = {'fusestatic': 'false', 'inertiafromgeom': 'false', 'discardvisual': 'true',
           'balanceinertia': 'false', 'boundmass': '1e-14', 'boundinertia': '1e-14'}


@cache
def exported(name):
    """Return the compiled world of a robot of the catalogue, and its URDF."""
    world = compose(name)
    return world.compile(), urdf_of(world)


def read_by_mujoco(xml):
    """Return the model that MuJoCo's own URDF reader makes, with every link a body."""
    root = ElementTree.fromstring(xml)
    ElementTree.SubElement(ElementTree.SubElement(root, 'mujoco'), 'compiler', _READER)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding='unicode'))


def scalar_joints(model, tree):
    """Return the ids of hinges and slides in a tree."""
    return [joint.id for joint in tree.joints if joint.axis is not None]


def random_position(model, joints, random, mimics=()):
    """Return random joint positions by name, within the limits; followers where they belong."""
    position = {}
    for joint in joints:
        low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-3.0, 3.0)
        position[joint] = random.uniform(low, high)
    for joint in mimics:
        mimic = mimics[joint]
        position[joint] = mimic.multiplier * position[mimic.leader] + mimic.offset
    return {model.joint(joint).name: value for joint, value in position.items()}


def data_at(model, position, data=None):
    """Return the data of a model with joints at positions by name: frames and inertia."""
    data = mujoco.MjData(model) if data is None else data
    for name, value in position.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mj_crb(model, data)
    return data


def frames(model, data, tree):
    """Yield link, position and rotation of all bodies, sites and cameras that are links."""
    for links, positions, rotations in (
            (tree.link_of_body, data.xpos, data.xmat),
            (tree.link_of_site, data.site_xpos, data.site_xmat),
            (tree.link_of_camera, data.cam_xpos, data.cam_xmat)):
        for index, link in links.items():
            yield link, positions[index], rotations[index].reshape(3, 3)


def mass_matrix(model, data, names, armature=True):
    """Return the inertia matrix of some joints, by products with unit vectors."""
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    columns = []
    for dof in dofs:
        unit, column = np.zeros(model.nv), np.empty(model.nv)
        unit[dof] = 1.0
        mujoco.mj_mulM(model, data, column, unit)
        columns.append(column[dofs])
    matrix = np.array(columns)
    return matrix if armature else matrix - np.diag(model.dof_armature[dofs])
