# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a process holds, to see whether it grows."""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path


@dataclass(frozen=True)
class Usage:
    """What a process holds: memory [MB], threads and open descriptors."""

    memory_mb: float
    threads: int
    descriptors: int

    @staticmethod
    def of(pid: int) -> Usage:
        """Read it for a process that runs."""
        lines = Path(f'/proc/{pid}/status').read_text().splitlines()
        status = dict(line.split(':', 1) for line in lines)
        return Usage(int(status['VmRSS'].split()[0]) / 1024, int(status['Threads']),
                     len(os.listdir(f'/proc/{pid}/fd')))

    def since(self, before: Usage) -> str:
        """Return the growth since a usage before, as the table shows it."""
        return (f'{self.memory_mb - before.memory_mb:+.1f} to {self.memory_mb:.0f} MB, '
                f'{self.threads - before.threads:+d} threads, '
                f'{self.descriptors - before.descriptors:+d} descriptors')
