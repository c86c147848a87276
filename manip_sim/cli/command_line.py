# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The command line of ``manip_sim``: its commands, their options, and types of options."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
import logging
import math
from pathlib import Path
import shutil
import sys
import textwrap
from typing import Any, NoReturn

from manip_sim.cli.offered_verbs import GROUP, OfferedVerb
from manip_sim.errors import ManipSimError, ModelError
from manip_sim.resources import offers, package_version
from manip_sim.ros_environment import check_ros_environment, missing_module

#: The least and the greatest edge of a picture [pixels].
SMALLEST, LARGEST = 16, 8192


def number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f'must be a finite number, got {text[:60]!r}')
    return value


def numbers(text: str) -> list[float]:
    return [number(part) for part in text.split(',')]


def positive(text: str) -> float:
    value = number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f'must be above 0, got {text[:60]!r}')
    return value


def whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f'must be a whole number, got {text[:60]!r}')
    return int(text[:9])


def count(text: str) -> int:
    value = whole(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'must be at least 1, got {text[:60]!r}')
    return value


def image_size(text: str) -> tuple[int, int]:
    """Return width and height of a picture [pixels] from text such as ``800x540``."""
    width, _, height = text.lower().partition('x')
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f'must be like 800x540, got {text[:60]!r}')
    size = int(width[:9]), int(height[:9])
    if not all(SMALLEST <= edge <= LARGEST for edge in size):
        raise argparse.ArgumentTypeError(
            f'must be from {SMALLEST} to {LARGEST} pixels each way, got {text[:60]!r}')
    return size


def assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition('=')
    if not (name and equals):
        raise argparse.ArgumentTypeError(f'must be like NAME=VALUE, got {text[:60]!r}')
    return name, value


_Argument = tuple[tuple[str, ...], dict[str, Any]]


def _argument(*names: str, **settings: Any) -> _Argument:
    return names, settings


def _flag(*names: str, **settings: Any) -> _Argument:
    return names, {'action': 'store_true', **settings}


def _command(module: str, summary: str, more: str, example: str, *arguments: _Argument
             ) -> tuple[str, str, str, str, tuple[_Argument, ...]]:
    return module, summary, more, example, arguments


_TOPIC = _argument('name', metavar='TOPIC')
_SERVICE = _argument('name', metavar='SERVICE')
_NODE = _argument('node', metavar='NODE', help='such as /manip_sim')
_PARAMETER = _argument('name', metavar='NAME')
_VALUES = _argument('values', nargs='?', default='{}', metavar='VALUES',
                    help="fields in YAML, such as '{data: [1.0]}' (default: the type's own)")
_COUNT = _flag('-c', '--count', help='only how many')
_LISTED = (_flag('-t', '--show-types', help='with the types'), _COUNT)
_WINDOW = {'type': count, 'metavar': 'N', 'help': 'number of messages to average over (default: '
           '%(default)s)'}

#: For each command that talks to nodes its summary, for each verb its summary and arguments.
COMMANDS: dict[str, tuple[str, dict[str, tuple[str, tuple[_Argument, ...]]]]] = {
    'topic': ('list, print and publish topics, as ros2 topic', {
        'list': ('list the topics', _LISTED),
        'info': ('print the type of a topic, and how many publish and subscribe', (
            _TOPIC, _flag('-v', '--verbose', help='with nodes and quality of service'))),
        'type': ('print the type of a topic', (_TOPIC,)),
        'find': ('list the topics of a type', (
            _argument('type', metavar='TYPE', help='such as sensor_msgs/msg/JointState'), _COUNT)),
        'echo': ('print messages', (
            _TOPIC, _argument('type', nargs='?', metavar='TYPE', help='(default: as published)'),
            _flag('--once', help='print one message'),
            _argument('--field', metavar='FIELD', help='print a field, such as pose.position'),
            _argument('--timeout', type=positive, metavar='SECONDS',
                      help='fail if no message comes for so long'),
            _flag('-f', '--full-length', help='print long arrays and text completely'),
            _flag('--no-arr', help='print no arrays'))),
        'hz': ('print how often messages come', (
            _TOPIC, _argument('-w', '--window', default=10000, **_WINDOW))),
        'bw': ('print the bandwidth of a topic', (
            _TOPIC, _argument('-w', '--window', default=100, **_WINDOW))),
        'delay': ('print the age of messages by the stamps in their headers', (
            _TOPIC, _argument('-w', '--window', default=10000, **_WINDOW))),
        'pub': ('publish messages', (
            _TOPIC, _argument('type', metavar='TYPE', help='such as std_msgs/msg/String'),
            _VALUES, _flag('-1', '--once', help='publish one message'),
            _argument('-t', '--times', type=count, metavar='N', help='publish N messages'),
            _argument('-r', '--rate', type=positive, default=1.0, metavar='HZ',
                      help='messages per second (default: 1)')))}),
    'param': ('list, read and set parameters of nodes, as ros2 param', {
        'list': ('list the parameters', (
            _argument('node', nargs='?', metavar='NODE', help='(default: all nodes)'),
            _argument('--filter', metavar='REGEX', help='those whose beginning matches'))),
        'describe': ('describe parameters', (
            _NODE, _argument('names', nargs='+', metavar='NAME'))),
        'get': ('print the value of a parameter', (
            _NODE, _PARAMETER, _flag('--hide-type', help='the value only'))),
        'set': ('set a parameter', (
            _NODE, _PARAMETER, _argument('value', metavar='VALUE', help='in YAML'))),
        'delete': ('delete a parameter, if its node allows that', (_NODE, _PARAMETER)),
        'dump': ('print all parameters as a parameter file', (_NODE,)),
        'load': ('set the parameters of a file; exit code 1 if some cannot be set', (
            _NODE, _argument('file', metavar='FILE', help='as dump prints it'),
            _flag('--no-use-wildcard', help='leave out what is for all nodes')))}),
    'service': ('list and call services, as ros2 service', {
        'list': ('list the services', _LISTED),
        'type': ('print the type of a service', (_SERVICE,)),
        'find': ('list the services of a type', (
            _argument('type', metavar='TYPE', help='such as std_srvs/srv/Trigger'), _COUNT)),
        'call': ('call a service; exit code 1 if it answers with success: false', (
            _SERVICE, _argument('type', metavar='TYPE', help='such as std_srvs/srv/Trigger'),
            _VALUES))})}
KINDS = ('robots', 'grippers', 'bases', 'arenas', 'objects', 'tasks')
#: Text is never wrapped to fewer characters than this, the minimum of argparse.
_NARROWEST = 11
#: Of this package, beside this one.
_PROGRAMS = ('sim_node', 'sim_view', 'pick_cube', 'hand_over')
_EXIT_CODES = ('Exit codes: 0 success; 1 a problem was found, or the command failed; 2 wrong '
               'command line')
#: The options of a composition; None where they are not given.
_COMPOSITION = (
    _argument('--robot', metavar='NAME', help='robot, by name or from a file (default: Panda)'),
    _argument('--gripper', metavar='NAME', help="gripper on every arm, or by arm as in '{right: "
              "PandaGripper, left: none}'; 'default' is the robot's own, 'none' mounts none "
              '(default: default)'),
    _argument('--base', metavar='NAME', help="what the robot stands on; 'default' is the robot's "
              "own, 'none' is the floor (default: default)"),
    _argument('--arena', metavar='NAME', help='what surrounds the robot (default: empty)'),
    _argument('--arena-param', action='append', metavar='NAME=VALUE', type=assignment,
              help="parameter of the arena, such as table_height=0.9; 'manip_sim list arenas' "
              'lists them; may be repeated'),
    _argument('--object', action='append', metavar='OBJECT', help='a free body: a YAML or MJCF '
              "file, or a description such as '{name: can, shape: cylinder, size: [0.03, 0.12], "
              "mass: 0.3, position: [0.5, 0, 0.06]}'; may be repeated"),
    _argument('--idn', type=whole, metavar='N', help='number in names such as robot0_joint1 '
              '(default: 0)'),
    _argument('--prefix', metavar='TEXT', help='start of all names, such as left_, instead of '
              'that number'),
    _argument('--position', nargs=3, type=number, metavar=('X', 'Y', 'Z'),
              help='position of the floor below the root [m] (default: set by the arena)'),
    _argument('--orientation', nargs=3, type=number, metavar=('ROLL', 'PITCH', 'YAW'),
              help='orientation of the root [rad]'),
    _argument('--timestep', type=number, metavar='SECONDS', help='physics step (default: 0.002)'),
    _flag('--no-gravity-compensation', default=None, help='switch gravity compensation off'),
    _flag('--tactile', default=None, help='tactile sensors on the pads of the grippers'),
    _argument('--params-file', type=Path, metavar='FILE', help='parameter file of a node, instead '
              'of all these options; may describe several robots and objects'),
    _argument('--cameras', action='append', metavar='NAME', help='camera of the model whose '
              'images the node publishes, or description of another camera, as for the node: '
              "'{name: front, position: [2, 0, 1], look_at: [0, 0, 1]}'; may be repeated"))
COMPOSITION = [names[0][2:].replace('-', '_') for names, _ in _COMPOSITION]
_RECORDS = _argument('files', nargs='+', type=Path, metavar='FILE',
                     help='a record, or a folder with records (*.mcap)')
#: For each command its module and function, its summary, a description, examples and arguments.
_COMMANDS = {
    'list': _command(
        'catalogue:list_parts', 'list the available parts and tasks, and where they come from',
        '', 'example: manip_sim list grippers',
        _argument('kind', nargs='?', choices=KINDS, metavar='KIND',
                  help=f'{", ".join(KINDS[:-1])} or {KINDS[-1]} (default: all)'),
        _flag('--json', help='print JSON, in SI units')),
    'describe': _command(
        'describe', 'describe a composition',
        'Lists parts, joints, limits, actuators, sensors, masses, frames, cameras, and the '
        'topics, services and parameters of a node with this composition. Tables fit the width of '
        'the terminal.',
        'example: manip_sim describe --robot Panda --gripper Robotiq85Gripper --arena table',
        _flag('--json', help='print JSON, in SI units'),
        _flag('--yaml', help="print what was inferred of the robot's file, as the YAML file that "
              'describes it')),
    'export': _command(
        'export', 'write a composition to a file for MuJoCo or ROS',
        'The file name selects the format: .xml is MJCF that refers to the mesh files by their '
        'paths, .mjz and .zip are a MuJoCo archive that contains them, .mjb is the compiled '
        'model, exact to the last bit, for the same release of MuJoCo, and .urdf is a URDF of the '
        'robot with base and grippers. --moveit writes a package for MoveIt 2: URDF, SRDF, '
        'limits, controllers, launch file. --ros2-control DIR writes a package for ros2_control: '
        'URDF, controllers, launch files; with both, MoveIt uses these controllers.',
        'examples: manip_sim export panda.mjz --robot Panda --arena table\n'
        '          manip_sim export panda.urdf --robot Panda --prefix left_\n'
        '          manip_sim export --moveit panda_moveit_config --robot Panda\n'
        '          manip_sim export --ros2-control panda_control --robot Panda',
        _argument('file', nargs='?', type=Path, metavar='FILE', help='out.xml, out.mjz, out.zip, '
                  'out.mjb or out.urdf'),
        _argument('--moveit', type=Path, metavar='DIR', help='new folder for the package; its '
                  'name is that of the package'),
        _argument('--name', metavar='ROBOT', help='the robot to write, if there are several'),
        _argument('--ros2-control', nargs='?', type=Path, const=True, default=False, metavar='DIR',
                  help='new folder for a package that starts ros2_control; without DIR: add a '
                  '<ros2_control> tag to a .urdf, for the setup in '
                  'config/topic_based_ros2_control.yaml')),
    'render': _command(
        'render', 'render a picture, without a screen',
        'Shows the start of a composition from two sides, or from the side that you choose. With '
        "'--robot none' it shows a gripper, a base or an arena alone.",
        'examples: manip_sim render panda.png --arena table\n'
        '          manip_sim render hand.png --robot none --gripper FourierRightHand\n'
        'On Linux, pictures are rendered with EGL; MUJOCO_GL selects glfw or osmesa instead.',
        _argument('file', type=Path, metavar='FILE', help='such as out.png or out.jpg'),
        _argument('--size', type=image_size, default=(800, 540), metavar='WIDTHxHEIGHT',
                  help='size of the picture [pixels] (default: 800x540)'),
        _argument('--azimuth', type=number, metavar='DEGREES', help='show one side: 0 looks along '
                  'x, 90 along y'),
        _argument('--elevation', type=number, metavar='DEGREES', help='show one side: negative '
                  'looks down'),
        _argument('--camera', metavar='NAME', help='show the view of a camera of the model')),
    'check': _command(
        'check', 'check the start of a composition, or of an MJCF file',
        'Reports shapes that intersect, blocked joints, joints outside their range, joints with '
        'no actuator, two actuators or one that is too weak, and missing files, and says how to '
        'fix them. A file is checked as it is, at its keyframe home or else at its first one.',
        'examples: manip_sim check --robot UR5e --gripper FourierRightHand\n'
        '          manip_sim check my_robot.xml\n'
        '          manip_sim check --robot FR3 --prefix fr3_ --against /joint_states',
        _argument('file', nargs='?', type=Path, metavar='FILE', help='an MJCF file; one in URDF '
                  'or xacro is checked as a robot'),
        _argument('--against', metavar='TOPIC', help='compare with the joint states of another '
                  'source, such as a real robot: names, ranges, swapped joints; needs ROS')),
    'run': _command(
        'run', 'run a policy on a task for many seeds, and report its success',
        'Writes a row for each episode to episodes.parquet, and the success with its 95 % '
        'interval to summary.json. To continue an interrupted run, repeat the command; with '
        'further --seeds, they are added. An episode in which the policy fails gets a row with '
        'the error, and the exit code is 1.',
        'examples: manip_sim run pick_cube --policy expert --seeds 0:100 --out results\n'
        '          manip_sim run reach --policy my_policy.py:Reach --latency 0.15 --seeds 0:1000 '
        '--out late\n'
        '          manip_sim run pick_cube --policy expert --seeds 0:12 --state-latency '
        '0,0.05,0.1,0.15,0.25,0.4 --out sweep',
        _argument('task', metavar='TASK', help="a task from 'manip_sim list tasks'"),
        _argument('--policy', required=True, help="'expert'; MODULE:CLASS or FILE.py:CLASS with "
                  'reset(seed) and act(observation); MODULE:FUNCTION of an observation; a '
                  'TorchScript (.pt) or ONNX file; or ros:/NAMESPACE of a node that answers '
                  'observations'),
        _argument('--policy-limit', type=positive, metavar='SECONDS', help='longest wall time of '
                  'an answer of the policy; after that, its episode fails (default: 10 for a '
                  'node, 600 for others)'),
        _argument('--seeds', required=True, metavar='SEEDS', help='such as 0:1000, which is 0 to '
                  '999, 0:1000:10 or 1,5,10:20'),
        _argument('--out', required=True, type=Path, metavar='DIR', help='folder of the run'),
        _argument('--robot', default='Panda', metavar='NAME', help='(default: Panda)'),
        _argument('--gripper', default='default', metavar='NAME', help="(default: the robot's "
                  'own, unless the task needs another one)'),
        _argument('--action', default='osc_pose', metavar='KIND', help='osc_pose, joint_position, '
                  'joint_velocity or joint_effort (default: osc_pose)'),
        _argument('--control-hz', type=number, default=20.0, metavar='HZ',
                  help='actions per second of simulated time (default: 20)'),
        _argument('--latency', type=numbers, metavar='SECONDS[,...]', help='delay of each '
                  'command, in simulated time (default: 0); several values make several runs, in '
                  'DIR/latency_SECONDS, with one table'),
        _argument('--state-latency', type=numbers, metavar='SECONDS[,...]',
                  help='age of the observed state (default: 0); several values as above'),
        _argument('--latency-jitter', type=number, metavar='SECONDS', help='standard deviation of '
                  '--latency, drawn from the seed (default: 0)'),
        _argument('--state-latency-jitter', type=number, metavar='SECONDS', help='standard '
                  'deviation of --state-latency, drawn from the seed (default: 0)'),
        _argument('--answer-time', metavar='SECONDS[,...]', help='let the policy think so long in '
                  'simulated time, with nothing commanded meanwhile; measured: as long as it '
                  'takes; several values make several runs, in DIR/answer_time_SECONDS'),
        _argument('--answer-time-jitter', type=number, metavar='SECONDS',
                  help='standard deviation of --answer-time, drawn from the seed (default: 0)'),
        _argument('--chunk-hz', type=positive, metavar='HZ', help='rate of the actions of a '
                  'chunk, shape (actions, n), that the policy returns (default: --control-hz)'),
        _argument('--ask-ahead', type=whole, metavar='N', help='ask the policy again when N '
                  'actions of the chunk are left (default: 0)'),
        _argument('--noise', action='append', metavar='NOISE', help='noise on what is observed: a '
                  "profile ('franka', 'ur', 'ideal'), whose latency applies unless --latency and "
                  'the like are given, a parameter file of the node, or NAME:=VALUE; may be '
                  'repeated, the last one wins'),
        _argument('--randomization', type=Path, metavar='FILE', help='YAML file with '
                  'distributions, drawn at each start from its seed'),
        _argument('--faults', type=Path, metavar='FILE', help='YAML file with faults that are '
                  'planned for each episode, drawn from its seed'),
        _argument('--cameras', action='append', metavar='NAME', help='camera whose images are '
                  'observed, or description of another camera; may be repeated'),
        _argument('--image-size', type=image_size, metavar='WIDTHxHEIGHT',
                  help='size of the images [pixels] (default: that of the camera)'),
        _argument('--worlds', type=count, metavar='N', help='how many episodes run at once, each '
                  'in a process (default: one for each processor)'),
        _argument('--batch', type=count, default=0, metavar='N', help='let the policy act in N '
                  'episodes of a process at once: act(observations, seeds) gets arrays with a '
                  'leading axis; --worlds is then how many batches run at once (default: 1)'),
        _argument('--engine', choices=('processes', 'ray'), default='processes',
                  help='what runs the episodes (default: processes of this machine)'),
        _argument('--address', metavar='ADDRESS', help="address of a Ray cluster, such as 'auto' "
                  '(default: start one here)'),
        _argument('--shard', default='1/1', metavar='I/K', help='run only one of K parts, from '
                  '1/K to K/K; parts in one folder are merged'),
        _flag('--record', help='record each episode in DIR/records/SEED.mcap'),
        _flag('--again', help='remove the rows and records that DIR has, such as those of an '
              'older policy'),
        _flag('--retry-errors', help='run episodes again whose rows have an error')),
    'merge': _command(
        'run', 'merge the folders of shards, or of runs with other seeds',
        '', 'example: manip_sim merge shard1 shard2 --out results',
        _argument('folders', nargs='+', type=Path, metavar='DIR', help='folders of a run'),
        _argument('--out', required=True, type=Path, metavar='DIR', help='folder for the merged '
                  'run')),
    'compare': _command(
        'run:compare_runs', 'compare runs with the same seeds, pair by pair',
        'Shows the success of each run, its difference from the first run with a 95 % interval, p '
        "and mid-p of McNemar's exact test, and the seeds with which only some of them succeed. "
        'The runs may differ in the policy; compares the seeds that all of them have.',
        'examples: manip_sim compare before after --threshold 0.05\n'
        '          manip_sim compare before after --until 0.1 --video videos\n'
        'The exit code is 1 if a run is worse than the first one by more than the threshold, sure '
        'at 95 %; 2 if the runs cannot be compared.',
        _argument('runs', nargs='+', type=Path, metavar='DIR', help="folders of 'manip_sim run'; "
                  'the first one is compared with'),
        _argument('--threshold', type=number, metavar='P', help='exit with 1 if the whole '
                  'interval of a difference is below -P, such as 0.05'),
        _argument('--until', type=number, metavar='WIDTH', help='add seeds to all runs until the '
                  'intervals of the differences are this narrow, such as 0.1'),
        _argument('--most', type=count, metavar='N', help='number of seeds after which --until '
                  'adds none (default: 10000)'),
        _argument('--across', action='append', default=[], metavar='OPTION',
                  help='compare runs that differ in this too, such as latency; may be repeated'),
        _argument('--video', type=Path, metavar='FOLDER', help='show the episodes of the first '
                  'ten seeds that differ beside each other, in FOLDER/SEED.mp4, where the runs '
                  'have records'),
        _argument('--camera', default='frontview', metavar='NAME', help='of the videos (default: '
                  'frontview)'),
        _flag('--json', help='print JSON'),
        _argument('--worlds', type=count, metavar='N', help='as for run, with --until'),
        _argument('--policy-limit', type=positive, metavar='SECONDS', help='as for run, with '
                  '--until')),
    'record': _command(
        'records:record', 'record topics of a running node',
        'Writes an MCAP file as rosbag2 does, with the model, the parameters and the definitions '
        'of all types inside. Ctrl-C ends it and completes the file. It needs ROS.',
        'examples: manip_sim record all.mcap\n'
        "          manip_sim record joints.mcap joint_states '~/mjcf' --duration 10",
        _argument('file', type=Path, metavar='FILE', help='new file, such as out.mcap'),
        _argument('topics', nargs='*', metavar='TOPIC', help='topic of the node; relative names '
                  'are in its namespace (default: all that it publishes or subscribes to)'),
        _argument('--node', default='manip_sim', metavar='NAME', help='full name of the node, '
                  'such as /left/manip_sim (default: /manip_sim)'),
        _argument('--duration', type=positive, metavar='SECONDS', help='end after this wall time '
                  '[s]')),
    'replay': _command(
        'records:replay', 'repeat recorded episodes or nodes in a fresh simulation',
        'Reports how many episodes succeed. With --verify it compares the state of each control '
        'period and the digests with those of the record, and reports in which period it first '
        'differs, or what cannot be repeated.',
        'example: manip_sim replay --verify run.mcap\n'
        'With --verify the exit code is 0 only if all episodes and nodes are equal to the last '
        'bit and the files are complete.',
        _RECORDS,
        _flag('--verify', help='compare states and digests with those of the record')),
    'convert': _command(
        'records:convert', 'convert recorded episodes to a data set for learning',
        'Writes a data set of LeRobot 3.0 (a folder with Parquet and video files), or of '
        'robomimic (an HDF5 file). Actions stay as they were applied, to the last bit.',
        'examples: manip_sim convert records/ --to lerobot pick_cube\n'
        '          manip_sim convert run.mcap --to hdf5 pick_cube.hdf5',
        _RECORDS,
        _argument('--to', choices=('lerobot', 'hdf5'), required=True, help='the format of the '
                  'data set'),
        _argument('out', type=Path, metavar='OUT', help='new folder, or new file'),
        _flag('--only-success', help='leave out episodes without success')),
    'demonstrate': _command(
        'records:demonstrate', 'demonstrate a task with a device, and record it',
        'Moves the end effector by the keyboard, a gamepad, a SpaceMouse or a page in the '
        'browser, in real time, and records each episode in DIR/SEED.mcap. Each record is '
        'repeated at once. A demonstration ends with success, when the time is up, or by a key; a '
        'discarded one begins again.',
        'examples: manip_sim demonstrate pick_cube --device keyboard --out picks\n'
        '          manip_sim demonstrate reach --device file:actions.csv --out reaches\n'
        'The exit code is 1 if a record does not repeat to the last bit, or there is none.',
        _argument('task', metavar='TASK', help="a task from 'manip_sim list tasks'"),
        _argument('--device', required=True, metavar='NAME', help='keyboard, gamepad, spacemouse, '
                  'browser, a leader arm of LeRobot as lerobot:TYPE,OPTION=VALUE, or '
                  'file:ACTIONS.csv with a column for each number of an action'),
        _argument('--out', required=True, type=Path, metavar='DIR', help='folder for the records; '
                  'seeds that it has are left out'),
        _argument('--episodes', type=count, default=1, metavar='N', help='number of '
                  'demonstrations to keep (default: 1)'),
        _argument('--seed', type=whole, default=0, metavar='N', help='of the first start; the '
                  'next ones follow (default: 0)'),
        _argument('--robot', default='Panda', metavar='NAME', help='(default: Panda)'),
        _argument('--gripper', default='default', metavar='NAME', help="(default: the robot's "
                  'own, unless the task needs another one)'),
        _argument('--rate', type=positive, default=20.0, metavar='HZ', help='actions per second '
                  '(default: 20)'),
        _flag('--view', help='show the world on a page in the browser beside another device'),
        _argument('--listen', default='127.0.0.1', metavar='ADDRESS', help='address of the page '
                  'for the browser (default: 127.0.0.1, only this machine)'),
        _argument('--port', type=whole, default=8080, metavar='N', help='port of that page '
                  '(default: 8080)')),
    'identify': _command(
        'identify', 'identify friction and rotor inertia of an arm from recorded joint states',
        'Reads positions and efforts from a record or a bag of rosbag2, and fits armature, '
        'damping and dry friction of each joint to them. The end of the record is held out, and '
        'shows what the values explain. A joint that did not move enough gets no value.',
        'examples: manip_sim identify --excite excitation.mcap --robot UR5e\n'
        '          manip_sim identify bag --robot UR5e --out ur5e.yaml\n'
        "The YAML file is a parameter file of the node, for --params-file here and for 'sim_node "
        "--ros-args --params-file'.",
        _argument('bag', nargs='?', type=Path, metavar='BAG', help='a record, an MCAP file, or '
                  'the folder or *.db3 file of a bag'),
        _argument('--out', type=Path, metavar='YAML', help='write the values to this file'),
        _flag('--json', help='print JSON, in SI units'),
        _argument('--part', default='arm', metavar='PART', help='arm, torso, head, legs or base '
                  '(default: arm)'),
        _argument('--topic', metavar='TOPIC', help='of the joint states (default: joint_states)'),
        _argument('--names', metavar='NAME,...', help='names that the joints of the part have in '
                  'the bag, in their order'),
        _flag('--payload', help='identify a payload at each flange too, beside the gripper'),
        _argument('--cutoff', type=positive, default=4.0, metavar='HZ',
                  help='of the filter of efforts and motion, without phase lag (default: 4)'),
        _argument('--excite', type=Path, metavar='FILE', help='record a motion in simulation from '
                  'which all can be identified: a Fourier series that keeps the limits and meets '
                  'nothing, in a new MCAP file'),
        _argument('--duration', type=positive, default=60.0, metavar='SECONDS',
                  help='of that motion (default: 60)'),
        _argument('--seed', type=whole, default=0, metavar='N', help='that the motion is drawn '
                  'from (default: 0)'))}
#: Those with the options of a composition.
_COMPOSING = ('describe', 'export', 'render', 'check', 'identify')


class _Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f'manip_sim: {message}; see {self.prog} --help\n')

    def _print_message(self, message: str, file: Any = None) -> None:
        with contextlib.suppress(BrokenPipeError):  # As from Python 3.11 on.
            super()._print_message(message, file)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """
    Read a command line.

    Ends the process with exit code 2 if it is wrong, and 0 after ``--help`` and ``--version``.

    :raises ModelError: if it is for a verb of another package that cannot be used
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    parser = _Parser(
        prog='manip_sim', allow_abbrev=False,
        description='List robots, grippers, bases and arenas; describe, check, render and export '
                    'compositions of them; run policies on tasks, and compare the runs; record '
                    'nodes, and repeat and convert records; demonstrate tasks; identify arms; '
                    'topics, parameters and services of nodes. Works without ROS, but for '
                    'record, topic, param and service.',
        epilog=f"For the options of a command, type manip_sim COMMAND --help. {_EXIT_CODES}. "
               "The node is another program, 'sim_node'.")
    parser.add_argument('--version', action='version', version=f'manip_sim {package_version()}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND',
                                     title='commands')
    for name, (module, summary, more, example, command_arguments) in _COMMANDS.items():
        command = _add_command(commands, name, module, summary, more, example)
        _add_all(command.add_mutually_exclusive_group() if name == 'describe' else command,
                 command_arguments)
        if name in _COMPOSING:
            add_composition(command)
    for name, (summary, verbs) in COMMANDS.items():
        command = _add_command(
            commands, name, 'command_line:run_ros_verb', summary,
            f'Type manip_sim {name} VERB --help for its options. It needs ROS, but not ros2.',
            f'verbs: {", ".join(verbs)}')
        added = command.add_subparsers(dest='action', required=True, metavar='VERB', title='verbs')
        for verb, (summary, verb_arguments) in verbs.items():
            _add_all(added.add_parser(verb, help=summary, description=f'{summary.capitalize()}.',
                                      allow_abbrev=False), verb_arguments)
    if not (words and words[0] in commands.choices):
        _add_verbs(commands, words)
        first = words[0] if words else ''
        if first in _PROGRAMS:
            parser.error(f"{first} is a program of its own: type '{first}' without 'manip_sim'")
        if first.startswith('-') and first not in ('-h', '--help', '--version'):
            parser.error(f"a COMMAND comes before '{first}', as in: manip_sim describe --robot "
                         'Panda')
    options, left = parser.parse_known_args(words)
    if options.command == 'convert' and len(left) == 1 and not left[0].startswith('-'):
        # Of several files before --to, argparse takes the last one for OUT, which comes after it.
        options.files.append(options.out)
        options.out = Path(left.pop())
    hint = ' (options name the parts: --robot NAME)' if hasattr(options, 'robot') and left and (
        not left[0].startswith('-')) else ''
    problem = f'unrecognized arguments: {" ".join(left)}{hint}' if left else _conflict(options)
    if problem:
        commands.choices[options.command].error(problem)
    return options


def _add_verbs(commands: Any, words: Sequence[str]) -> None:
    """Add the verbs of other packages; one that cannot be used is logged, unless it is asked."""
    for name, offer in offers(GROUP).items():
        try:
            if name in commands.choices:
                raise ModelError(f'{offer} is ignored: manip_sim has a command of that name')
            verb = OfferedVerb(offer)
            parser = _add_command(commands, name, '', verb.summary)
            parser.set_defaults(verb=verb)
            verb.add_arguments(parser)
        except ModelError as error:
            if words[:1] == [name]:
                raise ModelError(f'command {error}') from error
            logging.getLogger('manip_sim').warning('command %s', error)


def _conflict(options: argparse.Namespace) -> str | None:
    """Return which options do not go together, or None."""
    names = [name for name in COMPOSITION if getattr(options, name, None) is not None]
    if options.command == 'check' and options.file is not None and (names or options.against):
        return 'check either a FILE or a composition, not both'
    if 'params_file' in names and len(names) > 1:
        other = next(name for name in names if name != 'params_file').replace('_', '-')
        return f'--params-file cannot be combined with --{other}'
    if options.command == 'export':
        folder = isinstance(options.ros2_control, Path)
        if (options.file is not None) + (options.moveit is not None or folder) != 1:
            return 'give either a FILE, or --moveit DIR, --ros2-control DIR, or both of them'
        if options.ros2_control and not folder and (
                options.moveit or options.file.suffix.lower() != '.urdf'):
            return '--ros2-control without DIR is for a .urdf'
        if options.name and (options.file is None or options.file.suffix.lower() != '.urdf'):
            return '--name is for a .urdf'
    if options.command == 'compare':
        return _conflict_of_comparison(options)
    if options.command == 'identify' and (options.bag is None) == (options.excite is None):
        return 'give either a BAG, or --excite FILE to record one'
    if options.command != 'render':
        return None
    if options.camera is not None and (options.azimuth, options.elevation) != (None, None):
        return 'use either --camera or --azimuth and --elevation'
    alone = [name for name in ('gripper', 'base', 'arena') if getattr(options, name) is not None]
    if options.robot == 'none' and len(alone) != 1:
        return "with '--robot none' give one of --gripper, --base and --arena to be shown alone"
    return None


def _conflict_of_comparison(options: argparse.Namespace) -> str | None:
    if len(options.runs) < 2:
        return 'give at least two runs'
    for name in ('threshold', 'until'):
        value = getattr(options, name)
        if value is not None and not 0.0 <= value <= 1.0:
            return f'--{name} is a share of episodes from 0 to 1, got {value:g}'
    if options.until == 0.0:
        return '--until must be above 0'
    if options.until is None and options.most is not None:
        return '--most is for --until'
    return None


def _add_command(commands: Any, name: str, module: str, summary: str, more: str = '',
                 example: str = '') -> Any:
    description = f'{summary[0].upper()}{summary[1:]}. {more}'.strip()
    # The epilog has lines of its own, so argparse must not wrap either.
    width = max(shutil.get_terminal_size().columns - 2, _NARROWEST)
    parser = commands.add_parser(
        name, help=summary, allow_abbrev=False, description=textwrap.fill(description, width),
        formatter_class=argparse.RawDescriptionHelpFormatter, epilog=f'{example}\n{_EXIT_CODES}')
    parser.set_defaults(module=module, verb=None)
    return parser


def _add_all(parser: Any, arguments: Sequence[_Argument]) -> None:
    for names, settings in arguments:
        parser.add_argument(*names, **settings)


def add_composition(parser: argparse.ArgumentParser) -> None:
    """Add the options of a composition, which ``compose_from`` reads."""
    _add_all(parser.add_argument_group('composition', "For the names, type 'manip_sim list'."),
             _COMPOSITION)


def run_ros_verb(options: argparse.Namespace) -> tuple[str, int]:
    """Run a verb, which prints by itself; ManipSimError without ROS, or as the verb."""
    check_ros_environment()
    try:
        from manip_sim.cli.ros_commands import run_verb
    except ImportError as error:
        raise ManipSimError(missing_module(error)) from error
    return '', run_verb(options)
