# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Choice of cameras and lidars by a user, by name or description, such as in a parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import re
from typing import Any

import mujoco

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import World
from manip_sim.models.cameras import ImageSettings, MAX_PIXELS
from manip_sim.models.cameras import camera_names
from manip_sim.models.strict_yaml import parse_yaml
from manip_sim.quoting import quoted

#: A token of a topic's name.
_TOKEN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


def described_cameras(given: Sequence[str]) -> list[dict[str, Any]]:
    """
    Return the descriptions among some texts: those that begin with a brace, as YAML.

    :raises ModelError: if one is not YAML
    """
    return [parse_yaml(text, "one of 'cameras'") for text in given if _is_description(text)]


def described_lidars(given: Sequence[str]) -> list[dict[str, Any]]:
    """
    Return the descriptions of lidars, as YAML; empty texts are ignored.

    :raises ModelError: if one is not YAML
    """
    for text in filter(None, given):
        if not _is_description(text):
            raise ModelError(f"one of 'lidars' must be a description such as {{name: scan, "
                             f'position: [0.5, 0.0, 0.2]}}, got {quoted(text)}')
    return [parse_yaml(text, "one of 'lidars'") for text in filter(None, given)]


def _is_description(text: str) -> bool:
    return text.lstrip().startswith('{')


def chosen_cameras(given: Sequence[str], world: World, model: mujoco.MjModel
                   ) -> dict[str, ImageSettings]:
    """
    Return the chosen cameras, in order, and the default settings of their images.

    :param given: names of cameras and descriptions; empty texts are ignored
    :param world: the world with the cameras that are described
    :param model: its ``mujoco.MjModel``
    :raises UnknownNameError: if the camera is unknown
    :raises ModelError: if a camera is chosen twice or its name cannot name a topic
    """
    described = iter(world.cameras)
    chosen: dict[str, ImageSettings] = {}
    for text in filter(None, given):
        if _is_description(text):
            camera = next(described)
            name, images = camera.name, camera.images
        else:
            name, images = text, _images_of(model, text)
        if name in chosen:
            raise ModelError(f'the camera {quoted(name)} is chosen twice')
        chosen[name] = images
    return chosen


def _images_of(model: mujoco.MjModel, name: str) -> ImageSettings:
    if name not in camera_names(model):
        raise UnknownNameError('camera', name, camera_names(model))
    if not _TOKEN.fullmatch(name):
        raise ModelError(f'the camera {quoted(name)} cannot have a topic: its name must consist '
                         'of letters, digits and underscores, and not begin with a digit')
    width, height = model.cam_resolution[model.camera(name).id].tolist()
    # MuJoCo's default resolution is 1 x 1.
    if (width, height) == (1, 1):
        return ImageSettings()
    return replace(ImageSettings(), width=min(width, MAX_PIXELS), height=min(height, MAX_PIXELS))
