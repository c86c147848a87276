# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Let MuJoCo Warp take what ``manip_sim export`` writes, and compare its steps with MuJoCo's.

On the CPU, in as many worlds as ``--worlds`` says, without any change of the exported file but
MuJoCo's default ``ccd_tolerance``: with ours, Warp loses contacts, as it computes in single
precision. The table has the largest difference of a joint from MuJoCo's after the steps. The exit
code is 1 if a robot is not taken or differs by more than 1 mrad or 1 mm.

    pip install mujoco-warp
    python3 benchmark/exported.py [--worlds 2] [--steps 50] [--robots Panda UR5e]
"""

from __future__ import annotations

import argparse
import contextlib
import io
from pathlib import Path
import sys
import tempfile
import time

import mujoco
import numpy as np

from manip_sim.cli.main import main as manip_sim
from manip_sim.models import compose
from manip_sim.models.robots import robot_names

#: MuJoCo's default tolerance of collisions between convex shapes.
_CCD_TOLERANCE = 1e-6
#: Largest difference that single precision may make [rad or m].
_LARGEST = 1e-3


def differences(file: Path, name: str, worlds: int, steps: int) -> float:
    """Return by how much joints differ at most after some steps from the start [rad or m]."""
    import mujoco_warp as warp
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.ccd_tolerance = _CCD_TOLERANCE
    data = mujoco.MjData(model)
    for joint, position in compose(name, arena='table').init_qpos().items():
        data.joint(joint).qpos[0] = position
    mujoco.mj_forward(model, data)
    on_warp, state = warp.put_model(model), warp.put_data(model, data, nworld=worlds)
    for _ in range(steps):
        warp.step(on_warp, state)
    mujoco.mj_step(model, data, steps)
    return float(np.abs(state.qpos.numpy() - data.qpos).max())


def main() -> int:
    """Export, step and print."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--worlds', type=int, default=2)
    parser.add_argument('--steps', type=int, default=50)
    parser.add_argument('--robots', nargs='+', default=robot_names(), choices=robot_names())
    arguments = parser.parse_args()
    try:
        import warp
        import mujoco_warp
    except ImportError as error:
        print(f'skipped: {error} (pip install mujoco-warp)')
        return 0
    warp.config.log_level = warp.LOG_WARNING
    warp.set_device('cpu')
    print(f'MuJoCo {mujoco.__version__}, Warp {warp.__version__}, mujoco_warp '
          f'{mujoco_warp.__version__}, {arguments.worlds} worlds, {arguments.steps} steps')
    failed = False
    for name in arguments.robots:
        with tempfile.TemporaryDirectory() as folder:
            file, begin = Path(folder, f'{name}.xml'), time.perf_counter()
            with contextlib.redirect_stdout(io.StringIO()):
                manip_sim(['export', str(file), '--robot', name, '--arena', 'table'])
            try:
                largest = differences(file, name, arguments.worlds, arguments.steps)
            except Exception as error:  # It may raise anything, and the others shall be tried.
                found, failed = f'refused: {type(error).__name__}: {error}', True
            else:
                failed |= not largest <= _LARGEST
                found = f'taken; joints differ by {largest:.1e} rad or m at most'
        print(f'{name:11} {found} ({time.perf_counter() - begin:.0f} s)', flush=True)
    return int(failed)


if __name__ == '__main__':
    sys.exit(main())
