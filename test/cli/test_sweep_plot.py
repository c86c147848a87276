# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The picture of success over latencies."""

from xml.etree import ElementTree

import pytest

from manip_sim.experiments.experiment import success_over

FOUND = [(0.2, {'success_rate': 0.25, 'success_rate_95': (0.1, 0.5)}),
         (0.0, {'success_rate': 1.0, 'success_rate_95': (0.8, 1.0)}),
         (0.1, {'success_rate': None, 'success_rate_95': (0.0, 1.0)})]


@pytest.fixture
def picture():
    text = success_over('a <task> & policy', 'latency of a command', FOUND)
    return ElementTree.fromstring(text.replace(' xmlns="http://www.w3.org/2000/svg"', ''))


def test_points_are_at_their_latencies_and_rates(picture):
    xs, ys = zip(*((float(point.get('cx')), float(point.get('cy')))
                   for point in picture.iter('circle')))
    labels = {found.text: found for found in picture.iter('text')}
    assert list(xs) == sorted(xs) and xs[1] - xs[0] == pytest.approx(xs[2] - xs[1], abs=0.2)
    assert [float(labels[late].get('x')) for late in ('0', '0.1', '0.2')] == list(xs)
    lines = [float(labels[percent].get('y')) - 4.0 for percent in ('100', '25')]
    assert [ys[0], ys[2]] == pytest.approx(lines, abs=0.2)
    # None of an empty run is no success.
    assert ys[1] == max(float(line.get('y1')) for line in picture.iter('line'))


def test_intervals_reach_from_their_lower_to_their_upper_limit(picture):
    top, bottom = (next(float(line.get('y1')) for line in lines) for lines in (
        sorted(picture.iter('line'), key=lambda line: sign * float(line.get('y1')))
        for sign in (1, -1)))
    upright = [sorted((bottom - float(line.get(end))) / (bottom - top) for end in ('y1', 'y2'))
               for line in picture.iter('line') if line.get('x1') == line.get('x2')]
    assert upright == [pytest.approx(limits, abs=0.002)
                       for limits in ([0.8, 1.0], [0.0, 1.0], [0.1, 0.5])]


def test_names_with_signs_of_xml_are_written_as_they_are(picture):
    assert 'a <task> & policy' in [found.text for found in picture.iter('text')]
