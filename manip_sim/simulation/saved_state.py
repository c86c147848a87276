# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
States of a simulation between two control periods: saved, restored, compared by a digest.

They consist of plain data: numbers, texts, bytes, lists, dicts and arrays. As JSON it may come
from anybody. Reading it makes numbers, texts, arrays and containers, and objects of the classes of
this package that hold data; it runs no code of theirs, imports nothing but laws of users that are
installed here, by their names, and takes no more memory than the data.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Iterable, Mapping
import dataclasses
import enum
from functools import cached_property, lru_cache, partial
import hashlib
import json
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.control.commands import CommandHandle
from manip_sim.control.modes import Law, LAWS
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.physics import PHYSICS, Physics
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.physics.robot_frames import Frame
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import package_version
from manip_sim.simulation.episode_start import EpisodeStart
from manip_sim.simulation.robot import SimulatedRobot

#: Rooms whose classes can be written.
_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.sensing.',
          'manip_sim.simulation.')
#: Kinds of numbers that an array may have.
KINDS = 'biuf'
#: Character of an array's type, then its shape, in which equal letters are equal lengths. A class
#: declares them in ``shapes`` for arrays that compiled code reads, which checks nothing.
Shape = tuple[str | int, ...]
_AS_IT_IS = frozenset((type(None), bool, int, float, str, bytes))
_CONTAINERS: Mapping[str, type] = {
    'l': list, 't': tuple, 'q': deque, 's': set, 'f': frozenset}
_KIND_OF = {kind: letter for letter, kind in _CONTAINERS.items()}
#: Modules of the classes whose objects may have a state, or others that have one.
_CONTROL_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.simulation.')
#: Types of values without identity, which cannot change.
_VALUES = (type(None), bool, int, float, str, bytes, enum.Enum, np.generic)
#: Version of the layout of states; 1 were those whose control was pickled.
LAYOUT_VERSION = 3
#: Numbers of a model that control changes: gains of servos and of grippers.
_GAINS = ('actuator_gainprm', 'actuator_biasprm', 'actuator_forcerange', 'actuator_forcelimited')


class Encoder:
    """
    Turns objects into plain data; an object that is met again is a reference by its number.

    Containers and arrays belong to the object that has them, and are written again in another.

    :param index_of: index of objects that the reader has too, by their ``id``
    :param digest: leave out what makes no difference to the future: attributes that their class
        names in ``undigested``, what became of commands, and types of NumPy's numbers
    :ivar met: the objects that were written, in their order, but those that compare by value
    """

    def __init__(self, index_of: Mapping[int, int], digest: bool = False) -> None:
        self._index_of, self._digest = index_of, digest
        self._number_of: dict[int, int] = {}
        self.met: list[object] = []

    def encode(self, value: Any) -> Any:
        """
        Return a value as plain data.

        :raises ModelError: if it is of a kind that cannot be written
        """
        kind = type(value)
        if kind in _AS_IT_IS:
            return value
        if kind is np.ndarray:
            if value.dtype.kind not in KINDS:
                raise ModelError(f'an array of {value.dtype} cannot be a part of a state')
            return value.copy()
        if kind is dict:
            return self._dict(value)
        letter, encode = _KIND_OF.get(kind), self.encode
        if letter is not None:
            items = [item if type(item) in _AS_IT_IS else encode(item) for item in value]
            return [letter, *(sorted(items, key=repr) if letter in 'sf' else items)]
        if id(value) in self._index_of:
            return ['@', self._index_of[id(value)]]
        return self._other(value)

    def members(self, owner: Any, names: Any) -> dict[str, Any]:
        """Return attributes of an object by name, without those that a digest leaves out."""
        left_out = getattr(owner, 'undigested', ()) if self._digest else ()
        encode, members = self.encode, {}
        for name in names:
            if name not in left_out:
                value = getattr(owner, name)
                members[name] = value if type(value) in _AS_IT_IS else encode(value)
        return members

    def _dict(self, value: dict[Any, Any]) -> Any:
        if all([type(key) is str for key in value]):
            return {key: self.encode(item) for key, item in value.items()}
        items = [[self.encode(key), self.encode(item)] for key, item in value.items()]
        return ['d', *(sorted(items, key=repr) if self._digest else items)]

    def _other(self, value: Any) -> Any:
        if isinstance(value, np.generic):
            if self._digest or value.dtype.kind not in KINDS:
                return self.encode(value.item())
            return ['n', value.dtype.str, value.tobytes()]
        if isinstance(value, enum.Enum):
            return ['e', _name(type(value)), value.name]
        if isinstance(value, Law):
            return ['w', value.name]
        if isinstance(value, tuple) and hasattr(value, '_fields'):
            return ['T', _name(type(value)), *map(self.encode, value)]
        if not _is_data(type(value)):
            raise ModelError(f'a {type(value).__name__} cannot be a part of a state')
        if _is_value(type(value)):
            return ['v', _name(type(value)), self.members(value, vars(value))]
        if self._digest and isinstance(value, CommandHandle) and not value.is_active:
            return 'ended'
        if id(value) in self._number_of:
            return ['#', self._number_of[id(value)]]
        self._number_of[id(value)] = len(self.met)
        self.met.append(value)
        return ['o', _name(type(value)), self.members(value, vars(value))]


class Decoder:
    """
    Makes objects of what :class:`Encoder` has written.

    :param fixed: the objects that both have, by index
    :ivar met: the objects that were made, in their order, but those that compare by value
    :ivar values: those
    """

    def __init__(self, fixed: list[object]) -> None:
        self.met: list[Any] = []
        self.values: list[Any] = []
        self._readers: dict[str, Callable[..., Any]] = {
            'a': _array_of, 'n': _number, 'e': _member, 'b': _bytes, 'w': _law,
            '@': lambda index: fixed[_natural(index)],
            '#': lambda number: self.met[_natural(number)],
            'T': self._named_tuple, 'd': self._dict, 'o': partial(self._made, self.met),
            'v': partial(self._made, self.values)}

    def decode(self, content: Any) -> Any:
        """
        Return the value.

        :param content: anything that JSON can hold
        :raises ModelError: if it is not of this format
        """
        try:
            return self._read(content)
        except ModelError:
            raise
        except (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError,
                RecursionError, MemoryError) as error:
            raise ModelError(f'this is no value: {type(error).__name__}') from error

    def _read(self, content: Any) -> Any:
        kind, read = type(content), self._read
        if kind is np.ndarray:
            return content.copy()
        if kind is dict:
            return {name: item if (cls := type(item)) in _AS_IT_IS else
                    item.copy() if cls is np.ndarray else read(item)
                    for name, item in content.items()}
        if kind in _AS_IT_IS:
            return content
        container = _CONTAINERS.get(content[0])
        if container is None:
            return self._readers[content[0]](*content[1:])
        return container([item if type(item) in _AS_IT_IS else read(item)
                          for item in content[1:]])

    def _named_tuple(self, name: str, *items: Any) -> Any:
        cls = _found(name)
        if not issubclass(cls, tuple) or len(items) != len(getattr(cls, '_fields', ())):
            raise ModelError(f'{quoted(name)} is no tuple with that many names')
        return tuple.__new__(cls, map(self._read, items))

    def _dict(self, *items: Any) -> Any:
        return {self._read(key): self._read(item) for key, item in items}

    def _made(self, made: list[Any], name: str, members: dict[str, Any]) -> Any:
        cls, fields, shapes = _class(name)
        value: Any = object.__new__(cls)
        made.append(value)
        if members.keys() != fields:
            for key in members:
                if key.startswith('__') or key not in fields and hasattr(cls, key):
                    raise ModelError(
                        f'{quoted(name)} has no attribute {quoted(key)} that can be set')
            if not fields <= members.keys():
                raise ModelError(f'{quoted(name)} lacks attributes')
        restore = getattr(value, '__setstate__', vars(value).update)
        values = self._read(members)
        sizes: dict[Any, int] = {}
        for key, shape in shapes.items():
            if values[key] is not None and not _fits(values[key], shape, sizes):
                raise ModelError(f'{quoted(key)} of {quoted(name)} has another shape, or '
                                 'numbers of another kind')
        restore(values)
        return value


def to_json(plain: Any, sort_keys: bool = False) -> str:
    """Return plain data as JSON."""
    return json.dumps(plain, default=_as_json, separators=(',', ':'), sort_keys=sort_keys)


def _as_json(item: Any) -> Any:
    if isinstance(item, np.ndarray):
        return ['a', item.dtype.str, list(item.shape), _text(item.tobytes())]
    if isinstance(item, bytes):
        return ['b', _text(item)]
    raise TypeError(f'{type(item).__name__} is no plain data')


def _fits(array: Any, shape: Shape, sizes: dict[Any, int]) -> bool:
    """Return whether an array has a shape, and note the lengths that letters stand for."""
    if type(array) is not np.ndarray or array.dtype.char != shape[0] or (
            array.ndim != len(shape) - 1):
        return False
    for length, size in zip(array.shape, shape[1:]):
        if length != size and (
                type(size) is int or sizes.setdefault(size, length) != length):
            return False
    return True


def check_like(new: Any, old: Any, shapes: bool = False) -> None:
    """
    Check that attributes that came from outside are such as objects have now.

    :param new: attributes by name
    :param old: the present attributes
    :param shapes: whether arrays must have the same shapes, as compiled code reads them
    :raises ModelError: if one is missing, unknown or of another kind
    """
    if not isinstance(new, dict) or new.keys() != old.keys():
        raise ModelError('an object has other attributes than here')
    for name, value in new.items():
        now = old[name]
        kind = type(value)
        if kind is type(now):
            alike = kind is not np.ndarray or (
                value.dtype == now.dtype and value.ndim == now.ndim
                and (not shapes or value.shape == now.shape))
        else:
            numbers = (bool, int, float, np.generic)
            alike = (now is None or value is None
                     or isinstance(value, numbers) and isinstance(now, numbers)
                     or kind.__module__ == type(now).__module__)
        if not alike and kind is type(now):
            raise ModelError(f'{quoted(name)} has another shape, or numbers of another kind')
        if not alike:
            raise ModelError(f'{quoted(name)} is a {kind.__name__} and should be a '
                             f'{type(now).__name__}')


def _is_value(cls: type) -> bool:
    """Return whether objects of a class are of a frozen dataclass and compare by value."""
    parameters = getattr(cls, '__dataclass_params__', None)
    return parameters is not None and parameters.frozen and parameters.eq


def _is_data(cls: type) -> bool:
    return cls.__module__.startswith(_ROOMS) and not issubclass(
        cls, (enum.Enum, BaseException, tuple, list, dict, set, frozenset, deque))


def _name(cls: type) -> str:
    return f'{cls.__module__}:{cls.__qualname__}'


@lru_cache
def _found(name: str) -> Any:
    module, _, qualname = name.partition(':')
    if module.startswith(_ROOMS) and module in sys.modules:
        definition = getattr(sys.modules[module], qualname, None)
        if isinstance(definition, type) and definition.__module__ == module:
            return definition
    raise ModelError(f'there is no class {quoted(name)}')


@lru_cache
def _class(name: str) -> tuple[type, frozenset[str], Mapping[str, Shape]]:
    """Return a class by its name, and the attributes and shapes that its objects must have."""
    cls: type = _found(name)
    if not _is_data(cls):
        raise ModelError(f'{quoted(name)} holds no data')
    fields = dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()
    shapes = [vars(base).get('shapes', {}) for base in reversed(cls.__mro__)]
    return cls, frozenset(field.name for field in fields), {
        key: shape for of_class in shapes for key, shape in of_class.items()}


def _law(name: str) -> Law:
    try:
        return LAWS[str(name)]
    except UnknownNameError as error:
        raise ModelError(f'the state was saved with a law that is not here: {error}') from error


def _member(name: str, member: str) -> Any:
    module, _, qualname = name.partition(':')
    cls: Any = sys.modules[module]
    for part in qualname.split('.'):  # It may be of a class of a user.
        cls = vars(cls)[part]
    if not isinstance(cls, enum.EnumMeta):
        raise ModelError(f'{quoted(name)} is no enumeration')
    return cls[member]


def _array_of(dtype: str, shape: list[int], text: str) -> NDArray[Any]:
    return np.frombuffer(_bytes(text), _dtype(dtype)).reshape([*map(_natural, shape)]).copy()


def _number(dtype: str, content: Any) -> Any:
    (number,) = np.frombuffer(
        content if type(content) is bytes else _bytes(*content[1:]), _dtype(dtype))
    return number


def _dtype(text: str) -> np.dtype[Any]:
    kind = np.dtype(text) if isinstance(text, str) and len(text) <= 4 else None
    if kind is None or kind.kind not in KINDS or kind.itemsize > 8:
        raise ModelError('an array of what are no numbers')
    return kind


def _natural(number: Any) -> int:
    if type(number) is not int or number < 0:
        raise ModelError('a count or an index is no natural number')
    return number


def _text(content: bytes) -> str:
    return b64encode(content).decode()


def _bytes(text: str) -> bytes:
    return b64decode(text, validate=True)


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
    :ivar fixed: the objects that a state refers to by index, the same in every simulation of a
        world: models and frames of robots, which change with the model
    :ivar index_of: the index of each fixed object, by its ``id``
    """

    def __init__(self, roots: Iterable[object]) -> None:
        self._owners: list[Any] = []
        self._grippers: list[GripperModel] = []
        self.fixed: list[object] = []
        self._find(list(roots))
        self._number()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._number()  # In a copy, other objects are fixed.

    def _number(self) -> None:
        self.index_of = {id(item): index for index, item in enumerate(self.fixed)}

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
                self.fixed.append(item)
                if isinstance(item, GripperModel):
                    self._grippers.append(item)
            elif type(item).__module__.startswith(_CONTROL_ROOMS) and hasattr(item, '__dict__'):
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
    def count(self) -> int:
        """Number of objects of this package with a state, the first in :meth:`content`."""
        return len(self._owners)

    @cached_property
    def layout(self) -> str:
        """The objects with a state, what they remember, and the models that it refers to."""
        return ' '.join([*(f'{type(owner).__qualname__}({",".join(owner.remembered)})'
                           for owner in self._owners),
                         *(type(item).__qualname__ for item in self.fixed
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


@dataclasses.dataclass(frozen=True)
class SimulationState:
    """
    Everything that the future of a simulation depends on, but its model and commands to come.

    It can be pickled, and restored in another process in a simulation of an equal world. Like
    every pickle, it must come from a source that you trust.

    :ivar versions: of manip_sim and MuJoCo
    :ivar model: signature of the compiled model
    :ivar robots: names of the robots
    :ivar physics: what MuJoCo integrates, and its solvers start from
    :ivar computed_from: the same when the present forces were computed
    :ivar gains: what control has changed in the model, by field
    :ivar control: setpoints, commands, grippers, tare, filters and settings, and of each robot's
        sensors noise and measurements that have not arrived, as plain data
    :ivar start: of the joints at the next reset, by name [rad or m]
    :ivar step_count: physics steps since construction
    :ivar control_steps: physics steps since the last reset
    :ivar diverged: why the physics is on hold, or None
    :ivar drawn: the values drawn for the episode, by name
    :ivar seed: that the episode was drawn from
    :ivar layout: of what :attr:`control` refers to
    :ivar keyframe: that joints start from, and whether the next reset is the first to use it
    :ivar layout_version: version of this layout; 1 were those whose control was pickled
    """

    versions: str
    model: int
    robots: tuple[str, ...]
    physics: bytes
    computed_from: bytes
    gains: Mapping[str, bytes]
    control: list[Any]
    start: Mapping[str, float]
    step_count: int
    control_steps: int
    diverged: str | None
    drawn: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    seed: int = 0
    layout: str = ''
    keyframe: tuple[str, bool] = ('', False)
    layout_version: int = 1


class SavedStates:
    """
    Content of the states of a simulation besides commands that wait, and their comparison.

    :param physics: of the world
    :param clock: of the simulation
    :param steps: that the physics takes
    :param start: of the episodes
    :param efforts: of the actuators
    :param robots: the present robots, by name
    """

    def __init__(self, physics: Physics, clock: Clock, steps: PhysicsSteps, start: EpisodeStart,
                 efforts: ActuatorEfforts, robots: Mapping[str, SimulatedRobot]) -> None:
        self._physics, self._clock, self._steps, self._start = physics, clock, steps, start
        self._efforts, self._robots = efforts, robots
        self._control: ControlState | None = self._find_control()
        physics.on_change(self.sync_robots)

    def sync_robots(self) -> None:
        """Find all objects with a state again, as robots or the model changed, when asked for."""
        self._control = None

    def _find_control(self) -> ControlState:
        return ControlState([self._efforts, *self._robots.values()])

    @property
    def control(self) -> ControlState:
        """The state of control, of the present model."""
        if self._control is None:
            self._control = self._find_control()
        return self._control

    def save(self, diverged: str | None) -> SimulationState:
        """
        Return the present state.

        :param diverged: why the physics is on hold, or None
        """
        start, steps = self._start, self._steps
        return SimulationState(
            versions=_versions(), model=self._physics.model.signature, robots=tuple(self._robots),
            physics=steps.state().tobytes(), computed_from=steps.computed_from.tobytes(),
            gains=gains(self._physics.model), control=self.encoded(Encoder(self.control.index_of)),
            start=dict(start.positions), step_count=self._clock.step_count,
            control_steps=self._clock.control_steps, diverged=diverged,
            drawn=start.randomized.drawn, seed=start.seed, layout=self.control.layout,
            keyframe=start.settings, layout_version=LAYOUT_VERSION)

    def encoded(self, encoder: Encoder) -> list[Any]:
        """Return what objects with a state remember, grippers and sensors as plain data."""
        return [*self.control.encoded(encoder), *(
            encoder.encode(robot.sensing.save()) for robot in self._robots.values())]

    def decoded(self, state: SimulationState) -> list[dict[str, Any]]:
        """
        Return what :meth:`encoded` made the plain data of that a state contains.

        :param state: one that :meth:`check` accepts
        :raises ModelError: if its ``control`` cannot have been saved by this version
        """
        decoder, model = Decoder(self.control.fixed), self._physics.model
        present = [*self.control.content(), *(
            robot.sensing.save() for robot in self._robots.values())]
        if len(state.control) != len(present):
            raise ModelError('control consists of other parts here')
        content = [decoder.decode(values) for values in state.control]
        for number, (values, now) in enumerate(zip(content, present)):
            check_like(values, now, shapes=number < self.control.count)
        check_frames(decoder, model)
        return content

    def check(self, state: SimulationState) -> None:
        """
        Check that a state can be restored.

        :param state: from :meth:`save`
        :raises ModelError: if it belongs to another world, another set of objects, or another
            version of manip_sim or MuJoCo
        """
        if not isinstance(state, SimulationState):
            raise ModelError(f'expected a state of save(), got {state!r:.60}')
        if state.versions != _versions():
            raise ModelError(f'the state was saved by {one_line(state.versions, 80)}, this is '
                             f'{_versions()}')
        if state.layout_version != LAYOUT_VERSION:
            raise ModelError(f'the state has version {state.layout_version} of the layout of '
                             f'states, and this manip_sim has version {LAYOUT_VERSION}')
        if state.robots != tuple(self._robots):
            raise ModelError(f'the state was saved with the robots '
                             f'{one_line(", ".join(map(str, state.robots)), 200)}, now there are '
                             f'{", ".join(self._robots)}')
        if (state.model != self._physics.model.signature
                or {len(state.physics), len(state.computed_from)}
                != {self._steps.computed_from.nbytes}
                or _sizes(state.gains) != _sizes(gains(self._physics.model))):
            raise ModelError('the state was saved in a simulation of another world, or with other '
                             'objects in it')
        if state.layout != self.control.layout:
            raise ModelError('objects have come or gone since the state was saved')

    def replace(self, state: SimulationState, content: list[dict[str, Any]]) -> None:
        """
        Continue from a state; what its episode has drawn is there already.

        :param state: one that :meth:`check` accepts
        :param content: of it, as :meth:`decoded` returns it
        """
        model = self._physics.model
        self._clock.step_count, self._clock.control_steps = state.step_count, state.control_steps
        self._start.positions, self._start.seed = dict(state.start), state.seed
        self._start.settings = state.keyframe
        for name, numbers in state.gains.items():
            array = getattr(model, name)
            array.flat[:] = np.frombuffer(numbers, array.dtype)
        self.control.replace(content)
        # Commands may have changed controls since the present forces were computed.
        self._steps.compute_from(np.frombuffer(state.computed_from))
        mujoco.mj_setState(model, self._physics.data, np.frombuffer(state.physics), PHYSICS)
        robots = self._robots.values()
        for robot, measured in zip(robots, content[len(content) - len(robots):]):
            robot.sensing.restore(measured)

    def digest(self) -> str:
        """Return a digest of the present state, with the release of MuJoCo."""
        digest = hashlib.sha256(self._steps.state().tobytes())
        for name, content in gains(self._physics.model).items():
            digest.update(name.encode() + content)
        encoder = Encoder(self.control.index_of, digest=True)
        plain = [*self.control.encoded(encoder), *(encoder.encode(robot.sensing.digested())
                 for robot in self._robots.values()), encoder.encode(self._start.randomized.drawn)]
        digest.update(to_json(plain, sort_keys=True).encode())
        return f'mujoco-{mujoco.mj_versionString()}:{digest.hexdigest()}'


def gains(model: mujoco.MjModel) -> dict[str, bytes]:
    """Return what control changes in a model, by field."""
    return {name: getattr(model, name).tobytes() for name in _GAINS}


def check_frames(decoder: Decoder, model: mujoco.MjModel) -> None:
    """
    Check frames that were read, as MuJoCo does not.

    :raises ModelError: if there is no such body or site
    """
    for frame in decoder.values:
        if isinstance(frame, Frame) and not (
                frame.body in range(model.nbody)
                and (frame.site is None or frame.site in range(model.nsite))):
            raise ModelError('a frame of no body or site')


def _sizes(contents: Mapping[str, bytes]) -> dict[str, int]:
    return {name: len(content) for name, content in contents.items()}


def _versions() -> str:
    return f'manip_sim {package_version()} with MuJoCo {mujoco.mj_versionString()}'
