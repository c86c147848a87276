# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The rate and noise of single sensors, and descriptions that cannot be used."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState

from manip_sim.errors import ManipSimError
from manip_sim.interface.offered_sensors import SensorSettings
from manip_sim.interface.topics import Scope, topics_of_instruments
from manip_sim.models import compose
from manip_sim.simulation import Simulation

HAND, FOOT = 'robot0_right_imu', 'fixed_mount0_imu'
SLOW = f'{{name: {HAND}, rate: 50.0, noise: 0.5}}'


def periods(messages):
    return [(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec) // 10_000_000 for m in messages]


def numbers(message):
    rate, acceleration = message.angular_velocity, message.linear_acceleration
    return [rate.x, rate.y, rate.z, acceleration.x, acceleration.y, acceleration.z]


def test_a_sensor_has_its_own_rate_and_noise_and_the_others_stay_as_they_are(serve, client):
    serve(sensors=[SLOW], stepping='lockstep')
    hand, truth, foot = (client.listen(Imu, topic, qos_profile_sensor_data) for topic in (
        f'sensors/{HAND}/imu', f'truth/sensors/{HAND}/imu', f'sensors/{FOOT}/imu'))
    states = client.listen(JointState, 'joint_states')
    name = client.state().name[0]
    for period in range(1, 9):
        client.spin_until(lambda t=period: periods(states)[-1] == t and foot
                          and periods(foot)[-1] == t)
        if period % 2 == 0:
            client.spin_until(lambda t=period: hand and truth and periods(hand)[-1] == t
                              and periods(truth)[-1] == t)
        client.publish('joint_command', JointState(name=[name], position=[0.1]))
    assert set(periods(hand)) - {1} == set(periods(truth)) - {1} == {2, 4, 6, 8}
    assert set(periods(foot)) >= {2, 3, 4, 5, 6, 7, 8}
    exact = dict(zip(periods(truth), map(numbers, truth)))
    errors = np.array([np.subtract(numbers(message), exact[period]) for message, period in zip(
        hand, periods(hand)) if period in exact])
    assert 0.2 < errors.std() < 0.9
    assert client.node.count_publishers(f'truth/sensors/{FOOT}/imu') == 0
    assert client.node.count_publishers('truth/joint_states') == 0


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', seed=2))


@pytest.fixture(scope='module')
def served(simulation):
    return [found.name for found, *_ in topics_of_instruments(
        simulation, {Scope(): simulation.robot})]


def test_noise_of_a_sensor_is_repeated_by_its_seed_and_is_only_where_it_measures(simulation):
    instruments = simulation.instruments
    instruments.set_noise({HAND: 0.5})
    found = simulation.sensors.instrument(HAND)
    exact, drawn = found.read(simulation.data), []
    for seed in (2, 3, 2):
        simulation.reset(seed)
        drawn.append(instruments.measured(found) - exact)
    np.testing.assert_array_equal(drawn[0], drawn[2])
    assert (drawn[0] != drawn[1])[4:].all()
    other = simulation.sensors.instrument(FOOT)
    np.testing.assert_array_equal(instruments.measured(other), other.read(simulation.data))
    instruments.set_noise({})
    np.testing.assert_array_equal(instruments.measured(found), found.read(simulation.data))


@pytest.mark.parametrize('given, what', [
    (['robot0_right_imu'], "one of 'sensors' must hold keys and values, got 'robot0_right_imu'"),
    (['{name: imu'], "one of 'sensors' is invalid or unsafe YAML"),
    (['{name: robot0_right_im}'], "unknown sensor 'robot0_right_im': did you mean "
     "'robot0_right_imu'"),
    ([SLOW, SLOW], "the sensor 'robot0_right_imu' is described twice"),
    (['{rate: 50.0}'], "sensor without a name: needs 'name'"),
    ([f'{{name: {HAND}, rat: 50.0}}'], "unknown key 'rat': did you mean 'rate'"),
    ([f'{{name: {HAND}, rate: 200.0}}'],
     "parameter 'sensors: robot0_right_imu': 200 Hz is not possible"),
    ([f'{{name: {HAND}, noise: -1.0}}'], "'noise' must be at least 0, got -1")], ids=str)
def test_what_cannot_be_is_told_on_one_line(given, what, served):
    with pytest.raises(ManipSimError, match=what) as error:
        SensorSettings(given, served, 100.0)
    assert '\n' not in str(error.value)


@pytest.mark.full
@settings(max_examples=200, deadline=None)
@given(st.lists(st.text(max_size=20) | st.builds(
    '{{name: {}, rate: {}, noise: {}}}'.format, st.sampled_from([HAND, FOOT, 'x', '~', '[1]']),
    st.sampled_from(['50.0', '.nan', '-1', 'x', '[]', '1e999']) | st.floats().map(str),
    st.floats().map(str) | st.sampled_from(['{}', 'true', '!!python/x'])), max_size=3))
def test_any_text_gives_settings_or_one_line(served, given):
    try:
        found = SensorSettings(given, served, 100.0)
    except ManipSimError as error:
        assert '\n' not in str(error)
    else:
        assert all(every >= 1 for every in found.every.values())
        assert all(0.0 < noise <= 1000.0 for noise in found.noise.values())
