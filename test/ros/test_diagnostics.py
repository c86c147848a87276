# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the node tells of its health."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_commands_are_counted_by_part(serve, client):
    node = serve()
    arrays = client.listen(DiagnosticArray, '/diagnostics')
    statistics = node.commands.statistics['arm']
    # One at a time, because the node keeps the last one only.
    for message, arrived in (([0.0] * 7, lambda: statistics.accepted == 1),
                             ([2.0] * 7, lambda: statistics.accepted == 2),
                             ([0.0], lambda: statistics.refused == 1)):
        client.publish('arm/command', Float64MultiArray(data=message))
        client.spin_until(arrived)

    def arm():
        return values(next(s for s in arrays[-1].status if s.name == 'manip_sim: arm'))
    client.spin_until(lambda: bool(arrays) and int(arm()['dropped']) == 1
                      and int(arm()['clamped']) == 7)
    assert arm()['control_mode'] == 'position'
    assert float(arm()['age']) < 30.0
    gripper = values(next(s for s in arrays[-1].status if s.name == 'manip_sim: right/gripper'))
    assert gripper['age'] == 'never'


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_the_measured_real_time_factor_is_the_true_one(factor, serve, client):
    serve(real_time_factor=factor)
    ticks = []
    client.node.create_subscription(Clock, '/clock', lambda m: ticks.append(
        (time.monotonic(), m.clock.sec + m.clock.nanosec * 1e-9)), 10)
    arrays = client.listen(DiagnosticArray, '/diagnostics')
    client.spin_until(lambda: len(arrays) > 3)
    told = [float(values(array.status[0])['real_time_factor']) for array in arrays[1:]]
    (begin, first), (end, last) = ticks[0], ticks[-1]
    true = (last - first) / (end - begin)
    assert abs(sum(told) / len(told) / true - 1.0) < 0.01


def test_diagnostics_come_once_a_second(serve, client):
    serve()
    arrays = client.listen(DiagnosticArray, '/diagnostics')
    client.spin_until(lambda: bool(arrays))
    begin = time.monotonic()
    client.spin_until(lambda: len(arrays) >= 4)
    assert 2.5 < time.monotonic() - begin < 3.6


def test_a_machine_that_cannot_keep_up_is_told(serve, client):
    node = serve(publish_rate=500)
    arrays = client.listen(DiagnosticArray, '/diagnostics')
    client.spin_until(lambda: bool(arrays))
    node.runner.call(lambda: time.sleep(1.0))
    client.spin_until(lambda: any(
        s.level == DiagnosticStatus.WARN and 'dropped' in s.message
        for array in arrays for s in array.status))
    client.spin_until(lambda: int(values(arrays[-1].status[0])['missed_deadlines']) > 100)
