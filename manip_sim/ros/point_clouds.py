# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Organised point clouds, made of depth images and their colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from manip_sim.channels.contents import point_cloud
from manip_sim.rendering.intrinsics import Intrinsics
from manip_sim.ros.messages import message_of

#: x, y, z and the colour as a packed number, as in PCL's PointXYZRGB.
_POINT = np.dtype([(name, np.float32) for name in ('x', 'y', 'z', 'rgb')])


class PointCloudMaker:
    """Makes point clouds of the images of one camera."""

    def __init__(self, found: Intrinsics) -> None:
        #: Where the ray of a pixel is at a depth of one, shape (w,) and (h, 1).
        self._right = ((np.arange(found.width) - found.cx) / found.fx).astype(np.float32)
        self._down = ((np.arange(found.height) - found.cy) / found.fy).astype(
            np.float32)[:, np.newaxis]
        self._points = np.empty((found.height, found.width, 4), dtype=np.float32)

    def make(self, head: Header, depth: NDArray[Any], rgb: NDArray[np.uint8] | None
             ) -> PointCloud2:
        """
        Return the points that a camera sees, in its optical frame, one for each pixel.

        :param depth: along the view [m], +Inf where there is nothing, shape (h, w)
        :param rgb: shape (h, w, 3), or None for points without colours, which are white
        """
        points = self._points
        points[..., 2] = np.where(np.isfinite(depth), depth, np.nan)
        np.multiply(points[..., 2], self._right, out=points[..., 0])
        np.multiply(points[..., 2], self._down, out=points[..., 1])
        colours = points.view(np.uint8)[..., 12:]
        # In memory the last byte of the number comes first: blue, green, red.
        colours[..., :3] = 255 if rgb is None else rgb[..., ::-1]
        colours[..., 3] = 0
        return message_of(
            'sensor_msgs/PointCloud2', point_cloud(head, points.view(_POINT)[..., 0]))
