# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a failed test leaves: what the simulation published, and a picture of its last instant."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
from typing import Any, TYPE_CHECKING

from geometry_msgs.msg import PoseStamped
import mujoco
import numpy as np
from PIL import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from manip_sim.errors import ManipSimError
from manip_sim.models.archive import load_archive
from manip_sim.ros.messages import LATCHED

if TYPE_CHECKING:
    from manip_sim.testing.simulation_under_test import SimulationUnderTest

_SIZE = (960, 720)
#: The longest time for a picture, also of a machine with many other processes [s].
_RENDERING_S = 300.0
_ARCHIVE, _STATES, _PICTURE = 'model.mjz', 'states.npz', 'picture.png'


def save_evidence(simulation: SimulationUnderTest, folder: Path) -> list[str]:
    """
    Save the joint states and the model, and render a picture in a process of its own.

    :param folder: is created
    :returns: a line about the nodes in the domain, and one for each file
    """
    lines = [f'nodes in ROS domain {simulation.domain}: {", ".join(simulation.nodes())}']
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {}
    for topic in simulation.recorded(JointState):
        history = simulation.states(topic)
        for field in ('names', 'time_s', 'position', 'velocity', 'effort'):
            arrays[f'{topic}/{field}'] = np.array(getattr(history, field))
    for topic in simulation.recorded(PoseStamped):
        pose = simulation.messages(topic)[-1].pose
        arrays[f'{topic}/last'] = np.array([
            pose.position.x, pose.position.y, pose.position.z, pose.orientation.w,
            pose.orientation.x, pose.orientation.y, pose.orientation.z])
    np.savez(folder / _STATES, **arrays)
    lines.append(f'states at each control period: {folder / _STATES}')
    try:
        (folder / _ARCHIVE).write_bytes(_archive(simulation))
        _picture(folder)
        lines.append(f'the last instant: {folder / _PICTURE}')
    except ManipSimError as error:
        lines.append(f'no picture: {error}')
    return lines


def _archive(simulation: SimulationUnderTest) -> bytes:
    return bytes(simulation.receive(
        UInt8MultiArray, 'manip_sim/mjcf_archive', LATCHED).data)


def _picture(folder: Path) -> None:
    try:
        done = subprocess.run(
            [sys.executable, '-m', __name__, str(folder)], capture_output=True, text=True,
            check=False, env={'MUJOCO_GL': 'egl', **os.environ}, timeout=_RENDERING_S)
    except subprocess.TimeoutExpired as error:
        raise ManipSimError(f'rendering took more than {_RENDERING_S:g} s') from error
    if done.returncode:
        raise ManipSimError((done.stderr.strip().splitlines() or ['it ended without output'])[-1])


def render(folder: Path) -> None:
    """
    Render the last instant of what :func:`save_evidence` has saved.

    :param folder: where it is
    """
    model = load_archive((folder / _ARCHIVE).read_bytes())
    data = mujoco.MjData(model)
    with np.load(folder / _STATES) as arrays:
        for name in arrays.files:
            topic, _, field = name.rpartition('/')
            if field == 'names':
                for joint, position in zip(arrays[name], arrays[f'{topic}/position'][-1]):
                    data.joint(str(joint)).qpos[0] = position
            elif field == 'last' and topic.startswith('objects/'):
                body = model.body(topic.split('/')[1])
                data.qpos[model.jnt_qposadr[body.jntadr[0]]:][:7] = arrays[name]
    mujoco.mj_forward(model, data)
    from manip_sim.cli.rendering import picture_of_state
    picture: Image.Image = picture_of_state(model, data, _SIZE)
    picture.save(folder / _PICTURE)


if __name__ == '__main__':
    render(Path(sys.argv[1]))
