# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is counted and told of an end effector that does not come where it shall be."""

import numpy as np

from manip_sim.control.cartesian.reports import CartesianReport

FAR = np.array([0.03, 0.0, 0.04, 0.2, 0.1, 0.2])


def test_what_is_left_is_told_once_the_end_effector_has_stalled_for_three_tenths_of_a_second():
    report = CartesianReport('right')
    for tenth in range(3):
        report.see_target(FAR, False, 0.05, tenth / 10.0)
        assert report.unreachable == 0
    for tenth in range(3, 9):
        report.see_target(FAR, False, 0.05, tenth / 10.0 + 1e-6)
    assert report.unreachable == 1
    assert report.texts['unreachable'] == (
        'right: the target is not reached, 0.050 m and 0.300 rad are left')


def test_an_end_effector_that_comes_nearer_or_is_near_has_not_stalled():
    near = np.array([0.0019, 0.0, 0.0, 0.019, 0.0, 0.0])
    for error, progress in ((FAR, 0.11), (near, 0.0)):
        report = CartesianReport('right')
        for tenth in range(20):
            report.see_target(error, error is near, progress, tenth / 10.0)
        assert report.counts['unreachable'] == 0


def test_causes_are_counted_when_they_begin_and_told_with_the_target():
    report = CartesianReport('left')
    for held in (['j1'], ['j1', 'j2'], [], ['j2']):
        report.see_motion('the way', held, singular=True, slowed=False)
    assert report.counts == {'unreachable': 0, 'joint_limit': 2, 'singular': 1, 'slowed': 0,
                             'aside': 0}
    assert report.texts['joint_limit'] == 'left: the way is limited by the range of j2'
    for tenth in range(5):
        report.see_target(FAR, False, 0.0, tenth / 10.0)
    assert report.texts['unreachable'].endswith(
        'are left, a joint is at the end of its range, the arm is at a singularity')


def test_an_end_effector_that_leaves_its_way_by_centimetres_is_told_when_it_begins():
    report = CartesianReport('right')
    for distance in (0.0, 0.009, 0.011, 0.05, 0.004, 0.02):
        report.see_way(distance)
    assert report.counts['aside'] == 2
    assert report.texts['aside'] == (
        'right: the end effector is more than 0.01 m off the straight line to its target')
