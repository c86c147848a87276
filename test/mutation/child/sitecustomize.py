# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Record which lines a process runs that a test starts; Python imports this before all else."""

import atexit
import os
import sys
from typing import NoReturn

import coverage

_tracer = coverage.Coverage(
    data_file=os.environ['MUTATION_CHILDREN'], data_suffix=True, config_file=False,
    include=os.environ['MUTATION_SOURCES'].split(','), context=os.environ['MUTATION_CONTEXT'])
_exit = os._exit


def _save() -> None:
    _tracer.stop()
    _tracer.save()


def _save_and_exit(status: int) -> NoReturn:
    if sys.is_finalizing() is False:
        _save()
    _exit(status)


atexit.register(_save)
os._exit = _save_and_exit
_tracer.start()
