# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Choose OpenGL by ``MUJOCO_GL`` when something is rendered, not when MuJoCo is imported.

So a process can import MuJoCo without OpenGL and render later, and one in which nothing can be
rendered learns why.
"""

from __future__ import annotations

from concurrent.futures import Future
import importlib
import os
import sys
import threading
from typing import Any

from manip_sim.errors import ManipSimError

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
