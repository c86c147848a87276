# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim export``: a composition as a file for MuJoCo or ROS."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
import warnings

import mujoco

from manip_sim.cli.composing_options import compose_from, Composed
from manip_sim.cli.output import check_folder, write_whole
from manip_sim.errors import ManipSimError
from manip_sim.interface.offered_sensors import SensorSettings
from manip_sim.interface.part_parameters import commanded_parts
from manip_sim.interface.topics import hardware_of, remapped, topics_of_instruments
from manip_sim.models import World
from manip_sim.models.archive import describe_rounding
from manip_sim.models.urdf_writer import choose_robot, Hardware, urdf_of
from manip_sim.simulation import Simulation

_ARCHIVES = ('.mjz', '.zip')


def run(options: argparse.Namespace) -> tuple[str, int]:
    if options.moveit is not None or isinstance(options.ros2_control, Path):
        return '\n'.join(_write_packages(options)), 0
    file: Path = options.file
    ending = file.suffix.lower()
    if ending not in ('.xml', '.mjb', '.urdf', *_ARCHIVES):
        raise ManipSimError(f'{file}: the name must end with .xml, .mjz, .zip, .mjb or .urdf')
    check_folder(file)
    composed = compose_from(options)
    world = composed.composition.world
    notes: tuple[str, ...] = ()
    if ending in _ARCHIVES:
        content = world.to_archive()
        notes = (_said(world, lambda: mujoco.MjSpec.from_zip(BytesIO(content)).compile()),)
    elif ending == '.xml':
        content = world.to_xml().encode()
        notes = (_said(world, lambda: mujoco.MjModel.from_xml_string(content.decode())),)
    elif ending == '.mjb':
        content = world.to_binary()
        notes = (f'only MuJoCo {mujoco.mj_versionString()} reads it',)
    else:
        name = choose_robot(world, options.name).name_in_world
        urdf = urdf_of(world, name, _hardware(composed, name) if options.ros2_control else None)
        content, notes = urdf.xml.encode(), urdf.notes
    write_whole(file, lambda path: path.write_bytes(content))
    return '\n'.join([f'{file} ({-(-file.stat().st_size // 1000)} kB)', *notes]), 0


def _said(world: World, load: Callable[[], mujoco.MjModel]) -> str:
    """Return what the text of MJCF changes of a world, by reading it again."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        return describe_rounding(world.compile(), load())


def _write_packages(options: argparse.Namespace) -> list[str]:
    """Write packages for MoveIt and ros2_control, and return their names with notes on them."""
    from manip_sim.moveit import write_package
    from manip_sim.moveit.package import check_folder as check_package
    from manip_sim.moveit.package import write_control_package
    composed, lines, controllers = compose_from(options), [], None
    world = composed.composition.world
    if isinstance(options.ros2_control, Path):
        if options.moveit is not None:
            check_package(options.moveit.resolve())
            if options.moveit.resolve() == options.ros2_control.resolve():
                raise ManipSimError(f'{options.moveit} cannot be both packages: give two folders')
        hardware = _hardware(composed, choose_robot(world).name_in_world)
        notes, controllers = write_control_package(
            world, options.ros2_control, hardware, composed.parameters.given)
        lines += [f'{options.ros2_control}', *notes]
    if options.moveit is not None:
        lines += [f'{options.moveit}', *write_package(world, options.moveit, controllers)]
    return list(dict.fromkeys(lines))


def _hardware(composed: Composed, name: str) -> Hardware:
    """Return the ros2_control hardware of a robot, in the control modes of its parameters."""
    composition, value = composed.composition, composed.parameters.value
    simulation = Simulation(composition.world)
    robots = simulation.robots
    robot = robots[name]
    scope = dict(zip(robots, composition.scopes))[name]
    for part in commanded_parts(robot.parts):
        if robot.parts[part].atomic == (part,):
            robot.set_control_mode(part, value(scope.parameter(f'control_mode.{part}')))
    named = topics_of_instruments(simulation, dict(zip(composition.scopes, robots.values())))
    settings = SensorSettings(
        value('sensors'), [instrument.name for instrument, *_ in named], value('publish_rate'))
    return hardware_of(simulation, robot, scope, value('ros2_control_plugin'),
                       value('stepping') == 'lockstep', remapped, rates_hz=settings.rates_hz)
