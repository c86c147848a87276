# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Execute the blocks of a page: Python, files, and commands of a shell against a node here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, nullcontext, redirect_stdout
import importlib
from pathlib import Path
import re
import subprocess
import sys
import threading
from typing import Any

from harness import Client, Served
from pages import Block, commands, ROOT
import pytest
import rclpy
import yaml

from manip_sim.cli import ros_commands
from manip_sim.cli.command_line import COMMANDS
from manip_sim.cli.main import main as manip_sim
from manip_sim.interface.topics import ACTIONS

SETUP = (ROOT / 'setup.py').read_text()
#: Programs of the package, and the tests that run them.
PROGRAMS = {'pick_cube': 'test_pick_cube.py', 'hand_over': 'test_hand_over.py',
            'sim_view': 'test_viewer.py'}
#: Packages beside ours, with the executables and launch files of theirs that pages name.
OTHERS = {
    'controller_manager': 'ros2_control_node', 'depth_image_proc': 'point_cloud_xyzrgb_node',
    'foxglove_bridge': 'foxglove_bridge foxglove_bridge_launch.xml',
    'joint_state_publisher': 'joint_state_publisher', 'joy': 'joy_node',
    'nav2_bringup': 'navigation_launch.py', 'panda_moveit_config': 'moveit.launch.py',
    'panda_control': 'bringup.launch.py', 'panda_lockstep_control': 'bringup.launch.py',
    'plotjuggler': 'plotjuggler', 'robot_state_publisher': 'robot_state_publisher',
    'rqt_image_view': 'rqt_image_view', 'spacenav': 'spacenav_node',
    'teleop_twist_joy': 'teleop_node',
    'teleop_twist_keyboard': 'teleop_twist_keyboard', 'my_package': 'my_controller'}
#: First words of commands of other programs.
TOOLS = {'rviz2': 'rviz2', 'ros2 bag': 'rosbag2', 'ros2 security': 'sros2', 'sudo nft': 'nftables',
         'docker': 'docker', 'sudo apt': 'apt', 'colcon': 'colcon', 'rosdep': 'rosdep',
         'git': 'git', 'pre-commit': 'pre-commit', '.ci/run': 'bash', 'unshare': 'unshare',
         'nsenter': 'nsenter', 'srun': 'slurm', 'kubectl': 'kubectl', 'lerobot-': 'lerobot'}
#: Commands with the words of ros2.
GRAPH = [['manip_sim', command] for command in COMMANDS]
#: Of a shell; nothing that could fail here.
SHELL = {'source', 'mkdir', 'cd', 'for', 'do', 'done'}


class Enough(Exception):
    """A client without an end has shown what it does."""


def end() -> None:
    """End the spinning of the thread that calls this."""
    raise Enough


def run_here(experiment: Any, seeds: Sequence[int], count: int) -> Iterator[Any]:
    """Yield the rows of a run as ``run_in_processes`` does."""
    from manip_sim.experiments import Worker
    yield from map(Worker(experiment).run, seeds)


def two_seeds(seeds: re.Match[str]) -> str:
    """Return the first two of seeds."""
    return f'{seeds[1]}:{int(seeds[1]) + 2}'


def needed_program(words: list[str]) -> str | None:
    """Return the program beside ours that a command is of, or None."""
    for begin, program in TOOLS.items():
        if ' '.join(words).startswith(begin):
            return program
    if words[:2] in (['ros2', 'run'], ['ros2', 'launch']) and words[2] != 'manip_sim':
        assert words[3] in OTHERS[words[2]].split(), words
        return words[2]
    if any(':=menagerie:' in word for word in words):
        return 'mujoco-menagerie'
    return None


def interface(name: str) -> Any:
    """Return the class of a type such as ``std_msgs/msg/String``; ImportError without it."""
    package, kind, cls = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), cls)


class PageRunner:
    """
    Executes the blocks of a page one after the other, as a reader does.

    :param client: of the node
    :param folder: the working directory
    :param patch: changes the environment
    :ivar served: the node that the last command started, or None
    """

    def __init__(self, client: Client, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self._client, self._folder, self._patch = client, folder, patch
        self._names: dict[str, Any] = {'__name__': '__main__'}
        self.served: Served | None = None
        self._graph: Any = None
        self._open = ExitStack()
        patch.syspath_prepend(str(folder))  # A file finds those beside it.
        for name in ('assets', 'config'):
            (folder / name).symlink_to(ROOT / name)
        # Of a workspace.
        (folder / 'src').mkdir()

    def run(self, block: Block) -> None:
        """Execute a block; AssertionError if it cannot be, or an exception of its own."""
        if block.file:
            (self._folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (self._folder / block.file).write_text(block.text)
        if block.language == 'sh':
            self._shell(block)
        elif block.language == 'yaml':
            assert yaml.safe_load(block.text)
            assert block.file or block.needs, 'nobody reads it: name its file before it'
        elif block.language == 'python' and not block.needs:
            code = compile(block.text, block.where, 'exec')
            if 'rclpy' in block.text:
                self._run_client(code, endless='rclpy.spin(' in block.text)
            else:
                exec(code, self._names)
        else:
            assert block.file or block.needs or block.language == 'text', (
                'it is of no language that is executed')

    def _shell(self, block: Block) -> None:
        needed = set()
        for words in commands(block.text, self._folder):
            program = needed_program(words)
            if program is None:
                self._command(words)
            else:
                needed.add(program)
        assert needed == block.needs, f'mark it by <!-- needs: {", ".join(sorted(needed))} -->'

    def _command(self, words: list[str]) -> None:
        first, rest = Path(words[0]).name, words[1:]
        if words[:3] == ['ros2', 'run', 'manip_sim']:
            first, rest = words[3], words[4:]
        if first == 'ros2' or words[:2] in GRAPH:
            return self._ros2(' '.join(words[1:3]), words[3:])
        if first == 'export':
            for name, value in (word.split('=', 1) for word in rest):
                if not name.startswith('ROS_'):
                    self._patch.setenv(name, value)
        elif words[:2] == ['manip_sim', 'render']:
            # In a process of its own: MuJoCo chooses how it renders when it is imported.
            subprocess.run([sys.executable, '-m', 'manip_sim.cli', *rest], check=True,
                           timeout=300.0, stdout=subprocess.DEVNULL)
        elif first == 'manip_sim':
            if rest[0] == 'run':  # Two seeds, without processes of their own, show as much.
                rest = [re.sub(r'^(\d+):\d+$', two_seeds, word) for word in rest]
                self._patch.setattr('manip_sim.cli.run.run_in_processes', run_here)
            if '>' in rest:
                *rest, _, file = rest
                with open(self._folder / file, 'w') as output, redirect_stdout(output):
                    assert manip_sim(rest) == 0, words
            else:
                assert manip_sim(rest) == 0, words
        elif first == 'sim_node':
            self._serve(rest)
        elif first in PROGRAMS:
            assert f"'{first}': " in SETUP and (ROOT / 'test' / 'ros' / PROGRAMS[first]).exists()
        elif first == 'make':
            subprocess.run(['make', '--dry-run', *rest], cwd=ROOT, check=True, timeout=300.0,
                           stdout=subprocess.DEVNULL)
        elif words[:2] == ['pip', 'install']:
            for extra in re.findall(r'[\w-]+', words[2].partition('[')[2]):
                assert f"'{extra}': [" in SETUP
        else:
            assert first in SHELL or words[:3] == ['python3', '-m', 'venv'], (
                f'nobody knows the command {first}')
        return None

    def _serve(self, arguments: list[str]) -> None:
        self._end_node()
        self.served = Served({}, arguments)
        self._client.spin_until(lambda: 'manip_sim' in self._client.node.get_node_names())

    def _ros2(self, verb: str, rest: list[str]) -> None:
        """Execute a command of ``ros2`` by that of ``manip_sim`` with the same words, once."""
        if verb == 'action send_goal':
            name, kind, goal = [word for word in rest if word != '--feedback']
            assert any(name.endswith(re.sub('<.*>/', '/', action.name))
                       and kind.replace('/action/', '/') == action.type for action in ACTIONS)
            assert yaml.safe_load(goal)
            return
        if self.served is None:
            self._serve([])
        if self._graph is None:
            # One node for all: DDS takes seconds to find a second one of this process.
            self._graph = self._open.enter_context(ros_commands._graph())
            self._patch.setattr(ros_commands, '_graph', lambda: nullcontext(self._graph))
        if verb == 'service call':
            row = f'| `~/{rest[0].split("/")[-1]}` | {rest[1].replace("/srv/", "/")} |'
            assert row in (ROOT / 'docs' / 'reference' / 'services.md').read_text()
            try:
                interface(rest[1])
            except ImportError:
                return
        before = self.taken()
        if verb in ('topic echo', 'topic hz'):
            if self._is_image(rest[-1]):
                return
            verb, rest = 'topic echo', ['--once', *(word for word in rest if word != '--once')]
        elif verb == 'topic pub' and '--once' not in rest:
            rest = ['--once', *rest]
        assert manip_sim([*verb.split(), *rest]) == 0, (verb, rest)
        if verb == 'topic pub':
            self._client.spin_until(lambda: self.taken() > before)

    def _is_image(self, name: str) -> bool:
        self._client.spin_until(lambda: self._client.node.count_publishers(name) > 0)
        (kind,) = dict(self._client.node.get_topic_names_and_types())[name]
        return bool(kind.endswith('Image'))

    def taken(self) -> int:
        """Return how many commands the node has taken; AssertionError if one was rejected."""
        assert self.served is not None
        node = self.served.node
        statistics = [entry for commands in (*node.commands.robots, node.surroundings)
                      for entry in commands.statistics.values()]
        assert not sum(entry.rejected for entry in statistics), self._client.log()
        return sum(entry.accepted for entry in statistics)

    def _run_client(self, code: Any, endless: bool) -> None:
        """Run a client until it ends; one without an end until the node has taken a command."""
        if self.served is None:
            self._serve([])
        before, errors = self.taken(), []

        def run() -> None:
            try:
                exec(code, self._names)
            except Enough:
                pass
            except BaseException as error:  # The test has to learn of it.
                errors.append(error)

        thread = threading.Thread(target=run, name='client of a page')
        thread.start()
        try:
            self._client.spin_until(
                lambda: not thread.is_alive() or (endless and self.taken() > before))
        finally:
            if thread.is_alive():
                # In the client's thread: a shutdown from here takes the executor away under it.
                rclpy.get_global_executor().create_task(end)
            thread.join(timeout=300.0)
            rclpy.try_shutdown()
        assert not errors, errors
        assert not thread.is_alive()

    def close(self) -> None:
        """End the node and what the commands used."""
        self._open.close()
        self._end_node()

    def _end_node(self) -> None:
        if self.served is not None:
            self.served.close()
            self.served = None
            self._client.spin_until(
                lambda: 'manip_sim' not in self._client.node.get_node_names())
