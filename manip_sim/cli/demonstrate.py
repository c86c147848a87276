# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim demonstrate``: episodes of a task by a device, recorded and repeated at once."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import importlib.util
import sys
from types import ModuleType
from typing import TYPE_CHECKING

from manip_sim.cli.output import ProgressBar
from manip_sim.errors import ManipSimError
from manip_sim.experiments.demonstrations import action_of, open_device
from manip_sim.quoting import pluralize
from manip_sim.ros_environment import missing_module
from manip_sim.tasks import Setting

if TYPE_CHECKING:
    from manip_sim.experiments.demonstrations import Demonstration, Demonstrator, Device
    from manip_sim.tasks import Episode
    from manip_sim.viewer.task_page import TaskPage

_BROWSER = 'browser'


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Demonstrate; return a line each, and 1 if one does not repeat, or none was kept."""
    if importlib.util.find_spec('mcap') is None:
        raise ManipSimError("demonstrations need mcap: pip install 'manip_sim[records]'")
    from manip_sim.experiments.demonstrations import Demonstrator
    setting = Setting(options.task, options.robot, options.gripper, action_of(options.device),
                      options.rate)
    episode = setting.create_episode()
    with contextlib.ExitStack() as stack:
        device = stack.enter_context(contextlib.closing(_open(options, episode)))
        page: TaskPage | None = None
        if options.view and options.device != _BROWSER:
            page = stack.enter_context(contextlib.closing(_pages().TaskPage(
                episode, options.listen, options.port)))
            print(f'the world is shown on {page.address}', file=sys.stderr)
        if device.help:
            print(device.help, file=sys.stderr)
        progress = stack.enter_context(ProgressBar('s'))

        def show(time_s: float, success: bool, force: float) -> None:
            progress.show(int(time_s), f', external force {force:.1f} N' + (
                ', success' if success else ''))
            if page is not None:
                page.update()
        options.out.mkdir(parents=True, exist_ok=True)
        kept = [*_demonstrations(options, Demonstrator(
            episode, device, options.out, {'device': options.device}, show))]
    equal = sum(one.repeats for one in kept)
    return (f'{options.out}: {pluralize(len(kept), "demonstration")}, '
            f'{sum(one.success for one in kept)} with success; {equal} of {len(kept)} repeat'
            ), int(equal < len(kept) or not kept)


def _demonstrations(options: argparse.Namespace, demonstrator: Demonstrator
                    ) -> Iterator[Demonstration]:
    """Yield the demonstrations that are kept; tell of each."""
    seed, count = options.seed, 0
    while count < options.episodes:
        if (options.out / f'{seed}.mcap').exists():
            seed += 1
            continue
        try:
            one = demonstrator.run(seed)
        except KeyboardInterrupt:
            return
        print(_line(one), file=sys.stderr)
        if one.file is not None:
            yield one
            seed, count = seed + 1, count + 1
        if one.quits:
            return


def _open(options: argparse.Namespace, episode: Episode) -> Device:
    if options.device == _BROWSER:
        device: Device = _pages().PageDevice(episode, options.listen, options.port)
        return device
    return open_device(options.device, episode.actions.names)


def _pages() -> ModuleType:
    try:
        from manip_sim.viewer import task_page
    except ImportError as error:
        raise ManipSimError(missing_module(error)) from error
    return task_page


def _line(one: Demonstration) -> str:
    """Return what became of a demonstration, and of its repetition."""
    outcome = 'success' if one.success else 'no success'
    about = f'seed {one.seed}: {outcome} after {pluralize(one.periods, "control period")}'
    if one.repetition is None:
        return f'{about}, discarded'
    if one.repeats:
        return f'{about}, repeats to {outcome}: {one.file}'
    return f'{about}, does not repeat: {one.repetition.difference}'
