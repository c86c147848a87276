# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints that are tied to each other, in chains and stars, and which joints something moves."""

import mujoco
import numpy as np
import pytest

from manip_sim.models.couplings import actuated_joints, JointCouplings, moved_joints


def couplings(*equalities, count=4):
    """Return the couplings of slides j0, j1, ... and the model."""
    bodies = ''.join(f"""
        <body><joint name="j{n}" type="slide" range="-1 1" limited="true"/>
          <geom size="0.01" mass="0.1"/></body>""" for n in range(count))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{bodies}</worldbody><equality>{"".join(equalities)}</equality>'
        '</mujoco>')
    return JointCouplings(model, range(model.njnt))


def tied(follower, leader, factor=1.0, offset=0.0):
    return (f'<joint joint1="j{follower}" joint2="j{leader}" '
            f'polycoef="{offset} {factor} 0 0 0"/>')


def test_a_chain_is_followed_to_its_end_from_anywhere():
    chain = couplings(tied(1, 0, 2.0), tied(2, 1, -1.0), tied(3, 2, 0.5))
    expected = {0: 0.1, 1: 0.2, 2: -0.2, 3: -0.1}
    for joint, position in expected.items():
        assert chain.follow({joint: position}) == pytest.approx(expected)


def test_a_joint_that_is_given_is_not_moved_and_those_behind_it_are_found():
    chain = couplings(tied(1, 0, 2.0), tied(2, 1, -1.0), tied(3, 0))
    # Of those that j0 is tied to, the first one is known already, the last one is not.
    assert chain.follow({0: 0.1, 1: 0.5}) == pytest.approx({0: 0.1, 1: 0.5, 2: -0.5, 3: 0.1})


def test_joints_that_no_equality_ties_follow_nothing():
    pair = couplings(tied(1, 0))
    assert pair.follow({2: 0.3}) == {2: 0.3}
    assert pair.group(0) == {0, 1} and pair.group(2) == {2}


def test_an_offset_is_that_of_the_equality():
    pair = couplings(tied(1, 0, 3.0, offset=0.05))
    assert pair.follow({0: 0.1})[1] == pytest.approx(0.35)
    assert pair.follow({1: 0.35})[0] == pytest.approx(0.1)


def test_a_polynomial_counts_up_to_its_fourth_power():
    pair = couplings('<joint joint1="j1" joint2="j0" polycoef="0.1 0.2 0.3 0.4 0.5"/>')
    assert pair.follow({0: 0.5})[1] == pytest.approx(
        0.1 + 0.2 * 0.5 + 0.3 * 0.25 + 0.4 * 0.125 + 0.5 * 0.0625)


def test_ratios_are_the_derivative_of_the_polynomial_over_the_whole_range():
    pair = couplings('<joint joint1="j1" joint2="j0" polycoef="0.1 0.2 0.3 0.4 0.5"/>')
    ratios = pair.ratios(0)
    assert len(ratios) > 2
    for place, found in zip(np.linspace(-1.0, 1.0, len(ratios)), ratios):
        assert found[0] == pytest.approx(1.0, abs=1e-6)
        assert found[1] == pytest.approx(
            0.2 + 0.6 * place + 1.2 * place**2 + 2.0 * place**3, abs=1e-3)


def test_the_leader_of_a_cubic_is_found_from_the_follower():
    # Of the three roots two are complex, with real parts that are nearer to zero.
    pair = couplings('<joint joint1="j1" joint2="j0" polycoef="0 1 0 1 0"/>')
    assert pair.follow({1: 0.5 + 0.5**3})[0] == pytest.approx(0.5)
    assert pair.follow({1: -0.4 - 0.4**3})[0] == pytest.approx(-0.4)


def test_a_position_that_a_polynomial_never_has_moves_no_leader():
    pair = couplings('<joint joint1="j1" joint2="j0" polycoef="0.1 0 1 0 0"/>')
    assert abs(pair.follow({1: 0.1 + 0.3**2})[0]) == pytest.approx(0.3)
    assert pair.follow({1: 0.05}) == {1: 0.05}


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
