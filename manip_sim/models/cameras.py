# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cameras and lidars that are added to a world, and the choice of cameras by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import re
from typing import Any, Union

import mujoco
import numpy as np

from manip_sim.algebra import length, NO_TURN
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.spec_edits import body_for
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import quoted
from manip_sim.sensing.images import MAX_PIXELS
from manip_sim.sensing.lidars import MAX_RAYS, Rays

#: Of the site that marks the lidar [m].
_SITE_SIZE_M = 0.01
#: No viewer shows sites of this group by default.
_SITE_GROUP = 5


@dataclass(frozen=True)
class LidarModel:
    """
    A lidar that is fixed to a body.

    :ivar name: of the lidar, its site, its frame and its topics
    :ivar body: name of that body in the composed world; ``world`` for none
    :ivar position: in the frame of the body [m], shape (3,)
    :ivar quat_wxyz: of its frame, with x ahead and z up, shape (4,)
    :ivar rate_hz: scans per second of simulation time [Hz]
    :ivar noise: standard deviation of the white noise on distances [m]
    """

    name: str
    body: str = 'world'
    position: FloatArray = field(default_factory=lambda: np.zeros(3))
    quat_wxyz: FloatArray = field(default_factory=lambda: np.array(NO_TURN))
    rays: Rays = Rays()
    rate_hz: float = 10.0
    noise: float = 0.0

    def attach(self, spec: mujoco.MjSpec) -> None:
        """Add the site of the lidar to the spec of a world."""
        body = body_for(spec, f"lidar '{self.name}'", self.name, self.body,
                        {'site': '', 'camera': '', 'body': ''})
        body.add_site(name=self.name, pos=self.position, quat=self.quat_wxyz,
                      size=[_SITE_SIZE_M] * 3, group=_SITE_GROUP)


LidarLike = Union[LidarModel, Mapping[str, Any]]


def create_lidar(description: LidarLike) -> LidarModel:
    """
    Create a lidar.

    :param description: the keys of :class:`LidarDescription`; a lidar is returned as it is
    :raises ModelError: if something is wrong with it, on one line with lidar and key
    """
    if isinstance(description, LidarModel):
        return description
    # Imported late: it needs pydantic 2, which Ubuntu 24.04 does not have.
    from manip_sim.models.descriptions import LidarDescription, read_mounted
    parsed, source = read_mounted(LidarDescription, 'lidar', description)
    values = parsed.model_dump(exclude_none=True)
    rays = Rays(**{key: value for key, value in values.items() if key in Rays.__annotations__})
    for low, high in (('angle_min', 'angle_max'), ('elevation_min', 'elevation_max'),
                      ('range_min', 'range_max')):
        if getattr(rays, low) >= getattr(rays, high):
            raise ModelError(f"{source}: '{low}' must be less than '{high}', got "
                             f'{getattr(rays, low):g} and {getattr(rays, high):g}')
    if rays.samples * rays.rings > MAX_RAYS:
        raise ModelError(f"{source}: 'samples' times 'rings' must be at most {MAX_RAYS}, got "
                         f'{rays.samples * rays.rings}')
    quat_wxyz = parsed.quat_wxyz
    return LidarModel(parsed.name, parsed.body or 'world',
                      np.array(parsed.position or [0.0, 0.0, 0.0], dtype=float),
                      np.array(NO_TURN) if quat_wxyz is None else quat_wxyz, rays, parsed.rate,
                      parsed.noise)


#: From a frame that looks along x with z up to MuJoCo's camera, which looks along -z with y up.
_TO_MUJOCO = np.array([0.5, 0.5, -0.5, -0.5])
#: Below this sine of the angle between view and vertical, up in the image cannot be z.
_PARALLEL = 1e-6


@dataclass(frozen=True)
class ImageSettings:
    """
    Size and rate of a camera's images, and whether there are depth images.

    :ivar width: [pixels], as ``height``
    :ivar rate_hz: images per second of simulation time [Hz]
    """

    width: int = 640
    height: int = 480
    rate_hz: float = 20.0
    depth: bool = True


@dataclass(frozen=True)
class CameraModel:
    """
    A camera that is fixed to a body.

    :ivar name: of the camera and its topics
    :ivar body: name of that body in the composed world; ``world`` for none
    :ivar position: in the frame of the body [m], shape (3,)
    :ivar quat_wxyz: of MuJoCo's camera, which looks along -z with y up, shape (4,)
    :ivar fovy_deg: vertical field of view [degrees]
    """

    name: str
    body: str
    position: FloatArray
    quat_wxyz: FloatArray
    fovy_deg: float
    images: ImageSettings = ImageSettings()

    def attach(self, spec: mujoco.MjSpec) -> None:
        """Add the camera to the spec of a world."""
        body = body_for(spec, f"camera '{self.name}'", self.name, self.body, {
            'camera': '; write its name alone to take that one', 'body': ''})
        body.add_camera(name=self.name, pos=self.position, quat=self.quat_wxyz,
                        fovy=self.fovy_deg)


Camera = Union[CameraModel, Mapping[str, Any]]


def create_camera(description: Camera) -> CameraModel:
    """
    Create a camera.

    :param description: the keys of :class:`CameraDescription`; a camera is returned as it is
    :raises ModelError: if something is wrong with it, on one line with camera and key
    """
    if isinstance(description, CameraModel):
        return description
    # Imported late: it needs pydantic 2, which Ubuntu 24.04 does not have.
    from manip_sim.models.descriptions import CameraDescription, read_mounted
    parsed, _ = read_mounted(CameraDescription, 'camera', description)
    values: dict[str, Any] = {'width': parsed.width, 'height': parsed.height,
                              'rate_hz': parsed.rate, 'depth': parsed.depth}
    position = np.array(parsed.position or [0.0, 0.0, 0.0], dtype=float)
    quat_wxyz = np.empty(4)
    looks_along = (_toward(parsed.look_at, position) if parsed.quat_wxyz is None
                   else parsed.quat_wxyz)
    mujoco.mju_mulQuat(quat_wxyz, looks_along, _TO_MUJOCO)
    return CameraModel(
        parsed.name, parsed.body or 'world', position, quat_wxyz, parsed.fovy,
        replace(ImageSettings(), **{k: value for k, value in values.items() if value is not None}))


def _toward(point: Sequence[float] | None, position: FloatArray) -> FloatArray:
    """Return the orientation w, x, y, z of the frame whose x points to a point, with z up."""
    if point is None:
        return np.array(NO_TURN)
    forward = np.array(point) - position
    forward /= length(forward)
    left = np.cross([0.0, 0.0, 1.0], forward)
    if length(left) < _PARALLEL:
        left = np.cross([1.0, 0.0, 0.0], forward)
    left /= length(left)
    quat_wxyz = np.empty(4)
    axes = np.stack([forward, left, np.cross(forward, left)], axis=1)
    mujoco.mju_mat2Quat(quat_wxyz, axes.ravel())
    return quat_wxyz


def camera_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of the cameras of a ``mujoco.MjModel``."""
    return [model.camera(index).name for index in range(model.ncam)]


#: A token of a topic's name.
_TOKEN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


def described_cameras(texts: Sequence[str]) -> list[dict[str, Any]]:
    """
    Return the descriptions among some texts: those that begin with a brace, as YAML.

    :raises ModelError: if one is not YAML
    """
    return [parse_yaml(text, "one of 'cameras'") for text in texts if _is_description(text)]


def described_lidars(texts: Sequence[str]) -> list[dict[str, Any]]:
    """
    Return the descriptions of lidars, as YAML; empty texts are ignored.

    :raises ModelError: if one is not YAML
    """
    for text in filter(None, texts):
        if not _is_description(text):
            raise ModelError(f"one of 'lidars' must be a description such as {{name: scan, "
                             f'position: [0.5, 0.0, 0.2]}}, got {quoted(text)}')
    return [parse_yaml(text, "one of 'lidars'") for text in filter(None, texts)]


def _is_description(text: str) -> bool:
    return text.lstrip().startswith('{')


def chosen_cameras(texts: Sequence[str], added: Sequence[CameraModel], model: mujoco.MjModel
                   ) -> dict[str, ImageSettings]:
    """
    Return the chosen cameras, in order, and the default settings of their images.

    :param texts: names of cameras and descriptions; empty texts are ignored
    :param added: the cameras of the descriptions, as a world has them
    :param model: the ``mujoco.MjModel`` of that world
    :raises UnknownNameError: if the camera is unknown
    :raises ModelError: if a camera is chosen twice or its name cannot name a topic
    """
    described = iter(added)
    chosen: dict[str, ImageSettings] = {}
    for text in filter(None, texts):
        if _is_description(text):
            camera = next(described)
            name, images = camera.name, camera.images
        else:
            name, images = text, ImageSettings()
            if name not in camera_names(model):
                raise UnknownNameError('camera', name, camera_names(model))
            if not _TOKEN.fullmatch(name):
                raise ModelError(f'the camera {quoted(name)} cannot have a topic: its name must '
                                 'consist of letters, digits and underscores, and not begin with '
                                 'a digit')
            width, height = model.cam_resolution[model.camera(name).id].tolist()
            if (width, height) != (1, 1):  # MuJoCo's default.
                images = ImageSettings(min(width, MAX_PIXELS), min(height, MAX_PIXELS))
        if name in chosen:
            raise ModelError(f'the camera {quoted(name)} is chosen twice')
        chosen[name] = images
    return chosen
