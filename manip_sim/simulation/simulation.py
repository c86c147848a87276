# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The physics of one world: advance it, detect divergence, reset it, save its state."""

from __future__ import annotations

import copy

import mujoco

from manip_sim.control.surroundings import Surroundings
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arenas import EmptyArena
from manip_sim.models.randomization import checked_seed
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.world import World
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.entities import Entities
from manip_sim.physics.object_spawning import plan_world, WorldPlan
from manip_sim.physics.physics import Physics
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.physics.state_dependent_terms import Belts, FloatingBases, SpringForces
from manip_sim.sensing.lidars import Lidars
from manip_sim.simulation.control_period import ControlPeriods
from manip_sim.simulation.episode_start import DomainRandomizer, EpisodeStart, Sample
from manip_sim.simulation.faults import Faults
from manip_sim.simulation.payload_estimation import PayloadEstimate, PayloadEstimation
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.robot_set import MeasuredInstruments, RobotSet
from manip_sim.simulation.robot_spawning import (
    actuators_of, compose_base, plan_with_robot, plan_without_robot, RobotsPlan)
from manip_sim.simulation.saved_state import SavedStates, SimulationState
from manip_sim.simulation.start_defect import find_start_defects


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
    :ivar instruments: measurements of the sensors of the model
    :ivar sensors: values of all of these sensors, by name
    :ivar lidars: the lidars, by name
    :ivar surroundings: mocap bodies, joints of the arena, and actuators of no part
    :ivar pulls: springs that pull bodies
    :ivar periods: runs control periods
    :ivar episode_start: where resets lead to
    :ivar faults: of the robots
    :ivar states: what saved states consist of
    :ivar timestep_s: length of a physics step [s]
    :ivar start_defects: the defects of the start, a sentence for each
    """

    def __init__(self, world: World, visual: bool = False) -> None:
        self.physics = Physics(plan_world(
            compose_base(world, visual), tuple(world.objects), world.name))
        self.efforts = ActuatorEfforts(self.physics)
        self.surroundings = Surroundings(
            self.physics, self.efforts, world.arena, actuators_of(world))
        # Report divergence instead of letting MuJoCo reset silently.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._clock = Clock(round(self.model.opt.timestep * 1e9))
        self.timestep_s = float(self.model.opt.timestep)
        self._floating_bases = FloatingBases(
            self.physics, [robot.root_body for robot in world.robots])
        belts = Belts(self.physics)
        self.episode_start = EpisodeStart(
            world, self.physics, self.surroundings, self._floating_bases, belts)
        self.episode_start.place()
        self._present = RobotSet(self.physics, self.efforts, self._clock, world.robots)
        self.robots = self._present.by_name
        self.faults = Faults(self.physics, self._clock, self.robots, world.faults)
        self._steps = PhysicsSteps(
            self.physics, self._clock, self.efforts, self._present.tools, self._present.laws,
            self._present.seats, (belts, self.faults))
        self.pulls = SpringForces(self.physics, self._clock)
        self.periods = ControlPeriods(
            self._steps, self.robots, self._floating_bases, self.pulls, self._clock,
            self.timestep_s)
        self.instruments = MeasuredInstruments(self.physics, self.robots)
        self.sensors = self.instruments.sensors
        self.states = SavedStates(self.physics, self._clock, self._steps, self.episode_start,
                                  self.efforts, self.robots)
        self.lidars = Lidars(
            self.physics, world.lidars if self.robots else (),
            lambda body: self.instruments.sensing_of(int(self.model.body(body).id)))
        self.episode_start.randomize(
            {name: robot.sensing for name, robot in self.robots.items()})
        if self.randomized.draws:
            self._randomize(world.seed, None)
        self._settle()
        self._reset(world.seed)
        self.start_defects = [defect.text for defect in find_start_defects(
            self.model, self.data, self._floating_bases.roots)]

    def change_objects(self, plan: WorldPlan) -> None:
        """
        Change the objects; everything else stays as it is, commands included.

        :param plan: made from :attr:`plan`, by ``plan_with`` or ``plan_without``
        """
        self.faults.lift()
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

        :param robot: with everything mounted on it; it stands where ``set_base_xpos`` places
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
        :raises UnknownNameError: if the robot is unknown
        """
        self.change_robots(plan_without_robot(self, name))

    def change_robots(self, plan: RobotsPlan) -> None:
        """
        Change the robots; everything else stays as it is, commands included.

        :param plan: made by ``plan_with_robot`` or ``plan_without_robot`` from the present state
            of this simulation
        """
        self.physics.interrupt()
        there = {robot.name_in_world for robot in plan.world.robots}
        for name in self.robots.keys() - there:
            self._present.delete(name)
        self.episode_start.world = plan.world
        self._floating_bases.roots = tuple(robot.root_body for robot in plan.world.robots)
        self.surroundings.of_parts = set(actuators_of(plan.world))
        self._sync_robots()
        self.change_objects(plan.plan)
        self.episode_start.change_robots(plan)
        for robot in plan.world.robots[len(self.robots):]:
            self._present.begin(robot, plan.start, self.seed)
            self._floating_bases.apply()
            self._sync_robots()
            self.instruments.rebind()
            self.states.sync_robots()
            self._steps.compute()
            self._steps.compute_anew()

    def _sync_robots(self) -> None:
        self._steps.sync_robots(
            self._present.tools, self._present.laws, self._present.seats)
        self.periods.sync_robots()

    @property
    def entities(self) -> Entities:
        """Reads poses and twists of robots and free bodies, and places free bodies."""
        return self._present.entities

    @property
    def world(self) -> World:
        """The robots, the arena and the objects that there are now; a copy."""
        return self.episode_start.world.with_objects(self.plan.objects)

    @property
    def spawned_robots(self) -> list[str]:
        """Names of the robots that came while the simulation ran."""
        return self._present.spawned

    @property
    def start(self) -> dict[str, float]:
        """Positions of joints at the next reset, by name [rad or m], a copy."""
        return dict(self.episode_start.positions)

    def start_of(self, robot: RobotModel) -> dict[str, float]:
        """
        Return the start of the joints of a robot that is to be added, by name [rad or m].

        :param robot: its grippers start where their couplings let them settle
        """
        alone: World = copy.copy(self.world.with_robots([robot]))
        alone.arena, alone.objects, alone.cameras, alone.lidars = EmptyArena(), [], [], []
        alone.randomization = alone.noise = None
        keyframe = self.episode_start.keyframe
        alone.keyframe = keyframe if keyframe in alone.keyframes else ''
        settled = Simulation(alone).start
        with_others = self.world.with_robots([*self.world.robots, robot]).init_qpos(
            self.seed, keyframe)
        of_grippers = {joint for gripper in (
            robot.grippers.values() if isinstance(robot, ManipulatorModel) else ())
            for joint in gripper.joints}
        return {joint: position if joint in of_grippers else with_others[joint]
                for joint, position in settled.items()}

    @property
    def seed(self) -> int:
        """The seed that the present episode was drawn from."""
        return self.episode_start.seed

    @property
    def randomized(self) -> DomainRandomizer:
        """The draws for the present episode, where the world has ``randomization``."""
        return self.episode_start.randomized

    @property
    def plan(self) -> WorldPlan:
        """The plan that the world was compiled from."""
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

    @property
    def lowered_gains(self) -> list[str]:
        """A sentence for each servo of a robot whose gains were lowered to be stable."""
        return [sentence for robot in self.robots.values() for sentence in robot.joints.lowered]

    def _settle(self) -> None:
        self.episode_start.settle([gripper.part for robot in self.robots.values()
                                   for gripper in robot.grippers.values()], self._reset)

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
    def diverged(self) -> str | None:
        """Reason why the physics is on hold, or None."""
        return self.periods.diverged

    @property
    def idle(self) -> bool:
        """True if nothing but physics happens until the next command."""
        return self.periods.idle

    def advance(self, steps: int) -> None:
        """
        Run one control period; afterwards all of the data belongs to the new instant.

        :param steps: number of physics steps, from 1
        :raises CommandError: if that is not a whole number from 1
        :raises DivergenceError: if the physics diverges, or has diverged and was not reset; the
            last good state is held, at rest
        """
        self.periods.advance(steps)

    def estimate_payload(self, arm: str, robot: str | None = None, steps: int = 5
                         ) -> PayloadEstimate:
        """
        Let an arm turn its last three joints to some places and back, and estimate what it holds.

        :param arm: such as ``right``; it needs some 0.2 m of room around what it holds
        :param robot: its name; None for the only robot
        :param steps: physics steps of each control period meanwhile
        :raises CommandError: if the arm follows another command, is not in position mode, cannot
            turn its gripper enough, or cannot make the motion
        :raises DivergenceError: as of :meth:`advance`
        :raises UnknownNameError: if the robot or arm is unknown, or has no gripper
        """
        if robot is not None and robot not in self.robots:
            raise UnknownNameError('robot', robot, self.robots)
        moved = self.robot if robot is None else self.robots[robot]
        estimation = PayloadEstimation(self.physics, moved, arm)
        moved.apply(estimation.command)
        while estimation.command.handle.is_active:
            self.advance(steps)
            estimation.record()
        return estimation.result()

    def reset(self, seed: int | None = None, drawn: Sample | None = None) -> None:
        """
        Reset everything to the start and abort all commands; time goes on.

        Joints, grippers and their action state, free objects and tare are as after construction;
        control modes stay.

        :param seed: draws the start anew, as at construction with this seed, where the world has
            ``initialization_noise``, and the noise of sensors, and what the ``randomization`` of
            the world draws; None keeps all
        :param drawn: by name, in place of what ``randomization`` would draw, such as
            ``randomized.drawn`` of an earlier episode; None lets it draw
        :raises ModelError: if the seed is not a whole number from 0, or something cannot be drawn;
            then nothing changes
        """
        if seed is not None:
            seed = checked_seed(seed)
        self.physics.interrupt()
        self.faults.lift()
        episode_seed = self.seed if seed is None else seed
        positions = self.episode_start.draw(seed)
        if drawn is not None or (seed is not None and self.randomized.draws):
            self._randomize(episode_seed, drawn)
        self.episode_start.begin(episode_seed, positions)
        if positions is not None:
            self._settle()
        self._reset(seed)

    def _randomize(self, seed: int, drawn: Sample | None) -> None:
        """Draw what differs between episodes, or take drawn values."""
        if drawn is None:
            self.randomized.draw(seed)
        else:
            self.randomized.set(drawn)
        self._steps.refresh_joint_parameters()
        for robot in self.robots.values():
            robot.joints.refresh_joint_parameters()

    def _reset(self, seed: int | None = None) -> None:
        self.episode_start.place()
        self._clock.control_steps = 0
        for robot in self.robots.values():
            robot.reset()
        self.faults.begin(self.seed)
        self.periods.diverged = None
        self.pulls.end()
        self._steps.compute()
        self._steps.compute_anew()
        self.efforts.restart()
        for tool in self._steps.tools:
            tool.reset(self.data)
        for robot in self.robots.values():
            robot.sensing.reset(seed)
            robot.faults.measure()

    def forward(self) -> None:
        """Compute all of the present instant anew, after :attr:`data` was changed by hand."""
        self._steps.compute()

    def save(self) -> SimulationState:
        """
        Return the present state: physics, setpoints, commands, grippers, tare and settings.

        Call it between control periods. Edits of :attr:`model` are not part of it.
        """
        self.physics.interrupt()
        return self.states.save(self.diverged)

    def restore(self, state: SimulationState) -> None:
        """
        Continue from a state, to the last bit; time, too, is restored.

        Commands that run are aborted; those of the state go on, with handles of their own.

        :param state: of this simulation, or of one of an equal world in any process
        :raises ModelError: if it belongs to another world, another set of objects, or another
            version of manip_sim or MuJoCo; then nothing changes
        """
        self.states.check(state)
        content = self.states.decoded(state)
        self.physics.interrupt()
        for robot in self.robots.values():
            robot.abort('a saved state was restored')
        self.pulls.end()
        self.periods.diverged = state.diverged
        if state.drawn != self.randomized.drawn:
            self._randomize(state.seed, state.drawn)
        self.states.replace(state, content)

    def digest(self) -> str:
        """
        Return a digest of the present state, with the release of MuJoCo that it belongs to.

        It is the same for the same commands since the last reset, in any process, after any
        other episodes, and whatever was read meanwhile.
        """
        self.physics.interrupt()
        return self.states.digest()
