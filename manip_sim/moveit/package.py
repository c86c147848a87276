# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A ROS package with all that MoveIt 2 takes for a robot, differing for each composition."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import re
import shutil
import tempfile
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import yaml

from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.models.urdf_writer import choose_robot, Urdf, write_urdf
from manip_sim.models.urdf_writer.meshes import binary_stl, ELLIPSOID, MeshFile, stl_of
from manip_sim.models.urdf_writer.unit_sphere import unit_sphere
from manip_sim.moveit import launch_files, settings
from manip_sim.moveit.collisions import disabled_pairs
from manip_sim.moveit.groups import find_groups, Group, passive_joints
from manip_sim.moveit.postures import find_postures
from manip_sim.moveit.srdf import write_srdf
from manip_sim.quoting import quoted
from manip_sim.simulation import Simulation

_NAME = re.compile(r'[a-z][a-z0-9]*(_[a-z0-9]+)*')
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


def write_package(world: World, folder: Path) -> list[str]:
    """
    Write a MoveIt configuration package for the only robot of a world.

    :param world: with one robot
    :param folder: becomes the package and gives it its name; must be new or empty
    :returns: what was left out, in sentences
    :raises ModelError: if the folder cannot be used, or there is nothing to plan for
    """
    _check_folder(folder)
    files, notes = _contents(world, folder.name)
    with tempfile.TemporaryDirectory(dir=folder.parent) as unfinished:
        for name, content in files.items():
            file = Path(unfinished, folder.name, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        shutil.copytree(Path(unfinished, folder.name), folder, dirs_exist_ok=True)
    return notes


def _check_folder(folder: Path) -> None:
    if not _NAME.fullmatch(folder.name):
        raise ModelError(f'{quoted(folder.name)} cannot be the name of a ROS package: it needs '
                         'lower-case letters, digits and single underscores, such as '
                         'panda_moveit_config')
    if not folder.parent.is_dir():
        raise ModelError(f'no such folder: {folder.parent}')
    if folder.exists() and not folder.is_dir():
        raise ModelError(f'{folder} is a file, give the name of a folder')
    if folder.is_dir() and any(folder.iterdir()):
        raise ModelError(f'{folder} is not empty: give a new folder, or remove it first')


def _contents(world: World, package: str) -> tuple[dict[str, bytes], list[str]]:
    """Return the contents of all files by path, and what was left out."""
    model, robot = world.compile(), choose_robot(world)
    meshes = _meshes(model)
    uris = {key: _mesh_file(package, name) for key, (name, _) in meshes.items()}
    urdf = write_urdf(model, robot, uris)
    simulation = Simulation(world)
    simulated = simulation.robot
    groups = find_groups(model, simulated, urdf)
    if not groups:
        raise ModelError(f'{robot.name} has no joints that MoveIt could plan for')
    postures = find_postures(simulation, simulated)
    name, velocity, effort = _read(urdf)
    disabled = disabled_pairs(world, robot, urdf.tree.link_of_body, postures)
    srdf = write_srdf(name, groups, postures, passive_joints(model, simulated, urdf), disabled)
    texts = {f'config/{name}.urdf': urdf.xml, f'config/{name}.srdf': srdf,
             **launch_files.text_files(package, name),
             **_as_yaml(_settings(groups, simulated, velocity, effort)),
             **_as_yaml({'.setup_assistant': launch_files.setup_assistant(package, name),
                         'rviz/moveit.rviz': launch_files.rviz(groups[0].name)})}
    used = {key: mesh for key, mesh in meshes.items() if f'/meshes/{mesh[0]}"' in urdf.xml}
    return ({**{path: text.encode() for path, text in texts.items()},
             'meshes/README.md': b'Meshes of the robot as MuJoCo has compiled them.\n',
             **{f'meshes/{file}': content for file, content in used.values()}},
            list(urdf.notes))


def _settings(groups: list[Group], robot: Any, velocity: Mapping[str, float],
              effort: Mapping[str, float]) -> dict[str, Any]:
    return {
        'config/kinematics.yaml': settings.kinematics(groups),
        'config/joint_limits.yaml': settings.joint_limits(groups, robot, velocity),
        'config/moveit_controllers.yaml': settings.controllers(groups, effort),
        'config/ompl_planning.yaml': settings.ompl(groups),
        'config/pilz_industrial_motion_planner_planning.yaml': settings.pilz(),
        'config/pilz_cartesian_limits.yaml': settings.pilz_cartesian_limits()}


def _as_yaml(contents: Mapping[str, Any]) -> dict[str, str]:
    return {path: yaml.safe_dump(content, sort_keys=False) for path, content in contents.items()}


def _read(urdf: Urdf) -> tuple[str, dict[str, float], dict[str, float]]:
    """Return the name in a URDF, and its velocity and effort limits by joint."""
    root = ElementTree.fromstring(urdf.xml)
    limits = {str(joint.get('name')): limit for joint in root.iter('joint')
              if (limit := joint.find('limit')) is not None}
    velocity, effort = ({name: float(limit.get(key, 0.0)) for name, limit in limits.items()}
                        for key in ('velocity', 'effort'))
    return str(root.get('name')), velocity, effort


def _meshes(model: mujoco.MjModel) -> dict[str, tuple[str, bytes]]:
    """Return the name and content of an STL file for each mesh, whatever it was read from."""
    found = {ELLIPSOID: ('unit_sphere.stl', binary_stl(unit_sphere()))}
    for mesh in np.unique(model.geom_dataid[model.geom_type == _MESH]).tolist():
        found[model.mesh(mesh).name] = (f'mesh_{mesh}.stl', stl_of(model, mesh))
    return found


def _mesh_file(package: str, name: str) -> MeshFile:
    return MeshFile(f'package://{package}/meshes/{name}', np.ones(3), np.zeros(3), np.eye(3))
