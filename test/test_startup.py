# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the programs load with NumPy and MuJoCo, each looked at in a process of its own."""

import os
import subprocess
import sys

import pytest

LOOK = """
import os, sys
print(len(os.listdir('/proc/self/task')), 'OpenGL' in sys.modules or 'glfw' in sys.modules,
      os.environ.get('MUJOCO_GL'), os.environ.get('OPENBLAS_NUM_THREADS'))
"""
IMPORT = f'from manip_sim.startup import import_mujoco; import_mujoco(){LOOK}'
COMMAND = f"""
import sys
from manip_sim.cli.main import run
sys.argv[1:] = ['describe']
assert run() == 0 and 'numpy' in sys.modules{LOOK}"""
pytestmark = pytest.mark.skipif(not os.path.isdir('/proc/self/task'),
                                reason='threads are counted by Linux')


def seen(script, **variables):
    """Return threads, whether OpenGL is loaded, and two variables, after a script."""
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('MUJOCO_GL', 'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')}
    done = subprocess.run([sys.executable, '-c', script], env={**environment, **variables},
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1].split()


def test_mujoco_is_imported_without_opengl_and_without_threads_for_linear_algebra():
    assert seen(IMPORT) == ['1', 'False', 'None', '1']


def test_what_the_user_chose_stands():
    assert seen(IMPORT, MUJOCO_GL='nonsense', OPENBLAS_NUM_THREADS='2')[1:] == [
        'False', 'nonsense', '2']
    assert seen(IMPORT, OMP_NUM_THREADS='2')[1:] == ['False', 'None', 'None']


def test_a_command_starts_no_thread():
    assert seen(COMMAND)[::3] == ['1', '1']
