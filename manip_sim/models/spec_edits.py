# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Edits of a ``mujoco.MjSpec`` for which MuJoCo has no function, and names of its elements."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache
import re
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, quat_wxyz_from_rpy
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.actuators import JOINT_TRANSMISSIONS

#: Begin of names of joints, frames and of topics named after cameras and objects.
_PREFIX = re.compile(r'[A-Za-z][A-Za-z0-9_]{0,63}')
#: The lists of a spec whose elements have names, by kind.
NAMED_ELEMENTS = {
    'body': 'bodies', 'joint': 'joints', 'geom': 'geoms', 'site': 'sites', 'camera': 'cameras',
    'light': 'lights', 'actuator': 'actuators', 'sensor': 'sensors', 'tendon': 'tendons',
    'equality': 'equalities', 'exclude': 'excludes', 'pair': 'pairs', 'mesh': 'meshes',
    'material': 'materials', 'texture': 'textures', 'hfield': 'hfields', 'flex': 'flexes',
    'skin': 'skins', 'numeric': 'numerics', 'text': 'texts', 'tuple': 'tuples',
    'plugin': 'plugins'}
_WITH_DEFAULTS = ('joints', 'geoms', 'sites', 'cameras', 'lights', 'actuators', 'equalities',
                  'pairs', 'meshes', 'materials')


def check_prefix(prefix: str) -> None:
    """Reject a prefix that names in ROS cannot begin with."""
    if not _PREFIX.fullmatch(prefix):
        raise ModelError(f'prefix {prefix[:64]!r} cannot begin the names of joints and frames: '
                         'it needs a letter, then at most 63 letters, digits and underscores')


class TakenNames:
    """The names of a spec, collected once for all attachments."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._by_list = {elements: {element.name for element in getattr(spec, elements)}
                         for elements in NAMED_ELEMENTS.values()}

    def copy(self, spec: mujoco.MjSpec) -> TakenNames:
        """Return a copy for a copy of the spec."""
        new = TakenNames.__new__(TakenNames)
        new._spec = spec
        new._by_list = {elements: set(names) for elements, names in self._by_list.items()}
        return new

    def add(self, added: mujoco.MjSpec, prefix: str, part: str) -> None:
        """
        Reject attaching a spec that has one of the names, else add its names.

        MuJoCo would not compile the result, or would write XML that it cannot read again.

        :param prefix: begin of its names
        """
        lists = {elements: getattr(added, elements) for elements in self._by_list}
        names = {elements: [name for element in each
                            if (name := element.name) not in ('', 'world')]
                 for elements, each in lists.items()}
        for kind, elements in NAMED_ELEMENTS.items():
            for name in names[elements]:
                if prefix + name in self._by_list[elements]:
                    raise _taken(kind, prefix, name, part)
        classes = {element.classname.name for elements in _WITH_DEFAULTS
                   for element in lists[elements]}
        for name in sorted(classes):
            if self._spec.find_default(prefix + name) is not None:
                raise _taken('default class', prefix, name, part)
        for elements, own_names in names.items():
            self._by_list[elements].update(prefix + name for name in own_names)

    def discard(self, elements: str, name: str) -> None:
        """Follow the deletion of an element from a list of the spec, such as ``bodies``."""
        self._by_list[elements].discard(name)

    def rename(self, elements: str, old: str, new: str) -> None:
        """
        Follow a new name.

        :param elements: the list of the spec that has it, such as ``bodies``
        """
        self._by_list[elements].discard(old)
        self._by_list[elements].add(new)


def _taken(kind: str, prefix: str, name: str, part: str) -> ModelError:
    if not prefix:
        return ModelError(f"{kind} '{name}' of {part} already exists, from a robot: "
                          'change the idn or prefix of the robot')
    return ModelError(f"{kind} '{prefix}{name}' already exists, {part} cannot bring another: "
                      f'change the idn or prefix of {part}, or the name in its file')


_SIZES = ('memory', 'nuserdata')
_OLD_SIZES = ('nkey', 'njmax', 'nconmax', 'nstack')
_USER_COUNTS = tuple(f'nuser_{kind}' for kind in (
    'body', 'jnt', 'geom', 'site', 'cam', 'tendon', 'actuator', 'sensor'))
_BODIES = (int(mujoco.mjtObj.mjOBJ_BODY), int(mujoco.mjtObj.mjOBJ_XBODY))
#: In longer timesteps [s], the time constants of contacts are at least so many of them.
_SHORT_S, _CONTACT_STEPS = 0.002, 4.0
#: Damping ratio of couplings for which MuJoCo takes two long timesteps. With 1, the fingers of
#: XArm7 and IIWA keep both arms swinging at 0.05 rad/s while they press at 5 ms; with 1.5, the
#: joints of the Robotiq85Gripper are apart by 1.6 in place of 1.0 % of their range as it closes.
_COUPLING_DAMPING = 1.5
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_EQ, _TRN = mujoco.mjtEq, mujoco.mjtTrn
_WRAPS_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_OF_THE_ELEMENT = frozenset(('classname', 'compiler', 'id', 'info', 'plugin', 'signature'))


def weld_joints(spec: mujoco.MjSpec, kept: Collection[str]) -> None:
    """
    Fix all joints but some where they are, and leave out what drives, ties or measures them.

    :param spec: it has no keyframes
    :param kept: names of the other joints
    """
    joints = [joint for joint in spec.joints if joint.name not in kept]
    welded = {joint.name for joint in joints}
    tendons = [tendon for tendon in spec.tendons
               if any(int(wrap.type) == _WRAPS_JOINT and wrap.target.name in welded
                      for wrap in tendon.path)]
    loose = {tendon.name for tendon in tendons if tendon.name}
    tied = {int(_EQ.mjEQ_JOINT): welded, int(_EQ.mjEQ_TENDON): loose}
    delete_elements(spec, [equality for equality in spec.equalities if tied.get(
        int(equality.type), set()) & {equality.name1, equality.name2}])
    driven = {**dict.fromkeys(JOINT_TRANSMISSIONS, welded), int(_TRN.mjTRN_TENDON): loose}
    actuators = [actuator for actuator in spec.actuators
                 if actuator.target in driven.get(int(actuator.trntype), ())]
    delete_elements(spec, [*actuators, *tendons, *joints])


def rename_body(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str) -> None:
    """Rename a body, and the references to it in other elements."""
    for element, attribute in _references_to_bodies(spec):
        if getattr(element, attribute) == body.name:
            setattr(element, attribute, name)
    for element, attribute, kinds in _lists_of_bodies(spec):
        names = list(getattr(element, attribute))
        renamed = [name if other == body.name and kind in _BODIES else other
                   for other, kind in zip(names, kinds or [_BODIES[0]] * len(names))]
        if renamed != names:
            setattr(element, attribute, renamed)
    body.name = name


def _lists_of_bodies(spec: mujoco.MjSpec) -> Iterator[tuple[Any, str, list[int]]]:
    """Yield lists of names with the types of the elements; empty types if all are bodies."""
    for skin in spec.skins:
        yield skin, 'bodyname', []
    for flex in spec.flexes:
        yield flex, 'nodebody', []
        yield flex, 'vertbody', []
    for group in spec.tuples:
        yield group, 'objname', list(group.objtype)


def _references_to_bodies(spec: mujoco.MjSpec) -> Iterator[tuple[Any, str]]:
    for exclude in spec.excludes:
        yield exclude, 'bodyname1'
        yield exclude, 'bodyname2'
    for watcher in [*spec.cameras, *spec.lights]:
        yield watcher, 'targetbody'
    for equality in spec.equalities:
        if int(equality.objtype) in _BODIES:
            yield equality, 'name1'
            yield equality, 'name2'
    for actuator in spec.actuators:
        if int(actuator.trntype) == int(mujoco.mjtTrn.mjTRN_BODY):
            yield actuator, 'target'
    for sensor in spec.sensors:
        if int(sensor.objtype) in _BODIES:
            yield sensor, 'objname'
        if int(sensor.reftype) in _BODIES:
            yield sensor, 'refname'


def body_for(spec: mujoco.MjSpec, noun: str, name: str, body: str, others: Mapping[str, str]
             ) -> mujoco.MjsBody:
    """
    Return the body that a new element of a spec is fixed to.

    :param name: its name, and ``body`` that of the body
    :param others: kinds of elements that may not have its name, and what to do if one has
    :raises ModelError: if one has
    :raises UnknownNameError: if the body is unknown
    """
    elements = {'body': spec.bodies, 'camera': spec.cameras, 'site': spec.sites}
    for kind, hint in others.items():
        if any(element.name == name for element in elements[kind]):
            raise ModelError(f'{noun}: there is a {kind} of this name already{hint}')
    parent = spec.body(body)
    if parent is None:
        raise UnknownNameError(f'body of the {noun}', body,
                               [element.name for element in spec.bodies])
    return parent


def begin_like(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return an empty spec with the options, visual settings, statistics and sizes of another."""
    new = mujoco.MjSpec()
    for settings in ('option', 'visual', 'stat', *_SIZES):
        setattr(new, settings, getattr(spec, settings))
    return new


def attach(spec: mujoco.MjSpec, part_spec: mujoco.MjSpec, prefix: str, frame: mujoco.MjsFrame
           ) -> None:
    """
    Attach a spec to another without MuJoCo's warnings; its global settings are left behind.

    :param part_spec: the spec to be attached, not to be used afterwards
    """
    _yield_globals(part_spec, spec)
    if not prefix and spec.assets and not part_spec.assets:
        part_spec.assets = dict(spec.assets)  # MuJoCo warns if only one of them holds files.
    attach_as_is(spec, part_spec, prefix, frame)


def attach_as_is(spec: mujoco.MjSpec, part_spec: mujoco.MjSpec, prefix: str, frame: mujoco.MjsFrame
                 ) -> None:
    """
    Attach a spec to another, and leave sensors of no element, such as user sensors, without one.

    MuJoCo gives them the prefix as the name of an element; it does not read the XML of that.
    """
    of_nothing = [not sensor.objname for sensor in part_spec.sensors]
    # Lists of elements are collected each time, which counts with hundreds of objects.
    present = len(spec.sensors) if any(of_nothing) else 0
    spec.attach(part_spec, prefix=prefix, frame=frame)
    if not any(of_nothing):
        return
    for sensor, is_of_nothing in zip(spec.sensors[present:], of_nothing):
        if is_of_nothing:
            sensor.objname = ''


def _yield_globals(part_spec: mujoco.MjSpec, spec: mujoco.MjSpec) -> None:
    """
    Give a spec the global settings of the one that it will be attached to.

    MuJoCo would keep the latter's anyway, but would warn of each that differs. Both get the larger
    sizes of memory and user data; the numbers of ``user`` values are left to the compiler.
    """
    part_spec.option, part_spec.visual, part_spec.stat = spec.option, spec.visual, spec.stat
    for size in _SIZES:
        setattr(spec, size, max(getattr(part_spec, size), getattr(spec, size)))
        setattr(part_spec, size, getattr(spec, size))
    for count in _OLD_SIZES:
        setattr(part_spec, count, getattr(spec, count))
    for count in _USER_COUNTS:
        setattr(part_spec, count, -1)


def soften_contacts(spec: mujoco.MjSpec, timestep_s: float) -> None:
    """
    Let contacts be no stiffer than a long timestep allows, or they oscillate from step to step.

    In timesteps of more than 2 ms, the time constants of ``solref`` become at least four
    timesteps. Negative numbers there, which are stiffness and damping, stay.

    :param timestep_s: of the physics [s]
    """
    if timestep_s <= _SHORT_S:
        return
    for element in (*spec.geoms, *spec.pairs):
        if element.solref[0] > 0.0:
            element.solref[0] = max(element.solref[0], _CONTACT_STEPS * timestep_s)


def fit_couplings(spec: mujoco.MjSpec, timestep_s: float) -> None:
    """
    Let couplings of joints that shall be stiffer than the timestep allows be as stiff as it does.

    For a time constant of less than two timesteps, MuJoCo takes two. If it is less than one,
    stiffness and damping close a gap in one step; that is four times as stiff, and stable too.
    Otherwise, in timesteps of more than 2 ms, the damping ratio becomes at least 1.5.

    :param timestep_s: of the physics [s]
    """
    for tie in spec.equalities:
        if int(tie.type) != int(mujoco.mjtEq.mjEQ_JOINT):
            continue
        if 0.0 < tie.solref[0] < timestep_s:
            tie.solref = -1.0 / timestep_s**2, -1.0 / timestep_s
        elif timestep_s > _SHORT_S and 0.0 < tie.solref[0] <= 2.0 * timestep_s:
            tie.solref[1] = max(tie.solref[1], _COUPLING_DAMPING)


def name_main_default(part_spec: mujoco.MjSpec) -> None:
    """
    Rename the default class ``main`` of a spec.

    After attaching a spec without a prefix there would be two of that name.
    """
    name = 'arena'
    while part_spec.find_default(name) is not None:
        name += '_main'
    part_spec.default.name = name


def delete_elements(spec: mujoco.MjSpec, elements: list[Any]) -> None:
    """Delete elements other than bodies, and the sensors and contact pairs that refer to them."""
    # The kind of an element such as an ``MjsJoint``.
    deleted = {(int(getattr(mujoco.mjtObj, f'mjOBJ_{type(element).__name__[3:].upper()}')),
                element.name) for element in elements if element.name}
    for sensor in [sensor for sensor in spec.sensors if deleted.intersection((
            (int(sensor.objtype), sensor.objname), (int(sensor.reftype), sensor.refname)))]:
        spec.delete(sensor)
    for pair in [pair for pair in spec.pairs if deleted.intersection((
            (_GEOM, pair.geomname1), (_GEOM, pair.geomname2)))]:
        spec.delete(pair)
    for element in elements:
        spec.delete(element)


def rotate_actuators(actuators: list[mujoco.MjsActuator], count: int) -> None:
    """
    Move the first of some consecutive actuators of a spec behind the others.

    Elements of a spec cannot be moved, so their contents are. Contents of plugins cannot be moved,
    so with them all stay where they are.

    :param count: how many of them go to the end
    """
    if not 0 < count < len(actuators) or any(each.plugin.active for each in actuators):
        return
    contents = [_content(actuator) for actuator in actuators]
    for actuator in actuators:
        actuator.name = ''  # No name may occur twice at any time.
    for actuator, content in zip(actuators, contents[count:] + contents[:count]):
        for field, value in content.items():
            setattr(actuator, field, value)


@lru_cache(maxsize=1)
def _fields_of_actuators() -> list[str]:
    return [field for field in dir(mujoco.MjsActuator) if field not in _OF_THE_ELEMENT
            and not field.startswith(('_', 'set_to_'))]


def _content(actuator: mujoco.MjsActuator) -> dict[str, Any]:
    content = {field: getattr(actuator, field) for field in _fields_of_actuators()}
    content['userdata'] = list(content['userdata'])
    return {field: value.copy() if isinstance(value, np.ndarray) else value
            for field, value in content.items()}


def quat_wxyz_of(orientation: ArrayLike) -> FloatArray:
    """
    Return the quaternion w, x, y, z of a rotation in a description, normalised, shape (4,).

    :param orientation: roll, pitch, yaw [rad], shape (3,), or w, x, y, z, shape (4,)
    """
    numbers = np.asarray(orientation, dtype=float)
    if numbers.shape == (3,):
        return quat_wxyz_from_rpy(numbers)
    unit: FloatArray = numbers / length(numbers)
    return unit


def free_name(taken: Collection[str], wanted: str) -> str:
    """Return a name that is not taken: the wanted one, or that with a number."""
    name, number = wanted, 1
    while name in taken:
        name, number = f'{wanted}{number}', number + 1
    return name


def find_place(spec: mujoco.MjSpec, name: str, source: str) -> tuple[str, Any]:
    """Return ``body`` or ``site``, and the element of that name; a body goes before a site."""
    body = spec.body(name)
    if body is not None and name != 'world':
        return 'body', body
    site = spec.site(name)
    if site is not None:
        return 'site', site
    raise UnknownNameError(f'body or site in {source}', name, [
        element.name for element in [*spec.bodies[1:], *spec.sites]])


def add_body_at(model: mujoco.MjModel, place: tuple[str, Any], name: str, position: ArrayLike,
                orientation: ArrayLike) -> Any:
    """
    Add a body without mass.

    :param model: the spec before edits, compiled; gives the poses of sites
    :param place: ``body`` or ``site``, and the element
    :param position: in the body or site [m], shape (3,)
    :param orientation: in the body or site, see :func:`quat_wxyz_of`
    """
    kind, element = place
    pos, quat = np.asarray(position, dtype=float), quat_wxyz_of(orientation)
    parent = element
    if kind == 'site':
        parent = element.parent
        site = model.site(element.name)
        turned, whole = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(turned, pos, site.quat)
        mujoco.mju_mulQuat(whole, site.quat, quat)
        pos, quat = site.pos + turned, whole
    return parent.add_body(name=name, pos=pos, quat=quat)
