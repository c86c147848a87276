# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Draw the figures of the documentation from simulations run by this script.

It needs matplotlib.

usage: python3 docs/figures.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np

from manip_sim.models import compose
from manip_sim.simulation import Simulation

matplotlib.use('svg')
import matplotlib.pyplot as plt  # noqa: E402

FOLDER = Path(__file__).resolve().parent / 'figures'
#: A control period [steps], [s].
STEPS, PERIOD_S = 5, 0.01
STYLE = {'svg.fonttype': 'none', 'svg.hashsalt': 'manip_sim', 'font.size': 10,
         'axes.grid': True, 'grid.alpha': 0.3, 'axes.spines.top': False,
         'axes.spines.right': False, 'figure.facecolor': 'white', 'lines.linewidth': 1.6}


def save(figure: plt.Figure, name: str) -> None:
    """Write a figure as SVG, without the date."""
    figure.tight_layout()
    figure.savefig(FOLDER / f'{name}.svg', metadata={'Date': None})
    plt.close(figure)


def run(simulation: Simulation, seconds: float, look: Callable[[], object]) -> list[object]:
    """Advance, and return what ``look`` returns after each control period."""
    seen = []
    for _ in range(round(seconds / PERIOD_S)):
        simulation.advance(STEPS)
        seen.append(look())
    return seen


def wrench() -> None:
    """Draw both wrenches along z: at rest, while the hand moves up, and under a push."""
    simulation = Simulation(compose('Panda'))
    robot = simulation.robot
    body = simulation.model.body('gripper0_right_right_gripper').id

    def look() -> tuple[float, float]:
        end = robot.state().end_effectors['right']
        return end.wrench.force[2], end.external_wrench.force[2]

    rows = run(simulation, 0.5, look)
    pose = robot.state().end_effectors['right'].pose
    robot.apply(robot.parse_cartesian.pose('right', pose.position + [0.0, 0.0, 0.1],
                                           pose.quat_xyzw), period_s=PERIOD_S)
    rows += run(simulation, 1.0, look)
    axis = simulation.data.site(robot.end_effectors['right'].ft_frame).xmat.reshape(3, 3)[:, 2]
    simulation.data.xfrc_applied[body, :3] = 5.0 * axis
    rows += run(simulation, 0.5, look)
    simulation.data.xfrc_applied[body, :3] = 0.0
    rows += run(simulation, 0.3, look)
    times, values = PERIOD_S * np.arange(len(rows)), np.array(rows)
    figure, axes = plt.subplots(2, 1, figsize=(7.2, 4.2), sharex=True)
    for axis_, column, name in zip(axes, values.T, ('wrench', 'external_wrench')):
        axis_.plot(times, column, color='C0' if name == 'wrench' else 'C1')
        axis_.set_ylabel('force along z [N]')
        axis_.set_title(f'right/{name}', loc='left', fontsize=10)
        for begin, end in ((0.5, 1.0), (1.5, 2.0)):
            axis_.axvspan(begin, end, color='C7', alpha=0.12, linewidth=0)
    axes[1].set_ylim(-1.0, 6.0)
    axes[0].set_ylim(-13.0, -3.5)
    axes[0].text(0.52, -4.0, 'moves up', va='center')
    axes[0].text(1.52, -4.0, 'is pushed by 5 N', va='center')
    axes[1].set_xlabel('time [s]')
    save(figure, 'wrench')


def gravity() -> None:
    """Draw joints 2 and 4 of a Panda at zero effort, with and without compensation."""
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.0), sharex=True)
    for compensated, style in ((True, '-'), (False, '--')):
        simulation = Simulation(compose('Panda', gravity_compensation=compensated))
        robot = simulation.robot
        robot.set_control_mode('arm', 'effort')
        names = [name for name in robot.joint_names if name.startswith('robot0')]
        # A joint is held until its first effort.
        robot.apply(*robot.parse.joint_command(names, effort=np.zeros(len(names))),
                    period_s=PERIOD_S)

        def look(robot: object = robot) -> np.ndarray:
            state = robot.state()
            return np.array([state.position[[1, 3]], state.effort[[1, 3]]])

        seen = np.array(run(simulation, 1.0, look))
        times = PERIOD_S * np.arange(1, len(seen) + 1)
        for kind, axis in enumerate(axes):
            for joint, label in enumerate(('joint 2', 'joint 4')):
                word = 'with' if compensated else 'without'
                axis.plot(times, seen[:, kind, joint], style, color=f'C{joint}',
                          label=f'{label}, {word}')
    axes[0].set_ylabel('position [rad]')
    axes[1].set_ylabel('effort [N m]')
    for axis in axes:
        axis.set_xlabel('time [s]')
    axes[1].legend(fontsize=8, loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False)
    save(figure, 'gravity_compensation')


def setpoints() -> None:
    """Draw what a joint does with a step, and with a stream of the same distance."""
    figure, axes = plt.subplots(2, 2, figsize=(7.2, 4.6), sharex='col', sharey='row')
    for column, title in enumerate(('a step of 0.5 rad', 'a stream at 20 Hz')):
        simulation = Simulation(compose('Panda'))
        robot = simulation.robot
        goals: list[float] = []

        def look(robot: object = robot) -> tuple[float, float, float, float]:
            state = robot.controller_state('arm')
            return (state.reference.position[0], state.position[0],
                    state.reference.velocity[0], state.velocity[0])

        rows = []
        for period in range(100):
            time_s = PERIOD_S * period
            wanted = 0.5 if column == 0 else 0.25 * (1.0 - np.cos(np.pi * min(time_s, 0.8) / 0.8))
            if (column == 0 and period == 0) or (column == 1 and period % 5 == 0):
                robot.apply(*robot.parse.joint_command(['robot0_joint1'], position=[wanted]),
                            period_s=PERIOD_S)
                sent = wanted
            goals.append(sent)
            rows += run(simulation, PERIOD_S, look)
        values = np.array(rows)
        times = PERIOD_S * np.arange(1, len(values) + 1)
        axes[0, column].step(times - PERIOD_S, goals, color='C7', label='goal', where='post')
        for row in (0, 1):
            axes[row, column].plot(times, values[:, 2 * row], color='C1', linewidth=5.0,
                                   alpha=0.45, label='setpoint')
            axes[row, column].plot(times, values[:, 2 * row + 1], color='C0', label='measured')
        axes[0, column].set_title(title, fontsize=10)
        axes[1, column].set_xlabel('time [s]')
    axes[0, 0].set_ylabel('position [rad]')
    axes[1, 0].set_ylabel('velocity [rad/s]')
    axes[0, 1].legend(fontsize=8)
    save(figure, 'setpoints')


if __name__ == '__main__':
    FOLDER.mkdir(exist_ok=True)
    with plt.rc_context(STYLE):
        for draw in (wrench, gravity, setpoints):
            draw()
