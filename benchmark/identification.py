# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Joint inertia as a user identifies it from published states, as a table.

    python3 benchmark/identification.py [ROBOT ...] [--timestep S]

One arm joint after the other swings, while the others are held, so its inertia stays the same and
its weight is a sine of its angle. From the states of successive physics steps, nothing else, least
squares find its inertia I, that which it shares with each other joint, damping d and weight A, B,
C in

    effort[k+1] = I (v[k+1] - v[k]) / dt + ... + d v[k+1] + A sin q[k] + B cos q[k] + C

where ... are the accelerations of the others, which yield a little. That is what the integrator
solves: the published effort is that of the step that led to a state, weight is that at its
beginning, and damping acts with the velocity at its end. A fit with central differences, or with
all of them at one instant, mixes up inertia and damping at long steps.

The table has the greatest error of an inertia, of all arm joints, in percent.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation

MODES = ('position', 'velocity', 'effort')
#: Share of the acceleration limit that a joint swings with, how fast, and for how long.
SHARE, FREQUENCIES_HZ, SWING_S = 0.3, (3.0, 7.0), 1.0


def swing(simulation: Simulation, joint: str, mode: str, command_hz: float
          ) -> tuple[FloatArray, float]:
    """
    Let one joint of an arm swing.

    :returns: position, velocity and effort of all joints after each step, shape (steps, 3, n), and
        the inertia of the joint in the model
    """
    model, data, robot = simulation.model, simulation.data, simulation.robot
    of_model = model.joint(joint)
    dof = int(of_model.dofadr[0])
    limit = float(robot.joints.acceleration_limits(robot.joints.find([joint]))[0])
    start, omega = float(data.joint(joint).qpos[0]), 2.0 * np.pi * np.array(FREQUENCIES_HZ)
    unit, column = np.zeros((2, model.nv))
    unit[dof] = 1.0
    mujoco.mj_mulM(model, data, column, unit)
    inertia = float(column[dof])
    size = SHARE * limit / len(omega)
    # Away from the end of its range.
    if of_model.limited[0] and start > of_model.range.mean():
        size = -size
    states = []
    for period in range(round(SWING_S * command_hz)):
        angle = omega * period / command_hz
        values = {'position': start + size * ((1.0 - np.cos(angle)) / omega**2).sum(),
                  'velocity': size * (np.sin(angle) / omega).sum(),
                  'effort': size * inertia * np.cos(angle).sum()}
        field: Any = {mode: [values[mode]]}
        robot.apply(*robot.parse.joint_command([joint], **field), period_s=1.0 / command_hz)
        for _ in range(round(1.0 / command_hz / simulation.timestep_s)):
            simulation.advance(1)
            states.append(robot.measured().reshape(3, -1).copy())
    return np.array(states), inertia


def identify(states: FloatArray, index: int, timestep_s: float) -> float:
    """
    Return the inertia of a joint.

    :param states: of all joints after each step, shape (steps, 3, n)
    :param index: of the joint
    """
    before, after = states[:-1], states[1:]
    position, end = before[:, 0, index], after[:, 1, index]
    terms = np.column_stack([(after[:, 1] - before[:, 1]) / timestep_s, end, np.sin(position),
                             np.cos(position), np.ones(len(end))])
    found = np.linalg.lstsq(terms, after[:, 2, index], rcond=None)[0]
    return float(found[index])


def errors(name: str, mode: str, timestep_s: float, command_hz: float = 100.0) -> FloatArray:
    """Return the errors of the identified inertia of each arm joint, as shares of it."""
    simulation = Simulation(compose(name, arena='empty', timestep_s=timestep_s))
    simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    robot = simulation.robot
    if 'base' in robot.parts:
        robot.set_control_mode('base', 'position')
    result = []
    for joint in [joint for arm in robot.end_effectors for joint in robot.parts[arm].joints]:
        # Joints that have no effort yet are held.
        for either in ('position', mode):
            robot.set_control_mode('arm', either)
        simulation.reset()
        states, inertia = swing(simulation, joint, mode, command_hz)
        result.append(
            identify(states, robot.joint_names.index(joint), timestep_s) / inertia - 1.0)
    return np.array(result)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.
                                     RawDescriptionHelpFormatter)
    parser.add_argument('robots', nargs='*', metavar='ROBOT', choices=[[], *robot_names()])
    parser.add_argument('--timestep', type=float, default=0.005, metavar='S', help='(%(default)s)')
    parser.add_argument('--command-rate', type=float, default=100.0, metavar='HZ',
                        help='(%(default)s)')
    options = parser.parse_args(arguments)
    print(f'| robot | {" | ".join(MODES)} |\n|---|---|---|---|')
    for name in options.robots or robot_names():
        found = [errors(name, mode, options.timestep, options.command_rate) for mode in MODES]
        cells = ' | '.join(f'{100.0 * np.abs(error).max():.2f}' for error in found)
        print(f'| {name} | {cells} |', flush=True)


if __name__ == '__main__':
    main()
