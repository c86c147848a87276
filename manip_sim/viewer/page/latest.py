# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Robots of a node and their newest states as plain numbers, its diagnostics as plain text.

Text from ROS is shown as it is. Markdown of viser renders HTML and reads pictures of this machine,
so the page has none, and this is the only module that gives HTML to viser.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import html
import math
import os.path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.quoting import one_line

#: Length of a name on the page at most.
_MAX_NAME = 60
#: The labels of the page are grey and narrow otherwise, and the boxes and ends of sliders cut.
#: Hints are beside the panel, not over its buttons. On a phone the panel is as wide as the screen
#: and lower than half of it.
_STYLE = """<style>
.mantine-Text-root{color:inherit!important;letter-spacing:-0.1px!important}
.mantine-Slider-root~.mantine-NumberInput-root{width:3.9rem!important}
.mantine-Slider-markWrapper:first-of-type .mantine-Slider-markLabel
{transform:translate(-0.1rem,0.05rem)!important}
.mantine-Slider-markWrapper:last-of-type .mantine-Slider-markLabel
{transform:translate(-85%,0.05rem)!important}
.mantine-Tooltip-tooltip{margin-left:-24rem}
.mantine-Tooltip-arrow{display:none}
.mantine-Tabs-list{flex-wrap:nowrap!important;overflow-x:auto!important}
@media (max-width:36em){
.mantine-Paper-root[style*="fixed"]{width:100%!important;max-height:45%!important}
.mantine-Paper-root[style*="fixed"] [style*="20em"]{width:100%!important}
.mantine-Tabs-tab{padding:0.75em 0.5em!important}
.mantine-Tooltip-tooltip{display:none!important}
}</style>"""


def plain(text: str) -> str:
    """Return a name for labels and hints, which show text as it is, on one line, shortened."""
    return one_line(text, _MAX_NAME)


@dataclass(frozen=True)
class Line:
    """A line of text on the page, with a bold title and a coloured dot before it, if any."""

    text: str
    title: str = ''
    color: str = ''


class PlainText:
    """Lines of text in the panel."""

    def __init__(self, gui: Any, lines: Iterable[Line] = ()) -> None:
        self._shown = _as_html(lines)
        self._element = gui.add_html(self._shown)

    def show(self, lines: Iterable[Line]) -> None:
        """Show these lines in place of the former ones."""
        shown = _as_html(lines)
        if shown != self._shown:
            self._shown = self._element.content = shown


def _as_html(lines: Iterable[Line]) -> str:
    blocks = []
    for line in lines:
        dot = f'<span style="color:{html.escape(line.color)}">●</span> ' if line.color else ''
        title = f'<b>{html.escape(plain(line.title))}</b>: ' if line.title else ''
        blocks.append('<div style="padding:0 0.7em 0.5em;font-size:0.9em;overflow-wrap:anywhere">'
                      f'{dot}{title}{html.escape(one_line(line.text))}</div>')
    return _STYLE + ''.join(blocks)


#: Reach of the sliders of a hinge and of a slide joint without a range, either way
#: [rad, m].
_TURN, _WAY_M = math.pi, 2.0
#: Limits where none are declared [rad/s or m/s, N m or N].
_SPEED, _EFFORT = 1.0, 10.0
#: A range that is so many times as wide is none.
_MANY = 100.0
#: A greater limit of velocity or effort is none.
_GREAT = 1e6
_LIMITS = ('lower', 'upper', 'velocity', 'effort')
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_OF_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
#: The fields of ``sensor_msgs/JointState`` that hold commands.
FIELDS = ('position', 'velocity', 'effort')


@dataclass(frozen=True)
class ShownJoint:
    """
    A joint that can be commanded.

    :ivar label: a short name for people
    :ivar slides: whether it is a slide joint, in metres and newtons
    :ivar ranges: of goals by field: position [rad or m], velocity [rad/s or m/s] and
        effort [N m or N], each lowest and highest
    """

    name: str
    label: str
    slides: bool
    ranges: dict[str, tuple[float, float]] = field(hash=False)

    def unit(self, field: str) -> str:
        units = (('m', 'm/s', 'N') if self.slides else ('rad', 'rad/s', 'N m'))
        return units[FIELDS.index(field)]


@dataclass(frozen=True)
class ShownPart:
    """A subsystem, an arm or a gripper such as ``right/gripper``, and its commanded joints."""

    name: str
    joints: tuple[ShownJoint, ...]

    @property
    def is_gripper(self) -> bool:
        """True if it is a gripper, which an action of +1 closes."""
        return self.name.endswith('/gripper')


@dataclass(frozen=True)
class Robot:
    """
    A robot of the node.

    :ivar space: what the names of its topics begin with, such as ``/left/``
    :ivar title: its name for people; empty for the only robot
    :ivar parts: that do not overlap
    :ivar end_effectors: the arms that take Cartesian targets
    :ivar twist: velocities that the base takes along x and y and about z at most [m/s, m/s,
        rad/s]; None without such a base
    """

    space: str
    title: str
    parts: tuple[ShownPart, ...]
    end_effectors: tuple[str, ...]
    twist: tuple[float, float, float] | None = None

    def titled(self, text: str) -> str:
        """Return the name of something of this robot, for people."""
        return plain(f'{self.title}: {text}' if self.title else text)

    def status_name(self, part: str) -> str:
        """Return the name of the diagnostics of a part."""
        return f'{self.title}/{part}'.lstrip('/')


def declared_limits(urdf: str) -> dict[str, dict[str, float]]:
    """Return the finite ``lower``, ``upper``, ``velocity`` and ``effort`` that a URDF declares."""
    try:
        root = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    limits = {str(joint.get('name')): {key: float(limit.attrib[key])
                                       for key in _LIMITS if key in limit.attrib}
              for joint in root.iter('joint') if (limit := joint.find('limit')) is not None}
    if not all(math.isfinite(value) for each in limits.values() for value in each.values()):
        raise ValueError('a limit of a joint is not finite')
    return limits


def commanded_joints(model: mujoco.MjModel, names: list[str],
                     limits: Mapping[str, Mapping[str, float]], gripper: bool
                     ) -> tuple[ShownJoint, ...]:
    """
    Return those joints that have an actuator of their own.

    :param limits: as :func:`declared_limits` returns them
    :param gripper: whether the part is a gripper, whose joints take positions only where the
        actuator is a position servo
    """
    driven = {int(model.actuator_trnid[i, 0]) for i in range(model.nu)
              if int(model.actuator_trntype[i]) in _OF_JOINTS
              and (not gripper or model.actuator_biasprm[i, 1] < 0.0)}
    labels = dict(zip(names, short_labels(names)))
    joints = []
    for name in names:
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if index in driven:
            slides = int(model.jnt_type[index]) == _SLIDE
            declared, far = limits.get(name, {}), _WAY_M if slides else _TURN
            low, high = declared.get('lower', -far), declared.get('upper', far)
            if not (0.0 <= high - low <= _MANY * far and abs(low) <= _MANY * far):
                low, high = -far, far
            speed = limit_of(declared, 'velocity', _SPEED)
            effort = limit_of(declared, 'effort', _EFFORT)
            joints.append(ShownJoint(name, plain(labels[name]), slides, {
                'position': (low, high), 'velocity': (-speed, speed),
                'effort': (-effort, effort)}))
    return tuple(joints)


def limit_of(limits: Mapping[str, float], key: str, usual: float) -> float:
    """Return a limit of a joint, or the usual one where none is declared that can be used."""
    limit = limits.get(key, 0.0)
    return limit if 0.0 < limit <= _GREAT else usual


def short_labels(names: list[str]) -> list[str]:
    """Return names without the words that all begin with, and without ``_joint`` at the end."""
    common = os.path.commonprefix(names) if len(names) > 1 else names[0] if names else ''
    begin = common.rfind('_') + 1
    if len(names) == 1:
        begin = common.find('_') + 1
    labels = [name[begin:].removesuffix('_joint').replace('_', ' ') for name in names]
    if all(label.isdigit() for label in labels):
        return [f'joint {label}' for label in labels]
    return labels


OK, WARN, ERROR = 0, 1, 2
_SIGNS = {OK: '', WARN: 'Warning: ', ERROR: 'Error: '}
#: Fates of commands: by the key of the node's count, in words.
_OUTCOMES = {
    'dropped': 'rejected', 'clamped': 'clamped', 'slowed': 'slowed down', 'timeouts': 'timed out',
    'faults': 'failed in the gripper', 'cartesian_unreachable': 'out of reach',
    'cartesian_joint_limit': 'stopped by joint limits', 'cartesian_singular': 'at a singularity',
    'cartesian_slowed': 'slower than requested', 'cartesian_aside': 'off the straight line'}


@dataclass(frozen=True)
class ShownStatus:
    """
    A status of ``/diagnostics``, with its name without that of the node.

    :ivar level: 0 is all right, 1 is a warning, more is an error
    """

    level: int
    name: str
    message: str
    values: Mapping[str, str] = field(default_factory=dict)

    def number(self, key: str) -> float | None:
        """Return the value of a key as a finite number; None if it has none."""
        try:
            number = float(self.values[key])
        except (KeyError, ValueError):
            return None
        return number if math.isfinite(number) else None


def command_fields(statuses: Iterable[ShownStatus]) -> dict[str, str]:
    """Return the fields that the commands of parts use, by topic, such as ``left/arm``."""
    return {status.name: status.values['command_interface'] for status in statuses
            if status.values.get('command_interface') in FIELDS}


def control_modes(statuses: Iterable[ShownStatus]) -> dict[str, str]:
    """Return the control modes of parts, by topic, such as ``left/arm``."""
    return {status.name: status.values['control_mode'] for status in statuses
            if 'control_mode' in status.values}


def in_words(statuses: Iterable[ShownStatus]) -> list[Line]:
    """Return a line for each status, the most severe first."""
    ranked = sorted(statuses, key=lambda status: -status.level)
    lines = [Line(_words(status), title=f'{_SIGNS[min(status.level, ERROR)]}{status.name}')
             for status in ranked if status.values or status.level]
    return lines or [Line('No diagnostics yet.')]


def _words(status: ShownStatus) -> str:
    values = status.values
    if 'real_time_factor' in values:
        words = [f'{values.get("state", status.message)} at {values["real_time_factor"]} times '
                 'real time', f'{values.get("missed_deadlines", "0")} deadlines missed']
        words += [f'{count} times {name.removeprefix("mjWARN_")}'
                  for name, count in values.items() if name.startswith('mjWARN') and count != '0']
        words += [f'{count} {name.replace("_", " ")}' for name, count in values.items()
                  if name.startswith('failed_') and count != '0']
        if (defects := values.get('start_defects', 'none')) != 'none':
            words.append(f'at the start: {defects}')
    elif 'accepted' in values:
        age_s = status.number('age')
        words = [f'{values["control_mode"]} mode'] if 'control_mode' in values else []
        words.append('no command yet' if age_s is None else
                     f'{values["accepted"]} commands, {values.get("rate", "0.0")} per second, the '
                     f'last {age_s:.1f} s ago')
        words += [f'{values[key]} {outcome}' for key, outcome in _OUTCOMES.items()
                  if values.get(key, '0') != '0']
    elif status.name == 'cameras':
        words = [f'{key.removesuffix(".rate")} {rate} images per second'
                 for key, rate in values.items() if key.endswith('.rate')]
    else:
        words = [', '.join(f'{key} {value}' for key, value in values.items())]
    if status.level != OK or not {'accepted', 'real_time_factor'} & values.keys():
        words.insert(0, status.message)
    return '; '.join(filter(None, words))


_WINDOW_S = 2.0


class RealTimeFactor:
    """The real-time factor of the last two seconds of wall time."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()

    def add(self, wall_s: float, time_s: float) -> None:
        """Add a pair of wall time and simulation time [s]."""
        if self._seen and time_s < self._seen[-1][1]:
            self._seen.clear()
        self._seen.append((wall_s, time_s))
        while len(self._seen) > 2 and self._seen[1][0] < wall_s - _WINDOW_S:
            self._seen.popleft()

    @property
    def factor(self) -> float | None:
        """Simulation time per wall time; None before the pairs span a second of wall time."""
        if not self._seen or self._seen[-1][0] < self._seen[0][0] + 0.5 * _WINDOW_S:
            return None
        (first_wall, first), (last_wall, last) = self._seen[0], self._seen[-1]
        return (last - first) / (last_wall - first_wall)


@dataclass(frozen=True)
class JointStates:
    """
    The joints of one robot at one instant.

    :ivar position: [rad or m], as long as the names
    :ivar velocity: [rad/s or m/s]
    :ivar effort: [N m or N]
    :ivar time_s: simulation time [s]
    """

    names: Sequence[str]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    time_s: float


@dataclass(frozen=True)
class PoseInWorld:
    """Pose of a frame in ``world``: a position [m], shape (3,), and a quaternion, shape (4,)."""

    position: FloatArray
    quat_wxyz: FloatArray


@dataclass
class Latest:
    """
    The newest state of each kind.

    :ivar joints: by namespace of the robot's topics
    :ivar end_effectors: by namespace and arm
    :ivar wrenches: the external wrench, force and torque [N, N m], shape (6,), by namespace and
        arm
    :ivar contacts: where bodies touch, in ``world`` [m], shape (n, 3)
    :ivar arrows: by what they show: from and to, in ``world`` [m], shape (n, 2, 3)
    :ivar images: by camera, shape (h, w, 3); removed when they are shown
    :ivar joints_s: wall time of the newest joint states [s]
    """

    joints: dict[str, JointStates] = field(default_factory=dict)
    end_effectors: dict[tuple[str, str], PoseInWorld] = field(default_factory=dict)
    wrenches: dict[tuple[str, str], FloatArray] = field(default_factory=dict)
    objects: dict[str, PoseInWorld] = field(default_factory=dict)
    contacts: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    arrows: dict[str, FloatArray] = field(default_factory=dict)
    images: dict[str, NDArray[Any]] = field(default_factory=dict)
    diagnostics: list[ShownStatus] = field(default_factory=list)
    joints_s: float = 0.0
