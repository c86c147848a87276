# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Render the views of cameras: colour, metric depth and labels; and their intrinsics.

OpenGL is chosen by ``MUJOCO_GL`` when something is rendered, not when MuJoCo is imported. So a
process can import MuJoCo without OpenGL and render later, and one that cannot render learns why.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
import importlib
import os
import sys
import threading
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.errors import ManipSimError, ModelError

_VARIABLE = 'MUJOCO_GL'
#: Niceness of rendering: on few processors it takes what the physics leaves.
_NICENESS = 10
_OFF = ('disable', 'disabled', 'off', 'false', '0')
_DEFAULT = ('', 'enable', 'enabled', 'on', 'true', '1')
#: The modules of MuJoCo that create contexts, by platform and value of ``MUJOCO_GL``.
_MODULES = {
    'linux': {'egl': 'egl', 'osmesa': 'osmesa', 'glfw': 'glfw', 'glx': 'glfw'},
    'darwin': {'cgl': 'cgl', 'glfw': 'glfw'},
    'win32': {'glfw': 'glfw', 'wgl': 'glfw'}}


def cannot_render(error: object) -> ManipSimError:
    """Return the error to raise for one of OpenGL or MuJoCo's renderer."""
    way = os.environ.get(_VARIABLE, 'the default')
    return ManipSimError(f'cannot render with {_VARIABLE}={way}: {error}')


def choose_gl() -> str:
    """
    Return the OpenGL backend that ``MUJOCO_GL`` selects, and write it there for MuJoCo.

    By default it is EGL on Linux, which needs no screen. Call this before threads start: it sets
    the environment variable.

    :raises ManipSimError: if rendering is switched off or the value is none of MuJoCo's
    """
    ways = _MODULES.get(sys.platform, {'glfw': 'glfw'})
    asked = os.environ.get(_VARIABLE, '').lower().strip()
    if asked in _OFF:
        raise cannot_render('this value switches rendering off')
    way = next(iter(ways)) if asked in _DEFAULT else asked
    if way not in ways:
        raise cannot_render(f'it must be one of {", ".join(ways)}')
    os.environ[_VARIABLE] = way
    return way


def create_context(way: str, width: int, height: int) -> Any:
    """
    Return an OpenGL context, current in this thread, with methods ``make_current`` and ``free``.

    Without a graphics card, the driver renders in threads that it starts with the context. On
    Linux they get a lower priority, this thread does not: it would hold Python's lock while it
    waits for a processor.

    :param way: as :func:`choose_gl` returns it
    :param width: of the largest image [pixels], as ``height``
    :raises ManipSimError: if it cannot be created, with the cause
    """
    module = _MODULES.get(sys.platform, {}).get(way, way)
    made: Future[Any] = Future()

    def make() -> None:
        try:
            if sys.platform == 'linux':  # There niceness is per thread, and inherited.
                os.nice(_NICENESS)
            made.set_result(importlib.import_module(f'mujoco.{module}').GLContext(width, height))
        except BaseException as error:  # The thread that waits has to learn of it.
            made.set_exception(error)
    threading.Thread(target=make, name='OpenGL', daemon=True).start()
    try:
        context = made.result()
        context.make_current()
    except Exception as error:  # Each backend has exceptions of its own.
        raise cannot_render(error) from error
    return context


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
    principal point has its sensor's pixels, stretched to the image.

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


_Flag = mujoco.mjtRndFlag
#: Effects that take most of the time without a graphics card.
_LEFT_OUT = (_Flag.mjRND_SHADOW, _Flag.mjRND_REFLECTION, _Flag.mjRND_HAZE)
#: The label of pixels without a body.
BACKGROUND = -1
#: Flags that let colours be the numbers of shapes in the scene.
_SEGMENTS = (_Flag.mjRND_SEGMENT, _Flag.mjRND_IDCOLOR)
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
#: Room in a scene for what MuJoCo adds to the shapes of a model, such as skins.
_MORE_SHAPES = 1000


@dataclass(frozen=True, eq=False)
class Picture:
    """
    View of a camera; rows go from the top to the bottom.

    :ivar rgb: shape (height, width, 3), or None
    :ivar depth: along the view [m], +Inf where there is nothing or it is too far, shape (height,
        width), or None
    :ivar labels: ids of the bodies, :data:`BACKGROUND` where there is none, shape (height, width),
        or None
    """

    rgb: NDArray[np.uint8] | None
    depth: NDArray[np.float32] | None
    labels: NDArray[np.int32] | None = None


class OffscreenRenderer:
    """
    A renderer with an OpenGL context of its own, for the thread that creates it.

    :param model: the ``mujoco.MjModel``; the settings of its offscreen buffer are changed
    :param width: of the largest image [pixels], as ``height``
    :param way: as :func:`choose_gl` returns it; None: that one
    :param effects: render shadows, reflections and several samples per pixel, which take most of
        the time without a graphics card
    :raises ManipSimError: if nothing can be rendered
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, way: str | None = None,
                 effects: bool = False) -> None:
        self._size, self._effects = (width, height), effects
        self._gl = create_context(way or choose_gl(), width, height)
        self._shown = mujoco.MjvOption()
        self._shown.geomgroup[3:] = 0
        self._shown.sitegroup[:] = 0
        try:
            self._use(model)
        except BaseException:
            self._gl.free()
            raise

    def replace_model(self, model: mujoco.MjModel) -> None:
        """Render another ``mujoco.MjModel``; the settings of its offscreen buffer are changed."""
        self._gl.make_current()
        self._context.free()
        self._use(model)

    def _use(self, model: mujoco.MjModel) -> None:
        self._model = model
        model.vis.global_.offwidth, model.vis.global_.offheight = self._size
        if not self._effects:
            model.vis.quality.offsamples = 0
        self._context = mujoco.MjrContext(model, int(mujoco.mjtFontScale.mjFONTSCALE_50))
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, model.ngeom + _MORE_SHAPES)
        for flag in () if self._effects else _LEFT_OUT:
            self._scene.flags[int(flag)] = 0
        near, far = (limit * model.stat.extent for limit in (
            model.vis.map.znear, model.vis.map.zfar))
        #: One divided by depth is linear in what OpenGL stores.
        self._slope, self._offset = np.float32(1.0 / near - 1.0 / far), np.float32(1.0 / far)

    def render(self, data: mujoco.MjData, camera: str | mujoco.MjvCamera, width: int, height: int,
               rgb: bool = True, depth: bool = True, labels: bool = False, *,
               prepare: Callable[[mujoco.MjvScene], None] | None = None) -> Picture:
        """
        Render what a camera sees.

        :param data: a ``mujoco.MjData`` of the model, after ``mj_camlight``
        :param camera: name of one of the model, or a free one
        :param width: of the image [pixels], as ``height``, at most this renderer's
        :param prepare: changes the scene before it is rendered
        """
        self._gl.make_current()
        area = mujoco.MjrRect(0, 0, width, height)
        colours = np.empty((height, width, 3), np.uint8) if rgb else None
        stored = np.empty((height, width), np.float32) if depth else None
        view = fixed_camera(self._model, camera) if isinstance(camera, str) else camera
        # MuJoCo puts infinite planes around the camera, which is otherwise the one before.
        mujoco.mjv_updateCamera(self._model, data, view, self._scene)
        mujoco.mjv_updateScene(self._model, data, self._shown, None, view,
                               int(mujoco.mjtCatBit.mjCAT_ALL), self._scene)
        if prepare is not None:
            prepare(self._scene)
        if rgb or depth:
            mujoco.mjr_render(area, self._scene, self._context)
            mujoco.mjr_readPixels(colours, stored, area, self._context)
        # OpenGL's rows go from the bottom to the top.
        return Picture(None if colours is None else np.ascontiguousarray(colours[::-1]),
                       None if stored is None else self._metres(stored[::-1]),
                       self._labels(area) if labels else None)

    def _labels(self, area: mujoco.MjrRect) -> NDArray[np.int32]:
        """Render the scene once more, with the ids of bodies as colours."""
        for flag in _SEGMENTS:
            self._scene.flags[int(flag)] = 1
        mujoco.mjr_render(area, self._scene, self._context)
        for flag in _SEGMENTS:
            self._scene.flags[int(flag)] = 0
        colours = np.empty((area.height, area.width, 3), np.uint8)
        mujoco.mjr_readPixels(colours, None, area, self._context)
        bodies = np.full(self._scene.ngeom + 1, BACKGROUND, np.int32)
        for shape in self._scene.geoms[:self._scene.ngeom]:
            if shape.segid >= 0 and shape.objtype == _GEOM:
                bodies[shape.segid + 1] = self._model.geom_bodyid[shape.objid]
        # Black is the background, and the colour of a shape is its number plus one.
        numbers = colours[::-1].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        return bodies[numbers]

    def _metres(self, stored: NDArray[np.float32]) -> NDArray[np.float32]:
        metres = stored * self._slope
        metres += self._offset
        np.reciprocal(metres, out=metres)
        metres[stored <= 0.0] = np.inf
        return metres

    def close(self) -> None:
        """Free the OpenGL resources."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()
