# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Whether there is a screen, and how MuJoCo is imported without one."""

from __future__ import annotations

import os
import sys

from manip_sim.errors import ManipSimError

_SCREENS = ('DISPLAY', 'WAYLAND_DISPLAY')


def check_display() -> None:
    """
    Look for a screen.

    :raises ManipSimError: if there is none
    """
    if sys.platform == 'linux' and not any(os.environ.get(name) for name in _SCREENS):
        raise ManipSimError('--native needs a screen, and neither DISPLAY nor WAYLAND_DISPLAY is '
                            'set; without --native, any browser shows the page')


def import_mujoco() -> None:
    """Import MuJoCo without looking for OpenGL, which only its own viewer needs."""
    asked = os.environ.get('MUJOCO_GL')
    os.environ['MUJOCO_GL'] = 'disable'
    try:
        import mujoco  # noqa: F401
    finally:
        del os.environ['MUJOCO_GL']
        if asked is not None:
            os.environ['MUJOCO_GL'] = asked
