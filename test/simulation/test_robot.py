# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a simulation knows of a robot at its start."""

import numpy as np
import pytest
from sampling import whole_robot

from manip_sim.control.commands import Command, GripperSuction, Status
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.interface.part_parameters import commanded_parts, mode_parameters
from manip_sim.interface.topics import Scope
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.runtime.action_goals import GripperGoal, GripperRequest
from manip_sim.simulation import Simulation


def test_the_joints_of_a_twist_are_those_of_a_mobile_base_and_others_have_none():
    assert whole_robot('Panda').robot.twist_joints == ()
    base = whole_robot('PandaOmron').robot.twist_joints
    assert [next(word for word in ('forward', 'side', 'yaw') if word in joint)
            for joint in base] == ['forward', 'side', 'yaw']


def test_shapes_that_are_only_seen_are_left_out_unless_they_are_wanted():
    world = compose('Panda')
    seen, simulated = Simulation(world, visual=True).model, Simulation(world).model
    assert simulated.ngeom < seen.ngeom
    collides = (seen.geom_contype != 0) | (seen.geom_conaffinity != 0)
    assert simulated.ngeom >= collides.sum()
    assert (simulated.nq, simulated.nu) == (seen.nq, seen.nu)


def test_no_command_has_come_too_late_at_the_start():
    timeouts = whole_robot('PandaOmron').robot.joints.timeouts
    assert {'arm', 'torso', 'base'} <= set(timeouts) and set(timeouts.values()) == {0}


@pytest.mark.parametrize('part', ['arm', 'right/gripper'])
def test_a_robot_moves_and_does_not_rest_while_its_joints_or_its_fingers_move(panda_sim, part):
    robot = panda_sim.robot
    panda_sim.advance(1)
    assert robot.resting and not robot.moving
    length = robot.grippers[part].dof if part in robot.grippers else 7
    robot.apply(robot.parse.action(part, [0.5] * length))
    panda_sim.advance(1)
    assert robot.moving and not robot.resting


def commands_of_every_kind(robot):
    """Return a command of each kind for a PandaOmron."""
    parse, poses = robot.parse, robot.parse_cartesian
    robot.set_control_mode('base', 'velocity')
    joints = list(robot.joints.names)
    torso = joints[robot.joints.indices_of('torso')[0]]
    robot.set_control_mode('torso', 'impedance')
    return [
        *parse.joint_impedance([torso], [0.1], stiffness=1000.0),
        parse.action('arm', [0.5] * 7), parse.action('right/gripper', [1.0]),
        *parse.joint_command([*joints[-1:], *robot.grippers['right/gripper'].joints.names[:1]],
                             [0.1, 0.02]),
        *parse.joint_command(joints[:1]),
        parse.trajectory('arm', joints[:1], [1.0], [[0.3]]), parse.trajectory('arm', [], [], []),
        parse.twist(0.1, 0.0, 0.0), poses.pose('right', [0.4, 0.0, 1.2], [1.0, 0.0, 0.0, 0.0]),
        poses.twist('right', [0.1, 0.0, 0.0], [0.0] * 3), poses.action('right', [0.5] * 6),
        GripperSuction(robot=robot.robot_model, parts=frozenset({'right/gripper'}),
                       indices=np.arange(2), controls=np.zeros(2)),
        poses.until_contact('right', [0.1, 0.0, 0.0], [0.0] * 3, force=1.0, distance=1.0,
                            duration_s=1.0), *wrenches_of_impedance(robot),
        GripperGoal(robot, 'right/gripper', GripperRequest(0.02)).command]


def wrenches_of_impedance(robot):
    robot.set_control_mode('arm', 'effort')
    robot.joints.cartesian.set('right', 'cartesian_stiffness', [300.0] * 6)
    parse = robot.parse_cartesian
    return [parse.wrench('right', [0.0, 0.0, 1.0], [0.0] * 3),
            parse.force_mode('right', [0, 0, 1, 0, 0, 0], [1.0] * 6, [0.1] * 6)]


def concrete_kinds(kind=Command):
    below = [leaf for child in kind.__subclasses__() for leaf in concrete_kinds(child)]
    return below or [kind]


def test_a_command_for_another_robot_is_rejected_and_moves_nothing(panda_sim):
    foreign = commands_of_every_kind(whole_robot('PandaOmron').robot)
    assert {type(command) for command in foreign} >= set(concrete_kinds())
    robot = panda_sim.robot
    start = robot.state().position
    for command in foreign:
        own = robot.parse.action('arm', [0.5] * 7)
        with pytest.raises(CommandError, match=r"^a command for robot 'robot0' cannot be applied "
                                               r"to robot 'robot0' of this simulation$"):
            robot.apply(own, command)
        with pytest.raises(CommandError, match='cannot be applied'):
            robot.withdraw(command, 'nobody wants it')
        assert own.handle.status is command.handle.status is Status.WAITING
    panda_sim.advance(100)
    np.testing.assert_allclose(robot.state().position, start, atol=1e-6)


def test_a_robot_takes_its_commands_in_every_simulation_of_its_world():
    world = compose('Panda')
    first, second = Simulation(world), Simulation(world)
    command = first.robot.parse.action('arm', [0.5] * 7)
    second.robot.apply(command)
    assert command.handle.status is Status.RUNNING


@pytest.mark.parametrize('name', robot_names())
def test_each_part_starts_in_the_mode_in_which_it_starts_in_the_node(name):
    robot = Simulation(compose(name)).robot
    parts = commanded_parts(robot.parts)
    specs = {spec.name: spec.default for spec in mode_parameters(Scope(), parts)}
    for part in parts:
        modes = set(robot.joints.modes_of(robot.joints.indices_of(part)))
        assert modes == {specs[f'control_mode.{part}']} == {
            'velocity' if part == 'base' else 'position'}


def test_streams_of_a_robot_may_be_slow_and_go_on_for_longer():
    robot = Simulation(compose('Baxter')).robot
    left = robot.joints.indices_of('left')
    robot.set_stream('left', longest_s=0.5)
    robot.set_stream('left', hold_s=0.2)  # The other one stays.
    setpoints = robot.joints.setpoints
    settings = [setpoints.stream_settings(i) for i in range(len(setpoints.position))]
    assert [i for i, own in enumerate(settings) if own == (0.5, 0.2)] == sorted(left)
    with pytest.raises(CommandError, match='^left/gripper is a gripper'):
        robot.set_stream('left/gripper', 0.5)
    with pytest.raises(UnknownNameError, match="unknown part 'legs'"):
        robot.set_stream('legs', 0.5)
