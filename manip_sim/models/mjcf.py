# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One part of a world: load its MJCF file, compile it, attach it; composing is elsewhere."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.asset_files import resolve_files
from manip_sim.models.loading import compile_spec, load_spec, name_unnamed_elements
from manip_sim.models.named_elements import NamedElements
from manip_sim.models.naming import TakenNames
from manip_sim.models.spec_edits import attach, name_main_default

_MIN_MASS_KG = 1e-6
_MIN_INERTIA = 1e-9


class MujocoXMLModel(NamedElements):
    """
    One part: an MJCF file, its prefix and lists of its elements.

    The lists (:attr:`joints`, :attr:`bodies`, ...) are recorded at construction, in the order of
    the compiled model, with prefixed names. Unnamed elements get names first: geoms
    ``g{n}_col`` where they collide and ``g{n}_vis`` where they do not, others
    ``joint{n}``, ``site{n}`` and so on.

    :param fname: path of an MJCF file
    :param idn: number or word that distinguishes parts of one kind; part of the prefix
    :raises ModelError: if the file is missing, is not MJCF or does not compile
    """

    _horizontal_radius: float = 0.0
    #: Whether others have the spec, so that it may be edited at any time.
    _spec_is_shared = False

    def __init__(self, fname: str | PathLike[str], idn: int | str = 0) -> None:
        super().__init__(Path(fname), idn)
        self._spec = self._read()
        self._prepare_spec(self._spec)
        name_unnamed_elements(self._spec)
        self._record()

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

    def _refresh_if_edited(self) -> None:
        """Refresh, unless only the part itself has had its spec."""
        if self._spec_is_shared:
            self.refresh()

    def _record(self) -> None:
        self._record_elements(self._compile_alone())

    def _compile_alone(self) -> mujoco.MjModel:
        # A part without mass, such as a virtual base, only works below something that has mass.
        # The spec itself is compiled: a copy would have lost references to missing elements.
        compiler = self._spec.compiler
        bounds = compiler.boundmass, compiler.boundinertia
        compiler.boundmass, compiler.boundinertia = _MIN_MASS_KG, _MIN_INERTIA
        try:
            return compile_spec(self._spec, self.name)
        finally:
            compiler.boundmass, compiler.boundinertia = bounds

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
            found = ', '.join(body.name for body in roots) or 'none'
            raise ModelError(f'{self.file} must have exactly one root body, found {len(roots)}: '
                             f'{found}')
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
        return np.zeros(3)

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
                     own: mujoco.MjSpec) -> None:
        if not self.naming_prefix:
            name_main_default(own)
        TakenNames(spec).add(own, self.naming_prefix, self.name)
        for key in list(own.keys):
            own.delete(key)
        resolve_files(own, self.file)
        attach(spec, own, self.naming_prefix, frame)

    def compose(self) -> mujoco.MjSpec:
        """Return a new spec of this part and all that is mounted on it."""
        spec = mujoco.MjSpec()
        spec.modelname = self.name
        spec.option = self._spec.option
        self.attach_to(spec, spec.worldbody.add_frame())
        return spec

    def compile(self) -> mujoco.MjModel:
        """
        Compile this part and all that is mounted on it.

        :raises ModelError: with MuJoCo's message
        """
        return compile_spec(self.compose(), self.name)

    def to_xml(self) -> str:
        """Return the MJCF of this part and all that is mounted on it."""
        spec = self.compose()
        compile_spec(spec, self.name)
        xml: str = spec.to_xml()
        return xml
