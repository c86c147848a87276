# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Print how large the package is, and how many of its functions a command and a start pass through.

Lines of code are those without comments, docstrings and blank lines. An importer is another module
of the package. Calls are counted in a node in this process: those of a JointState command until it
is buffered, and from the buffer to the first step of the physics, with the files that they are in;
and those of a control period without a message, with all that the thread of the physics does.

    python3 benchmark/house.py [--names]
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
import statistics
import sys
import threading
import time
import tokenize
from types import FrameType
from typing import Any, NamedTuple

PACKAGE = Path(__file__).resolve().parents[1] / 'manip_sim'
NOT_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
            tokenize.ENCODING, tokenize.ENDMARKER}
PERIOD_S = 0.05
#: Calls are counted in so many control periods after a command.
_PERIODS = 10


def modules() -> dict[str, Path]:
    """Return the file of each module by its name."""
    found = {}
    for file in sorted(PACKAGE.rglob('*.py')):
        parts = [PACKAGE.name, *file.relative_to(PACKAGE).with_suffix('').parts]
        found['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = file
    return found


def code_lines(file: Path) -> int:
    """Return how many lines have code, and no docstring alone."""
    tree = ast.parse(file.read_text())
    docs: set[int] = set()
    for node in ast.walk(tree):
        if (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)):
            docs.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    with file.open('rb') as stream:
        lines = {line for token in tokenize.tokenize(stream.readline)
                 if token.type not in NOT_CODE
                 for line in range(token.start[0], token.end[0] + 1)}
    return len(lines - docs)


def importers(files: dict[str, Path]) -> dict[str, set[str]]:
    """Return the modules of the package that import each module."""
    found: dict[str, set[str]] = defaultdict(set)
    for name, file in files.items():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    full = f'{node.module}.{alias.name}'
                    found[full if full in files else node.module].add(name)
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    found[alias.name].add(name)
    return found


def twice(names: Iterable[str]) -> list[str]:
    """Return the names that are there more than once."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def print_size(with_names: bool) -> None:
    """Print the size of the package, and what is cut thin or named twice."""
    files = modules()
    found = importers(files)
    alone = [name for name, file in files.items()
             if len(found[name]) == 1 and file.name != '__init__.py']
    same_modules = twice(name.rpartition('.')[2] for name, file in files.items()
                         if file.stem not in ('__init__', '__main__'))
    same_classes = twice(node.name for file in files.values()
                         for node in ast.parse(file.read_text()).body
                         if isinstance(node, ast.ClassDef))
    print(f'{len(files)} modules, {sum(len(f.read_text().splitlines()) for f in files.values())} '
          f'lines, {sum(map(code_lines, files.values()))} of code')
    for what, names in (('modules with one importer', alone),
                        ('names of several modules', same_modules),
                        ('names of several classes', same_classes)):
        print(f'{len(names)} {what}' + (f': {", ".join(names)}' if with_names else ''))


class Call(NamedTuple):
    """A function that was called: its name with those around it, and its file."""

    name: str
    file: str


class CallQueue:
    """The functions of the package, and some of MuJoCo, that threads call while it records."""

    def __init__(self) -> None:
        self.by_thread: dict[str, list[Call]] = defaultdict(list)
        self.recording = False

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        """Record a call, as a profile function."""
        if not self.recording:
            return
        calls, code = self.by_thread[threading.current_thread().name], frame.f_code
        if event == 'call' and code.co_filename.startswith(str(PACKAGE)):
            calls.append(Call(code.co_qualname if sys.version_info >= (3, 11)
                              else code.co_name, code.co_filename))
        elif event == 'c_call' and getattr(argument, '__name__', '').startswith('mj_step'):
            calls.append(Call('mj_step', ''))

    def between(self, thread: str, first: str, through: str, last: tuple[str, ...]) -> list[Call]:
        """Return the calls of a thread from one function through another to the next of others."""
        calls = self.by_thread[thread]
        middle = next(i for i, call in enumerate(calls) if call.name.endswith(through))
        begin = next(i for i in range(middle, -1, -1) if calls[i].name.endswith(first))
        end = next(i for i in range(middle, len(calls)) if calls[i].name.endswith(last))
        return calls[begin:end]

    def usual(self, thread: str, first: str, last: str) -> int:
        """Return the median of the calls of a thread from one function to the next of another."""
        names, lengths, begin = [call.name for call in self.by_thread[thread]], [], None
        for place, name in enumerate(names):
            if begin is not None and name.endswith(last):
                lengths.append(place - begin)
                begin = None
            if name.endswith(first):
                begin = place
        return round(statistics.median(lengths))


def calls_to_a_world() -> int:
    """Return how many functions composing the world of a node with a Panda calls."""
    from manip_sim.interface.composition import compose_world
    from manip_sim.interface.parameter_spec import GivenParameters
    calls = CallQueue()
    calls.recording = True
    sys.setprofile(calls)
    compose_world(GivenParameters({'robot': 'Panda'}))
    sys.setprofile(None)
    return len(calls.by_thread[threading.current_thread().name])


def print_calls_of_a_command() -> None:
    """Print how many functions a JointState command passes through in a node."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter
    from sensor_msgs.msg import JointState

    from manip_sim.ros.sim_node import SimNode
    from manip_sim.simulation.compiled_period import is_loaded
    calls = CallQueue()
    threading.setprofile(calls)
    rclpy.init()
    node = SimNode(parameter_overrides=[Parameter('publish_rate', value=1.0 / PERIOD_S),
                                        Parameter('publish_clock', value=False)])
    client = rclpy.create_node('client')
    publisher = client.create_publisher(JointState, 'joint_command', 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.start()
    end = time.monotonic() + 2.0
    while time.monotonic() < end or not publisher.get_subscription_count():
        executor.spin_once(timeout_sec=0.05)
    for position in (0.1, 0.15):
        calls.recording = position > 0.1
        publisher.publish(JointState(name=['robot0_joint1', 'robot0_joint2'],
                                     position=[position] * 2))
        while not is_loaded():  # Laws are loaded, or compiled, as the first command takes effect.
            time.sleep(PERIOD_S)
        begin_ns = node.thread.progress.time_ns
        while node.thread.progress.time_ns < begin_ns + _PERIODS * PERIOD_S * 1e9:
            time.sleep(PERIOD_S)
    calls.recording = False
    node.stop()
    client.destroy_node()
    node.destroy_node()
    rclpy.shutdown()
    to_buffer = calls.between('commands', '_take', 'submit', ('CommandBuffer.add',))
    # MuJoCo's function, or what is called last before compiled code calls it.
    to_step = calls.between(
        'physics', 'PendingCommands.take', 'SimulatedRobot.apply', ('mj_step', '_row_in_thread'))
    print(f'{len(to_buffer)} calls from a message to the buffer, {len(to_step)} from there to the '
          f'first step, in {len({call.file for call in to_buffer + to_step})} files')
    period = 'SimulationThread._period'
    print(f'{calls.usual("physics", period, period)} calls of a control period without a message, '
          f'{calls.usual("physics", "Simulation.advance", "Journal.period")} of them of control')


def main() -> None:
    """Print all figures; those of a command need ROS."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--names', action='store_true', help='print the names that are counted')
    print_size(parser.parse_args().names)
    print(f'{calls_to_a_world()} calls from robot:=Panda to a world')
    try:
        import rclpy  # noqa: F401
    except ImportError:
        sys.exit('the calls of a command need rclpy')
    print_calls_of_a_command()


if __name__ == '__main__':
    main()
