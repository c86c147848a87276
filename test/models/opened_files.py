# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What Linux says about which files of a folder have been opened."""

import ctypes
import os
import struct

_IN_OPEN, _NONBLOCK = 0x20, 0o4000
_EVENT = struct.Struct('iIII')


class OpenedFiles:
    """
    The names of the files of a folder that any thread or process opens.

    :param folder: is watched from now on
    """

    def __init__(self, folder):
        libc = ctypes.CDLL(None, use_errno=True)
        self._watch = libc.inotify_init1(_NONBLOCK)
        assert libc.inotify_add_watch(self._watch, os.fsencode(folder), _IN_OPEN) > 0

    def take(self):
        """Return the names since the last call."""
        names = set()
        try:
            events = os.read(self._watch, 1_000_000)
        except BlockingIOError:
            return names
        while events:
            length = _EVENT.unpack_from(events)[3]
            names.add(events[_EVENT.size:_EVENT.size + length].rstrip(b'\0').decode())
            events = events[_EVENT.size + length:]
        return names - {''}

    def close(self):
        os.close(self._watch)
