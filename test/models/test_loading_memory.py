# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Loading a robot with large meshes takes little more memory and time than in bare MuJoCo."""

import json
import subprocess
import sys

import numpy as np
import pytest

from files_rig import write

pytestmark = pytest.mark.full

PROGRAM = """
import json, pathlib, sys, time
from manip_sim.models import compose, load_robot
import mujoco
file, is_bare = sys.argv[1], sys.argv[2] == 'bare'
def peak():  # Unlike that of getrusage, it does not begin with that of the parent process.
    status = pathlib.Path('/proc/self/status').read_text()
    return int(status.split('VmHWM:')[1].split()[0]) / 1024
begin, seconds, kept = peak(), [], None
for _ in range(3):
    start, kept = time.process_time(), None
    if is_bare:
        spec = mujoco.MjSpec.from_file(file)
        kept = spec, spec.compile()
    else:
        world = compose(load_robot(file), base='none')
        kept = world, world.compile()
    seconds.append(time.process_time() - start)
print(json.dumps([peak() - begin, seconds[0], min(seconds[1:])]))
"""


@pytest.fixture(params=[0, 2], ids=['without hand', 'with hand'])
def file(tmp_path, request):
    """Return a robot of six links, each of a mesh with 40 000 faces, and fingers of such ones."""
    fingers = ''.join(
        f'<body name="finger{number}" pos="0 {side} 0.2"><joint name="f{number}" type="slide" '
        f'axis="0 {-side} 0" range="0 0.05"/><geom type="mesh" mesh="link{number}"/></body>'
        for number, side in enumerate((0.1, -0.1)[:request.param]))
    steps = np.linspace(0.0, 1.0, 101)
    for number in range(6):
        u, v = (axis.ravel() for axis in np.meshgrid(2.0 * np.pi * steps[:-1], np.pi * steps))
        radius = 0.05 + 0.01 * np.sin((number + 3) * u)
        points = np.stack([radius * np.cos(u) * np.sin(v), radius * np.sin(u) * np.sin(v),
                           0.1 * np.cos(v)], axis=1)
        faces = [(row * 100 + i + 1, row * 100 + (i + 1) % 100 + 1, (row + 1) * 100 + i + 1,
                  (row + 1) * 100 + (i + 1) % 100 + 1) for row in range(100) for i in range(100)]
        lines = [f'v {x:.6f} {y:.6f} {z:.6f}' for x, y, z in points]
        lines += [f'f {a} {c} {b}\nf {b} {c} {d}' for a, b, c, d in faces]
        write(tmp_path / f'link{number}.obj', '\n'.join(lines))
    bodies = ''.join(
        f'<body name="link{number}" pos="0 0 0.2"><joint name="j{number}" axis="0 1 0" '
        f'range="-1 1"/><geom type="mesh" mesh="link{number}"/>' for number in range(6))
    meshes = ''.join(f'<mesh file="link{number}.obj"/>' for number in range(6))
    joints = [*(f'j{number}' for number in range(6)), *(f'f{i}' for i in range(request.param))]
    motors = ''.join(f'<position joint="{joint}" kp="500" kv="50"/>' for joint in joints)
    return write(tmp_path / 'arm.xml', f"""<mujoco><compiler autolimits="true"/>
      <asset>{meshes}</asset><worldbody><body name="base"><geom size="0.01"/>
      {bodies}{fingers}{'</body>' * 6}</body></worldbody><actuator>{motors}</actuator></mujoco>""")


def measured(file, kind):
    done = subprocess.run([sys.executable, '-c', PROGRAM, str(file), kind], check=True,
                          capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_a_robot_takes_little_more_than_in_bare_mujoco(file):
    bare, ours = measured(file, 'bare'), measured(file, 'ours')
    memory, first, again = (b / a for a, b in zip(bare, ours))
    # The world keeps meshes, as bare MuJoCo does; the robot's own model has none.
    assert memory < 1.5, (bare, ours)
    assert first < 1.9, (bare, ours)
    # Parts are inferred of one compiled model, and the world is another.
    assert again < 5.0, (bare, ours)
