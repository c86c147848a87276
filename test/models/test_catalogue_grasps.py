# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every gripper of the catalogue opens, closes and holds a part; forces are the datasheet's."""

from functools import cache

import mujoco
import numpy as np
import pytest

from catalogue import figures, GRIPPERS
from gripper_rig import cube, cylinder, GripperRig, PARK_HEIGHT_M

from manip_sim.models.grippers import create_gripper

GRASPS = figures('grasps.json')
DATASHEETS = figures('datasheets.json')['grippers']
CLEARANCE_M = 0.005
LIFT_M = 0.1


def has_pads(name):
    """Tell whether a gripper has two sides that close on something."""
    roles = create_gripper(name).important_geoms
    return bool(roles['left_fingerpad'] and roles['right_fingerpad'])


PINCHING = [name for name in GRIPPERS if has_pads(name) and name not in GRASPS['cylinders']]


def stated(figure):
    """Return the grippers whose datasheets state a figure."""
    return [name for name in PINCHING if figure in DATASHEETS.get(name, {})]


def closing(name):
    """Return the action that closes a gripper."""
    return GRASPS['closing_action'].get(name, 1.0)


def running_median(values):
    """Return the median of each value and its four neighbours on either side, shape (n,)."""
    padded = np.pad(values, 4, mode='edge')
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 9), axis=1)


class Stroke:
    """
    One closing in free air.

    :ivar times: since the first closing action [s], shape (n,)
    :ivar gaps: between the pads [m], shape (n,)
    :ivar pads: middles of the pads seen from the carriage [m], shape (n, 2, 3)
    :ivar lowest: of the collision shapes seen from the carriage [m], shape (n,)
    """

    def __init__(self, name):
        rig = GripperRig(name)
        rig.actuate(np.negative(closing(name)))
        rows = []
        last_change = 0.0
        while not rows or rows[-1][0] - last_change < 0.3:
            height = rig.carriage_height()
            pads = rig.pads() - [0.0, 0.0, height]
            rows.append((0.01 * len(rows), rig.pad_gap(), pads, rig.lowest_point() - height))
            rig.advance(closing(name), 0.01)
            if rig.fingers.moving:
                last_change = rows[-1][0]
            assert rows[-1][0] < 15.0, f'{name} has not closed after 15 s'
        times, gaps, middles, lowest = zip(*rows)
        # Old versions of MuJoCo give a distance of zero now and then.
        self.times, self.gaps = np.array(times), running_median(np.array(gaps))
        self.pads, self.lowest = np.array(middles), np.array(lowest)

    def duration_s(self):
        """Return how long the pads took for 95 % of their way."""
        left = self.gaps - self.gaps.min()
        return self.times[np.argmax(left < 0.05 * left[0])]

    def cube_edge_m(self):
        """Return the edge of a cube that fits well between the pads."""
        for edge in (0.05, 0.04, 0.06, 0.07):
            if self.gaps.min() + CLEARANCE_M < edge < self.gaps[0] - CLEARANCE_M:
                return edge
        raise AssertionError(f'no cube of 4 to 7 cm fits: the pads go from {self.gaps[0]:.3f} m '
                             f'to {self.gaps.min():.3f} m')


stroke_of = cache(Stroke)


class Lift:
    """
    A cube that is grasped and lifted.

    :ivar rose: how far the cube rose [m]
    :ivar slipped: how far it moved in the gripper's frame in 2 s [m]
    :ivar force: with which either side presses, horizontally [N]
    """

    def __init__(self, name):
        stroke, action = stroke_of(name), closing(name)
        edge = stroke.cube_edge_m()
        at_cube = np.argmax(stroke.gaps <= edge)
        middle = stroke.pads[at_cube].mean(axis=0)
        across = np.diff(stroke.pads[at_cube], axis=0)[0]
        rig = GripperRig(name, cube(edge, middle[0], middle[1], np.arctan2(across[1], across[0])))
        low = max(edge / 2.0 - middle[2], 0.002 - stroke.lowest[:at_cube + 1].min())
        rig.actuate(np.negative(action))
        rig.move(low, np.negative(action))
        rig.actuate(action)
        rig.move(low + LIFT_M, action)
        part = rig.data.body('part')
        before = part.xpos - [0.0, 0.0, rig.carriage_height()]
        forces = []
        for _ in range(20):
            rig.advance(action, 0.1)
            forces.append([np.linalg.norm(rig.force_on_part(f'{side}_finger')[:2])
                           for side in ('left', 'right')])
        self.rose = part.xpos[2] - edge / 2.0
        self.slipped = np.linalg.norm(part.xpos - [0.0, 0.0, rig.carriage_height()] - before)
        self.force = np.mean(forces)


lift_of = cache(Lift)


@pytest.mark.parametrize('name', PINCHING)
def test_plus_one_closes_and_minus_one_opens(name):
    gaps = stroke_of(name).gaps
    # Fingers that stand side by side pass each other at the end; the pads are apart again then.
    assert gaps.min() < gaps[0] - 0.02
    assert gaps[-1] < gaps[0]


@pytest.mark.parametrize('name', PINCHING)
def test_a_cube_is_lifted_and_held(name):
    lift = lift_of(name)
    assert lift.rose > LIFT_M - 0.01
    assert lift.slipped < 0.005


@pytest.mark.parametrize('name', stated('stroke_m'))
def test_the_stroke_is_that_of_the_datasheet(name):
    gaps = stroke_of(name).gaps
    assert gaps[0] - gaps.min() == pytest.approx(DATASHEETS[name]['stroke_m'], rel=0.1)


@pytest.mark.parametrize('name', stated('grip_force_n'))
def test_the_grip_force_is_in_the_range_of_the_datasheet(name):
    low, high = DATASHEETS[name]['grip_force_n']
    assert low <= lift_of(name).force <= high


@pytest.mark.parametrize('name', stated('closing_time_s'))
def test_closing_takes_as_long_as_the_datasheet_says(name):
    assert stroke_of(name).duration_s() == pytest.approx(
        DATASHEETS[name]['closing_time_s'], rel=0.15)


class Hold:
    """
    A cylinder that a hand takes with its palm up and holds with its palm down.

    :ivar moved: how far it moved from where it was taken until the end [m]
    :ivar speed: at the end [m/s]
    :ivar touching: whether the hand touches it at the end
    """

    def __init__(self, name):
        how = GRASPS['cylinders'][name]
        hand = create_gripper(name)
        alone = mujoco.MjData(hand.compile())
        mujoco.mj_kinematics(alone.model, alone)
        palm = alone.body(hand.correct_naming(how['body']))
        rotation = palm.xmat.reshape(3, 3)
        position = palm.xpos + rotation @ how['position_m'] + [0.0, 0.0, PARK_HEIGHT_M]
        axis, up = rotation @ how['axis'], rotation @ how['up']
        rig = GripperRig(name, cylinder(0.05, 0.12, position, axis), (1.0, 0.0, 0.0, 0.0))
        gravity = np.linalg.norm(rig.model.opt.gravity)
        rig.model.opt.gravity[:] = -gravity * up
        for duration_s, action in how['actions']:
            rig.advance(action, duration_s)
        start = rig.data.body('part').xpos.copy()
        for angle in np.linspace(0.0, np.pi, 40):
            rig.model.opt.gravity[:] = gravity * (
                -np.cos(angle) * up + np.sin(angle) * np.cross(axis, up))
            rig.advance(how['actions'][-1][1], 0.05)
        rig.advance(how['actions'][-1][1], 2.0)
        part = rig.data.body('part')
        self.moved = np.linalg.norm(part.xpos - start)
        self.speed = np.linalg.norm(part.cvel[3:])
        self.touching = rig.model.geom('part').id in rig.data.contact.geom


@pytest.mark.parametrize('name', [name for name in GRIPPERS if name in GRASPS['cylinders']])
def test_a_hand_keeps_a_cylinder_when_turned_over(name):
    hold = Hold(name)
    assert hold.moved < 0.02
    assert hold.speed < 0.01
    assert hold.touching
