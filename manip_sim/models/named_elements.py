# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The elements of a part, by the names that they have in a compiled model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, overload

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.naming import check_prefix


class NamedElements:
    """
    Names of the elements of a part by kind, with its prefix, in the order of the compiled model.

    :param file: where they come from, for messages
    :param idn: number or word that distinguishes parts of one kind; part of the prefix
    :ivar file: where they come from
    :ivar idn: number or word
    """

    _important_sites: Mapping[str, str] = {}
    _important_geoms: Mapping[str, list[str]] = {}
    _important_sensors: Mapping[str, str] = {}
    _own_model: mujoco.MjModel

    def __init__(self, file: Path, idn: int | str) -> None:
        self.file = file
        self.idn = idn
        self._given_prefix = ''

    def _record_elements(self, alone: mujoco.MjModel) -> None:
        """Record what is in the part, compiled alone."""
        self._own_model = alone

        not_free = alone.jnt_type != int(mujoco.mjtJoint.mjJNT_FREE)
        self._bodies = _names(alone.body, range(1, alone.nbody))
        self._joints = _names(alone.joint, np.flatnonzero(not_free).tolist())
        self._actuators = _names(alone.actuator, range(alone.nu))
        self._sensors = _names(alone.sensor, range(alone.nsensor))
        self._cameras = _names(alone.camera, range(alone.ncam))
        self._record_shapes(alone, range(alone.nbody))
        self._check_important('site', self._important_sites.values(), self._sites)
        self._check_important('sensor', self._important_sensors.values(), self._sensors)

    def _record_shapes(self, model: mujoco.MjModel, bodies: Iterable[int]) -> None:
        """Record the sites and geoms of some bodies."""
        own = list(bodies)
        here = np.isin(model.geom_bodyid, own)
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        self._sites = _names(model.site, np.flatnonzero(np.isin(model.site_bodyid, own)).tolist())
        self._contact_geoms = _names(model.geom, np.flatnonzero(here & collides).tolist())
        self._visual_geoms = _names(model.geom, np.flatnonzero(here & ~collides).tolist())
        for group in self._important_geoms.values():
            self._check_important('geom', group, self._contact_geoms + self._visual_geoms)

    def _check_important(self, kind: str, wanted: Iterable[str], existing: list[str]) -> None:
        for name in wanted:
            if name not in existing:
                raise UnknownNameError(f'{kind} of {self.name} in {self.file}', name, existing)

    @property
    def name(self) -> str:
        """Class name and idn, such as ``Panda0``."""
        return f'{type(self).__name__}{self.idn}'

    @property
    def naming_prefix(self) -> str:
        """What each name of this part begins with in the compiled model."""
        return self._given_prefix or self._prefix_of_idn

    @property
    def _prefix_of_idn(self) -> str:
        """The prefix unless another is given."""
        return f'{self.idn}_'

    def set_naming_prefix(self, prefix: str) -> None:
        """
        Replace the prefix that the idn gives by another one.

        :param prefix: a letter, then at most 63 letters, digits and underscores, such as
            ``left_``; empty: the prefix that the idn gives
        :raises ModelError: if it is none of these, or the class overrides :attr:`naming_prefix`
        """
        if prefix:
            check_prefix(prefix)
        self._given_prefix = prefix
        if prefix and self.naming_prefix != prefix:
            raise ModelError(f"{self.name} cannot have the prefix '{prefix}': its class says that "
                             f"it is '{self.naming_prefix}'")

    @overload
    def correct_naming(self, names: str) -> str: ...

    @overload
    def correct_naming(self, names: list[str] | tuple[str, ...]) -> list[str]: ...

    @overload
    def correct_naming(self, names: Mapping[str, Any]) -> dict[str, Any]: ...

    def correct_naming(self, names: Any) -> Any:
        """
        Return names with this part's prefix, always a copy.

        :param names: a name, a sequence of names, or a mapping whose values are either
        :raises TypeError: for anything else
        """
        if isinstance(names, str):
            return self.naming_prefix + names
        if isinstance(names, (list, tuple)):
            return [self.correct_naming(name) for name in names]
        if isinstance(names, Mapping):
            return {key: self.correct_naming(value) for key, value in names.items()}
        raise TypeError('names must be a str, a list, a tuple or a dict of them, '
                        f'not {type(names).__name__}')

    @property
    def bodies(self) -> list[str]:
        """All bodies but the world."""
        return self.correct_naming(self._bodies)

    @property
    def joints(self) -> list[str]:
        """All joints but free joints; a ball joint counts once."""
        return self.correct_naming(self._joints)

    @property
    def actuators(self) -> list[str]:
        """All actuators."""
        return self.correct_naming(self._actuators)

    @property
    def joint_ranges(self) -> dict[str, FloatArray]:
        """Range by name of the joint [rad or m], shape (2,), infinite where there is none."""
        found = {raw: self._own_model.joint(raw) for raw in self._joints}
        return {self.correct_naming(raw): np.array(
                    joint.range if joint.limited[0] else (-np.inf, np.inf))
                for raw, joint in found.items()}

    @property
    def control_ranges(self) -> dict[str, FloatArray]:
        """Control range by name of the actuator, in its unit, shape (2,), zeros if it has none."""
        return {self.correct_naming(raw): np.array(self._own_model.actuator(raw).ctrlrange)
                for raw in self._actuators}

    @property
    def sites(self) -> list[str]:
        """All sites."""
        return self.correct_naming(self._sites)

    @property
    def sensors(self) -> list[str]:
        """All sensors."""
        return self.correct_naming(self._sensors)

    @property
    def cameras(self) -> list[str]:
        """All cameras."""
        return self.correct_naming(self._cameras)

    @property
    def contact_geoms(self) -> list[str]:
        """The geoms that can collide, by contype and conaffinity."""
        return self.correct_naming(self._contact_geoms)

    @property
    def visual_geoms(self) -> list[str]:
        """The geoms that cannot collide."""
        return self.correct_naming(self._visual_geoms)

    @property
    def important_sites(self) -> dict[str, str]:
        """Sites by role."""
        return self.correct_naming(self._important_sites)

    @property
    def important_geoms(self) -> dict[str, list[str]]:
        """Lists of geoms by role."""
        return self.correct_naming(self._important_geoms)

    @property
    def important_sensors(self) -> dict[str, str]:
        """Sensors by role."""
        return self.correct_naming(self._important_sensors)

    @property
    def dof(self) -> int:
        """Number of :attr:`joints`."""
        return len(self._joints)


def _names(kind: Callable[[int], Any], ids: Iterable[int]) -> list[str]:
    return [kind(i).name for i in ids]
