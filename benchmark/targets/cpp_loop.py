# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The plain loop in C++, built where CMake and rclcpp are found."""

from __future__ import annotations

import atexit
from functools import cache
import os
from pathlib import Path
import shutil
import subprocess
import tempfile

import mujoco

SOURCE = Path(__file__).resolve().parents[1] / 'cpp_loop'
REMEDY = ('C++ loop: {} is not found; install CMake and a ROS 2 with rclcpp, and source its '
          'setup.bash')


@cache
def build() -> tuple[Path | None, str]:
    """
    Build the loop, once in a process, in a folder that goes with the process.

    :returns: the program, or None and a line that says why not
    """
    if shutil.which('cmake') is None:
        return None, REMEDY.format('CMake')
    folder = Path(tempfile.mkdtemp(prefix='manip_sim_cpp_loop_'))
    atexit.register(shutil.rmtree, folder)
    prefixes = os.environ.get('CMAKE_PREFIX_PATH') or os.environ.get('AMENT_PREFIX_PATH', '')
    for arguments in (['-S', str(SOURCE), '-B', str(folder), '-Wno-dev',
                       f'-DMUJOCO={Path(mujoco.__file__).parent}',
                       f'-DCMAKE_PREFIX_PATH={prefixes.replace(os.pathsep, ";")}'],
                      ['--build', str(folder)]):
        done = subprocess.run(['cmake', *arguments], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True)
        if 'no rclcpp' in done.stdout:
            return None, REMEDY.format('rclcpp')
        if done.returncode:
            return None, f'C++ loop: not built: {" ".join(done.stdout[-1000:].split())}'
    return folder / 'cpp_loop', ''
