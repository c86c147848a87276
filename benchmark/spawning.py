# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What adding and deleting an object costs in a world that has many, beside MuJoCo alone.

Planning runs in another thread than the physics, changing delays the physics. ``compile`` is what
MuJoCo needs for the same world, ``mj_setConst`` the greatest part of that, which grows with the
square of the degrees of freedom. Rounds alternate; each figure is the least CPU time [ms].
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import time
from typing import Any

import mujoco

from manip_sim.models import compose
from manip_sim.models.object_creation import create_object, ObjectModel
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation
from manip_sim.startup import use_one_blas_thread

_COUNTS, _ROUNDS = (1, 100, 200, 400), 7


def _box(number: int) -> ObjectModel:
    return create_object({'name': f'box{number}', 'shape': 'box', 'size': [0.03] * 3,
                          'position': [0.1 * (number % 20), 0.1 * (number // 20), 0.9]})


def main() -> None:
    """Print a row for each count of objects."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    use_one_blas_thread()
    print(f'{"objects":>8}', *(f'{name:>15}' for name in (
        'plan spawn', 'plan delete', 'change', 'compile', 'mj_setConst')))
    for count in _COUNTS:
        simulation = Simulation(compose(
            'Panda', arena='table', cube=False, objects=[_box(i) for i in range(count)]))
        least: dict[str, float] = {}

        def timed(name: str, function: Callable[[], Any], least: dict[str, float] = least) -> Any:
            begin = time.thread_time()
            result = function()
            least[name] = min(least.get(name, 1e9), 1e3 * (time.thread_time() - begin))
            return result

        for _ in range(_ROUNDS):
            new = _box(count)
            plan = timed('plan spawn', lambda: plan_with(simulation.plan, new))  # noqa: B023
            timed('compile', plan.spec.copy().compile)
            data = mujoco.MjData(plan.compiled)
            timed('mj_setConst', lambda: mujoco.mj_setConst(plan.compiled, data))  # noqa: B023
            timed('change', lambda: simulation.change_objects(plan))  # noqa: B023
            less = timed('plan delete', lambda: plan_without(
                simulation.plan, f'box{count}'))  # noqa: B023
            timed('change', lambda: simulation.change_objects(less))  # noqa: B023
        print(f'{count:8d}', *(f'{least[name]:15.1f}' for name in (
            'plan spawn', 'plan delete', 'change', 'compile', 'mj_setConst')), flush=True)


if __name__ == '__main__':
    main()
