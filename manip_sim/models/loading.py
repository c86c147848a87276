# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read, complete and compile specs, with errors that name the file and the cause."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
import logging
import os
from pathlib import Path
from typing import Any
import warnings

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import (
    infer_inertias_once, MissingMeshError, resolve_files, skip_missing)
from manip_sim.models.mjcf_versions import (
    Document, ERRORS, read_documents, read_mjcf, with_remedy)
from manip_sim.models.xml_model import XmlModel
from manip_sim.quoting import one_line, quoted

#: Numbers that MuJoCo accepts from a file even if nan or inf, by the prefix of the field's name.
_NUMBERS = [(kind, what) for kind, fields in {
    'body': ('mass', 'inertia', 'pos', 'quat', 'ipos'), 'geom': ('size', 'pos', 'friction'),
    'jnt': ('pos', 'axis', 'range', 'stiffness'), 'dof': ('damping', 'armature', 'frictionloss'),
    'actuator': ('gear', 'gainprm', 'biasprm', 'ctrlrange', 'forcerange')}.items()
    for what in fields]
_MAY_BE_INFINITE = ('range', 'ctrlrange', 'forcerange')
#: The least mass and inertia of the bodies of a part that is compiled alone [kg, kg m^2].
_MIN_MASS_KG, _MIN_INERTIA = 1e-6, 1e-9
#: Radius of what stands for a mesh where shapes do not matter [m].
_SMALL_M = 1e-3
#: Corners of a tetrahedron [m], and of its faces.
_SMALL_CORNERS_M = (0.0, 0.0, 0.0, _SMALL_M, 0.0, 0.0, 0.0, _SMALL_M, 0.0, 0.0, 0.0, _SMALL_M)
_FACES = (0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2)


#: MuJoCo's sentence on a spec that it compiled without its visual shapes.
_OF_OUR_COMPILER = 'The visual elements of the spec were discarded'
#: MuJoCo's warning of a part without a prefix, which is intended.
_EMPTY_PREFIX = 'Attaching a spec with an empty prefix'


def _log_warning(message: str) -> None:
    if not message.startswith(_EMPTY_PREFIX):
        logging.getLogger('manip_sim.mujoco').warning(message)


# Unless a handler is set, MuJoCo appends its warnings to a file in the working directory.
if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(_log_warning)


def compile_spec(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """
    Compile a spec.

    :raises ModelError: with MuJoCo's message, or if a number that must be finite is not
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings('ignore', _EMPTY_PREFIX)
            model = spec.compile()
    except ERRORS as error:
        raise ModelError(f'{name} does not compile: {with_remedy(_one_line(error))}') from error
    _reject_not_finite(model, name)
    _reject_what_tactile_sensors_cannot_feel(model, name)
    return model


def compile_alone(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """Compile a part without mass, such as a virtual base, which moves only with other parts."""
    # The spec itself is compiled: a copy would have lost references to missing elements.
    compiler = spec.compiler
    bounds = compiler.boundmass, compiler.boundinertia
    compiler.boundmass, compiler.boundinertia = _MIN_MASS_KG, _MIN_INERTIA
    try:
        return compile_spec(spec, name)
    finally:
        compiler.boundmass, compiler.boundinertia = bounds


def compile_copy(spec: mujoco.MjSpec, name: str, visual: bool = True) -> mujoco.MjModel:
    """
    Compile a part as :func:`compile_alone` does, of whose references none is missing.

    :param visual: with the shapes that only show something

    A spec that was compiled keeps its meshes as MuJoCo's compiler made them, many times as large
    as the files, and so do copies of it.
    """
    copied = spec.copy()
    if not visual:
        leave_out_visual(copied)
    return compile_alone(copied, name)


def leave_out_visual(spec: mujoco.MjSpec) -> None:
    """Let a spec be compiled without shapes that only show something, and without their files."""
    spec.compiler.discardvisual = True
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    _shrink_meshes(spec, lambda body, geom: bool(
        geom.contype or geom.conaffinity or geom.name in paired or not body.explicitinertial))


def compile_without_meshes(spec: mujoco.MjSpec, name: str, kept: Collection[str]
                           ) -> mujoco.MjModel:
    """
    Compile a part that compiled before, for all but its shapes: these are most of its size.

    Shapes of meshes become small spheres, also where the mass of the body comes from them.

    :param kept: names of bodies that keep their meshes
    """
    light = spec.copy()
    _shrink_meshes(light, lambda body, geom: body.name in kept)
    try:
        return compile_alone(light, name)
    except ModelError:  # Something else than a shape refers to a mesh.
        return compile_copy(spec, name)


def _shrink_meshes(spec: mujoco.MjSpec, keeps: Callable[[Any, Any], bool]) -> None:
    """
    Replace shapes of meshes by small spheres, meshes without shapes by tetrahedra, images by dots.

    :param keeps: takes a body and a shape of it, and returns whether that keeps its mesh
    """
    needed = set()
    for body in spec.bodies:
        for geom in body.geoms:
            if not geom.meshname:
                continue
            if int(geom.type) == int(mujoco.mjtGeom.mjGEOM_SDF) or keeps(body, geom):
                needed.add(geom.meshname)
                continue
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_SPHERE, ''
            geom.size = [_SMALL_M, 0.0, 0.0]
    for mesh in spec.meshes:  # Deleting one takes longer than compiling a small one.
        if mesh.name not in needed:
            mesh.file, mesh.uservert, mesh.userface = '', _SMALL_CORNERS_M, _FACES
            mesh.scale, mesh.inertia = np.ones(3), mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            mesh.usernormal = mesh.userfacenormal = mesh.usertexcoord = mesh.userfacetexcoord = []
    for texture in spec.textures:
        texture.file, texture.cubefiles = '', [''] * len(texture.cubefiles)
        texture.builtin, texture.width = mujoco.mjtBuiltin.mjBUILTIN_FLAT, 1
        texture.height = 1 if int(texture.type) == int(mujoco.mjtTexture.mjTEXTURE_2D) else 6


def _reject_what_tactile_sensors_cannot_feel(model: mujoco.MjModel, name: str) -> None:
    """
    Reject height fields and flexes beside tactile sensors.

    At a contact with a height field MuJoCo ends the simulation; for a flex it takes the shape with
    the number -1.
    """
    sensors = np.flatnonzero(model.sensor_type == int(mujoco.mjtSensor.mjSENS_TACTILE))
    if not len(sensors):
        return
    fields = np.flatnonzero((model.geom_type == int(mujoco.mjtGeom.mjGEOM_HFIELD))
                            & (model.geom_contype | model.geom_conaffinity != 0))
    if len(fields) or model.nflex:
        flex = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, 0)
        shape = (f'height field {quoted(model.geom(fields[0]).name)}' if len(fields)
                 else f'flex {quoted(flex)}')
        sensor = quoted(model.sensor(sensors[0]).name)
        raise ModelError(f'{name}: tactile sensors such as {sensor} cannot feel {shape}; leave '
                         'out one of them')


def _reject_not_finite(model: mujoco.MjModel, name: str) -> None:
    for kind, field in _NUMBERS:
        values = getattr(model, f'{kind}_{field}')
        bad = np.isnan(values) if field in _MAY_BE_INFINITE else ~np.isfinite(values)
        if bad.any():
            index = int(np.argwhere(bad)[0][0])
            if kind == 'dof':
                index = int(model.dof_jntid[index])
            kind = {'jnt': 'joint', 'dof': 'joint'}.get(kind, kind)
            raise ModelError(f'{name} does not compile: {field} of {kind} '
                             f'{quoted(getattr(model, kind)(index).name)} must be finite')


def load_spec(file: Path, notes: list[str] | None = None) -> mujoco.MjSpec:
    """
    Read a spec from an MJCF or URDF file; it names its asset files by absolute paths.

    :param notes: is given sentences on what MuJoCo has dropped since the file was written, and on
        elements left out as their files are missing; None: a missing file is an error
    :raises ModelError: if a file is missing, is not MJCF or URDF, or could crash the process
    """
    model = XmlModel(file)
    if file.suffix.lower() == '.mjcf':  # MuJoCo chooses a reader by the suffix.
        spec, dropped = read_mjcf(file)
    else:
        spec, dropped = _read_file(file)
    _report(dropped, notes)
    missing: dict[tuple[str, str], MissingMeshError] = {}
    resolve_files(spec, file, model, None if notes is None else missing)
    if notes is not None:
        notes += skip_missing(spec, missing, file)
    _apply_total_mass(spec, file)
    return spec


def _read_file(file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    try:
        # Of a relative path, MuJoCo repeats the folders before files that included ones name.
        return mujoco.MjSpec.from_file(os.path.abspath(file)), []
    except ERRORS:
        return read_mjcf(file)


def _report(sentences: list[str], notes: list[str] | None) -> None:
    """Add sentences to notes, or log them if nobody takes notes."""
    if notes is not None:
        notes += sentences
        return
    for sentence in sentences:
        logging.getLogger(__name__).warning(sentence)


def _apply_total_mass(spec: mujoco.MjSpec, file: Path) -> None:
    """
    Give each body the mass that it has by the ``settotalmass`` of its file.

    That scales whole models, so MuJoCo ignores it in a spec that is attached to another.
    """
    compiler = spec.compiler
    total, compiler.settotalmass = compiler.settotalmass, -1.0
    if total <= 0.0:
        return
    infer_inertias_once(spec)
    model = compile_spec(spec, str(file))
    mujoco.mj_setTotalmass(model, total)
    spec.copy_back(model)
    compiler.boundmass = compiler.boundinertia = 0.0  # They held before scaling.


def spec_from_documents(documents: Sequence[Document], file: Path,
                        assets: Mapping[str, bytes] | None = None,
                        notes: list[str] | None = None) -> mujoco.MjSpec:
    """
    Read a spec from documents in which all paths are absolute, or names of assets.

    :param assets: contents of meshes and images that are not on the disk
    :param notes: is given sentences on what MuJoCo has dropped; None: they are logged
    """
    spec, dropped = read_documents(documents, file, assets)
    _report(dropped, notes)
    return spec


def _one_line(error: Exception) -> str:
    lines = (part.strip() for part in str(error).splitlines())
    text = ', '.join(line for line in lines if line and not line.startswith(_OF_OUR_COMPILER))
    return one_line(text) or type(error).__name__


def name_unnamed_elements(spec: mujoco.MjSpec) -> None:
    """Name unnamed bodies, joints, sites, cameras, actuators, sensors and geoms by a number."""
    for kind, elements in (
            ('body', spec.bodies), ('joint', spec.joints), ('site', spec.sites),
            ('camera', spec.cameras), ('actuator', spec.actuators), ('sensor', spec.sensors)):
        _name_unnamed(elements, lambda element, kind=kind: f'{kind}{{}}')  # type: ignore[misc]
    _name_unnamed(spec.geoms, lambda geom: (
        'g{}_col' if geom.contype or geom.conaffinity else 'g{}_vis'))


def _name_unnamed(elements: Sequence[Any], pattern: Callable[[Any], str]) -> None:
    names = [element.name for element in elements]
    taken = set(names)
    next_number: dict[str, int] = {}
    for element, name in zip(elements, names):
        if name:
            continue
        form = pattern(element)
        number = next_number.get(form, 0)
        while form.format(number) in taken:
            number += 1
        element.name = form.format(number)
        next_number[form] = number + 1
