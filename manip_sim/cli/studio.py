# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A backdrop of one colour and lights that move with the camera, for pictures of parts."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mujoco

_BACKDROP = (0.71, 0.76, 0.81)
#: Narrow, so that what is near does not look larger [degrees].
_FIELD_OF_VIEW = 20.0
_AMBIENT = 0.42
#: Each light: its direction along the camera's right, up and forward; its brightness [1]. The
#: first casts shadows, straight down, so that they stay below and have no edges on walls.
_LIGHTS = (((0.0, -1.0, 0.0), 0.18), ((0.6, -0.6, 0.6), 0.46), ((-0.8, -0.1, 0.6), 0.22))
_SPECULAR = 0.35
#: For smooth edges and shadows: samples per pixel, and size of the shadow map [pixels].
_SAMPLES, _SHADOW_SIZE = 8, 8192


def prepare(model: mujoco.MjModel) -> None:
    """Give ground, sky and horizon of a model one colour; the model is changed in place."""
    import mujoco
    import numpy as np
    ground = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
    model.geom_matid[ground] = -1
    for texture in np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX):
        start = model.tex_adr[texture]
        size = (model.tex_height[texture] * model.tex_width[texture]
                * model.tex_nchannel[texture])
        model.tex_data[start:start + size] = np.resize(np.round(255 * np.array(_BACKDROP)), size)
    model.vis.rgba.haze[:3] = _BACKDROP
    model.vis.global_.fovy = _FIELD_OF_VIEW
    model.vis.quality.offsamples, model.vis.quality.shadowsize = _SAMPLES, _SHADOW_SIZE


def light(scene: mujoco.MjvScene, azimuth: float) -> None:
    """
    Replace the lights of a scene, and match its ground to the backdrop where no shadow falls.

    :param azimuth: of the view [degrees]
    """
    import mujoco
    import numpy as np
    turn = np.radians(azimuth)
    axes = np.array([[np.sin(turn), -np.cos(turn), 0.0], [0.0, 0.0, 1.0],
                     [np.cos(turn), np.sin(turn), 0.0]])
    on_ground = 0.0
    scene.nlight = len(_LIGHTS)
    for index, (direction, brightness) in enumerate(_LIGHTS):
        one = scene.lights[index]
        one.type, one.texid, one.headlight = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, -1, 0
        one.dir = np.array(direction) @ axes / np.linalg.norm(direction)
        one.pos = -5.0 * one.dir
        one.attenuation = (1.0, 0.0, 0.0)
        one.castshadow = index == 0
        # Its shadows, also those of a shape on its own walls, dim all three: so diffuse alone.
        one.ambient, one.diffuse, one.specular = (
            np.full(3, 0.0 if one.castshadow else _AMBIENT / (len(_LIGHTS) - 1)),
            np.full(3, brightness), np.full(3, 0.0 if one.castshadow else _SPECULAR))
        on_ground += one.ambient[0] - brightness * one.dir[2]
    for geom in scene.geoms[:scene.ngeom]:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.rgba[:3] = np.array(_BACKDROP) / on_ground
            geom.specular = geom.reflectance = 0.0
