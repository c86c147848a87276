# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cost of the parts of a control period of five steps in process, against the bare physics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import math
import time
from types import SimpleNamespace
from typing import Any

from targets.figures import Figure, Settings
from targets.physics import Bare, panda
from targets.robots import rate

from manip_sim.simulation import Simulation
from manip_sim.simulation.compiled_period import load

STEPS = 5
_ROUND_S = 0.3


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure them one after the other, each beside the bare physics."""
    simulation = panda(0.002)
    bare = Bare(simulation)
    load()  # As a node does at its start.
    duration_s = _ROUND_S * settings.scale
    with contextlib.ExitStack() as stack:
        parts: list[tuple[str, Callable[[], Any]]] = [
            ('advance, at rest', lambda: simulation.advance(STEPS)),
            ('state', simulation.robot.state)]
        publish = _publishing(simulation, stack)
        if publish is not None:
            parts.append(('publish, nobody listens', publish))
        parts.append(('advance with goals that are streamed', _streaming(simulation)))
        for what, part in parts:
            settings.report(f'period, {what}')
            ratios = []
            for _ in range(settings.rounds):
                ours = rate(part, duration_s)
                ratios.append(bare.steps_per_s(duration_s, STEPS, time.thread_time) / STEPS / ours)
            yield Figure('period', f'period of {STEPS} steps: {what}, times bare `mj_step`',
                         ratios)


def _streaming(simulation: Simulation) -> Callable[[], object]:
    """Return a function that commands a goal for all joints of the arm, and advances."""
    robot = simulation.robot
    names = [name for name in robot.parts['arm'].driven_joints if name]
    start = robot.state().position[:len(names)]

    def period() -> None:
        goal = start + 0.05 * math.sin(2.0 * simulation.time_s)
        robot.apply(*robot.parse.joint_command(names, goal),
                    period_s=STEPS * simulation.timestep_s)
        simulation.advance(STEPS)
    return period


def _publishing(simulation: Simulation, stack: contextlib.ExitStack
                ) -> Callable[[], object] | None:
    """Return a function that publishes to no subscriber, reading no state; None without ROS."""
    try:
        import rclpy
    except ImportError:
        return None
    from manip_sim.interface.profiles import JointNames
    from manip_sim.interface.topics import Scope
    from manip_sim.ros.channel_publishers import robot_states
    from manip_sim.ros.executor import RejectionLog
    rclpy.init()
    stack.callback(rclpy.shutdown)
    node = rclpy.create_node('period')
    stack.callback(node.destroy_node)
    context: Any = SimpleNamespace(
        node=node, log=RejectionLog(node.get_logger()), inbox=None, publishing=None,
        frame_prefix='', joint_names=JointNames(),
        is_built=False, robots={Scope(): simulation.robot}, table=[],
        thread=SimpleNamespace(observe=lambda *_: None))
    publishers = robot_states(context)
    return lambda: publishers.publish(simulation)
