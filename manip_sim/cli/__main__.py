# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Entry point of ``manip_sim`` and ``python3 -m manip_sim.cli``."""

import gc
import signal
import sys

from manip_sim.startup import open_standard_streams, spare_garbage


def run() -> int:
    """Run the command as a process of its own; return the code of ``manip_sim.cli.main.run``."""
    # Ctrl-C ends it as it ends other commands, also during the imports.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_standard_streams()
    gc.disable()  # Nothing that is imported is garbage; main() enables it.
    from manip_sim.cli.main import run
    try:
        return run()
    finally:
        spare_garbage()


if __name__ == '__main__':
    sys.exit(run())
