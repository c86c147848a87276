# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that renders: it gets snapshots from the physics, which never waits for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
import threading
import time

from manip_sim.errors import ManipSimError
from manip_sim.rendering import cannot_render, OffscreenRenderer, Picture
from manip_sim.sensing.images import ImageNoise
from manip_sim.simulation.snapshots import Snapshot, VisibleWorld

THREAD_NAME = 'cameras'
#: Time that a running rendering may still take when the thread is to end [s].
_LAST_S = 2.0


@dataclass(frozen=True)
class CameraView:
    """
    A camera and the size of its images.

    :ivar camera: its name
    :ivar width: [pixels], as ``height``
    :ivar exact: whether its images are exact beside others that are measured
    """

    camera: str
    width: int
    height: int
    exact: bool = False


@dataclass(frozen=True, eq=False)
class Shot:
    """
    A picture of a camera, with its instant.

    :ivar view: the camera
    :ivar snapshot: of the instant
    :ivar picture: colours, depth, labels: at least the requested ones
    :ivar took_s: wall time of the rendering [s]; 0 if an earlier picture is used again
    :ivar noise: to be added to the picture, or None
    """

    view: CameraView
    snapshot: Snapshot
    picture: Picture
    took_s: float
    noise: ImageNoise | None = None


@dataclass(frozen=True, eq=False)
class _Order:
    view: CameraView
    snapshot: Snapshot
    rgb: bool
    depth: bool
    labels: bool
    noise: ImageNoise | None

    def is_met_by(self, shot: Shot) -> bool:
        return (self.view.camera == shot.view.camera
                and self.snapshot.shows_the_same_as(shot.snapshot)
                and (shot.picture.rgb is not None or not self.rgb)
                and (shot.picture.depth is not None or not self.depth)
                and (shot.picture.labels is not None or not self.labels))


class CameraThread:
    """
    A thread that renders, with an OpenGL context and an ``MjData`` of its own.

    For each camera the newest snapshot counts: one that has not been rendered when the next comes
    is left out.

    :param way: to render, as :func:`manip_sim.rendering.choose_gl` returns it
    :param world: as it is at the start
    :param views: the cameras
    :param deliver: is called in this thread with each shot
    :param report_failure: is called in this thread with the error that ends the rendering
    :ivar left_out: how many snapshots of each camera were not rendered because newer ones came
    :ivar failed: why nothing is rendered, or None
    """

    def __init__(self, way: str, world: VisibleWorld, views: list[CameraView],
                 deliver: Callable[[Shot], None],
                 report_failure: Callable[[ManipSimError], None]) -> None:
        self._way = way
        self._world = world
        self._size = max(view.width for view in views), max(view.height for view in views)
        self._deliver = deliver
        self._report_failure = report_failure
        self._orders: dict[CameraView, _Order] = {}
        self._shots: dict[CameraView, Shot] = {}
        self._wake = threading.Condition()
        self._stopping = False
        self._ready = threading.Event()
        self.left_out: Counter[str] = Counter()
        self.failed: ManipSimError | None = None
        # A rendering that hangs must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name=THREAD_NAME, daemon=True)

    def start(self, timeout_s: float) -> None:
        """
        Start the thread, and wait until OpenGL is ready or has failed.

        :param timeout_s: how long to wait at most [s]
        """
        self._thread.start()
        self._ready.wait(timeout_s)

    def order(self, view: CameraView, snapshot: Snapshot, rgb: bool, depth: bool,
              labels: bool = False, noise: ImageNoise | None = None) -> None:
        """
        Request a shot of a view, and return at once.

        :param rgb: whether colours are needed
        :param depth: whether depth is needed
        :param labels: whether the ids of bodies are needed
        :param noise: that the shot hands on; the rendered picture is exact
        """
        if self.failed is not None:
            return
        with self._wake:
            if view in self._orders:
                self.left_out[view.camera] += 1
            self._orders[view] = _Order(view, snapshot, rgb, depth, labels, noise)
            self._wake.notify()

    def stop(self, timeout_s: float = _LAST_S) -> bool:
        """
        End the thread.

        :param timeout_s: how long to wait for a rendering that runs [s]
        :returns: whether it has ended; if not, the process must end by ``os._exit``
        """
        with self._wake:
            self._stopping = True
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # ------------------------------------------------------------------ in the thread

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:  # OpenGL and MuJoCo raise many types.
            self.failed = error if isinstance(error, ManipSimError) else cannot_render(error)
            if not self._stopping:
                self._report_failure(self.failed)
        finally:
            self._ready.set()
            self._shots.clear()

    def _serve(self) -> None:
        renderer = OffscreenRenderer(self._world.model, *self._size, self._way)
        try:
            self._ready.set()
            while True:
                for order in self._wait():
                    if self._stopping:
                        return
                    if order.snapshot.plan is not self._world.plan:
                        self._world = VisibleWorld(order.snapshot.plan)
                        renderer.replace_model(self._world.model)
                    self._meet(order, renderer)
                if self._stopping:
                    return
        finally:
            renderer.close()

    def _wait(self) -> list[_Order]:
        with self._wake:
            while not (self._orders or self._stopping):
                self._wake.wait()
            orders, self._orders = self._orders, {}
        return list(orders.values())

    def _meet(self, order: _Order, renderer: OffscreenRenderer) -> None:
        if order.view.camera not in self._world.cameras:  # Deleted with its object.
            return
        last = next(filter(order.is_met_by, self._shots.values()), None)
        if last is not None:
            self._deliver(Shot(order.view, order.snapshot, last.picture, 0.0, order.noise))
            return
        begin_s, view = time.perf_counter(), order.view
        self._world.show(order.snapshot)
        picture = renderer.render(self._world.data, view.camera, view.width, view.height,
                                  order.rgb, order.depth, order.labels)
        shot = Shot(view, order.snapshot, picture, time.perf_counter() - begin_s, order.noise)
        self._shots[view] = shot
        self._deliver(shot)
