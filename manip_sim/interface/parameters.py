# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node's parameters: one table with type, default, limits and description."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from manip_sim.control.cartesian.cartesian_settings import CartesianSettings, FRAMES
from manip_sim.control.modes import default_mode, LAWS, MODES
from manip_sim.control.reflexes import DEFAULT, OFF
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S
from manip_sim.errors import ParameterError
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.interface.topics import Scope
from manip_sim.models.arenas import arena_names, arena_parameters, ArenaParameter
from manip_sim.models.bases import base_names
from manip_sim.models.cameras import ImageSettings
from manip_sim.models.grippers import gripper_names
from manip_sim.models.randomization import TYPES
from manip_sim.models.robots import robot_names
from manip_sim.models.urdf_writer import PLUGINS, TOPIC_PLUGIN
from manip_sim.physics.parts import Part
from manip_sim.physics.payload import Payload
from manip_sim.sensing.images import MAX_PIXELS, MAX_RATE_HZ, MIN_RATE_HZ
from manip_sim.sensing.sensor_noise import QUANTITIES
from manip_sim.validation import fitting_timestep, nearest_rates, steps_of

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
STEPPING = ('realtime', 'free', 'lockstep')
SHORTEST_STEP_S = 1e-4


#: Is to be used before the names of models are known.
MODEL_PATH = ParameterSpec(
    'model_path', [''], 'Folders whose models are added to the catalogue: robots/NAME.yaml, .xml '
    'or .urdf is the robot NAME; likewise grippers, bases and arenas.')


def node_parameters() -> list[ParameterSpec]:
    """Return the parameters of every node but :data:`MODEL_PATH`, before robots are known."""
    return [
        ParameterSpec('robots', [''], 'Names of several robots in one world, such as left and '
                      'right. The name is the namespace of the topics of a robot and the prefix '
                      'of its parameters, such as left.robot. Empty: one robot.'),
        ParameterSpec('task', '', "A task from 'manip_sim list tasks'. It sets arena and objects, "
                      'and draws its starts from seed. Empty: no task.'),
        ParameterSpec('arena', 'empty', 'What surrounds the robot.',
                      choices=tuple(arena_names()), kind='arenas'),
        ParameterSpec('cube', True, 'In the arena table: put a free cube of 0.05 m and 0.1 kg on '
                      'the table.'),
        ParameterSpec('objects', [''], 'Free bodies: YAML files that list objects, MJCF files, or '
                      'descriptions such as {name: box, shape: box, size: [0.1, 0.1, 0.1], '
                      'mass: 0.5, position: [0.5, 0.0, 0.05]}.'),
        ParameterSpec('spawn_roots', [''], 'Folders whose files ~/spawn_entity may read, with '
                      'their subfolders; empty: the assets of manip_sim.'),
        ParameterSpec('cameras', [''], "Cameras whose images are published: names of the model's "
                      'cameras, such as birdview, or descriptions such as {name: front, '
                      'position: [1.5, 0.0, 1.5], look_at: [0.0, 0.0, 0.8], fovy: 45}.'),
        ParameterSpec('lidars', [''], 'Lidars: descriptions such as {name: scan, position: '
                      '[0.5, 0.0, 0.2], samples: 720, rings: 1, range_max: 10.0, rate: 10.0}.'),
        ParameterSpec('sensors', [''], 'Rate and noise of single sensors: descriptions such as '
                      '{name: wrist_imu, rate: 50.0, noise: 0.01}.'),
        ParameterSpec('initialization_noise.type', 'gaussian', "Distribution of the noise on "
                      "the start positions of the robots' own joints.", choices=TYPES),
        ParameterSpec('initialization_noise.magnitude', 0.0, 'Standard deviation (gaussian) '
                      'or half-width (uniform) of the noise on the start positions; 0: no noise.',
                      'rad or m', minimum=0.0, maximum=3.0),
        ParameterSpec('seed', 0, 'Seed of initialization_noise; equal seeds give equal starts. '
                      'A change takes effect at the next reset.', live=True, minimum=0,
                      maximum=2**31 - 1),
        ParameterSpec('randomization', '', 'YAML file with distributions of masses, friction, '
                      'sizes, poses, lights, camera poses, noise and latency, drawn from seed at '
                      'each reset, or its content in braces; empty: none.'),
        ParameterSpec('faults', '', 'YAML file with faults that are planned for each episode: '
                      'what, part, from, until, or its content in braces; empty: none.'),
        ParameterSpec('timestep', 0.002, 'Physics step.', 's', minimum=SHORTEST_STEP_S,
                      maximum=0.01),
        ParameterSpec('publish_rate', 100.0, 'Control periods, and messages on each state topic, '
                      'per second of simulation time; a period is a whole number of timesteps.',
                      'Hz', minimum=1.0, maximum=10000.0),
        ParameterSpec('stepping', 'realtime', 'What drives the physics: the clock, nothing (as '
                      'fast as possible), or the commands of lockstep_parts.', choices=STEPPING),
        ParameterSpec('start_paused', False, 'Start paused, and wait for ~/pause or ~/step.'),
        ParameterSpec('pause_at', 0.0, 'Pause at the end of the control period that reaches this '
                      'simulation time; ~/pause resumes. A time that has passed has no effect.',
                      's', live=True, minimum=0.0, maximum=1e9),
        ParameterSpec('real_time_factor', 1.0, 'Simulation time per wall time, with stepping '
                      'realtime.', live=True, minimum=0.1, maximum=10.0),
        ParameterSpec('expected_command_rate', 0.0, 'Commands per second of simulation time for '
                      'which the controllers or policies were made; /diagnostics warns of parts '
                      'whose commands come at another one. 0: any.', 'Hz', live=True,
                      minimum=0.0, maximum=10000.0),
        ParameterSpec('thread_priority', 50, 'Priority of the process among real-time threads '
                      '(SCHED_FIFO), where that is permitted, with stepping realtime; 0: none.',
                      minimum=0, maximum=99),
        ParameterSpec('cpu_affinity', [-1], 'Numbers of the processors on which the process runs; '
                      '[-1]: all.'),
        ParameterSpec('lock_memory', False, 'Keep all memory of the process from being swapped.'),
        ParameterSpec('gravity_compensation', True, 'Let the actuators carry the weight of all '
                      'links and grippers; included in the effort and in the torque limits.'),
        ParameterSpec('publish_tf', True, 'Publish /tf and /tf_static, if tf2_msgs is installed; '
                      'switch it off if you use robot_state_publisher.'),
        ParameterSpec('tf_rate', 50.0, 'Messages on /tf and ~/markers per second of simulation '
                      'time; rounded to publish_rate divided by a whole number.', 'Hz',
                      minimum=0.1, maximum=10000.0),
        ParameterSpec('frame_prefix', '', 'Start of all frame names in messages, such as left/, '
                      'as in robot_state_publisher.'),
        ParameterSpec('profile', '', 'Names of topics, services, actions and joints in messages '
                      'as a driver has them: franka, kortex, ur, xarm, or a YAML file; empty: '
                      'own names.'),
        ParameterSpec('ros2_control_tag', False, 'Add to robot_description the tag with which '
                      'ros2_control commands this node.'),
        ParameterSpec('ros2_control_plugin', TOPIC_PLUGIN, 'Hardware component that the tag '
                      'names; the one of manip_sim_hardware also works in lockstep.',
                      choices=PLUGINS),
        ParameterSpec('publish_clock', True, 'Publish /clock; only one node of a domain should.'),
    ]


def keyframe_parameter(names: Sequence[str]) -> ParameterSpec:
    """
    Return the parameter of the keyframe that joints start from.

    :param names: of the keyframes of all files
    """
    return ParameterSpec('keyframe', '', 'Keyframe of the files of robots, grippers, bases or '
                         'arena that joints start from; empty: the usual start. A change takes '
                         'effect at the next reset.', live=True, choices=('', *names))


def arena_specs(arena: str) -> list[ParameterSpec]:
    """Return the parameters of an arena, such as ``arena.table_height``."""
    # The parameter ``cube`` is older than the others and has no ``arena.`` before its name.
    return [_arena_spec(parameter) for parameter in arena_parameters(arena)
            if parameter.name != 'cube']


def _arena_spec(parameter: ArenaParameter) -> ParameterSpec:
    is_number = not isinstance(parameter.default, bool)
    description = f'{parameter.description[:1].upper()}{parameter.description[1:]}.'
    return ParameterSpec(
        f'arena.{parameter.name}', parameter.default, description, parameter.unit,
        minimum=parameter.low if is_number else None,
        maximum=parameter.high if is_number else None)


def composition_parameters(scope: Scope) -> list[ParameterSpec]:
    """Return the parameters that say which robot there is."""
    specs = [
        ParameterSpec('robot', 'Panda', 'Robot of the catalogue, or a file: MJCF, URDF or YAML.',
                      choices=tuple(robot_names()), kind='robots'),
        ParameterSpec('gripper', 'default',
                      "Gripper on every arm, or by arm as in '{right: PandaGripper, left: none}'; "
                      "'default' is the robot's own, 'none' mounts none.",
                      choices=('default', 'none', *gripper_names()), kind='grippers'),
        ParameterSpec('base', 'default',
                      "What the robot stands on; 'default' is the robot's own, 'none' is the "
                      'floor.', choices=('default', 'none', *base_names()), kind='bases'),
        ParameterSpec('prefix', f'{scope.name}_' if scope.name else '',
                      'Start of all names of the robot, its base and its '
                      'grippers: joints, frames, the model. Empty: names such as robot0_joint1.'),
        ParameterSpec('tactile', False, 'Put tactile sensors on the pads of the grippers: '
                      'points some 4 mm apart that measure how deep each is pressed.'),
        ParameterSpec('lockstep_parts', ['arm'], 'Parts that must each receive a command before '
                      'lockstep advances by a control period, such as arm or right/gripper; '
                      'for a robot without arms, arm stands for all parts; arena stands for '
                      "the arena's joints.")]
    if not scope.name:
        specs.append(ParameterSpec('idn', 0, 'Number of the robot in names such as robot0_joint1, '
                                   'if prefix is empty.', minimum=0, maximum=999))
    return [spec.within(scope) for spec in specs]


def actuation_parameters(scope: Scope, subsystems: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters of what motors and gears add to joints.

    :param subsystems: those with actuators
    """
    return [spec.within(scope) for name in subsystems for spec in (
        ParameterSpec(f'friction.{name}', 'none', f'Friction of the joints of the {name}: none '
                      "(only that of the model), 'catalogue', or values such as '{coulomb: 0.5, "
                      "static: 0.8, stribeck_velocity: 0.05, viscous: 1.0}', each a number or "
                      'one for each joint.'),
        ParameterSpec(f'torque_speed.{name}', 'none', 'Velocity up to which the joints '
                      f"of the {name} have their full torque, and at which they have none: none, "
                      "'catalogue', or values such as '{knee: 1.5, no_load: 3.0}'."),
        ParameterSpec(f'armature.{name}', 'model', 'Inertia of the rotors, reflected to the '
                      f"joints of the {name}, in kg m^2 (kg): model, or a number such as "
                      "'0.1', or one for each joint such as '[0.6, 0.6, 0.5]'."))]


def place_parameters(scope: Scope, position: Sequence[float]) -> list[ParameterSpec]:
    """
    Return the parameters that say where a robot stands.

    :param position: where it stands unless the user says where [m], three numbers
    """
    return [spec.within(scope) for spec in (
        ParameterSpec('position', [float(value) for value in position], 'Position in the frame '
                      "world of the floor below the robot's root: x, y, z.", 'm', length=3),
        ParameterSpec('orientation', [0.0, 0.0, 0.0], 'Orientation of the robot in the '
                      'frame world: roll, pitch, yaw.', 'rad', length=3))]


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


def camera_parameters(camera: str, default: ImageSettings) -> list[ParameterSpec]:
    """
    Return the parameters of a camera that is chosen.

    :param camera: its name
    :param default: what its images are unless the user says more
    """
    return [
        ParameterSpec(f'camera.{camera}.width', default.width, 'Width of the images.', 'pixels',
                      minimum=1, maximum=MAX_PIXELS),
        ParameterSpec(f'camera.{camera}.height', default.height, 'Height of the images.', 'pixels',
                      minimum=1, maximum=MAX_PIXELS),
        ParameterSpec(f'camera.{camera}.rate', default.rate_hz, 'Images per second of simulation '
                      'time, at most publish_rate; rounded to publish_rate divided by a whole '
                      'number.', 'Hz', minimum=MIN_RATE_HZ, maximum=MAX_RATE_HZ),
        ParameterSpec(f'camera.{camera}.depth', default.depth, 'Also publish depth.')]


def periods_per_image(publish_rate: float, rate: float, name: str) -> int:
    """
    Return after how many control periods an image comes, for the nearest rate there is.

    :param publish_rate: control periods per second [Hz]
    :param rate: images per second that are requested [Hz]
    :param name: of the parameter that sets the rate, named in errors
    :raises ParameterError: if there are more images than control periods
    """
    if rate > publish_rate * (1.0 + 1e-9):
        raise ParameterError(f"parameter '{name}': {rate:g} Hz is not possible, because "
                             f'publish_rate is {publish_rate:g} Hz')
    return periods_per_message(publish_rate, rate)


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
                      live=True, minimum=0.0, maximum=1000.0),
        ParameterSpec(f'payload.{arm}.center_of_mass', list(none.center_of_mass),
                      'Its centre of mass in ft_frame, the flange between wrist and gripper.',
                      'm', live=True, minimum=-10.0, maximum=10.0, length=3),
        ParameterSpec(f'payload.{arm}.inertia', list(none.inertia),
                      'Its inertia about the centre of mass, in the axes of ft_frame: ixx, ixy, '
                      'ixz, iyy, iyz, izz.', 'kg m^2', live=True, minimum=-1000.0,
                      maximum=1000.0, length=6))]


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


def steps_per_period(publish_rate: float, timestep: float) -> int:
    """
    Return how many physics steps a control period has.

    :param publish_rate: [Hz]
    :param timestep: [s]
    :raises ParameterError: if it is not a whole number, naming the nearest rates for which it is
    """
    whole = steps_of(1.0 / publish_rate, timestep)
    if whole is None:
        fitted = fitting_timestep(1.0 / publish_rate, timestep)
        raise ParameterError(
            f"parameter 'publish_rate': a period of {publish_rate:g} Hz is not a whole number of "
            f'timesteps of {timestep:g} s; the nearest rates that are: '
            + ', '.join(f'{rate:.10g}' for rate in nearest_rates(publish_rate, timestep))
            + (f'; or set timestep:={fitted:.9g}' if fitted and fitted >= SHORTEST_STEP_S else ''))
    return whole


def periods_per_message(publish_rate: float, rate: float) -> int:
    """
    Return after how many control periods a message comes, for the nearest rate there is.

    :param publish_rate: control periods per second [Hz]
    :param rate: messages per second that are requested [Hz]
    """
    fewer = max(1, int(publish_rate / rate))
    return min((fewer, fewer + 1), key=lambda n: abs(publish_rate / n - rate))


def commanded_parts(parts: Mapping[str, Part]) -> list[str]:
    """Return the parts with driven joints, which have a control mode: all but grippers."""
    return [name for name, part in parts.items() if part.gripper is None and part.actuators]
