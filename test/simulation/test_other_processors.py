# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The same commands give the same bits with the linear algebra of another processor."""

import os
from pathlib import Path
import platform
import subprocess
import sys

import pytest

pytestmark = pytest.mark.full

#: Kernels of OpenBLAS that every x86-64 processor runs, and one for newer ones.
KERNELS = ['Prescott', 'Nehalem', 'Haswell']
SCRIPT = """
import hashlib
import numpy as np
from episodes import digests
from end_effector_operator import operator_of
random = np.random.default_rng(0)
digest = hashlib.blake2b(digest_size=8)
matrix = random.normal(size=(64, 64))
print(hashlib.blake2b((matrix @ matrix).tobytes(), digest_size=8).hexdigest())
for name, mode in (('Panda', 'position'), ('Panda', 'effort'), ('Baxter', 'position')):
    op = operator_of(name, mode=mode)
    op.run(0.2, lambda: op.move_at(0.1 * random.normal(size=3), 0.2 * random.normal(size=3)))
    op.run(0.3, lambda: op.act(*np.clip(random.normal(size=6), -1.0, 1.0)))
    op.go_to(op.reachable(0.5, 1))
    op.run(0.4)
    op.go_to((op.pose[0] + [0.0, 1.5, 0.3], op.pose[1]))
    op.run(0.8)
    data = op.simulation.data
    digest.update(data.qpos.tobytes() + data.qvel.tobytes() + data.qfrc_actuator.tobytes())
for of_episode in digests(0, 9):
    digest.update(of_episode.encode())
print(digest.hexdigest())
"""


@pytest.mark.skipif(platform.machine() != 'x86_64', reason='the kernels are for x86-64')
def test_poses_twists_and_actions_do_not_depend_on_the_kernels_of_the_blas():
    found = []
    flags = Path('/proc/cpuinfo').read_text().split()
    path = os.pathsep.join(map(str, Path(__file__).parents[:2]))
    for kernel in KERNELS[:2] + KERNELS[2:] * ('avx2' in flags):
        environment = os.environ | {'OPENBLAS_CORETYPE': kernel, 'OPENBLAS_NUM_THREADS': '1',
                                    'PYTHONPATH': path}
        found.append(subprocess.run([sys.executable, '-c', SCRIPT], env=environment, check=True,
                                    capture_output=True, text=True).stdout.split())
    products, digests = zip(*found)
    # The products of NumPy themselves show that the kernels differ.
    assert len(set(products)) > 1
    assert len(set(digests)) == 1
