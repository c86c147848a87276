# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Limits and mimics of the joints of a URDF: rejected if impossible, and kept by the model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
import math
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.algebra import matrix_of, product
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import quoted, quoted_names

_WITH_RANGE = ('revolute', 'prismatic')
_MOVES = (*_WITH_RANGE, 'continuous')
#: Types of joints; spherical is MuJoCo's own.
_TYPES = ('fixed', *_MOVES, 'planar', 'floating', 'spherical')
#: The link that is the world itself for MuJoCo.
_WORLD = 'world'
#: Time constant [s] and damping ratio of couplings and of the ranges of coupled joints. MuJoCo
#: takes two timesteps where that is longer (refsafe), which is as stiff as is stable.
_SOLREF = (1e-3, 1.0)
#: Impedance, the greatest that MuJoCo takes, at any distance.
_SOLIMP = (0.9999, 0.9999, 1e-3, 0.5, 2.0)
#: Least inertia of a coupled joint, seen from its leader, over effort per range of that [s^2].
#: With the above and a timestep of 5 ms, an effort f displaces a coupling of inertias a and b by
#: 1e-8 s^2 f (1/a + 1/b), so by 0.25 % of the range.
_INERTIA_PER_STIFFNESS = 8e-6
#: Limits of a follower that leave its leader less than this share of the range lock it.
_LEAST_SHARE = 0.05


def check_joints(robot: ElementTree.Element, file: Path) -> tuple[dict[str, float], list[str]]:
    """
    Reject impossible types, limits and mimics, and complete what MuJoCo reads differently.

    As URDF defines, a missing ``lower`` or ``upper`` is 0. If both are there, the smaller number
    is the lower one. A joint that has neither is not limited; nor is an effort or velocity of -1,
    as in SDF. One that is fixed follows no other;
    one that follows it is fixed where that puts it. A link that only joints name is added.

    :param robot: changed in place
    :returns: positions of the joints that are fixed, as their limits are equal, by name [rad or
        m], and the changes, in sentences
    :raises ModelError: naming file and joint, and for types what to write instead
    """
    notes = [*_leave_out_repeated(robot, file), *_declare_links(robot, file)]
    _reject_circle(robot, file)
    joints = {joint.get('name', ''): joint for joint in robot.findall('joint')}
    fixed: dict[str, float] = {}
    unlimited, swapped, of_sdf = [], [], []
    for name, joint in joints.items():
        limit, kind = joint.find('limit'), joint.get('type')
        if limit is not None:  # SDF writes -1 for none.
            none = [key for key in ('effort', 'velocity')
                    if re.fullmatch(r'\s*-1(\.0*)?\s*', limit.get(key, ''))]
            limit.attrib.update(dict.fromkeys(none, '0'))
            of_sdf += [name] * bool(none)
        _reject_negative(limit, ('effort', 'velocity'), name, file)
        _reject_negative(joint.find('dynamics'), ('damping', 'friction'), name, file)
        if kind in _MOVES:
            _reject_zero_axis(joint, name, file)
        if kind not in _WITH_RANGE:
            continue
        if limit is None or not {'lower', 'upper'} & set(limit.keys()):
            unlimited.append(name)
            continue
        lower, upper = _numbers(limit, ('lower', 'upper'), name, file)
        if lower > upper and {'lower', 'upper'} <= set(limit.keys()):
            swapped.append(name)
            lower, upper = upper, lower
        if lower > upper:
            raise ModelError(f'{file}: joint {quoted(name)}: lower {lower:g} of its <limit> is '
                             f'above upper {upper:g}; one that is missing is 0')
        limit.attrib.update(lower=repr(lower), upper=repr(upper))
        if lower == upper:
            fixed[name] = lower
            joint.remove(limit)
    equal = [*fixed]
    followers = _fix_mimics(joints, fixed, file)
    _check_mimics(joints, file)
    for name, joint in joints.items():
        _check_type(joint, name, file)
    return fixed, [
        *notes, *followers,
        *([f'fixed, as lower and upper of their <limit> are equal: {quoted_names(equal)}']
          if equal else []),
        *([f'read the other way round, as lower is above upper in their <limit>: '
           f'{quoted_names(swapped)}; swap these numbers in the file'] if swapped else []),
        *(['without a limit of effort or velocity, as SDF writes it by -1 in their <limit>: '
           f'{quoted_names(of_sdf)}; write 0 in the file'] if of_sdf else []),
        *([f'not limited, as they have neither lower nor upper: {quoted_names(unlimited)}']
          if unlimited else [])]


def _check_type(joint: ElementTree.Element, name: str, file: Path) -> None:
    kind = joint.get('type', '')
    if kind not in _TYPES:
        raise UnknownNameError(f'type of joint {quoted(name)} of {file}', kind, _TYPES)
    parent = joint.find('parent')
    if kind == 'floating' and (parent is None or parent.get('link') != _WORLD):
        raise ModelError(
            f'{file}: joint {quoted(name)} is floating, which only a joint of the link '
            f'{quoted(_WORLD)} can be; write type="fixed", or a joint for each direction, or '
            f'<parent link="{_WORLD}"/> if the whole robot floats')


def _numbers(element: ElementTree.Element | None, attributes: Sequence[str], joint: str,
             file: Path) -> list[float]:
    """Return attributes of an element of a joint, 0 for those that are missing."""
    values: list[float] = []
    if element is None:
        return values
    for attribute in attributes:
        text = element.get(attribute, '0')
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ModelError(f'{file}: joint {quoted(joint)}: {attribute} of its <{element.tag}> '
                             f'must be a finite number, got {quoted(text)}')
        values.append(value)
    return values


def _reject_negative(element: ElementTree.Element | None, attributes: Sequence[str], joint: str,
                     file: Path) -> None:
    for attribute, value in zip(attributes, _numbers(element, attributes, joint, file)):
        if element is not None and value < 0.0:
            raise ModelError(
                f'{file}: joint {quoted(joint)}: {attribute} of its <{element.tag}> is negative: '
                f'{value:g}; write {-value:g}, or 0 for none')


def _reject_zero_axis(joint: ElementTree.Element, name: str, file: Path) -> None:
    axis = joint.find('axis')
    words = ['1'] if axis is None else axis.get('xyz', '1').split()
    if all(re.fullmatch(r'[+-]?[0.]+', word) for word in words):
        raise ModelError(f'{file}: joint {quoted(name)}: its axis is zero: write a direction, as '
                         'in <axis xyz="0 0 1"/>')


def _leave_out_repeated(robot: ElementTree.Element, file: Path) -> list[str]:
    """
    Leave out joints that repeat the links of another one, with its name or fixed in its place.

    :raises ModelError: if other joints lead to the same link or one to ``world``, or if links, or
        a joint that moves and another one, have one name
    """
    leading: dict[str, tuple[str, str, ElementTree.Element]] = {}
    repeated = []
    for joint in robot.findall('joint'):
        name, (parent, child) = joint.get('name', ''), (
            element.get('link', '') if element is not None else ''
            for element in (joint.find('parent'), joint.find('child')))
        if not child or child not in leading:
            leading[child] = name, parent, joint
        elif leading[child][1] == parent and (
                leading[child][0] == name or _are_fixed_alike(leading[child][2], joint)):
            robot.remove(joint)
            repeated.append(name)
        else:
            raise ModelError(f'{file}: joint {quoted(name)} leads to link {quoted(child)}, as '
                             f'joint {quoted(leading[child][0])} does: delete one of them, or '
                             'correct its <child>')
    if _WORLD in leading:
        raise ModelError(f'{file}: joint {quoted(leading[_WORLD][0])} leads to link '
                         f'{quoted(_WORLD)}, the fixed root of all: give it another name')
    moving = {joint.get('name') for joint in robot.findall('joint')
              if joint.get('type') != 'fixed'}
    for kind in ('link', 'joint'):
        names = Counter(element.get('name', '') for element in robot.findall(kind)
                        if kind == 'link' or element.get('name') in moving)
        name, count = next(iter(names.most_common(1)), ('', 0))
        if count > 1:  # No joint is made of fixed ones.
            raise ModelError(f'{file}: {count} elements <{kind}> have the name {quoted(name)}: '
                             'give each another one, also where it is referred to')
    return [f'left out: joints that are there twice: {quoted_names(repeated)}'] if repeated else []


def _are_fixed_alike(*joints: ElementTree.Element) -> bool:
    """Return whether joints are fixed and have the same origin."""
    places = []
    for joint in joints:
        origin = joint.find('origin')
        attributes = {} if origin is None else origin.attrib
        places.append([attributes.get(name, '0 0 0').split() for name in ('xyz', 'rpy')])
    return all(joint.get('type') == 'fixed' for joint in joints) and places[0] == places[1]


def _reject_circle(robot: ElementTree.Element, file: Path) -> None:
    """
    Reject links that lead to each other in a circle, so that no root carries them.

    :raises ModelError: with the joints of the circle
    """
    leading = {child.get('link'): (joint.get('name', ''), parent.get('link'))
               for joint in robot.findall('joint')
               for parent, child in zip(joint.findall('parent'), joint.findall('child'))}
    for link in leading:
        circle = []
        while link in leading and leading[link][0] not in circle:
            name, link = leading[link]
            circle.append(name)
        if link in leading:
            joints = circle[circle.index(leading[link][0]):]
            raise ModelError(f'{file}: joints {quoted_names(joints)} lead from link '
                             f'{quoted(str(link))} back to it, so nothing carries it: delete one '
                             'of them, or correct its <parent> or <child>')


def _declare_links(robot: ElementTree.Element, file: Path) -> list[str]:
    """
    Add the links that joints lead to and that are not declared, as links without shapes.

    :raises ModelError: if a joint begins at such a link, or another link may be meant: one that
        no joint leads to, beside the root
    """
    links = [str(link.get('name')) for link in robot.findall('link')]
    ends = {str(joint.get('name')): [element.get('link') if element is not None else None
                                     for element in (joint.find('parent'), joint.find('child'))]
            for joint in robot.findall('joint')}
    children = {child for _, child in ends.values()}
    roots = [link for link in links if link not in children]
    missing = [(joint, child) for joint, (_, child) in ends.items() if child not in links]
    for joint, (parent, child) in ends.items():
        if parent is not None and parent not in {*links, *children}:
            raise ModelError(f'{file}: joint {quoted(joint)}: {_undeclared("parent", parent)}')
        if child is not None and child not in links and len(roots) > 1:
            raise ModelError(f'{file}: joint {quoted(joint)}: {_undeclared("child", child)}; no '
                             f'joint leads to {quoted_names(roots[1:])}')
    notes = []
    for joint, child in missing:
        if child is not None and child not in links:
            ElementTree.SubElement(robot, 'link', name=child)
            links.append(child)
            notes.append(f'joint {quoted(joint)}: {_undeclared("child", child)}; it is added '
                         'without mass and shape')
    return notes


def _undeclared(end: str, link: str) -> str:
    return f'its {end} link {quoted(link)} is not declared: write <link name="{link}"/>'


def _fix_mimics(joints: Mapping[str, ElementTree.Element], fixed: dict[str, float], file: Path
                ) -> list[str]:
    """
    Let joints that are fixed follow no others, and fix those that follow them.

    :param fixed: gets the positions of the latter [rad or m]
    :returns: the changes, in sentences
    """
    still = {**{name: 0.0 for name, joint in joints.items() if joint.get('type') == 'fixed'},
             **fixed}
    ignored, followers = [], []
    for name in still:
        for tie in joints[name].findall('mimic'):
            joints[name].remove(tie)
            ignored.append(name)
    waiting = [*still]
    while waiting:
        leader = waiting.pop()
        for name, joint in joints.items():
            mimic = joint.find('mimic')
            if mimic is None or mimic.get('joint') != leader or joint.get('type') not in _MOVES:
                continue
            if mimic.get('multiplier') is None:
                mimic.set('multiplier', '1')
            multiplier, offset = _numbers(mimic, ('multiplier', 'offset'), name, file)
            fixed[name] = still[name] = multiplier * still[leader] + offset
            joint.remove(mimic)
            for limit in joint.findall('limit'):
                joint.remove(limit)
            followers.append(name)
            waiting.append(name)
    return [*([f'<mimic> is ignored on joints that are fixed: {quoted_names(ignored)}']
              if ignored else []),
            *([f'fixed, as the joints are that they follow: {quoted_names(followers)}']
              if followers else [])]


def _check_mimics(joints: Mapping[str, ElementTree.Element], file: Path) -> None:
    leaders = {}
    for name, joint in joints.items():
        mimic = joint.find('mimic')
        if mimic is None:
            continue
        _numbers(mimic, ('multiplier', 'offset'), name, file)
        leader = leaders[name] = mimic.get('joint', '')
        if leader not in joints:
            raise UnknownNameError(f'joint in the <mimic> of joint {quoted(name)} of {file}',
                                   leader, joints)
        for joint_name, relation in ((name, 'is on a joint'),
                                     (leader, f'names joint {quoted(leader)},')):
            kind = joints[joint_name].get('type')
            if kind not in _MOVES:
                raise ModelError(f'{file}: joint {quoted(name)}: its <mimic> {relation} which is '
                                 f'{kind}, not one of {", ".join(_MOVES)}')
    for name in leaders:
        chain = [name]
        while (following := leaders.get(chain[-1])) is not None and following not in chain:
            chain.append(following)
        if following == name:  # Else it may lead to a circle, whose own joints are reported.
            raise ModelError(f'{file}: joint {quoted(name)}: its <mimic> is a circle, so nothing '
                             f'can drive it: {" follows ".join(map(quoted, [*chain, name]))}')


def complete_joints(spec: mujoco.MjSpec, robot: ElementTree.Element, fixed: Mapping[str, float]
                    ) -> list[str]:
    """
    Add velocity limits, as the first number of ``user``, and make couplings stiff.

    :param fixed: positions of joints that are replaced by fixed ones, by name [rad or m]
    :returns: which joints end before their leaders do, in sentences
    """
    for name, position in fixed.items():
        _fix(spec, spec.joint(name), position)
    for joint in robot.findall('joint'):
        element, limit = spec.joint(joint.get('name', '')), joint.find('limit')
        velocity = 0.0 if limit is None else float(limit.get('velocity', 0.0))
        if element is not None and velocity > 0.0:
            element.userdata = [velocity]
    notes = []
    for tie in spec.equalities:  # MuJoCo makes them of mimics.
        tie.solref, tie.solimp = _SOLREF, _SOLIMP
        follower, leader = spec.joint(tie.name1), spec.joint(tie.name2)
        for joint in (follower, leader):
            joint.solref_limit, joint.solimp_limit = _SOLREF, _SOLIMP
        if np.ptp(follower.range) and np.ptp(leader.range) and tie.data[1]:
            notes += _range_notes(follower, leader, *map(float, tie.data[:2]))
    return notes


def _range_notes(follower: Any, leader: Any, offset: float, ratio: float) -> list[str]:
    """Return that a joint ends before its leader does, and free one that would lock it."""
    ends = np.sort((follower.range - offset) / ratio)
    low, high = leader.range
    if min(high, ends[1]) - max(low, ends[0]) < _LEAST_SHARE * (high - low):
        # Other tools let followers move as they may, so nobody has seen that limits lock them.
        follower.range = np.sort(offset + ratio * leader.range)
        return [f'the limits of joint {quoted(follower.name)} are left out: within them, joint '
                f'{quoted(leader.name)}, which it follows, would hardly move; correct lower and '
                'upper in its <limit>, or the multiplier in its <mimic>']
    ends = np.clip(ends, low, high)
    if np.abs(ends - leader.range).max() < 0.01 * (high - low):
        return []
    return [f'joint {quoted(leader.name)} reaches only {ends[0]:.4g} to {ends[1]:.4g} of its '
            f'range {low:.4g} to {high:.4g}: there joint {quoted(follower.name)}, which follows '
            'it, is at the ends of its own']


def _fix(spec: mujoco.MjSpec, joint: Any, position: float) -> None:
    body, axis, quat = joint.parent, np.array(joint.axis), np.empty(4)
    mujoco.mju_normalize3(axis)
    if int(joint.type) == int(mujoco.mjtJoint.mjJNT_SLIDE):
        body.pos = body.pos + product(matrix_of(body.quat), position * axis)
    else:
        mujoco.mju_axisAngle2Quat(quat, axis, position)
        mujoco.mju_mulQuat(quat, body.quat, quat)
        body.quat = quat
    spec.delete(joint)


def support_couplings(spec: mujoco.MjSpec) -> None:
    """
    Give coupled joints of a URDF the rotor inertia below which its servos would part them.

    The force of a constraint grows with the inertia of its joints. The rotors are small beside
    that of the leader.
    """
    ties = {tie.name1: (tie.name2, float(tie.data[1])) for tie in spec.equalities}
    for follower in ties:
        leader, ratio = follower, 1.0
        while leader in ties:
            leader, factor = ties[leader]
            ratio *= factor
        servo = spec.actuator(leader)
        if servo is None or not ratio:
            continue
        spans = [abs(float(np.ptp(spec.joint(name).range)) / scale) or 1.0
                 for name, scale in ((leader, 1.0), (follower, ratio))]
        effort = float(np.abs(servo.forcerange).max()) or float(servo.gainprm[0]) * spans[0]
        least = _INERTIA_PER_STIFFNESS * effort / min(spans)
        for name, scale in ((leader, 1.0), (follower, ratio)):
            joint = spec.joint(name)
            joint.armature = max(joint.armature, least / scale**2)
