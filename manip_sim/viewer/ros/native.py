# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""MuJoCo's own viewer in a window: it shows the node, and drives nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import math
import threading
import time

import mujoco
import mujoco.viewer
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from manip_sim.startup import EndSignals
from manip_sim.viewer.page.kinematics import Kinematics
from manip_sim.viewer.page.model_scene import first_view
from manip_sim.viewer.ros.discovery import Discovery
from manip_sim.viewer.ros.readers import Readers
from manip_sim.viewer.ros.states import States

_PERIOD_S = 1.0 / 60.0
_LOOK_S = 0.5
#: Aspect ratio of the part of the picture that the panels of the window never cover.
_ASPECT = 0.6
#: How long a window may take to close [s].
_CLOSING_S = 5.0


def show_native(node: Node, readers: Readers, simulation: str, run_ready: Callable[[], None],
                ended: EndSignals) -> None:
    """
    Show a node until the window is closed or the process is to end.

    :param node: the viewer's own
    :param simulation: full name of the node that is seen, without the first slash
    :param run_ready: runs the callbacks that are ready
    :param ended: the signals on which the process is to end
    """
    discovery = Discovery(node, readers, simulation)
    states = States(node, readers, simulation, discovery.base)
    print(f'sim_view: waiting for the node /{simulation}', flush=True)
    while not ended.wait(0.0):
        models = _wait_for_model(discovery, run_ready, ended)
        if models is None:
            return
        posture = Kinematics(discovery.model)
        with _open_window(posture) as window:
            with window.lock():
                aim(window.cam, *first_view(posture.model, posture.data, _ASPECT))
            print(f'sim_view: a window shows /{simulation}', flush=True)
            look_s = 0.0
            while window.is_running() and discovery.models == models:
                if ended.wait(_PERIOD_S):
                    return
                run_ready()
                if time.monotonic() > look_s:
                    look_s = time.monotonic() + _LOOK_S
                    discovery.look()
                    if discovery.layout is not None:
                        states.listen(discovery.layout)
                with window.lock():
                    for joints in states.latest.joints.values():
                        posture.set_joints(joints.names, joints.position)
                    for name, pose in states.latest.objects.items():
                        posture.place(name, pose.position, pose.quat_wxyz)
                    posture.compute()
                window.sync()
            if not window.is_running():
                return


@contextlib.contextmanager
def _open_window(posture: Kinematics) -> Iterator[mujoco.viewer.Handle]:
    """Open a window, and close it; its thread must not outlive the interpreter."""
    others = set(threading.enumerate())
    with mujoco.viewer.launch_passive(posture.model, posture.data) as window:
        drawing = set(threading.enumerate()) - others
        yield window
    for thread in drawing:
        thread.join(_CLOSING_S)


def aim(camera: mujoco.MjvCamera, position: NDArray[np.float64], target: NDArray[np.float64]
        ) -> None:
    """
    Let a free camera look from a position to a target.

    :param camera: is changed
    :param position: in ``world``, shape (3,) [m]
    :param target: in ``world``, shape (3,) [m]
    """
    way = target - position
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat = target
    camera.distance = np.linalg.norm(way)
    camera.azimuth = math.degrees(math.atan2(way[1], way[0]))
    camera.elevation = math.degrees(math.atan2(way[2], math.hypot(way[0], way[1])))


def _wait_for_model(discovery: Discovery, run_ready: Callable[[], None],
                    ended: EndSignals) -> int | None:
    """Return the number of the newest model when there is one; None if the process is to end."""
    while discovery.model is None:
        if ended.wait(_LOOK_S / 5.0):
            return None
        run_ready()
        discovery.look()
    return discovery.models
