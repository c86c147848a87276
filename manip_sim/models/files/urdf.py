# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read URDF with MuJoCo's reader, and add what that leaves out: meshes, masses, limits, mimics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations_with_replacement
import math
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.files.ros_packages import expanded, find_meshes
from manip_sim.models.files.urdf_joints import check_joints, complete_joints
from manip_sim.models.loading import Document, Place, read_documents
from manip_sim.models.untrusted_models import SelfContainedModel
from manip_sim.models.user_files import Files, InMemoryFile, XACRO_SUFFIX
from manip_sim.models.xml_model import AssetFolders, XmlModel
from manip_sim.quoting import one_line, pluralize, quoted, quoted_names

#: Mass and inertia of a moving link that has neither these nor a shape [kg, kg m^2].
_LIGHT_KG, _LIGHT_INERTIA = 1e-3, 1e-6
_HEAD = 4096
#: Of shapes that are not drawn: cameras, the viewer and exported URDF show groups 0 to 2.
_COLLISION_GROUP = 3
#: Types of joints that move.
_MOVES = re.compile(rb'type\s*=\s*["\'](?:revolute|continuous|prismatic)["\']')
#: Elements of a URDF that MuJoCo reads.
_READ_BY_MUJOCO = ('link', 'joint', 'material', 'mujoco', 'include')
#: Shapes, and the attributes that each needs.
_GEOMETRY = {'box': {'size'}, 'cylinder': {'radius', 'length'}, 'capsule': {'radius', 'length'},
             'sphere': {'radius'}, 'mesh': {'filename'}}
#: Elements of which an element has one; a geometry has one of any.
_SINGLE = {'link': ('inertial',),
           'visual': ('origin', 'geometry', 'material'), 'collision': ('origin', 'geometry'),
           'inertial': ('origin', 'mass', 'inertia'),
           'joint': ('origin', 'axis', 'parent', 'child', 'limit', 'dynamics', 'mimic')}
#: Share of an effort limit that the weight may need in any pose; real arms are like this.
_CARRIED_SHARE = 0.5
#: Densities are not made smaller than by this factor.
_LEAST_DENSITY_FACTOR = 0.01
_POSES = 50
#: Of a moving link whose file gives none, and the least moment of inertia [kg, kg m^2].
_LEAST_KG, _LEAST_INERTIA = 1e-4, 1e-8
#: Of what a link is made whose mass alone is known [kg/m^3].
_DENSITY = 1000.0
#: Moments up to this one, or up to this share of the greatest, may be zero to MuJoCo [kg m^2].
_ZERO, _ZERO_SHARE = 1e-14, 1e-7
_PAIRS = [''.join(pair) for pair in combinations_with_replacement('xyz', 2)]


def is_urdf(file: Path, files: Files | None = None) -> bool:
    """
    Return whether a file is URDF: by its ending, or because its first element is ``robot``.

    :raises ModelError: if a request must not or cannot read it
    """
    if file.suffix.lower() in ('.urdf', XACRO_SUFFIX):
        return True
    if files is not None:
        return _begins_urdf(files.read(file, 'model file'))
    if not file.is_file():  # Reading a device or a pipe may never end.
        return False
    try:
        with open(file, 'rb') as stream:
            return _begins_urdf(stream.read(_HEAD))
    except OSError:
        return False


def _begins_urdf(content: bytes) -> bool:
    first = re.search(rb'<([A-Za-z_]\w*)', content[:_HEAD])
    return first is not None and first.group(1) == b'robot'


def is_moving_urdf(content: bytes) -> bool:
    """Return whether a text is URDF with joints that move: a robot, not an object."""
    return _begins_urdf(content) and _MOVES.search(content) is not None


def load_urdf(file: Path, xacro_args: Mapping[str, str] | None = None, expects_meshes: bool = True,
              files: Files | None = None) -> tuple[Any, list[str]]:
    """
    Read a spec from a URDF file, or from a xacro file that makes one.

    All links become bodies, also those on fixed joints. Collision shapes of links that have
    visual ones are in group 3, which is not drawn. The velocity limit of a joint becomes the
    first number of its ``user``, the effort limit its actuator force range; zero: no limit. A
    mimic joint is coupled by an equality constraint.

    :param expects_meshes: make the sentences on meshes that cannot be read a :class:`LostShape`
    :returns: a new ``mujoco.MjSpec``, and a sentence for each thing left out or invented
    """
    robot, origins, fixed, notes = _read(file, xacro_args or {}, expects_meshes, files)
    if files is None:
        spec, changed = read_documents([Document(robot, origins)], file)
        notes += changed
    else:
        spec = _hold(robot, origins, file, files).load_tried(notes)
    colliding = {geom.meshname for body in spec.bodies for geom in _colliding(body)}
    for mesh in spec.meshes:  # Those without volume may show something; shapes that collide weigh.
        if mesh.name not in colliding:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    for body in spec.bodies:  # Of links that have any, only the visual shapes are drawn.
        if len(_colliding(body)) < len(body.geoms):
            for geom in _colliding(body):
                geom.group = _COLLISION_GROUP
    notes += complete_joints(spec, robot, fixed)
    notes += _give_mass(spec, robot)
    notes += _take_gravity(spec, robot)
    return spec, notes


def hold_urdf(file: Path, xacro_args: Mapping[str, str], files: Files) -> SelfContainedModel:
    """Read a URDF file and the files that it names, as :func:`load_urdf` does, without MuJoCo."""
    robot, origins, _, _ = _read(file, xacro_args, True, files)
    return _hold(robot, origins, file, files)


def _hold(robot: ElementTree.Element, origins: Mapping[ElementTree.Element, Place], file: Path,
          files: Files) -> SelfContainedModel:
    """Read what a URDF names, and leave out what MuJoCo does not read."""
    read = ElementTree.Element('robot', robot.attrib)
    read.extend([child for child in robot if child.tag in _READ_BY_MUJOCO])
    for material in read.iter('material'):  # Textures are not read.
        for texture in material.findall('texture'):
            material.remove(texture)
    document = Document(read, origins, folders=AssetFolders(file.parent))
    held = SelfContainedModel(str(file), [document], is_light=False)
    held.hold(files, as_robot=True)
    return held


def _read(file: Path, xacro_args: Mapping[str, str], expects_meshes: bool, files: Files | None
          ) -> tuple[ElementTree.Element, dict[ElementTree.Element, Place], dict[str, float],
                     list[str]]:
    """
    Return the elements, ready for MuJoCo.

    :returns: with file and line of each, the positions of joints to be fixed, by name, and the
        omissions, in sentences
    """
    robot, origins = _elements(file, xacro_args, files)
    for element in list(robot.iter()):  # Other readers take the first, too; MuJoCo refuses two.
        for alike in ([list(element)] if element.tag == 'geometry' else
                      map(element.findall, _SINGLE.get(element.tag, ()))):
            for repeated in alike[1:]:
                element.remove(repeated)
    for color in robot.iter('color'):
        if len(color.get('rgba', '').split()) == 3:
            color.set('rgba', f'{color.get("rgba")} 1')
    notes = [*find_meshes(robot, file, expects_meshes, files), *_drop_empty_shapes(robot),
             *_make_physical(robot)]
    fixed, said = check_joints(robot, file)
    extension = robot.find('mujoco')
    if extension is None:
        extension = ElementTree.SubElement(robot, 'mujoco')
    compiler = extension.find('compiler')
    if compiler is None:
        compiler = ElementTree.SubElement(extension, 'compiler')
    for attribute, value in (('fusestatic', 'false'), ('discardvisual', 'false'),
                             ('strippath', 'false'), ('balanceinertia', 'true'),
                             ('autolimits', 'true')):
        compiler.set(attribute, value)
    for attribute in ('meshdir', 'coordinate'):  # The frames of a URDF are always local.
        compiler.attrib.pop(attribute, None)
    return robot, origins, fixed, [*notes, *said]


def _elements(file: Path, xacro_args: Mapping[str, str], files: Files | None
              ) -> tuple[ElementTree.Element, dict[ElementTree.Element, Place]]:
    """
    Return the root element of a URDF file with the places of all, or of what a xacro file makes.

    :raises ModelError: if it is not URDF, cannot be read, or is xacro by request, which runs code
    """
    is_xacro = file.suffix.lower() == XACRO_SUFFIX
    if files is not None:
        if is_xacro or xacro_args:
            raise ModelError(
                f'{one_line(str(file), 200)}: xacro evaluates Python and reads other files, so it '
                "is not expanded by request: spawn the URDF that 'xacro "
                f"{one_line(file.name, 60)} > robot.urdf' writes below spawn_roots, or add the "
                'file to a folder of model_path')
    elif is_xacro:
        text = InMemoryFile(expanded(file, xacro_args), str(file))
        file, files = text.file, text
    elif xacro_args:
        raise ModelError(f"'xacro_args' are for a {XACRO_SUFFIX} file, not for {file}")
    model = XmlModel(file, files=files)
    if not model.is_urdf:
        raise ModelError(f"{file} is not URDF: its root is {quoted(model.root)}, not 'robot'")
    return model.tree, {} if is_xacro else model.origins


def _drop_empty_shapes(robot: ElementTree.Element) -> list[str]:
    """
    Remove shapes of size zero, which some exporters write for links without a shape.

    Shapes without a complete geometry of a kind that URDF knows are removed, too, and those whose
    place or size is no number, such as what xacro would have replaced.
    """
    dropped, unknown = [], []
    for link in robot.iter('link'):
        for shape in [*link.findall('visual'), *link.findall('collision')]:
            is_known = any(needed <= set(element.keys()) for tag, needed in _GEOMETRY.items()
                           for element in shape.findall(f'geometry/{tag}'))
            sizes = [number for element in shape.findall('geometry/*') if element.tag != 'mesh'
                     for key in ('size', 'radius', 'length')
                     for number in element.get(key, '').split()]
            places = [number for element in shape.findall('origin')
                      for number in ' '.join(element.attrib.values()).split()]
            if any(_value(number) == 0.0 for number in sizes):
                link.remove(shape)
                dropped.append(str(link.get('name')))
            elif not is_known or any(math.isnan(_value(number)) for number in (*sizes, *places)):
                link.remove(shape)
                unknown.append(str(link.get('name')))
    return [f'left out: {pluralize(len(names), "shape")} {reason}, of {quoted_names(names)}'
            for names, reason in ((dropped, 'of size zero'), (
                unknown, 'without a <box>, <cylinder>, <sphere> or <mesh> with its attributes, or '
                         'without numbers in them'))
            if names]


def _value(number: str) -> float:
    """Return a number of a file, without a comma behind it; NaN if it is none."""
    try:
        return float(number.rstrip(','))
    except ValueError:
        return math.nan


def _give_mass(spec: mujoco.MjSpec, robot: ElementTree.Element) -> list[str]:
    """Give a little mass to links that move, with nothing on them that has inertia or shapes."""
    without = {str(link.get('name')) for link in robot.iter('link')
               if link.find('inertial') is None}
    light = []
    for body in spec.bodies[1:]:
        # Links on it may be heavy: MuJoCo wants a mass of its own nevertheless.
        if (body.name in without and len(body.joints)
                and not any(other.name not in without or _colliding(other)
                            for other in _with_fixed(body))):
            body.mass, body.inertia = _LIGHT_KG, [_LIGHT_INERTIA] * 3
            body.explicitinertial = True
            light.append(body.name)
    return [f'1 g for links without inertia and shape: {", ".join(light)}'] if light else []


def _take_gravity(spec: mujoco.MjSpec, robot: ElementTree.Element) -> list[str]:
    """Let links weigh nothing that weigh nothing in Gazebo, such as those that springs carry."""
    light = []
    for extension in robot.iter('gazebo'):
        said = {str(child.text).strip().lower(): child.tag for child in extension
                if child.tag in ('gravity', 'turnGravityOff')}
        body = spec.body(extension.get('reference', ''))
        if body is not None and (said.get('0', said.get('false')) == 'gravity'
                                 or said.get('1', said.get('true')) == 'turnGravityOff'):
            body.gravcomp = 1.0
            light.append(body.name)
    return [f'no gravity on {pluralize(len(light), "link")}, as <gazebo> elements say: '
            f'{quoted_names(light)}'] if light else []


def _with_fixed(body: Any) -> Iterator[Any]:
    """Yield a body and the bodies fixed on it."""
    left = [body]
    while left:
        body = left.pop()
        yield body
        left += [child for child in body.bodies if not child.joints]


def masses_from_shapes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """Say which moving links of a URDF have a mass that follows from their shapes."""
    return [f"link '{body.name}' has no <inertial>: {model.body(body.name).mass[0]:.4g} kg from "
            f'its collision shapes at {max(geom.density for geom in _colliding(body)):.4g} kg/m^3'
            for body in _guessed(spec, model)]


def lighten(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """
    Reduce the density of shapes that give a link its mass, if motors could not carry the links.

    Shapes for collisions are often thicker than the link, and there twice.
    """
    guessed = list(_guessed(spec, model))
    share = _carried_share(model, [model.body(body.name).id for body in guessed])
    if share >= 1.0:
        return []
    for body in guessed:
        for geom in _colliding(body):
            geom.density *= share
    return ['links without <inertial> are lighter than their shapes at the usual density, so that '
            f'no pose needs more than {_CARRIED_SHARE:.0%} of an effort limit']


def _guessed(spec: mujoco.MjSpec, model: mujoco.MjModel) -> Iterator[Any]:
    """Yield the bodies that move and whose mass follows from their shapes."""
    for body in spec.bodies[1:]:
        if (not body.explicitinertial and _colliding(body)
                and model.body_weldid[model.body(body.name).id]):
            yield body


def _colliding(body: Any) -> list[Any]:
    return [geom for geom in body.geoms if geom.contype or geom.conaffinity]


def _carried_share(model: mujoco.MjModel, guessed: list[int]) -> float:
    """Return by which factor some masses have to be smaller so that all effort limits carry."""
    limited = np.flatnonzero(model.jnt_actfrclimited)
    if not guessed or not len(limited):
        return 1.0
    dofs = model.jnt_dofadr[limited]
    room = _CARRIED_SHARE * np.abs(model.jnt_actfrcrange[limited]).max(axis=1)
    share = 1.0
    others = sorted(set(range(1, model.nbody)) - set(guessed))
    for data in _in_random_poses(model):
        known, made = (np.abs(_weight(model, data, bodies)[dofs]) for bodies in (others, guessed))
        heavy = (made > 0.0) & (known < room)
        share = float(np.min((room - known)[heavy] / made[heavy], initial=share))
    return max(share, _LEAST_DENSITY_FACTOR)


def greatest_weight(model: mujoco.MjModel) -> FloatArray:
    """Return the greatest effort that the weight of all bodies asks in any pose, shape (nv,)."""
    bodies = [*range(1, model.nbody)]
    weights = [np.abs(_weight(model, data, bodies)) for data in _in_random_poses(model)]
    greatest: FloatArray = np.max(weights, axis=0)
    return greatest


def _in_random_poses(model: mujoco.MjModel) -> Iterator[mujoco.MjData]:
    """Yield the same data again and again, in other poses."""
    free = np.flatnonzero(model.jnt_limited == 0)
    low, high = model.jnt_range.T.copy()
    low[free], high[free] = -np.pi, np.pi
    random, data = np.random.default_rng(0), mujoco.MjData(model)
    scalar = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    for _ in range(_POSES):
        data.qpos[model.jnt_qposadr[scalar]] = random.uniform(low, high)[scalar]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        yield data


def _weight(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]) -> FloatArray:
    """Return the effort that the weight of some bodies asks of the joints, shape (nv,)."""
    effort, jacobian = np.zeros(model.nv), np.empty((3, model.nv))
    for body in bodies:
        mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
        mass = model.body_mass[body] * (1.0 - model.body_gravcomp[body])
        effort -= mass * model.opt.gravity @ jacobian
    return effort


def _make_physical(robot: ElementTree.Element) -> list[str]:
    """
    Make the masses of moving links positive and the moments of inertia of all links possible.

    An inertia matrix keeps its axes; a moment below the least becomes that. MuJoCo itself corrects
    moments of which one is greater than the sum of the others. Products that are missing are zero,
    missing moments those of a ball of water, and an ``<inertial>`` without mass is left out.

    :param robot: root of the URDF, changed in place; numbers that are none are left to MuJoCo
    :returns: a sentence for each kind of change
    """
    moved = {child.get('link') for joint in robot.iter('joint') if joint.get('type') != 'fixed'
             for child in joint.findall('child')}
    weightless, projected, balls, massless = [], [], [], []
    for link in robot.iter('link'):
        inertial = link.find('inertial')
        if inertial is None:
            continue
        mass, inertia = inertial.find('mass'), inertial.find('inertia')
        if mass is None:
            link.remove(inertial)
            massless.append(str(link.get('name')))
            continue
        if inertia is None:
            inertia = ElementTree.SubElement(inertial, 'inertia')
            balls.append(str(link.get('name')))
            _write(inertia, np.diag([_moment_of_ball(mass)] * 3))
        for pair in _PAIRS:
            inertia.attrib.setdefault(f'i{pair}', '0')
        try:
            moments, axes = np.linalg.eigh(_matrix(inertia))
            kilograms = float(mass.get('value', 0.0))
        except (ValueError, np.linalg.LinAlgError):
            continue
        name = str(link.get('name'))
        needs_mass = kilograms <= 0.0 and link.get('name') in moved
        if needs_mass:
            mass.set('value', repr(_LEAST_KG))
            weightless.append(name)
        zero = max(_ZERO, _ZERO_SHARE * moments.max())
        if moments.min() < 0.0 or (moments.min() <= zero and (kilograms > 0.0 or needs_mass)):
            _write(inertia, axes * np.maximum(moments, _LEAST_INERTIA) @ axes.T)
            projected.append(name)
    return [said + quoted_names(names) for names, said in (
        (massless, 'left out: <inertial> without <mass>, of '),
        (balls, 'the moment of inertia of a ball of water for links whose <inertial> has no '
                '<inertia>: '),
        (weightless, f'{_LEAST_KG * 1e3:g} g for moving links of mass 0: '),
        (projected, 'moments of inertia that are not positive became '
                    f'{_LEAST_INERTIA:g} kg m^2: ')) if names]


def _moment_of_ball(mass: ElementTree.Element) -> float:
    """Return the moment of inertia of a ball of a mass [kg m^2]; 0 if it is no positive number."""
    try:
        kilograms = max(float(mass.get('value', 0.0)), 0.0)
    except ValueError:
        return 0.0
    radius = (3.0 * kilograms / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return float(0.4 * kilograms * radius**2)


def _matrix(inertia: ElementTree.Element) -> FloatArray:
    matrix = np.zeros((3, 3))
    for pair in _PAIRS:
        row, column = ('xyz'.index(letter) for letter in pair)
        matrix[row, column] = matrix[column, row] = float(inertia.get(f'i{pair}', 0.0))
    if not np.isfinite(matrix).all():
        raise ValueError('not finite')
    return matrix


def _write(inertia: ElementTree.Element, matrix: FloatArray) -> None:
    for pair in _PAIRS:
        row, column = ('xyz'.index(letter) for letter in pair)
        inertia.set(f'i{pair}', repr(float(matrix[row, column])))
