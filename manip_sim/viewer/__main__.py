# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Entry point of ``sim_view`` and ``python3 -m manip_sim.viewer``.

It imports little, so that a signal during the slow imports ends the process as cleanly as later.
"""

from __future__ import annotations

import gc
import sys

from manip_sim.startup import import_mujoco, run_program, use_one_blas_thread

TYPE_CHECKING = False  # As in typing, whose import would take longer than all others here.
if TYPE_CHECKING:
    import argparse

_EPILOG = """\
The printed address ends with a token, which is new at each start unless SIM_VIEW_TOKEN is set.
ROS arguments come last: '--ros-args -r __ns:=/cell' looks for the node in a namespace.
"""
_PORT = 8080
_SCREENS = ('DISPLAY', 'WAYLAND_DISPLAY')


def main() -> int:
    """Show a node in the browser; return 0 after SIGINT, SIGTERM or SIGHUP, 1 without a start."""
    return run_program(_run)


def _run() -> int:
    words = sys.argv[1:]
    begin = words.index('--ros-args') if '--ros-args' in words else len(words)
    from argparse import ArgumentError
    try:
        options, left = _parser().parse_known_args(words[:begin])
    except ArgumentError as error:
        return _fail(f'{error}; see --help', 2)
    if left:
        return _fail(f"unknown argument '{left[0]}': ROS arguments such as '-r __ns:=/cell' come "
                     "after '--ros-args'; see --help", 2)
    from manip_sim.errors import ManipSimError
    from manip_sim.ros_environment import check_ros_environment, missing_module
    try:
        use_one_blas_thread()  # viser imports NumPy.
        if not options.record:
            check_ros_environment()
        if options.native:
            check_display()
        else:
            import viser  # noqa: F401
        import_mujoco()
        if options.record:
            from manip_sim.viewer.playback import show_records
            gc.enable()
            return show_records(options)
        from manip_sim.viewer.session import show
    except ImportError as error:
        return _fail(missing_module(error))
    except ManipSimError as error:
        return _fail(str(error))
    gc.enable()
    try:
        return show(options, words[begin:])
    except ManipSimError as error:
        return _fail(str(error))


def _parser() -> argparse.ArgumentParser:
    import argparse
    from pathlib import Path
    parser = argparse.ArgumentParser(
        prog='sim_view', epilog=_EPILOG, exit_on_error=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Show a running sim_node on a page in the browser, and drive it from there; '
        'or show records.')
    parser.add_argument('--listen', '--host', default='127.0.0.1', metavar='ADDRESS',
                        help='address to listen on, %(default)s by default: only this machine; '
                        'with 0.0.0.0, everyone on the network who knows the token can drive the '
                        'robot')
    parser.add_argument('--port', type=int, default=_PORT, help='%(default)s by default')
    parser.add_argument('--allow-host', action='append', default=[], metavar='NAME',
                        help='a name under which browsers may open the page, in addition to '
                        'localhost, the name of this machine and addresses; may be repeated')
    parser.add_argument('--no-commands', action='store_true',
                        help='watch only: nobody can command the robot or the simulation from '
                        'the page')
    parser.add_argument('--node', default='manip_sim', metavar='NAME',
                        help='the node to show, %(default)s by default; relative names are in '
                        'the namespace')
    parser.add_argument('--poses', type=Path, metavar='FILE',
                        help='keep the poses that you save on the page in this file (JSON); '
                        'without it they are lost when sim_view ends')
    parser.add_argument('--records', type=Path, default=Path(), metavar='FOLDER',
                        help='where Record on the page writes its MCAP files; the present folder '
                        'by default')
    parser.add_argument('--dark', action='store_true', help='start with a dark page')
    parser.add_argument('--record', type=Path, nargs='+', metavar='FILE',
                        help='show records of episodes or nodes instead: files, or folders with '
                        '*.mcap; needs no ROS')
    parser.add_argument('--native', action='store_true',
                        help="open MuJoCo's own viewer in a window instead; it cannot send "
                        'commands')
    return parser


def _fail(message: str, code: int = 1) -> int:
    print(f'sim_view: {message}', file=sys.stderr)
    return code


def check_display() -> None:
    """Check that there is a screen; ManipSimError if there is none."""
    import os

    from manip_sim.errors import ManipSimError
    if sys.platform == 'linux' and not any(os.environ.get(name) for name in _SCREENS):
        raise ManipSimError('--native needs a screen, and neither DISPLAY nor WAYLAND_DISPLAY is '
                            'set; without --native, any browser shows the page')


if __name__ == '__main__':
    sys.exit(main())
