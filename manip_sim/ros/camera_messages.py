# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images and intrinsics as messages; the one place that knows their encodings."""

from __future__ import annotations

from array import array
import io
import sys
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from manip_sim.rendering.intrinsics import Intrinsics

#: Of JPEG, the default of image_transport_plugins.
_QUALITY = 95
_PLUMB_BOB = 'plumb_bob'


def header(stamp: Time, frame_id: str) -> Header:
    """Return a header."""
    return Header(stamp=stamp, frame_id=frame_id)


def image(head: Header, pixels: NDArray[Any]) -> Image:
    """
    Return an image: ``rgb8`` of bytes with shape (h, w, 3), ``32FC1`` of floats with shape (h, w).

    :param pixels: contiguous, the top row first
    """
    message = Image(header=head, height=pixels.shape[0], width=pixels.shape[1],
                    encoding='rgb8' if pixels.ndim == 3 else '32FC1',
                    is_bigendian=sys.byteorder == 'big', step=pixels.strides[0])
    # rclpy takes an array.array as it is, and checks anything else byte by byte.
    content = array('B')
    content.frombytes(pixels.data.cast('B'))
    message.data = content
    return message


def jpeg(head: Header, rgb: NDArray[np.uint8]) -> CompressedImage:
    """
    Return an image as JPEG.

    :param rgb: shape (h, w, 3), the top row first
    """
    from PIL.Image import fromarray
    stream = io.BytesIO()
    fromarray(rgb).save(stream, 'JPEG', quality=_QUALITY)
    # The format as image_transport writes it, whatever the order of colours inside.
    return CompressedImage(header=head, format='rgb8; jpeg compressed bgr8',
                           data=array('B', stream.getvalue()))


def camera_info(found: Intrinsics) -> CameraInfo:
    """Return the intrinsics of a camera without distortion; the header is empty."""
    return CameraInfo(
        width=found.width, height=found.height, distortion_model=_PLUMB_BOB, d=[0.0] * 5,
        k=[found.fx, 0.0, found.cx, 0.0, found.fy, found.cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[found.fx, 0.0, found.cx, 0.0, 0.0, found.fy, found.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
