# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim record``: topics of a running node in an MCAP file."""

from __future__ import annotations

import argparse

from manip_sim.cli.output import ProgressBar
from manip_sim.errors import RecordError
from manip_sim.ros_environment import check_ros_environment, missing_module


def run(options: argparse.Namespace) -> tuple[str, int]:
    check_ros_environment()
    try:
        from manip_sim.records.node_recorder import record_node
    except ImportError as error:
        raise RecordError(missing_module(error)) from error
    name = f'/{options.node.strip("/")}'
    with ProgressBar('messages') as progress:
        text, found = record_node(
            options.file, name, options.topics, options.duration, progress.show)
    return text, int(not found)
