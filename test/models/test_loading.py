# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files that MuJoCo cannot take, and what MuJoCo warns of."""

import logging
import math
import os
import re
import subprocess
import sys

import mujoco
import pytest

from manip_sim.models.loading import compile_copy, compile_without_meshes

LOAD_WITH_LITTLE_MEMORY = """
import resource
import sys
from pathlib import Path
from manip_sim.errors import ModelError
from manip_sim.models.loading import compile_spec, load_spec
used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (50 << 20), used + (50 << 20)))
try:
    compile_spec(load_spec(Path(sys.argv[1])), 'model')
except ModelError as error:
    print(error)
"""


@pytest.mark.full
def test_a_height_field_that_does_not_fit_into_memory_is_told(mjcf):
    file = mjcf(sections='<asset><hfield name="h" nrow="4000" ncol="4000" size="1 1 1 1"/>'
                         '</asset>')
    child = subprocess.run([sys.executable, '-c', LOAD_WITH_LITTLE_MEMORY, str(file)],
                           capture_output=True, text=True, timeout=60.0)
    assert child.returncode == 0, child.stderr
    assert re.search(r'model\.xml is not MJCF that MuJoCo can read: |^model does not compile: ',
                     child.stdout)


def test_a_warning_of_mujoco_is_logged_and_not_written_to_a_file(panda_sim, caplog):
    panda_sim.data.ctrl[0] = math.nan
    with caplog.at_level(logging.WARNING):
        mujoco.mj_step(panda_sim.model, panda_sim.data)
    assert any('CTRL' in record.message for record in caplog.records)
    assert os.listdir('.') == []


@pytest.fixture
def shaped_arm():
    """Return the spec of a link with a mesh to touch, in millimetres, and one to see."""
    spec = mujoco.MjSpec()
    spec.add_texture(name='grid', type=mujoco.mjtTexture.mjTEXTURE_2D, file='/nowhere/grid.png')
    painted = spec.add_material(name='painted')
    painted.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = 'grid'
    for name, size in (('solid', 200), ('shell', 300)):
        corners = [size * (corner >> axis & 1) for corner in range(8) for axis in range(3)]
        spec.add_mesh(name=name, uservert=corners, scale=[1e-3] * 3)
    body = spec.worldbody.add_body(name='link', mass=1.0, inertia=[1.0] * 3, ipos=[0.0] * 3,
                                   explicitinertial=True)
    body.add_joint(name='turn')
    for name, touches in (('solid', 1), ('shell', 0)):
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name,
                      material='painted', contype=touches, conaffinity=touches)
    return spec


def test_shapes_to_see_need_neither_meshes_nor_images(shaped_arm):
    shell = shaped_arm.mesh('shell')
    shell.file, shell.uservert = '/nowhere/shell.stl', []
    shaped_arm.add_mesh(name='spare', file='/nowhere/spare.stl')
    model = compile_copy(shaped_arm, 'arm', visual=False)
    assert [model.geom(geom).name for geom in range(model.ngeom)] == ['solid']
    assert model.nmeshvert == 8


def test_meshes_of_any_scale_are_left_out(shaped_arm):
    model = compile_without_meshes(shaped_arm, 'arm', ())
    assert (model.ngeom, model.nmesh, model.nmeshvert) == (2, 2, 8)
    assert compile_without_meshes(shaped_arm, 'arm', ['link']).nmeshvert == 16
