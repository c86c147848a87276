# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Start ``sim_node`` once for each of several lists of arguments, in a process of its own each.

The processes are forks of this one, which has imported what all of them need: that is most of what
a start takes. It reads lists of arguments, and writes exit code, output and errors of each, as
JSON.
"""

from __future__ import annotations

from collections.abc import Sequence
import json
import os
import subprocess
import sys
import tempfile
from typing import NamedTuple

#: A start that should fail and goes on is ended after so long [s].
_TIMEOUT_S = 300


class Start(NamedTuple):
    """
    How a start ended.

    :ivar code: exit code, negative for a signal
    """

    code: int
    output: str
    errors: str


def starts(arguments: Sequence[Sequence[str]]) -> list[Start]:
    """Return how starts with some arguments end, one after the other."""
    done = subprocess.run([sys.executable, __file__], input=json.dumps([*map(list, arguments)]),
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [Start(*fields) for fields in json.loads(done.stdout)]


def _start(arguments: list[str]) -> Start:
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        child = os.fork()
        if not child:
            import signal
            os.dup2(output.fileno(), 1)
            os.dup2(errors.fileno(), 2)
            signal.alarm(_TIMEOUT_S)
            sys.argv = ['sim_node', *arguments]
            # The end of the process is that of any other: what is left to do then is done.
            sys.exit(main())
        _, status = os.waitpid(child, 0)
        texts = []
        for file in (output, errors):
            file.seek(0)
            texts.append(file.read().decode())
    return Start(os.waitstatus_to_exitcode(status), *texts)


if __name__ == '__main__':
    from manip_sim.__main__ import main
    from manip_sim.startup import import_mujoco
    import_mujoco()
    import manip_sim.ros.process  # noqa: F401
    found = []
    for words in json.load(sys.stdin):
        found.append(_start(words))
    print(json.dumps(found))
