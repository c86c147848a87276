# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a program needs before it imports rclpy: environment variables of ROS, and packages."""

from __future__ import annotations

from importlib.util import find_spec
import os
from pathlib import Path
import re
import sys

from manip_sim.errors import ManipSimError
from manip_sim.quoting import one_line, quoted

#: DDS has no ports for more domains; Linux gives ports of these to outgoing connections.
_LAST_DOMAIN = 232
_SHARED_DOMAINS = (102, 214)
_RANGES = ('LOCALHOST', 'SUBNET', 'OFF', 'SYSTEM_DEFAULT', 'NOT_SET')
#: Names by which pip installs the modules that are no part of ROS.
_FROM_PIP = {'mujoco': 'mujoco', 'numpy': 'numpy', 'PIL': 'pillow', 'pydantic': 'pydantic',
             'yaml': 'pyyaml'}
_OF_VIEWER = ('scipy', 'trimesh', 'viser')


def check_ros_environment() -> None:
    """
    Check variables that rcl reads: with a bad value it ends the process, or takes another one.

    These are ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE`` and ``RMW_IMPLEMENTATION``.

    :raises ManipSimError: naming the values that can be used
    """
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if domain and not (re.fullmatch('[0-9]+', domain) and int(domain[:9]) <= _LAST_DOMAIN):
        low, high = _SHARED_DOMAINS
        raise ManipSimError(
            f'ROS_DOMAIN_ID must be a whole number from 0 to {_LAST_DOMAIN}, got '
            f'{quoted(domain)}; best below {low} or above {high}: Linux uses the ports of those '
            'between for outgoing connections')
    found_by = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '')
    if found_by and found_by not in _RANGES:
        raise ManipSimError('ROS_AUTOMATIC_DISCOVERY_RANGE must be one of '
                            f'{", ".join(_RANGES[:-1])}, got {quoted(found_by)}')
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


def missing_module(error: ImportError) -> str:
    """
    Return which module is missing, or cannot be used, and what to do.

    :raises ImportError: the same, if it is a module of this package
    """
    name = str(error.name)
    module = name.partition('.')[0]
    if module in ('manip_sim', 'None'):
        raise error
    of_pip = _FROM_PIP.get(module) or ("'manip_sim[viewer]'" if module in _OF_VIEWER else None)
    if not isinstance(error, ModuleNotFoundError) or '._' in name:
        reason = one_line(str(error).partition('\n')[0])
        if of_pip:
            return f"module '{module}' cannot be used: {reason}"
        found = find_spec(module)
        return (f'{found.origin if found else module} cannot be used: {reason}; it is of another '
                'Python or another ROS than this program: in a new shell, source ROS 2 Jazzy only')
    if of_pip:
        return f"no module '{module}': install it with pip install {of_pip}"
    return (f"no module '{module}': source ROS 2 Jazzy, or install it from wheels with "
            "pip install 'manip_sim[jazzy]'")
