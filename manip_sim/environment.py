# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a program needs before it imports rclpy: environment variables of ROS, and packages."""

from __future__ import annotations

import os
from pathlib import Path
import re
import sys

from manip_sim.errors import ManipSimError
from manip_sim.quoting import quoted

#: DDS has no ports for more domains; Linux gives ports of these to outgoing connections.
_LAST_DOMAIN = 232
_SHARED_DOMAINS = (102, 214)
#: Names by which pip installs the modules that are no part of ROS.
_FROM_PIP = {'mujoco': 'mujoco', 'numpy': 'numpy', 'PIL': 'pillow', 'pydantic': 'pydantic',
             'yaml': 'pyyaml'}
_OF_VIEWER = ('scipy', 'trimesh', 'viser')


def check_ros_environment() -> None:
    """
    Check ``ROS_DOMAIN_ID`` and ``RMW_IMPLEMENTATION``; with a bad value rcl ends the process.

    :raises ManipSimError: naming the values that can be used
    """
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if domain and not (re.fullmatch('[0-9]+', domain) and int(domain[:9]) <= _LAST_DOMAIN):
        low, high = _SHARED_DOMAINS
        raise ManipSimError(
            f'ROS_DOMAIN_ID must be a whole number from 0 to {_LAST_DOMAIN}, got '
            f'{quoted(domain)}; best below {low} or above {high}: Linux uses the ports of those '
            'between for outgoing connections')
    chosen, installed = os.environ.get('RMW_IMPLEMENTATION', ''), _installed_middleware()
    if chosen and installed and chosen not in installed:
        raise ManipSimError(f'RMW_IMPLEMENTATION is {quoted(chosen)}, which is not installed; '
                            f'installed: {", ".join(installed)}')


def _installed_middleware() -> list[str]:
    """Return the RMW implementations that the indexes of ROS list; none if there is no index."""
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    return sorted({file.name for prefix in prefixes if prefix for file in Path(
        prefix, 'share', 'ament_index', 'resource_index', 'rmw_typesupport').glob('*')
        if file.name != 'rmw_implementation'})


def missing_module(error: ModuleNotFoundError) -> str:
    """
    Return which module is missing and how to install it.

    :raises ModuleNotFoundError: the same, if it is a module of this package
    """
    module = str(error.name).partition('.')[0]
    if module in ('manip_sim', 'None'):
        raise error
    if module in _FROM_PIP:
        return f"no module '{module}': install it with pip install {_FROM_PIP[module]}"
    if module in _OF_VIEWER:
        return f"no module '{module}': install it with pip install 'manip_sim[viewer]'"
    return (f"no module '{module}': source ROS 2 Jazzy, or install it from wheels with "
            "pip install 'manip_sim[jazzy]'")
