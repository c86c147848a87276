# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim identify``: friction and rotor inertia of an arm from recorded joint states."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
import json
import math
from pathlib import Path
from typing import Any

from manip_sim.cli.composing_options import compose_from
from manip_sim.cli.output import (
    check_folder, number, ProgressBar, table, terminal_width, write_whole)
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.identification.least_squares import identify, Identification, RigidModel
from manip_sim.identification.recorded_motion import (
    find_excitation, read_motion, record_excitation, RecordedMotion)
from manip_sim.models.robots import ManipulatorModel
from manip_sim.models.robots.robot_model import SUBSYSTEMS
from manip_sim.quoting import pluralize, quoted_names
from manip_sim.simulation import Simulation

#: The values that are written, by the parameter and its key.
_WRITTEN = {'coulomb': 'frictionloss', 'viscous': 'damping'}
#: Less of the efforts explained at the end of a record is worth a line.
_WELL = 0.9


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Identify, or record an excitation; return the report, and 1 if nothing can be told."""
    if options.out is not None:
        check_folder(options.out)
    composed = compose_from(options)
    simulation = Simulation(composed.composition.world)
    if len(simulation.robots) != 1:
        raise ModelError('identify is for one robot, and these are '
                         f'{quoted_names(list(simulation.robots))}')
    robot = simulation.robot
    parts = [name for name in SUBSYSTEMS if name in robot.parts and robot.parts[name].joints]
    if options.part not in parts:
        raise UnknownNameError(f'part of {robot.name}', options.part, parts)
    if options.excite is not None:
        excitation = find_excitation(simulation, options.part, options.duration, options.seed)
        with ProgressBar('states') as progress:
            states = record_excitation(simulation, excitation, options.part, options.excite,
                                       progress.show)
        return (f'{options.excite} ({pluralize(states, "state")} in {excitation.duration_s:g} s)',
                0)
    joints = robot.parts[options.part].joints
    motion = read_motion(
        options.bag, joints, [name for name in robot.joint_names if name not in joints],
        options.topic, _names(options, joints))
    flanges = robot.robot_model.eef_name if options.part == 'arm' and isinstance(
        robot.robot_model, ManipulatorModel) else {}
    if options.payload and not flanges:
        raise ModelError(f'--payload is for arms with a flange, which {options.part} has not')
    model = RigidModel(simulation.model, simulation.data.qpos, joints, flanges)
    with ProgressBar('states') as progress:
        identification = identify(motion, model, options.cutoff, options.payload, progress.show)
    if options.out is not None:
        write_whole(options.out, lambda file: _write(
            file, options, identification, composed.parameters.given))
    observable = any(value.value is not None for joint in identification.joints
                     for value in joint.values.values())
    if options.json:
        return json.dumps({
            **asdict(identification), 'suffices_s': identification.suffices_s,
            'topic': motion.topic, 'notes': _notes(options, motion, identification)}, indent=2
            ).replace('NaN', 'null'), int(not observable)
    return _report(options, motion, identification), int(not observable)


def _names(options: argparse.Namespace, joints: tuple[str, ...]) -> dict[str, str]:
    """Return the names in the bag by the names of the robot, where --names gives them."""
    if options.names is None:
        return {}
    names = options.names.split(',')
    if len(names) != len(joints):
        raise ModelError(f'--names has {pluralize(len(names), "name")}, and {options.part} has '
                         f'{pluralize(len(joints), "joint")}: {quoted_names(joints)}')
    return dict(zip(joints, names))


def _write(file: Path, options: argparse.Namespace, identification: Identification,
           composition: Mapping[str, Any]) -> None:
    """Write the composition with the identified values, as a parameter file."""
    import yaml
    # The value of the model where nothing is told, and nothing negative.
    values = {key: [float(f'{value.before if value.value is None else max(value.value, 0.0):.6g}')
                    for value in (joint.values[kind] for joint in identification.joints)]
              for key, kind in (*_WRITTEN.items(), ('armature', 'armature'))}
    armature = values.pop('armature')
    parameters: dict[str, Any] = {
        'robot': 'Panda', **composition,
        f'friction.{options.part}': yaml.safe_dump(values, default_flow_style=True, width=math.inf
                                                   ).strip(),
        f'armature.{options.part}': str(armature)}
    file.write_text(f'# By manip_sim identify {options.bag}\n' + yaml.safe_dump(
        {'/**': {'ros__parameters': parameters}}, sort_keys=False, width=math.inf))


def _report(options: argparse.Namespace, motion: RecordedMotion, identification: Identification
            ) -> str:
    width = terminal_width()
    values = [(joint.name, *(text for kind in joint.values for text in (
        number(joint.values[kind].value), '-' if joint.values[kind].value is None
        else f'{joint.values[kind].error:.2g}'))) for joint in identification.joints]
    title = (f'{options.bag}, {motion.topic}: {identification.fitted_s:.1f} s fitted, '
             f'{identification.held_out_s:.1f} s held out')
    texts = [table(title, ('joint', 'armature', '+-', 'damping', '+-', 'frictionloss', '+-',
                           'offset', '+-'), values, width),
             table('Effort that is left (rms)', (
                 'joint', 'fitted', 'held out', "with the model's values", 'explained [%]'),
                 [(joint.name, *('-' if math.isnan(value) else f'{value:.3g}' for value in (
                     joint.rms, joint.held_out, joint.held_out_before)),
                   '-' if math.isnan(joint.explained) else f'{100.0 * joint.explained:.2f}')
                  for joint in identification.joints], width)]
    for load in identification.payloads:
        center = ', '.join('-' if axis.value is None else f'{axis.value:.3f} +- {axis.error:.2g}'
                           for axis in load.center)
        texts.append(f'payload of {load.arm}: {load.mass.value:.3f} +- {load.mass.error:.2g} kg, '
                     f'center of mass in the frame of the flange {center} m')
    if options.out is not None:
        texts.append(str(options.out))
    return '\n'.join([*texts, *_notes(options, motion, identification)])


def _notes(options: argparse.Namespace, motion: RecordedMotion, identification: Identification
           ) -> list[str]:
    """Return what a user should know, a sentence each."""
    unobserved: dict[tuple[str, str], list[str]] = {}
    for joint in identification.joints:
        for kind, value in joint.values.items():
            if value.value is None:
                unobserved.setdefault((joint.name, value.reason), []).append(kind)
    notes = [f'not observable: {", ".join(kinds)} of {name}: {reason}'
             for (name, reason), kinds in unobserved.items()]
    notes += [f'{kind} of {joint.name} is negative: the model, or the sign of the efforts, does '
              'not fit; the file has 0' for joint in identification.joints
              for kind, value in joint.values.items() if kind != 'offset'
              and value.value is not None
              and value.value < -max(3.0 * value.error, value.tolerance)]
    notes += [f'{joint.name}: only {100.0 * joint.explained:.0f} % of the efforts are explained: '
              'the robot, its gripper, its load or the unit of the efforts is another one'
              for joint in identification.joints if joint.explained < _WELL]
    notes += [f'the efforts fit a payload of {load.mass.value:.2f} +- {load.mass.error:.1g} kg '
              f'more at the flange of {load.arm}: choose the --gripper, or add --payload'
              for load in identification.hints]
    notes += _length(identification)
    if motion.missing:
        notes.append('not in the bag, and taken at the start pose: '
                     + quoted_names(motion.missing))
    if len(motion.stretches) > 1:
        notes.append(f'{len(motion.stretches)} stretches between gaps, of '
                     f'{motion.duration_s:.1f} s')
    notes.append(f'the efforts are {1e3 * abs(identification.lag_s):.1f} ms '
                 f'{"behind" if identification.lag_s >= 0.0 else "ahead of"} the positions, which '
                 'was taken into account')
    return [*motion.notes, *notes]


def _length(identification: Identification) -> list[str]:
    """Return whether a longer record would tell more, as far as its own scatter says."""
    short = [(value.more, f'{kind} of {joint.name}', value) for joint in identification.joints
             for kind, value in joint.values.items() if value.more > 1.0]
    if not short:
        return []
    _, name, value = max(short, key=lambda entry: entry[0])
    others = (f', and {pluralize(len(short) - 1, "other value")} by more than 5 %'
              if len(short) > 1 else '')
    return [f'the record is short: {name} can be wrong by {value.within:.2g} (at 95 %){others}; '
            f'{math.ceil(identification.suffices_s / 10.0) * 10} s of this motion would suffice']
