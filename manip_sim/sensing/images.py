# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The noise and the age of what a camera measures; rendering is elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from manip_sim.sensing.randomness import generator
from manip_sim.sensing.robot_sensing import Measurements, RobotSensing

#: Limits of width and height of images, of their rate, and of the field of view of cameras.
MAX_PIXELS = 4096
MIN_RATE_HZ, MAX_RATE_HZ = 0.01, 10_000.0
MIN_FOVY_DEG, MAX_FOVY_DEG = 1.0, 170.0
#: Type of the snapshots that images are rendered from.
Scene = TypeVar('Scene')
_BRIGHTEST = 255.0


@dataclass(frozen=True)
class ImageNoise:
    """
    The noise of one image; it depends on these numbers only.

    :ivar camera: name of the camera
    :ivar seed: a whole number from 0
    :ivar count: steps from the reset to the instant of the image
    :ivar pixel: standard deviation on each colour of each pixel, of 255
    :ivar depth: standard deviation on depth at 1 m [m]
    """

    camera: str
    seed: int
    count: int
    pixel: float
    depth: float

    def _draw(self, purpose: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        random = generator(self.seed, f'{self.camera} {purpose}', self.count)
        return random.standard_normal(shape, dtype=np.float32)

    def on_colours(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return colours with white noise, shape (h, w, 3)."""
        if not self.pixel:
            return rgb
        noisy = self._draw('pixel', rgb.shape)
        noisy *= np.float32(self.pixel)
        noisy += rgb
        return np.clip(np.rint(noisy, out=noisy), 0.0, _BRIGHTEST, out=noisy).astype(np.uint8)

    def on_depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """
        Return depth with white noise, whose standard deviation grows with the square of depth.

        So it does where depth z = f b / d is triangulated from a disparity d with noise of a
        constant standard deviation: dz = z^2 dd / (f b). That is the error model of Khoshelham
        and Oude Elberink, Accuracy and Resolution of Kinect Depth Data, Sensors 12 (2012).

        :param depth: along the view [m], +Inf where there is nothing, shape (h, w)
        """
        if not self.depth:
            return depth
        there = np.isfinite(depth)
        metres = np.where(there, depth, np.float32(0.0))
        noisy = metres + np.float32(self.depth) * metres**2 * self._draw('depth', depth.shape)
        return np.where(there, np.maximum(noisy, np.float32(0.0)), depth)


class CameraSensing(Generic[Scene]):
    """Measurements of a camera, with the noise and latency of a robot."""

    def __init__(self, camera: str, sensing: RobotSensing) -> None:
        self._camera = camera
        self.sensing = sensing
        self._scenes: Measurements[Scene] = Measurements()

    @property
    def delays(self) -> bool:
        """True if images are older than the present instant."""
        return self.sensing.settings.delays_images

    def record(self, scene: Scene) -> None:
        """Remember the scene of the present instant, which arrives later."""
        count = self.sensing.count
        self._scenes.record(count, scene, self.sensing.delays['image'].steps(count))

    def measured(self, scene: Scene) -> tuple[Scene, ImageNoise | None]:
        """Return the newest scene that has arrived, and the noise of its image."""
        count = self.sensing.count
        if self.delays:
            self.record(scene)
            count, scene = self._scenes.newest(count)
        else:
            self._scenes.clear()
        settings: Any = self.sensing.settings
        pixel, depth = settings['noise.pixel'], settings['noise.depth']
        if not (pixel or depth):
            return scene, None
        return scene, ImageNoise(self._camera, self.sensing.seed, count, pixel, depth)
