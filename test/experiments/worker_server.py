# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Import once what processes of runs need, which are forked from this one."""

import functools
import os

from manip_sim.control.law.loading import load_laws
from manip_sim.experiments import processes

load_laws()


class ServeInEnvironment:
    """Serve as a process of a run does, with the variables of the one that asks."""

    def __reduce__(self):
        return functools.partial, (_serve, dict(os.environ))


def _serve(environment, *arguments):
    os.environ.clear()
    os.environ.update(environment)
    processes._serve(*arguments)
