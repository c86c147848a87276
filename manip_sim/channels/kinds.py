# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The channels of robots, objects, arenas, instruments and lidars."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.channels import contents
from manip_sim.channels.contents import Channel, Make, Read
from manip_sim.control.controlled_joints import ControllerState
from manip_sim.frame_names import FrameNames, ROOT
from manip_sim.interface.offered_sensors import Offered
from manip_sim.interface.parameters import periods_per_message
from manip_sim.interface.topics import (
    BY_NAME, PUBLISHED, Scope, TOKEN, Topic, topics_of, topics_of_instruments, topics_of_lidars,
    topics_of_objects, topics_of_surroundings)
from manip_sim.models.cameras import LidarModel
from manip_sim.sensing.robot_sensing import ODOM
from manip_sim.simulation import SimulatedRobot, Simulation

#: By the name in a row of the table: message and length of a reading of an arm.
_ARM: dict[str, tuple[Make, int]] = {
    'wrench': (contents.wrench, 6), 'external_wrench': (contents.wrench, 6),
    'pose': (contents.pose, 7), 'twist': (contents.twist, 6)}


def clock_channel() -> Channel:
    """Return the channel of the simulation time."""
    nothing = np.empty(0)
    return Channel(BY_NAME['/clock'], lambda _: nothing, contents.clock, 0)


def robot_channels(robot: SimulatedRobot, scope: Scope, prefix: str = '',
                   controller_type: str = contents.CONTROLLER_STATE) -> list[Channel]:
    """
    Return the states of a robot, its parts and its arms.

    :param scope: namespace of the topics
    :param prefix: of the names of frames
    :param controller_type: of the states of controllers, as ``contents.controller_state``
    """
    channels = []
    for row in topics_of(robot.parts, twist=True):
        topic, part, sensing = replace(row, name=scope.topic(row.name)), row.of, robot.sensing
        if row.direction != PUBLISHED:
            continue
        if row.by == 'joints':
            names = robot.parts[part].joints if part else robot.joint_names
            channel = Channel(topic, _reading(robot.reader.measured, part or None),
                              contents.joint_state(names), 3 * len(names))
            channels.append(channel.beside(
                _reading(robot.reader.exact, part or None), row, scope, sensing))
        elif row.by in _ARM:
            make, count = _ARM[row.by]
            frame = ROOT if row.by in ('pose', 'twist') else robot.end_effectors[part].wrench_frame
            name = f'{part}/{row.by}'
            channel = Channel(topic, _reading(sensing.measured, name), make, count, prefix + frame)
            channels.append(channel.beside(_reading(sensing.exact, name), row, scope, sensing))
        elif row.by == 'controllers':
            joints = robot.controller_state(part).names
            channels.append(Channel(
                replace(topic, type=controller_type), partial(_controllers, robot, part),
                contents.controller_state(joints, controller_type), contents.ROWS * len(joints)))
    return channels


def _reading(read: Callable[..., FloatArray], name: str | None) -> Read:
    return lambda _: read(name)


def _controllers(robot: SimulatedRobot, part: str, _: Simulation) -> FloatArray:
    return controller_numbers(robot.controller_state(part))


def controller_numbers(state: ControllerState) -> FloatArray:
    """
    Return the numbers of a message; without a setpoint the reference is the measured state.

    :returns: rows, of n joints each: position, velocity, acceleration and effort of the reference;
        measured position, velocity and effort; error of position and velocity; shape (9 n,)
    """
    reference, gives = state.reference, state.reference.gives_effort
    position, velocity, acceleration = (
        reference.position, reference.velocity, reference.acceleration)
    if gives.any():
        position = np.where(gives, state.position, position)
        velocity = np.where(gives, state.velocity, velocity)
        acceleration = np.where(gives, 0.0, acceleration)
    return np.concatenate([
        position, velocity, acceleration, reference.effort,
        state.position, state.velocity, state.effort,
        position - state.position, velocity - state.velocity])


def odometry_channel(robot: SimulatedRobot, scope: Scope, frame: str, base: str) -> Channel:
    """
    Return the pose of a base in the frame of its odometry, and its twist in its own axes.

    :param scope: namespace of the topic
    :param frame: name of the frame of the odometry
    :param base: name of the frame of the base
    """
    row, sensing = BY_NAME['odom'], robot.sensing
    return Channel(
        replace(row, name=scope.topic(row.name)), _reading(sensing.measured, ODOM),
        contents.odometry(base), 13, frame).beside(
            _reading(sensing.exact, ODOM), row, scope, sensing)


def object_channels(simulation: Simulation, prefix: str = '') -> list[Channel]:
    """
    Return the states of free and mocap bodies, of joints of the arena and of other actuators.

    Nothing is read of bodies and actuators that are gone.

    :param prefix: of the names of frames
    """
    surroundings = simulation.surroundings
    rows = [row for row in (
        *topics_of_objects(filter(TOKEN.fullmatch, simulation.entities.free_names)),
        *topics_of_surroundings(surroundings)) if row.direction == PUBLISHED]
    # Actuators that come and go are last.
    return [object_channel(simulation, row, prefix) for row in sorted(
        rows, key=lambda row: row.by == 'loose_actuators')]


def object_channel(simulation: Simulation, row: Topic, prefix: str = '') -> Channel:
    """
    Return one of :func:`object_channels`.

    :param row: of the table, filled in
    :param prefix: of the names of frames
    """
    surroundings, names = simulation.surroundings, simulation.surroundings.other_actuators
    if row.by == 'arena_joints':
        joints = surroundings.joints
        return Channel(row, lambda _: surroundings.state(), contents.joint_state(joints),
                       3 * len(joints))
    if row.by == 'loose_actuators':
        return Channel(
            row, lambda _: (surroundings.state_of_actuators()
                            if surroundings.other_actuators == names else None),
            contents.joint_state(names), 3 * len(names))
    make, count = _ARM[row.by.removeprefix('object_')]

    def read(simulation: Simulation) -> FloatArray | None:
        entities = simulation.entities
        if row.of in entities.free_names:
            of_body = entities.pose if row.by == 'object_pose' else entities.twist
            return of_body(simulation.data, row.of)
        return surroundings.pose(row.of) if row.of in surroundings.mocap_names else None
    return Channel(row, read, make, count, prefix + ROOT)


def instrument_channels(simulation: Simulation, robots: Mapping[Scope, SimulatedRobot],
                        every: Mapping[str, int], noisy: Iterable[str], prefix: str = ''
                        ) -> Iterator[Channel]:
    """
    Yield what the instruments of the model measure; nothing is read of those that are gone.

    :param robots: by the scope of their topics
    :param every: control periods for each message, by the name of the instrument, where not one
    :param noisy: names of those with noise of their own
    :param prefix: of the names of frames
    """
    first = next(iter(robots.values()), None)
    for instrument, scope, row in topics_of_instruments(simulation, robots):
        channel = Channel(
            replace(row, name=scope.topic(row.name)), partial(_measured, instrument.name),
            contents.OF_INSTRUMENTS[instrument.kind](instrument), instrument.length,
            instrument.frame and prefix + instrument.frame, every.get(instrument.name, 1))
        robot = robots.get(scope, first)
        yield channel if robot is None else channel.beside(
            partial(_exact, instrument.name), row, scope, robot.sensing, instrument.name in noisy)


def _measured(name: str, simulation: Simulation) -> FloatArray | None:
    instrument = simulation.sensors.instrument(name)
    return None if instrument is None else simulation.instruments.measured(instrument)


def _exact(name: str, simulation: Simulation) -> FloatArray | None:
    instrument = simulation.sensors.instrument(name)
    return None if instrument is None else instrument.read(simulation.data)


def lidar_channel(simulation: Simulation, fixed: LidarModel, period_s: float, prefix: str = ''
                  ) -> Channel:
    """
    Return what a lidar measures.

    :param period_s: length of a control period [s]
    :param prefix: of the names of frames
    """
    name, model, lidars = fixed.name, simulation.model, simulation.lidars
    lidar, rings = lidars[name], fixed.rays.rings
    every = periods_per_message(1.0 / period_s, fixed.rate_hz)
    (row,) = topics_of_lidars({name: rings > 1})
    return Channel(
        row, _reading(lidars.measured, name), contents.laser_scan(lidar, every * period_s)
        if rings == 1 else contents.ring_cloud(lidar), lidar.rays.samples * rings,
        prefix + FrameNames(model).sites[model.site(name).id], every, patches=False).beside(
            _reading(lidars.exact, name), row, Scope(), lidars.sensing(name), bool(fixed.noise))


def offered_channel(offered: Offered, simulation: Simulation, prefix: str = '') -> Channel:
    """
    Return the channel of a sensor of another package, with an instance of its own.

    :param prefix: of the names of frames
    :raises ModelError: if it cannot be made
    """
    source = offered.create(simulation)
    return Channel(offered.topic, lambda _: None, lambda head, _: {}, 0,
                   source.frame and prefix + source.frame, patches=False, write=source.write,
                   offer=str(offered.offer))
