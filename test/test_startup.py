# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the programs load with NumPy and MuJoCo, each looked at in a process of its own."""

import os
import subprocess
import sys

import pytest

IMPORT = """
import os, sys
from manip_sim.startup import import_mujoco
import_mujoco()
print('OpenGL' in sys.modules or 'glfw' in sys.modules, os.environ.get('MUJOCO_GL'),
      os.environ.get('OPENBLAS_NUM_THREADS'))
"""
#: Runs a program, and tells what NumPy finds when it is imported.
WATCH = """
import os, sys

class Watch:
    def find_spec(self, name, *_):
        if name == 'numpy':
            print('numpy', os.environ.get('OPENBLAS_NUM_THREADS'))

sys.meta_path.insert(0, Watch())
sys.argv[1:] = {arguments}
from {module} import {main}
print('code', {main}())
"""
WRONG = ['--ros-args', '-r', 'nonsense']


def seen(script, **variables):
    """Return the lines that a script prints, without our variables but those given."""
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('MUJOCO_GL', 'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')}
    done = subprocess.run([sys.executable, '-c', script], env={**environment, **variables},
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_mujoco_is_imported_without_opengl_and_without_threads_for_linear_algebra():
    assert seen(IMPORT) == ['False None 1']


def test_what_the_user_chose_stands():
    assert seen(IMPORT, MUJOCO_GL='nonsense', OPENBLAS_NUM_THREADS='2') == ['False nonsense 2']
    assert seen(IMPORT, OMP_NUM_THREADS='2') == ['False None None']


@pytest.mark.parametrize(('module', 'main', 'arguments', 'needed', 'code'), [
    ('manip_sim.cli.main', 'run', ['describe'], (), 0),
    ('manip_sim.__main__', 'main', WRONG, ('rclpy',), 1),
    ('manip_sim.viewer.__main__', 'main', WRONG, ('rclpy', 'viser'), 1)])
def test_numpy_is_imported_when_one_thread_is_chosen(module, main, arguments, needed, code):
    for package in needed:
        pytest.importorskip(package, reason=f'the program needs {package}')
    lines = seen(WATCH.format(module=module, main=main, arguments=arguments))
    assert (lines[0], lines[-1]) == ('numpy 1', f'code {code}')
