# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Models that somebody names or sends who must not read every file of the user who runs the process.

All files are read here, through a :class:`Files` that says which ones may be, and checked. MuJoCo
gets their contents under other names, so it opens no file by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
import hashlib
from pathlib import Path, PurePosixPath
import re
from xml.etree import ElementTree

import mujoco

from manip_sim.errors import ModelError
from manip_sim.models.asset_files import check_content, MAX_FILE_BYTES, places, references
from manip_sim.models.loading import spec_from_string
from manip_sim.models.mjcf_versions import Origins
from manip_sim.models.regular_files import Files
from manip_sim.models.sandbox import compile_held, try_to_do
from manip_sim.models.xml_check import AssetFolders, XmlModel
from manip_sim.models.xml_limits import Budget, Limits
from manip_sim.quoting import one_line, quoted

#: What a model may consist of; all its files together have at most so many bytes.
LIMITS = Limits(bytes=1_000_000, files=50, depth=10, made=1000, elements=1000, nested=100)
#: What a robot may consist of.
ROBOT_LIMITS = replace(LIMITS, elements=5000, keys=100)
_MAX_ASSET_BYTES = 2 * MAX_FILE_BYTES
_NAMES_A_FILE = re.compile(r'file.*', re.IGNORECASE)
#: A NaN among numbers: MuJoCo takes it for no value, and prints a line for each.
_NAN = re.compile(r'(?:.*\s)?[+-]?nan(?:[\s(].*)?', re.IGNORECASE | re.DOTALL)
#: Attributes of files; MuJoCo gets all files by names without a folder and with a known suffix.
_OF_FILES = ('meshdir', 'texturedir', 'assetdir', 'strippath')
#: What has no meaning in a part of a world, but may ask for any amount of memory.
_LEFT_OUT = ('size', 'keyframe')
_LEFT_OUT_OF_ROBOTS = ('size',)
#: Elements of a model that compiles so quickly that it need not be tried before.
_LIGHT = frozenset((
    'mujoco', 'compiler', 'option', 'flag', 'default', 'asset', 'material', 'worldbody', 'body',
    'frame', 'geom', 'joint', 'freejoint', 'inertial', 'site', 'camera', 'light', 'contact',
    'exclude'))
_MAX_LIGHT_ELEMENTS = 100


@dataclass
class HeldModel:
    """
    A model and the contents of all files that it names.

    :ivar name: what it was read from, for messages
    :ivar xml: MJCF or URDF
    :ivar models: MJCF that it attaches, by the names in it
    :ivar assets: meshes and images, by their names in it
    :ivar is_light: whether it compiles quickly for sure
    :ivar origins: file and line of each element of MJCF, by the name of the model that it is in;
        that of the first one is empty
    """

    name: str
    xml: str = ''
    models: dict[str, bytes] = field(default_factory=dict)
    assets: dict[str, bytes] = field(default_factory=dict)
    is_light: bool = True
    origins: dict[str, Origins] = field(default_factory=dict)

    def load(self, notes: list[str] | None = None) -> mujoco.MjSpec:
        """
        Return a new spec.

        A model that may take long, or crash MuJoCo, is compiled in another process first.

        :param notes: as for ``spec_from_string``
        :raises ModelError: if it is no model, or compiling it takes too long or too much memory
        """
        if not self.is_light:
            try_to_do(self.name, compile_held, self.xml, self.models, self.assets)
        return self.load_tried(notes)

    def load_tried(self, notes: list[str] | None = None) -> mujoco.MjSpec:
        """Return a new spec, of a model that is compiled elsewhere first."""
        spec = spec_from_string(self.xml, Path(self.name), self.models, self.assets, notes,
                                self.origins)
        for reference in references(spec):
            if reference.file not in self.assets:
                raise ModelError(f'{one_line(self.name)}: {reference.kind} '
                                 f'{quoted(reference.element_name)} names a file')
        return spec


def hold_model(file: Path, files: Files) -> HeldModel:
    """
    Read a model and all that it names.

    :param file: MJCF or URDF
    :raises ModelError: if a file must not be or cannot be read, is not what its suffix says, or
        something is too large
    """
    model = XmlModel(file, Budget(LIMITS), files=files, traced=True)
    held = HeldModel(str(file))
    held.xml = _hold(model, held, files, _LEFT_OUT)
    held.origins[''] = model.origins_in_order
    held.is_light = held.is_light and not held.assets and model.elements <= _MAX_LIGHT_ELEMENTS
    return held


def hold_robot(file: Path, files: Files) -> HeldModel:
    """
    Read the MJCF file of a robot and all that it names, as :func:`hold_model` does.

    It keeps its keyframes, and may have more elements.
    """
    held = HeldModel(str(file), is_light=False)
    model = XmlModel(file, Budget(ROBOT_LIMITS), files=files, traced=True)
    held.xml = _hold(model, held, files, _LEFT_OUT_OF_ROBOTS)
    held.origins[''] = model.origins_in_order
    return held


def hold_tree(root: ElementTree.Element, file: Path, files: Files) -> HeldModel:
    """
    Read all that a URDF names.

    :param root: of its elements, changed in place
    """
    held = HeldModel(str(file), is_light=False)
    held.xml = _hold_tree(root, {}, AssetFolders(file.parent), held, files, _LEFT_OUT_OF_ROBOTS)
    return held


def _hold(model: XmlModel, held: HeldModel, files: Files, left_out: Collection[str]) -> str:
    """Add the files of a model to what is held, and return the model that names them."""
    return _hold_tree(model.tree, model.models, model.folders[0], held, files, left_out)


def _hold_tree(root: ElementTree.Element, models: Mapping[str, XmlModel], own: AssetFolders,
               held: HeldModel, files: Files, left_out: Collection[str]) -> str:
    for section in [child for child in root if child.tag in left_out]:
        root.remove(section)
    for element in root.iter():
        held.is_light = held.is_light and element.tag in _LIGHT
        if element.tag == 'plugin':
            raise ModelError(f'{one_line(held.name)}: what is spawned cannot have plugins')
        for attribute in _OF_FILES if element.tag == 'compiler' else ('content_type',):
            element.attrib.pop(attribute, None)
        for attribute, name in element.items():
            if attribute != 'name' and _NAN.fullmatch(name):
                raise ModelError(f'{one_line(held.name)}: {attribute[:60]} of '
                                 f'<{element.tag[:60]}> must be a number, got {quoted(name)}')
            if _NAMES_A_FILE.fullmatch(attribute) and name:
                element.set(attribute, _content(models[name], held, files, left_out)
                            if element.tag == 'model' else _name_of_held(
                                element, name, own, root.tag == 'robot', held, files))
    return ElementTree.tostring(root, encoding='unicode')


def _content(model: XmlModel, held: HeldModel, files: Files, left_out: Collection[str]) -> str:
    content = _hold(model, held, files, left_out).encode()
    name = f'{_digest(content)}.xml'
    held.models[name] = content
    held.origins[name] = model.origins_in_order
    return name


def _name_of_held(element: ElementTree.Element, name: str, own: AssetFolders, is_urdf: bool,
                  held: HeldModel, files: Files) -> str:
    if element.tag not in ('mesh', 'texture'):
        raise ModelError(f'{one_line(held.name)}: <{element.tag[:60]}> names the file '
                         f'{quoted(name, 200)}, which what is spawned cannot have')
    names = [name, PurePosixPath(name).name] if is_urdf else [name]
    found = files.first([place for each in names for place in places(element.tag, each, own)])
    content = files.read(found, f'{element.tag} file', MAX_FILE_BYTES)
    suffix = found.suffix.lower()
    check_content(element.tag, suffix, content, str(found))
    short = held_name(found, content)
    held.assets[short] = content
    if sum(map(len, held.assets.values())) > _MAX_ASSET_BYTES:
        raise ModelError(f'{one_line(held.name)} names files of more than '
                         f'{_MAX_ASSET_BYTES / 1e6:.0f} MB')
    return short


def held_name(file: Path, content: bytes) -> str:
    """Return a name for the content of a file that no other content has."""
    stem = re.sub(r'[^A-Za-z0-9-]', '_', file.stem)[:40]
    return f'{stem}_{_digest(content)}{file.suffix.lower()}'


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
