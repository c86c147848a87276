# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Values made from the state and the model, neither saved nor part of a digest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar('T')


class Derived:
    """
    Values that are made when they are needed, by key.

    They do not belong to the state: without a ``__dict__``, a walk through the state stops here.
    So restoring a state keeps them; values that depend on the state are compared with it.

    :ivar of: the values, which their owner clears when the model has changed
    """

    __slots__ = ('of',)

    def __init__(self) -> None:
        self.of: dict[Any, Any] = {}

    def clear(self) -> None:
        """
        Forget all values.

        In a copy of an object graph, this method is that of the copy; ``of.clear`` would be none.
        """
        self.of.clear()

    def made_of(self, make: Callable[..., T], *parts: Any) -> T:
        """
        Return the value made of some objects, the same as before while they are the same.

        :param make: its maker, one for each kind of parts
        """
        key: Any = make
        numbers = tuple(map(id, parts))
        kept = self.of.get(key)
        if kept is None or kept[0] != numbers:
            kept = self.of[key] = numbers, make(*parts), parts
        made: T = kept[1]
        return made

    def __reduce__(self) -> tuple[type[Derived], tuple[()]]:
        """Let a copy begin without any."""
        return Derived, ()
