# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One part of a world, also one of the catalogue: load its MJCF file, compile it, attach it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import functools
import os
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, overload, TYPE_CHECKING

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import KindError, ModelError, UnknownNameError
from manip_sim.models.asset_files import resolve_files
from manip_sim.models.loading import (
    compile_alone, compile_copy, compile_spec, load_spec, name_unnamed_elements)
from manip_sim.models.registry import Registry
from manip_sim.models.spec_edits import attach, check_prefix, name_main_default, TakenNames
from manip_sim.models.user_files import read_yaml
from manip_sim.resources import asset_path
from manip_sim.quoting import format_value
from manip_sim.validation import check_kind

#: Names to use instead, by name.
REPLACEMENTS = {
    'root': 'use spec (a mujoco.MjSpec), or parse to_xml()',
    'tree': 'use spec (a mujoco.MjSpec), or parse to_xml()',
    'worldbody': 'use spec.worldbody',
    'asset': 'use spec.meshes, spec.textures and spec.materials',
    'actuator': 'use spec.actuators',
    'sensor': 'use spec.sensors',
    'equality': 'use spec.equalities',
    'tendon': 'use spec.tendons',
    'contact': 'use spec.pairs and spec.excludes',
    'default': 'use spec.default',
    'merge': 'use manip_sim.models.compose or World, which put parts together',
    'merge_assets': 'use manip_sim.models.compose or World, which put parts together',
    'get_element_names': 'use joints, bodies, actuators, sites, sensors, contact_geoms or '
                         'visual_geoms',
    'contact_geom_rgba': 'use rgba of spec.geom(name) for the names in contact_geoms',
    'grasp_qpos': 'use format_action, whose +1 closes, and init_qpos',
    'init_torso_qpos': 'use init_qpos, which has all joints, or init_base_qpos',
    'resolve_asset_dependency': 'files are found by the paths in the MJCF file',
    'exclude_from_prefixing': 'override correct_naming',
}


def _prefixed(field: str, doc: str) -> Any:
    """Return a property: recorded names with the prefix of their part, a copy."""
    def names(part: MujocoXMLModel) -> list[str]:
        raw: list[str] = getattr(part, field)
        return part.correct_naming(raw)
    return property(names, doc=doc)


class MujocoXMLModel:
    """
    One part: an MJCF file, its prefix and lists of its elements.

    The lists (:attr:`joints`, :attr:`bodies`, ...) are recorded at construction, in the order of
    the compiled model, with prefixed names. Unnamed elements get names first: geoms
    ``g{n}_col`` where they collide and ``g{n}_vis`` where they do not, others
    ``joint{n}``, ``site{n}`` and so on.

    :param fname: path of an MJCF file
    :param idn: number or word that distinguishes parts of one kind; part of the prefix
    :ivar file: the file
    :ivar idn: number or word
    :raises ModelError: if the file is missing, is not MJCF or does not compile
    """

    _important_sites: Mapping[str, str] = {}
    _important_geoms: Mapping[str, list[str]] = {}
    _important_sensors: Mapping[str, str] = {}
    #: Positions of scalar joints by keyframe and name in the file [rad or m].
    _keyframes: Mapping[str, Mapping[str, float]] = MappingProxyType({})
    _own_model: mujoco.MjModel
    #: Beginning of the prefix, before the idn.
    _prefix_word = ''
    _top_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _horizontal_radius: float = 0.0
    #: Of the kind of part, which registers classes when they are defined.
    registry: ClassVar[Registry[Any] | None] = None
    #: True if others have the spec, so that it may be edited at any time.
    _spec_is_shared = False
    #: True if nothing that the spec refers to is missing, as it was compiled before.
    _refers_to_all = False
    #: True if :meth:`_check_declared` ran; else it does so before the part is put into a spec.
    _is_checked = True

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered and cls.registry is not None:
            cls.registry.register(cls)

    def __init__(self, fname: str | PathLike[str], idn: int | str = 0) -> None:
        check_kind(fname, (str, PathLike), 'fname', 'the path of an MJCF file')
        check_kind(idn, (str, int, np.integer), 'idn', 'a number or a word')
        if not str(idn).isprintable():
            raise ModelError(f'idn must be a number or a word, got {format_value(idn)}')
        self.file = Path(fname)
        self.idn = idn
        self._given_prefix = ''
        self._spec = self._read()
        self._prepare_spec(self._spec)
        name_unnamed_elements(self._spec)
        self._record()
        try:
            self._check_declared()
        except AttributeError:  # A property of a subclass needs what its constructor sets later.
            self._is_checked = False

    def _read(self) -> mujoco.MjSpec:
        """Return the spec of the file; overridden by parts from third-party files."""
        return load_spec(self.file)

    def _prepare_spec(self, spec: mujoco.MjSpec) -> None:
        """Complete the spec that was just loaded; for subclasses that add standard elements."""

    def refresh(self) -> None:
        """
        Update the recorded lists, ranges and offsets after edits of :attr:`spec`.

        :raises ModelError: if it no longer compiles, or an element that is needed is missing
        """
        name_unnamed_elements(self._spec)
        self._record()
        self._check_declared()

    def _refresh_if_edited(self) -> None:
        """Refresh, unless only the part itself has had its spec."""
        if self._spec_is_shared:
            self.refresh()

    def _record(self) -> None:
        self._record_elements(self._compile_alone())

    def _compile_alone(self) -> mujoco.MjModel:
        whole = self._refers_to_all and not self._spec_is_shared
        return (compile_copy if whole else compile_alone)(self._spec, self.name)

    @property
    def spec(self) -> mujoco.MjSpec:
        """
        This part's own ``mujoco.MjSpec``, with the names of its file, without prefix.

        Edits take effect in every later :meth:`compile`, also in that of a robot that this part
        is mounted on or of a world. :attr:`joints` and the other lists, the ranges in
        ``format_action`` and the offsets are recorded: call :meth:`refresh` after an edit;
        compiling and mounting do so too. Parts that are mounted on this one are not in the spec.
        """
        self._spec_is_shared = True
        return self._spec

    @property
    def root_body(self) -> str:
        """
        Prefixed name of the one body that all other bodies are below.

        :raises ModelError: if the file has none or several
        """
        return f'{self.naming_prefix}{self._root().name}'

    def _root(self) -> mujoco.MjsBody:
        roots = self._spec.worldbody.bodies
        if len(roots) != 1:
            names = ', '.join(body.name for body in roots) or 'none'
            raise ModelError(f'{self.file} must have exactly one root body, found {len(roots)}: '
                             f'{names}')
        return roots[0]

    @property
    def base_offset(self) -> FloatArray:
        """Position that the file gives the root body [m], shape (3,), a copy."""
        return np.array(self._own_model.body(self._root().name).pos)

    @property
    def bottom_offset(self) -> FloatArray:
        """Position of what the part stands on: the root's by default [m], shape (3,), a copy."""
        return self.base_offset

    @property
    def top_offset(self) -> FloatArray:
        """Position of what stands on the part [m], shape (3,), a copy: zeros unless declared."""
        return np.array(self._top_offset)

    @property
    def horizontal_radius(self) -> float:
        """Nominal radius about the origin that the class declares, not a measured one [m]."""
        return self._horizontal_radius

    def attach_to(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame) -> None:
        """
        Add a copy of this part, with prefixed names, to another spec.

        Options, keyframes and visual settings of the file are left behind.

        :param spec: the spec to add to
        :param frame: the frame of that spec to attach the part to
        :raises ModelError: if the spec has one of the names already
        """
        self._refresh_if_edited()
        self._attach_recorded(spec, frame)

    def _attach_recorded(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame) -> None:
        self._attach_copy(spec, frame, self._spec.copy())

    def _attach_copy(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame,
                     part_spec: mujoco.MjSpec) -> None:
        if not self._is_checked:
            self._check_declared()
            self._is_checked = True
        if not self.naming_prefix:
            name_main_default(part_spec)
        TakenNames(spec).add(part_spec, self.naming_prefix, self.name)
        for key in list(part_spec.keys):
            part_spec.delete(key)
        resolve_files(part_spec, self.file)
        attach(spec, part_spec, self.naming_prefix, frame)

    def compose(self) -> mujoco.MjSpec:
        """Return a new spec of this part and everything mounted on it."""
        spec = mujoco.MjSpec()
        spec.modelname = self.name
        spec.option = self._spec.option
        self.attach_to(spec, spec.worldbody.add_frame())
        return spec

    def compile(self) -> mujoco.MjModel:
        """
        Compile this part and everything mounted on it.

        :raises ModelError: with MuJoCo's message
        """
        return compile_spec(self.compose(), self.name)

    def get_xml(self) -> str:
        """Return the same as :meth:`to_xml`, under robosuite's name."""
        return self.to_xml()

    def save_model(self, fname: str | PathLike[str], pretty: bool = False) -> None:
        """
        Write the MJCF of this part and everything mounted on it, as robosuite does.

        :param fname: the file, which is replaced
        :param pretty: the text is indented anyway
        :raises ModelError: if the file cannot be written
        """
        try:
            Path(fname).write_text(self.to_xml(), encoding='utf-8')
        except OSError as error:
            raise ModelError(f'cannot write {fname}: {error.strerror}') from error

    if not TYPE_CHECKING:  # With it, type checkers would accept any name.

        def __getattr__(self, name: str) -> Any:
            """Say what replaces an attribute of robosuite's models that is not there."""
            if hasattr(type(self), name):  # A property raised the error.
                return object.__getattribute__(self, name)
            instead = REPLACEMENTS.get(name)
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'"
                                 + (f': {instead}' if instead else ''), name=name, obj=self)

    def to_xml(self) -> str:
        """Return the MJCF of this part and everything mounted on it."""
        spec = self.compose()
        compile_spec(spec, self.name)
        xml: str = spec.to_xml()
        return xml

    # ------------------------------------------------------------------ names of elements

    def _record_elements(self, alone: mujoco.MjModel) -> None:
        """Record the elements of the part, compiled alone."""
        self._own_model = alone

        not_free = alone.jnt_type != int(mujoco.mjtJoint.mjJNT_FREE)
        self._bodies = _names(alone, alone.name_bodyadr[1:])
        self._joints = _names(alone, alone.name_jntadr[not_free])
        self._actuators = _names(alone, alone.name_actuatoradr)
        self._sensors = _names(alone, alone.name_sensoradr)
        self._cameras = _names(alone, alone.name_camadr)
        self._record_shapes(alone, range(alone.nbody))

    def _check_declared(self) -> None:
        """Check that the elements exist that the class names by role."""
        self._check_important('site', self._important_sites.values(), self._sites)
        self._check_important('sensor', self._important_sensors.values(), self._sensors)
        for group in self._important_geoms.values():
            self._check_important('geom', group, self._contact_geoms + self._visual_geoms)

    def _record_shapes(self, model: mujoco.MjModel, bodies: Iterable[int]) -> None:
        """Record the sites and geoms of some bodies."""
        in_part = np.zeros(model.nbody, dtype=bool)
        in_part[list(bodies)] = True
        here = in_part[model.geom_bodyid]
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        self._sites = _names(model, model.name_siteadr[in_part[model.site_bodyid]])
        self._contact_geoms = _names(model, model.name_geomadr[here & collides])
        self._visual_geoms = _names(model, model.name_geomadr[here & ~collides])

    def _check_important(self, kind: str, names: Iterable[str], existing: list[str]) -> None:
        for name in names:
            if name not in existing:
                raise UnknownNameError(f'{kind} of {self.name} in {self.file}', name, existing)

    @property
    def name(self) -> str:
        """Class name and idn, such as ``Panda0``."""
        return f'{self.type_name}{self.idn}'

    @property
    def type_name(self) -> str:
        """Class name, such as ``Panda``: the same for each of several in a world."""
        return type(self).__name__

    @property
    def naming_prefix(self) -> str:
        """Beginning of each name of this part in the compiled model."""
        return self._given_prefix or f'{self._prefix_word}{self.idn}_'

    def set_naming_prefix(self, prefix: str) -> None:
        """
        Replace the prefix that the idn gives by another one.

        :param prefix: a letter, then at most 63 letters, digits and underscores, such as
            ``left_``; empty: the prefix that the idn gives
        :raises ModelError: if it is none of these, or the class overrides :attr:`naming_prefix`
        """
        check_kind(prefix, str, 'prefix', 'a word')
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
            prefix = self.naming_prefix
            return [prefix + name if isinstance(name, str) else self.correct_naming(name)
                    for name in names]
        if isinstance(names, Mapping):
            return {key: self.correct_naming(value) for key, value in names.items()}
        raise KindError('names must be a str, a list, a tuple or a dict of them, '
                        f'not {type(names).__name__}')

    bodies: list[str] = _prefixed('_bodies', 'All bodies but the world.')
    joints: list[str] = _prefixed(
        '_joints', 'All joints but free joints; a ball joint counts once.')
    actuators: list[str] = _prefixed('_actuators', 'All actuators.')
    sites: list[str] = _prefixed('_sites', 'All sites.')
    sensors: list[str] = _prefixed('_sensors', 'All sensors.')
    contact_geoms: list[str] = _prefixed(
        '_contact_geoms', 'The geoms that can collide, by contype and conaffinity.')
    visual_geoms: list[str] = _prefixed('_visual_geoms', 'The geoms that cannot collide.')

    @property
    def keyframes(self) -> dict[str, dict[str, float]]:
        """Positions of scalar joints by named keyframe of the file and joint [rad or m]."""
        prefix = self.naming_prefix
        return {name: {prefix + joint: position for joint, position in positions.items()}
                for name, positions in self._keyframes.items()}

    @property
    def joint_ranges(self) -> dict[str, FloatArray]:
        """Range by name of the joint [rad or m], shape (2,), infinite where there is none."""
        joints = map(self._own_model.joint, self._joints)
        return {name: np.array(joint.range if joint.limited[0] else (-np.inf, np.inf))
                for name, joint in zip(self.correct_naming(self._joints), joints)}

    @property
    def control_ranges(self) -> dict[str, FloatArray]:
        """Control range by name of the actuator, in its unit, shape (2,), zeros if it has none."""
        return {name: np.array(self._own_model.actuator(raw).ctrlrange)
                for name, raw in zip(self.correct_naming(self._actuators), self._actuators)}

    @property
    def cameras(self) -> list[str]:
        """All cameras."""
        return self.correct_naming(self._cameras)

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


def _names(model: mujoco.MjModel, addresses: IntArray) -> list[str]:
    """Return the names at some addresses, such as ``name_geomadr``."""
    names = model.names
    return [names[address:names.index(b'\0', address)].decode() for address in addresses.tolist()]


class FromYaml:
    """A class attribute that is read from ``part.yaml`` when it is first needed."""

    def __init__(self, key: str, default: Any) -> None:
        self.key = key
        self.default = default

    def __get__(self, part: CatalogueModel | None, owner: type[CatalogueModel]) -> Any:
        return owner.data().get(self.key, self.default) if owner._folder else self.default


class CatalogueModel(MujocoXMLModel):
    """
    A part whose class is created with a ``folder`` of ``assets``; the numbers are in it.

    ``part.yaml`` has the keys of descriptions of users' files, and a few more. A folder without
    one has only what its MJCF file says.

    :param idn: number or word in the prefix
    """

    #: Place of its folder: ``robots``, ``grippers`` or ``bases``, and the folder.
    _kind: ClassVar[str]
    _folder: ClassVar[str] = ''
    #: Content of ``part.yaml``, of each class once it is read.
    _data: ClassVar[dict[str, Any]]
    #: The MJCF file, relative to the folder; by default it is named like the folder.
    _model = FromYaml('model', None)

    def __init_subclass__(cls, folder: str = '', **kwargs: Any) -> None:
        cls._folder = folder or cls._folder
        super().__init_subclass__(**kwargs)

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(self.model_file(), idn=idn)

    def _read(self) -> mujoco.MjSpec:
        # Reading files would be half of composing a Panda (28 ms, 16 without).
        return _load(self.file).copy()

    @classmethod
    def model_file(cls) -> Path:
        """Return the MJCF file."""
        file = asset_path(cls._kind, cls._folder)
        return file if cls._model is None else Path(os.path.normpath(file.parent / cls._model))

    @classmethod
    def data(cls) -> dict[str, Any]:
        """
        Return what ``part.yaml`` says.

        :raises ModelError: if the file cannot be read
        :raises UnknownNameError: if it has a key that no attribute of the class reads
        """
        if '_data' not in vars(cls):
            file = asset_path(cls._kind, cls._folder).with_name('part.yaml')
            known = {attribute.key for base in cls.__mro__ for attribute in vars(base).values()
                     if isinstance(attribute, FromYaml)}
            values = read_yaml(file) if file.is_file() else {}
            for key in values:
                if key not in known:
                    raise UnknownNameError(f'key of {file}', key, known)
            cls._data = values
        return cls._data


_load = functools.cache(load_spec)
