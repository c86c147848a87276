# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which joints something moves or holds: actuators, springs, couplings by joints and tendons."""

import mujoco
import pytest

from manip_sim.simulation.mechanism import moved_joints


def moved(sections, count=4, of_joint=''):
    """Return the numbers of the slides j0, j1, ... that something moves."""
    bodies = ''.join(f"""
        <body><joint name="j{n}" type="slide" axis="1 0 0" {of_joint if n == 0 else ''}/>
          <geom name="g{n}" size="0.01" mass="0.1"/><site name="s{n}"/></body>"""
                     for n in range(count))
    return moved_joints(mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{bodies}<site name="fixed"/></worldbody>{sections}</mujoco>'))


MOTOR = '<actuator><motor joint="j0"/></actuator>'


def fixed_tendon(name, joint, more=''):
    return f'<fixed name="{name}" {more}><joint joint="j{joint}" coef="1"/></fixed>'


def test_a_motor_and_a_spring_move_their_joints_alone():
    assert moved(MOTOR) == {0}
    assert moved('', of_joint='stiffness="5"') == {0}
    assert moved('') == set()


def test_joints_that_are_coupled_to_a_moved_one_are_moved_too():
    couple = '<joint joint1="j{}" joint2="j{}"/>'.format
    chain = f'<equality>{couple(1, 0)}{couple(2, 1)}</equality>'
    assert moved(MOTOR + chain) == {0, 1, 2}
    assert moved(chain) == set()
    assert moved('<equality><joint joint1="j3"/></equality>') == {3}


@pytest.mark.parametrize('first', ['a', 'b'])
def test_tendons_that_are_tied_couple_their_joints_whichever_comes_first(first):
    second = 'ab'.replace(first, '')
    tied = (f'<tendon>{fixed_tendon("a", 0)}{fixed_tendon("b", 1)}</tendon>'
            f'<equality><tendon tendon1="{first}" tendon2="{second}"/></equality>')
    assert moved(MOTOR + tied) == {0, 1}


def test_a_spring_in_a_tendon_moves_the_joints_of_the_bodies_that_it_spans():
    assert moved(f'<tendon>{fixed_tendon("a", 2, "stiffness=" + chr(34) + "3" + chr(34))}'
                 '</tendon>') == {2}
    spans = '<spatial stiffness="3">{}</spatial>'
    sites = '<site site="s1"/><site site="s3"/>'
    assert moved(f'<tendon>{spans.format(sites)}</tendon>') == {1, 3}
    # A pulley is no place: behind it another branch begins.
    branches = f'{sites}<pulley divisor="2"/><site site="s1"/><site site="fixed"/>'
    assert moved('<tendon>' + spans.format(branches.replace('s3', 's2')) + '</tendon>') == {1, 2}
    # It also goes around a shape, whose body it pulls at.
    around = '<site site="fixed"/><geom geom="g2"/><site site="fixed"/>'
    assert moved(f'<tendon>{spans.format(around)}</tendon>') == {2}
