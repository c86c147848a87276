# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Descriptions in YAML or a mapping: keys, units, limits; objects, cameras, lidars, motors and gears.

The friction, torque-speed curves and rotor inertia of the catalogue are in the file
``actuators.yaml`` beside a robot's MJCF, each with its source. How friction and torque follow the
velocity is computed by the simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import math
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np

from manip_sim.algebra import length, quat_wxyz_from_rpy, xyzw_to_wxyz
from manip_sim.arrays import FloatArray
from manip_sim.errors import describe_choices, ModelError, UnknownNameError
from manip_sim.models.actuators import FrictionLaw
from manip_sim.models.object_model import check_object_name, MAX_MASS_KG, MIN_MASS_KG, SIZES
from manip_sim.models.user_files import read_yaml
from manip_sim.quoting import format_value, one_line, pluralize, quoted
from manip_sim.sensing.images import (
    MAX_FOVY_DEG, MAX_PIXELS, MAX_RATE_HZ, MIN_FOVY_DEG, MIN_RATE_HZ)
from manip_sim.sensing.lidars import MAX_NOISE_M, MAX_RANGE_M, MAX_RAYS, MAX_RINGS
from manip_sim.validation import norm_of_unit_quaternion

try:
    from pydantic import (
        AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator, StrictBool,
        StrictInt, ValidationError)
except ImportError as error:  # Ubuntu 24.04 has version 1, and all else works without it.
    raise ModelError('models and objects from files and descriptions need pydantic 2: '
                     f"pip install 'pydantic>=2' ({error})") from error

__all__ = ['AfterValidator', 'BeforeValidator', 'checked', 'ConfigDict', 'Field',
           'model_validator', 'Number', 'Strict', 'StrictBool', 'StrictInt', 'ValidationError']
M = TypeVar('M', bound=BaseModel)
#: Greatest distance of an object or camera from the origin along an axis [m].
_MAX_DISTANCE_M = 1e4
_MIN_SIZE_M, _MAX_SIZE_M = 1e-4, 100.0
#: Of water, as in MuJoCo [kg/m^3].
_DEFAULT_DENSITY = 1000.0
#: The shape that is in a file.
MESH = 'mesh'
#: Sliding, torsional [m] and rolling [m], as in MuJoCo.
DEFAULT_FRICTION = (1.0, 0.005, 0.0001)
#: A point nearer to the camera than this gives no direction to look in [m].
_MIN_DISTANCE_M = 1e-6
_Pixels = Annotated[StrictInt, Field(ge=1, le=MAX_PIXELS)]


class Strict(BaseModel):
    """A description with known keys only; pydantic compiles it when it is first used."""

    # Each process that imports descriptions would wait for all of them.
    model_config = ConfigDict(extra='forbid', defer_build=True)


def compile_descriptions(base: type[Strict] = Strict) -> None:
    """Compile all descriptions imported by now, in a process that can read no file later."""
    for kind in base.__subclasses__():
        kind.model_rebuild()
        compile_descriptions(kind)


def _number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        hint = ', which YAML reads as a string: write 1.0e-3' if _is_exponent(value) else ''
        raise ValueError(f'must be a number{hint}')
    try:
        return float(value)
    except OverflowError:
        raise ValueError('must be finite') from None


def _is_exponent(value: object) -> bool:
    try:
        return isinstance(value, str) and float(value) is not None
    except ValueError:
        return False


#: A number, not given as a text or a bool; combine with ``pydantic.Field``.
Number = Annotated[float, BeforeValidator(_number)]


def checked(kind: type[M], values: Mapping[str, Any], source: str) -> M:
    """
    Return values as a pydantic model.

    :param kind: the model, which forbids extra keys
    :raises ModelError: on one line, naming the key that is unknown, missing or has a bad value
    """
    if not isinstance(values, Mapping):
        raise ModelError(f"{source}: must be keys with values, such as "
                         f"{{'{next(iter(kind.model_fields))}': ...}}, got {format_value(values)}")
    try:
        return kind.model_validate(dict(values))
    except ValidationError as errors:
        # A misspelt key also makes the right one missing; the error names the misspelt one.
        first = min(errors.errors(), key=lambda e: e['type'] != 'extra_forbidden')
        raise ModelError(f'{source}: {_explained(first, kind.model_fields)}') from None


def _explained(error: Any, keys: Iterable[str]) -> str:
    place = [str(part) for part in error['loc']]
    key = place[0] if place else ''
    if error['type'] == 'extra_forbidden':
        return f'unknown key {quoted(key)}: {describe_choices(key, keys)}'
    if error['type'] == 'missing':
        return f"needs '{key}'"
    own = error.get('ctx', {}).get('error', error['msg'])
    message = _MESSAGES.get(error['type'], lambda e: str(own))(error)
    if not key:
        return one_line(message)
    number = f'[{place[1]}]' if len(place) > 1 and place[1].isdigit() else ''
    return one_line(f"'{key}'{number} {message}, got {format_value(error['input'])}")


def _length(error: Any) -> str:
    context = error['ctx']
    bound = f'at least {context["min_length"]}' if 'min_length' in context else (
        f'at most {context["max_length"]}')
    return f'must have {bound} of them'


_MESSAGES: dict[str, Callable[[Any], str]] = {
    'greater_than': lambda e: f'must be above {e["ctx"]["gt"]:g}',
    'greater_than_equal': lambda e: f'must be at least {e["ctx"]["ge"]:g}',
    'less_than_equal': lambda e: f'must be at most {e["ctx"]["le"]:g}',
    'finite_number': lambda e: 'must be finite',
    'literal_error': lambda e: f'must be {e["ctx"]["expected"]}',
    'list_type': lambda e: 'must be a list',
    'int_type': lambda e: 'must be a whole number',
    'bool_type': lambda e: 'must be true or false',
    'string_type': lambda e: 'must be a string',
    'too_short': _length,
    'too_long': _length,
}


def _listed(value: object) -> object:
    """Return a number as a list of one, anything else as it is."""
    return [value] if isinstance(value, (int, float)) and not isinstance(value, bool) else value


def _known_shape(value: object) -> object:
    if not isinstance(value, str) or value not in SIZES:
        raise ValueError(f'is unknown: {describe_choices(value, [*SIZES, MESH])}')
    return value


#: A position along an axis [m].
Coordinate = Annotated[Number, Field(ge=-_MAX_DISTANCE_M, le=_MAX_DISTANCE_M,
                                     allow_inf_nan=False)]
_Finite = Annotated[Number, Field(allow_inf_nan=False)]
_Size = Annotated[Number, Field(ge=_MIN_SIZE_M, le=_MAX_SIZE_M, allow_inf_nan=False)]
_Friction = Annotated[Number, Field(ge=0.0, le=100.0, allow_inf_nan=False)]
_Colour = Annotated[Number, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
_Mass = Annotated[Number, Field(ge=MIN_MASS_KG, le=MAX_MASS_KG, allow_inf_nan=False)]
_Scale = Annotated[Number, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
_Density = Annotated[Number, Field(gt=0.0, le=1e5, allow_inf_nan=False)]
_Turn = Annotated[Number, Field(ge=-math.pi - 1e-3, le=math.pi + 1e-3, allow_inf_nan=False)]
_Tilt = Annotated[Number, Field(ge=-math.pi / 2, le=math.pi / 2, allow_inf_nan=False)]
_Range = Annotated[Number, Field(gt=0.0, le=MAX_RANGE_M, allow_inf_nan=False)]


class PlacedDescription(Strict):
    """
    A name and a pose in the world.

    :ivar name: letters, digits and underscores; also the name of the body, and in names of topics
    :ivar position: of the body's frame in ``world`` [m]
    :ivar rpy: roll, pitch, yaw of the body in ``world`` [rad]
    :ivar quat_xyzw: instead of ``rpy``, a quaternion x, y, z, w of length 1
    :ivar visual: only seen, not touched; an object stays where it is put
    """

    model_config = ConfigDict(frozen=True)

    name: str | None = None
    position: Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None = None
    rpy: Annotated[list[_Finite], Field(min_length=3, max_length=3)] | None = None
    quat_xyzw: Annotated[list[_Finite], Field(min_length=4, max_length=4)] | None = None
    visual: StrictBool = False

    @model_validator(mode='after')
    def _check_orientation(self) -> PlacedDescription:
        if self.quat_xyzw is None:
            return self
        if self.rpy is not None:
            raise ValueError("give 'rpy' or 'quat_xyzw', not both")
        norm_of_unit_quaternion(self.quat_xyzw, "'quat_xyzw'", ValueError)
        return self

    @property
    def quat_wxyz(self) -> FloatArray | None:
        """The orientation, of length 1, shape (4,); None if it is not given."""
        if self.quat_xyzw is not None:
            quat = np.array(self.quat_xyzw)
            return xyzw_to_wxyz(quat / length(quat))
        return None if self.rpy is None else quat_wxyz_from_rpy(self.rpy)


class FileDescription(PlacedDescription):
    """
    An object in an MJCF file.

    It has the pose and the name of the body in the file, unless given here.

    :ivar file: path, relative to the folder of the YAML file, or to the working directory; or
        ``robosuite:NAME``
    """

    file: str


class SolidDescription(PlacedDescription):
    """
    A body of one material.

    :ivar mass: [kg]
    :ivar density: instead of the mass [kg/m^3], 1000 if neither is given
    :ivar friction: sliding, optionally followed by torsional [m] and rolling [m]
    :ivar rgba: colour, each from 0 to 1; opaque if the fourth is left out
    :ivar condim: MuJoCo's dimension of contacts: 4 adds torsional, 6 also rolling friction
    """

    name: str
    mass: _Mass | None = None
    density: _Density | None = None
    friction: Annotated[list[_Friction], BeforeValidator(_listed),
                        Field(min_length=1, max_length=3)] = list(DEFAULT_FRICTION)
    rgba: Annotated[list[_Colour], Field(min_length=3, max_length=4)] = [0.6, 0.6, 0.65, 1.0]
    condim: Literal[1, 3, 4, 6] = 3

    @model_validator(mode='after')
    def _check_mass(self) -> SolidDescription:
        if self.mass is not None and self.density is not None:
            raise ValueError("give 'mass' or 'density', not both")
        return self

    @property
    def colour(self) -> list[float]:
        """Red, green, blue and opacity, shape (4,)."""
        return [*self.rgba, 1.0][:4]

    @property
    def density_kg_m3(self) -> float:
        """Density, unless :attr:`mass` is given [kg/m^3]."""
        return self.density or _DEFAULT_DENSITY


class MeshDescription(SolidDescription):
    """
    A body of the shape of a mesh, with the frame of the file.

    :ivar shape: ``mesh``
    :ivar file: path of an OBJ or STL file, as that of :class:`FileDescription`
    :ivar scale: of the file, or [x, y, z]; 0.001 for millimetres
    :ivar texture: path of a PNG image; an OBJ file says how it lies on the shape
    :ivar collision: ``hull``, the convex hull, or ``parts``, convex parts of it by coacd
    """

    shape: Literal['mesh']
    file: str
    scale: Annotated[list[_Scale], BeforeValidator(_listed)] = [1.0]
    texture: str | None = None
    collision: Literal['hull', 'parts'] = 'hull'

    @model_validator(mode='after')
    def _check_scale(self) -> MeshDescription:
        if len(self.scale) not in (1, 3):
            raise ValueError(f"'scale' must be a number or [x, y, z], "
                             f'got {format_value(self.scale)}')
        return self


class ShapeDescription(SolidDescription):
    """
    A body of one shape, with its frame in the middle; the axis of a cylinder or capsule is z.

    :ivar shape: ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``ellipsoid``
    :ivar size: full extents [x, y, z] of a box, radius of a sphere, [radius, length] of a cylinder
        and of a capsule without its caps, radii [x, y, z] of an ellipsoid [m]
    """

    shape: Annotated[str, BeforeValidator(_known_shape)]
    size: Annotated[list[_Size], BeforeValidator(_listed)]

    @model_validator(mode='after')
    def _check_size(self) -> ShapeDescription:
        count, meaning = SIZES[self.shape]
        if len(self.size) != count:
            raise ValueError(f"'size' of a {self.shape} is {meaning} [m], got "
                             f'{pluralize(len(self.size), "number")}: {format_value(self.size)}')
        if not MIN_MASS_KG <= self.mass_kg <= MAX_MASS_KG:
            raise ValueError(f'weighs {self.mass_kg:g} kg by its density, it must be '
                             f'{MIN_MASS_KG:g} to {MAX_MASS_KG:g} kg')
        return self

    @property
    def volume_m3(self) -> float:
        """Volume of the shape [m^3]."""
        if self.shape == 'box':
            return math.prod(self.size)
        ball = 4.0 / 3.0 * math.pi
        if self.shape == 'ellipsoid':
            return ball * math.prod(self.size)
        radius = self.size[0]
        cylinder = math.pi * radius**2 * self.size[-1]
        return {'sphere': ball * radius**3, 'cylinder': cylinder,
                'capsule': cylinder + ball * radius**3}[self.shape]

    @property
    def mass_kg(self) -> float:
        """Mass, as given or from the density [kg]."""
        if self.mass is not None:
            return self.mass
        return self.density_kg_m3 * self.volume_m3

    @property
    def mujoco_size(self) -> list[float]:
        """The ``size`` of MuJoCo's geom: half extents, radii and half lengths [m]."""
        if self.shape == 'box':
            return [extent / 2.0 for extent in self.size]
        if self.shape in ('cylinder', 'capsule'):
            return [self.size[0], self.size[1] / 2.0, 0.0]
        return [*self.size, 0.0, 0.0][:3]


def kind_of(values: Any) -> type[FileDescription | MeshDescription | ShapeDescription]:
    """
    Return the kind of description that some values are meant to be.

    :raises ValueError: if they have both a file and a shape other than a mesh
    """
    if values.get('shape') == MESH:
        return MeshDescription
    if 'file' in values and 'shape' in values:
        raise ValueError("give 'shape' or 'file', not both; only 'shape: mesh' has a file")
    return FileDescription if 'file' in values else ShapeDescription


class CameraDescription(PlacedDescription):
    """
    A camera: its name, where it is and what it sees.

    The pose is that of a frame that looks along x, with y to the left and z up, in the frame of
    the body.

    :ivar position: in the frame of the body [m], the origin if it is not given
    :ivar look_at: instead of ``rpy`` and ``quat_xyzw``, the point in the middle of the image, in
        the frame of the body [m]; up is the body's z, or its x if the camera looks along z
    :ivar body: the body that it is fixed to; None is the world
    :ivar fovy: vertical field of view [degrees]
    :ivar width: of the images [pixels], as ``height``
    :ivar rate: images per second of simulation time [Hz]
    :ivar depth: also publish depth images
    """

    name: str
    look_at: Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None = None
    body: str | None = None
    fovy: Annotated[Number, Field(ge=MIN_FOVY_DEG, le=MAX_FOVY_DEG, allow_inf_nan=False)] = 45.0
    width: _Pixels | None = None
    height: _Pixels | None = None
    rate: Annotated[Number, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)
                    ] | None = None
    depth: StrictBool | None = None

    @model_validator(mode='after')
    def _check_look_at(self) -> CameraDescription:
        if self.look_at is None:
            return self
        if self.rpy is not None or self.quat_xyzw is not None:
            raise ValueError("give 'look_at', 'rpy' or 'quat_xyzw', not two of them")
        if math.dist(self.look_at, self.position or [0.0, 0.0, 0.0]) < _MIN_DISTANCE_M:
            raise ValueError(f"'look_at' must not be where the camera is, got {self.look_at}")
        return self


class LidarDescription(PlacedDescription):
    """
    A lidar: its name, where it is and what it sees; its frame has x ahead and z up.

    Omitted values are as in :class:`manip_sim.sensing.lidars.Rays`.

    :ivar position: in the frame of the body [m], the origin if it is not given
    :ivar body: the body that it is fixed to, which it does not see; None is the world
    :ivar samples: rays of a ring
    :ivar rings: 1 is a planar scanner, with a LaserScan; more make a PointCloud2
    :ivar angle_min: of the first ray of a ring, about z [rad]
    :ivar angle_max: of the last one; of a full turn, of the one after the last one [rad]
    :ivar elevation_min: of the first of several rings [rad]
    :ivar elevation_max: of the last one [rad]
    :ivar range_min: below it is too near to measure [m]
    :ivar range_max: beyond it is nothing [m]
    :ivar rate: scans per second of simulation time [Hz]
    :ivar noise: standard deviation of the white noise on distances [m]
    """

    name: str
    body: str | None = None
    samples: Annotated[StrictInt, Field(ge=2, le=MAX_RAYS)] = 360
    rings: Annotated[StrictInt, Field(ge=1, le=MAX_RINGS)] = 1
    angle_min: _Turn | None = None
    angle_max: _Turn | None = None
    elevation_min: _Tilt | None = None
    elevation_max: _Tilt | None = None
    range_min: _Range | None = None
    range_max: _Range | None = None
    rate: Annotated[Number, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)] = 10.0
    noise: Annotated[Number, Field(ge=0.0, le=MAX_NOISE_M, allow_inf_nan=False)] = 0.0


Mounted = TypeVar('Mounted', CameraDescription, LidarDescription)


def read_mounted(kind: type[Mounted], noun: str, values: Mapping[str, Any]) -> tuple[Mounted, str]:
    """Return the description of a camera or lidar, and what to call it in messages."""
    name = values.get('name') if isinstance(values, Mapping) else None
    source = f'{noun} without a name' if name is None else f'{noun} {quoted(name)}'
    parsed = checked(kind, values, source)
    check_object_name(parsed.name, noun, f'a {noun} and its topics')
    return parsed, source


CATALOGUE = 'catalogue'
#: Beside the MJCF file of a robot.
FILE = 'actuators.yaml'


def _per_joint(value: Any) -> tuple[float, ...]:
    values: list[Any] = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
    if not values or any(isinstance(item, bool) or not isinstance(item, (int, float))
                         or not 0.0 <= item < math.inf for item in values):
        raise ValueError('must be a finite number from 0, or one for each joint')
    return tuple(float(item) for item in values)


PerJoint = Annotated[tuple[float, ...], BeforeValidator(_per_joint)]


class Friction(Strict):
    """
    Friction of joints; each a number, or one for each joint.

    :ivar coulomb: dry friction at speed [N m or N]
    :ivar viscous: in place of the damping of the model [N m s/rad or N s/m]
    :ivar static: dry friction at rest [N m or N]; needs :attr:`stribeck_velocity`
    :ivar stribeck_velocity: [rad/s or m/s]
    """

    coulomb: PerJoint
    viscous: PerJoint | None = None
    static: PerJoint | None = None
    stribeck_velocity: PerJoint | None = None

    @model_validator(mode='after')
    def _check(self) -> Friction:
        if (self.static is None) != (self.stribeck_velocity is None):
            raise ValueError("'static' and 'stribeck_velocity' belong together")
        if self.stribeck_velocity is not None and not all(self.stribeck_velocity):
            raise ValueError("'stribeck_velocity' must be above 0")
        return self


class TorqueSpeed(Strict):
    """
    Torque-speed curve of joints; each a number, or one for each joint.

    :ivar knee: velocity up to which all of the torque is there [rad/s or m/s]
    :ivar no_load: velocity at which none is left [rad/s or m/s]
    """

    knee: PerJoint
    no_load: PerJoint


class _OfSubsystem(Strict):
    friction: Friction | None = None
    torque_speed: TorqueSpeed | None = None
    #: Sources of the numbers, by their names.
    sources: dict[str, str]


class JointActuation:
    """
    The actuation of the joints of one subsystem.

    :param source: the subsystem and its robot, for messages
    :param catalogue: values by kind, as :func:`read_catalogue` returns them
    :param friction: ``catalogue``, or the keys of :class:`Friction`; None for that of the model
    :param torque_speed: ``catalogue``, or the keys of :class:`TorqueSpeed`; None for the same
        torque at any speed
    """

    def __init__(self, joints: Sequence[str], source: str, catalogue: Mapping[str, Any] | None,
                 friction: str | Mapping[str, Any] | None,
                 torque_speed: str | Mapping[str, Any] | None) -> None:
        self.joints = list(joints)
        self._source, self._catalogue = source, catalogue or {}
        #: Each with one number for each joint, or None.
        self._friction = self._chosen(Friction, friction, 'friction')
        self._curve = self._chosen(TorqueSpeed, torque_speed, 'torque_speed')
        static = self._friction.get('static')
        if static is not None and (static < self._friction['coulomb']).any():
            raise ModelError(f"friction of {source}: 'static' must be at least 'coulomb'")
        if self._curve and (self._curve['no_load'] <= self._curve['knee']).any():
            raise ModelError(f"torque_speed of {source}: 'no_load' must be above 'knee'")

    def _chosen(self, kind: type[Strict], choice: str | Mapping[str, Any] | None, key: str
                ) -> dict[str, FloatArray]:
        """Return numbers by name, for each joint, of those that are given."""
        if choice is None:
            return {}
        source = f'{key} of {self._source}'
        if isinstance(choice, str) and choice != CATALOGUE:
            raise UnknownNameError(source, choice, ['none', CATALOGUE])
        values = self._catalogue.get(key) if isinstance(choice, str) else choice
        if values is None:
            raise ModelError(f'{source}: the catalogue has none; give numbers')
        if not isinstance(values, Mapping):
            raise ModelError(f'{source} must be a mapping, got {format_value(values)}')
        return {name: self.of_each(numbers, name) for name, numbers in
                checked(kind, values, source).model_dump(exclude_none=True).items()}

    def of_each(self, values: tuple[float, ...], name: str) -> FloatArray:
        """
        Return one number for each joint, shape (n,).

        :raises ModelError: if the number of values fits neither one nor all joints
        """
        count = len(self.joints)
        if len(values) not in (1, count):
            raise ModelError(f"{self._source}: '{name}' needs 1 or {count} numbers, "
                             f'got {len(values)}')
        return np.broadcast_to(np.array(values), count).copy()

    def attributes(self) -> list[tuple[str, FloatArray]]:
        """Return the attributes of joints in MJCF and their values, each of shape (n,)."""
        return [(attribute, self._friction[name]) for attribute, name in (
            ('frictionloss', 'coulomb'), ('damping', 'viscous')) if name in self._friction]

    def laws(self) -> list[FrictionLaw]:
        """Return what depends on the velocity, for each joint."""
        values = dict(self._curve)
        if 'static' in self._friction:
            values |= {name: self._friction[name]
                       for name in ('coulomb', 'static', 'stribeck_velocity')}
        return [FrictionLaw(**{name: float(numbers[joint]) for name, numbers in values.items()})
                for joint in range(len(self.joints))]


def single(value: float | Sequence[float], source: str) -> tuple[float, ...]:
    """
    Return a number, or one for each joint, as a tuple.

    :raises ModelError: if it is neither, or a number is negative or not finite
    """
    try:
        return _per_joint(value)
    except ValueError as error:
        raise ModelError(f'armature of {source} {error}, got {format_value(value)}') from error


def read_catalogue(folder: Path, subsystem: str) -> dict[str, Any] | None:
    """Return the values that the catalogue has for a subsystem, or None."""
    file = folder / FILE
    if not file.is_file():
        return None
    values = read_yaml(file).get(subsystem)
    if values is None:
        return None
    actuation = checked(_OfSubsystem, values, f'{file}: {subsystem}')
    return actuation.model_dump(exclude_none=True)
