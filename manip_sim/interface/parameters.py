# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The node's parameters of its world: type, default, limits and description of each.

Those of the parts of its robots are in :mod:`manip_sim.interface.part_parameters`.
"""

from __future__ import annotations

from collections.abc import Sequence

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
from manip_sim.sensing.images import MAX_PIXELS, MAX_RATE_HZ, MIN_RATE_HZ
from manip_sim.validation import fitting_timestep, nearest_rates, steps_of

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
                      'realtime.', live=True, minimum=0.1, maximum=100.0),
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
