# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The example of ``docs/how_to/cartesian.md`` that needs no ROS, run."""

from pathlib import Path
import re

import numpy as np

from manip_sim.control.commands import Status

DOCUMENT = (Path(__file__).resolve().parents[1] / 'docs' / 'how_to' / 'cartesian.md').read_text()


def test_the_example_of_the_document_runs():
    (script,) = [block for block in re.findall(r'```python\n(.*?)```', DOCUMENT, re.DOTALL)
                 if 'rclpy' not in block]
    names = {}
    exec(script, names)
    assert names['command'].handle.status is Status.DONE
    assert np.abs(names['command'].handle.error).max() < 1e-3
