# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where the camera of MuJoCo's own window looks."""

import mujoco
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='the window needs ROS 2')
pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.viewer.ros.native import aim  # noqa: E402


@pytest.mark.parametrize('position, target', [
    ((2.0, 1.0, 1.5), (0.1, -0.2, 0.8)), ((-1.0, 3.0, 0.2), (0.0, 0.0, 1.0))])
def test_the_camera_looks_from_the_position_to_the_target(position, target):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    position, target = np.array(position), np.array(target)
    aim(camera, position, target)
    scene = mujoco.MjvScene(model, maxgeom=10)
    mujoco.mj_forward(model, data)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera,
                           mujoco.mjtCatBit.mjCAT_ALL, scene)
    # The two eyes stand beside each other.
    eyes = np.mean([eye.pos for eye in scene.camera], axis=0)
    assert eyes == pytest.approx(position, abs=1e-6)
    way = target - position
    assert scene.camera[0].forward == pytest.approx(way / np.linalg.norm(way), abs=1e-6)
