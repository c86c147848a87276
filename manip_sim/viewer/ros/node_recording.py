# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A record of the node, written by ``manip_sim record`` in a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
import subprocess
import sys
import time

#: Longest wait for a record to be completed when the viewer ends [s].
_CLOSING_S = 10.0


class NodeRecording:
    """
    A record that begins and ends when people say so.

    :param node: full name of the node, such as ``/manip_sim``
    :param folder: where the files are written
    :param report: called with a text, and whether it is a record that was written
    """

    def __init__(self, node: str, folder: Path, report: Callable[[str, bool], None]) -> None:
        self._node, self._folder, self._report = node, folder, report
        self._process: subprocess.Popen[str] | None = None

    @property
    def is_running(self) -> bool:
        return self._process is not None

    def record(self, wanted: bool) -> None:
        """Begin a record, or end the present one; what is so already is ignored."""
        if self._process is None and wanted:
            name = self._node.rpartition('/')[2]
            file = self._folder / f'{name}_{time.strftime("%Y%m%d_%H%M%S")}.mcap'
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'manip_sim.cli', 'record', str(file), '--node', self._node],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True)
        elif self._process is not None and not wanted:
            self._process.send_signal(signal.SIGINT)

    def update(self) -> None:
        """Report a record that has ended; to be called from time to time."""
        if self._process is not None and self._process.poll() is not None:
            process, self._process = self._process, None
            lines = process.communicate()[0].strip().splitlines()
            self._report(lines[-1] if lines else 'the record has ended', not process.returncode)

    def close(self) -> None:
        """End the present record, and wait for its file."""
        self.record(False)
        if self._process is not None:
            try:
                self._process.communicate(timeout=_CLOSING_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.communicate()
            self._process = None
