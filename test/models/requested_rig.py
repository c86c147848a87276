# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that a request may name: files of our own making below a folder, with meshes."""

import struct

import numpy as np

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
_FACES = ((0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4), (2, 6, 3), (3, 6, 7),
          (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5))


def stl(size=0.1):
    """Return a cube as binary STL."""
    faces = b''.join(struct.pack('<12fH', 0, 0, 0, *(size * _CORNERS[list(face)]).ravel(), 0)
                     for face in _FACES)
    return bytes(80) + struct.pack('<I', len(_FACES)) + faces


def urdf(mesh='package://lab_arm/meshes/link.stl', more=''):
    """Return the URDF of an arm of two links, each with a mesh."""
    link = f"""<visual><geometry><mesh filename="{mesh}"/></geometry></visual>
      <collision><geometry><box size="0.05 0.05 0.2"/></geometry></collision>
      <inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
    return f"""<robot name="arm"><link name="base"/>
      <link name="upper">{link}</link><link name="lower">{link}</link>
      <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
        <origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" velocity="2" effort="80"/></joint>
      <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
        <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
        <limit lower="-2" upper="2" velocity="2" effort="80"/></joint>
      <gazebo><plugin filename="libgazebo_ros_control.so" name="c"/></gazebo>{more}</robot>"""


def write_package(folder):
    """Write a package with a robot, and return the folder."""
    package = folder / 'lab_arm'
    (package / 'meshes').mkdir(parents=True)
    (package / 'meshes/link.stl').write_bytes(stl())
    (package / 'package.xml').write_text('<package><name>lab_arm</name></package>')
    (package / 'arm.urdf').write_text(urdf())
    (package / 'arm.srdf').write_text(
        '<robot><disable_collisions link1="base" link2="lower"/></robot>')
    return package
