# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The start of episodes: positions of joints, and values drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import mujoco
import numpy as np

from manip_sim.control.surroundings import Surroundings
from manip_sim.models.world import World
from manip_sim.physics.parts import Part
from manip_sim.physics.physics import Physics
from manip_sim.physics.state_dependent_terms import Belts, FloatingBases
from manip_sim.sensing.robot_sensing import RobotSensing
from manip_sim.simulation.drawn_randomization import DomainRandomizer, Sample
from manip_sim.simulation.robot_spawning import RobotsPlan

#: Duration of the simulation in which coupled joints settle at their start [s].
_SETTLE_S = 0.5


def _settle(model: mujoco.MjModel, data: mujoco.MjData, disabled: int = 0) -> None:
    """Let couplings move their joints, without gravity; ``disabled`` are further flags."""
    gravity, flags = model.opt.gravity.copy(), model.opt.disableflags
    model.opt.gravity[:] = 0.0
    # Only the couplings matter here, not what a gripper overlaps.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | disabled
    mujoco.mj_step(model, data, round(_SETTLE_S / model.opt.timestep))
    model.opt.gravity[:], model.opt.disableflags = gravity, flags


def start_without_control(model: mujoco.MjModel, positions: Mapping[str, float]
                          ) -> mujoco.MjData:
    """
    Return the state at a start, at rest, with coupled joints where their couplings put them.

    It needs no controllers, so it is for parts alone and for robots that cannot be controlled.

    :param model: the compiled ``mujoco.MjModel``
    :param positions: of joints, by name [rad or m]; others are where the model has them
    """
    data = mujoco.MjData(model)
    for joint, position in positions.items():
        data.joint(joint).qpos = position
    if model.neq:
        _settle(model, data, int(mujoco.mjtDisableBit.mjDSBL_ACTUATION))
        settled = data.qpos.copy()
        mujoco.mj_resetData(model, data)
        data.qpos[:] = settled
    mujoco.mj_forward(model, data)
    return data


class EpisodeStart:
    """
    The start to which resets return.

    :param world: that has it
    :param physics: of the world
    :param surroundings: which are held where they start
    :param floating_bases: of the robots
    :param belts: which run at their speed at the start
    :ivar positions: of joints, by name [rad or m]
    :ivar seed: that the present episode was drawn from
    :ivar randomized: the draws for the present episode
    """

    def __init__(self, world: World, physics: Physics, surroundings: Surroundings,
                 floating_bases: FloatingBases, belts: Belts) -> None:
        self.world, self._physics, self._belts = world, physics, belts
        self._surroundings, self._floating_bases = surroundings, floating_bases
        self.positions = world.init_qpos()
        self.seed = world.seed
        self.randomized = DomainRandomizer(None, physics, {})
        self._keyframe, self._changes = world.keyframe, False
        #: Keyframe and draws, and where couplings then put the joints of grippers.
        self._settled: tuple[str, Sample, dict[str, float]] | None = None

    def randomize(self, sensing: Mapping[str, RobotSensing]) -> None:
        """
        Let episodes draw what the ``randomization`` of the world says.

        :param sensing: of each robot, by name
        """
        self.randomized = DomainRandomizer(
            self.world.randomization, self._physics, sensing,
            [name for robot in self.world.robots for name, law in robot.friction_laws.items()
             if np.isfinite(law.stribeck_velocity)])

    @property
    def keyframe(self) -> str:
        """
        Keyframe of a file that joints start from, from the next reset on; empty: none.

        :raises UnknownNameError: if it is set to one that no part of the world has
        """
        return self._keyframe

    @keyframe.setter
    def keyframe(self, name: str) -> None:
        self._keyframe, self._changes = self.world.checked_keyframe(name), True

    @property
    def settings(self) -> tuple[str, bool]:
        """The keyframe, and whether the next reset uses another one than the last."""
        return self._keyframe, self._changes

    @settings.setter
    def settings(self, settings: tuple[str, bool]) -> None:
        self.keyframe, self._changes = settings

    def draw(self, seed: int | None) -> dict[str, float] | None:
        """
        Return where joints are at the next reset, by name [rad or m]; None: where they were.

        :param seed: of their noise; None keeps the present one
        :raises ModelError: if the seed is not a whole number from 0
        """
        if seed is None and not self._changes:
            return None
        return self.world.init_qpos(self.seed if seed is None else seed, self._keyframe)

    def begin(self, seed: int, positions: dict[str, float] | None) -> None:
        """
        Begin an episode at drawn positions.

        :param seed: of the episode
        :param positions: as :meth:`draw` has returned
        """
        self.seed, self._changes = seed, False
        if positions is not None:
            self.positions = positions

    def change_robots(self, plan: RobotsPlan) -> None:
        """Take over where the robots start that come, and forget those that go."""
        self.positions = {joint: position for joint, position in
                          {**self.positions, **plan.start}.items() if joint in plan.joints}
        self._settled = None

    def place(self) -> None:
        """Put all joints, objects and the surroundings to the start."""
        model, data = self._physics.model, self._physics.data
        mujoco.mj_resetData(model, data)
        for joint, position in self.positions.items():
            data.joint(joint).qpos[0] = position
            self._surroundings.hold(joint, position)
        self._belts.begin(data)
        self.randomized.place(data)
        mujoco.mj_forward(model, data)
        self._surroundings.hold_actuators()
        self._floating_bases.apply()

    def settle(self, grippers: Iterable[Part], reset: Callable[[], None]) -> None:
        """
        Make the start of grippers satisfy their couplings.

        A declared start may violate them; great forces would correct it in the first steps. The
        noise of the start does not move grippers, so the start without it is simulated, and again
        only when the keyframe, the draws or the robots have changed.

        :param reset: brings all to the start, at rest
        """
        model, data = self._physics.model, self._physics.data
        if not model.neq + model.ntendon:
            return
        keyframe, drawn = self._keyframe, self.randomized.drawn
        if self._settled is None or self._settled[0] != keyframe or self._settled[1] is not drawn:
            positions, self.positions = self.positions, self.world.exact_qpos(keyframe)
            reset()
            _settle(model, data)
            self.positions = positions
            self._settled = keyframe, drawn, {
                joint: position for part in grippers for joint, position in zip(
                    part.joints, data.qpos[part.qpos_addresses].tolist())}
        self.positions.update(self._settled[2])
