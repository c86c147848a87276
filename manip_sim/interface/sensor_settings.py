# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The rates and the noise of single sensors, as a user sets them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Optional

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.interface.parameters import periods_per_image
from manip_sim.models.cameras import MAX_RATE_HZ, MIN_RATE_HZ
from manip_sim.models.strict_yaml import parse_yaml
from manip_sim.quoting import quoted


_MAX_NOISE = 1e3


class SensorSettings:
    """
    The settings of sensors by name.

    :param given: descriptions; empty texts are ignored
    :param names: of the instruments that have topics
    :param publish_rate: control periods per second [Hz]
    :raises ModelError: if a description cannot be used, on one line
    :raises UnknownNameError: if there is no such sensor
    :raises ParameterError: if a sensor is faster than ``publish_rate``
    :ivar every: after how many control periods a message comes
    :ivar rates_hz: of the sensors with fewer messages than control periods [Hz]
    :ivar noise: standard deviation on each number that is read, in its unit
    """

    def __init__(self, given: Sequence[str], names: Iterable[str], publish_rate: float
                 ) -> None:
        self.every: dict[str, int] = {}
        self.rates_hz: dict[str, float] = {}
        self.noise: dict[str, float] = {}
        texts = [text for text in given if text]
        if not texts:
            return
        names = list(dict.fromkeys(names))
        seen: set[str] = set()
        for text in texts:
            name, rate, noise = _described(parse_yaml(text, "one of 'sensors'"))
            if name not in names:
                raise UnknownNameError('sensor', name, names)
            if name in seen:
                raise ModelError(f'the sensor {quoted(name)} is described twice')
            seen.add(name)
            if rate is not None:
                self.every[name] = periods_per_image(publish_rate, rate, f'sensors: {name}')
                if self.every[name] > 1:
                    self.rates_hz[name] = publish_rate / self.every[name]
            if noise:
                self.noise[name] = noise


def _described(values: Mapping[str, Any]) -> tuple[str, float | None, float]:
    # Imported late: it needs pydantic 2, which Ubuntu 24.04 does not have.
    from manip_sim.models.strict_descriptions import checked, Field, Number, Strict

    class SensorDescription(Strict):
        name: str
        rate: Optional[Annotated[Number, Field(  # noqa: UP045
            ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)]] = None
        noise: Annotated[Number, Field(ge=0.0, le=_MAX_NOISE, allow_inf_nan=False)] = 0.0

    name = values.get('name')
    found = checked(SensorDescription, values,
                    'sensor without a name' if name is None else f'sensor {quoted(str(name))}')
    return found.name, found.rate, found.noise
