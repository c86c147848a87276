# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images as JPEG, the same in topics and records."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

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
