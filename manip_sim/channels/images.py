# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The channels of cameras: images, intrinsics and point clouds, made of pictures."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import io
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.channels.channel import Fields
from manip_sim.channels.contents import point_cloud
from manip_sim.interface.topics import Topic
from manip_sim.interface.world_topics import topics_of_cameras
from manip_sim.rendering.offscreen import Intrinsics

#: ``format`` of the messages as image_transport writes it, whatever the order of colours inside.
JPEG_FORMAT = 'rgb8; jpeg compressed bgr8'
#: The default of image_transport_plugins.
_QUALITY = 95


def jpeg_of(rgb: NDArray[np.uint8]) -> bytes:
    """
    Return an image as JPEG.

    :param rgb: shape (h, w, 3), the top row first
    """
    from PIL.Image import fromarray
    stream = io.BytesIO()
    fromarray(rgb).save(stream, 'JPEG', quality=_QUALITY)
    return stream.getvalue()


_PLUMB_BOB = 'plumb_bob'
#: Of images, by the kind of their numbers.
_ENCODINGS = {'u': 'rgb8', 'f': '32FC1', 'i': '32SC1'}
#: x, y, z and the colour as a packed number, as in PCL's PointXYZRGB.
_POINT = np.dtype([(name, np.float32) for name in ('x', 'y', 'z', 'rgb')])


@dataclass(frozen=True)
class ImageChannel:
    """
    A topic of a camera.

    :ivar topic: name, type, meaning and QoS
    :ivar parts: of a picture, which ``make`` takes after a header; none for intrinsics. A picture
        without the first one is not published
    :ivar make: returns the fields of a message
    """

    topic: Topic
    parts: tuple[str, ...]
    make: Callable[..., Fields]


def image_channels(camera: str, found: Intrinsics, depth: bool) -> list[ImageChannel]:
    """
    Return the channels of what a camera sees, and of its intrinsics.

    :param found: its intrinsics
    :param depth: whether there are depth images
    """
    info = partial(camera_info, found)
    makers: dict[str, tuple[Callable[..., Fields], tuple[str, ...]]] = {
        'color/image_raw': (image, ('rgb',)),
        'color/image_raw/compressed': (compressed_image, ('rgb',)),
        'color/camera_info': (info, ()),
        'depth/image_raw': (image, ('depth',)),
        'depth/camera_info': (info, ()),
        'depth/points': (PointCloudMaker(found).make, ('depth', 'rgb')),
        'labels/image_raw': (image, ('labels',))}
    rows = {row.name.removeprefix(f'{camera}/'): row for row in topics_of_cameras({camera: depth})}
    return [ImageChannel(rows[name], parts, make) for name, (make, parts) in makers.items()
            if name in rows]


def image(head: Fields, pixels: NDArray[Any]) -> Fields:
    """
    Return an image: ``rgb8`` of bytes with shape (h, w, 3), ``32FC1`` or ``32SC1`` of (h, w).

    :param pixels: contiguous, the top row first
    """
    # rclpy takes an array.array as it is, and checks anything else byte by byte.
    content = array('B')
    content.frombytes(pixels.data.cast('B'))
    return {'header': head, 'height': pixels.shape[0], 'width': pixels.shape[1],
            'encoding': _ENCODINGS[pixels.dtype.kind], 'is_bigendian': sys.byteorder == 'big',
            'step': pixels.strides[0], 'data': content}


def compressed_image(head: Fields, rgb: NDArray[np.uint8]) -> Fields:
    """
    Return an image as JPEG.

    :param rgb: shape (h, w, 3), the top row first
    """
    return {'header': head, 'format': JPEG_FORMAT, 'data': array('B', jpeg_of(rgb))}


def camera_info(found: Intrinsics, head: Fields) -> Fields:
    """Return the intrinsics of a camera without distortion."""
    projection = np.array([
        [found.fx, 0.0, found.cx, 0.0], [0.0, found.fy, found.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    return {'header': head, 'width': found.width, 'height': found.height,
            'distortion_model': _PLUMB_BOB, 'd': [0.0] * 5, 'k': projection[:, :3].ravel(),
            'r': np.eye(3).ravel(), 'p': projection.ravel()}


class PointCloudMaker:
    """Makes organised point clouds of the depth images of one camera."""

    def __init__(self, found: Intrinsics) -> None:
        #: Where the ray of a pixel is at a depth of one, shape (w,) and (h, 1).
        self._right = ((np.arange(found.width) - found.cx) / found.fx).astype(np.float32)
        self._down = ((np.arange(found.height) - found.cy) / found.fy).astype(
            np.float32)[:, np.newaxis]
        self._points = np.empty((found.height, found.width, 4), dtype=np.float32)

    def make(self, head: Fields, depth: NDArray[Any], rgb: NDArray[np.uint8] | None) -> Fields:
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
