# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim export``: a composition as a file for MuJoCo."""

from __future__ import annotations

import argparse
from pathlib import Path

from manip_sim.cli.composition import compose_from
from manip_sim.cli.output import check_folder, write_whole
from manip_sim.errors import ManipSimError

_ARCHIVES = ('.mjz', '.zip')


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Write the file and tell its size."""
    file: Path = options.file
    ending = file.suffix.lower()
    if ending == '.urdf':
        raise ManipSimError(f'{file}: URDF cannot be written yet, only .xml, .mjz and .zip')
    if ending not in ('.xml', *_ARCHIVES):
        raise ManipSimError(f'{file}: the name must end with .xml, .mjz or .zip')
    check_folder(file)
    world = compose_from(options).composition.world
    if ending == '.xml':
        xml = world.to_xml()
        write_whole(file, lambda path: path.write_text(xml, encoding='utf-8'))
    else:
        write_whole(file, lambda path: path.write_bytes(world.to_archive()))
    return f'{file} ({_size(file)})', 0


def _size(file: Path) -> str:
    return f'{-(-file.stat().st_size // 1000)} kB'
