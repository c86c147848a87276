# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Compose the world that the parameters describe: one robot, or several by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
import re
from typing import Any, TYPE_CHECKING

import mujoco
import yaml

from manip_sim.control.modes import MODES
from manip_sim.errors import ModelError, ParameterError
from manip_sim.interface.parameter_spec import ParameterSource
from manip_sim.interface.parameters import (
    actuation_parameters, arena_specs, camera_parameters, composition_parameters,
    keyframe_parameter, MODEL_PATH, node_parameters, periods_per_image, place_parameters,
    steps_per_period)
from manip_sim.interface.part_parameters import (
    cartesian_parameters, commanded_parts, integral_parameters, law_parameters, mode_parameters,
    payload_parameters, reflex_parameters, sensing_parameters, speed_parameter, stream_parameters,
    timeout_parameters, wrench_parameters)
from manip_sim.interface.topics import Scope
from manip_sim.models import (
    Arena, arena_parameters, compose_robot, create_arena, set_model_path, World)
from manip_sim.models.cameras import (
    chosen_cameras, described_cameras, described_lidars, ImageSettings)
from manip_sim.models.robots.robot_model import RobotModel, SUBSYSTEMS
from manip_sim.models.user_files import AllowedRoots, parse_yaml, read_yaml
from manip_sim.models.world import keyframe_names
from manip_sim.physics.parts import Part
from manip_sim.quoting import quoted
from manip_sim.resources import share_directory

if TYPE_CHECKING:
    from manip_sim.tasks import Task

#: Robots that the user does not place stand side by side [m].
_SPACING_M = 1.0
#: Parameters that name a YAML file, or hold its content in braces.
CONTENTS = ('faults', 'randomization')
#: Name of a robot: a namespace, parameters and names of joints may begin with it.
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*')
#: Names that no robot may have: of the node's namespace and of its parameters.
_RESERVED = ('arena', 'armature', 'camera', 'command_timeout', 'control_mode', 'friction',
             'latency', 'law', 'noise', 'objects', 'qos_overrides', 'resolution', 'sensors',
             'stream_hold', 'stream_interval', 'timeout_follows_mode', 'torque_speed', 'truth')


@dataclass(frozen=True)
class Composition:
    """
    A world and what the node needs to serve it.

    :ivar scopes: where topics and parameters of each robot are, in the order of the world's robots
    :ivar world: the world
    :ivar steps: physics steps of a control period
    :ivar task: the task, or None
    :ivar cameras: settings of the images of the chosen cameras, by name, once they are declared
    """

    scopes: list[Scope]
    world: World
    steps: int
    task: Task | None = None
    cameras: Mapping[str, ImageSettings] = field(default_factory=dict)


def compose_world(parameters: ParameterSource) -> Composition:
    """
    Declare the parameters of the composition, and compose the world that they describe.

    Parameters of the parts of the robots are left to :func:`declare_parts`.

    :raises ManipSimError: if a parameter cannot be used, or the models do not fit together
    """
    value = parameters.value
    declare_node(parameters)
    steps = steps_per_period(value('publish_rate'), value('timestep'))
    if value('task'):
        return _compose_task(parameters, steps)
    scopes = [Scope(name) for name in _robot_names(value('robots'))] or [Scope()]
    robots = []
    for scope in scopes:
        parameters.declare(composition_parameters(scope))
        robot, gripper, base, prefix, tactile = (value(scope.parameter(name)) for name in (
            'robot', 'gripper', 'base', 'prefix', 'tactile'))
        robots.append(compose_robot(robot, gripper, base, prefix=prefix, tactile=tactile,
                                    idn=value('idn') if not scope.name else scope.name))
        _set_actuation(parameters, scope, robots[-1])
    arena = compose_arena(parameters)
    for scope, robot, position in zip(scopes, robots, _side_by_side(arena, robots)):
        parameters.declare(place_parameters(scope, position))
        place = value(scope.parameter('position'))
        robot.set_base_xpos(place, may_be_raised=list(place) == list(position))
        if any(value(scope.parameter('orientation'))):
            robot.set_base_ori(value(scope.parameter('orientation')))
    parameters.declare([keyframe_parameter(keyframe_names(
        part for robot in robots for part in (robot, *robot.models))
        + keyframe_names([arena]))])
    world = World(robots, arena, objects=_objects(value('objects')), keyframe=value('keyframe'),
                  **_settings(value))
    _check_rates(world, value('publish_rate'))
    return Composition(scopes, world, steps)


def _compose_task(parameters: ParameterSource, steps: int) -> Composition:
    """Compose the world of a task for the robot that the parameters describe."""
    from manip_sim.tasks import create_task  # It takes a while, and most nodes have none.
    value, node = parameters.value, {spec.name: spec.default for spec in node_parameters()}
    for name in ('robots', 'arena', 'cube', 'objects'):
        setting = value(name)
        if (list(setting) if isinstance(node[name], list) else setting) != node[name]:
            raise ParameterError(f"parameter '{name}' cannot be combined with 'task', which "
                                 'brings arena, robots and objects')
    # A task brings its starts.
    parameters.declare([keyframe_parameter(())])
    parameters.declare(composition_parameters(Scope()))
    # A task with two robots names them itself.
    chosen = {name: value(name) for name in ('idn', 'prefix', 'tactile') if value(name)}
    task = create_task(value('task'), value('robot'), value('gripper'), base=value('base'),
                       **_settings(value), **chosen)
    _check_rates(task.world, value('publish_rate'))
    robots = task.world.robots
    scopes = [Scope(robot.name_in_world) for robot in robots] if len(robots) > 1 else [Scope()]
    return Composition(scopes, task.world, steps, task)


def _settings(value: Callable[[str], Any]) -> dict[str, Any]:
    """Return what parameters set of any world; what they do not set is left to the world."""
    noise = {key: value(f'initialization_noise.{key}') for key in ('type', 'magnitude')}
    chosen = {'lidars': described_lidars(value('lidars')),
              'initialization_noise': noise if noise['magnitude'] else None,
              **{name: _content(value(name), name) for name in CONTENTS}}
    return {'timestep_s': value('timestep'), 'gravity_compensation': value('gravity_compensation'),
            'seed': value('seed'), 'cameras': described_cameras(value('cameras')),
            **{name: setting for name, setting in chosen.items() if setting}}


def _content(text: str, name: str) -> str | dict[str, Any]:
    """Return the name of a YAML file as it is, and of a content in braces what it holds."""
    return parse_yaml(text, f"parameter '{name}'") if text.lstrip().startswith('{') else text


def with_contents(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return parameters with the contents of YAML files in place of their names.

    :param values: by name
    :raises ModelError: if such a file cannot be read
    """
    contents = {name: values[name] for name in CONTENTS if values.get(name)}
    return {**values, **{
        name: yaml.safe_dump(read_yaml(text), default_flow_style=True, width=math.inf)
        for name, text in contents.items() if not text.lstrip().startswith('{')}}


def _check_rates(world: World, publish_rate: float) -> None:
    for lidar in world.lidars:
        periods_per_image(publish_rate, lidar.rate_hz, f'lidars: {lidar.name}')


def _set_actuation(parameters: ParameterSource, scope: Scope, robot: RobotModel) -> None:
    """Declare the parameters of the actuation of a robot, and do what they say."""
    subsystems = [name for name in SUBSYSTEMS if robot.actuators_of(name)]
    parameters.declare(actuation_parameters(scope, subsystems))
    for subsystem in subsystems:
        chosen: dict[str, Any] = {}
        for kind, default in (('friction', 'none'), ('torque_speed', 'none'),
                              ('armature', 'model')):
            name = scope.parameter(f'{kind}.{subsystem}')
            text = parameters.value(name)
            if text == default:
                continue
            if kind == 'armature':
                text = f'{{armature: {text}}}'
            chosen[kind] = parse_yaml(text, f"parameter '{name}'") if '{' in text else text
        if 'armature' in chosen:
            chosen['armature'] = chosen['armature'].get('armature')
        if chosen:
            robot.set_actuation(subsystem, **chosen)


def declare_node(parameters: ParameterSource) -> None:
    """
    Declare the parameters of every node, and let the folders of the user join the catalogue.

    :raises ManipSimError: if a value cannot be used
    """
    parameters.declare([MODEL_PATH])
    set_model_path(folder for folder in parameters.value(MODEL_PATH.name) if folder)
    parameters.declare(node_parameters())


def declare_parts(parameters: ParameterSource,
                  served: Iterable[tuple[Scope, Mapping[str, Part]]]) -> None:
    """
    Declare the parameters that depend on the parts of each robot.

    :raises ParameterError: if a value cannot be used
    """
    for scope, parts in served:
        commanded = commanded_parts(parts)
        parameters.declare(mode_parameters(scope, commanded))
        parameters.couple(scope, parts)
        modes = {part: parameters.value(scope.parameter(f'control_mode.{part}'))
                 for part in commanded}
        for part in commanded:
            law = MODES[modes[part]].law
            if law is not None and parts[part].atomic == (part,):
                parameters.declare(law_parameters(scope, part, law))
        parameters.declare(timeout_parameters(scope, commanded, modes.__getitem__))
        parameters.declare(stream_parameters(scope, commanded))
        arms = [arm for arm in commanded if f'{arm}/gripper' in parts]
        parameters.declare(cartesian_parameters(scope, arms))
        # A gripper alone has a wrench, and no arm that is commanded.
        mounts = [name.removesuffix('/gripper') for name in parts if name.endswith('/gripper')]
        parameters.declare([*wrench_parameters(scope, mounts), *payload_parameters(scope, mounts),
                            *integral_parameters(scope, commanded)])
        parameters.declare(reflex_parameters(scope, commanded, arms))
        parameters.declare([*sensing_parameters(scope), speed_parameter(scope)])
        parameters.couple(scope, parts)


def declare_cameras(parameters: ParameterSource, world: World, model: mujoco.MjModel
                    ) -> dict[str, ImageSettings]:
    """
    Declare the parameters of the cameras that are chosen, and return what they say, by camera.

    :param world: the world
    :param model: its ``mujoco.MjModel``
    :raises ManipSimError: if a camera cannot be chosen, or a value cannot be used
    """
    chosen = chosen_cameras(parameters.value('cameras'), world.cameras, model)
    for name, images in chosen.items():
        parameters.declare(camera_parameters(name, images))
        width, height, rate_hz, depth = (
            parameters.value(f'camera.{name}.{key}') for key in (
                'width', 'height', 'rate', 'depth'))
        chosen[name] = ImageSettings(width, height, rate_hz, depth)
        periods_per_image(parameters.value('publish_rate'), rate_hz, f'camera.{name}.rate')
    return chosen


def compose_arena(parameters: ParameterSource) -> Arena:
    """
    Declare the parameters of the arena that is requested, and return it.

    :param parameters: after :func:`declare_node`
    :raises ManipSimError: if a value cannot be used
    """
    name = parameters.value('arena')
    specs = arena_specs(name)
    parameters.declare(specs)
    options = {spec.name.partition('.')[2]: parameters.value(spec.name) for spec in specs}
    if 'cube' in {parameter.name for parameter in arena_parameters(name)}:
        options['cube'] = parameters.value('cube')
    return create_arena(name, **options)


def spawn_files(folders: Sequence[str]) -> AllowedRoots:
    """
    Return the files that a request to spawn may name.

    :param folders: of the parameter ``spawn_roots``
    :raises ModelError: if one is not a folder
    """
    # An empty list of strings is a list with an empty string in ROS.
    return AllowedRoots([folder for folder in folders if folder] or [share_directory() / 'assets'],
                        'spawn_roots')


def _objects(texts: Sequence[str]) -> list[Any]:
    """Return descriptions of objects; what begins with a brace is one in YAML."""
    return [parse_yaml(text, "parameter 'objects'") if text.lstrip().startswith('{') else text
            for text in texts if text]


def _robot_names(texts: Sequence[str]) -> list[str]:
    # An empty list of strings is a list with an empty string in ROS.
    names = [name for name in texts if name]
    for name in names:
        try:
            check_robot_name(name)
        except ModelError as error:
            raise ParameterError(f"parameter 'robots': {error}") from error
    if len(set(names)) != len(names):
        raise ParameterError("parameter 'robots': the names must differ, got " + ', '.join(names))
    return names


def check_robot_name(name: str) -> None:
    """
    Reject what cannot be the namespace of a robot, and the beginning of its names.

    :raises ModelError: saying what it has to be
    """
    if not _NAME.fullmatch(name) or len(name) > 60 or name in _RESERVED:
        raise ModelError(
            f'{quoted(name)} cannot be the name of a robot: it needs a letter, then letters, '
            'digits and single underscores, and must not be one of ' + ', '.join(_RESERVED))


def _side_by_side(arena: Arena, robots: Sequence[RobotModel]) -> list[list[float]]:
    """Return where each robot stands: at the arena's place, several in a row along y [m]."""
    middle = (len(robots) - 1) / 2.0
    return [(arena.robot_position(robot) + [0.0, (middle - i) * _SPACING_M, 0.0]).tolist()
            for i, robot in enumerate(robots)]
