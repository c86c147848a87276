# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The physics of one world: advance it, detect divergence, reset it."""

from __future__ import annotations

from collections.abc import Iterator
import hashlib
import pickle
from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import DivergenceError, ModelError
from manip_sim.models.robots import RobotModel
from manip_sim.models.world import World
from manip_sim.resources import package_version
from manip_sim.sensing.lidars import Lidars
from manip_sim.simulation.cartesian.frames import Frame
from manip_sim.simulation.cartesian.parser import CartesianParser
from manip_sim.simulation.cartesian.pose_stream import PoseStream
from manip_sim.simulation.cartesian.targets import Target
from manip_sim.simulation.clock import Clock
from manip_sim.simulation.command_parser import CommandParser
from manip_sim.simulation.control_period import ControlPeriods, Interval
from manip_sim.simulation.efforts import ActuatorEfforts
from manip_sim.simulation.entities import Entities
from manip_sim.simulation.free_base import FreeRoots
from manip_sim.simulation.measured_instruments import MeasuredInstruments
from manip_sim.simulation.message_clock import MessageClock, MessageClocks
from manip_sim.simulation.physics import Physics
from manip_sim.simulation.physics_steps import PhysicsSteps
from manip_sim.simulation.present_robots import PresentRobots
from manip_sim.simulation.point_streams import PointStreams
from manip_sim.simulation.pulls import Pulls
from manip_sim.simulation.randomized import Drawn, Randomized
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.robot_spawning import (
    actuators_of, compose_base, plan_with_robot, plan_without_robot, RobotsPlan)
from manip_sim.simulation.saved_state import (
    Content, ControlState, gains, PHYSICS, set_gains, SimulationState)
from manip_sim.simulation.spawning import plan_world, WorldPlan
from manip_sim.simulation.start_check import check_start
from manip_sim.simulation.streams import RampEstimator, StreamEstimator, WaitingGoals
from manip_sim.simulation.surroundings import Surroundings
from manip_sim.simulation.velocity_stream import VelocityStream

#: What commands bring along: it is a part of states, and not there at construction.
_PASSING = (Frame, MessageClock, MessageClocks, PointStreams, PoseStream, RampEstimator,
            StreamEstimator, Target, VelocityStream, WaitingGoals)
#: How long the coupled joints of grippers are simulated so that they settle at their start [s].
_SETTLE_S = 0.5


class Simulation:
    """
    The physics of a world, the robots and the objects in it.

    Time is a count of steps; nothing here waits or reads a clock. Only one thread at a time may
    use it. Call ``mj_forward`` after changing :attr:`model`; changed positions and velocities in
    :attr:`data` are detected by the next control period. To read or save what follows from them
    before that, call :meth:`forward`.

    :param world: an arena with robots
    :param visual: keep the geoms that cannot collide, for rendering; they slow down each step
    :ivar physics: the only holder of model and data
    :ivar robots: the robots, with their commands and states, by name
    :ivar efforts: of the actuators in the last physics step
    :ivar instruments: what is measured of the sensors of the model
    :ivar sensors: values of all of these sensors, by name
    :ivar lidars: the lidars, by name
    :ivar entities: reads poses and twists of robots and free bodies, and places free bodies
    :ivar surroundings: mocap bodies, joints of the arena, and actuators of no part
    :ivar pulls: springs that pull bodies
    :ivar start_defects: what is wrong with the start, a sentence for each defect
    :ivar diverged: why the physics is on hold, or None
    :ivar randomized: what was drawn for the present episode, where the world has
        ``randomization``
    :ivar seed: that the present episode was drawn from
    """

    def __init__(self, world: World, visual: bool = False) -> None:
        self.physics = Physics(plan_world(
            compose_base(world, visual), tuple(world.objects), world.name))
        self.surroundings = Surroundings(self.physics, world.arena, actuators_of(world))
        # Report divergence instead of letting MuJoCo reset silently.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.diverged: str | None = None
        self._world = world
        self._keyframe = world.keyframe
        self._changes_start = False
        self._start = world.init_qpos()
        self._clock = Clock(round(self.model.opt.timestep * 1e9))
        self._timestep_s = float(self.model.opt.timestep)
        self._free_roots = FreeRoots(self.physics, [robot.root_body for robot in world.robots])
        self.seed = world.seed
        self.randomized = Randomized(None, self.physics, {})
        self._to_start()
        self.efforts = ActuatorEfforts(self.physics)
        self._present = PresentRobots(self.physics, self.efforts, self._clock, world.robots)
        self.robots = self._present.by_name
        self._steps = PhysicsSteps(
            self.physics, self._clock, self.efforts, self._present.tools, self._present.laws)
        self.pulls = Pulls(self.physics, self._clock)
        self._periods = ControlPeriods(
            self._steps, [*self.robots.values()], self._free_roots, self._timestep_s)
        self.instruments = MeasuredInstruments(self.physics, self.robots)
        self.sensors = self.instruments.sensors
        self.physics.on_change(self._look_at_model)
        self.lidars = Lidars(
            self.physics, world.lidars if self.robots else (),
            lambda body: self.instruments.sensing_of(int(self.model.body(body).id)))
        self.randomized = Randomized(
            world.randomization, self.physics,
            {robot.name: robot.sensing for robot in self.robots.values()},
            [name for robot in world.robots for name, law in robot.velocity_laws.items()
             if np.isfinite(law.stribeck_velocity)])
        if self.randomized.draws:
            self._randomize(world.seed, None)
        self._settle_linkages()
        self._reset(world.seed)
        self.start_defects = check_start(
            self.model, self.data, self._free_roots.roots)

    def _look_at_model(self) -> None:
        spawned = set(self.spawned_robots)
        self.entities = Entities(self.model, {
            name if name in spawned else robot.robot_model.root_body: robot.frame_body
            for name, robot in self.robots.items()},
            [robot.robot_model.root_body for robot in self.robots.values()])
        self._control = ControlState(
            [self.efforts, *self.robots.values()],
            (Clock, Physics, CartesianParser, CommandParser), _PASSING)

    def change_objects(self, plan: WorldPlan) -> None:
        """
        Change the objects; everything else stays as it is, commands included.

        :param plan: made from :attr:`plan`, by ``plan_with`` or ``plan_without``
        """
        _ = self.efforts.values  # They belong to a step of the model before.
        known = self.surroundings.other_actuators
        self.physics.change(plan)
        if self.surroundings.hold_actuators(known):
            mujoco.mj_forward(self.model, self.data)

    def spawn_robot(self, robot: RobotModel) -> SimulatedRobot:
        """
        Add a robot to the running world, at rest at its start; everything else stays as it is.

        Its name is that of the entity too. A reset keeps it and brings it to its start, as it does
        with spawned objects. It takes part in saved states: they can be restored only while there
        are the same robots.

        :param robot: with all that is mounted on it; it stands where ``set_base_xpos`` places
            it, else where the arena places a robot
        :raises ModelError: if a name is taken already, there are too many robots, or MuJoCo cannot
            compile the world; then nothing changes
        """
        self.change_robots(plan_with_robot(self, robot))
        return self.robots[robot.name_in_world]

    def delete_robot(self, name: str) -> None:
        """
        Remove a robot that :meth:`spawn_robot` has added; its commands are aborted.

        :param name: of the robot, such as a key of :attr:`robots`
        :raises ModelError: if the robot was there at the start
        :raises UnknownNameError: if there is no such robot
        """
        self.change_robots(plan_without_robot(self, name))

    def change_robots(self, plan: RobotsPlan) -> None:
        """
        Change the robots; everything else stays as it is, commands included.

        :param plan: made by ``plan_with_robot`` or ``plan_without_robot`` from the present state
            of this simulation
        """
        there = {robot.name_in_world for robot in plan.world.robots}
        for name in self.robots.keys() - there:
            self._present.delete(name)
        self._world = plan.world
        self._free_roots.roots = tuple(robot.root_body for robot in plan.world.robots)
        self.surroundings.of_parts = set(actuators_of(plan.world))
        self._look_at_robots()
        self.change_objects(plan.plan)
        self._start = {joint: position for joint, position in
                       {**self._start, **plan.start}.items() if joint in plan.joints}
        for robot in plan.world.robots[len(self.robots):]:
            self._present.begin(robot, plan.start, self.seed)
            self._free_roots.apply()
            self._look_at_robots()
            self.instruments.look_at_model()
            self._look_at_model()
            self._steps.compute()
            self._steps.compute_anew()

    def _look_at_robots(self) -> None:
        self._steps.look_at_robots(self._present.tools, self._present.laws)
        self._periods.robots = tuple(self.robots.values())

    @property
    def world(self) -> World:
        """The robots, the arena and the objects that there are now; a copy."""
        return self._world.with_objects(self.plan.objects)

    @property
    def spawned_robots(self) -> list[str]:
        """Names of the robots that came while the simulation ran."""
        return self._present.spawned

    @property
    def start(self) -> dict[str, float]:
        """Positions of joints at the next reset, by name [rad or m], a copy."""
        return dict(self._start)

    @property
    def plan(self) -> WorldPlan:
        """What the world was compiled from."""
        return self.physics.plan

    @property
    def model(self) -> mujoco.MjModel:
        """The ``mujoco.MjModel``."""
        return self.physics.model

    @property
    def data(self) -> mujoco.MjData:
        """The ``mujoco.MjData``."""
        return self.physics.data

    @property
    def robot(self) -> SimulatedRobot:
        """
        The only robot.

        :raises ModelError: if there are several, or none
        """
        if len(self.robots) != 1:
            raise ModelError('expected one robot, but the world has '
                             + (', '.join(self.robots) or 'none'))
        return next(iter(self.robots.values()))

    def _to_start(self) -> None:
        mujoco.mj_resetData(self.model, self.data)
        for joint, position in self._start.items():
            self.data.joint(joint).qpos[0] = position
            self.surroundings.hold(joint, position)
        self.randomized.place(self.data)
        mujoco.mj_forward(self.model, self.data)
        self.surroundings.hold_actuators()
        self._free_roots.apply()

    def _settle_linkages(self) -> None:
        """
        Make the start of grippers with coupled joints satisfy the couplings.

        A declared start may violate them; great forces would correct it in the first steps.
        """
        self._reset()
        if not self.model.neq + self.model.ntendon:
            return
        gravity, flags = self.model.opt.gravity.copy(), self.model.opt.disableflags
        self.model.opt.gravity[:] = 0.0
        # Only the couplings matter here, not what a gripper overlaps.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        mujoco.mj_step(self.model, self.data, round(_SETTLE_S / self.timestep_s))
        self.model.opt.gravity[:], self.model.opt.disableflags = gravity, flags
        for robot in self.robots.values():
            for gripper in robot.grippers.values():
                part = gripper.part
                self._start.update(zip(part.joints, self.data.qpos[part.qpos_addresses].tolist()))

    @property
    def timestep_s(self) -> float:
        """Length of a physics step [s]."""
        return self._timestep_s

    @property
    def time_s(self) -> float:
        """Simulation time [s]."""
        return self.time_ns * 1e-9

    @property
    def time_ns(self) -> int:
        """Simulation time: steps times the timestep [ns]."""
        return self._clock.time_ns

    @property
    def step_count(self) -> int:
        """Physics steps since construction; a reset does not change it, an assignment does."""
        return self._clock.step_count

    @step_count.setter
    def step_count(self, count: int) -> None:
        self._clock.step_count = count

    @property
    def idle(self) -> bool:
        """Whether nothing but physics happens until the next command."""
        return (self.diverged is None and not self.pulls
                and self._steps.resumes() and self._periods.rest
                and not any([robot.sensing.settings.measures for robot in self.robots.values()]))

    def advance(self, steps: int) -> None:
        """
        Run one control period; afterwards all of the data belongs to the new instant.

        :param steps: number of physics steps
        :raises DivergenceError: if the physics diverges, or has diverged and was not reset; the
            last good state is held, at rest
        """
        for interval in self.period(steps):
            interval.run()

    def period(self, steps: int) -> Iterator[Interval]:
        """
        Run one control period as :meth:`advance`, but leave its intervals to the caller.

        Each one has to be run before the next one is asked for.

        :param steps: number of physics steps
        :raises DivergenceError: as :meth:`advance`
        """
        self._check_not_diverged()
        if self.pulls:
            self.pulls.apply(steps * self._timestep_s)
        yield from self._periods.intervals(steps)
        reason = self._steps.divergence.reason()
        if reason is None:
            for tool in self._steps.tools:
                tool.end_period(self.data, steps, steps * self._timestep_s)
            for robot in self.robots.values():
                if robot.sensing.settings.measures:
                    robot.end_period(steps * self._timestep_s)
            self.pulls.release()
        else:
            self._hold(reason)

    def _hold(self, reason: str) -> None:
        self.diverged = f'the physics diverged at {self.time_ns / 1e9:.3f} s: {reason}'
        self._steps.divergence.hold()
        self.pulls.release()
        self._steps.compute()
        self.efforts.restart()
        for tool in self._steps.tools:
            tool.restart(self.data)
        self._check_not_diverged()

    def _check_not_diverged(self) -> None:
        if self.diverged is not None:
            raise DivergenceError(f'{self.diverged}; its last good state is held until reset()')

    def advance_idle(self, steps: int, periods: int) -> None:
        """
        Run several control periods at once; only while :attr:`idle`.

        The result is that of as many calls of :meth:`advance`, to the last bit.

        :param steps: number of physics steps of a period
        :param periods: number of control periods
        :raises DivergenceError: if the physics diverges
        """
        physics = self._steps
        if physics.stays_untouched and all([tool.settled for tool in physics.tools]):
            physics.begin()
            physics.run_untouched(steps * periods)
            if physics.was_untouched and physics.divergence.reason() is None:
                return
            # Run one by one, the periods show in which of them that happened.
            physics.undo()
        for _ in range(periods):
            self.advance(steps)

    @property
    def keyframe(self) -> str:
        """
        Keyframe of a file that joints start from, from the next reset on; empty: none.

        :raises UnknownNameError: if it is set to one that no part of the world has
        """
        return self._keyframe

    @keyframe.setter
    def keyframe(self, name: str) -> None:
        self._keyframe = self._world.checked_keyframe(name)
        self._changes_start = True

    @property
    def start_settings(self) -> tuple[str, bool]:
        """The keyframe, and whether the next reset uses another one than the last."""
        return self._keyframe, self._changes_start

    @start_settings.setter
    def start_settings(self, settings: tuple[str, bool]) -> None:
        keyframe, changes = settings
        self._keyframe, self._changes_start = self._world.checked_keyframe(keyframe), changes

    def reset(self, seed: int | None = None, drawn: Drawn | None = None) -> None:
        """
        Reset everything to the start and abort all commands; time goes on.

        Joints, grippers and their action state, free objects and tare are as after construction;
        control modes stay.

        :param seed: draws the start anew, as at construction with this seed, where the world has
            ``initialization_noise``, and the noise of sensors, and what the ``randomization`` of
            the world draws; None keeps all
        :param drawn: by name, in place of what ``randomization`` would draw, such as
            ``randomized.drawn`` of an earlier episode; None lets it draw
        :raises ModelError: if the seed is no whole number from 0, or something cannot be drawn;
            then nothing changes
        """
        settles = seed is not None or self._changes_start
        own = self.seed if seed is None else seed
        start = self._world.init_qpos(own, self._keyframe) if settles else self._start
        if drawn is not None or (seed is not None and self.randomized.draws):
            self._randomize(own, drawn)
        self._start, self.seed, self._changes_start = start, own, False
        if settles:
            self._settle_linkages()
        self._reset(seed)

    def _randomize(self, seed: int, drawn: Drawn | None) -> None:
        """Draw what differs between episodes, or take what was drawn."""
        if drawn is None:
            self.randomized.draw(seed)
        else:
            self.randomized.set(drawn)
        self._steps.look_at_joints()
        for robot in self.robots.values():
            robot.joints.look_at_joints()

    def _reset(self, seed: int | None = None) -> None:
        self._to_start()
        self._clock.control_steps = 0
        for robot in self.robots.values():
            robot.reset()
        self.diverged = None
        self.pulls.end()
        self._steps.contacts_change = False
        self._steps.compute()
        self._steps.compute_anew()
        self.efforts.restart()
        for tool in self._steps.tools:
            tool.reset(self.data)
        for robot in self.robots.values():
            robot.sensing.reset(seed)

    def forward(self) -> None:
        """Compute all of the present instant anew, after :attr:`data` was changed by hand."""
        self._steps.compute()

    # ------------------------------------------------------------------ saved states

    def save(self) -> SimulationState:
        """
        Return the present state: physics, setpoints, commands, grippers, tare and settings.

        Call it between control periods. Edits of :attr:`model` are not part of it.
        """
        return SimulationState(
            versions=self._versions(), model=self.model.signature, robots=tuple(self.robots),
            physics=self._steps.state().tobytes(),
            computed_from=self._steps.computed_from.tobytes(), gains=gains(self.model),
            control=self._control.save(), start=dict(self._start),
            step_count=self._clock.step_count, control_steps=self._clock.control_steps,
            contacts_change=self._steps.contacts_change, diverged=self.diverged,
            sensing=pickle.dumps([robot.sensing.save() for robot in self.robots.values()]),
            drawn=self.randomized.drawn, seed=self.seed, layout=self._control.layout)

    def restore(self, state: SimulationState) -> None:
        """
        Continue from a state, to the last bit; time, too, is what it was.

        Commands that run are aborted; those of the state go on, with handles of their own.

        :param state: of this simulation, or of one of an equal world in any process
        :raises ModelError: if it belongs to another world, another set of objects, or another
            version of manip_sim or MuJoCo; then nothing changes
        """
        self.check_restorable(state)
        self.continue_from(state, self._control.loaded(state.control), pickle.loads(state.sensing))

    def continue_from(self, state: SimulationState, control: Content, sensing: Any) -> None:
        """
        Continue from a state whose pickled parts are given as objects.

        :param state: one that :meth:`check_restorable` accepts
        :param control: what its ``control`` stands for
        :param sensing: what its ``sensing`` stands for
        """
        for robot in self.robots.values():
            robot.abort('a saved state was restored')
        self.pulls.end()
        self._clock.step_count, self._clock.control_steps = state.step_count, state.control_steps
        self._start = dict(state.start)
        self.diverged, self._steps.contacts_change = state.diverged, state.contacts_change
        self.seed = state.seed
        if state.drawn != self.randomized.drawn:
            self._randomize(state.seed, state.drawn)
        set_gains(self.model, state.gains)
        # Commands may have changed controls since the present forces were computed.
        self._steps.compute_from(np.frombuffer(state.computed_from))
        mujoco.mj_setState(self.model, self.data, np.frombuffer(state.physics), PHYSICS)
        self._control.replace(control)
        for robot, measured in zip(self.robots.values(), sensing):
            robot.sensing.restore(measured)

    @property
    def control(self) -> ControlState:
        """The state of control, of the present model."""
        return self._control

    def check_restorable(self, state: SimulationState) -> None:
        """
        Check that a state can be restored here.

        :param state: from :meth:`save`
        :raises ModelError: if not, as :meth:`restore`
        """
        if not isinstance(state, SimulationState):
            raise ModelError(f'expected a state of save(), got {state!r:.60}')
        if state.versions != self._versions():
            raise ModelError(f'the state was saved by {state.versions}, this is '
                             + self._versions())
        if state.robots != tuple(self.robots):
            raise ModelError(f'the state was saved with the robots {", ".join(state.robots)}, now '
                             f'there are {", ".join(self.robots)}')
        if (state.model != self.model.signature
                or len(state.physics) != self._steps.computed_from.nbytes):
            raise ModelError('the state was saved in a simulation of another world, or with other '
                             'objects in it')
        if state.layout != self._control.layout:
            raise ModelError('objects have come or gone since the state was saved')

    def digest(self) -> str:
        """
        Return a digest of the present state, with the release of MuJoCo that it belongs to.

        It is the same for the same commands since the last reset, in any process, after any
        other episodes, and whatever was read meanwhile.
        """
        digest = hashlib.sha256(self._steps.state().tobytes())
        for name, content in gains(self.model).items():
            digest.update(name.encode() + content)
        for content in self._control.encoded():
            digest.update(b'%d:' % len(content) + content)
        for robot in self.robots.values():
            digest.update(robot.sensing.encoded())
        if self.randomized.drawn:
            digest.update(repr(sorted(self.randomized.drawn.items())).encode())
        return f'mujoco-{mujoco.mj_versionString()}:{digest.hexdigest()}'

    @staticmethod
    def _versions() -> str:
        return f'manip_sim {package_version()} with MuJoCo {mujoco.mj_versionString()}'
