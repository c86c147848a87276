# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Import MuJoCo in programs that render later, or never."""

from __future__ import annotations

import os


def import_mujoco() -> None:
    """
    Import MuJoCo without OpenGL.

    Otherwise MuJoCo looks for OpenGL in child processes, which take long and outlive a signal, and
    its import fails where ``MUJOCO_GL`` names a backend that is not available.
    """
    asked = os.environ.get('MUJOCO_GL')
    os.environ['MUJOCO_GL'] = 'disable'
    try:
        import mujoco  # noqa: F401
    finally:
        del os.environ['MUJOCO_GL']
        if asked is not None:
            os.environ['MUJOCO_GL'] = asked
