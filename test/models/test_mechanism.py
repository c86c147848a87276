# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which joints something moves or holds: actuators, springs, couplings by joints and tendons."""

import mujoco
import pytest

from manip_sim.models.couplings import actuated_joints, moved_joints


def moved(sections, count=4, of_joint=''):
    """Return the numbers of the slides j0, j1, ... that something moves."""
    bodies = ''.join(f"""
        <body name="b{n}">
          <joint name="j{n}" type="slide" axis="1 0 0" {of_joint if n == 0 else ''}/>
          <geom name="g{n}" size="0.01" mass="0.1"/>
          <geom name="c{n}" type="cylinder" size="0.01 0.01" mass="0.1"/>
          <site name="s{n}"/></body>"""
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


@pytest.mark.parametrize(('actuator', 'expected'), [
    ('<motor jointinparent="j2"/>', {2}), ('<motor site="s1"/>', {1}),
    ('<motor site="s1" refsite="s3"/>', {1, 3}), ('<motor site="s2" refsite="fixed"/>', {2}),
    ('<motor cranksite="s2" slidersite="s3" cranklength="1"/>', {2, 3}),
    ('<adhesion body="b1" ctrlrange="0 1"/>', set())])
def test_an_actuator_moves_the_joints_between_the_places_that_it_acts_on(actuator, expected):
    assert moved(f'<actuator>{actuator}</actuator>') == expected


def test_joints_that_carry_both_places_are_not_between_them():
    model = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody>
  <body><joint name="j0"/><geom size="0.1"/><site name="low"/>
    <body><joint name="j1"/><geom size="0.1"/>
      <body><joint name="j2"/><geom size="0.1"/><site name="high"/></body></body></body>
</worldbody><actuator><motor site="high" refsite="low"/><motor site="low"/></actuator></mujoco>""")
    assert [actuated_joints(model, actuator) for actuator in range(2)] == [[1, 2], [0]]


@pytest.mark.parametrize('sites', [('fixed', 's1'), ('s1', 'fixed')])
def test_a_tendon_may_begin_or_end_in_the_world(sites):
    places = ''.join(f'<site site="{site}"/>' for site in sites)
    assert moved(f'<tendon><spatial stiffness="3">{places}</spatial></tendon>') == {1}


def test_a_tendon_goes_around_cylinders_too():
    around = '<site site="fixed"/><geom geom="c3"/><site site="fixed"/>'
    assert moved(f'<tendon><spatial stiffness="3">{around}</spatial></tendon>') == {3}


@pytest.mark.parametrize('kind', ['connect', 'weld'])
def test_bodies_that_are_tied_to_each_other_move_together(kind):
    tied = f'<equality><{kind} site1="s1" site2="s0"/></equality>'
    assert moved(tied) == set()
    assert moved(MOTOR + tied) == {0, 1}


def test_a_body_that_is_welded_to_the_world_is_held():
    assert moved('<equality><weld site1="s1" site2="fixed"/></equality>') == {1}
    assert moved('<equality><connect site1="s1" site2="fixed"/></equality>') == set()
