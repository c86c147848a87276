# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Organised point clouds, also made of depth images and their colours."""

from __future__ import annotations

from array import array
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from manip_sim.rendering.intrinsics import Intrinsics

#: x, y, z and the colour as a packed number, as in PCL's PointXYZRGB.
_POINT = np.dtype([(name, np.float32) for name in ('x', 'y', 'z', 'rgb')])
#: Of the fields of messages, by the kinds and sizes of numbers.
_DATATYPES = {'f4': PointField.FLOAT32, 'u2': PointField.UINT16}


def point_cloud(head: Header, points: NDArray[Any]) -> PointCloud2:
    """
    Return the message of points in rows, some of which may be NaN.

    :param points: contiguous, of a type with fields, shape (h, w)
    """
    message = PointCloud2(
        header=head, height=points.shape[0], width=points.shape[1],
        is_bigendian=sys.byteorder == 'big', point_step=points.itemsize,
        row_step=points.strides[0], is_dense=False, fields=[
            PointField(name=name, offset=offset, datatype=_DATATYPES[kind.str[1:]], count=1)
            for name, (kind, offset, *_) in (points.dtype.fields or {}).items()])
    content = array('B')
    content.frombytes(points.view(np.uint8).data.cast('B'))
    message.data = content
    return message


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
        return point_cloud(head, points.view(_POINT)[..., 0])
