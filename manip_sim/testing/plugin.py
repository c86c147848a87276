# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The plugin of pytest: the fixture ``sim_node``, and the files saved for failed tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
import difflib
import os
from pathlib import Path
import re
from typing import Any, TYPE_CHECKING

import pytest

from manip_sim.errors import UnknownNameError
from manip_sim.ros_environment import check_shared_memory
from manip_sim.testing.domains import reserve_domain

if TYPE_CHECKING:
    from manip_sim.testing.simulation_under_test import SimulationUnderTest

_OPTION = '--sim-node-failures'
#: Of the function that the fixture returns; all others are parameters of the node.
_ARGUMENTS = ('as_process', 'patience')
_RUNNING = pytest.StashKey[list['SimulationUnderTest']]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that says where failed tests leave record and picture."""
    parser.getgroup('manip_sim').addoption(
        _OPTION, metavar='DIR', default='sim_node_failures',
        help='folder for the record and the picture of the simulations of each failed test '
        '(default: %(default)s)')


@pytest.fixture
def sim_node(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
             ) -> Iterator[Callable[..., SimulationUnderTest]]:
    """
    Return a function that starts a paused node in a ROS domain that nobody else uses.

    ``sim_node(robot='UR5e', stepping='lockstep')`` takes the parameters of the node, with two
    underscores for a dot (``control_mode__arm='effort'``), ``as_process=True`` to start it as a
    process of its own, and ``patience``, the wall time after which a simulation that stands still
    fails the test [s]. It returns a ``SimulationUnderTest``, which ends with the test. What the
    test starts meanwhile, here or as a process, finds the same domain in its environment.
    """
    check_shared_memory()
    pytest.importorskip('rclpy', reason='the fixture sim_node needs ROS 2')
    from manip_sim.testing.simulation_under_test import SimulationUnderTest
    running = request.node.stash.setdefault(_RUNNING, [])
    last_first = ExitStack()

    def start(as_process: bool = False, patience: float = 10.0, **parameters: Any
              ) -> SimulationUnderTest:
        for name in parameters:
            if difflib.get_close_matches(name, _ARGUMENTS, cutoff=0.75):
                raise UnknownNameError('argument of sim_node', name, _ARGUMENTS)
        domain, lock = reserve_domain()
        last_first.callback(os.close, lock)
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        simulation = SimulationUnderTest(
            domain, {name.replace('__', '.'): value for name, value in parameters.items()},
            as_process, patience)
        running.append(simulation)
        last_first.callback(simulation.close)
        return simulation

    with last_first:
        yield start


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """Save record and picture of the simulations of a test that has failed."""
    report = yield
    if call.when == 'call' and report.failed:
        root = item.config.rootpath / item.config.getoption(_OPTION)
        running: list[SimulationUnderTest] = item.stash.get(_RUNNING, [])
        for index, simulation in enumerate(running):
            name = re.sub(r'[^\w.-]+', '_', item.nodeid).strip('_')
            folder = root / (f'{name}-{index}' if index else name)
            report.sections.append(('manip_sim', _saved(simulation, folder)))
    return report


def _saved(simulation: SimulationUnderTest, folder: Path) -> str:
    try:
        return '\n'.join(simulation.save_evidence(folder))
    except Exception as error:  # The report of the failure itself must not be lost.
        return f'neither record nor picture: {error}'
