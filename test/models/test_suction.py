# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The suction cup holds what its data sheet says, and only what its whole lip touches."""

import mujoco
import pytest

from gripper_rig import GripperRig

from manip_sim.control.commands import Status
from manip_sim.runtime.action_goals import Ending, GoalError, gripper_goal, GripperRequest

GRIPPER = 'right/gripper'
#: Area of a cup of 40 mm [m^2] and full vacuum [Pa], by OnRobot; height of the cup [m].
AREA_M2, VACUUM_PA, CUP_M = 450e-6, 81e3, 0.108
EDGE_M, G = 0.1, 9.81


def box(mass_kg, x_m=0.0, kind=mujoco.mjtGeom.mjGEOM_BOX, quat=(1.0, 0.0, 0.0, 0.0)):
    """Return a part that stands on the table, 0.1 m high."""
    def add(spec):
        body = spec.worldbody.add_body(name='part', pos=[x_m, 0.0, EDGE_M / 2.0], quat=quat)
        body.add_freejoint()
        body.add_geom(name='part', type=kind, size=[EDGE_M / 2.0] * 3, mass=mass_kg,
                      friction=[1.0, 0.005, 0.0001])
    return add


def lying_cylinder(mass_kg):
    """Return a cylinder that lies on the table."""
    return box(mass_kg, 0.0, mujoco.mjtGeom.mjGEOM_CYLINDER, (0.5**0.5, 0.5**0.5, 0.0, 0.0))


class Suction:
    """A cup that is pressed on a part, sucks, and is lifted."""

    def __init__(self, part, press_m=0.001):
        self.rig = GripperRig('VacuumGripper', part)
        self.data, self.cups = self.rig.data, self.rig.fingers.cups
        self.rig.move(EDGE_M + CUP_M - press_m, -1.0)

    def height(self):
        return self.data.body('part').xpos[2] - EDGE_M / 2.0

    def held(self):
        return self.cups.held(self.data)[0] == self.rig.model.body('part').id

    def start(self, position, **more):
        goal = gripper_goal(self.rig.simulation.robot, GRIPPER, GripperRequest(position, **more))
        self.rig.simulation.robot.apply(goal.command, period_s=0.01)
        self.rig.action = None
        return goal

    def run(self, goal, seconds=3.0):
        for period in range(round(seconds * 100)):
            self.rig.wait(0.01)
            goal.check(self.rig.simulation)
            if goal.outcome is not None:
                return (period + 1) * 0.01
        raise AssertionError('the goal has not ended')


@pytest.mark.parametrize(('share', 'holds'), [(0.97, True), (1.03, False)])
def test_cup_holds_what_its_sheet_says_and_not_more(share, holds):
    suction = Suction(box(share * AREA_M2 * VACUUM_PA / G))
    suction.rig.advance(1.0, 1.0)
    assert suction.held()
    # So slowly that the acceleration takes less than a hundredth of the force.
    robot = suction.rig.simulation.robot
    robot.apply(robot.parse.trajectory('arm', ['robot0_carriage'], [1.3],
                                       [[suction.rig.carriage_height() + 0.02]]))
    suction.rig.wait(1.6)
    assert suction.held() == holds
    assert suction.height() == pytest.approx(0.02 if holds else 0.0, abs=0.003)
    reading = suction.data.sensor('gripper0_suction_force').data[0]
    assert reading == pytest.approx(AREA_M2 * VACUUM_PA if holds else 0.0, rel=1e-3)


def test_action_of_plus_one_sucks_zero_goes_on_and_minus_one_lets_go_in_the_times_of_the_sheet():
    suction = Suction(box(0.2))
    suction.rig.advance(1.0, 0.35)
    assert suction.cups.vacuum(suction.data)[0] == pytest.approx(0.95 * 81.0, abs=2.0)
    suction.rig.advance(0.0, 0.3)
    suction.rig.move(EDGE_M + CUP_M + 0.1, 0.0)
    assert suction.held() and suction.height() == pytest.approx(0.1, abs=0.005)
    suction.rig.advance(-1.0, 0.22)
    assert suction.cups.vacuum(suction.data)[0] < 1.0
    suction.rig.wait(0.5)
    assert not suction.held() and suction.height() < 0.01


@pytest.mark.parametrize('part', [
    box(0.1, EDGE_M / 2.0 - 0.01), lying_cylinder(0.1)], ids=['edge', 'round'])
def test_cup_that_does_not_seal_lifts_nothing(part):
    suction = Suction(part)
    goal = suction.start(1.0)
    assert suction.run(goal) == pytest.approx(1.0, abs=0.05)
    assert goal.outcome.ending is Ending.ABORTED and 'does not seal' in goal.outcome.reason
    assert goal.view.reached is False and goal.view.position < 0.05
    suction.rig.wait(0.2)
    suction.rig.move(EDGE_M + CUP_M + 0.1, 0.0)
    assert suction.height() < 0.01


def test_cup_that_goes_on_sucking_takes_the_part_that_it_comes_to():
    suction = Suction(box(0.3), press_m=-0.05)
    suction.rig.advance(1.0, 0.3)
    assert suction.cups.vacuum(suction.data)[0] == 0.0
    suction.rig.move(EDGE_M + CUP_M, 1.0)
    suction.rig.wait(0.5)
    suction.rig.move(EDGE_M + CUP_M + 0.1, 1.0)
    assert suction.held() and suction.height() == pytest.approx(0.1, abs=0.005)


def test_goal_of_a_gripper_command_is_reached_with_what_is_held_and_keeps_to_its_force():
    suction = Suction(box(0.3))
    goal = suction.start(1.0)
    assert suction.run(goal) == pytest.approx(0.35, abs=0.03)
    assert goal.outcome.ending is Ending.SUCCEEDED and goal.view.reached
    assert goal.view.effort == pytest.approx(0.95 * 36.45, abs=0.5)
    weak = suction.start(1.0, max_effort=10.0)
    suction.run(weak)
    suction.rig.wait(0.5)
    assert suction.data.sensor('gripper0_suction_force').data[0] == pytest.approx(10.0, rel=0.01)
    goal = suction.start(0.0)
    assert suction.run(goal) < 0.25 and goal.view.position == pytest.approx(0.0, abs=0.05)
    assert goal.outcome.ending is Ending.SUCCEEDED


def test_goal_is_replaced_by_an_action_and_checked():
    suction = Suction(box(0.3))
    goal = suction.start(1.0)
    suction.rig.advance(-1.0, 0.05)
    goal.check(suction.rig.simulation)
    assert goal.outcome.ending is Ending.ABORTED
    assert goal.command.handle.status in (Status.REPLACED, Status.DONE)
    for request, match in ((GripperRequest(float('nan')), 'position must be finite'),
                           (GripperRequest(1.0, max_effort=-1.0), 'not negative'),
                           (GripperRequest(1.0, joint='thumb'), 'thumb')):
        with pytest.raises(GoalError, match=match):
            gripper_goal(suction.rig.simulation.robot, GRIPPER, request)


def test_restored_state_goes_on_with_the_same_bits_while_a_part_is_held():
    suction = Suction(box(0.3))
    simulation = suction.rig.simulation
    suction.rig.advance(1.0, 0.2)
    state, digests = simulation.save(), []
    for _ in range(2):
        suction.rig.wait(0.3)
        digests.append(simulation.digest())
        simulation.restore(state)
    assert digests[0] == digests[1]
