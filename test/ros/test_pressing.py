# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Presses on a table by a client with an admittance controller, through topics in lock-step."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / 'benchmark'


@pytest.fixture
def pressing(monkeypatch):
    """Return the module with the client."""
    monkeypatch.syspath_prepend(str(BENCHMARK))
    import pressing
    return pressing


def force_on_table(simulation):
    """Return the sum of all normal forces on the table now, by MuJoCo's contacts [N]."""
    table, force, total = simulation.model.geom('table_collision').id, np.zeros(6), 0.0
    for index, contact in enumerate(simulation.data.contact):
        if table in (contact.geom1, contact.geom2):
            mujoco.mj_contactForce(simulation.model, simulation.data, index, force)
            total += force[0]
    return total


@pytest.mark.full
@pytest.mark.parametrize('gripper, force_n, rate_hz', [
    ('PandaGripper', 20.0, 500.0), ('JacoThreeFingerGripper', 20.0, 100.0)])
def test_a_client_presses_within_half_a_newton_still_and_sliding(
        serve, client, pressing, gripper, force_n, rate_hz):
    node = serve(**pressing.PARAMETERS, gripper=gripper, publish_rate=rate_hz)
    still, sliding = pressing.press(
        client.node, client.spin_until, force_n, rate_hz, seconds=0.8)
    assert still < 0.5 and sliding < 0.5
    assert force_on_table(node.simulation) == pytest.approx(force_n, abs=0.5)
