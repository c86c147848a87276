# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Impedance with gains in the message, over the topic."""

import math

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray

NAN7 = [math.nan] * 7


def send(node, client, data, accepted):
    client.publish('arm/impedance_command', Float64MultiArray(data=data))
    statistics = node.commands.robots[0].statistics['arm']
    client.spin_until(lambda: statistics.accepted + statistics.rejected == accepted)
    return statistics


def test_a_message_sets_goals_and_gains_of_all_joints_live(serve, client):
    node = serve(start_paused=True, control_mode__arm='impedance')
    send(node, client, [0.3, *NAN7[1:], *NAN7, *NAN7, *[100.0] * 7, *[20.0] * 7], 1)
    node.simulation.data.qfrc_applied[0] = 5.0
    for _ in range(300):
        node.thread.step()
    assert node.simulation.robot.state().position[0] == pytest.approx(0.35, rel=0.01)
    send(node, client, [*NAN7, *NAN7, *NAN7, 200.0, *NAN7[1:], *NAN7], 2)
    for _ in range(300):
        node.thread.step()
    assert node.simulation.robot.state().position[0] == pytest.approx(0.325, rel=0.01)


@pytest.mark.parametrize('data', [
    [], [0.1] * 7, [math.inf] * 35, [*NAN7, *NAN7, *NAN7, *[-1.0] * 7, *NAN7]])
def test_a_message_that_cannot_be_used_is_rejected_and_changes_nothing(data, serve, client):
    node = serve(start_paused=True, control_mode__arm='impedance')
    before = node.simulation.digest()
    assert send(node, client, data, 1).rejected == 1
    node.thread.call(lambda: None)
    assert node.simulation.digest() == before


def test_in_another_mode_a_message_is_rejected(serve, client):
    node = serve(start_paused=True)
    assert send(node, client, [100.0] * 35, 1).rejected == 1
    assert not np.isnan(node.simulation.robot.state().position).any()
