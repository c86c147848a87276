# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One robot of a simulated world: its parts, their controllers, its end effectors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
import logging
from typing import Any

from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.control.cartesian.cartesian_commands import PoseAction
from manip_sim.control.cartesian.cartesian_settings import IMPEDANCE
from manip_sim.control.cartesian.kinematic_chains import find_chains, find_frames
from manip_sim.control.command_parser import CartesianParser, CommandParser
from manip_sim.control.commands import (
    Command, CommandHandle, GripperAction, GripperCommand, JointSetpoint, JointTrajectory,
    NoCommand, Status, TrajectoryReference)
from manip_sim.control.controlled_joints import ControllerState
from manip_sim.control.delayed_commands import DelayedCommands
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.joint_controller import JointController
from manip_sim.control.modes import Law, law_of, MODES, POSITION
from manip_sim.control.reflexes import Reflexes
from manip_sim.control.robot_runs import RobotRuns
from manip_sim.control.seats import LawParameters
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.robots import RobotModel
from manip_sim.physics.clock import Clock
from manip_sim.physics.efforts import ActuatorEfforts
from manip_sim.physics.parts import atomic_parts, find_parts, Part
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import Physics, STEPS
from manip_sim.simulation.faults import RobotFaults
from manip_sim.simulation.robot_state import joint_dynamics, JointDynamics, RobotReader, State
from manip_sim.validation import positive_number

_LOGGER = logging.getLogger('manip_sim.control')


class SimulatedRobot:
    """
    A robot in a simulation, with its commands and its states.

    Commands are validated by :attr:`parse`, which only reads, and take effect with :meth:`apply`.
    A ``Simulation`` makes and advances it.

    :param physics: of the world at the start, after ``mj_forward``
    :param robot: a robot of the model
    :param efforts: of the actuators of the model
    :param clock: of the simulation
    :ivar robot_model: the robot, with its base and its grippers
    :ivar parts: by name
    :ivar joints: controller of the joints
    :ivar grippers: controllers of the grippers, by part
    :ivar runs: its intervals that compiled code runs
    :ivar end_effectors: readers of the grippers, by arm, of the arms with a gripper
    :ivar sensing: its measurements: noise, resolution and latency
    :ivar reflexes: what stops a part, and which parts were stopped
    :ivar parse: parser of commands
    :ivar parse_cartesian: parser of Cartesian commands
    :ivar joint_names: all scalar joints, in the order of the states
    :ivar reader: reads joints and grippers
    :ivar faults: that act, or will
    :ivar indices_of: indices of each part's joints in :attr:`joint_names`, by part
    """

    remembered = ('_period_s',)

    def __init__(self, physics: Physics, robot: RobotModel, efforts: ActuatorEfforts,
                 clock: Clock) -> None:
        self._physics, model = physics, physics.model
        self._efforts, self._clock = efforts, clock
        self._timestep_s = self._period_s = float(model.opt.timestep)
        self.robot_model = robot
        self.parts: dict[str, Part] = find_parts(model, robot)
        atomic = atomic_parts(self.parts)
        self.reader = RobotReader(physics, self.name, self.parts, efforts, clock)
        self.joint_names, self.indices_of = self.reader.joint_names, self.reader.indices_of
        self.end_effectors, self.sensing = self.reader.end_effectors, self.reader.sensing
        self.faults = RobotFaults(self.reader, clock)
        self.sensing.faulty = self.faults.current
        self.joints = JointController(
            physics, {name: p for name, p in self.parts.items() if p.gripper is None},
            [part.name for part in atomic if part.gripper is None],
            find_chains(model, robot, self.parts, self.end_effectors), robot.gains_are_highest,
            self.end_effectors)
        self.grippers = {part.name: GripperController(physics, part, self._timestep_s)
                         for part in atomic if part.gripper is not None}
        self.runs = RobotRuns(physics, self.joints, self.grippers, clock)
        self.reflexes = Reflexes(physics, self.parts, self.joints, self.end_effectors, efforts)
        self.parse = CommandParser(robot, self.joints, self.grippers)
        self.parse_cartesian = CartesianParser(
            robot, self.joints, find_frames(model, robot, self.end_effectors))
        physics.on_change(self._find_frames)
        self._late = DelayedCommands()
        if self.twist_joints:
            self.reader.add_odometry(self.name, self.twist_joints)

    def _find_frames(self) -> None:
        self.parse_cartesian.rebind(self._physics.model)

    @property
    def period_s(self) -> float:
        """Length of a control period, of which commands come [s]."""
        return self._period_s

    @property
    def name(self) -> str:
        """The prefix of its names, without the trailing underscore."""
        return self.robot_model.name_in_world

    @property
    def frame_body(self) -> str:
        """The body whose pose is the robot's, such as its mobile base."""
        base = self.robot_model.base
        return base.root_body if base is not None and base.joints else self.robot_model.root_body

    @property
    def sensor_names(self) -> list[str]:
        """The sensors of the robot, its base and its grippers."""
        return [name for part in (self.robot_model, *self.robot_model.models)
                for name in part.sensors]

    @property
    def twist_joints(self) -> tuple[str, ...]:
        """The joints x, y and yaw of a base that takes a twist, or none."""
        indices = self.joints.twist_indices
        return () if indices is None else tuple(self.joints.names[i] for i in indices)

    @property
    def moving(self) -> bool:
        """True if setpoints change, or may change, in the next interval."""
        return self.joints.moving or self.grippers_move

    @property
    def grippers_move(self) -> bool:
        """True if setpoints of a gripper change, or may change, in the next interval."""
        return any([gripper.moving for gripper in self.grippers.values()])

    @property
    def resting(self) -> bool:
        """True if the physics loop has nothing to do for it until the next command."""
        return (self.joints.resting and not self.reflexes.armed and not self._late
                and not self.faults.scheduled
                and not self.grippers_move)

    def apply(self, *commands: Command, period_s: float | None = None, delay_steps: int = 0
              ) -> None:
        """
        Let validated commands take effect with the next control period.

        :param commands: made by :attr:`parse` or :attr:`parse_cartesian`
        :param period_s: length of a control period [s]; None for that of the last one
        :param delay_steps: timesteps after which they take effect, before the latency of
            commands is added
        :raises CommandError: if a command was made for another robot, or ``period_s`` is not a
            finite number above 0; then none takes effect
        """
        if len(commands) == 1 and not delay_steps and self._goes_on(commands[0], period_s):
            return
        self._physics.interrupt()
        for command in commands:
            self.check_own(command)
        if period_s is not None and period_s != self._period_s:
            self._period_s = positive_number(period_s, 'period_s', CommandError)
        for command in commands:
            if self.faults.loses(command):
                continue
            if self._late or delay_steps or self.sensing.settings.delays_commands:
                count = self._clock.control_steps + delay_steps
                self._late.add(
                    command, count + self.sensing.delays['command'].steps(count))
            else:
                self._apply(command)

    def _goes_on(self, command: Command, period_s: float | None) -> bool:
        """Let compiled code go on with a command like the one before; return whether it does."""
        if not self._physics.standing.item(STEPS) or not self._applies_at_once or (
                period_s not in (None, self._period_s)):
            return False
        self.check_own(command)
        return self.runs.go_on(command, self._period_s)

    @property
    def _applies_at_once(self) -> bool:
        """True if commands take effect at once, and none is lost or refused."""
        return not (self.faults.scheduled or self.sensing.settings.delays_commands
                    or self.reflexes.tripped)

    def _apply(self, command: Command) -> None:
        clock = self._clock
        refusal = self.reflexes.refusal(command)
        if refusal is None and self.reflexes.armed:
            self.reflexes.check_command(
                command, self._physics.data, clock.control_s, self._period_s)
            refusal = self.reflexes.refusal(command)
        if refusal is not None:
            command.handle.end(Status.ABORTED, refusal)
        elif isinstance(command, NoCommand):
            command.handle.end(Status.DONE)
        elif isinstance(command, GripperCommand):
            (part,) = command.parts
            self.grippers[part].apply(command, self._physics.data)
        else:
            if isinstance(command, JointTrajectory) and command.start_ns:
                command = replace(command, start_s=clock.since_reset_s(command.start_ns))
            self.joints.apply(command, self._physics.data, clock.control_s, self._period_s)

    def check_own(self, command: Command) -> None:
        """
        Reject a command for another robot, whose joints and grippers have other indices.

        :param command: made by any parser
        :raises CommandError: naming both
        """
        if command.robot is not self.robot_model:
            raise CommandError(f"a command for robot '{command.robot.name_in_world}' cannot be "
                               f"applied to robot '{self.name}' of this simulation")

    def withdraw(self, command: Command, reason: str) -> None:
        """
        Abort a command; joints or fingers that no newer command has taken come to rest.

        :param command: one that has been applied
        :param reason: why, for the command's handle
        :raises CommandError: if it was made for another robot
        """
        self.check_own(command)
        self._physics.interrupt()
        if self._late.withdraw(command.handle, reason):
            return
        if isinstance(command, GripperCommand):
            (part,) = command.parts
            self.grippers[part].withdraw(command.handle, self._physics.data, reason)
        else:
            self.joints.withdraw(command.handle, self._physics.data, reason)

    def limits(self, part: str) -> FloatArray:
        """
        Return the range that actions span, by driven joint in its mode, SI units, (n, 2), a copy.

        :param part: such as ``arm``
        :raises UnknownNameError: if the part is unknown, or it is a gripper
        """
        return self.joints.ranges(self.joints.indices_of(part))

    def set_control_mode(self, part: str, mode: str) -> None:
        """
        Change the control mode of a part; joints whose mode changes come to rest.

        :param part: such as ``arm``
        :param mode: the name of one of ``manip_sim.control.modes.MODES``, such as ``effort``
        :raises CommandError: if the part is a gripper
        :raises ModelError: if the gains of the mode cannot be used
        :raises UnknownNameError: if the part or mode is unknown
        """
        self._check_no_gripper(part)
        self._physics.interrupt()
        self.joints.set_mode(part, mode, self._physics.data)
        self.reflexes.hold_laws(self._physics.data)

    def set_law(self, part: str, law: Law | Callable[..., object], /, *,
                compiled: bool | None = None, **parameters: float) -> None:
        """
        Let a law of your own move a part from the next physics step on.

        The part then is in the control mode ``law:<name>``: commands of positions, trajectories
        and poses move its setpoints, which the law gets. A law that fails stops the part by a
        reflex; :meth:`reset_reflexes` lets it begin anew, as a reset does. Any other control mode
        ends it.

        :param part: such as ``arm``
        :param law: made by ``manip_sim.laws.law``, or decorated by ``numba.njit``; any other
            function or callable object with its arguments runs as plain Python
        :param compiled: False lets it run as plain Python, which is slow; None: as it was made
        :param parameters: of the law, by name; defaults where none is given
        :raises CommandError: if the part is a gripper
        :raises ModelError: if the law cannot be compiled, a value is not a finite number, or the
            integrator of the world is RK4, which has no place between the halves of a step
        :raises UnknownNameError: if the part or parameter is unknown
        """
        self._check_no_gripper(part)
        self._physics.interrupt()
        joint_law = law_of(law)
        compiled = joint_law.is_compiled if compiled is None else bool(compiled)
        if not compiled:
            _LOGGER.warning("the law '%s' of %s runs as plain Python in each physics step, which "
                            'is slow', joint_law.name, part)
        self.joints.set_law(
            part, joint_law, joint_law.values(parameters), compiled, self._physics.data)
        self.reflexes.hold_laws(self._physics.data)

    def law_parameters(self, part: str) -> LawParameters:
        """
        Return the parameters of the law that moves a part, by name; a new value acts at once.

        :param part: such as ``arm``; of several arms the values are those of the first
        :raises ModelError: if no law moves it
        :raises UnknownNameError: if the part is unknown
        """
        self.joints.seats_of(part)
        return LawParameters(lambda: self.joints.seats_of(part))

    @property
    def laws(self) -> dict[str, str]:
        """The names of the laws that move parts, by part; parts that consist of no others."""
        return {part: seat.name for part, seat in self.joints.seats.of.items()}

    def check_laws(self) -> None:
        """Stop the parts whose laws have failed in the last run."""
        if self.joints.seats.of:
            self.reflexes.check_laws(self._physics.data)

    def command_interfaces(self) -> dict[str, str]:
        """Return what the commands of each joint are: ``position``, ``velocity``, ``effort``."""
        fingers = [joint for gripper in self.grippers.values() for joint in gripper.joints.names]
        return {**{name: MODES[self.joints.mode_of(name)].field for name in self.joints.names},
                **dict.fromkeys(fingers, POSITION.field)}

    def set_command_timeout(self, part: str, timeout_s: float, ends_targets: bool = True) -> None:
        """
        Change how long the last command of a part lasts if no fresh one comes.

        :param part: such as ``arm``
        :param timeout_s: simulation time [s]; 0 for no timeout
        :param ends_targets: whether it ends Cartesian targets too, which come to rest anyway
        :raises CommandError: if the part is a gripper, or the timeout negative or not finite
        :raises UnknownNameError: if the part is unknown
        """
        self._check_no_gripper(part)
        self._physics.interrupt()
        timeout_s = positive_number(timeout_s, 'timeout_s', CommandError, or_zero=True)
        self.joints.set_timeout(part, timeout_s, ends_targets)

    def set_stream(self, part: str, longest_s: float | None = None, hold_s: float | None = None
                   ) -> None:
        """
        Change which commands of a part are a stream, and followed smoothly, and what ends it.

        Goals that come more slowly are steps, each with its own start and stop.

        :param part: such as ``arm``
        :param longest_s: longest interval of a stream, above 0 [s]; None: no change
        :param hold_s: how long joints go on at the velocity of the stream after a command was due
            [s]; 0 for two message intervals; None: no change
        :raises CommandError: if the part is a gripper, or a time is not in its range
        :raises UnknownNameError: if the part is unknown
        """
        self._check_no_gripper(part)
        if longest_s is not None:
            longest_s = positive_number(longest_s, 'longest_s', CommandError)
        if hold_s is not None:
            hold_s = positive_number(hold_s, 'hold_s', CommandError, or_zero=True)
        self.joints.set_stream(part, longest_s, hold_s)

    def set_integral_gain(self, part: str, gain: float) -> None:
        """
        Let servos of a part take away errors that remain in position and velocity mode.

        :param part: such as ``arm``
        :param gain: rate at which an error is taken away [1/s]; 0 for not at all
        :raises CommandError: if the part is a gripper, or the gain negative or not finite
        :raises UnknownNameError: if the part is unknown
        """
        self._check_no_gripper(part)
        self._physics.interrupt()
        self.joints.set_integral_gain(
            part, positive_number(gain, 'integral_gain', CommandError, or_zero=True))

    def _check_no_gripper(self, part: str) -> None:
        if part in self.grippers:
            raise CommandError(f'{part} is a gripper: it has no control mode, no timeout and '
                               'no streams')

    def tare_wrench(self) -> None:
        """Let the present external wrench of every arm read zero."""
        for reader in self.end_effectors.values():
            reader.external.tare(self._physics.data)
        self.sensing.tare()

    def set_wrench_cutoff(self, arm: str, cutoff_hz: float) -> None:
        """
        Filter the external wrench of an arm by a low-pass of first order, in simulated time.

        :param arm: such as ``right``
        :param cutoff_hz: cutoff frequency [Hz]; 0 for no filter
        :raises CommandError: if it is negative or not finite
        :raises UnknownNameError: if the arm is unknown, or it has no gripper
        """
        if arm not in self.end_effectors:
            raise UnknownNameError('arm with a gripper', arm, self.end_effectors)
        self.end_effectors[arm].external.set_cutoff(cutoff_hz, self._physics.data)

    def set_payload(self, arm: str, mass: float, center_of_mass: ArrayLike = (0.0,) * 3,
                    inertia: ArrayLike = (0.0,) * 6) -> None:
        """
        Declare what an arm holds: its actuators carry it, and its external wrench is without it.

        :param arm: such as ``right``
        :param mass: [kg]; 0 for nothing
        :param center_of_mass: in ``ft_frame``, the flange between wrist and gripper [m], shape
            (3,)
        :param inertia: about the centre of mass, in the axes of ``ft_frame``: ixx, ixy, ixz, iyy,
            iyz, izz [kg m^2], shape (6,)
        :raises CommandError: if a number is not finite, the mass is negative, or no body has such
            an inertia; then nothing changes
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self.joints.set_payload(arm, Payload.checked(mass, center_of_mass, inertia))

    def payload(self, arm: str) -> Payload:
        """
        Return the payload of an arm, as :meth:`set_payload` has declared it.

        :param arm: such as ``right``
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        return self.joints.payloads[arm]

    @property
    def settings(self) -> dict[str, Any]:
        """Acting settings, by the name of the parameter of the node."""
        acting: dict[str, Any] = {}
        for part, limits in self.reflexes.limits.items():
            values = self.joints.settings(part)
            acting.update({f'{name}.{part}': value for name, value in values.items()})
            acting.update({f'reflex.{part}.{name}': v for name, v in asdict(limits).items()})
        for part in self.laws:
            acting.update({f'law.{part}.{name}': value
                          for name, value in self.law_parameters(part).items()})
        for arm, settings in self.joints.cartesian.settings.items():
            acting.update({
                f'{name}.{arm}' if name in IMPEDANCE else f'cartesian.{arm}.{name}':
                list(value) if isinstance(value, tuple) else value
                for name, value in asdict(settings).items()})
        for arm, reader in self.end_effectors.items():
            acting[f'wrench_cutoff.{arm}'] = reader.external.cutoff_hz
            acting.update({
                f'payload.{arm}.{name}': list(value) if isinstance(value, tuple) else value
                for name, value in asdict(reader.external.payload).items()})
        return {**acting, 'speed_scaling': self.joints.speed_scaling, **self.sensing.settings.all}

    def state(self) -> State:
        """Return the measured state of the present instant, with noise and latency."""
        return self.reader.state(self.sensing.measured)

    def true_state(self) -> State:
        """Return a snapshot of the present instant, exactly."""
        return self.reader.state(self.sensing.exact)

    def measured(self, part: str | None = None) -> FloatArray:
        """
        Return the positions, then the velocities, then the efforts of the joints of a part.

        They are measured with noise and latency, as set.

        :param part: its name; None for all joints
        :returns: each in the order of the joints' names, in SI units, shape (3 n,), a copy
        :raises UnknownNameError: if the part is unknown
        """
        return self.reader.measured(part)

    def dynamics(self) -> dict[str, JointDynamics]:
        """Return inertia, damping, friction and limits of all scalar joints, by name."""
        return joint_dynamics(self._physics.model, self.joints, self.joint_names,
                              self.robot_model.friction_laws)

    def controller_state(self, part: str) -> ControllerState:
        """
        Return the reference and the measured state of a part's driven joints, copies.

        :param part: such as ``arm``
        :raises UnknownNameError: if the part is unknown, or it is a gripper
        """
        return self.joints.controller_state(part, self._physics.data, self._efforts.values)

    def trajectory_reference(self, handle: CommandHandle) -> TrajectoryReference | None:
        """
        Return what the joints of a trajectory that runs follow, or None.

        :param handle: of the trajectory's command
        """
        return self.joints.trajectory_reference(handle, self._clock.control_s)

    def begin_period(self, period_s: float, interval_s: float) -> None:
        """
        Begin a control period; end position commands that are done and commands that timed out.

        :param period_s: length of the control period [s]
        :param interval_s: length of its first interval, if setpoints move [s]
        """
        self._period_s = period_s
        if self._late:
            self._apply_late()
        self.reflexes.check(self._physics.data)
        self.joints.begin_period(
            self._physics.data, self._clock.control_s, period_s, interval_s)

    @property
    def has_latency(self) -> bool:
        """True if commands are on their way, or states are measured before they arrive."""
        return bool(self._late) or self.sensing.settings.delays

    def next_arrival(self, count: int, end: int) -> int:
        """
        Return when the next late command takes effect.

        :param count: steps since the reset, after which that has to be
        :param end: returned if none does
        """
        return next((arrival for arrival, _ in self._late if arrival > count), end)

    def _apply_late(self) -> None:
        for command in self._late.due(self._clock.control_steps):
            try:
                self._apply(command)
            except Exception as error:  # A user's gripper may raise anything.
                command.handle.end(Status.ABORTED, str(error))

    @property
    def busy_parts(self) -> frozenset[str]:
        """The atomic parts with a motion that has an end, or for which one waits."""
        return self.joints.busy_parts | self._late.busy_parts

    def set_reflex(self, part: str, quantity: str, limit: float | ArrayLike | str) -> None:
        """
        Change what stops a part; it then refuses commands until :meth:`reset_reflexes`.

        :param part: such as ``arm``
        :param quantity: ``velocity`` or ``effort``, as multiples of the limits of the joints,
            ``force`` [N] or ``torque`` [N m], of the external wrench on the tool of an arm,
            ``discontinuity``, of commands for positions, as a multiple of the limits of velocity
            and acceleration, or ``collision``, of the torques that the world exerts at joints
        :param limit: 0 for none; of collisions ``none``, ``default`` (a quarter of the effort
            limits), or a threshold for all joints or one for each [N m or N]
        :raises CommandError: if the part is a gripper, the limit negative or not finite, or the
            wrench on a tool shall stop a part that has none
        :raises UnknownNameError: if the part or quantity is unknown
        """
        self._check_no_gripper(part)
        self._physics.interrupt()
        self.reflexes.set(part, quantity, limit)

    def external_efforts(self, part: str) -> FloatArray:
        """
        Return what the world exerts at the joints of a part, as the reflex on collisions sees it.

        Zeros unless any part of the robot has that reflex.

        :param part: such as ``arm``
        :returns: the residual of the momentum observer [N m or N], shape (n,), a copy
        :raises UnknownNameError: if the part is unknown, or it is a gripper
        """
        self._physics.interrupt()
        return self.reflexes.collisions.residual[self.joints.indices_of(part)]

    def reset_reflexes(self) -> None:
        """
        Let parts that a reflex has stopped take commands again.

        :raises CommandError: in emergency stop, and until a robot that recovers rests
        """
        self._physics.interrupt()
        self.reflexes.reset()

    def set_speed_scaling(self, scaling: float) -> None:
        """
        Let trajectories be followed slower, along the same paths; those that run change gradually.

        :param scaling: share of their speed, from 0 (they stand still) to 1
        :raises CommandError: if it is not a number of that range
        """
        share = positive_number(scaling, 'speed_scaling', CommandError, or_zero=True)
        if share > 1.0:
            raise CommandError(f'speed_scaling must be from 0 to 1, got {share:g}')
        self._physics.interrupt()
        self.joints.set_speed_scaling(share, self._clock.control_s)

    @property
    def trajectories_late_s(self) -> float:
        """Delay of trajectories by ``speed_scaling`` [s]."""
        return self.joints.late_s(self._clock.control_s)

    def emergency_stop(self) -> None:
        """
        Stop all parts but grippers, which stay as they are; all refuse commands until recovery.

        Joints brake within their acceleration limits and are held.
        """
        self._physics.interrupt()
        self.reflexes.stop_all(self._physics.data)

    def recover(self) -> None:
        """Let all parts take commands again as soon as the joints that were stopped rest."""
        self._physics.interrupt()
        self.reflexes.recover()

    @property
    def safety_state(self) -> str:
        """``running``, ``protective_stop``, ``emergency_stop`` or ``recovering``."""
        return self.reflexes.safety_state

    @property
    def may_stand(self) -> bool:
        """True if nothing but joints and fingers has to be looked at in a control period."""
        return not (self._late or self.sensing.settings.delays or self.sensing.settings.measures
                    or self.reflexes.armed or self.reflexes.is_recovering
                    or not all([gripper.stands for gripper in self.grippers.values()]))

    def streams(self, command: JointSetpoint | PoseAction) -> int:
        """
        Return where compiled code can give a command other values in a world that goes on.

        :param command: that was applied, nobody else has it
        :returns: address of the row of the robot; 0 if it has to be applied
        """
        goes_on = self._applies_at_once and command.handle.is_active and any(
            [other is command for other in self.joints.commands.running])
        return self.runs.address if goes_on else 0

    def renews_grip(self, part: str, command: GripperAction) -> int:
        """
        Return where compiled code can give the action of a gripper other numbers, see above.

        :param part: the gripper
        :param command: that was applied, nobody else has it
        :returns: address of the row of the robot; 0 if it has to be applied again
        """
        return self.runs.renews(part, command) if self._applies_at_once else 0

    def abort(self, reason: str) -> None:
        """
        End the handles of all commands; what the joints do is up to the caller.

        :param reason: why, for the handles
        """
        self._physics.interrupt()
        self._late.abort(reason)
        for ledger in (self.joints.commands, *(g.commands for g in self.grippers.values())):
            ledger.end(Status.ABORTED, reason)

    def reset(self) -> None:
        """Abort all commands and hold the joints where they are; modes stay."""
        self._physics.interrupt()
        self._period_s = self._timestep_s
        self.reflexes.clear()
        self._late.abort('the simulation was reset')
        self.joints.reset(self._physics.data)
        for gripper in self.grippers.values():
            gripper.reset(self._physics.data)
