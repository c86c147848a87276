# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The watch that keeps the last good state, without a robot."""

import mujoco
import numpy as np
import pytest

from manip_sim.physics.physics_steps import DivergenceWatch

BAD_CONTROL = int(mujoco.mjtWarning.mjWARN_BADCTRL)


@pytest.fixture
def watched():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep="0.01"/><worldbody><body><joint name="j" damping="1"/>'
        '<geom size="0.1"/></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>')
    data = mujoco.MjData(model)
    return model, data, DivergenceWatch(model, data)


def test_hold_restores_the_state_and_old_warnings_are_no_reason(watched):
    model, data, watch = watched
    mujoco.mj_step(model, data)
    data.warning[BAD_CONTROL].number = 3  # Of former steps.
    watch.remember()
    good = data.qpos.copy(), data.qvel.copy(), data.time
    data.ctrl[0] = np.nan
    mujoco.mj_step(model, data)
    assert data.warning[BAD_CONTROL].number == 4
    assert 'bad position, velocity, acceleration or control' in watch.reason()
    watch.hold()
    np.testing.assert_array_equal([*data.qpos, *data.qvel, data.time],
                                  [*good[0], *np.zeros_like(good[1]), good[2]])
    data.ctrl[0] = 0.1
    # A warning of before is no reason in the next period, and a new one is.
    watch.remember()
    assert watch.reason() is None
    mujoco.mj_step(model, data)
    assert watch.reason() is None
    data.ctrl[0] = np.nan
    mujoco.mj_step(model, data)
    assert watch.reason() is not None
