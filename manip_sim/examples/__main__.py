# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Entry point of ``pick_cube`` and ``hand_over``, and of ``python3 -m manip_sim.examples NAME``.

It imports little, so that a signal during the slow imports ends the process as cleanly as later.
"""

from __future__ import annotations

import sys

from manip_sim.startup import EndSignals, import_mujoco, run_program, without_ros_arguments

_NAMES = {
    'pick_cube': """Pick up the cube of a node with one arm at a table, and print the wrist force.

Start the node first: sim_node --ros-args -p arena:=table""",
    'hand_over': """Pass a cube along three arms that stand at one table.

Start the node first: sim_node --ros-args --params-file config/hand_over.yaml"""}


def pick_cube() -> int:
    """
    Pick a cube up.

    :returns: the exit code: 0 after SIGINT, SIGTERM or SIGHUP or when it is held, else 1
    """
    return run_program(lambda: _run('pick_cube'))


def hand_over() -> int:
    """
    Hand a cube over.

    :returns: the exit code: 0 after SIGINT, SIGTERM or SIGHUP or when it is done, else 1
    """
    return run_program(lambda: _run('hand_over'))


def _run(name: str) -> int:
    if {'-h', '--help'} & set(sys.argv[1:]):
        print(f'usage: {name} [--help] [--ros-args ...]\n\n{_NAMES[name]}')
        return 0
    if unknown := without_ros_arguments(sys.argv[1:]):
        print(f"{name}: unknown argument '{unknown[0]}': it uses the robot of the node that runs, "
              'as started by sim_node --ros-args -p robot:=NAME; see --help', file=sys.stderr)
        return 2
    import gc
    from importlib import import_module

    from manip_sim.errors import ManipSimError
    from manip_sim.ros_environment import check_ros_environment, missing_module
    try:
        check_ros_environment()
        import_mujoco()
        example = import_module(f'manip_sim.examples.{name}')
    except ImportError as error:
        problem = missing_module(error)
    except ManipSimError as error:
        problem = str(error)
    else:
        gc.enable()
        signals = EndSignals()
        try:
            code: int = example.main(is_asked_to_end=lambda: signals.wait(0.0))
            return code
        except ManipSimError as error:
            problem = str(error)
    print(f'{name}: {problem}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    if sys.argv[1:2] and sys.argv[1] in _NAMES:
        example_name = sys.argv.pop(1)
        sys.exit(run_program(lambda: _run(example_name)))
    print(f'usage: python3 -m manip_sim.examples {"|".join(_NAMES)} [--ros-args ...]',
          file=sys.stderr)
    sys.exit(2)
