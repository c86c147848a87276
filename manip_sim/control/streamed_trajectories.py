# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Detect trajectories that are not separate motions, but each the next point of a stream."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import IntArray

#: Messages no farther apart than this are a stream, unless set otherwise [s].
STREAM_INTERVAL_S = 0.105
#: A point of a stream is due before so many intervals between the messages have passed.
_DUE_INTERVALS = 2.5
#: A stream goes on after a gap of so many of its longest intervals.
_GAP_INTERVALS = 10.0


class PointStreams:
    """
    Joints that are sent one point after the other, each due about when the next one comes.

    Motions to such points would end at rest at each of them. Servoing tools send the next two.

    :param count: number of joints
    """

    def __init__(self, count: int) -> None:
        self._came_s = np.full(count, -np.inf)
        self._streams = np.zeros(count, dtype=bool)

    def take(self, indices: IntArray, now_s: float, due_s: float, longest_s: float) -> bool:
        """
        Take in that a trajectory of one or two points begins; tell whether it goes on a stream.

        :param indices: of its joints
        :param now_s: simulation time [s]
        :param due_s: how long from now the last point is due [s]
        :param longest_s: longest interval between messages of a stream [s]
        """
        since_s = now_s - float(self._came_s[indices].min())
        # Of a stream, messages may have come together, or were lost.
        goes_on = bool(self._streams[indices].all()) and since_s <= _GAP_INTERVALS * longest_s
        streams = (goes_on or since_s <= longest_s) and (
            due_s <= _DUE_INTERVALS * (longest_s if goes_on else since_s))
        self._came_s[indices], self._streams[indices] = now_s, streams
        return streams
