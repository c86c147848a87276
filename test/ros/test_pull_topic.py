# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bodies are pulled by a topic, which ends by itself and takes nothing that does not fit."""

import math

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PoseStamped
import numpy as np
import pytest
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402

from manip_sim.errors import CommandError, UnknownNameError  # noqa: E402

PULL = 'manip_sim/pull'


def arrow(*ends, body='cube', **fields):
    return Marker(ns=body, points=[Point(x=x, y=y, z=z) for x, y, z in ends], **fields)


@pytest.mark.full
def test_a_cube_is_lifted_by_the_topic_and_falls_without_it(serve, client):
    node = serve(start_paused=True, arena='table')
    poses = client.listen(PoseStamped, 'objects/cube/pose')
    client.spin_until(lambda: bool(poses))

    def place():
        position = poses[-1].pose.position
        return np.array([position.x, position.y, position.z])

    def step():
        count = len(poses)
        assert client.call(Trigger, 'manip_sim/step').success
        client.spin_until(lambda: len(poses) > count)

    start, pulls = place(), node.simulation.pulls
    message = arrow(start, start + [0.0, 0.0, 0.4])
    for period in range(25):
        # Only the first one says where the cube is held.
        message.points[0].x = start[0] + 10.0 * bool(period)
        before = node.surroundings.statistics['pull'].accepted
        client.publish(PULL, message)
        client.spin_until(lambda n=before: node.surroundings.statistics['pull'].accepted > n)
        step()
    high = place()
    assert high[2] > start[2] + 0.1 and abs(high[0] - start[0]) < 1e-3
    for _ in range(20):
        assert pulls
        step()
    assert not pulls
    client.publish(PULL, arrow(place(), start, id=3))
    client.publish(PULL, Marker(ns='cube', action=Marker.DELETE))
    before = place()[2]
    client.spin_until(lambda: node.surroundings.statistics['pull'].accepted > 26)
    step()
    assert not pulls and place()[2] <= before


WRONG = [
    arrow([0, 0, 0], body='cub'), arrow([0, 0, 1.0], [0, 0, 1.0], body='cub'),
    arrow([0, 0, 1.0], [0, 0, 1.0], body='table'), arrow([0, 0, 1.0]),
    arrow([0, 0, 1.0], [0, 0, math.nan]), arrow([0, 0, 1.0], [0, 0, 1e300]),
    arrow([0, 0, 1.0], [0, 0, 1.0], type=Marker.CUBE), arrow(*[[0.0, 0.0, 0.0]] * 5000),
    arrow([0, 0, 1.0], [0, 0, 1.0], action=Marker.DELETEALL),
    Marker(ns='cub', action=Marker.DELETE)]
WRONG[0].header.frame_id = WRONG[3].header.frame_id = 'robot0_link0'
POINTS = st.lists(st.builds(Point, x=st.floats(), y=st.floats(), z=st.floats(-1.0, 1.0)),
                  max_size=3)


@pytest.mark.full
def test_what_does_not_fit_is_rejected_counted_and_pulls_nothing(serve, client):
    node = serve(arena='table')
    statuses = client.listen(DiagnosticArray, '/diagnostics')
    log = client.log()
    for wrong in WRONG:
        client.publish(PULL, wrong)

    def counted():
        values = [{pair.key: pair.value for pair in status.values}
                  for message in statuses for status in message.status
                  if status.name == 'manip_sim: pull']
        return values and (values[-1]['accepted'], values[-1]['dropped']) == (
            '0', str(len(WRONG)))
    client.spin_until(counted)
    client.spin_until(lambda: any("did you mean 'cube'?" in text for text in log))
    assert not node.simulation.pulls

    @settings(max_examples=200, deadline=None)
    @given(POINTS, st.sampled_from(['cube', 'robot0_link5', 'table']) | st.text(max_size=3),
           st.integers(0, 4), st.integers(0, 4), st.integers(-2**31, 2**31 - 1))
    def any_message(points, body, kind, action, number):
        message = Marker(ns=body, points=points, type=kind, action=action, id=number)
        try:
            node.surroundings._pull('', message)
        except (CommandError, UnknownNameError) as error:
            assert str(error).isprintable()
        else:
            assert body in ('cube', 'robot0_link5') and action in (0, 2)
            assert action == 2 or np.isfinite([[p.x, p.y, p.z] for p in points]).all()
    any_message()
    client.state()
    assert node.simulation.diverged is None
