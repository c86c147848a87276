# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Check names of parts in a composition: that prefixes are valid and no name occurs twice."""

from __future__ import annotations

import re

import mujoco

from manip_sim.errors import ModelError

#: What joints, frames and the topics named after cameras and objects may all begin with.
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
    """The names of a spec, collected once for all that is attached to it."""

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

    def add(self, own: mujoco.MjSpec, prefix: str, part: str) -> None:
        """
        Reject attaching a spec that has one of the names, else add its names.

        MuJoCo would not compile the result, or would write XML that it cannot read again.

        :param prefix: what its names will begin with
        """
        lists = {elements: getattr(own, elements) for elements in self._by_list}
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
        for elements, added in names.items():
            self._by_list[elements].update(prefix + name for name in added)

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
