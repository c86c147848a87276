# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim check``: the defects of a start, and their remedies."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, pairwise
from pathlib import Path

import mujoco
import numpy as np

from manip_sim.cli.composing_options import compose_from
from manip_sim.errors import ManipSimError, ModelError
from manip_sim.models import World
from manip_sim.models.actuators import SCALAR
from manip_sim.models.files.urdf import is_urdf
from manip_sim.models.loading import compile_spec, load_spec
from manip_sim.models.world import skipped_geoms
from manip_sim.quoting import pluralize, quoted, quoted_names
from manip_sim.ros_environment import missing_module
from manip_sim.simulation import Simulation
from manip_sim.simulation.episode_start import start_without_control
from manip_sim.simulation.start_defect import find_start_defects, StartDefect

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def run(options: argparse.Namespace) -> tuple[str, int]:
    if options.file is not None and is_urdf(options.file):  # It has no actuators by itself.
        options.robot, options.file = str(options.file), None
    if options.file is not None:
        name, note = str(options.file), ''
        defects, remarks = _defects_of_file(options.file)
    else:
        world = compose_from(options).composition.world
        name = f'{world.name} in arena {world.arena.arena_name}'
        defects_of_world, remarks = _defects_of(world)
        defects = [*defects_of_world, *(StartDefect(
            'meshes', sentence, 'see there, or accept it by meshes: none in the YAML file of the '
            'model') for sentence in skipped_geoms(world))]
        if options.against is not None:
            wrong, others = differences(world, options.against, *states_on(options.against))
            defects, remarks = [*defects, *wrong], [*remarks, *others]
        prefixes = list(_prefixes(world))
        note = (f'Names in the files lack the prefix{"es" if len(prefixes) > 1 else ""} '
                f'{", ".join(prefixes)}.' if prefixes else '')
    notes = [f'note: {sentence}' for sentence in remarks]
    if not defects:
        return '\n'.join([f'{name}: nothing is wrong with the start', *notes]), 0
    lines = [f'{name}: {pluralize(len(defects), "defect")}',
             *(f'- {defect.text}\n  fix: {defect.remedy}' for defect in defects), *notes]
    return '\n'.join([*lines, note] if note else lines), 1


def _defects_of(world: World) -> tuple[list[StartDefect], list[str]]:
    """Return the defects of a world, and which gains of its servos were lowered."""
    roots = [robot.root_body for robot in world.robots]
    urdf = tuple(prefix for prefix, is_of_urdf in _prefixes(world).items() if is_of_urdf)
    try:
        simulation = Simulation(world)
    except ModelError as error:
        # It cannot be controlled; the defects of its start may explain why.
        model = world.compile()
        data = start_without_control(model, world.init_qpos())
        return [StartDefect('control', f'this cannot be simulated: {error}',
                            'change the model as the message says'),
                *find_start_defects(model, data, roots, urdf)], []
    return (find_start_defects(simulation.model, simulation.data, roots, urdf),
            simulation.lowered_gains)


def _prefixes(world: World) -> dict[str, bool]:
    """Return the prefixes of the parts of robots, and whether the first part of each is URDF."""
    prefixes: dict[str, bool] = {}
    for robot in world.robots:
        for part in (robot, *robot.models):
            if part.naming_prefix:
                prefixes.setdefault(part.naming_prefix, is_urdf(part.file))
    return prefixes


def _defects_of_file(file: Path) -> tuple[list[StartDefect], list[str]]:
    """Return the defects of a whole model, and notes on parts that are left out."""
    notes: list[str] = []
    spec = load_spec(file, notes)
    model = compile_spec(spec, str(file))
    data = mujoco.MjData(model)
    if model.nkey:
        home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, 'home')
        mujoco.mj_resetDataKeyframe(model, data, max(home, 0))
    mujoco.mj_forward(model, data)
    # Trees with joints other than free ones, so no objects; by ids, as they may have no names.
    jointed = model.jnt_bodyid[np.flatnonzero(model.jnt_type != _FREE)]
    roots = np.unique(model.body_rootid[jointed]).tolist()
    if not roots:
        raise ModelError(f'{file} has no body with joints, so no robot to check')
    return find_start_defects(model, data, roots), notes


#: A position is beyond its range if it exceeds it by more than this [rad or m], as noise does.
_TOLERANCE = 0.01


def differences(world: World, topic: str, names: Sequence[str], positions: Sequence[float]
                ) -> tuple[list[StartDefect], list[str]]:
    """Return defects and remarks of joint states [rad or m] for the robots of a world."""
    model, ranges = world.compile(), {}  # By name in the order of their states.
    for name in (name for robot in world.robots for part in (robot, *robot.models)
                 for name in part.joints):
        joint = model.joint(name)
        if int(joint.type[0]) in SCALAR:
            limited = bool(model.jnt_limited[joint.id])
            ranges[name] = tuple(joint.range.tolist()) if limited else (-np.inf, np.inf)
    common = [name for name in names if name in ranges]
    places = {name: place for place, name in enumerate(ranges)}
    return list(_defects(topic, names, positions, ranges)), [
        f'{topic} has {quoted(first)} before {quoted(second)}, this robot after it: a client that '
        'takes positions by their place instead of their names swaps joints'
        for first, second in pairwise(common) if places[first] > places[second]][:1]


def _defects(topic: str, names: Sequence[str], positions: Sequence[float],
             ranges: Mapping[str, tuple[float, float]]) -> Iterator[StartDefect]:
    unknown = [name for name in dict.fromkeys(names) if name not in ranges]
    missing = [name for name in ranges if name not in names]
    twice = [name for name in dict.fromkeys(names) if list(names).count(name) > 1]
    for joints, text, remedy in (
            (unknown, 'has joints that this robot does not have', 'choose the robot or its prefix '
             f'so that its joints have these names: it has {quoted_names(list(ranges), 8)}'),
            (missing, 'lacks joints of this robot', 'let their source publish them, or choose '
             'another robot, gripper or base'),
            (twice, 'names joints twice', 'let one source publish each joint')):
        if joints:
            yield StartDefect('states', f'{topic} {text}: {quoted_names(joints, 8)}', remedy)
    if len(positions) != len(names):
        yield StartDefect('states', f'{topic} has {len(names)} names and {len(positions)} '
                          'positions', 'let its source publish a position for each joint')
        return
    values = {name: value for name, value in zip(names, positions) if name in ranges}
    beyond = [name for name, value in values.items() if not _within(value, ranges[name])]
    swapped = {name: other for pair in combinations(beyond, 2) for name, other in (
        pair, pair[::-1]) if all(_within(values[a], ranges[b]) for a, b in (pair, pair[::-1]))}
    for name in beyond:
        low, high = ranges[name]
        hint = (f'; {quoted(swapped[name])} is beyond its own too, and each value would fit the '
                'other joint: they may be swapped' if name in swapped else '')
        yield StartDefect(
            'states', f'{topic}: {quoted(name)} is at {values[name]:.4g}, beyond its range from '
            f'{low:.4g} to {high:.4g}{hint}',
            'compare the order of names and positions in its source, its units and its zeros')


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] - _TOLERANCE <= value <= limits[1] + _TOLERANCE


def states_on(topic: str) -> tuple[list[str], list[float]]:
    """Return names and positions of the next message on a topic; raises as ``next_message``."""
    try:
        from manip_sim.cli.ros_commands import next_message
    except ImportError as error:
        raise ManipSimError(f'--against: {missing_module(error)}') from error
    message = next_message(topic, 'sensor_msgs/msg/JointState')
    return list(message.name), list(message.position)
