# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files that MuJoCo cannot take, and what MuJoCo warns of."""

import logging
import math
import os
import re
import subprocess
import sys

import mujoco
import pytest

LOAD_WITH_LITTLE_MEMORY = """
import resource
import sys
from pathlib import Path
from manip_sim.errors import ModelError
from manip_sim.models.loading import compile_spec, load_spec
used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (50 << 20), used + (50 << 20)))
try:
    compile_spec(load_spec(Path(sys.argv[1])), 'model')
except ModelError as error:
    print(error)
"""


@pytest.mark.full
def test_a_height_field_that_does_not_fit_into_memory_is_told(mjcf):
    file = mjcf(sections='<asset><hfield name="h" nrow="4000" ncol="4000" size="1 1 1 1"/>'
                         '</asset>')
    child = subprocess.run([sys.executable, '-c', LOAD_WITH_LITTLE_MEMORY, str(file)],
                           capture_output=True, text=True, timeout=60.0)
    assert child.returncode == 0, child.stderr
    assert re.search(r'model\.xml is not MJCF that MuJoCo can read: |^model does not compile: ',
                     child.stdout)


def test_a_warning_of_mujoco_is_logged_and_not_written_to_a_file(panda_sim, caplog):
    panda_sim.data.ctrl[0] = math.nan
    with caplog.at_level(logging.WARNING):
        mujoco.mj_step(panda_sim.model, panda_sim.data)
    assert any('CTRL' in record.message for record in caplog.records)
    assert os.listdir('.') == []
