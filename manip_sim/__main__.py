# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Entry point of ``sim_node`` and ``python3 -m manip_sim``.

It imports little, so that a signal during the slow imports ends the process as cleanly as later.
"""

from __future__ import annotations

import sys

from manip_sim.startup import import_mujoco, run_program, without_ros_arguments

_HELP = """\
usage: sim_node [--help] [--ros-args -p NAME:=VALUE ...]

Serve a simulated robot over ROS 2 until Ctrl-C, SIGTERM or SIGHUP.

  sim_node --ros-args -p robot:=Panda -p arena:=table

Parameters, topics and services are listed in docs/reference; while the node
runs, 'ros2 param describe /manip_sim NAME' describes a parameter."""


def main() -> int:
    """
    Run the node.

    :returns: exit code: 0 after SIGINT, SIGTERM, SIGHUP or --help, 1 on failure, 2 for a wrong
        argument
    """
    return run_program(_run)


def _run() -> int:
    arguments = sys.argv[1:]
    ours = without_ros_arguments(arguments)
    if ours and ours[0] in ('-h', '--help'):
        print(_HELP)
        return 0
    if ours:
        print(f"sim_node: unknown argument '{ours[0]}': parameters such as '-p robot:=Panda' come "
              "after '--ros-args'; see --help", file=sys.stderr)
        return 2
    from manip_sim.errors import ManipSimError
    from manip_sim.ros_environment import check_ros_environment, missing_module
    try:
        check_ros_environment()
        import_mujoco()
        from manip_sim.ros.process import run
    except ImportError as error:
        return _fail(missing_module(error))
    except ManipSimError as error:
        return _fail(str(error))
    return run(arguments)


def _fail(message: str) -> int:
    print(f'sim_node: {message}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
