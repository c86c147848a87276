# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Needs of a program before it imports rclpy: environment variables of ROS, and packages."""

from __future__ import annotations

import fcntl
from importlib.util import find_spec
import os
from pathlib import Path
import re
import sys

from manip_sim.errors import ManipSimError
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import share_directory

#: DDS has no ports for more domains; Linux gives ports of these to outgoing connections.
_LAST_DOMAIN = 232
_SHARED_DOMAINS = (102, 214)
_RANGES = ('LOCALHOST', 'SUBNET', 'OFF', 'SYSTEM_DEFAULT', 'NOT_SET')
#: Ranges with which rmw_fastrtps takes its own transports, whatever the environment says.
_OWN_TRANSPORTS = ('LOCALHOST', 'NOT_SET')
#: Values of ROS's variable that mean Fast DDS.
_FAST_DDS = ('', 'rmw_fastrtps_cpp', 'rmw_fastrtps_dynamic_cpp')
#: Variables and files of the folder in which Fast DDS 2 and 3 look for profiles.
_PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_PROFILE_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')
#: Environment in which Fast DDS does without shared memory.
_WITHOUT = 'FASTDDS_BUILTIN_TRANSPORTS=UDPv4 and ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET'
#: Remedy for nodes that are found, but whose messages do not arrive.
SHARE_MEMORY = ('nodes of one machine need one /dev/shm: start containers with --ipc host, and as '
                f'one user, or set {_WITHOUT} for all nodes')
#: Names by which pip installs the modules from outside ROS.
_FROM_PIP = {'mujoco': 'mujoco', 'numpy': 'numpy', 'PIL': 'pillow', 'pydantic': 'pydantic',
             'yaml': 'pyyaml'}
#: Folder of Fast DDS for messages between processes, room that a node and its clients need there,
#: and most leftovers that an error names.
_SHARED_MEMORY, _NEEDED_BYTES, _NAMED = Path('/dev/shm'), 4_000_000, 5  # noqa: S108
_DISTRIBUTION = re.compile('[a-z]+')
_OF_VIEWER = ('msgspec', 'scipy', 'trimesh', 'viser', 'websockets')


def check_ros_environment() -> None:
    """
    Check variables that rcl reads: with a bad value it ends the process, or takes another one.

    These are ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE``, ``RMW_IMPLEMENTATION`` and
    those of SROS2.
    Without room in shared memory, Fast DDS ends the process by SIGBUS.

    :raises ManipSimError: naming the values that can be used, or what fills the shared memory
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
    keystore = os.environ.get('ROS_SECURITY_KEYSTORE', '')
    # Without it, rcl does without security, unless it is enforced, and says nothing.
    if os.environ.get('ROS_SECURITY_ENABLE') == 'true' and not os.path.isdir(keystore):
        raise ManipSimError('ROS_SECURITY_ENABLE is true, and ROS_SECURITY_KEYSTORE is no folder, '
                            f'got {quoted(keystore)}: create one (ros2 security), or unset '
                            'ROS_SECURITY_ENABLE')
    check_shared_memory()


def set_discovery_profile() -> None:
    """
    Let Fast DDS announce this process often on this machine, unless the user has a profile.

    With another range than ``LOCALHOST``, announcements would go to the whole network. What this
    sets are environment variables; it has no effect once a context was initialized.
    """
    if os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST' and not any(
            os.environ.get(name) for name in _PROFILE_VARIABLES) and not any(
            Path(name).exists() for name in _PROFILE_FILES):
        file = share_directory() / 'config' / 'fast_dds.xml'
        os.environ.update(dict.fromkeys(_PROFILE_VARIABLES, str(file)))


def check_shared_memory() -> None:
    """
    Check that shared memory has room, without which the import of rclpy may end the process.

    :raises ManipSimError: naming what fills it
    """
    if not _SHARED_MEMORY.is_dir() or not _uses_shared_memory():
        return
    file_system = os.statvfs(_SHARED_MEMORY)
    free = file_system.f_bavail * file_system.f_frsize
    if free >= _NEEDED_BYTES:
        return
    left = [file.with_name(file.name.removesuffix('_el'))
            for file in sorted(_SHARED_MEMORY.glob('fastrtps_*_el')) if not _is_locked(file)]
    left = [file for file in left if file.is_file()]
    size = sum(file.stat().st_size for file in left)
    names = ' '.join(f'{file.name}*' for file in left[:_NAMED])
    more = f' (and {len(left) - _NAMED} more)' if len(left) > _NAMED else ''
    raise ManipSimError(
        f'{_SHARED_MEMORY} has {free / 1e6:.1f} MB left, and ROS needs {_NEEDED_BYTES / 1e6:.0f} '
        'MB there: ' + (
            f'nodes that were killed have left {size / 1e6:.1f} MB, remove it with: cd '
            f'{_SHARED_MEMORY} && rm {names}{more}' if left else
            f'remove files, make it larger (docker run --shm-size 256m), or set {_WITHOUT}'))


def _uses_shared_memory() -> bool:
    if os.environ.get('RMW_IMPLEMENTATION', '') not in _FAST_DDS:
        return False
    transports = os.environ.get('FASTDDS_BUILTIN_TRANSPORTS', 'DEFAULT')
    return os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '') in _OWN_TRANSPORTS or not (
        'UDP' in transports or 'TCP' in transports)


def _is_locked(file: Path) -> bool:
    """Return whether a process uses a file of Fast DDS; one that has been killed does not."""
    try:
        with file.open() as opened:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # Also of a file of another user.
        return True
    return False


def _installed_middleware() -> list[str]:
    """Return the RMW implementations that the indexes of ROS list; none without an index."""
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
        spec = find_spec(module)
        return (f'{spec.origin if spec else module} cannot be used: {reason}; it is of another '
                'Python or another ROS than this program: in a new shell, source one ROS 2 only')
    if of_pip:
        return f"no module '{module}': install it with pip install {of_pip}"
    return (f"no module '{module}': source ROS 2 Jazzy or a later one, or install it from wheels "
            "with pip install 'manip_sim[jazzy]'")


def apt_names(*packages: str) -> str:
    """
    Return the names by which apt knows packages of ROS, separated by blanks.

    They are for the ROS 2 that is sourced, else for the one that the variable names.
    """
    sourced = os.environ.get('ROS_DISTRO', '')
    distribution = sourced if _DISTRIBUTION.fullmatch(sourced) else '$ROS_DISTRO'
    return ' '.join(f'ros-{distribution}-{package.replace("_", "-")}' for package in packages)
