# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""See what happens inside a control period: every robot, sampled at every physics step."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from manip_sim.control.law import stepping
from manip_sim.models import compose
from manip_sim.simulation import Simulation


def whole_robot(name, timestep_s=0.002, contacts=False, **options):
    """Return a simulation of a robot with all that it has by default, in position mode."""
    simulation = Simulation(compose(name, timestep_s=timestep_s, **options))
    if not contacts:
        simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if 'base' in simulation.robot.parts:
        simulation.robot.set_control_mode('base', 'position')
    return simulation


class Driven:
    """
    The driven joints of a simulation, with what the model says of them.

    :ivar names: of the joints
    :ivar velocity_limit: as the model declares it [rad/s or m/s], shape (n,)
    :ivar low: and ``high``: of the range, infinite where there is none [rad or m], shape (n,)
    """

    def __init__(self, simulation, part=None):
        self.simulation, model = simulation, simulation.model
        parts = [part] if part else [n for n, p in simulation.robot.parts.items()
                                     if p.atomic == (n,) and p.gripper is None]
        self.names = [j for p in parts for j in simulation.robot.parts[p].driven_joints]
        joints = [model.joint(name) for name in self.names]
        self.qpos = np.array([j.qposadr[0] for j in joints])
        self.dofs = np.array([j.dofadr[0] for j in joints])
        self.velocity_limit = np.array([j.user[0] for j in joints])
        limited = np.array([bool(j.limited[0]) for j in joints])
        self.low = np.where(limited, [j.range[0] for j in joints], -np.inf)
        self.high = np.where(limited, [j.range[1] for j in joints], np.inf)
        self.damping = np.asarray(model.dof_damping).reshape(model.nv, -1)[self.dofs, 0]

    @property
    def position(self):
        """Where the joints are [rad or m], shape (n,), a copy."""
        return self.simulation.data.qpos[self.qpos].copy()

    def command(self, mode, values, joints=None, period_s=0.01):
        """Apply goals for all joints, or for some, in a mode."""
        names = self.names if joints is None else joints
        robot = self.simulation.robot
        robot.apply(*robot.parse.joint_command(names, **{mode: values}), period_s=period_s)

    def within(self, start, offset):
        """Return an offset that is turned round or shortened where it would leave the range."""
        leaves = (start + offset > self.high) | (start + offset < self.low)
        turned = np.where(leaves, -offset, offset)
        return np.clip(start + turned, self.low, self.high) - start


class Samples:
    """
    What the driven joints did at each physics step.

    :ivar position: [rad or m], shape (steps, n)
    :ivar velocity: [rad/s or m/s], shape (steps, n)
    :ivar effort: of the actuators [N m or N], shape (steps, n)
    :ivar wrench: of the right arm's sensors if it was asked for [N, N m], shape (steps, 6)
    """

    def __init__(self, driven, wrench=False):
        self._driven = driven
        self._rows = []
        end = driven.simulation.robot.end_effectors.get('right') if wrench else None
        prefix = end and end.ft_frame.removesuffix('ft_frame')
        self._wrench = end and [
            driven.simulation.model.sensor(prefix + name).adr[0] + axis
            for name in ('force_ee', 'torque_ee') for axis in range(3)]

    def take(self, model, data):
        driven = self._driven
        wrench = np.zeros(6)
        if self._wrench:
            mujoco.mj_forward(model, data)
            wrench = data.sensordata[self._wrench].copy()
        self._rows.append((data.qpos[driven.qpos].copy(), data.qvel[driven.dofs].copy(),
                           data.qfrc_actuator[driven.dofs].copy(), wrench))

    def __getattr__(self, name):
        names = ('position', 'velocity', 'effort', 'wrench')
        if name not in names:
            raise AttributeError(name)
        return np.array([row[names.index(name)] for row in self._rows])


@contextmanager
def sampled(driven, wrench=False) -> Iterator[Samples]:
    """Record every physics step of a simulation meanwhile."""
    samples, step, step2 = Samples(driven, wrench), mujoco.mj_step, mujoco.mj_step2
    may_step = stepping.may_step

    def single_steps(model, data, nstep=1):
        for _ in range(nstep):
            step(model, data)
            samples.take(model, data)

    def second_half(model, data):
        step2(model, data)
        samples.take(model, data)

    mujoco.mj_step, mujoco.mj_step2 = single_steps, second_half
    stepping.may_step = lambda data: False
    try:
        yield samples
    finally:
        mujoco.mj_step, mujoco.mj_step2 = step, step2
        stepping.may_step = may_step
