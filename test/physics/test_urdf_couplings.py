# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Mimic joints of URDF are gears: fingers of any mass stay together at the effort limit."""

import itertools

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose, load_gripper
from manip_sim.simulation import Simulation

#: By kind: range of the leader [rad or m] and least inertia of a finger [kg m^2 or kg].
SPANS = {'prismatic': 0.04, 'revolute': 0.8}


def inertial(mass):
    moment = f'{mass * 1e-3!r}'
    return (f'<inertial><mass value="{mass!r}"/><inertia ixx="{moment}" iyy="{moment}" '
            f'izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>')


def shape(size, xyz=(0, 0, 0), kind='box'):
    return (f'<collision><origin xyz="{" ".join(map(str, xyz))}"/><geometry>'
            f'<{kind} {"size" if kind == "box" else "radius"}="{size}"/></geometry></collision>')


def finger(name, kind, mass, xyz, axis, limits, effort, mimic=''):
    prismatic = kind == 'prismatic'
    body = shape('0.02 0.01 0.06' if prismatic else '0.02 0.01 0.1',
                 (0, 0, 0.03 if prismatic else 0.05))
    return (f'<link name="{name}_finger">{inertial(mass)}{body}</link>'
            f'<joint name="{name}_finger_joint" type="{kind}"><parent link="palm"/>'
            f'<child link="{name}_finger"/><origin xyz="{" ".join(map(str, xyz))}"/>'
            f'<axis xyz="{" ".join(map(str, axis))}"/><limit lower="{limits[0]!r}" '
            f'upper="{limits[1]!r}" effort="{effort!r}" velocity="3"/>{mimic}</joint>')


def hand(kind, mass, effort, multiplier=1.0, offset=0.0, block=''):
    """
    Return a URDF of two fingers.

    :param block: what stops the second one in the middle of its way: ``post``, its ``range``
    """
    span, sign = SPANS[kind], np.sign(multiplier)
    ends = sorted((offset, multiplier * span / (2 if block == 'range' else 1) + offset))
    # Each finger in a plane of its own, so that only the post is in the way of the second one.
    if kind == 'prismatic':
        at, leader_axis, axis = 0.1, (0, 1, 0), (0, -sign, 0)
        middle = -0.05 - abs(multiplier) * span / 2 - sign * offset
        post = shape('0.02 0.1 0.02', (-0.05, middle - 0.055, at + 0.05))
    else:
        at, leader_axis, axis = 0.05, (1, 0, 0), (-sign, 0, 0)
        angle = abs(multiplier) * span / 2 + sign * offset
        post = shape(0.01, (
            -0.05, -0.05 + 0.08 * np.sin(angle) + 0.015 * np.cos(angle),
            at + 0.08 * np.cos(angle) - 0.015 * np.sin(angle)), 'sphere')
    return ('<robot name="hand"><link name="palm">' + inertial(0.4) + (
        post if block == 'post' else '') + '</link>'
            + finger('driven', kind, mass, (0.05, 0.05, at), leader_axis, (0.0, span), effort)
            + finger('follower', kind, mass, (-0.05, -0.05, at), axis, ends, effort,
                     f'<mimic joint="driven_finger_joint" multiplier="{multiplier!r}" '
                     f'offset="{offset!r}"/>')
            + '</robot>')


def close(file, timestep_s, goal, seconds=1.0, period_s=0.02):
    """Return positions of driven and follower in each period, and the last effort."""
    simulation = Simulation(compose(str(file), timestep_s=timestep_s))
    robot = simulation.robot
    names = [next(n for n in robot.joint_names if n.endswith(end)) for end in
             ('driven_finger_joint', 'follower_finger_joint')]
    indices = [robot.joint_names.index(name) for name in names]
    seen = []
    for _ in range(round(seconds / period_s)):
        robot.apply(*robot.parse.joint_command(names[:1], position=[goal]))
        simulation.advance(round(period_s / timestep_s))
        seen.append(robot.state().position[indices].copy())
    return np.array(seen), float(robot.state().effort[indices[0]])


def check(tmp_path, kind, mass, effort, multiplier, offset, timestep_s, block):
    """Check that fingers at rest are together and in their ranges, within 1 % of the range."""
    file = tmp_path / 'hand.urdf'
    file.write_text(hand(kind, mass, effort, multiplier, offset, block))
    span = SPANS[kind]
    seen, pushed = close(file, timestep_s, span)
    # In units of the leader's range.
    seen = seen[len(seen) // 2:]
    driven, follower = seen[:, 0] / span, (seen[:, 1] - offset) / (multiplier * span)
    assert np.abs(driven - follower).max() < 0.01
    assert min(driven.min(), follower.min()) > -0.01
    end = 0.5 if block == 'range' else 1.0
    assert max(driven.max(), follower.max()) < end + 0.01
    if block:
        assert driven[-1] < 0.9 and pushed > 0.5 * effort
    else:
        assert driven[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.full
@pytest.mark.parametrize('block', ['post', 'range', ''])
@pytest.mark.parametrize(('kind', 'mass', 'effort', 'multiplier', 'offset', 'timestep_s'), [
    ('prismatic', 0.05, 40.0, 1.0, 0.0, 0.002),
    ('prismatic', 0.2, 20.0, -0.5, 0.04, 0.005),
    ('revolute', 0.1, 5.0, 1.0, 0.0, 0.002),
    ('revolute', 0.02, 1.0, -0.5, 0.2, 0.0005)])
def test_fingers_stay_together_at_the_effort_limit(
        tmp_path, kind, mass, effort, multiplier, offset, timestep_s, block):
    check(tmp_path, kind, mass, effort, multiplier, offset, timestep_s, block)


@pytest.mark.full
@pytest.mark.parametrize('kind', SPANS)
@pytest.mark.parametrize('timestep_s', [0.0005, 0.001, 0.002, 0.005])
def test_fingers_of_any_mass_stay_together_at_any_timestep(tmp_path, kind, timestep_s):
    # MuJoCo's contacts are too soft for light fingers, so the range of the second one stops it.
    ratios = ((1.0, 0.0), (-2.0, 0.01), (0.25, -0.02))
    masses, efforts = (0.001, 0.03, 1.0), (2.0, 20.0, 80.0)
    # An orthogonal array: each two of mass, effort and ratio meet once. Every second timestep
    # stops those fingers by the range that the others do not.
    other = (kind == 'revolute') != (timestep_s in (0.001, 0.005))
    for (row, mass), (column, effort) in itertools.product(enumerate(masses), enumerate(efforts)):
        check(tmp_path, kind, mass, effort, *ratios[(row + column) % 3], timestep_s,
              ('range', '')[(row + column + other) % 2])


@pytest.mark.parametrize(('ranges_per_s', 'stop'), [(2.0, 'range'), (3.0, '')])
def test_fingers_stay_together_while_they_move_and_when_they_stop(tmp_path, ranges_per_s, stop):
    span, file = SPANS['prismatic'], tmp_path / 'hand.urdf'
    file.write_text(hand('prismatic', 0.05, 20.0, block=stop).replace(
        'velocity="3"', f'velocity="{ranges_per_s * span!r}"'))
    seen, _ = close(file, 0.005, span, seconds=0.6, period_s=0.005)
    assert np.ptp(seen[:, 0]) > 0.45 * span
    assert np.abs(seen[:, 0] - seen[:, 1]).max() < 0.01 * span


@pytest.mark.parametrize('pushed', ['driven_finger_joint', 'follower_finger_joint'])
def test_a_chain_of_couplings_carries_a_force_at_any_of_its_joints(tmp_path, pushed):
    third = finger('third', 'prismatic', 0.01, (0.1, 0, 0.1), (0, 1, 0), (0.0, 0.1), 10.0,
                   '<mimic joint="follower_finger_joint" multiplier="2.5"/>')
    file = tmp_path / 'hand.urdf'
    file.write_text(hand('prismatic', 0.01, 40.0).replace('</robot>', third + '</robot>'))
    model = load_gripper(file).compile()
    model.opt.timestep = 0.005
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.02
    mujoco.mj_step(model, data, 200)
    data.joint(f'gripper0_{pushed}').qfrc_applied[0] = -40.0
    mujoco.mj_step(model, data, 200)
    places = [float(data.joint(f'gripper0_{name}').qpos[0])
              for name in ('driven_finger_joint', 'follower_finger_joint', 'third_finger_joint')]
    assert places[0] > -0.01 * 0.04
    assert places == pytest.approx([places[0], places[0], 2.5 * places[0]], abs=0.01 * 0.04)


def test_a_joint_ends_at_the_range_of_its_follower_and_the_description_says_so(tmp_path):
    file = tmp_path / 'hand.urdf'
    file.write_text(hand('prismatic', 0.05, 40.0).replace(
        'multiplier="1.0"', 'multiplier="2.0"'))
    seen, _ = close(file, 0.002, 0.04)
    assert seen[-1] == pytest.approx([0.02, 0.04], abs=0.0004)
    assert ("joint 'driven_finger_joint' reaches only 0 to 0.02 of its range 0 to 0.04: there "
            "joint 'follower_finger_joint', which follows it, is at the ends of its own"
            ) in load_gripper(file).inferred
