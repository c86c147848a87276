# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``python3 -m manip_sim.cli`` is the command ``manip_sim``."""

import sys

from manip_sim.cli.main import run

if __name__ == '__main__':
    sys.exit(run())
