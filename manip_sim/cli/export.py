# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim export``: a composition as a file for MuJoCo or ROS."""

from __future__ import annotations

import argparse
from pathlib import Path

from manip_sim.cli.composition import compose_from
from manip_sim.cli.output import check_folder, write_whole
from manip_sim.errors import ManipSimError
from manip_sim.interface.parameters import robot_parameters
from manip_sim.interface.scope import Scope
from manip_sim.models import World
from manip_sim.models.urdf_writer import Hardware, urdf_of
from manip_sim.simulation import Simulation

_ARCHIVES = ('.mjz', '.zip')


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Write the file or the package; tell its size, and what it cannot hold."""
    if options.moveit is not None:
        from manip_sim.moveit import write_package
        folder: Path = options.moveit
        return '\n'.join([f'{folder}', *write_package(compose_from(options), folder)]), 0
    file: Path = options.file
    ending = file.suffix.lower()
    if ending not in ('.xml', '.urdf', *_ARCHIVES):
        raise ManipSimError(f'{file}: the name must end with .xml, .mjz, .zip or .urdf')
    check_folder(file)
    world = compose_from(options)
    notes: tuple[str, ...] = ()
    if ending in _ARCHIVES:
        content = world.to_archive()
    elif ending == '.xml':
        content = world.to_xml().encode()
    else:
        urdf = urdf_of(world, hardware=_hardware(world) if options.ros2_control else None)
        content, notes = urdf.xml.encode(), urdf.notes
    write_whole(file, lambda path: path.write_bytes(content))
    return '\n'.join([f'{file} ({_size(file)})', *notes]), 0


def _hardware(world: World) -> Hardware:
    """Return what lets ros2_control command the robot in the default control modes."""
    robot = Simulation(world).robot
    driven = [name for name, part in robot.parts.items() if part.gripper is None
              and part.actuators]
    for parameter in robot_parameters(Scope(), driven):
        group, _, part = parameter.name.partition('.')
        if group == 'control_mode':
            robot.set_control_mode(part, parameter.default)
    return Hardware(robot.command_interfaces())


def _size(file: Path) -> str:
    return f'{-(-file.stat().st_size // 1000)} kB'
