# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every gripper of the catalogue opens, closes and holds a part; forces are the datasheet's."""

from functools import cache

import mujoco
import numpy as np
import pytest

from catalogue import figures, GRIPPERS
from gripper_rig import cube, cylinder, GripperRig, PARK_HEIGHT_M, plate

from manip_sim.models.grippers import create_gripper

GRASPS = figures('grasps.json')
DATASHEETS = figures('datasheets.json')['grippers']
CLEARANCE_M = 0.005
LIFT_M = 0.1


def has_pads(name):
    """Return whether a gripper has two sides that close on something."""
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

    :param joints: where the fingers shall go by a joint command; without, an action closes
    :ivar closed: where the fingers that can be commanded are in the end, by joint
    :ivar times: since the first closing action [s], shape (n,)
    :ivar gaps: between the pads [m], shape (n,)
    :ivar pads: middles of the pads seen from the carriage [m], shape (n, 2, 3)
    :ivar lowest: of the collision shapes seen from the carriage [m], shape (n,)
    """

    def __init__(self, name, joints=None):
        rig = GripperRig(name)
        rig.actuate(np.negative(closing(name)))
        if joints is None:
            rig.apply(closing(name))
        else:
            rig.command(joints)
        rows = []
        last_change = 0.0
        while not rows or rows[-1][0] - last_change < 0.3:
            height = rig.carriage_height()
            pads = rig.pads() - [0.0, 0.0, height]
            rows.append((0.01 * len(rows), rig.pad_gap(), pads, rig.lowest_point() - height))
            rig.wait(0.01)
            if rig.fingers.moving:
                last_change = rows[-1][0]
            assert rows[-1][0] < 15.0, f'{name} has not closed after 15 s'
        times, gaps, middles, lowest = zip(*rows)
        # Old versions of MuJoCo give a distance of zero now and then.
        self.times, self.gaps = np.array(times), running_median(np.array(gaps))
        self.pads, self.lowest = np.array(middles), np.array(lowest)
        self.closed = {joint: rig.data.joint(joint).qpos[0]
                       for joint in rig.fingers.joints.names}

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
    :ivar depth: of the deepest contact of the gripper [m]
    """

    def __init__(self, name, edge=None):
        stroke, action = stroke_of(name), closing(name)
        edge = edge or stroke.cube_edge_m()
        at_cube = np.argmax(stroke.gaps <= edge)
        middle = stroke.pads[at_cube].mean(axis=0)
        across = np.diff(stroke.pads[at_cube], axis=0)[0]
        left_moved, right_moved = np.linalg.norm(
            stroke.pads[at_cube] - stroke.pads[0], axis=1) > 1e-4
        if left_moved != right_moved:  # A jaw that does not move must not land on the part.
            away = across if right_moved else -across
            middle += CLEARANCE_M * away / np.linalg.norm(across)
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
        self.depth = rig.deepest_contact()


@cache
def lift_of(name):
    """Return the lift of a cube that fits, or of the edge that suits a gripper [m]."""
    return Lift(name, GRASPS['lifted_m'].get(name))


@pytest.mark.full
@pytest.mark.parametrize('name', PINCHING)
def test_plus_one_closes_and_minus_one_opens(name):
    gaps = stroke_of(name).gaps
    # Fingers that stand side by side pass each other at the end; the pads are apart again then.
    assert gaps.min() < gaps[0] - 0.02
    assert gaps[-1] < gaps[0]


@pytest.mark.full
@pytest.mark.parametrize('name', PINCHING)
def test_a_cube_is_lifted_and_held(name):
    lift = lift_of(name)
    assert lift.rose > LIFT_M - 0.01
    assert lift.slipped < 0.005


@pytest.mark.full
@pytest.mark.parametrize('name', stated('stroke_m'))
def test_the_stroke_is_that_of_the_datasheet(name):
    gaps = stroke_of(name).gaps
    assert gaps[0] - gaps.min() == pytest.approx(DATASHEETS[name]['stroke_m'], rel=0.1)


@pytest.mark.full
@pytest.mark.parametrize('name', stated('grip_force_n'))
def test_the_grip_force_is_in_the_range_of_the_datasheet(name):
    low, high = DATASHEETS[name]['grip_force_n']
    assert low <= lift_of(name).force <= high


@pytest.mark.full
@pytest.mark.parametrize('name', [name for name in stated('closing_time_s')
                                  if name not in stated('slow_action')])
def test_closing_by_an_action_takes_as_long_as_the_datasheet_says(name):
    assert stroke_of(name).duration_s() == pytest.approx(
        DATASHEETS[name]['closing_time_s'], rel=0.15)


@pytest.mark.full
@pytest.mark.parametrize('name', stated('closing_time_s'))
def test_closing_by_a_joint_command_takes_as_long_as_the_datasheet_says(name):
    assert Stroke(name, stroke_of(name).closed).duration_s() == pytest.approx(
        DATASHEETS[name]['closing_time_s'], rel=0.15)


@pytest.mark.full
@pytest.mark.parametrize('name', stated('slow_action'))
def test_an_action_of_the_reference_that_is_slower_than_the_hand_takes_as_long_as_it_says(name):
    # The fingers meet before their commands are at the end, after 10 s.
    assert 5.0 < stroke_of(name).duration_s() < 10.0


class Grasp:
    """
    A part without weight that hangs between the open pads, gripped.

    :ivar force: with which either side presses [N], shape (2,)
    :ivar depth: of the deepest contact of the gripper [m]
    """

    def __init__(self, name, width_m):
        stroke = stroke_of(name)
        at_part = np.argmax(stroke.gaps <= width_m)
        middle = stroke.pads[at_part].mean(axis=0) + [0.0, 0.0, PARK_HEIGHT_M]
        across = np.diff(stroke.pads[at_part], axis=0)[0]
        yaw = np.arctan2(across[1], across[0])
        self.rig = GripperRig(name, plate(width_m, middle, yaw))
        self.rig.actuate(np.negative(closing(name)))
        self.rig.actuate(closing(name))
        self.force = np.array([np.linalg.norm(self.rig.force_on_part(f'{side}_finger'))
                               for side in ('left', 'right')])
        self.depth = self.rig.deepest_contact()


WIDTHS = [pytest.param(name, width, id=f'{name}-{width * 1e3:g}mm')
          for name in stated('grip_force_n') for width in GRASPS['plates_m'].get(name, [])]


@pytest.mark.full
@pytest.mark.parametrize(('name', 'width_m'), WIDTHS)
def test_the_grip_force_is_that_of_the_datasheet_whatever_the_width_of_the_part(name, width_m):
    grasp, (low, high) = Grasp(name, width_m), DATASHEETS[name]['grip_force_n']
    assert (low <= grasp.force).all()
    assert (grasp.force <= high).all()
    assert grasp.depth < 0.001


def test_every_gripper_with_a_stated_force_grips_parts_of_several_widths():
    for name in stated('grip_force_n'):
        assert len(GRASPS['plates_m'].get(name, GRASPS['cubes_m'].get(name, []))) >= 4, name


#: The hand of another one, with other actions, grips the smallest and the largest.
CUBES = [pytest.param(name, edge, id=f'{name}-{edge * 1e3:g}mm')
         for name, edges in GRASPS['cubes_m'].items()
         for edge in (edges[::3] if name == 'JacoThreeFingerDexterousGripper' else edges)]


@pytest.mark.full
@pytest.mark.parametrize(('name', 'edge_m'), CUBES)
def test_a_hand_that_leans_on_its_part_grips_cubes_with_the_force_of_the_datasheet(name, edge_m):
    lift, (low, high) = Lift(name, edge_m), DATASHEETS[name]['grip_force_n']
    assert low <= lift.force <= high
    assert lift.rose > LIFT_M - 0.01


@pytest.mark.full
@pytest.mark.parametrize('name', PINCHING)
def test_nothing_sinks_into_the_fingers_that_lift_a_cube(name):
    assert lift_of(name).depth < 0.001


@pytest.mark.parametrize('name', PINCHING + sorted(GRASPS['cylinders']))
def test_fingers_that_close_on_nothing_do_not_sink_into_each_other(name):
    rig = GripperRig(name)
    rig.actuate(np.negative(closing(name)))
    rig.actuate(closing(name))
    assert rig.deepest_contact() < 0.001


@pytest.mark.full
@pytest.mark.parametrize('name', sorted(GRASPS['plates_m']))
def test_opening_starts_without_delay_after_a_grip(name):
    rig, opening = Grasp(name, 0.05).rig, np.negative(closing(name))
    gap = rig.pad_gap()
    rig.advance(opening, 0.25)
    # A fifth of a second at least is spent opening, of the 0.1 m/s that all of them exceed.
    speed = min(0.1, stroke_of(name).gaps[0] / stroke_of(name).duration_s())
    assert rig.pad_gap() - gap > 0.5 * 0.2 * speed


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
        self.depth = rig.deepest_contact()


@pytest.mark.full
@pytest.mark.parametrize('name', [name for name in GRIPPERS if name in GRASPS['cylinders']])
def test_a_hand_keeps_a_cylinder_when_turned_over(name):
    hold = Hold(name)
    assert hold.moved < 0.02
    assert hold.speed < 0.01
    assert hold.touching
    assert hold.depth < 0.001
