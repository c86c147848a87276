# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""MuJoCo Warp takes exported models as they are; ``benchmark/exported.py`` steps them too."""

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
