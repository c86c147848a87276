# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the model that a name means, and read the description beside it in YAML."""

from __future__ import annotations

from difflib import get_close_matches
import logging
from pathlib import Path
import re
from typing import Annotated, Any, Literal, TypeVar, Union

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.descriptions import AfterValidator, Field, Strict, ValidationError
from manip_sim.models.registry import find_source, is_of_others, is_path
from manip_sim.models.user_files import (
    Files, parse_requested, read_yaml, split_arguments, stem_of, XACRO_SUFFIX, YAML_SUFFIXES)
from manip_sim.quoting import one_line, quoted

#: A key of the outermost mapping of a YAML file, and how similar a misspelled one is at least.
_KEY, _NEAR = re.compile(rb'^["\']?([A-Za-z][\w -]*)["\']?[ \t]*:(?:\s|$)', re.MULTILINE), 0.8
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
Range = Annotated[list[Number], Field(min_length=2, max_length=2)]
Subsystem = Literal['arm', 'base', 'torso', 'head', 'legs', 'other']
Arm = Literal['right', 'left']
Name = Annotated[str, Field(strict=True, min_length=1)]


def _rotation(numbers: list[float]) -> list[float]:
    if len(numbers) == 4 and not any(numbers):
        raise ValueError('a quaternion must not be zero')
    return numbers


#: Roll, pitch, yaw [rad], or a quaternion w, x, y, z.
Rotation = Annotated[list[Number], Field(min_length=3, max_length=4), AfterValidator(_rotation)]


class Description(Strict):
    """Keys of all descriptions."""

    #: Path of the model, relative to the YAML file.
    model: Name | None = None
    #: Arguments of a xacro file.
    xacro_args: dict[Name, Union[Annotated[str, Field(strict=True)],
                                 Annotated[bool, Field(strict=True)], Number]] = {}
    #: ``none``: nobody is warned of meshes that are missing.
    meshes: Union[Literal['none'], None] = None

    @property
    def xacro_values(self) -> dict[str, str]:
        """The arguments as xacro reads them, a copy."""
        return {str(name): str(value).lower() if isinstance(value, bool) else
                f'{value:g}' if isinstance(value, float) else str(value)
                for name, value in self.xacro_args.items()}


class FrameDescription(Strict):
    """A pose in the frame of a body or site."""

    #: Name of a body or site.
    at: Name | None = None
    position: Vector = [0.0, 0.0, 0.0]
    orientation: Rotation = [0.0, 0.0, 0.0]


class HandDescription(Strict):
    """Description of a hand, beyond the file of it or of a robot with it."""

    #: The grasp frame.
    grasp_point: FrameDescription | None = None
    #: Opening and closing control, in that order, by actuator.
    closing: dict[Name, Range] = {}
    #: Numbers of an action: one for each actuator, or one for all.
    action: Literal['each', 'together'] = 'each'
    #: Lists of geoms by role, such as ``left_fingerpad``.
    fingers: dict[Literal['left_finger', 'right_finger', 'left_fingerpad', 'right_fingerpad'],
                  list[Name]] = {}

    @property
    def geoms_by_role(self) -> dict[str, list[str]]:
        """Lists of the fingers' geoms by role, copies."""
        return {str(role): list(geoms) for role, geoms in self.fingers.items()}


class OwnHandDescription(HandDescription):
    """The hand in a robot's file."""

    #: The body that carries all of it.
    body: Name | None = None


class GripperDescription(Description, HandDescription):
    """A hand in a file of its own."""

    #: Pose of its root body in the end effector body of an arm.
    mount: FrameDescription | None = None
    #: A keyframe, or positions by joint [rad or m].
    start: Union[Name, dict[Name, Number], None] = None


class ArmDescription(Strict):
    """End of an arm, and its hand or default gripper."""

    #: The body or site that a gripper is mounted on, or a pose in it.
    mount: Union[Name, FrameDescription, None] = None
    #: The file's own hand, or the body that carries it; ``none``: there is none.
    hand: Union[Name, OwnHandDescription, None] = None
    gripper: Name | None = None
    controller: Name | None = None


class RobotDescription(Description):
    """A robot."""

    #: By side; ``none``: the robot has no arms, whatever its file looks like.
    arms: Union[dict[Arm, ArmDescription], Literal['none']] = {}
    #: Subsystem by joint.
    subsystems: dict[Name, Subsystem] = {}
    #: A keyframe, or positions by joint [rad or m].
    start: Union[Name, dict[Name, Number], None] = None
    base: Name | None = None
    #: Controller settings by subsystem.
    controllers: dict[Name, Name] = {}
    #: Position of the floor below the robot in ``world``, by arena [m].
    placement: dict[Name, Vector] = {}
    #: Point that stands on a base or the floor, in the frame of the root body [m].
    foot: Vector | None = None
    #: True if mocap bodies of the file come with the robot.
    mocap: Annotated[bool, Field(strict=True)] = True
    #: Effort limits of joints of a file without actuators: its own, or guesses for those too low.
    efforts: Literal['own', 'guess'] = 'own'
    #: By joint [rad/s or m/s].
    velocity_limits: dict[Name, Annotated[Number, Field(gt=0.0)]] = {}

    @property
    def by_arm(self) -> dict[Arm, ArmDescription]:
        """The descriptions of arms."""
        return {} if isinstance(self.arms, str) else self.arms

    def arm(self, side: str) -> ArmDescription | None:
        """Return the description of an arm, or None."""
        return next((arm for name, arm in self.by_arm.items() if name == side), None)


class BaseDescription(Description):
    """Description of a base, on which a robot stands."""

    #: Where the robot stands, in the frame of the root body [m].
    top: Vector | None = None
    #: Body that carries the robot, of a base with joints.
    support: Name | None = None
    #: True if a base with joints drives sideways; else twists along y are clamped to zero.
    sideways: bool = True


class ArenaDescription(Description):
    """The environment of the robots; without ``model``, it consists of an arena and parts."""

    #: Arena to begin with, without a model: a name of the catalogue, or ``robosuite:NAME``.
    arena: Name | None = None
    #: Parameters of that arena.
    parameters: dict[Name, Union[Annotated[bool, Field(strict=True)], Number]] = {}
    #: Position of the floor below a robot in ``world`` [m]; None: where ``arena`` has it.
    robot_position: Vector | None = None
    #: Descriptions of welded furniture, which are checked elsewhere.
    fixtures: list[dict[str, Any]] = []
    #: Descriptions of objects, or paths of files, which are checked elsewhere.
    objects: list[Union[Name, dict[str, Any]]] = []
    #: Areas where objects are placed, by name, which are checked elsewhere.
    placements: dict[Name, Any] = {}


DescriptionT = TypeVar('DescriptionT', bound=Description)


def describes_model(file: Path, kind: type[Description], files: Files | None = None) -> bool:
    """
    Return whether a YAML file is a description, and not one of another tool.

    It is, if it has a key of a description or one that is nearly spelled so, or no key at all.
    """
    try:
        content = (files or Files()).read(file, 'YAML file')
    except ModelError:
        return True  # Reading it tells why.
    keys = [key.decode(errors='replace') for key in _KEY.findall(content)]
    return not keys or any(get_close_matches(key, kind.model_fields, 1, _NEAR) for key in keys)


def read_description(file: Path, kind: type[DescriptionT], files: Files | None = None
                     ) -> DescriptionT:
    """
    Read a description from a YAML file.

    :raises ModelError: if it cannot be read or a value is of the wrong kind
    :raises UnknownNameError: if it has an unknown key, naming the nearest ones
    """
    try:
        return kind.model_validate(read_yaml(file) if files is None else parse_requested(
            files.read(file, 'YAML file'), str(file)))
    except ValidationError as error:
        # A union has errors of all its members; the best fitting one has the deepest.
        deepest = max(error.errors(), key=lambda member: len(member['loc']))
        raise _explained(file, kind, deepest) from error


def _explained(file: Path, kind: type[Strict], error: Any) -> ModelError:
    # A part of a location may also name a member of a union, which is no key in the file.
    place = [str(part) for part in error['loc'] if not (
        isinstance(part, str) and ('[' in part or part in _UNION_MEMBERS))]
    if error['type'] == 'extra_forbidden':
        parent = '.'.join(place[:-1])
        return UnknownNameError(f'key of {file}{f", {parent}" if parent else ""}', place[-1],
                                _keys_at(kind, place[:-1]))
    message = error['msg'].removeprefix('Value error, ')
    if error['type'] in ('model_type', 'dict_type'):
        message = 'should be a mapping of keys to values'
    subject = f"'{'.'.join(place)}' of {file}" if place else str(file)
    return ModelError(f'{subject}: {message[:1].lower()}{message[1:]}, '
                      f'got {quoted(error["input"])}')


_UNION_MEMBERS = {'str', 'FrameDescription', 'OwnHandDescription', 'constrained-str'}


def _keys_at(kind: type[Strict], place: list[str]) -> list[str]:
    """Return the keys that a mapping at some location in a file may have."""
    if not place:
        return list(kind.model_fields)
    known: dict[str, type[Strict]] = {
        'arms': ArmDescription, 'mount': FrameDescription, 'grasp_point': FrameDescription,
        'hand': OwnHandDescription}
    for name in reversed(place):
        if name in known:
            return list(known[name].model_fields)
    return list(kind.model_fields)


MODELS = ('.xml', '.mjcf', '.urdf', XACRO_SUFFIX)


def find_model(path: Path, kind: type[DescriptionT], stem: str, files: Files | None = None
               ) -> tuple[Path, DescriptionT, str]:
    """
    Return the file of a model, its description, and the file that the latter was read from.

    A model ``panda.xml`` is described by ``panda.yaml`` beside it, or by a file of a fixed name,
    such as ``robot.yaml``, that names it or has no other model beside it.

    :param path: a model, a YAML file, or a folder; arguments may follow the name of a xacro file;
        or a name of Menagerie or robosuite, as for ``find_source``
    :param stem: the fixed name of a YAML file, without its suffix, such as ``robot``
    :raises ModelError: if a file is missing, or it is not clear which one is meant
    """
    try:
        if files is None and is_of_others(str(path)):
            path = find_source(str(path), f'{stem}s') or path
        file, arguments = split_arguments(str(path))
        model, description, source = _find(Path(file).expanduser(), kind, stem, files)
        if arguments:
            description.xacro_args = {**description.xacro_args, **arguments}
        return model, description, source
    except (OSError, RuntimeError) as error:
        raise ModelError(f'cannot read {one_line(str(path), 200)}: '
                         f'{getattr(error, "strerror", None) or error}') from error


def _find(path: Path, kind: type[DescriptionT], stem: str, files: Files | None
          ) -> tuple[Path, DescriptionT, str]:
    at = files or Files()
    if at.is_folder(path):
        path = _in_folder(path, stem, at)
    if not at.is_file(path):
        raise ModelError(f'no such file: {one_line(str(path), 200)}')
    if path.suffix.lower() in YAML_SUFFIXES:
        description = _described(path, kind, files)
        return _model_of(path, description, stem, at), description, str(path)
    if path.suffix.lower() not in MODELS:
        raise ModelError(f'{path} is neither a model ({", ".join(MODELS)}) nor a description '
                         f'({", ".join(YAML_SUFFIXES)})')
    for name in (stem_of(path), stem):
        for suffix in YAML_SUFFIXES:
            beside = path.with_name(name + suffix)
            if not at.is_file(beside):
                continue
            if not describes_model(beside, kind, files):
                logging.getLogger(__name__).warning(
                    '%s is not read: it has no key of a description, such as %s', beside,
                    next(iter(kind.model_fields)))
                continue
            description = _described(beside, kind, files)
            if _model_of(beside, description, stem, at).resolve() == path.resolve():
                return path, description, str(beside)
    return path, kind(), str(path)


def _described(file: Path, kind: type[DescriptionT], files: Files | None) -> DescriptionT:
    """Read a description; relative paths of other files in it start from its folder."""
    description = read_description(file, kind, files)
    if isinstance(description, RobotDescription):
        for part in (*description.by_arm.values(), description):
            key = 'base' if part is description else 'gripper'
            named = getattr(part, key)
            if named is not None and is_path(named):
                setattr(part, key, str(file.parent / Path(named).expanduser()))
    return description


def _in_folder(folder: Path, stem: str, files: Files) -> Path:
    names = [*(stem + suffix for suffix in YAML_SUFFIXES),
             *(name + suffix for name in (folder.name, stem)
               for suffix in (*YAML_SUFFIXES, *MODELS))]
    for name in names:
        if files.is_file(folder / name):
            return folder / name
    models = _models_in(folder, files)
    # In Menagerie, a scene includes the model, and adds floor and light.
    apart = [file for file in models if not file.stem.startswith('scene')]
    for candidates in (models, apart):
        if len(candidates) == 1:
            return candidates[0]
    listed = ', '.join(file.name for file in models[:5]) or 'no model'
    raise ModelError(f'{folder} has neither {stem}.yaml nor {folder.name}.xml nor one model '
                     f'alone, but {listed}')


def _models_in(folder: Path, files: Files) -> list[Path]:
    """Return the models in a folder; of xacro files those that are whole robots by their name."""
    return [file for file in files.listed(folder) if file.suffix.lower() in MODELS
            and not (file.suffix.lower() == XACRO_SUFFIX and stem_of(file) == file.stem)]


def _model_of(file: Path, description: Description, stem: str, files: Files) -> Path:
    """Return the model that a YAML file describes."""
    if description.model is not None:
        model = file.parent / Path(description.model).expanduser()
        if not files.is_file(model):
            raise ModelError(f"'model' of {file}: no such file: {one_line(str(model), 200)}"
                             f'{files.rule}')
        return model
    if isinstance(description, ArenaDescription) and description.arena is not None:
        return file
    for suffix in (*MODELS, f'.urdf{XACRO_SUFFIX}'):
        if files.is_file(file.with_suffix(suffix)):
            return file.with_suffix(suffix)
    models = _models_in(file.parent, files) if file.stem == stem else []
    if len(models) == 1:
        return models[0]
    if isinstance(description, ArenaDescription) and (
            description.fixtures or description.objects or description.placements):
        return file
    raise ModelError(f"{file} must say which 'model' it describes: there is no "
                     f'{file.with_suffix(".xml").name} beside it')
