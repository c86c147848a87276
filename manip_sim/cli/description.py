# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a composition is made of, as plain data that JSON can hold: SI units, None for no limit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from manip_sim.cli.elements import actuator_rows, camera_rows, frame_rows, sensor_rows
from manip_sim.cli.listing import free_bodies, origin
from manip_sim.interface.parameters import parameters_of
from manip_sim.interface.topics import SERVICES, topics_of
from manip_sim.models.bases import RobotBaseModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.camera_choice import chosen_cameras
from manip_sim.simulation.commands import MODES
from manip_sim.simulation.mechanism import actuated_joints, moved_joints
from manip_sim.simulation.parts import Part
from manip_sim.simulation.servos import effort_range

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
Row = dict[str, Any]


def describe(world: World, given: Mapping[str, Any]) -> Row:
    """
    Return what a world with one robot is made of.

    :param world: the world
    :param given: parameters of the node that differ from their defaults
    :returns: of dictionaries, lists, strings and finite numbers
    :raises ModelError: if the world cannot be simulated, or a camera is not there
    """
    robot, model = world.robots[0], world.compile()
    simulation = Simulation(world)
    parts = simulation.robot.parts
    twist = simulation.robot.joints.twist_indices is not None
    place = world.arena.robot_position(robot).tolist()
    cameras = chosen_cameras(given.get('cameras', ()), world, model)
    parameters = parameters_of(parts, world.arena.arena_name, place, cameras)
    defaults = {parameter.name: parameter.default for parameter in parameters}
    return {
        'name': robot.name,
        'arena': world.arena.arena_name,
        'mass_kg': float(model.body(robot.root_body).subtreemass[0]),
        'models': list(_models(robot, model)),
        'parts': [_part(part, defaults) for part in parts.values()],
        'joints': list(_joints(simulation, model)),
        'actuators': actuator_rows(model, _of_parts(parts, 'actuators')),
        'sensors': sensor_rows(model, robot),
        'frames': frame_rows(simulation.model, simulation.data, robot),
        'cameras': camera_rows(model),
        'objects': [{'name': name, 'mass_kg': mass}
                    for name, mass in free_bodies(world.arena.compile()).items()],
        'topics': [asdict(topic) for topic in topics_of(
            parts, twist, cameras={name: images.depth for name, images in cameras.items()})],
        'services': [asdict(service) for service in SERVICES],
        'parameters': [
            {'name': p.name, 'value': given.get(p.name, p.default), 'default': p.default,
             'unit': p.unit, 'live': p.live, 'meaning': p.description} for p in parameters],
        'start_defects': list(simulation.start_defects),
    }


def _models(robot: RobotModel, model: Any) -> Iterator[Row]:
    grippers = robot.grippers if isinstance(robot, ManipulatorModel) else {}
    arm_of = {gripper.naming_prefix: arm for arm, gripper in grippers.items()}
    parts: list[MujocoXMLModel] = [robot, *robot.models]
    mass = {part.naming_prefix: sum(float(model.body(body).mass[0]) for body in part.bodies)
            for part in robot.models}
    # All that is of no other part: on a mobile base the robot's root is in two bodies.
    mass[robot.naming_prefix] = (
        float(model.body(robot.root_body).subtreemass[0]) - sum(mass.values()))
    for part in parts:
        kind = ('robots' if part is robot else
                'bases' if isinstance(part, RobotBaseModel) else 'grippers')
        source, file = origin(part, kind)
        yield {
            'kind': kind[:-1], 'class': type(part).__name__, 'prefix': part.naming_prefix,
            'arm': arm_of.get(part.naming_prefix), 'mass_kg': mass[part.naming_prefix],
            'joints': len(part.joints), 'actuators': len(part.actuators), 'from': source,
            'file': file}


def _part(part: Part, defaults: Mapping[str, Any]) -> Row:
    commanded = part.gripper is None and part.actuators
    return {'name': part.name, 'consists_of': list(part.atomic), 'joints': list(part.joints),
            'actuators': list(part.actuators),
            'control_mode': (defaults[f'control_mode.{part.name}'] if commanded
                             else 'position' if part.gripper is not None else None)}


def _of_parts(parts: Mapping[str, Part], elements: str) -> dict[str, str]:
    """Return the part of each joint or actuator, of those that do not overlap."""
    return {name: part.name for part in parts.values() if part.atomic == (part.name,)
            for name in getattr(part, elements)}


def _joints(simulation: Simulation, model: Any) -> Iterator[Row]:
    part_of = _of_parts(simulation.robot.parts, 'joints')
    limits = _limits_of_driven(simulation)
    drivers: dict[int, list[int]] = {}
    for actuator in range(model.nu):
        for driven in actuated_joints(model, actuator):
            drivers.setdefault(driven, []).append(actuator)
    moved = moved_joints(model)
    for name, start in zip(simulation.robot.joint_names, simulation.robot.state().position):
        joint = int(model.joint(name).id)
        hinge = int(model.jnt_type[joint]) == _HINGE
        row = {'name': name, 'part': part_of[name], 'type': 'hinge' if hinge else 'slide',
               'unit': 'rad' if hinge else 'm', 'start': float(start),
               'position': _range(model.jnt_range[joint]) if model.jnt_limited[joint] else None,
               'velocity': _declared_velocity(model, joint),
               'effort': _effort(model, joint, drivers.get(joint, [])),
               'driven_by': [model.actuator(a).name for a in drivers.get(joint, [])],
               'coupled': joint in moved and joint not in drivers}
        yield {**row, **limits.get(name, {})}


def _limits_of_driven(simulation: Simulation) -> dict[str, Row]:
    """Return the velocity and effort limits that the controllers keep to, by joint."""
    limits: dict[str, Row] = {}
    for name, part in simulation.robot.parts.items():
        if part.gripper is not None or part.atomic != (name,):
            continue
        of_mode = {}
        for mode in MODES:
            simulation.robot.set_control_mode(name, mode)
            of_mode[mode] = simulation.robot.limits(name)
        driven = [joint for joint in part.driven_joints if joint is not None]
        for joint, velocity, effort in zip(driven, of_mode['velocity'], of_mode['effort']):
            is_limited = simulation.model.jnt_actfrclimited[simulation.model.joint(joint).id]
            limits[joint] = {'velocity': float(velocity[1]),
                             'effort': _range(effort) if is_limited else None}
    return limits


def _declared_velocity(model: Any, joint: int) -> float | None:
    declared = float(model.jnt_user[joint, 0]) if model.nuser_jnt else 0.0
    return declared if declared > 0.0 else None


def _effort(model: Any, joint: int, actuators: list[int]) -> list[float] | None:
    if len(actuators) == 1 and actuated_joints(model, actuators[0]) == [joint]:
        found = effort_range(model, np.array([joint]), np.array(actuators))[0]
        return _range(found) if np.isfinite(found).all() else None
    return _range(model.jnt_actfrcrange[joint]) if model.jnt_actfrclimited[joint] else None


def _range(limits: Any) -> list[float]:
    return [float(value) for value in limits]
