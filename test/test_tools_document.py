# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What ``docs/how_to/tools.md`` says of topics, actions, links and executables."""

from pathlib import Path
import re

import pytest

from manip_sim.interface.topics import ACTIONS, TOPICS

DOCS = Path(__file__).resolve().parents[1] / 'docs'
DOCUMENT = (DOCS / 'how_to' / 'tools.md').read_text()
ROWS = {row[0]: row[1:] for line in DOCUMENT.splitlines() if line.startswith('| ')
        for row in [[cell.strip() for cell in line.strip('|').split(' | ')]] if row[0] != 'tool'}
TOOLS = ('RViz', 'MoveIt', 'robot_state_publisher', 'Foxglove', 'nav2', 'ros2_control',
         'moveit_servo', 'PlotJuggler', 'joint_state_publisher', 'rosbag2')


def known():
    names = {topic.name for topic in TOPICS} | {action.name for action in ACTIONS}
    return names | {name.replace('<part>', part) for name in names for part in ('arm', 'base')}


@pytest.mark.parametrize('tool', TOOLS)
def test_each_tool_has_a_row_with_names_that_there_are(tool):
    (link,) = [cell for cell in ROWS if cell.startswith(f'[{tool}](')]
    reads, gives, command = ROWS[link]
    named = re.findall(r'`([^`:]+)`', f'{reads} {gives}')
    assert {name for name in named if name != 'ros2_control_tag'} <= known()
    assert re.fullmatch(r'`.+`.*', command)
