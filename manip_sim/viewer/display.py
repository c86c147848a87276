# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check whether there is a screen."""

from __future__ import annotations

import os
import sys

from manip_sim.errors import ManipSimError

_SCREENS = ('DISPLAY', 'WAYLAND_DISPLAY')


def check_display() -> None:
    """
    Check that there is a screen.

    :raises ManipSimError: if there is none
    """
    if sys.platform == 'linux' and not any(os.environ.get(name) for name in _SCREENS):
        raise ManipSimError('--native needs a screen, and neither DISPLAY nor WAYLAND_DISPLAY is '
                            'set; without --native, any browser shows the page')
