# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images of the cameras that somebody wants to see."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from numpy.typing import NDArray

from manip_sim.viewer.page.commands import Events
from manip_sim.viewer.page.plain_text import Line, plain, PlainText

#: Least time between two images of a camera [s].
_PERIOD_S = 0.1
_QUALITY = 80


class CameraPanel:
    """
    A box to tick for each camera, and its image below.

    :param gui: ``viser.ViserServer.gui``
    :param cameras: names
    :param watch: starts or stops listening to the images of a camera
    :param events: queue to the thread that updates the page
    """

    def __init__(self, gui: Any, cameras: Iterable[str], watch: Callable[[str, bool], None],
                 events: Events) -> None:
        self._gui, self._watch = gui, watch
        self._images: dict[str, Any] = {}
        self._shown_s: dict[str, float] = {}
        self._folders = {name: gui.add_folder(plain(name)) for name in cameras}
        for name, folder in self._folders.items():
            with folder:
                box = gui.add_checkbox('Show', False, hint=f'the images of {plain(name)}')
            self._couple(name, box, events)
        if not self._folders:
            PlainText(gui, [Line('The node has no cameras. Start it with, for example, '
                                 '-p "cameras:=[birdview]".')])

    def _couple(self, name: str, box: Any, events: Events) -> None:
        box.on_update(lambda _: events.add(lambda: self._tick(name, bool(box.value))))

    def _tick(self, name: str, wanted: bool) -> None:
        self._watch(name, wanted)
        if not wanted and name in self._images:
            self._images.pop(name).remove()

    def show(self, now_s: float, images: dict[str, NDArray[Any]], wanted: bool) -> None:
        """
        Show images, each at most ten times a second; ``now_s`` is wall time [s].

        :param images: by camera, shape (h, w, 3); those that are due are removed
        :param wanted: whether any browser shows the page
        """
        for name in list(images):
            if now_s < self._shown_s.get(name, 0.0) + _PERIOD_S:
                continue
            pixels = images.pop(name)
            if not wanted or name not in self._folders:
                continue
            self._shown_s[name] = now_s
            if name in self._images:
                self._images[name].image = pixels
            else:
                with self._folders[name]:
                    self._images[name] = self._gui.add_image(pixels, jpeg_quality=_QUALITY)
