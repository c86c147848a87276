# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write the URDF of a robot; reading URDF is in ``manip_sim.models.files.urdf``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.loading import compile_spec
from manip_sim.models.robots import RobotModel
from manip_sim.models.urdf_writer.joints import (
    actuated_joints, add_hardware, effort_limit, find_mimics, Hardware, Mimic, OWN_PLUGIN, PLUGINS,
    position_limits, TOPIC_PLUGIN, velocity_limit)
from manip_sim.models.urdf_writer.kinematic_tree import (
    build_tree, Joint, KinematicTree, Link, robot_tree)
from manip_sim.models.urdf_writer.link_shapes import (
    collides, files_of_meshes, geoms_of_body, is_seen, MeshFile, rgba_of, Shape, shapes_of,
    text_of)
from manip_sim.models.world import World
from manip_sim.quaternion import matrix_of, rpy_of


@dataclass(frozen=True)
class Urdf:
    """
    A URDF, and how it relates to the model.

    :ivar xml: the URDF
    :ivar tree: its links and joints
    :ivar mimics: how joints follow others, by id of the joint
    :ivar notes: what URDF cannot express and was left out, in sentences
    """

    xml: str
    tree: KinematicTree
    mimics: Mapping[int, Mimic]
    notes: tuple[str, ...]


def write_urdf(model: mujoco.MjModel, robot: RobotModel,
               meshes: Mapping[str, MeshFile] | None = None, hardware: Hardware | None = None,
               lidars: Iterable[str] = ()) -> Urdf:
    """
    Return the URDF of a robot with its base and grippers, in ``world``.

    :param model: the compiled ``mujoco.MjModel`` of a world with the robot
    :param robot: a robot of that world
    :param meshes: files of meshes by name; other meshes are left out
    :param hardware: of the ``<ros2_control>`` tag; None for none
    :param lidars: names of the lidars of the world
    """
    name = robot.name.removesuffix(str(robot.idn))
    return _UrdfWriter(model, robot_tree(model, robot, lidars), name, meshes or {}).write(hardware)


class _UrdfWriter:
    """Writer of the URDF of one robot."""

    def __init__(self, model: mujoco.MjModel, tree: KinematicTree, name: str,
                 meshes: Mapping[str, MeshFile]) -> None:
        self._model, self._tree, self._meshes = model, tree, meshes
        self._robot = ElementTree.Element('robot', name=name)
        self._materials: dict[str, str] = {}
        self._actuators = actuated_joints(model)
        self._scalar = [joint.id for joint in tree.joints
                        if joint.id is not None and joint.axis is not None]
        self._mimics, self._notes = find_mimics(model, self._scalar, self._actuators)
        geoms = [g for body in tree.link_of_body for g in geoms_of_body(model, body)]
        #: Without visual geoms, those that collide are shown.
        self._shows_all = not any(is_seen(model, geom) for geom in geoms)
        self._notes += _loops(model, set(tree.link_of_body))

    def write(self, hardware: Hardware | None) -> Urdf:
        """Write the URDF and return it."""
        joint_of = {joint.child: joint for joint in self._tree.joints}
        for link in self._tree.links:
            if link.name in joint_of:
                self._add_joint(joint_of[link.name])
            self._add_link(link)
        for place, (rgba, name) in enumerate(self._materials.items()):
            material = ElementTree.Element('material', name=name)
            ElementTree.SubElement(material, 'color', rgba=rgba)
            self._robot.insert(place, material)
        if hardware is not None:
            names = [self._model.joint(joint).name for joint in self._scalar]
            add_hardware(self._robot, hardware, names,
                         [self._model.joint(joint).name for joint in self._mimics])
        ElementTree.indent(self._robot)
        xml = ElementTree.tostring(self._robot, encoding='unicode')
        return Urdf(f'<?xml version="1.0"?>\n{xml}\n', self._tree, self._mimics,
                    tuple(dict.fromkeys(self._notes)))

    # ------------------------------------------------------------------ joints

    def _add_joint(self, joint: Joint) -> None:
        element = ElementTree.SubElement(self._robot, 'joint', name=joint.name, type=joint.kind)
        ElementTree.SubElement(element, 'parent', link=joint.parent)
        ElementTree.SubElement(element, 'child', link=joint.child)
        _add_origin(element, joint.position, joint.rotation)
        if joint.axis is None or joint.id is None:
            return
        ElementTree.SubElement(element, 'axis', xyz=text_of(joint.axis))
        model, number = self._model, joint.id
        limits = {
            'effort': effort_limit(model, number, self._actuators.get(number, [])),
            'velocity': velocity_limit(model, number, self._mimics, self._actuators),
            **dict(zip(('lower', 'upper'), position_limits(model, number)))}
        ElementTree.SubElement(element, 'limit',
                               {key: text_of(value) for key, value in limits.items()})
        dof = int(model.jnt_dofadr[number])
        # Newer versions of MuJoCo have coefficients for higher powers of the velocity too.
        damping = np.atleast_1d(model.dof_damping[dof])[0]
        ElementTree.SubElement(element, 'dynamics', damping=text_of(damping),
                               friction=text_of(model.dof_frictionloss[dof]))
        if number in self._mimics:
            mimic = self._mimics[number]
            ElementTree.SubElement(
                element, 'mimic', joint=model.joint(mimic.leader).name,
                multiplier=text_of(mimic.multiplier), offset=text_of(mimic.offset))

    # ------------------------------------------------------------------ links

    def _add_link(self, link: Link) -> None:
        element = ElementTree.SubElement(self._robot, 'link', name=link.name)
        if link.body is None:
            return
        _add_inertial(element, self._model, link.body)
        for geom in geoms_of_body(self._model, link.body):
            touches = collides(self._model, geom)
            seen = is_seen(self._model, geom) or (touches and self._shows_all)
            shapes = list(shapes_of(self._model, geom, self._meshes)) if seen or touches else []
            if (seen or touches) and not shapes:
                kind = mujoco.mjtGeom(int(self._model.geom_type[geom])).name
                self._notes.append(f'{link.name}: a {kind.rpartition("_")[2].lower()} is left out')
            if seen:
                self._add_shapes(element, 'visual', geom, shapes)
            if touches:
                self._add_shapes(element, 'collision', geom, shapes)

    def _add_shapes(self, link: ElementTree.Element, tag: str, geom: int, shapes: list[Shape]
                    ) -> None:
        for shape in shapes:
            element = ElementTree.SubElement(link, tag)
            _add_origin(element, shape.position, shape.rotation)
            geometry = ElementTree.SubElement(element, 'geometry')
            ElementTree.SubElement(geometry, shape.tag, dict(shape.attributes))
            if tag == 'visual':
                ElementTree.SubElement(element, 'material', name=self._material(geom))

    def _material(self, geom: int) -> str:
        rgba = [round(float(part), 4) for part in rgba_of(self._model, geom)]
        return self._materials.setdefault(text_of(rgba), f'colour_{len(self._materials)}')


def _loops(model: mujoco.MjModel, bodies: set[int]) -> list[str]:
    """Return a note of the constraints that close loops, which a URDF, a tree, cannot have."""
    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    count = sum(1 for e in range(model.neq) if int(model.eq_type[e]) in kinds
                and model.eq_active0[e] and _bodies_of(model, e) <= bodies)
    return [f'{count} constraints between bodies close loops: a URDF is a tree'] if count else []


def _bodies_of(model: mujoco.MjModel, equality: int) -> set[int]:
    ends = {int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])}
    if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return {int(model.site_bodyid[site]) for site in ends}
    return ends


def _add_origin(element: ElementTree.Element, position: FloatArray, rotation: FloatArray) -> None:
    ElementTree.SubElement(element, 'origin', xyz=text_of(position), rpy=text_of(rpy_of(rotation)))


def _add_inertial(link: ElementTree.Element, model: mujoco.MjModel, body: int) -> None:
    if not model.body_mass[body] > 0.0:
        return
    turn = matrix_of(model.body_iquat[body])
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    element = ElementTree.SubElement(link, 'inertial')
    _add_origin(element, model.body_ipos[body], np.eye(3))
    ElementTree.SubElement(element, 'mass', value=text_of(model.body_mass[body]))
    ElementTree.SubElement(element, 'inertia', {
        f'i{"xyz"[row]}{"xyz"[column]}': text_of(inertia[row, column])
        for row in range(3) for column in range(row, 3)})


def urdfs_of(world: World, hardware: Mapping[str, Hardware] | None = None) -> dict[str, Urdf]:
    """
    Return the URDF of each robot by its name in the world.

    :param world: with one robot or more
    :param hardware: by name of the robot, for those with a ``<ros2_control>`` tag
    :raises ModelError: if the world does not compile
    """
    spec = world.compose(objects=False)
    model = compile_spec(spec, world.name)
    held = {robot.naming_prefix + name: file for robot in world.robots
            for name, file in robot.held_files.items()}
    meshes, hardware_of = files_of_meshes(spec, model, held), hardware or {}
    return {robot.name_in_world:
            write_urdf(model, robot, meshes, hardware_of.get(robot.name_in_world),
                       [lidar.name for lidar in world.lidars])
            for robot in world.robots}


def urdf_of(world: World, robot: str | None = None, hardware: Hardware | None = None) -> Urdf:
    """
    Return the URDF of one robot.

    :param world: with the robot
    :param robot: its name, as for :func:`urdfs_of`; None for the only one
    :param hardware: of the ``<ros2_control>`` tag; None for none
    :raises ModelError: if there are several robots and none is named, or the world does not
        compile
    :raises UnknownNameError: if the robot is unknown
    """
    name = choose_robot(world, robot).name_in_world
    return urdfs_of(world, {} if hardware is None else {name: hardware})[name]


def choose_robot(world: World, name: str | None = None) -> RobotModel:
    """
    Return the robot of a name, or the only one; raises as :func:`urdf_of` does.

    :param world: with one robot or more
    :param name: of the robot, as for :func:`urdfs_of`; None for the only one
    """
    robots = {robot.name_in_world: robot for robot in world.robots}
    if name is None:
        if len(robots) != 1:
            raise ModelError('a URDF describes one robot: name one of '
                             + (', '.join(robots) or 'none'))
        return next(iter(robots.values()))
    if name not in robots:
        raise UnknownNameError('robot', name, robots)
    return robots[name]


__all__ = ['build_tree', 'choose_robot', 'Hardware', 'KinematicTree', 'OWN_PLUGIN', 'PLUGINS',
           'robot_tree', 'TOPIC_PLUGIN', 'Urdf', 'urdf_of', 'urdfs_of', 'write_urdf']
