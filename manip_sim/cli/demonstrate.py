# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim demonstrate``: episodes of a task by a device, recorded and repeated at once."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import sys
from typing import TYPE_CHECKING

from manip_sim.cli.output import ProgressBar
from manip_sim.errors import ManipSimError
from manip_sim.experiments.demonstrations import action_of, open_device
from manip_sim.quoting import pluralize
from manip_sim.ros_environment import missing_module
from manip_sim.tasks import Setting

if TYPE_CHECKING:
    from manip_sim.experiments.demonstrations import Demonstration, Device
    from manip_sim.tasks import Episode


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Demonstrate; return a line each, and 1 if one does not repeat, or none was kept."""
    if importlib.util.find_spec('mcap') is None:
        raise ManipSimError("demonstrations need mcap: pip install 'manip_sim[records]'")
    from manip_sim.experiments.demonstrations import Demonstrator
    setting = Setting(options.task, options.robot, options.gripper, action_of(options.device),
                      options.rate)
    episode = setting.create_episode()
    device = _open(options, episode)
    with contextlib.closing(device), ProgressBar('s') as progress:
        if device.help:
            print(device.help, file=sys.stderr)
        options.out.mkdir(parents=True, exist_ok=True)
        demonstrator = Demonstrator(
            episode, device, options.out, {'device': options.device},
            lambda time_s, success, force: progress.show(
                int(time_s), f', external force {force:.1f} N' + (', success' if success else '')))
        kept: list[Demonstration] = []
        seed, quits = options.seed, False
        while len(kept) < options.episodes and not quits:
            if (options.out / f'{seed}.mcap').exists():
                seed += 1
                continue
            try:
                one = demonstrator.run(seed)
            except KeyboardInterrupt:
                break
            print(_line(one), file=sys.stderr)
            quits = one.quits
            if one.file is not None:
                kept.append(one)
                seed += 1
    equal = sum(one.repeats for one in kept)
    return (f'{options.out}: {pluralize(len(kept), "demonstration")}, '
            f'{sum(one.success for one in kept)} with success; {equal} of {len(kept)} repeat'
            ), int(equal < len(kept) or not kept)


def _open(options: argparse.Namespace, episode: Episode) -> Device:
    if options.device != 'browser':
        return open_device(options.device, episode.actions.names)
    try:
        from manip_sim.viewer.dragging import PageDevice
    except ImportError as error:
        raise ManipSimError(missing_module(error)) from error
    return PageDevice(episode, options.listen, options.port)


def _line(one: Demonstration) -> str:
    """Return what became of a demonstration, and of its repetition."""
    outcome = 'success' if one.success else 'no success'
    about = f'seed {one.seed}: {outcome} after {pluralize(one.periods, "control period")}'
    if one.repetition is None:
        return f'{about}, discarded'
    if one.repeats:
        return f'{about}, repeats to {outcome}: {one.file}'
    return f'{about}, does not repeat: {one.repetition.difference}'
