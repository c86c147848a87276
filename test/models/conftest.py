# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots of a few hinges and a base on wheels for the tests of models."""

import pytest

from manip_sim.models.bases import MobileBaseModel


@pytest.fixture
def robot_with(robot_class, mjcf):
    """Return a function that makes a robot of a chain of hinges with the names given."""
    def make(*joints, idn=0, root='', subsystem_of_joint=None):
        links, closing = '', ''
        for name in joints:
            links += f'<body><joint name="{name}" range="-1 1"/><geom size="0.1"/>'
            closing += '</body>'
        actuators = ''.join(f'<motor name="m{i}" joint="{name}" ctrlrange="-{i + 1} {i + 1}"/>'
                            for i, name in enumerate(joints))
        robot_class._subsystem_of_joint = subsystem_of_joint or {}
        return robot_class(mjcf(f'<body name="base" {root}>{links}<geom size="0.1"/>{closing}'
                                '</body>', f'<actuator>{actuators}</actuator>'), idn)
    return make


@pytest.fixture
def mobile_base(mjcf):
    """Return a base that slides along x and lifts its support."""
    class Cart(MobileBaseModel, registered=False):
        _top_offset = (0.0, 0.0, 0.2)

    return Cart(mjcf("""
        <body name="cart">
          <joint name="joint_mobile_forward" type="slide" axis="1 0 0"/><geom size="0.1" mass="5"/>
          <body name="support" pos="0 0 0.2">
            <joint name="joint_torso_height" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/>
          </body>
        </body>""", """
        <actuator><velocity name="drive" joint="joint_mobile_forward" kv="9" ctrlrange="-2 2"/>
        <motor name="mobile_lift" joint="joint_torso_height" ctrlrange="-80 80"/></actuator>""",
                     name='cart'))
