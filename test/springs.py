# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints that are pulled as by springs with dampers, against what the formulas of these say."""

import numpy as np


def deflection(simulation):
    """Push each joint of the arms with 2 N m or N; return how far each moved, and the pushes."""
    joints, data = simulation.robot.joints, simulation.data
    indices = joints.indices_of('arm')
    simulation.advance(500)
    before, _ = joints.measured(indices, data)
    effort = np.where(indices % 2, -2.0, 2.0)
    data.qfrc_applied[joints.dofs(indices)] = effort
    simulation.advance(1500)
    after, velocity = joints.measured(indices, data)
    assert np.abs(velocity).max() < 1e-3
    return after - before, effort


def assert_swings(simulation, stiffness, damping):
    """Check the decrement and the period of the only joint, with the inertia of MuJoCo."""
    data, (joint,) = simulation.data, simulation.robot.joints.names
    dof, step_s = simulation.model.joint(joint).dofadr[0], simulation.timestep_s
    inertia = 1.0 / simulation.model.dof_invweight0[dof]
    rest, away = float(data.qpos[0]), []
    data.qfrc_applied[dof] = 4.0
    for _ in range(10):
        simulation.advance(800)
    data.qfrc_applied[dof] = 0.0
    for _ in range(4000):
        simulation.advance(1)
        away.append(float(data.qpos[0]) - rest)
    passive = float(np.reshape(simulation.model.dof_damping, (simulation.model.nv, -1))[dof, 0])
    decay = (damping + passive) / (2.0 * inertia)
    swing = np.sqrt(stiffness / inertia - decay**2)
    t = step_s * np.arange(1, 4001)
    expected = 4.0 / stiffness * np.exp(-decay * t) * (
        np.cos(swing * t) + decay / swing * np.sin(swing * t))
    assert np.abs(np.array(away) - expected).max() < 0.05 * 4.0 / stiffness
