# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Definitions of messages against those of another reader, and messages without ROS."""

import re
import struct

import numpy as np
import pytest

from manip_sim.errors import RecordError

for needed in ('mcap_ros2', 'rosbags'):
    pytest.importorskip(needed, reason='needs the extras records and test')

from rosbags.typesys import get_types_from_msg, get_typestore, Stores  # noqa: E402

from manip_sim.records import record_file  # noqa: E402
from manip_sim.records.record_file import (  # noqa: E402
    decoder, definition, encoded, full_name, installed, new_message)


@pytest.mark.parametrize('name', record_file._FIELDS)
def test_a_definition_has_the_fields_of_rosbags(name):
    store = get_typestore(Stores.ROS2_JAZZY)
    _, fields = get_types_from_msg(
        definition(name).partition('=' * 80)[0], full_name(name))[full_name(name)]
    _, expected = store.fielddefs[full_name(name)]
    assert fields == expected


def test_a_new_message_has_the_fields_and_defaults_of_its_type():
    message = new_message('sensor_msgs/Imu')
    assert message.orientation.w == 1.0 and message.header.stamp.sec == 0
    assert message.angular_velocity_covariance == [0.0] * 9


def test_a_message_is_encoded_with_what_was_set_and_arrays_of_numpy():
    message = new_message('sensor_msgs/Imu')
    message.header.frame_id, message.angular_velocity.y = 'hand', 2.0
    message.orientation_covariance = np.arange(9.0)
    found = decoder('sensor_msgs/Imu')(encoded('sensor_msgs/Imu', message))
    assert (found.header.frame_id, found.angular_velocity.y) == ('hand', 2.0)
    assert found.orientation_covariance == list(range(9))
    layout = new_message('std_msgs/Float64MultiArray')
    layout.layout.dim = [new_message('std_msgs/MultiArrayDimension')]
    layout.layout.dim[0].label = 'x'
    found = decoder('std_msgs/Float64MultiArray')(encoded('std_msgs/Float64MultiArray', layout))
    assert [dim.label for dim in found.layout.dim] == ['x']


def test_a_field_that_there_is_not_and_a_value_that_does_not_fit_are_errors():
    message = new_message('geometry_msgs/WrenchStamped')
    message.wrench.forces = 3.0
    with pytest.raises(AttributeError, match="Wrench has no field 'forces'"):
        encoded('geometry_msgs/WrenchStamped', message)
    number = new_message('std_msgs/Float64')
    number.data = 'text'
    with pytest.raises(ValueError, match='text'):
        encoded('std_msgs/Float64', number)
    count = new_message('sensor_msgs/Range')
    count.radiation_type = 300
    with pytest.raises(struct.error):
        encoded('sensor_msgs/Range', count)


def test_a_type_of_an_installed_package_needs_no_definition_here(tmp_path, monkeypatch):
    folder = tmp_path / 'share' / 'their_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Grasp.msg').write_text('# A grasp.\nstd_msgs/Header header\nPad[] pads\n')
    (folder / 'Pad.msg').write_text('float64 pressure 1.5\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    message = new_message('their_msgs/Grasp')
    message.pads = [new_message('their_msgs/Pad')]
    found = decoder('their_msgs/Grasp')(encoded('their_msgs/Grasp', message))
    assert [pad.pressure for pad in found.pads] == [1.5]


def test_a_type_that_nobody_has_is_an_error_with_its_name():
    message = re.escape('the definition of no_msgs/msg/None is not installed')
    for find in (lambda: new_message('no_msgs/None'), lambda: installed('no_msgs/msg/None')):
        with pytest.raises(RecordError, match=message):
            find()
