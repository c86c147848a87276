# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How programs that may render later, or never, import MuJoCo."""

from __future__ import annotations

import os


def import_mujoco() -> None:
    """
    Import MuJoCo without OpenGL.

    MuJoCo would look for it in processes of their own, which takes long and outlives a signal, and
    could not be imported where ``MUJOCO_GL`` asks for something that is not there.
    """
    asked = os.environ.get('MUJOCO_GL')
    os.environ['MUJOCO_GL'] = 'disable'
    try:
        import mujoco  # noqa: F401
    finally:
        del os.environ['MUJOCO_GL']
        if asked is not None:
            os.environ['MUJOCO_GL'] = asked
