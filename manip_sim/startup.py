# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The environment for the slow imports of NumPy and MuJoCo: no BLAS threads, no OpenGL."""

from __future__ import annotations

import os


def use_one_blas_thread() -> None:
    """
    Let NumPy start without threads for linear algebra.

    ``OPENBLAS_NUM_THREADS`` and ``OMP_NUM_THREADS`` count, where they are set.

    A robot's matrices are too small for them, and after the import of NumPy the OpenBLAS threads
    busy-wait: a quarter of the processor time of a node's start on two processors.
    """
    if 'OMP_NUM_THREADS' not in os.environ:
        os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')


def import_mujoco() -> None:
    """
    Import MuJoCo without OpenGL, in programs that render later, or never.

    Otherwise MuJoCo looks for OpenGL in child processes, which take long and outlive a signal, and
    its import fails where ``MUJOCO_GL`` names a backend that is not available.
    """
    use_one_blas_thread()
    asked = os.environ.get('MUJOCO_GL')
    os.environ['MUJOCO_GL'] = 'disable'
    try:
        import mujoco  # noqa: F401
    finally:
        del os.environ['MUJOCO_GL']
        if asked is not None:
            os.environ['MUJOCO_GL'] = asked
