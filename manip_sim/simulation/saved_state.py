# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""States of a simulation between two control periods: saved, restored, compared by a digest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import hashlib
import pickle
from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import ModelError
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.physics import Physics, PHYSICS
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.resources import package_version
from manip_sim.simulation.control_state import Content, ControlState
from manip_sim.simulation.episode_start import EpisodeStart
from manip_sim.simulation.robot import SimulatedRobot

#: Numbers of a model that control changes: gains of servos and of grippers.
_GAINS = ('actuator_gainprm', 'actuator_biasprm', 'actuator_forcerange', 'actuator_forcelimited')


@dataclass(frozen=True)
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
    :ivar control: setpoints, commands, grippers, tare, filters and settings, pickled
    :ivar start: of the joints at the next reset, by name [rad or m]
    :ivar step_count: physics steps since construction
    :ivar control_steps: physics steps since the last reset
    :ivar diverged: why the physics is on hold, or None
    :ivar sensing: of each robot, noise and measurements that have not arrived, pickled
    :ivar drawn: the values drawn for the episode, by name
    :ivar seed: that the episode was drawn from
    :ivar layout: of what :attr:`control` refers to
    :ivar keyframe: that joints start from, and whether the next reset is the first to use it
    """

    versions: str
    model: int
    robots: tuple[str, ...]
    physics: bytes
    computed_from: bytes
    gains: Mapping[str, bytes]
    control: bytes
    start: Mapping[str, float]
    step_count: int
    control_steps: int
    diverged: str | None
    sensing: bytes
    drawn: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    layout: str = ''
    keyframe: tuple[str, bool] = ('', False)


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
            gains=gains(self._physics.model), control=self.control.save(),
            start=dict(start.positions), step_count=self._clock.step_count,
            control_steps=self._clock.control_steps, diverged=diverged,
            sensing=pickle.dumps([robot.sensing.save() for robot in self._robots.values()]),
            drawn=start.randomized.drawn, seed=start.seed, layout=self.control.layout,
            keyframe=start.settings)

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
            raise ModelError(f'the state was saved by {state.versions}, this is {_versions()}')
        if state.robots != tuple(self._robots):
            raise ModelError(f'the state was saved with the robots {", ".join(state.robots)}, now '
                             f'there are {", ".join(self._robots)}')
        if (state.model != self._physics.model.signature
                or len(state.physics) != self._steps.computed_from.nbytes):
            raise ModelError('the state was saved in a simulation of another world, or with other '
                             'objects in it')
        if state.layout != self.control.layout:
            raise ModelError('objects have come or gone since the state was saved')

    def replace(self, state: SimulationState, control: Content, sensing: Any) -> None:
        """
        Continue from a state; what its episode has drawn is there already.

        :param state: one that :meth:`check` accepts
        :param control: what its ``control`` stands for
        :param sensing: what its ``sensing`` stands for
        """
        model = self._physics.model
        self._clock.step_count, self._clock.control_steps = state.step_count, state.control_steps
        self._start.positions, self._start.seed = dict(state.start), state.seed
        self._start.settings = state.keyframe
        for name, content in state.gains.items():
            array = getattr(model, name)
            array.flat[:] = np.frombuffer(content, array.dtype)
        self.control.replace(control)
        # Commands may have changed controls since the present forces were computed.
        self._steps.compute_from(np.frombuffer(state.computed_from))
        mujoco.mj_setState(model, self._physics.data, np.frombuffer(state.physics), PHYSICS)
        for robot, measured in zip(self._robots.values(), sensing):
            robot.sensing.restore(measured)

    def digest(self) -> str:
        """Return a digest of the present state, with the release of MuJoCo."""
        digest = hashlib.sha256(self._steps.state().tobytes())
        for name, content in gains(self._physics.model).items():
            digest.update(name.encode() + content)
        for content in self.control.encoded():
            digest.update(b'%d:' % len(content) + content)
        for robot in self._robots.values():
            digest.update(robot.sensing.encoded())
        if self._start.randomized.drawn:
            digest.update(repr(sorted(self._start.randomized.drawn.items())).encode())
        return f'mujoco-{mujoco.mj_versionString()}:{digest.hexdigest()}'


def gains(model: mujoco.MjModel) -> dict[str, bytes]:
    """Return what control changes in a model, by field."""
    return {name: getattr(model, name).tobytes() for name in _GAINS}


def _versions() -> str:
    return f'manip_sim {package_version()} with MuJoCo {mujoco.mj_versionString()}'
