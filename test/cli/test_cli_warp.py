# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""MuJoCo Warp takes exported models; ``benchmark/exported.py`` steps those of all robots."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.models.robots import ROBOTS
from manip_sim.simulation import Simulation

warp = pytest.importorskip('mujoco_warp', reason='mujoco_warp is not installed')


def taken(model, data):
    """Return the state of two worlds of MuJoCo Warp."""
    return warp.put_data(model, data, nworld=2), warp.put_model(model)


@pytest.mark.parametrize('name', ROBOTS.names())
def test_an_exported_robot_is_taken_with_its_state(name, here, tmp_path):
    file = tmp_path / 'robot.xml'
    assert here('export', file, '--robot', name, '--arena', 'table')[0] == 0
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    state, on_warp = taken(model, data)
    assert (on_warp.nv, on_warp.nu) == (model.nv, model.nu)
    np.testing.assert_allclose(state.qpos.numpy(), [data.qpos] * 2, atol=1e-6)


def test_a_model_that_never_resets_itself_is_not_taken():
    # The simulation's own has this flag; what is exported does not.
    simulation = Simulation(compose('Panda'))
    with pytest.raises(NotImplementedError):
        taken(simulation.model, simulation.data)


@pytest.mark.full
def test_a_cube_stays_on_a_table_with_a_tolerance_for_single_precision(here, tmp_path):
    file = tmp_path / 'robot.xml'
    assert here('export', file, '--robot', 'Panda', '--arena', 'table')[0] == 0
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.ccd_tolerance = 1e-6
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    state, on_warp = taken(model, data)
    height = model.jnt_qposadr[model.joint('cube_joint').id] + 2
    before = data.qpos[height]
    for _ in range(60):
        warp.step(on_warp, state)
    np.testing.assert_allclose(state.qpos.numpy()[:, height], before, atol=5e-4)
