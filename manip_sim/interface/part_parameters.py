# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node's parameters of parts of robots: modes, timeouts, streams, control, reflexes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from manip_sim.control.cartesian.cartesian_settings import CartesianSettings, FRAMES
from manip_sim.control.modes import default_mode, LAWS, MODES
from manip_sim.control.reflexes import DEFAULT, OFF
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.interface.topics import Scope
from manip_sim.physics.parts import Part
from manip_sim.physics.payload import LARGEST, Payload
from manip_sim.sensing.sensor_noise import QUANTITIES

#: Of a base in modes with a timeout: navigation sends velocities more slowly than controllers [s].
_BASE_TIMEOUT_S = 0.5
#: Reasons to stop a part: quantity, condition, unit if measured at a tool, and greatest value.
_REFLEXES = (
    ('velocity', 'a joint exceeds this multiple of its velocity limit', '', 100.0),
    ('effort', 'a joint exceeds this multiple of its effort limit', '', 1.0),
    ('force', 'the external force on the tool exceeds this value', 'N', 1e5),
    ('torque', 'the external torque on the tool exceeds this value', 'N m', 1e5),
    ('discontinuity', 'a command for positions or velocities of joints demands more than this '
     'multiple of the velocity or acceleration limit of a joint', '', 100.0))


def commanded_parts(parts: Mapping[str, Part]) -> list[str]:
    """Return the parts with driven joints, which have a control mode: all but grippers."""
    return [name for name, part in parts.items() if part.gripper is None and part.actuators]


def default_timeout(part: str, mode: str) -> float:
    """
    Return after what time without a fresh command a part stops, unless the user says when [s].

    A position is safe to keep; a velocity or an effort whose sender has died is not.
    """
    timeout_s = MODES[mode].timeout_s
    return _BASE_TIMEOUT_S if timeout_s and part == 'base' else timeout_s


def mode_parameters(scope: Scope, parts: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters that say what commands of each part mean.

    :param parts: the parts with driven joints, see :func:`commanded_parts`
    """
    return [ParameterSpec(
        f'control_mode.{part}', default_mode(part),
        f'What commands of the {part} mean; a change brings it to rest.', live=True,
        choices=tuple(MODES)).within(scope) for part in parts]


def law_parameters(scope: Scope, part: str, law: str) -> list[ParameterSpec]:
    """
    Return the parameters of the law that moves a part.

    :param part: one that consists of no others
    :param law: its name
    :raises ModelError: if the package that offers the law cannot be used
    """
    return [ParameterSpec(
        f'law.{part}.{name}', default, f"Parameter of the law '{law}', which moves the {part}.",
        live=True).within(scope) for name, default in LAWS[law].defaults.items()]


def timeout_parameters(scope: Scope, parts: Sequence[str],
                       mode_of: Callable[[str], str] = default_mode) -> list[ParameterSpec]:
    """
    Return the parameters that say when parts stop for want of commands.

    :param parts: the parts with driven joints, see :func:`commanded_parts`
    :param mode_of: returns the control mode of a part, on which the default depends
    """
    return [spec.within(scope) for part in parts for spec in (
        ParameterSpec(
            f'command_timeout.{part}', default_timeout(part, mode_of(part)),
            f'After this time without a new command for the {part} (simulation time), position '
            'holds, velocity goes to zero, effort to gravity compensation; 0 switches it off. '
            'Until you set it, the default follows the control mode.', 's', live=True,
            minimum=0.0, maximum=3600.0),
        ParameterSpec(
            f'timeout_follows_mode.{part}', True,
            f'Let command_timeout.{part} be the default of the control mode, which ends no '
            'Cartesian targets; false as soon as you set that.', live=True))]


def stream_parameters(scope: Scope, parts: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters that say what messages for a part are a stream, and how it ends.

    :param parts: the parts with driven joints, see :func:`commanded_parts`
    """
    return [spec.within(scope) for part in parts for spec in (
        ParameterSpec(f'stream_interval.{part}', STREAM_INTERVAL_S,
                      f'Longest interval between messages of a stream for the {part}, which is '
                      'followed smoothly with a delay of 1.5 intervals; messages with longer '
                      'intervals are steps.', 's', live=True, minimum=0.001, maximum=5.0),
        ParameterSpec(f'stream_hold.{part}', 0.0,
                      f'How long the {part} continues at the velocity of a stream after a '
                      'message was due, before it brakes and moves to the last goal; 0 means '
                      'two message intervals.', 's', live=True, minimum=0.0, maximum=10.0))]


def cartesian_parameters(scope: Scope, arms: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters of the Cartesian control of a robot.

    :param arms: those with a gripper
    """
    settings = CartesianSettings()
    return [spec.within(scope) for arm in arms for spec in (
        ParameterSpec(f'cartesian.{arm}.stiffness', settings.stiffness,
                      'Stiffness of target poses and pose actions in effort mode: acceleration of '
                      "the end effector per error, in all directions; robosuite's kp.", '1/s^2',
                      live=True, minimum=1.0, maximum=1000.0),
        ParameterSpec(f'cartesian.{arm}.damping_ratio', settings.damping_ratio,
                      'Damping ratio of the same control; 1 is critical damping.', live=True,
                      minimum=0.1, maximum=3.0),
        ParameterSpec(f'cartesian.{arm}.linear_velocity', settings.linear_velocity,
                      'Largest speed of the end effector; a faster target twist is clamped.',
                      'm/s', live=True, minimum=0.001, maximum=10.0),
        ParameterSpec(f'cartesian.{arm}.angular_velocity', settings.angular_velocity,
                      'Largest angular speed of the end effector; a faster twist is clamped.',
                      'rad/s', live=True, minimum=0.001, maximum=30.0),
        ParameterSpec(f'cartesian.{arm}.twist_timeout', settings.twist_timeout,
                      'Time without a new target twist (simulation time) until the end effector '
                      'stops.', 's', live=True, minimum=0.001, maximum=10.0),
        ParameterSpec(f'cartesian_stiffness.{arm}', list(settings.cartesian_stiffness),
                      'Stiffness of the end effector along and about the axes of '
                      f'cartesian_frame.{arm} in effort mode, of an impedance that keeps the '
                      'inertia of the arm; six zeros: the control of '
                      f'cartesian.{arm}.stiffness.', 'N/m, N m/rad', live=True, minimum=0.0,
                      maximum=1e5, length=6),
        ParameterSpec(f'cartesian_damping.{arm}', list(settings.cartesian_damping),
                      'Damping of that impedance along and about its axes, beside that of '
                      f'cartesian_damping_ratio.{arm}.', 'N s/m, N m s/rad',
                      live=True, minimum=0.0, maximum=1e5, length=6),
        ParameterSpec(f'cartesian_damping_ratio.{arm}', settings.cartesian_damping_ratio,
                      'Damping ratio of each mode of that impedance; 1 is critical damping.',
                      live=True, minimum=0.01, maximum=3.0),
        ParameterSpec(f'null_space_stiffness.{arm}', settings.null_space_stiffness,
                      f'Stiffness of that impedance towards null_space_posture.{arm}, in what '
                      'leaves the end effector where it is; 0: such motions are free.', 'N m/rad',
                      live=True, minimum=0.0, maximum=1e4),
        ParameterSpec(f'null_space_posture.{arm}', settings.null_space_posture,
                      'Posture that a redundant arm tends to in Cartesian commands: initial, or a '
                      "position [rad] for each of its joints such as '[0.0, 0.5, 1.0]'.",
                      live=True),
        ParameterSpec(f'cartesian_frame.{arm}', settings.cartesian_frame,
                      'Axes of that impedance: those of the base of the arm, of the end effector '
                      '(tool), or of the world.', live=True, choices=FRAMES))]


def wrench_parameters(scope: Scope, arms: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters of the wrenches of a robot.

    :param arms: those with a gripper
    """
    return [ParameterSpec(
        f'wrench_cutoff.{arm}', 0.0, 'Cutoff frequency (in simulation time) of a first-order '
        'low-pass filter for the external wrench, the mean over a control period; 0: no filter.',
        'Hz', live=True, minimum=0.0, maximum=10000.0).within(scope) for arm in arms]


def payload_parameters(scope: Scope, arms: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters of what arms hold.

    :param arms: those with a gripper
    """
    none = Payload()
    return [spec.within(scope) for arm in arms for spec in (
        ParameterSpec(f'payload.{arm}.mass', none.mass, 'Mass of what the arm holds, which its '
                      'actuators carry and its external wrench leaves out; 0: nothing.', 'kg',
                      live=True, minimum=0.0, maximum=LARGEST['mass']),
        ParameterSpec(f'payload.{arm}.center_of_mass', list(none.center_of_mass),
                      'Its centre of mass in ft_frame, the flange between wrist and gripper.',
                      'm', live=True, minimum=-LARGEST['center_of_mass'],
                      maximum=LARGEST['center_of_mass'], length=3),
        ParameterSpec(f'payload.{arm}.inertia', list(none.inertia),
                      'Its inertia about the centre of mass, in the axes of ft_frame: ixx, ixy, '
                      'ixz, iyy, iyz, izz.', 'kg m^2', live=True,
                      minimum=-LARGEST['inertia'], maximum=LARGEST['inertia'], length=6))]


def integral_parameters(scope: Scope, parts: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters of the integral terms of servos.

    :param parts: the parts with driven joints, see :func:`commanded_parts`
    """
    return [ParameterSpec(
        f'integral_gain.{part}', 0.0, f'Rate at which the servos of the {part} take away errors '
        'that remain, such as of dry friction, in position and velocity mode; 0 switches it off.',
        '1/s', live=True, minimum=0.0, maximum=50.0).within(scope) for part in parts]


def reflex_parameters(scope: Scope, parts: Sequence[str], arms: Sequence[str]
                      ) -> list[ParameterSpec]:
    """
    Return the parameters of what stops a part until ``~/reset_reflex``.

    :param parts: the parts with driven joints, see :func:`commanded_parts`
    :param arms: those with a gripper, and so with an external wrench
    """
    return [spec.within(scope) for part in parts for spec in (
        *[ParameterSpec(f'reflex.{part}.{quantity}', 0.0, f'Stop if {condition}; the part then '
                        'rejects commands until ~/reset_reflex. 0 switches it off.', unit,
                        live=True, minimum=0.0, maximum=most)
          for quantity, condition, unit, most in _REFLEXES
          if not unit or part in arms or (part == 'arm' and len(arms) == 1)],
        ParameterSpec(f'reflex.{part}.collision', OFF, 'The same if the world exerts more than '
                      f"this torque at a joint [N m or N]: {OFF}, {DEFAULT} (a quarter of the "
                      "effort limits), or a number for all joints or one for each such as "
                      "'[20, 20, 18]'.", live=True))]


def sensing_parameters(scope: Scope) -> list[ParameterSpec]:
    """Return the parameters of a robot's measurements: noise, resolution and latency."""
    return [ParameterSpec(name, 0.0, f'{quantity.meaning} 0 switches it off.', quantity.unit,
                          live=True, minimum=0.0, maximum=quantity.maximum).within(scope)
            for name, quantity in QUANTITIES.items()]


def speed_parameter(scope: Scope) -> ParameterSpec:
    """Return the parameter of the speed of trajectories of a robot."""
    return ParameterSpec('speed_scaling', 1.0, 'Share of their speed at which trajectories are '
                         'followed, along the same paths; 0 lets them stand still.', live=True,
                         minimum=0.0, maximum=1.0).within(scope)
