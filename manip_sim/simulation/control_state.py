# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The state of the objects that control robots, which their classes declare.

What MuJoCo integrates, and what a whole state of a simulation consists of, is not known here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import enum
from functools import cached_property
from typing import Any

import numpy as np

from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.physics.robot_frames import Frame
from manip_sim.simulation.plain_data import Encoder, KINDS

#: Modules of the classes whose objects may have a state, or others that have one.
_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.simulation.')
#: Types of values without identity, which cannot change.
_VALUES = (type(None), bool, int, float, str, bytes, enum.Enum, np.generic)


class ControlState:
    """
    The state of the objects that control robots.

    A class whose objects remember something from one control period to the next declares the
    names of these attributes in ``remembered``, and in ``undigested`` those of them on which the
    future does not depend, such as counts. Their values are numbers, texts, arrays, containers,
    commands, and objects that hold such values; all other attributes stay as they are at
    construction. Containers and arrays are the owner's own: what two owners both change would be
    two after a state is restored. Of grippers, whose ``format_action`` may have a state in classes
    of users too, all arrays of numbers and plain values belong to the state.

    :param roots: objects from which those with a state are reached through attributes and
        containers, between two control periods
    """

    def __init__(self, roots: Iterable[object]) -> None:
        self._owners: list[Any] = []
        self._grippers: list[GripperModel] = []
        #: Models and frames of robots, to which commands refer; frames change with the model.
        self._fixed: list[object] = []
        self._find(list(roots))
        self._index_of = {id(item): index for index, item in enumerate(self._fixed)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)  # In a copy, other objects are fixed.
        self._index_of = {id(item): index for index, item in enumerate(self._fixed)}

    def _find(self, left: list[Any]) -> None:
        seen: set[int] = set()
        while left:
            item = left.pop(0)
            if isinstance(item, _VALUES) or id(item) in seen:
                continue
            seen.add(id(item))
            if isinstance(item, Mapping):
                left += item.values()
            elif isinstance(item, (list, tuple, set, frozenset)):
                left += item
            elif isinstance(item, (MujocoXMLModel, Frame)):
                self._fixed.append(item)
                if isinstance(item, GripperModel):
                    self._grippers.append(item)
            elif type(item).__module__.startswith(_ROOMS) and hasattr(item, '__dict__'):
                remembered = getattr(type(item), 'remembered', None)
                if remembered is not None:
                    self._owners.append(item)
                # Only some simulations have the objects that commands bring along.
                left += (value for name, value in vars(item).items()
                         if name not in (remembered or ()))

    def content(self) -> list[dict[str, Any]]:
        """Return what each object with a state remembers, and each gripper; no copies."""
        return [*({name: getattr(owner, name) for name in owner.remembered}
                  for owner in self._owners), *map(_numbers, self._grippers)]

    @property
    def fixed(self) -> list[object]:
        """The objects that a state refers to by index, the same in every simulation of a world."""
        return self._fixed

    @property
    def index_of(self) -> Mapping[int, int]:
        """The index of each fixed object, by its ``id``."""
        return self._index_of

    @property
    def count(self) -> int:
        """Number of objects of this package with a state, the first in :meth:`content`."""
        return len(self._owners)

    @cached_property
    def layout(self) -> str:
        """The objects with a state, what they remember, and the models that it refers to."""
        return ' '.join([*(f'{type(owner).__qualname__}({",".join(owner.remembered)})'
                           for owner in self._owners),
                         *(type(item).__qualname__ for item in self._fixed
                           if not isinstance(item, Frame))])

    def encoded(self, encoder: Encoder) -> list[dict[str, Any]]:
        """Return the content as plain data."""
        return [*(encoder.members(owner, owner.remembered) for owner in self._owners),
                *(encoder.encode(_numbers(gripper)) for gripper in self._grippers)]

    def replace(self, content: Iterable[dict[str, Any]]) -> None:
        """Restore a content, which nobody else may use then."""
        for owner, values in zip((*self._owners, *self._grippers), content):
            vars(owner).update(values)


def _numbers(gripper: GripperModel) -> dict[str, Any]:
    """Return the attributes of a gripper that are arrays of numbers or plain values."""
    return {name: value for name, value in vars(gripper).items()
            if isinstance(value, _VALUES)
            or isinstance(value, np.ndarray) and value.dtype.kind in KINDS}
