# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Load the models of Menagerie and robosuite unmodified, and print a table of what works.

    MENAGERIE_ROOT=~/mujoco_menagerie python3 benchmark/foreign_models.py
    python3 benchmark/foreign_models.py --robosuite FOLDER   # unpacked wheels, else as installed
    python3 benchmark/foreign_models.py panda ur5            # only names with one of these words
    python3 benchmark/foreign_models.py --folder FOLDER      # all robots in a folder of yours
    python3 benchmark/foreign_models.py --folder FOLDER      # with clones, FOLDER/OWNER/NAME

With ``--folder``, the MJCF, URDF and xacro files of whole robots anywhere in a folder are loaded
as they are; if it has clones of the repositories that ``foreign_models.yaml`` lists, at the
commits that it names, only the files that it lists. With ``--load``, it goes no further than to
load them. Percentages by class and the causes of failures follow the rows:

- inferred: whether the parts have the joints that the list says, which was written by hand; of
  other files nothing is known, so read the column parts.
- lost: how many sentences tell of collision shapes that were left out.
- holds: the start pose, for 5 s within 5 mrad or 5 mm; bare: whether the bare MJCF model does, or
  no if the torque limits of a URDF do not carry the robot.
- follows: each arm a sine as below, or as well as it does if bodies may pass through each other.
- grips: the fingers of each hand move by a third of their range, or until they touch something,
  when an action closes the hand, and back when one opens it.
- weak: which of these two fail where an actuator of the file has too little effort for a sine,
  against weight, friction and damping, or where the bare MJCF model follows as badly with the same
  controls. The percentages leave out these, and the robots that bare ones do not hold either.

Each row is one model in a process of its own:

- bare: whether MuJoCo compiles the file; bare_holds: whether it holds its start pose for 10 s
  there, within 5 mrad or 5 mm and without a fall, with the controls of the keyframe, or those
  that hold.
- loads: as a robot, or as a hand on a post.
- same: names and limits of joints, masses of bodies, and poses of bodies and sites in random
  configurations, are those of the original; missing bodies and sites are not compared.
- holds: the same start pose, on a floor.
- position, velocity: all joints of a part follow a sine of at most 0.1 rad at 0.5 Hz, with a
  residual below 15 % after the best delay up to 50 ms; floating bases are fixed for this, without
  gravity and floor; hands follow a sine of actions, 0.1 of the stroke to each side, with a
  residual below 30 %. "untouched" does so only if its bodies may pass through each other, and
  the servos of "as bare" follow as badly in the bare model, which is given the same controls.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator
import logging
import multiprocessing
import os
from pathlib import Path
import re
import sys
import tempfile
from typing import Any

import mujoco
import numpy as np
import yaml

from manip_sim.errors import DivergenceError, ManipSimError
from manip_sim.models import compose, load_gripper, load_robot
from manip_sim.models.actuators import declared_velocity, effort_range
from manip_sim.models.robots import ManipulatorModel
from manip_sim.simulation.simulation import Simulation

HOLD_S, HELD, FALLEN = 10.0, 5e-3, 0.1
AMPLITUDE, FREQUENCY_HZ, PERIOD_S = 0.1, 0.5, 0.01
FOLLOWED, MAX_DELAY_S = 0.15, 0.05
LIMIT_S = 600.0
_MARKS = {True: 'yes', False: 'no', None: '-'}
HAND = re.compile(r'(hand|gripper|2f85|dexee)')
NO_MODEL = re.compile(r'(scene|keyframe|_actuators)')
#: The element that names an included file, and the one that a whole model has, by its suffix.
INCLUDED = re.compile(r'include\s+file(?:name)?\s*=\s*["\']([^"\']+)')
WHOLE = {'.xml': re.compile(r'<mujoco\b.*<(?:joint|include|attach)\b', re.DOTALL),
         '.urdf': re.compile(r'<robot\b.*<joint\b', re.DOTALL),
         '.xacro': re.compile(r'<robot\b[^>]*\bname\s*=')}
POST = """<mujoco model="post"><default><geom contype="0" conaffinity="0"/></default>
  <worldbody><body name="base" pos="0 0 1"><geom size="0.02"/>
  <body name="link" pos="0 0 0.05"><joint name="turn" axis="0 0 1" armature="1" range="-3 3"
    limited="true"/><geom size="0.02"/><body name="right_hand" pos="0 0 0.05"/></body></body>
  </worldbody><actuator><position joint="turn" kp="5000" kv="140"/></actuator></mujoco>"""


def find_models(robosuite: Path | None) -> Iterator[tuple[str, str, Path]]:
    """Yield collection, ``robot`` or ``hand``, and file."""
    root = os.environ.get('MENAGERIE_ROOT')
    for file in sorted(Path(root).glob('*/*.xml')) if root else []:
        if not NO_MODEL.search(file.name):
            inside = file.stem + ('' if HAND.search(file.stem) else file.parent.name)
            is_hand = HAND.search(inside) and 'with_hand' not in inside and 'nohand' not in inside
            in_arm = re.search(r'(gripper_|_gripper)', file.stem) and 'umi' not in file.stem
            yield 'menagerie', 'hand' if is_hand and not in_arm else 'robot', file
    places = [robosuite] if robosuite else [Path(place) for place in sys.path]
    for place in places:
        for package in ('robosuite/models/assets', 'robosuite_models/assets'):
            for file in sorted((place / package / 'robots').glob('*/robot.xml')):
                yield 'robosuite', 'robot', file
            for file in sorted((place / package / 'grippers').glob('*.xml')):
                yield 'robosuite', 'hand', file


def bare_holds(file: Path) -> tuple[Any, bool]:
    """Return the model that MuJoCo makes of a file, and whether it holds its start pose."""
    spec = mujoco.MjSpec.from_file(str(file))
    model = spec.compile()
    names = [model.key(i).name for i in range(model.nkey)]
    key = next((names.index(n) for n in ('home', 'open') if n in names),
               0 if len(names) == 1 else None)
    if (model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any() and not (
            model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)).any():
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
        model = spec.compile()
    data = mujoco.MjData(model)
    if key is None:
        mujoco.mj_forward(model, data)
        for actuator in range(model.nu):
            bias, gain = model.actuator_biasprm[actuator], model.actuator_gainprm[actuator, 0]
            if bias[1] < 0.0 < gain:
                data.ctrl[actuator] = -(bias[0] + bias[1] * data.actuator_length[actuator]) / gain
    else:
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_forward(model, data)
    scalar = np.flatnonzero(model.jnt_type >= 2)
    addresses = model.jnt_qposadr[scalar]
    start, worst = data.qpos[addresses].copy(), 0.0
    height = data.subtree_com[0, 2]
    for _ in range(100):
        mujoco.mj_step(model, data, max(1, round(HOLD_S / 100 / model.opt.timestep)))
        worst = max(worst, float(np.abs(data.qpos[addresses] - start).max(initial=0.0)))
    falls = height - data.subtree_com[0, 2] > FALLEN
    return model, bool(np.isfinite(worst) and worst < HELD and not falls)


def differences(original: Any, model: Any, prefix: str, robot_root: str) -> list[str]:
    """Return how a composed model differs from the original, in words."""
    found = []
    joints = [original.joint(i).name for i in range(original.njnt)
              if original.joint(i).name and original.jnt_type[i] >= 2]
    ours = {model.joint(i).name for i in range(model.njnt)}
    missing = [name for name in joints if prefix + name not in ours]
    if missing:
        found.append(f'joints are gone: {missing[:3]}')
    joints = [name for name in joints if name not in missing]
    for name in joints:
        a, b = original.joint(name), model.joint(prefix + name)
        if a.limited[0] != b.limited[0] or not np.allclose(a.range, b.range, atol=1e-9):
            found.append(f'limits of {name}')
    bodies = [original.body(i).name for i in range(1, original.nbody) if original.body(i).name]
    names = {model.body(i).name for i in range(model.nbody)}
    bodies = [name for name in bodies if prefix + name in names]
    found += [f'mass of {name}' for name in bodies
              if not np.isclose(original.body(name).mass[0], model.body(prefix + name).mass[0])]
    sites = [original.site(i).name for i in range(original.nsite) if original.site(i).name]
    site_names = {model.site(i).name for i in range(model.nsite)}
    sites = [name for name in sites if prefix + name in site_names]
    random = np.random.default_rng(0)
    first = original.body(bodies[0]).name
    for _ in range(5):
        a, b = mujoco.MjData(original), mujoco.MjData(model)
        for name in joints:
            low, high = original.joint(name).range if original.joint(name).limited[0] else (-1, 1)
            value = random.uniform(low, high)
            a.joint(name).qpos[0] = b.joint(prefix + name).qpos[0] = value
        mujoco.mj_kinematics(original, a)
        mujoco.mj_kinematics(model, b)
        for kind, places in (('body', bodies), ('site', sites)):
            for name in places:
                pose, other = (_relative(getattr(d, kind)(p + name), d.body(p + first))
                               for d, p in ((a, ''), (b, prefix)))
                if not np.allclose(pose, other, atol=1e-6):
                    found.append(f'pose of {kind} {name}')
        if found:
            break
    return found


def _relative(place: Any, root: Any) -> Any:
    turn = root.xmat.reshape(3, 3).T
    return np.column_stack([turn @ (place.xpos - root.xpos), turn @ place.xmat.reshape(3, 3)])


def holds(simulation: Simulation, seconds: float = HOLD_S) -> tuple[bool, str]:
    """Return whether the start pose is held for some seconds, and which joint moves how far."""
    start, worst = simulation.robot.state().position, 0.0
    where = ''
    for _ in range(100):
        try:
            simulation.advance(round(seconds / 100 / simulation.timestep_s))
        except DivergenceError as error:
            return False, str(error)
        moved = np.abs(simulation.robot.state().position - start)
        if moved.max(initial=0.0) > worst:
            worst = float(moved.max())
            where = f'{simulation.robot.joint_names[int(moved.argmax())]} moves {worst:.3g}'
    return worst < HELD, where


def follows(simulation: Simulation, part: str, mode: str, original: Any) -> tuple[bool | str, str]:
    """
    Return whether the joints of a part follow a sine, and which one is worst.

    :param original: the bare model
    """
    names = [joint for joint in simulation.robot.parts[part].driven_joints if joint]
    residual, touches, _ = _sine(simulation, part, mode, names)
    why = f'{names[int(residual.argmax())]} {100 * residual.max():.0f} %'
    if residual.max() < FOLLOWED:
        return True, why
    contacts = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    simulation.model.opt.disableflags |= contacts
    free, _, controls = _sine(simulation, part, mode, names)
    simulation.model.opt.disableflags &= ~contacts
    if free.max() < FOLLOWED:
        return 'untouched', f'{why}, {touches}'
    bare = _bare_sine(simulation, original, names, mode, controls)
    failing = free >= FOLLOWED
    if (bare[failing] > 0.8 * free[failing]).all():
        return 'as bare', f'{why}, bare {100 * bare[int(free.argmax())]:.0f} %'
    return False, why


def _sine(simulation: Simulation, part: str, mode: str, names: list[str]
          ) -> tuple[Any, str, list[dict[str, float]]]:
    """Return the residuals of joints, which bodies of the robot met, and setpoints by joint."""
    simulation.reset()
    robot, model, data = simulation.robot, simulation.model, simulation.data
    index = [robot.joint_names.index(name) for name in names]
    start = robot.state().position[index]
    middle, swing = _room(model, names, start)
    robot.set_control_mode(part, 'position')
    run_to(simulation, part, names, start, middle)
    robot.set_control_mode(part, mode)
    reached, controls, touches = [], [], ''
    for goal in sine(mode, middle, swing):
        robot.apply(*robot.parse.joint_command(names, **{mode: goal}, part=part),
                    period_s=PERIOD_S)
        simulation.advance(round(PERIOD_S / simulation.timestep_s))
        reached.append(getattr(robot.state(), mode)[index])
        controls.append(_setpoints(model, data))
        if data.ncon and not touches:
            bodies = (model.body(model.geom_bodyid[geom]).name for geom in data.contact[0].geom)
            touches = ' touches '.join(bodies)
    robot.set_control_mode(part, 'position')
    goals = np.array(list(sine(mode, middle, swing)))
    return _residual(goals, np.array(reached), middle * (mode == 'position')), touches, controls


def _setpoints(model: Any, data: Any) -> dict[str, float]:
    """Return the setpoints of servos by the joints that they drive."""
    return {model.joint(model.actuator_trnid[i, 0]).name: data.act[model.actuator_actadr[i]]
            for i in range(model.nu)
            if model.actuator_actadr[i] >= 0
            and int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)}


def _bare_sine(simulation: Simulation, original: Any, names: list[str], mode: str,
               controls: list[dict[str, float]]) -> Any:
    """Return the residuals of joints of a bare model, 0 where it has no position servo, (n,)."""
    prefix = simulation.robot.robot_model.naming_prefix
    model, data = original, mujoco.MjData(original)
    _hang(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    servos = {prefix + model.joint(model.actuator_trnid[i, 0]).name: i for i in range(model.nu)
              if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)
              and model.actuator_biasprm[i, 1] < 0.0}
    start = simulation.robot.state().position[[simulation.robot.joint_names.index(name)
                                               for name in names]]
    middle, swing = _room(simulation.model, names, start)
    joints = [model.joint(name.removeprefix(prefix)) for name in names]
    for joint, place in zip(joints, middle):
        data.joint(joint.id).qpos[0] = place
    reached = []
    for setpoints in controls:
        for name, actuator in servos.items():
            if name in setpoints:
                data.ctrl[actuator] = setpoints[name]
        mujoco.mj_step(model, data, max(1, round(PERIOD_S / model.opt.timestep)))
        reached.append([data.qpos[j.qposadr[0]] if mode == 'position' else data.qvel[j.dofadr[0]]
                        for j in joints])
    residual = _residual(np.array(list(sine(mode, middle, swing))), np.array(reached),
                         middle * (mode == 'position'))
    return np.where([name in servos for name in names], residual, 0.0)


def sine(mode: str, middle: Any, swing: Any) -> Iterator[Any]:
    """Yield the goals of each period [rad, m, rad/s or m/s]."""
    for tick in range(round(2.0 / FREQUENCY_HZ / PERIOD_S)):
        phase = 2.0 * np.pi * FREQUENCY_HZ * tick * PERIOD_S
        yield (middle + swing * np.sin(phase) if mode == 'position'
               else swing * 2.0 * np.pi * FREQUENCY_HZ * np.cos(phase))


def run_to(simulation: Simulation, part: str, names: list[str], start: Any, goal: Any) -> None:
    """Move a part slowly."""
    for share in np.linspace(0.0, 1.0, 100):
        simulation.robot.apply(*simulation.robot.parse.joint_command(
            names, position=start + share * (goal - start), part=part), period_s=PERIOD_S)
        simulation.advance(round(PERIOD_S / simulation.timestep_s))


def _room(model: Any, names: list[str], start: Any) -> tuple[Any, Any]:
    """Return a middle and an amplitude that keep joints inside their ranges and velocities."""
    middle, swing = start.copy(), np.full(len(names), AMPLITUDE)
    for i, name in enumerate(names):
        joint = model.joint(name)
        if joint.type[0] == int(mujoco.mjtJoint.mjJNT_SLIDE):
            swing[i] = 0.02
        if joint.limited[0]:
            low, high = joint.range
            swing[i] = min(swing[i], 0.2 * (high - low))
            middle[i] = np.clip(middle[i], low + 1.2 * swing[i], high - 1.2 * swing[i])
    velocities = declared_velocity(model, [model.joint(name).id for name in names])
    return middle, np.minimum(swing, 0.8 * velocities / (2.0 * np.pi * FREQUENCY_HZ))


def _residual(goals: Any, reached: Any, middle: Any) -> Any:
    """Return how much of a sine is not followed, after the best delay, shape (n,)."""
    begin, found = round(0.5 / FREQUENCY_HZ / PERIOD_S), []
    for delay in range(round(MAX_DELAY_S / PERIOD_S) + 1):
        error = (reached[begin:] - goals[begin - delay:len(goals) - delay])
        found.append(np.sqrt((error**2).mean(axis=0))
                     / np.sqrt(((goals[begin:] - middle)**2).mean(axis=0)))
    return np.min(found, axis=0)


def hand_follows(simulation: Simulation, part: str, original: Any) -> tuple[bool | str, str]:
    """
    Return whether the servos of a hand follow a sine of actions, and which is worst.

    :param original: the bare model; where it follows the same controls no better, that is said
    """
    simulation.reset()
    controller = simulation.robot.grippers[part]
    actuators = controller._actuators
    if not len(actuators.ids) or not actuators.is_servo.any():
        return True, 'has no servos'
    low, high = actuators.ranges.T
    start = np.clip(2.0 * (actuators.place(simulation.data) - low) / (high - low) - 1.0, -1, 1)
    gripper: Any = controller.part.gripper
    share = (start - gripper._open) / (gripper._closed - gripper._open)
    middle = np.clip(2.0 * share - 1.0, -0.6, 0.6)
    goals, reached, controls = [], [], []
    for tick in range(round(3.0 / FREQUENCY_HZ / PERIOD_S)):
        ramp = min(1.0, tick * PERIOD_S)
        begin = 2.0 * share - 1.0
        action = begin + ramp * (middle - begin) + 0.2 * ramp * np.sin(
            2.0 * np.pi * FREQUENCY_HZ * tick * PERIOD_S)
        robot = simulation.robot
        robot.apply(robot.parse.action(part, np.clip(action, -1, 1)), period_s=PERIOD_S)
        simulation.advance(round(PERIOD_S / simulation.timestep_s))
        place = 2.0 * (actuators.place(simulation.data) - low) / (high - low) - 1.0
        controls.append(actuators.setpoints(simulation.data))
        goals.append(action)
        reached.append(2.0 * (place - gripper._open) / (gripper._closed - gripper._open) - 1.0)
    residual = np.where(actuators.is_servo, _of_actions(goals, reached), 0.0)
    worst = int(residual.argmax())
    why = f'{actuators.name(worst)} {100 * residual[worst]:.0f} %'
    if residual.max() < 2.0 * FOLLOWED:
        return True, why
    names = [actuators.name(i).removeprefix(gripper.naming_prefix)
             for i in range(len(actuators.ids))]
    bare = _bare_places(original, names, controls)
    bare_residual = _of_actions(goals, [
        2.0 * (2.0 * (place - low) / (high - low) - 1.0 - gripper._open)
        / (gripper._closed - gripper._open) - 1.0 for place in bare])
    failing = residual >= 2.0 * FOLLOWED
    as_bare = (bare_residual[failing] > 0.8 * residual[failing]).all()
    return 'as bare' if as_bare else False, f'{why}, bare {100 * bare_residual[worst]:.0f} %'


def _of_actions(goals: Any, reached: Any) -> Any:
    """Return the residual of a sine of actions, which are carried out evenly at 20 Hz."""
    begin, found = round(1.0 / FREQUENCY_HZ / PERIOD_S), []
    for delay in range(16):
        error = (np.array(reached)[begin:] - np.array(goals)[begin - delay:len(goals) - delay])
        found.append(np.sqrt((error**2).mean(axis=0)) / (0.2 / np.sqrt(2.0)))
    return np.min(found, axis=0)


def _bare_places(model: Any, names: list[str], controls: list[Any]) -> list[Any]:
    """Return the controls at which servos of a bare model rest, while it is given controls."""
    every = [model.actuator(i).name for i in range(model.nu)]
    ids = [every.index(name) if name in every else int(name.removeprefix('actuator'))
           for name in names]
    data, places = mujoco.MjData(model), []
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    for control in controls:
        data.ctrl[ids] = control
        mujoco.mj_step(model, data, max(1, round(PERIOD_S / model.opt.timestep)))
        bias = model.actuator_biasprm[ids]
        places.append(-(bias[:, 0] + bias[:, 1] * data.actuator_length[ids])
                      / model.actuator_gainprm[ids, 0])
    return places


def check(kind: str, file: Path) -> dict[str, Any]:
    """Return the row of a model."""
    row: dict[str, Any] = dict.fromkeys(
        ('bare', 'bare_holds', 'loads', 'same', 'holds', 'position', 'velocity'))
    row['reason'] = []
    try:
        original, row['bare_holds'] = bare_holds(file)
        row['bare'] = True
    except Exception as error:
        row['bare'] = False
        row['reason'].append(f'MuJoCo: {" ".join(str(error).split())[:90]}')
        return row
    try:
        simulation = _simulation(kind, file)
    except ManipSimError as error:
        row['loads'] = False
        row['reason'].append(str(error)[:160])
        return row
    row['loads'] = True
    robot = simulation.robot.robot_model
    prefix = robot.naming_prefix if kind == 'robot' else 'gripper0_right_'
    changed = differences(original, simulation.model, prefix, robot.root_body)
    row['same'] = not changed
    row['reason'] += changed[:3]
    row['arms'] = isinstance(robot, ManipulatorModel)
    row['holds'], why = holds(simulation)
    if not row['holds']:
        row['reason'] += [why, *(defect[:90] for defect in simulation.start_defects[:2])]
    if kind == 'hand':
        row['position'], why = hand_follows(simulation, 'right/gripper', original)
        if row['position'] is not True:
            row['reason'].append(why)
        return row
    if (simulation.model.jnt_type == 0).any():
        simulation = _simulation(kind, file, hangs=True)
    parts = [name for name, part in simulation.robot.parts.items() if '/' not in name
             and part.atomic == (name,) and part.actuators]
    for mode in ('position', 'velocity'):
        results = {part: follows(simulation, part, mode, original) for part in parts}
        row[mode] = worst_of(good for good, _ in results.values())
        row['reason'] += [f'{mode}: {why}' for good, why in results.values()
                          if good is not True]
    for part in simulation.robot.grippers:
        good, why = hand_follows(simulation, part, original)
        row['position'] = worst_of([row['position'], good])
        if good is not True:
            row['reason'].append(f'{part}: {why}')
    return row


def find_in_folder(folder: Path, words: list[str]
                   ) -> Iterator[tuple[str, str, dict[str, int] | None]]:
    """
    Yield repository, path (behind that of a xacro file its arguments) and joints by part.

    For the repositories of the list, ``ROS_PACKAGE_PATH`` names the packages of others that they
    need. Of other files the joints are None, and the repository is the uppermost folder.
    """
    listed = yaml.safe_load(Path(__file__).with_suffix('.yaml').read_text())
    if not folder.is_dir():
        raise SystemExit(f'no such folder: {folder}')
    missing = [repository for repository in listed if not (folder / repository).is_dir()]
    if len(missing) > len(listed) // 2:  # It is no folder with these clones.
        for path in find_robots(folder):
            if not words or any(word in str(path) for word in words):
                top = path.parts[0] if len(path.parts) > 1 else ''
                yield top, str(path.relative_to(top)), None
        return
    if missing:
        raise SystemExit(f'{folder / missing[0]} is missing')
    for repository, entry in listed.items():
        if words and not any(word in repository for word in words):
            continue
        os.environ['ROS_PACKAGE_PATH'] = os.pathsep.join(
            str(file.parent) for other in entry.get('packages', ())
            for file in sorted((folder / other).rglob('package.xml')))
        for path, parts in entry['files'].items():
            yield repository, path, parts


def find_robots(folder: Path) -> list[Path]:
    """Return the model files below a folder that have joints and that no other file includes."""
    texts = {file: file.read_text(errors='replace') for suffix in ('xml', 'urdf', 'xacro')
             for file in folder.rglob(f'*.{suffix}')
             if file.is_file() and not NO_MODEL.search(file.name)}
    included = {Path(name).name for text in texts.values() for name in INCLUDED.findall(text)}
    return sorted(file.relative_to(folder) for file, text in texts.items()
                  if WHOLE[file.suffix].search(text) and file.name not in included)


def check_as_found(name: str, moves: bool) -> dict[str, Any]:
    """
    Return whether a model loads and holds its start pose, its parts, and what is wrong.

    :param name: path, behind that of a xacro file its arguments
    :param moves: whether to simulate it, too
    """
    row: dict[str, Any] = {'reason': []}
    original = None
    if moves and class_of(name) == 'MJCF':
        try:
            original, row['bare'] = bare_holds(Path(name))
        except Exception as error:
            row['reason'].append(f'MuJoCo: {" ".join(str(error).split())[:200]}')
    try:
        robot = load_robot(name)
        row['loads'] = True
        simulation = Simulation(compose(robot))
    except ManipSimError as error:
        return {**row, 'loads': False, 'reason': [str(error)]}
    row['parts'] = {part: len(found.joints) for part, found in simulation.robot.parts.items()
                    if found.atomic == (part,) and found.joints}
    row['lost'] = sum('nothing touches these' in sentence for sentence in robot.inferred)
    if not moves:
        return row
    row['holds'], why = holds(simulation, 5.0)
    if not row['holds']:
        row['reason'] = [why, *(defect[:90] for defect in simulation.start_defects[:1])]
    if class_of(name) != 'MJCF' and any('its actuator' in d for d in simulation.start_defects):
        row['bare'] = False
    if (simulation.model.jnt_type == 0).any():
        simulation = _hung(simulation)
    row['weak'] = {}
    arms = [name for name, part in simulation.robot.parts.items()
            if part.atomic == (name,) and name in ('arm', 'right', 'left') and part.actuators]
    hands = list(simulation.robot.grippers)
    for what, parts, moves_well in (('follows', arms, _arm_follows), ('grips', hands, _grips)):
        try:
            row[what] = worst_of(moves_well(simulation, part, row, original)
                                 for part in parts) if parts else None
        except DivergenceError as error:
            row[what] = False
            row['reason'].append(str(error))
    return row


def _arm_follows(simulation: Simulation, part: str, row: dict[str, Any], original: Any) -> bool:
    """Return whether an arm follows a sine of positions, if need be without contacts."""
    names = _movable(simulation, part)
    contacts = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    residual, _, _ = _sine(simulation, part, 'position', names)
    if residual.max() >= FOLLOWED:
        simulation.model.opt.disableflags |= contacts
        residual, _, _ = _sine(simulation, part, 'position', names)
        simulation.model.opt.disableflags &= ~contacts
    if residual.max() >= FOLLOWED:
        row['reason'].append(f'does not follow: {names[int(residual.argmax())]} '
                             f'{100 * residual.max():.0f} %')
        _explain(simulation, part, 'follows', row, original)
    return bool(residual.max() < FOLLOWED)


def _movable(simulation: Simulation, part: str) -> list[str]:
    """Return the driven joints of a part that no equality constraint holds in place."""
    model = simulation.model
    ties = (model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & (model.eq_obj2id < 0)
    held = {model.joint(joint).name for joint in model.eq_obj1id[ties & (model.eq_active0 != 0)]}
    return [joint for joint in simulation.robot.parts[part].driven_joints
            if joint and joint not in held]


def _explain(simulation: Simulation, part: str, what: str, row: dict[str, Any], original: Any
             ) -> None:
    """Note if the actuators of a part are too weak, or those of the bare MJCF model do no more."""
    why = _lack(simulation, part)
    if not why and original is not None:
        good, why = (hand_follows(simulation, part, original) if what == 'grips' else
                     follows(simulation, part, 'position', original))
        why = why if good == 'as bare' else ''
    if why:
        row['weak'][what] = True
        row['reason'].append(why)


def _lack(simulation: Simulation, part: str) -> str:
    """Return which actuator of a part lacks effort for a sine, and how much, or nothing."""
    simulation.reset()
    model, robot = simulation.model, simulation.robot
    names = _movable(simulation, part)
    middle, swing = _room(model, names, robot.state().position[
        [robot.joint_names.index(name) for name in names]])
    ids = robot.parts[part].actuator_ids
    ids = ids[model.actuator_trntype[ids] == int(mujoco.mjtTrn.mjTRN_JOINT)]
    joints = model.actuator_trnid[ids, 0]
    limits, dofs = effort_range(model, joints, ids), model.jnt_dofadr[joints]
    if part in robot.grippers:  # Their servos exert what their stiffness gives.
        reach = np.where((model.actuator_biasprm[ids, 1] < 0.0) & (model.jnt_limited[joints] != 0),
                         model.actuator_gainprm[ids, 0] * np.ptp(model.jnt_range[joints], axis=1),
                         np.inf)
        limits = np.clip(limits, -reach[:, None], reach[:, None])
    data, acceleration, needed = mujoco.MjData(model), np.zeros(model.nv), np.empty(model.nv)
    own = [int(model.joint(name).dofadr[0]) for name in names]
    omega = 2.0 * np.pi * FREQUENCY_HZ
    for phase in np.linspace(0.0, 2.0 * np.pi, 9):
        data.qpos[:] = simulation.data.qpos
        data.qpos[[int(model.joint(name).qposadr[0]) for name in names]] = (
            middle + swing * np.sin(phase))
        data.qvel[own] = swing * omega * np.cos(phase)
        acceleration[own] = -swing * omega**2 * np.sin(phase)
        mujoco.mj_forward(model, data)
        mujoco.mj_mulM(model, data, needed, acceleration)
        needed += data.qfrc_bias - data.qfrc_passive
        needed += model.dof_frictionloss * np.where(data.qvel == 0.0, np.sign(needed),
                                                    np.sign(data.qvel))
        lacks = np.maximum(needed[dofs] - limits[:, 1], limits[:, 0] - needed[dofs])
        index = int(lacks.argmax()) if len(lacks) else 0
        if len(lacks) and lacks[index] >= 0.0:
            return (f'{model.joint(joints[index]).name} needs {needed[dofs[index]]:.3g} N m or N, '
                    f'its actuator has {limits[index, 0]:.3g} to {limits[index, 1]:.3g}')
    return ''


def _grips(simulation: Simulation, part: str, row: dict[str, Any], original: Any) -> bool:
    """Return whether a hand closes and opens again."""
    simulation.reset()
    robot, model = simulation.robot, simulation.model
    if not robot.parts[part].actuators:
        row['reason'].append(f'{part} has no actuators')
        row['weak']['grips'] = True
        return False
    index = [robot.joint_names.index(name) for name in robot.parts[part].joints]
    spans = np.array([np.ptp(model.joint(name).range) if model.joint(name).limited[0] else 1.0
                      for name in robot.parts[part].joints])
    places, touched = [], False
    for action in (-1.0, 1.0, -1.0):
        for _ in range(round(3.0 / PERIOD_S)):
            robot.apply(robot.parse.action(part, np.full(robot.grippers[part].dof, action)),
                        period_s=PERIOD_S)
            simulation.advance(round(PERIOD_S / simulation.timestep_s))
        places.append(robot.state().position[index] / spans)
        touched = touched or action > 0.0 and bool(simulation.data.ncon)
    closing, opening = (np.abs(b - a).max() for a, b in zip(places, places[1:]))
    good = opening > 0.03 and (closing > 0.33 or touched and closing > 0.03)
    if not good:
        row['reason'].append(f'{part} does not grip: closes by {closing:.0%} of the range, '
                             f'opens by {opening:.0%}')
        _explain(simulation, part, 'grips', row, original)
    return bool(good)


def class_of(name: str) -> str:
    """Return ``MJCF``, ``URDF`` or ``xacro``."""
    return 'xacro' if '.xacro' in name else 'URDF' if name.endswith('.urdf') else 'MJCF'


def check_folder(folder: Path, words: list[str], moves: bool) -> None:
    """
    Print a row for each model in a folder, percentages by class, and the causes of failures.

    :param moves: whether to simulate them, too
    """
    rows = []
    columns = ('loads', 'inferred', 'lost', 'bare', 'holds', 'follows', 'grips', 'weak', 'parts')
    print(f'| model | {" | ".join(columns)} | reason |\n|{"---|" * (len(columns) + 2)}')
    for repository, path, expected in find_in_folder(folder, words):
        row = in_process('as found' if moves else 'as loaded', str(folder / repository / path))
        row.update(repository=repository, listed=expected is not None)
        row['class'] = class_of(path)
        if 'parts' in row and expected is not None:
            row['inferred'] = row['parts'] == expected
            if not row['inferred']:
                row['reason'].append(f'inferred instead of {expected}')
        rows.append(row)
        marks = ' | '.join(_mark(row.get(column)) for column in columns)
        reason = '; '.join(row['reason'])[:300]
        print(f'| {Path(repository, path)} | {marks} | {reason} |', flush=True)
    _sum_up(rows)


def _mark(value: Any) -> str:
    """Return what a row shows of a value."""
    if isinstance(value, dict):
        return ', '.join(name if number is True else f'{name} {number}'
                         for name, number in value.items())
    return _MARKS[value] if value is None or isinstance(value, bool) else str(value)


def _sum_up(rows: list[dict[str, Any]]) -> None:
    """Print percentages by class, and the causes of failures."""
    print(f'\n{len(rows)} models of {len({row["repository"] for row in rows})} repositories')
    for kind in ('MJCF', 'URDF', 'xacro'):
        own = [row for row in rows if row['class'] == kind]
        if not own:
            continue
        loaded = [row for row in own if row.get('loads')]
        able = [row for row in loaded if row.get('bare', kind != 'MJCF')]
        print(f'{kind}: {len(own)} files')
        for column, among in (('loads', own), ('inferred', own), ('holds', able),
                              ('follows', loaded), ('grips', loaded)):
            counted = [row for row in among if among is own or row.get(column) is not None
                       and (row[column] or column not in row['weak'])]
            if column == 'inferred':
                counted = [row for row in counted if row['listed']]
            if not counted:
                continue
            good = sum(bool(row.get(column)) for row in counted)
            print(f'  {column}: {good} of {len(counted)} ({good / len(counted):.0%})')
    causes = Counter(_cause(row['reason'][0]) for row in rows
                     if row['reason'])
    for cause, count in causes.most_common():
        print(f'{count} times: {cause}')


def _cause(reason: str) -> str:
    """Return a reason without the names in it."""
    return re.sub(r"('[^']*'(\.\.\.)?|\S*/\S*|[\d.]+)", '*', reason)[-100:]


def worst_of(results: Iterable[bool | str]) -> bool | str:
    """Return the worst of some results: False, else what restricts one of them, else True."""
    every = list(results)
    return False if False in every else next((good for good in every if good is not True), True)


def _simulation(kind: str, file: Path, hangs: bool = False) -> Simulation:
    if kind == 'robot':
        robot = load_robot(file)
        simulation = Simulation(compose(robot))
        return _hung(simulation) if hangs else simulation
    with tempfile.TemporaryDirectory() as folder:
        post = Path(folder) / 'post.xml'
        post.write_text(POST)
        return Simulation(compose(load_robot(post), load_gripper(file, idn='0_right')))


def _hung(simulation: Simulation) -> Simulation:
    """Return the same simulation without floor, and with floating bases fixed in place."""
    model = simulation.model
    floor = model.geom_bodyid == 0
    model.geom_contype[floor] = model.geom_conaffinity[floor] = 0
    _hang(model)
    return simulation


def _hang(model: Any) -> None:
    """Switch gravity off in a model, and make its floating bases too heavy to move."""
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        address = model.jnt_dofadr[joint]
        # Much more than a robot, yet not so much that light links are lost beside it.
        model.dof_armature[address:address + 6] = 1e4
    model.opt.gravity[:] = 0.0
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _worker(kind: str, file: Any, out: Any) -> None:
    logging.disable(logging.WARNING)
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        out.put(check(kind, file) if kind in ('robot', 'hand')
                else check_as_found(file, kind == 'as found'))
    except Exception as error:
        out.put({'reason': [f'{type(error).__name__}: {str(error)[:120]}'], 'bare': True})


def in_process(kind: str, file: Path | str) -> dict[str, Any]:
    """Return the row of a model from a process of its own."""
    # Not spawned: to import all of it again takes longer than most models need.
    context: Any = multiprocessing.get_context(
        'fork' if 'fork' in multiprocessing.get_all_start_methods() else 'spawn')
    out = context.Queue()
    process = context.Process(target=_worker, args=(kind, file, out))
    process.start()
    try:
        row: dict[str, Any] = out.get(timeout=LIMIT_S)
        return row
    except Exception:
        return {'bare': True, 'reason': [f'ends after {LIMIT_S:g} s or by a crash']}
    finally:
        process.terminate()
        process.join()


def main() -> None:
    """Print the table and how many of how many work."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('words', nargs='*', help='parts of model names (default: all)')
    parser.add_argument('--robosuite', type=Path, help='where the wheels are unpacked')
    parser.add_argument('--folder', type=Path, help='of robots, or of the listed clones')
    parser.add_argument('--load', action='store_true', help='only load the models of the folder')
    arguments = parser.parse_args()
    if arguments.folder is not None:
        check_folder(arguments.folder, arguments.words, not arguments.load)
        return
    columns = ('bare', 'bare_holds', 'loads', 'same', 'holds', 'position', 'velocity')
    print(f'| model | kind | {" | ".join(columns)} | reason |\n|{"---|" * (len(columns) + 3)}')
    rows = []
    for collection, kind, file in find_models(arguments.robosuite):
        name = f'{collection}:{file.parent.name}/{file.stem}'
        if arguments.words and not any(word in name for word in arguments.words):
            continue
        row = in_process(kind, file)
        rows.append((collection, kind, row))
        marks = ' | '.join(str(_MARKS.get(row.get(c), row.get(c))) for c in columns)
        what = kind + ('' if row.get('arms', True) or kind == 'hand' else ', no arm')
        print(f'| {name} | {what} | {marks} | {"; ".join(row["reason"])} |', flush=True)
    summary(rows)


def summary(rows: list[tuple[str, str, dict[str, Any]]]) -> None:
    """Print how many models of each collection work, of those that MuJoCo compiles."""
    for collection in ('menagerie', 'robosuite'):
        for kind in ('robot', 'hand'):
            own = [row for c, k, row in rows if (c, k) == (collection, kind) and row['bare']
                   and (kind == 'hand' or row.get('arms', True))]
            if not own:
                continue
            held = [r for r in own if r.get('holds') or not r.get('bare_holds')]
            good = [r for r in held if r.get('same') and r.get('position')
                    and r.get('velocity') is not False]
            figures = ', '.join(f'{sum(bool(r.get(c)) for r in own)} {c}' for c in (
                'loads', 'same', 'holds', 'position', 'velocity'))
            print(f'\n{collection} {kind}s with arms or hands: {len(own)} compile; {figures}; '
                  f'{len(held)} hold where the original does; {len(good)} do all of it')


if __name__ == '__main__':
    main()
