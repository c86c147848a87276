# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Features of a node: each is told of each event, in the order of the list."""

import numpy as np
import pytest
from rclpy.parameter import Parameter

from manip_sim.models.user_files import AllowedRoots
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.ros.feature import Feature
from manip_sim.ros.sim_node import SimNode
from manip_sim.ros.spawning_services import add_robot, delete_robot
from manip_sim.simulation.robot_spawning import plan_with_robot, RequestedRobot


class Recorder(Feature):
    """Records its calls, with what holds for the node at each."""

    def __init__(self, name, context, calls):
        self._name, self._context, self._calls = name, context, calls

    def _record(self, event, *facts):
        self._calls.append((event, self._name, *facts))

    def start(self):
        self._record('start', self._context.thread._thread.is_alive())

    def started(self):
        self._record('started', self._context.thread._thread.is_alive())

    def robot_added(self, scope, robot):
        self._record('added', scope.name, robot.name, self._context.robots[scope] is robot,
                     f'{scope.name}.control_mode.arm' in self._context.parameters.names)

    def robot_removed(self, scope):
        self._record('removed', scope.name, scope.name in self._context.simulation.robots)

    def world_changed(self):
        self._record('changed', *self._context.simulation.robots,
                     *(scope.name for scope in self._context.robots if scope.name))

    def parameters_changed(self, parameters):
        self._record('parameters', *(parameter.name for parameter in parameters))

    def close(self):
        self._record('closed', self._context.thread._thread.is_alive())


@pytest.fixture
def recorded(serve, monkeypatch):
    """Return a node whose last features are two that record their calls, and these calls."""
    calls, add = [], SimNode._add_features

    def add_recorders(node, context, *arguments):
        add(node, context, *arguments)
        node.shared.features += [Recorder(name, context, calls) for name in ('a', 'b')]
    monkeypatch.setattr(SimNode, '_add_features', add_recorders)
    node = serve(arena='table')
    return node, calls


def events(calls, *names):
    """Return what has been recorded since the last call, and forget it."""
    taken, calls[:] = [*calls], []
    assert [call[1] for call in taken] == ['a', 'b'] * (len(taken) // 2)
    assert [call[0] for call in taken[::2]] == [*names]
    for one, other in zip(taken[::2], taken[1::2]):
        assert (one[0], *one[2:]) == (other[0], *other[2:])
    return [(one[0], *one[2:]) for one in taken[::2]]


def in_executor(node, client, function, *arguments):
    task = node.executor.create_task(function, *arguments)
    client.spin_until(task.done)
    return task.result()


def test_features_are_told_of_the_start_of_robots_parameters_and_the_end(recorded, client):
    node, calls = recorded
    told = events(calls, 'parameters', 'start', 'started')
    assert told == [('parameters',), ('start', False), ('started', True)]
    node.set_parameters([Parameter('real_time_factor', value=2.0)])
    assert events(calls, 'parameters') == [('parameters', 'real_time_factor')]
    node.shared.parameters.show({'real_time_factor': 1.5})  # It acts already.
    assert events(calls, 'parameters') == [('parameters',)]
    plan = plan_with_robot(node.simulation, RequestedRobot(
        {'robot': 'UR5e'}, 'test', AllowedRoots([], 'spawn_roots')).create(
            'left', Pose(np.array([0.0, 2.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))))
    in_executor(node, client, add_robot, node.shared, 'left', plan)
    added = next(i for i, call in enumerate(calls) if call[0] != 'parameters')
    assert {call[2] for call in calls[:added]} >= {'left.spawned', 'left.control_mode.arm'}
    del calls[:added]
    told = events(calls, 'added', 'changed')
    assert told == [('added', 'left', 'left', True, True), ('changed', 'robot0', 'left', 'left')]
    in_executor(node, client, delete_robot, node.shared, 'left')
    assert events(calls, 'removed', 'changed') == [
        ('removed', 'left', True), ('changed', 'robot0')]
    node.stop()
    assert calls == [('closed', 'b', False), ('closed', 'a', False)]
    node.stop()
    assert len(calls) == 2
