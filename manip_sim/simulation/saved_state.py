# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""States of a simulation between two control periods: saved, restored, compared by a digest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
import enum
from functools import cached_property
import hashlib
from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.models.grippers import GripperModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.physics import PHYSICS, Physics
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.physics.robot_frames import Frame
from manip_sim.quoting import one_line
from manip_sim.resources import package_version
from manip_sim.simulation.episode_start import EpisodeStart
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.serialization import check_like, Decoder, Encoder, KINDS, to_json

#: Modules of the classes whose objects may have a state, or others that have one.
_CONTROL_ROOMS = ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.simulation.')
#: Types of values without identity, which cannot change.
_VALUES = (type(None), bool, int, float, str, bytes, enum.Enum, np.generic)
#: Version of the layout of states; 1 were those whose control was pickled.
LAYOUT_VERSION = 3
#: Numbers of a model that control changes: gains of servos and of grippers.
_GAINS = ('actuator_gainprm', 'actuator_biasprm', 'actuator_forcerange', 'actuator_forcelimited')


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
