# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Read, complete and compile specs, with errors that name the file and the cause.

MuJoCo rejects what its format has no longer. That is left out here, or gets its later name, each
time that the installed version rejects it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
import logging
import os
from pathlib import Path
import re
from typing import Any
import warnings
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import (
    infer_inertias_once, LostShape, MissingMeshError, places, resolve_files, skip_missing)
from manip_sim.models.xml_model import AssetFolders, XmlModel
from manip_sim.quoting import one_line, quoted

#: MuJoCo raises the first for errors in a file, the others if there is not enough memory.
ERRORS = (ValueError, mujoco.FatalError, RuntimeError, MemoryError)
#: Attributes that the format once had, by element and name, with what replaces them. Of MuJoCo 1
#: from dm_control's schema of 2018, of later ones from the reader's tables of all releases.
_ATTRIBUTES: Mapping[tuple[str, str], tuple[str, ...]] = {
    ('camera', 'orthographic'): ('projection',),
    ('compiler', 'convexhull'): (),
    ('compiler', 'exactmeshinertia'): (),
    ('contact', 'internal'): (),
    ('contact', 'vertcollide'): (),
    ('flag', 'passive'): ('spring', 'damper'),
    ('flag', 'sensornoise'): (),
    ('flexcomp', 'class'): (),
    ('joint', 'actuatorforcelimited'): ('actuatorfrclimited',),
    ('joint', 'actuatorforcerange'): ('actuatorfrcrange',),
    ('lengthrange', 'inteval'): ('interval',),
    ('option', 'apirate'): (),
    ('option', 'collision'): (),
    ('option', 'impedance'): (),
    ('option', 'mpr_iterations'): ('ccd_iterations',),
    ('option', 'mpr_tolerance'): ('ccd_tolerance',),
    ('option', 'reference'): (),
    ('plugin', 'name'): (),
    ('quality', 'numarrows'): ()}
#: Likewise elements, by the element around them, where an empty name is any; and the values of
#: attributes that have another name now.
_ELEMENTS = {
    ('', 'composite'): '', ('equality', 'distance'): '', ('equality', 'flexvert'): '',
    ('extension', 'required'): 'plugin',
    **{('material', layer): '' for layer in (
        'emissive', 'metallic', 'normal', 'occlusion', 'opacity', 'orm', 'rgb', 'rgba',
        'roughness')}}
_VALUES = {'orthographic': {'true': 'orthographic', 'false': 'perspective'}}
_ONLY_NUMBERS = re.compile(r'[\s,\d.eE+-]*')
#: The elements that name files with shapes or images.
_WITH_FILES = ('flexcomp', 'hfield', 'mesh', 'skin', 'texture')
#: Plugins that MuJoCo had.
_PLUGINS = tuple(f'mujoco.elasticity.{kind}' for kind in ('cable', 'membrane', 'shell', 'solid'))
#: A message of MuJoCo and its element, of an attached model if there is an error in that.
_MESSAGE = re.compile(r"Error: *(?P<what>(?:(?!Error:).)*?)\s*Element '(?P<tag>[^']*)', line "
                      r'(?P<line>\d+)', re.DOTALL)
_UNKNOWN = re.compile(r"Schema violation: unrecognized attribute: '(.*)'")
_BAD_FORMAT = re.compile(r"bad format in attribute '(.*)'")
_NO_PLUGIN = re.compile(r'plugin (\S+) not found')
_NO_FILE = re.compile(r"Error opening file '(.*)'")
_UNKNOWN_ELEMENT = 'Schema violation: unrecognized element'
_RENAMED_MAIN = "top-level default class 'main' cannot be renamed"
_TWO_ORIENTATIONS = "Schema violation: at most one of 'fullinertia'"
#: Remedies by expressions in MuJoCo's messages, of reading and of compiling.
_REMEDIES = {
    'repeated name': 'give one of them another name',
    'invalid keyword': 'write a word that MuJoCo knows, or delete the attribute',
    'bad format': 'write numbers with blanks between them',
    'does not have enough data': 'write as many numbers as it needs',
    'has too much data': 'write as many numbers as it needs',
    'required attribute missing': 'add it', 'missing element': 'add it',
    'unknown default c': 'define it in <default>, or load the file that includes this one',
    'World body cannot have': 'move it into a body',
    r'^plugin \S+ not found': 'load its library with mujoco.mj_loadPluginLibrary, or delete it',
    'mass and inertia of moving bodies': 'give it an <inertial>, or a shape with mass',
    'axis too small': 'write a direction, as in axis="0 0 1"',
    r'range\[0\] should be smaller': 'write the lower number first, or limited="false"',
    r'size \d must be positive': 'write its size', 'are negative': 'write positive numbers',
    'free joint can only': 'move it to <worldbody>, or delete its free joint',
    'transmission target': 'correct its name, or add what it acts on; if another file includes '
    'this one, load that',
    ' not found in ': 'correct its name, or add it'}
#: File and line of an element.
Place = tuple[Path, int]
_ORIENTATIONS = ('quat', 'axisangle', 'xyaxes', 'zaxis', 'euler')


class Document:
    """
    The XML of a model or of one that it attaches.

    :param origins: file and line of its elements; of others no place is told
    :param name: by which another document names it; empty for the first
    :param folders: where its files are
    """

    def __init__(self, root: ElementTree.Element, origins: Mapping[ElementTree.Element, Place],
                 name: str = '', folders: AssetFolders | None = None) -> None:
        self.root, self.name = root, name
        self.folders = folders or AssetFolders(Path())
        self._origins = origins

    def text(self) -> str:
        """Return it as text, each element on a line of its own."""
        for element in self.root.iter():
            element.tail = '\n'
            if len(element):
                element.text = '\n'
        try:
            return ElementTree.tostring(self.root, encoding='unicode')
        except RecursionError as error:
            raise ModelError(f'{self.place(self.root) or "it"} has elements that are nested too '
                             'deeply') from error

    def at(self, line: int) -> ElementTree.Element | None:
        """Return the element that begins at a line of the text."""
        parser = expat.ParserCreate()
        lines: list[int] = []
        parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
        parser.Parse(self.text(), True)
        return next((element for element, begin in zip(self.root.iter(), lines)
                     if begin == line), None)

    def place(self, element: ElementTree.Element) -> str:
        """Return where an element was read, or nothing."""
        if element not in self._origins:
            return ''
        file, line = self._origins[element]
        return f'{one_line(str(file), 200)}, line {line}'

    def owner(self, element: ElementTree.Element) -> str:
        """Return the link or joint of a URDF that has an element, or nothing."""
        return next((f'{part.tag} {quoted(part.get("name", ""))}' for part in self.root
                     if self.root.tag == 'robot' and element in set(part.iter())), '')


def read_mjcf(file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """
    Read a spec from an MJCF file, without what MuJoCo has dropped.

    :returns: the spec, and a sentence for each element that was changed
    :raises ModelError: naming file, line and element
    """
    model = XmlModel(file)
    _resolve_included(model)
    return read_documents(documents_of(model), file)


def documents_of(model: XmlModel) -> list[Document]:
    """Return the documents of a model and of those that it attaches, which name each other."""
    documents: list[Document] = []

    def add(model: XmlModel) -> str:
        name = f'model{len(documents)}.xml' if documents else ''
        documents.append(Document(model.tree, model.origins, name, model.folders[0]))
        attached = {file: add(inner) for file, inner in model.models.items()}
        for element in model.tree.iter('model'):
            element.set('file', attached[element.get('file', '')])
        return name
    add(model)
    return documents


def _resolve_included(model: XmlModel) -> None:
    """Let elements name their files by absolute paths if these lie beside an included file."""
    folders = model.folders[0]
    for element, (file, _) in model.origins.items():
        for attribute in [key for key in element.attrib if element.tag in _WITH_FILES
                          and key.startswith('file')]:
            name = element.attrib[attribute]
            beside = file.parent / name
            # MuJoCo reads a flexcomp's file at once, from the working directory.
            if beside.is_file() and (element.tag == 'flexcomp' or not any(
                    place.is_file() for place in places(element.tag, name, folders))):
                element.set(attribute, os.path.abspath(beside))
    for attached in model.models.values():
        _resolve_included(attached)


def read_documents(documents: Sequence[Document], file: Path,
                   assets: Mapping[str, bytes] | None = None
                   ) -> tuple[mujoco.MjSpec, list[str]]:
    """
    Read a spec from the documents of an MJCF or URDF file, as :func:`read_mjcf` does.

    :param documents: that of the file first; they are changed in place
    :param assets: contents of meshes and images that are not on the disk, by their names
    """
    notes: list[str] = []
    while True:
        whole, *attached = (document.text() for document in documents)
        models = {document.name: text.encode()
                  for document, text in zip(documents[1:], attached)}
        try:
            return mujoco.MjSpec.from_string(whole, include=models or None,
                                             assets=dict(assets) if assets else None), notes
        except ERRORS as error:
            changed = list(_changed(documents, str(error)))
            if not changed:
                raise ModelError(_explained(documents, error, file)) from error
            notes += changed


def _changed(documents: Sequence[Document], message: str) -> Iterator[str]:
    """Change what a message of MuJoCo rejects, if an earlier version had it; yield sentences."""
    match = _MESSAGE.search(message)
    problem, tag = (match['what'], match['tag']) if match else (message, '')
    unknown, bad = _UNKNOWN.match(problem), _BAD_FORMAT.match(problem)
    plugin, no_file = _NO_PLUGIN.match(problem), _NO_FILE.match(problem)
    for document in documents:
        if plugin and plugin[1] in _PLUGINS:
            yield from _drop_plugin(document, plugin[1])
        elif no_file and tag == 'flexcomp':
            yield from _drop_flexes(document, no_file[1])
        elif bad:
            yield from _drop_commas(document, tag, bad[1])
        elif unknown and (tag, unknown[1]) in _ATTRIBUTES:
            yield from _drop_attribute(document, tag, unknown[1])
        elif problem == _UNKNOWN_ELEMENT:
            yield from _drop_elements(document, tag)
        elif problem == _RENAMED_MAIN:
            yield from _rename_main(document)
        elif problem.startswith(_TWO_ORIENTATIONS):
            yield from _drop_orientations(document)


def _drop_attribute(document: Document, tag: str, name: str) -> Iterator[str]:
    later = _ATTRIBUTES[tag, name]
    for element in document.root.iter(tag):
        value = element.attrib.pop(name, None)
        if value is None:
            continue
        for other in later:
            element.attrib.setdefault(other, _VALUES.get(name, {}).get(value, value))
        yield _sentence(document, element, f'{name}={quoted(value)} of <{tag}>',
                        f'read as {" and ".join(later)}' if later else '')


def _drop_elements(document: Document, tag: str) -> Iterator[str]:
    for parent in list(document.root.iter()):
        later = _ELEMENTS.get((parent.tag, tag), _ELEMENTS.get(('', tag)))
        for element in parent.findall(tag) if later is not None else ():
            yield _sentence(document, element, f'<{tag}>', f'read as <{later}>' if later else '')
            if later:
                element.tag = later
            else:
                parent.remove(element)


def _drop_plugin(document: Document, name: str) -> Iterator[str]:
    """Leave out a plugin and what uses it or an instance of it."""
    instances = {instance.get('name') for element in document.root.iter('plugin')
                 if element.get('plugin') == name for instance in element.iter('instance')}
    for parent in list(document.root.iter()):
        for element in parent.findall('plugin'):
            if element.get('plugin') == name or element.get('instance') in instances - {None}:
                yield _sentence(document, element, f'<plugin> of {quoted(name)}', '')
                parent.remove(element)


def _drop_flexes(document: Document, name: str) -> Iterator[str]:
    """Leave out soft bodies of a file that is not there, which MuJoCo reads at once."""
    for parent in list(document.root.iter()):
        for element in parent.findall('flexcomp'):
            if element.get('file') and name.endswith(element.get('file', '')):
                parent.remove(element)
                place = document.place(element)
                yield LostShape(
                    f'left out: <flexcomp> {quoted(element.get("name", ""))}'
                    f'{" in " if place else ""}{place}, as there is no file {quoted(name)}; put '
                    'it there, or correct its name')


def _rename_main(document: Document) -> Iterator[str]:
    """Let the outermost default class be called main, as MuJoCo wants it."""
    for element in document.root.findall('default'):
        name = element.get('class')
        if name in (None, 'main'):
            continue
        for user in document.root.iter():
            for attribute in ('class', 'childclass'):
                if user.get(attribute) == name:
                    user.set(attribute, 'main')
        yield _sentence(document, element, f'class={quoted(name)} of the outermost <default>',
                        "read as 'main'")


def _drop_orientations(document: Document) -> Iterator[str]:
    """Leave out what a full inertia matrix, which has axes of its own, took precedence over."""
    for element in document.root.iter('inertial'):
        others = [name for name in _ORIENTATIONS if name in element.attrib]
        if 'fullinertia' in element.attrib and others:
            for name in others:
                del element.attrib[name]
            yield _sentence(document, element, f'{" and ".join(others)} of an <inertial> that '
                            'has fullinertia', '')


def _drop_commas(document: Document, tag: str, name: str) -> Iterator[str]:
    """Let blanks separate numbers that commas separate."""
    for element in document.root.iter(tag):
        value = element.get(name, '')
        if ',' in value and _ONLY_NUMBERS.fullmatch(value):
            element.set(name, value.replace(',', ' '))
            yield _sentence(document, element, f'the commas in {name}={quoted(value)} of <{tag}>',
                            '')


def _sentence(document: Document, element: ElementTree.Element, dropped: str, later: str) -> str:
    place = document.place(element)
    return (f'{later or "ignored"}: {dropped}{" in " if place else ""}{place}, which MuJoCo reads '
            'no longer')


def _explained(documents: Sequence[Document], error: Exception, file: Path) -> str:
    """Return MuJoCo's message, with file, line, element and a remedy for an unknown element."""
    match = _MESSAGE.search(str(error))
    kind = 'URDF' if documents[0].root.tag == 'robot' else 'MJCF'
    begin = f'{one_line(str(file))} is not {kind} that MuJoCo can read'
    if match is None:
        return f'{begin}: {_one_line(error)}'
    problem, tag = match['what'], match['tag']
    unknown = _UNKNOWN.match(problem)
    place = ''
    for document in documents:
        elements = [element for element in [document.at(int(match['line']))]
                    if element is not None and element.tag == tag]
        elements += document.root.iter(tag)
        fitting = (': '.join(filter(None, (document.place(element), document.owner(element))))
                   for element in elements if unknown is None or unknown[1] in element.attrib)
        place = place or next(fitting, '')
    place = f'{place}: ' if place else ''
    if unknown:
        return (f'{begin}: {place}<{tag}> has no attribute {quoted(unknown[1])}: correct its '
                'name, or delete it')
    if problem == _UNKNOWN_ELEMENT:
        return (f'{begin}: {place}there is no element <{one_line(tag, 60)}> here: correct its '
                'name or its place, or delete it')
    return f'{begin}: {place}<{tag}>: {with_remedy(one_line(problem))}'


def with_remedy(message: str) -> str:
    """Return a message of MuJoCo with what to do, if it is one of those that are known."""
    remedy = next((advice for words, advice in _REMEDIES.items()
                   if re.search(words, message)), '')
    return f'{message}: {remedy}' if remedy else message


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
        try:
            # Of a relative path, MuJoCo repeats the folders before files that included ones name.
            spec, dropped = mujoco.MjSpec.from_file(os.path.abspath(file)), []
        except ERRORS:
            spec, dropped = read_mjcf(file)
    _report(dropped, notes)
    missing: dict[tuple[str, str], MissingMeshError] = {}
    resolve_files(spec, file, model, None if notes is None else missing)
    if notes is not None:
        notes += skip_missing(spec, missing, file)
    _apply_total_mass(spec, file)
    return spec


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
