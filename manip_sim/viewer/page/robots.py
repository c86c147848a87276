# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots of a node as the page shows them, without their states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
import os.path
from xml.etree import ElementTree

import mujoco

from manip_sim.viewer.page.plain_text import plain

#: How far the sliders of a hinge and of a slide joint without a range go either way
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

    :ivar name: in messages
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
    """
    A subsystem, an arm or a gripper.

    :ivar name: ``arm``, ``right``, ``right/gripper`` ...
    :ivar joints: those that can be commanded
    """

    name: str
    joints: tuple[ShownJoint, ...]

    @property
    def is_gripper(self) -> bool:
        """Whether it is a gripper, which an action of +1 closes."""
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

    def titled(self, what: str) -> str:
        """Return the name of something of this robot, for people."""
        return plain(f'{self.title}: {what}' if self.title else what)

    def status_name(self, part: str) -> str:
        """Return the name of the diagnostics of a part."""
        return f'{self.title}/{part}'.lstrip('/')


def declared_limits(urdf: str) -> dict[str, dict[str, float]]:
    """
    Return ``lower``, ``upper``, ``velocity`` and ``effort`` of joints, as far as declared.

    :raises ValueError: if it is not XML, or a limit is not a finite number
    """
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

    :param names: of the joints of a part
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
            joints.append(ShownJoint(name, plain(labels[name]), slides,
                                     _ranges(limits.get(name, {}), slides)))
    return tuple(joints)


def limit_of(limits: Mapping[str, float], key: str, usual: float) -> float:
    """Return a limit of a joint, or the usual one where none is declared that can be used."""
    limit = limits.get(key, 0.0)
    return limit if 0.0 < limit <= _GREAT else usual


def _ranges(limits: Mapping[str, float], slides: bool) -> dict[str, tuple[float, float]]:
    far = _WAY_M if slides else _TURN
    low, high = limits.get('lower', -far), limits.get('upper', far)
    if not (0.0 <= high - low <= _MANY * far and abs(low) <= _MANY * far):
        low, high = -far, far
    speed = limit_of(limits, 'velocity', _SPEED)
    effort = limit_of(limits, 'effort', _EFFORT)
    return {'position': (low, high), 'velocity': (-speed, speed), 'effort': (-effort, effort)}


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
