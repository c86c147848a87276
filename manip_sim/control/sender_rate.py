# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How fast simulation time runs by the clock from which a sender stamps its messages."""

from __future__ import annotations

from dataclasses import dataclass, replace

#: Share of what is known of the speed of the stamps' clock that is kept from message to message.
_KEPT = 0.98
#: It is taken to run like simulation time as if messages over so much time had shown it [s].
_SAME_S = 1.0
#: That is given up by this factor with each message that shows another speed, which differs by
#: more than this share, and which the message confirms to within this share of the difference.
_GIVEN_UP, _OTHER, _CONFIRMED = 0.5, 0.1, 0.25
#: After so many messages one may be odd, but not more of them in a row.
_SETTLED, _MOST_ODD = 8, 3


@dataclass(frozen=True)
class SenderRate:
    """
    Simulation time per time by the stamps of a stream, averaged with a fading memory.

    :ivar since_s: sum of the times between messages [s]
    :ivar stamped_s: sum of the times between their stamps [s]
    :ivar assumed_s: how much time is added to both, as if the clocks ran alike [s]
    :ivar number: of the times in the sums
    :ivar odd: how many messages in a row were left out of them
    """

    since_s: float = 0.0
    stamped_s: float = 0.0
    assumed_s: float = _SAME_S
    number: int = 0
    odd: int = 0

    @property
    def value(self) -> float:
        """The rate that messages have shown, the nearer to 1 the fewer there were."""
        return (self.since_s + self.assumed_s) / (self.stamped_s + self.assumed_s)

    @property
    def measured(self) -> float:
        """The rate by the messages alone; 1 before the first one."""
        return self.since_s / self.stamped_s if self.number else 1.0

    def after(self, since_s: float, stamped_s: float, tolerance_s: float) -> SenderRate:
        """
        Return the measure after a message.

        Where one of the clocks stood for a while, as simulation time does in a pause, the message
        tells nothing of how fast they run.

        :param since_s: simulation time from the last message to this one, above 0 [s]
        :param stamped_s: the same by their stamps, above 0 [s]
        :param tolerance_s: by which a message may be off the measured rate [s]
        """
        measured, now = self.measured, since_s / stamped_s
        if (self.number > _SETTLED and self.odd < _MOST_ODD
                and abs(stamped_s * measured - since_s) > tolerance_s):
            return replace(self, odd=self.odd + 1)
        other = abs(measured - 1.0)
        confirms = (self.number > 1 and other > _OTHER
                    and abs(now - measured) < _CONFIRMED * other)
        return SenderRate(
            _KEPT * self.since_s + since_s, _KEPT * self.stamped_s + stamped_s,
            _KEPT * self.assumed_s * (_GIVEN_UP if confirms else 1.0), self.number + 1)
