# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The fields of the ROS messages in records, which are written without ROS.

Types and names are those of common_interfaces and rcl_interfaces, release Jazzy.
"""

from __future__ import annotations

#: Fields of each type, without the separator `/msg/` in its name.
_FIELDS = {
    'builtin_interfaces/Time': 'int32 sec; uint32 nanosec',
    'geometry_msgs/Point': 'float64 x; float64 y; float64 z',
    'geometry_msgs/Pose': 'geometry_msgs/Point position; geometry_msgs/Quaternion orientation',
    'geometry_msgs/PoseStamped': 'std_msgs/Header header; geometry_msgs/Pose pose',
    'geometry_msgs/Quaternion': 'float64 x 0; float64 y 0; float64 z 0; float64 w 1',
    'geometry_msgs/Vector3': 'float64 x; float64 y; float64 z',
    'geometry_msgs/Wrench': 'geometry_msgs/Vector3 force; geometry_msgs/Vector3 torque',
    'geometry_msgs/WrenchStamped': 'std_msgs/Header header; geometry_msgs/Wrench wrench',
    'rosgraph_msgs/Clock': 'builtin_interfaces/Time clock',
    'sensor_msgs/CompressedImage': 'std_msgs/Header header; string format; uint8[] data',
    'sensor_msgs/JointState': 'std_msgs/Header header; string[] name; float64[] position; '
                              'float64[] velocity; float64[] effort',
    'std_msgs/Bool': 'bool data',
    'std_msgs/Float64': 'float64 data',
    'std_msgs/Float64MultiArray': 'std_msgs/MultiArrayLayout layout; float64[] data',
    'std_msgs/Header': 'builtin_interfaces/Time stamp; string frame_id',
    'std_msgs/MultiArrayDimension': 'string label; uint32 size; uint32 stride',
    'std_msgs/MultiArrayLayout': 'std_msgs/MultiArrayDimension[] dim; uint32 data_offset',
    'std_msgs/String': 'string data'}
_SEPARATOR = '=' * 80


def full_name(name: str) -> str:
    """
    Return the name of a type as in messages, such as ``std_msgs/msg/Bool``.

    :param name: such as ``std_msgs/Bool``
    """
    return name.replace('/', '/msg/')


def definition(name: str) -> str:
    """
    Return the definition of a type followed by those that it refers to, as rosbag2 stores it.

    :param name: such as ``std_msgs/Bool``
    """
    found = [name]
    for known in found:
        for field in _FIELDS[known].split('; '):
            type_name = field.split()[0].removesuffix('[]')
            if type_name in _FIELDS and type_name not in found:
                found.append(type_name)
    return '\n'.join([_lines(name), *(
        f'{_SEPARATOR}\nMSG: {other}\n{_lines(other)}' for other in found[1:])])


def _lines(name: str) -> str:
    return _FIELDS[name].replace('; ', '\n')
