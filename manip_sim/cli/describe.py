# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim describe``: a composition, in tables, JSON or YAML."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
import json
import logging
from typing import Any

import mujoco
import numpy as np
import yaml

from manip_sim.algebra import wxyz_to_xyzw
from manip_sim.cli.composing_options import compose_from, Composed, origin
from manip_sim.cli.output import number, span, table, terminal_width
from manip_sim.errors import ModelError
from manip_sim.interface.composition import declare_cameras, declare_parts
from manip_sim.interface.offered_sensors import offered_topics
from manip_sim.interface.topics import actions_of, Scope, SERVICES, topics_of_world
from manip_sim.models.actuators import declared_velocity, effort_range, position_servos
from manip_sim.models.couplings import actuated_joints, moved_joints
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.urdf_writer.links import subtree
from manip_sim.models.world import inferred_by_model
from manip_sim.quoting import pluralize
from manip_sim.sensing.instruments import sensor_type
from manip_sim.simulation import SimulatedRobot, Simulation

_TARGET = {
    int(mujoco.mjtTrn.mjTRN_JOINT): 'joint', int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): 'joint',
    int(mujoco.mjtTrn.mjTRN_TENDON): 'tendon', int(mujoco.mjtTrn.mjTRN_SITE): 'site',
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): 'site', int(mujoco.mjtTrn.mjTRN_BODY): 'body'}
_LOGGER = logging.getLogger('manip_sim')
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
Row = dict[str, Any]


def actuator_rows(model: mujoco.MjModel, part_of: Mapping[str, str]) -> list[Row]:
    """Return some actuators as the files define them, by the part of each."""
    rows = []
    for name, part in part_of.items():
        index = int(model.actuator(name).id)
        kind = _TARGET[int(model.actuator_trntype[index])]
        target = int(model.actuator_trnid[index, 0])
        rows.append({
            'name': name, 'part': part, 'type': _servo_type(model, index), 'drives': kind,
            'target': getattr(model, kind)(target).name,
            'control': _limits(model.actuator_ctrllimited, model.actuator_ctrlrange, index),
            'force': _limits(model.actuator_forcelimited, model.actuator_forcerange, index)})
    return rows


def _limits(limited: Any, ranges: Any, index: int) -> list[float] | None:
    return _range(ranges[index]) if limited[index] else None


def _servo_type(model: mujoco.MjModel, index: int) -> str:
    fixed = int(model.actuator_gaintype[index]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    bias = int(model.actuator_biastype[index])
    stiffness, damping = -model.actuator_biasprm[index, 1:3]
    if position_servos(model, index):
        return 'position servo'
    if (fixed and bias == int(mujoco.mjtBias.mjBIAS_AFFINE) and stiffness == 0.0
            and damping > 0.0):
        return 'velocity servo'
    return 'motor' if fixed and bias == int(mujoco.mjtBias.mjBIAS_NONE) else 'other'


def sensor_rows(model: mujoco.MjModel, robot: RobotModel) -> list[Row]:
    rows = []
    # Joints of a hand in the robot's own file are the robot's too.
    for name in dict.fromkeys(
            name for part in (robot, *robot.models) for name in part.sensors):
        index = int(model.sensor(name).id)
        kind = int(model.sensor_objtype[index])
        element = int(model.sensor_objid[index])
        rows.append({
            'name': name,
            'type': sensor_type(model, index),
            'of': mujoco.mj_id2name(model, kind, element) if element >= 0 else None,
            'length': int(model.sensor_dim[index])})
    return rows


def frame_rows(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotModel) -> list[Row]:
    """Return the bodies of a robot and the sites with a role, with their poses in ``world``."""
    rows = []
    for body in subtree(model, int(model.body(robot.root_body).id)):
        rows.append({
            'name': model.body(body).name, 'kind': 'body',
            'parent': model.body(int(model.body_parentid[body])).name,
            'mass_kg': float(model.body_mass[body]),
            'position_m': data.xpos[body].tolist(),
            'quat_xyzw': wxyz_to_xyzw(data.xquat[body]).tolist()})
    for name in dict.fromkeys(
            site for part in (robot, *robot.models) for site in (
                part.correct_naming('ft_frame'), *part.important_sites.values())
            if site in part.sites):
        site, quat = int(model.site(name).id), np.empty(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[site])
        rows.append({
            'name': name, 'kind': 'site',
            'parent': model.body(int(model.site_bodyid[site])).name, 'mass_kg': None,
            'position_m': data.site_xpos[site].tolist(),
            'quat_xyzw': wxyz_to_xyzw(quat).tolist()})
    return rows


def camera_rows(model: mujoco.MjModel) -> list[Row]:
    rows = []
    for camera in range(model.ncam):
        width, height = model.cam_resolution[camera].tolist()
        rows.append({
            'name': model.camera(camera).name,
            'body': model.body(int(model.cam_bodyid[camera])).name,
            'fovy_rad': float(np.radians(model.cam_fovy[camera])),
            # A camera without a resolution of its own has one of 1 x 1.
            'resolution': [width, height] if width > 1 and height > 1 else None})
    return rows


def describe(composed: Composed) -> Row:
    """
    Return what a world consists of; of several robots, names of parts begin with the robot's.

    :param composed: the world, and the parameters of the node
    :returns: dictionaries and lists of what JSON can hold; numbers are finite
    :raises ModelError: if the world cannot be simulated, or a camera does not exist
    """
    world, parameters = composed.composition.world, composed.parameters
    model, simulation = world.compile(), Simulation(world)
    served = list(zip(composed.composition.scopes, simulation.robots.values()))
    declare_parts(parameters, [(scope, robot.parts) for scope, robot in served])
    cameras = declare_cameras(parameters, world, model)
    of_robots = [_of_robot(composed, simulation, model, scope, robot) for scope, robot in served]
    topics = topics_of_world(
        simulation, dict(served), {name: images.depth for name, images in cameras.items()},
        composed.composition.task is not None)
    return {
        'name': world.name,
        'arena': world.arena.arena_name,
        'mass_kg': sum(float(model.body(robot.root_body).subtreemass[0])
                       for robot in world.robots),
        **{section: [row for sections in of_robots for row in sections[section]]
           for section in of_robots[0]},
        'inferred': [{'model': name, 'inference': sentence}
                     for name, sentences in inferred_by_model(world) for sentence in sentences],
        'cameras': camera_rows(model),
        'objects': [{'name': name, 'mass_kg': float(model.body(name).subtreemass[0])}
                    for name in simulation.entities.free_names],
        'topics': [asdict(topic) for topic in (*topics, *(
            offered.topic for offered in offered_topics(dict(served), topics, _LOGGER.warning)))],
        'services': [asdict(service) for service in SERVICES],
        'actions': [{**asdict(action), 'name': scope.topic(action.name)}
                    for scope, robot in served for action in actions_of(robot.parts)],
        'parameters': [
            {'name': p.name, 'value': parameters.value(p.name), 'default': p.default,
             'unit': p.unit, 'live': p.live, 'meaning': p.description}
            for p in parameters.specs.values()],
        'start_defects': list(simulation.start_defects),
    }


def _of_robot(composed: Composed, simulation: Simulation, model: mujoco.MjModel, scope: Scope,
              robot: SimulatedRobot) -> dict[str, list[Row]]:
    """Return the sections of one robot; names of its parts begin with its scope."""
    parts = {name: scope.topic(name) for name in robot.parts}
    whole, rows = robot.robot_model, []
    for name, part in robot.parts.items():
        mode = None
        if part.gripper is not None:
            mode = 'position'
        elif part.actuators:
            mode = composed.parameters.value(scope.parameter(f'control_mode.{name}'))
        rows.append({
            'name': parts[name], 'consists_of': [parts[other] for other in part.atomic],
            'joints': list(part.joints), 'actuators': list(part.actuators), 'control_mode': mode})
    return {
        'models': [{'robot': scope.name, **row} for row in _models(whole, model)],
        'parts': rows,
        'joints': list(_joints(simulation.model, robot, model, parts)),
        'actuators': actuator_rows(model, _of_parts(robot, 'actuators', parts)),
        'sensors': sensor_rows(model, whole),
        'frames': frame_rows(simulation.model, simulation.data, whole)}


def _models(robot: RobotModel, model: mujoco.MjModel) -> Iterator[Row]:
    grippers = robot.grippers if isinstance(robot, ManipulatorModel) else {}
    # By part, not by prefix: a hand in the robot's own file has that of the robot.
    arm_of = {id(gripper): arm for arm, gripper in grippers.items()}
    mass = {id(part): sum(float(model.body(body).mass[0]) for body in part.bodies)
            for part in robot.models}
    # The rest: on a mobile base the robot's root is in two bodies.
    mass[id(robot)] = float(model.body(robot.root_body).subtreemass[0]) - sum(mass.values())
    for part in (robot, *robot.models):
        kind = ('robots' if part is robot else 'grippers' if id(part) in arm_of else 'bases')
        source, file = origin(part, kind)
        yield {
            'kind': kind[:-1], 'class': type(part).__name__, 'prefix': part.naming_prefix,
            'arm': arm_of.get(id(part)), 'mass_kg': mass[id(part)],
            'joints': len(part.joints), 'actuators': len(part.actuators), 'from': source,
            'file': file}


def _of_parts(robot: SimulatedRobot, elements: str, names: Mapping[str, str]) -> dict[str, str]:
    """Return the part of each joint or actuator; parts that consist of others are left out."""
    return {name: names[part.name] for part in robot.parts.values() if part.atomic == (part.name,)
            for name in getattr(part, elements)}


def _joints(simulated: Any, robot: SimulatedRobot, model: mujoco.MjModel, names: Mapping[str, str]
            ) -> Iterator[Row]:
    part_of = _of_parts(robot, 'joints', names)
    limits = _limits_of_driven(simulated, robot)
    drivers: dict[int, list[int]] = {}
    for actuator in range(model.nu):
        for driven in actuated_joints(model, actuator):
            drivers.setdefault(driven, []).append(actuator)
    moved = moved_joints(model)
    for name, start in zip(robot.joint_names, robot.state().position):
        joint = int(model.joint(name).id)
        hinge = int(model.jnt_type[joint]) == _HINGE
        velocity = float(declared_velocity(model, joint))
        row = {'name': name, 'part': part_of[name], 'type': 'hinge' if hinge else 'slide',
               'unit': 'rad' if hinge else 'm', 'start': float(start),
               'position': _limits(model.jnt_limited, model.jnt_range, joint),
               'velocity': velocity if np.isfinite(velocity) else None,
               'effort': _effort(model, joint, drivers.get(joint, [])),
               'driven_by': [model.actuator(a).name for a in drivers.get(joint, [])],
               'coupled': joint in moved and joint not in drivers}
        yield {**row, **limits.get(name, {})}


def _limits_of_driven(simulated: Any, robot: SimulatedRobot) -> dict[str, Row]:
    """Return the velocity and effort limits that the controllers keep to, by joint."""
    limits: dict[str, Row] = {}
    for name, part in robot.parts.items():
        if part.gripper is not None or part.atomic != (name,):
            continue
        joints, indices = robot.joints, robot.joints.indices_of(name)
        efforts = joints.ranges(indices, ['effort'] * len(joints.names))
        for index, velocity, effort in zip(indices, joints.velocity_limits(indices), efforts):
            joint = joints.names[index]
            is_limited = simulated.jnt_actfrclimited[simulated.joint(joint).id]
            limits[joint] = {'velocity': float(velocity),
                             'effort': _range(effort) if is_limited else None}
    return limits


def _effort(model: mujoco.MjModel, joint: int, actuators: list[int]) -> list[float] | None:
    if len(actuators) == 1 and actuated_joints(model, actuators[0]) == [joint]:
        limits = effort_range(model, np.array([joint]), np.array(actuators))[0]
        return _range(limits) if np.isfinite(limits).all() else None
    return _limits(model.jnt_actfrclimited, model.jnt_actfrcrange, joint)


def _range(limits: Any) -> list[float]:
    return [float(value) for value in limits]


#: By section of the description: the title, the names of the columns, and the cells of a row.
_COLUMNS: dict[str, tuple[str, tuple[str, ...], Callable[[Row], tuple[str, ...]]]] = {
    'models': (
        'Models', ('kind', 'class', 'prefix', 'mass kg', 'joints', 'actuators', 'from'),
        lambda r: (_kind(r), r['class'], r['prefix'],
                   number(r['mass_kg']), str(r['joints']), str(r['actuators']), r['from'])),
    'inferred': (
        'Inferred from files', ('model', 'inference'),
        lambda r: (r['model'], r['inference'])),
    'parts': (
        'Parts', ('part', 'consists of', 'joints', 'actuators', 'control mode'),
        lambda r: (r['name'], ', '.join(n for n in r['consists_of'] if n != r['name']) or '-',
                   str(len(r['joints'])), str(len(r['actuators'])), r['control_mode'] or '-')),
    'joints': (
        'Joints: velocity limits per second, effort limits in N m or N',
        ('joint', 'part', 'start', 'position', 'unit', 'velocity', 'effort', 'driven by'),
        lambda r: (r['name'], r['part'], number(r['start']), span(r['position']), r['unit'],
                   number(r['velocity']), span(r['effort']), _driver(r))),
    'actuators': (
        'Actuators, as the files have them',
        ('actuator', 'part', 'type', 'drives', 'control', 'force'),
        lambda r: (r['name'], r['part'], r['type'], f'{r["drives"]} {r["target"]}',
                   span(r['control']), span(r['force']))),
    'sensors': (
        'Sensors', ('sensor', 'type', 'of', 'length'),
        lambda r: (r['name'], r['type'], r['of'] or '-', str(r['length']))),
    'frames': (
        'Frames, at the start in world',
        ('frame', 'kind', 'parent', 'mass kg', 'x m', 'y m', 'z m'),
        lambda r: (r['name'], r['kind'], r['parent'], number(r['mass_kg']),
                   *(f'{round(value, 3) + 0.0:.3f}' for value in r['position_m']))),
    'cameras': (
        'Cameras', ('camera', 'body', 'field of view rad', 'resolution'),
        lambda r: (r['name'], r['body'], number(r['fovy_rad']),
                   'x'.join(map(str, r['resolution'])) if r['resolution'] else '-')),
    'objects': ('Objects', ('object', 'mass kg'), lambda r: (r['name'], number(r['mass_kg']))),
    'topics': (
        'Topics of the node', ('topic', 'type', 'node', 'meaning'),
        lambda r: (r['name'], r['type'], {'published': 'publishes'}.get(
            r['direction'], 'subscribes'), r['meaning'])),
    'services': ('Services of the node', ('service', 'type', 'meaning'),
                 lambda r: (r['name'], r['type'], r['meaning'])),
    'actions': (
        'Actions of the node, where control_msgs is installed', ('action', 'type', 'meaning'),
        lambda r: (r['name'], r['type'], r['meaning'])),
    'parameters': (
        'Parameters of the node', ('parameter', 'value', 'unit', 'live', 'meaning'),
        lambda r: (r['name'], _value(r['value']), r['unit'] or '-', 'yes' if r['live'] else '-',
                   r['meaning'])),
}


def run(options: argparse.Namespace) -> tuple[str, int]:
    composed = compose_from(options)
    if options.yaml:
        return _as_yaml(composed), 0
    description = describe(composed)
    if options.json:
        return json.dumps(description, indent=2, allow_nan=False), 0
    width = terminal_width()
    tables = [table(title, header, [cells(row) for row in description[section]], width)
              for section, (title, header, cells) in _COLUMNS.items()]
    return '\n\n'.join([_summary(description), *filter(None, tables)]), 0


def _as_yaml(composed: Composed) -> str:
    """Return the parts inferred from the robot's file, as the YAML file that describes it."""
    robots = composed.composition.world.robots
    # Of robots, those from files alone have a description.
    if len(robots) != 1 or not hasattr(robots[0], 'described'):
        raise ModelError('describe --yaml is for one robot from a file, such as --robot arm.xml; '
                         'robots of the catalogue are described in assets/robots')
    robot: Any = robots[0]
    lines = [f'# Save this as {robot.file.stem}.yaml beside {robot.file.name}, and edit what was '
             'inferred wrongly:', *(f'# - {sentence}' for sentence in robot.inferred)]
    return '\n'.join([*lines, yaml.safe_dump(
        robot.described, sort_keys=False, default_flow_style=None, width=100)]).rstrip('\n')


def _summary(description: Row) -> str:
    lines = [f'{description["name"]} in arena {description["arena"]}, '
             f'{description["mass_kg"]:.4g} kg, {pluralize(len(description["joints"]), "joint")}, '
             f'{pluralize(len(description["actuators"]), "actuator")}']
    defects = description['start_defects']
    if defects:
        lines.append(f"The start has {pluralize(len(defects), 'defect')}, see 'manip_sim check'")
    return '\n'.join(lines)


def _kind(model: Row) -> str:
    robot = f'{model["robot"]}: ' if model['robot'] else ''
    return f'{robot}{model["kind"]}{" (" + model["arm"] + ")" if model["arm"] else ""}'


def _driver(joint: Row) -> str:
    if joint['driven_by']:
        return ', '.join(joint['driven_by'])
    return 'a coupling' if joint['coupled'] else 'nothing'


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f'[{", ".join(map(str, value))}]'
    return str(value) if value != '' else "''"
