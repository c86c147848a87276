# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim check``: the defects of a start, and their remedies."""

from __future__ import annotations

import argparse

from pathlib import Path

import mujoco
import numpy as np

from manip_sim.cli.composing_options import compose_from
from manip_sim.cli.states_check import differences, states_on
from manip_sim.errors import ModelError
from manip_sim.models import World
from manip_sim.models.files.urdf import is_urdf
from manip_sim.models.loading import compile_spec, load_spec
from manip_sim.models.missing_meshes import lost_shapes
from manip_sim.quoting import counted
from manip_sim.simulation import Simulation
from manip_sim.simulation.episode_start import start_without_control
from manip_sim.simulation.start_check import find_start_defects
from manip_sim.simulation.start_defect import StartDefect

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
        found, remarks = _defects_of(world)
        defects = [*found, *(StartDefect(
            'meshes', sentence, 'see there, or accept it by meshes: none in the YAML file of the '
            'model') for sentence in lost_shapes(world))]
        if options.against is not None:
            wrong, others = differences(world, options.against, *states_on(options.against))
            defects, remarks = [*defects, *wrong], [*remarks, *others]
        prefixes = list(_prefixes(world))
        note = (f'Names in the files lack the prefix{"es" if len(prefixes) > 1 else ""} '
                f'{", ".join(prefixes)}.' if prefixes else '')
    notes = [f'note: {sentence}' for sentence in remarks]
    if not defects:
        return '\n'.join([f'{name}: nothing is wrong with the start', *notes]), 0
    lines = [f'{name}: {counted(len(defects), "defect")}',
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
    roots = _robots(model)
    if not roots:
        raise ModelError(f'{file} has no body with joints, so no robot to check')
    return find_start_defects(model, data, roots), notes


def _robots(model: mujoco.MjModel) -> list[int]:
    """Return the root bodies of trees with joints other than free ones, so not of objects."""
    jointed = model.jnt_bodyid[np.flatnonzero(model.jnt_type != _FREE)]
    # By their ids, since they may have no names.
    return [int(root) for root in np.unique(model.body_rootid[jointed])]
