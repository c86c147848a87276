# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures: a node in this process, or one in its own; each with a domain nobody else uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import importlib.util
from pathlib import Path
import signal
import subprocess
from typing import Any

import pytest

if importlib.util.find_spec('rclpy'):
    from forks import Fork, start
    from harness import Client, DOMAIN, Served


class WithoutRos(pytest.File):
    """A test module that is skipped as a whole, because there is no ROS 2."""

    def collect(self) -> list[Any]:
        pytest.skip('tests of the node need ROS 2', allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Any, parent: Any) -> Any:
    if importlib.util.find_spec('rclpy') is None:
        return WithoutRos.from_parent(parent, path=module_path)
    return None


@pytest.fixture
def domain() -> int:
    """Return the domain in which all nodes and clients of these tests live."""
    return DOMAIN


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client()
    yield client
    client.close()


@pytest.fixture
def serve() -> Iterator[Callable[..., Any]]:
    """Return a function that starts a node with parameters (dots as double underscores)."""
    running: list[Served] = []

    def start(**parameters: Any) -> Any:
        served = Served({name.replace('__', '.'): value for name, value in parameters.items()})
        running.append(served)
        return served.node

    yield start
    for served in running:
        served.close()


@pytest.fixture
def process() -> Iterator[Callable[..., Fork | subprocess.Popen[str]]]:
    """
    Return a function that starts ``python3 -m MODULE ARGUMENTS`` and ends it after the test.

    The module may be the path of a script. Where its start is tested, with ``fresh=True``, nothing
    is imported before.
    """
    running: list[Fork | subprocess.Popen[str]] = []

    def start_one(*arguments: str, module: str = 'manip_sim',
                  fresh: bool = False) -> Fork | subprocess.Popen[str]:
        running.append(start(module, arguments, fresh))
        return running[-1]

    yield start_one
    for started in running:
        if started.poll() is None:
            started.send_signal(signal.SIGKILL)
        started.communicate(timeout=300.0)


@pytest.fixture
def script(process: Any, tmp_path: Path) -> Callable[..., Fork | subprocess.Popen[str]]:
    """Return a function that starts a script, from its text and arguments."""
    def start(text: str, *arguments: str) -> Fork | subprocess.Popen[str]:
        file = tmp_path / 'script.py'
        file.write_text(text)
        return process(*arguments, module=str(file))
    return start


@pytest.fixture
def sim_process(process: Any) -> Callable[..., Fork | subprocess.Popen[str]]:
    """Return a function that starts the node as a process, with parameters NAME:=VALUE."""
    def start(*parameters: str, fresh: bool = False) -> Fork | subprocess.Popen[str]:
        arguments = [word for parameter in parameters for word in ('-p', parameter)]
        return process('--ros-args', *arguments, fresh=fresh)
    return start
