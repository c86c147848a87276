# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The intrinsics of the cameras of a model: where an image shows a point."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from manip_sim.errors import ModelError


@dataclass(frozen=True)
class Intrinsics:
    """
    An ideal pinhole camera: u = fx x / z + cx, v = fy y / z + cy, in its optical frame.

    The optical frame looks along z, with x to the right and y down. The middle of the first pixel
    is at (0, 0), as in OpenCV and image_geometry, so that the middle of an image of w pixels is at
    (w - 1) / 2.

    :ivar width: of the image [pixels], as ``height``, ``fx``, ``fy``, ``cx`` and ``cy``
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


def intrinsics_of(model: mujoco.MjModel, camera: str, width: int, height: int) -> Intrinsics:
    """
    Return the intrinsics that MuJoCo renders a camera with.

    A camera with a field of view has square pixels; one with a sensor size, focal length and
    principal point has those of its sensor, stretched to the image.

    :param width: of the image [pixels], as ``height``
    :raises ModelError: if the camera is orthographic
    """
    # MuJoCo's own frustum, since versions differ in the sign of the principal point.
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, 1)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mjv_updateCamera(model, data, fixed_camera(model, camera), scene)
    frustum = scene.camera[0]
    if getattr(frustum, 'orthographic', 0):
        raise ModelError(f"camera '{camera}' is orthographic: no camera_info can describe it")
    top, tall = frustum.frustum_top, frustum.frustum_top - frustum.frustum_bottom
    # MuJoCo's frustum_width is half the width, and zero where pixels are square.
    half = frustum.frustum_width or 0.5 * tall * width / height
    near = frustum.frustum_near
    return Intrinsics(
        width, height, fx=near * width / (2.0 * half), fy=near * height / tall,
        cx=(half - frustum.frustum_center) / (2.0 * half) * width - 0.5,
        cy=top / tall * height - 0.5)


def fixed_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    """Return a camera of a model, to be rendered."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = model.camera(name).id
    return camera
