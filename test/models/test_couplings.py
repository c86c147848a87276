# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints that are tied to each other by equalities of MuJoCo, in chains and stars."""

import mujoco
import numpy as np
import pytest

from manip_sim.models.couplings import JointCouplings


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
