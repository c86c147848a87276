# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Draw the pictures of explanation/architecture.md; which room imports which is read from code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from html import escape
from pathlib import Path

HERE = Path(__file__).resolve().parent
PACKAGE = HERE.parent / 'manip_sim'
#: Rooms from top to bottom: each imports from rooms below it only.
FLOORS = (
    {'viewer': 'a client: see and drive', 'examples': 'clients: pick, hand over',
     'cli': 'the command manip_sim', 'moveit': 'SRDF and configuration',
     'testing': 'a fixture of pytest'},
    {'experiments': 'many seeds: rows, intervals, shards',
     'identification': 'friction and rotors from records'},
    {'ros': 'how it is seen: node, topics', 'records': 'episodes in MCAP files',
     'env': 'tasks for gymnasium'},
    {'channels': 'what can be read, and its messages'},
    {'interface': 'names: topics, parameters', 'runtime': 'when: threads, pacing'},
    {'tasks': 'starts, success, episodes', 'worlds': 'many copies of one'},
    {'simulation': 'what happens: robots in a world, states', 'rendering': 'pictures'},
    {'control': 'commands, modes, setpoints, servos, grippers'},
    {'physics': 'the compiled model and its data, steps, forces'},
    {'models': 'what exists: robots, grippers, arenas, worlds'},
    {'sensing': 'what is measured: instruments'})
#: Name, what it does, what it may touch.
THREADS = (
    ('main', 'waits for signals', 'what it starts and ends'),
    ('executor', 'services, parameters, actions, diagnostics', 'the simulation by thread.call()'),
    ('commands', 'takes messages, checks them, makes commands', 'limits and modes; submit()'),
    ('physics', 'control and mj_step; observers make messages', 'model, data, controllers'),
    ('publishing', 'publishes them in their order; not in lock-step', 'publishers'),
    ('cameras', 'renders copies of the state', 'its own MjData and OpenGL context'),
    ('background', 'tries spawned models', 'nothing; the executor takes the result'))
#: The module or function of each station.
COMMAND = (
    ('DDS', 'joint_command'), ('ros/command_inbox.py', 'waits, takes the bytes'),
    ('ros/messages.py', 'bounds, then reads the message'),
    ('ros/command_subscribers.py', 'names, stamps, counts'),
    ('control/command_parser.py', 'validates, clamps: a Command'),
    ('runtime/change_queue.py', 'until the next control period'),
    ('control/joint_controller.py', 'owns joints; setpoints'),
    ('control/servos.py', 'controls'),
    ('mj_step', 'the physics'))
STATE = (
    ('mj_step, mj_forward', 'the physics'), ('simulation/simulation.py', 'the end of a period'),
    ('runtime/simulation_thread.py', 'who has to be called'),
    ('ros/channel_publishers.py', 'whoever has a reader'),
    ('channels/kinds.py', 'joints, poses, wrenches'),
    ('ros/messages.py', 'numbers into bytes'),
    ('DDS', 'joint_states'))
_STYLE = ('<style>text{font:13px sans-serif;fill:#1b2733}.b{font-weight:bold}.s{font-size:11.5px}'
          'rect{fill:#eef3f8;stroke:#4a6785;rx:5}.w{fill:#fff}'
          'path{stroke:#4a6785;fill:none;stroke-width:1.3;marker-end:url(#a)}</style>'
          '<defs><marker id="a" markerWidth="9" markerHeight="9" refX="7" refY="3.5" '
          'orient="auto">'
          '<polygon points="0 0, 8 3.5, 0 7" fill="#4a6785"/></marker></defs>')


class Drawing:
    """Boxes and arrows, in pixels."""

    def __init__(self) -> None:
        self._parts: list[str] = []
        self._width = self._height = 0.0

    def box(self, x: float, y: float, width: float, height: float, title: str, *lines: str
            ) -> None:
        """Draw a box with a title and lines of text."""
        self._parts.append(f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"/>')
        for number, text in enumerate((title, *lines)):
            kind = 's' if number else 'b'
            self._parts.append(f'<text class="{kind}" x="{x + 10:g}" y="{y + 20 + 17 * number:g}">'
                               f'{escape(text)}</text>')
        self._width, self._height = max(self._width, x + width), max(self._height, y + height)

    def arrow(self, *points: tuple[float, float]) -> None:
        """Draw an arrow along some points."""
        way = ' L'.join(f'{x:g} {y:g}' for x, y in points)
        # Behind the boxes.
        self._parts.insert(0, f'<path d="M{way}"/>')

    def svg(self) -> str:
        """Return the drawing."""
        width, height = self._width + 10, self._height + 10
        return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
                f'width="{width:g}" height="{height:g}">{_STYLE}'
                f'<rect class="w" width="100%" height="100%" style="stroke:none"/>\n'
                + '\n'.join(self._parts) + '\n</svg>\n')


@cache
def imported(room: str) -> set[str]:
    """Return the rooms that modules of a room import."""
    found = set()
    for path in (PACKAGE / room).rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                found |= set(node.module.split('.')[1:2])
    return {name for floor in FLOORS for name in floor} & found - {room}


def direct(room: str) -> set[str]:
    """Return the rooms that a room imports, without those that these import in turn."""
    found = imported(room)
    return found - {deeper for other in found for deeper in _reached(other)}


def _reached(room: str) -> set[str]:
    found = imported(room)
    return found.union(*map(_reached, found))


def rooms() -> Drawing:
    """Draw the rooms; an arrow leads to each room below that a room imports :func:`direct`."""
    drawing, places = Drawing(), {}
    for number, floor in enumerate(FLOORS):
        width = (900 - 15 * (len(floor) - 1)) / len(floor)
        for column, (room, text) in enumerate(floor.items()):
            places[room] = (10 + column * (width + 15), 10 + 95 * number, width)
            drawing.box(*places[room][:2], width, 52, room, text)
    order = [room for floor in FLOORS for room in floor]
    for room in order:
        x, y, width = places[room]
        below = sorted(direct(room), key=order.index)
        for number, other in enumerate(below):
            left, top, wide = places[other]
            if top <= y:
                continue
            begin = x + width * (number + 1) / (len(below) + 1)
            end = min(max(begin, left + 12), left + wide - 12)
            drawing.arrow((begin, y + 52), (end, top - 2))
    return drawing


def threads() -> Drawing:
    """Draw the threads of a node."""
    drawing = Drawing()
    for number, (name, does, touches) in enumerate(THREADS):
        drawing.box(10 + 365 * (number % 2), 10 + 90 * (number // 2), 350, 74, name, does,
                    f'may touch: {touches}')
    return drawing


def ways() -> Drawing:
    """Draw the way of a command to the physics, and that of a state to a reader."""
    drawing = Drawing()
    for column, stations in enumerate((COMMAND, STATE)):
        x = 10 + 400 * column
        for number, (place, does) in enumerate(stations):
            drawing.box(x, 10 + 72 * number, 330, 48, place, does)
            if number:
                drawing.arrow((x + 165, 72 * number - 14), (x + 165, 72 * number + 8))
    return drawing


def pictures() -> Iterator[tuple[Path, str]]:
    """Yield the file and the content of each picture."""
    for draw in (rooms, threads, ways):
        yield HERE / 'explanation' / f'architecture_{draw.__name__}.svg', draw().svg()


if __name__ == '__main__':
    for path, content in pictures():
        path.write_text(content)
