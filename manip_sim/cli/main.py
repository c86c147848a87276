# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The command ``manip_sim``: dispatch to a command, exit codes, and errors in one line.

It imports little: a command imports what it needs when it runs.
"""

from __future__ import annotations

from collections.abc import Sequence
import gc
import importlib
import logging
import os
import sys

from manip_sim.cli.command_line import parse
from manip_sim.cli.output import UsageError
from manip_sim.errors import ManipSimError
from manip_sim.quoting import one_line
from manip_sim.startup import use_one_blas_thread

PROBLEM, WRONG_USE = 1, 2


def run() -> int:
    """
    Run the command as a process of its own.

    :returns: the exit code: 0; 1 if something is wrong or cannot be done; 2 if the command line is
    """
    use_one_blas_thread()
    logging.basicConfig(format='manip_sim: %(message)s', level=logging.WARNING)
    try:
        return main()
    except SystemExit as ended:  # By argparse: help, or a wrong command line.
        return _report() or int(ended.code or 0)
    except Exception as error:  # A defect of the package, or of a model from another one.
        if sys.flags.dev_mode:
            raise
        return _fail(f'unexpected {type(error).__name__}: {error} (where: python3 -X dev -m '
                     'manip_sim.cli, and the same arguments)')


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run a command.

    :returns: the exit code
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    # MuJoCo reads this variable when it is imported.
    if words[:1] not in (['render'], ['run'], ['compare']) and 'mujoco' not in sys.modules:
        os.environ['MUJOCO_GL'] = 'disable'
    try:
        options = parse(arguments)
        module, _, function = options.module.partition(':')
        command = options.verb or importlib.import_module(f'manip_sim.cli.{module}')
        gc.enable()
        text, code = getattr(command, function or 'run')(options)
    except UsageError as error:
        return _fail(str(error), WRONG_USE)
    except ManipSimError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f'{error.filename or words[0]}: {error.strerror or error}')
    return _report(text) or int(code)


def _report(text: str = '') -> int:
    """Print a text and flush the output; return an exit code other than zero if that fails."""
    if sys.stdout is None:
        return 0
    try:
        if text:
            encoding = sys.stdout.encoding or 'utf-8'
            print(text.encode(encoding, 'backslashreplace').decode(encoding))
        sys.stdout.flush()
    except OSError as error:
        # Python flushes once more when it exits, then to the null device.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):  # Otherwise the reader has ended.
            return _fail(f'cannot write the output: {error.strerror}')
    return 0


def _fail(message: str, code: int = PROBLEM) -> int:
    print(f'manip_sim: {one_line(message, 2000)}', file=sys.stderr)
    return code
