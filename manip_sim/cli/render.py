# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim render``: framed pictures of a composition, or of a part alone."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from manip_sim.cli.output import check_folder, write_whole
from manip_sim.errors import DivergenceError, ManipSimError, ModelError, UnknownNameError
from manip_sim.startup import import_mujoco

if TYPE_CHECKING:
    import mujoco
    from PIL.Image import Image

    from manip_sim.models import World
    from manip_sim.models.mjcf import MujocoXMLModel

#: Width of the view over that of its content.
_MARGIN = 1.05
#: Number of corrections of an aim; after a few times the margins differ by less than a pixel.
_CORRECTIONS = 10


@dataclass(frozen=True)
class View:
    """
    The direction that a picture is taken in; it shows everything, as large as possible.

    :ivar azimuth: looking along x is 0, along y is 90 [degrees]
    :ivar elevation: looking down is negative [degrees]
    :ivar camera: name of a camera of the model, used instead of the angles
    """

    azimuth: float = 140.0
    elevation: float = -12.0
    camera: str | None = None


TWO_SIDES = (View(), View(220.0))
#: To see into bins and onto tables.
TWO_SIDES_OF_ARENAS = tuple(View(view.azimuth, -35.0) for view in TWO_SIDES)


def cameras(views: Sequence[View], model: mujoco.MjModel, points: Any, aspect: float) -> list[Any]:
    """
    Return a camera for each view.

    Cameras that are not the model's see all points and share one distance, the least possible:
    their pictures have the same scale.

    :param points: in the world, (n, 3) [m]
    :param aspect: aspect ratio of each picture, width / height
    :raises UnknownNameError: if the camera is unknown
    """
    import mujoco
    names = [model.camera(index).name for index in range(model.ncam)]
    for view in views:
        if view.camera is not None and view.camera not in names:
            raise UnknownNameError('camera', view.camera, names)
    upward = np.tan(np.radians(model.vis.global_.fovy / 2.0)) / _MARGIN
    tangents = np.array([upward * aspect, upward])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    seen = {view: (points - middle) @ _axes(view).T for view in views if view.camera is None}
    distance = max((_nearest(of_view, tangents) for of_view in seen.values()), default=0.0)
    chosen: list[Any] = [view.camera for view in views]
    for index, view in enumerate(views):
        if view in seen:
            chosen[index] = camera = mujoco.MjvCamera()
            camera.azimuth, camera.elevation = view.azimuth, view.elevation
            camera.lookat[:] = middle + _aim(seen[view], distance) @ _axes(view)
            camera.distance = distance
    return chosen


def _axes(view: View) -> Any:
    """Return the right, up and forward directions of a camera, as rows."""
    turn, tilt = np.radians(view.azimuth), np.radians(view.elevation)
    away = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    aside = np.array([np.sin(turn), -np.cos(turn), 0.0])
    return np.array([aside, np.cross(aside, away), away])


def _nearest(seen: Any, tangents: Any) -> float:
    """Return the least distance from which a well aimed camera sees all points [m]."""
    reach = seen[:, 2:] * tangents
    spread = (seen[:, :2] - reach).max(axis=0) - (seen[:, :2] + reach).min(axis=0)
    return float((spread / tangents / 2.0).max())


def _aim(seen: Any, distance: float) -> Any:
    """Return where to aim so that opposite margins are equal, along the camera's axes [m]."""
    aim = np.zeros(3)
    for _ in range(_CORRECTIONS):  # Near points shift more than far ones.
        at = (seen - aim)[:, :2] / (seen[:, 2:] + distance)
        aim[:2] += distance * (at.min(axis=0) + at.max(axis=0)) / 2.0
    return aim


_BACKDROP = (0.71, 0.76, 0.81)
#: Narrow, so that near things do not look larger [degrees].
_FIELD_OF_VIEW = 20.0
_AMBIENT = 0.42
#: Each light: its direction along the camera's right, up and forward; its brightness [1]. The
#: first casts shadows, straight down, so that they stay below and have no edges on walls.
_LIGHTS = (((0.0, -1.0, 0.0), 0.18), ((0.6, -0.6, 0.6), 0.46), ((-0.8, -0.1, 0.6), 0.22))
_SPECULAR = 0.35
#: For smooth edges and shadows: samples per pixel, and size of the shadow map [pixels].
_SAMPLES, _SHADOW_SIZE = 8, 8192
#: Height above the floor of the lowest shape of a part that is shown alone [m].
_ABOVE_FLOOR = 0.01
#: Time for grippers to open; the slowest one takes eight to nine seconds [s].
_OPENING_S = 12.0
#: Part of the floor in a picture of an arena without furniture, by its corners [m].
_FLOOR = ((-1.0, -1.0, 0.0), (-1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0))


def prepare_studio(model: mujoco.MjModel) -> None:
    """Give ground, sky and horizon of a model one colour; the model is changed in place."""
    import mujoco
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


def light_studio(scene: mujoco.MjvScene, azimuth: float) -> None:
    """Light a scene seen from an azimuth [degrees], and match its ground to the backdrop."""
    import mujoco
    turn = np.radians(azimuth)
    axes = np.array([[np.sin(turn), -np.cos(turn), 0.0], [0.0, 0.0, 1.0],
                     [np.cos(turn), np.sin(turn), 0.0]])
    on_ground = 0.0
    scene.nlight = len(_LIGHTS)
    for index, (direction, brightness) in enumerate(_LIGHTS):
        light = scene.lights[index]
        light.type, light.texid, light.headlight = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, -1, 0
        light.dir = np.array(direction) @ axes / np.linalg.norm(direction)
        light.pos = -5.0 * light.dir
        light.attenuation = (1.0, 0.0, 0.0)
        light.castshadow = index == 0
        # Its shadows, also those of a shape on its own walls, dim all three: so diffuse alone.
        light.ambient, light.diffuse, light.specular = (
            np.full(3, 0.0 if light.castshadow else _AMBIENT / (len(_LIGHTS) - 1)),
            np.full(3, brightness), np.full(3, 0.0 if light.castshadow else _SPECULAR))
        on_ground += light.ambient[0] - brightness * light.dir[2]
    for geom in scene.geoms[:scene.ngeom]:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.rgba[:3] = np.array(_BACKDROP) / on_ground
            geom.specular = geom.reflectance = 0.0


def picture_of_world(world: World, size: tuple[int, int], views: Sequence[View] = TWO_SIDES,
                     in_studio: bool = False, grippers_open: bool = False) -> Image:
    """
    Render a world at its start.

    :param size: width and height of the picture; views stand side by side in it [pixels]
    :param views: directions of view, from left to right
    :param in_studio: before a backdrop of one colour instead of the arena's floor and sky
    :param grippers_open: as they are after a command to open, wherever they start
    :raises UnknownNameError: if the camera is unknown
    :raises ManipSimError: if nothing can be rendered
    """
    model, data = _start_of(world, grippers_open)
    return picture_of_state(model, data, size, views, in_studio,
                            _FLOOR if not world.robots else ())


def picture_of_part(part: MujocoXMLModel, size: tuple[int, int],
                    views: Sequence[View] = TWO_SIDES, in_studio: bool = False) -> Image:
    """
    Render a gripper or a base alone over a floor, a gripper as on a flange that faces down.

    Parameters and errors as of :func:`picture_of_world`.
    """
    import mujoco

    from manip_sim.models import create_arena
    from manip_sim.models.grippers import GripperModel
    from manip_sim.models.loading import compile_spec
    from manip_sim.simulation.episode_start import start_without_control

    frame, height = {}, 0.0
    by_joint: dict[str, float] = {}
    if isinstance(part, GripperModel):
        frame['quat'] = [0.0, 1.0, 0.0, 0.0]
        if part.init_qpos is not None:
            by_joint = dict(zip(part.joints, np.asarray(part.init_qpos, dtype=float).tolist()))
    for _ in range(2):  # The height follows from the shapes of the first pass.
        spec = create_arena('empty').compose()
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        part.attach_to(spec, spec.worldbody.add_frame(pos=[0.0, 0.0, height], **frame))
        model = compile_spec(spec, part.name)
        data = start_without_control(model, by_joint)
        corners = _visible_corners(model, data)
        if not len(corners):
            raise ModelError(f'{part.name} has no visible shapes (group 0 to 2), so no picture')
        height += _ABOVE_FLOOR - float(corners[:, 2].min())
    return picture_of_state(model, data, size, views, in_studio)


def picture_of_state(model: mujoco.MjModel, data: mujoco.MjData, size: tuple[int, int],
                     views: Sequence[View] = TWO_SIDES, in_studio: bool = False,
                     else_shown: Sequence[Sequence[float]] = ()) -> Image:
    """
    Render the present state of a model.

    :param data: after ``mj_forward``
    :param else_shown: points that fill the picture if nothing but the world has visible shapes [m]

    Other parameters and errors as of :func:`picture_of_world`.
    """
    import mujoco
    from PIL import Image

    from manip_sim.rendering import cannot_render, OffscreenRenderer

    corners = _visible_corners(model, data)
    if not len(corners):
        if not else_shown:
            raise ModelError('without visible shapes (group 0 to 2) there is no picture')
        corners = np.array(else_shown)
    width, height = -(-size[0] // len(views)), size[1]
    if in_studio:
        prepare_studio(model)
    seen_by = cameras(views, model, corners, width / height)
    picture = Image.new('RGB', size)
    try:
        renderer = OffscreenRenderer(model, width, height, effects=True)
    except mujoco.FatalError as error:
        raise cannot_render(error) from error
    with contextlib.closing(renderer):
        for index, camera in enumerate(seen_by):
            light = partial(light_studio, azimuth=views[index].azimuth)
            seen = renderer.render(data, camera, width, height, depth=False,
                                   prepare=light if in_studio else None)
            picture.paste(Image.fromarray(seen.rgb), (index * size[0] // len(views), 0))
    return picture


def _start_of(world: World, grippers_open: bool = False) -> tuple[Any, Any]:
    """Return model and data of a world at its start, even if it cannot be controlled."""
    from manip_sim.simulation import Simulation
    from manip_sim.simulation.episode_start import start_without_control
    if world.robots:
        with contextlib.suppress(ModelError):
            simulation = Simulation(world, visual=True)
            if grippers_open:
                for robot in simulation.robots.values():
                    for part, gripper in robot.grippers.items():
                        robot.apply(robot.parse.action(part, [-1.0] * gripper.dof))
                with contextlib.suppress(DivergenceError):
                    simulation.advance(round(_OPENING_S / simulation.timestep_s))
            return simulation.model, simulation.data
    model = world.compile()
    return model, start_without_control(model, world.init_qpos())


def _visible_corners(model: mujoco.MjModel, data: mujoco.MjData) -> Any:
    """Return the corners of the bounding boxes of visible shapes but the world's [m], (n, 3)."""
    signs = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, 8).T
    corners = [np.empty((0, 3))]
    for geom in np.flatnonzero((model.geom_group < 3) & (model.geom_bodyid != 0)):
        middle, half = np.split(model.geom_aabb[geom], 2)
        corners.append(data.geom_xpos[geom]
                       + (middle + signs * half) @ data.geom_xmat[geom].reshape(3, 3).T)
    return np.concatenate(corners)


_ENDINGS = ('.png', '.jpg', '.jpeg')


def run(options: argparse.Namespace) -> tuple[str, int]:
    file: Path = options.file
    if file.suffix.lower() not in _ENDINGS:
        raise ManipSimError(f'{file}: the name must end with .png or .jpg')
    check_folder(file)
    import_mujoco()
    picture = _picture(options)
    write_whole(file, picture.save)
    return str(file), 0


def _picture(options: argparse.Namespace) -> Image:
    from manip_sim.cli.composing_options import arena_from, compose_from
    from manip_sim.models import World
    from manip_sim.models.bases import create_base
    from manip_sim.models.grippers import create_gripper

    shows_arena = options.robot == 'none' and options.arena is not None
    views = TWO_SIDES_OF_ARENAS if shows_arena else TWO_SIDES
    if options.camera is not None:
        views = (View(camera=options.camera),)
    elif (options.azimuth, options.elevation) != (None, None):
        azimuth, elevation = options.azimuth, options.elevation
        views = (View(views[0].azimuth if azimuth is None else azimuth,
                      views[0].elevation if elevation is None else elevation),)
    if options.robot != 'none':
        world = compose_from(options).composition.world
        return picture_of_world(world, options.size, views)
    if options.gripper is not None:
        return picture_of_part(create_gripper(options.gripper), options.size, views)
    if options.base is not None:
        return picture_of_part(create_base(options.base), options.size, views)
    return picture_of_world(World([], arena_from(options)), options.size, views)
