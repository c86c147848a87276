# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands that actuators take as they are, without setpoints or modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math

import mujoco

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.physics.physics import Physics
from manip_sim.quoting import quoted_names

_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


class DirectControls:
    """
    Controls of actuators by the names that commands use.

    :param physics: of the world
    :param part: their collective name in topics and messages
    :param kind: noun for a name, for messages
    :param names: all known names
    :param actuator_of: the actuator by name, where a name has one
    """

    def __init__(self, physics: Physics, part: str, kind: str, names: Sequence[str],
                 actuator_of: Mapping[str, str]) -> None:
        self._physics = physics
        self._part, self._kind, self._names = part, kind, names
        self._actuator_of = dict(actuator_of)

    def __contains__(self, name: str) -> bool:
        """Return whether a name has an actuator."""
        return name in self._actuator_of

    def control(self, name: str) -> tuple[str, int]:
        """
        Return what a joint or actuator is commanded by, and the id of the actuator.

        :returns: ``position``, ``velocity`` or ``effort``, and the id
        :raises UnknownNameError: if the name is unknown
        :raises CommandError: if no actuator drives it
        """
        if name not in self._names:
            raise UnknownNameError(self._kind, name, self._names)
        if name not in self._actuator_of:
            driven = quoted_names(list(self._actuator_of)) or 'none'
            raise CommandError(f"no actuator of the {self._part} drives '{name}'; driven are: "
                               f'{driven}')
        model = self._physics.model
        actuator = int(model.actuator(self._actuator_of[name]).id)
        affine = int(model.actuator_biastype[actuator]) == _AFFINE
        _, of_position, of_velocity = model.actuator_biasprm[actuator, :3].tolist()
        if affine and of_position:
            # MuJoCo integrates the control of such a servo.
            integrates = int(model.actuator_dyntype[actuator]) == _INTEGRATOR
            return 'velocity' if integrates else 'position', actuator
        return 'velocity' if affine and of_velocity else 'effort', actuator

    def checked(self, names: Sequence[str], position: Sequence[float], velocity: Sequence[float],
                effort: Sequence[float]) -> dict[str, float]:
        """
        Return the controls of a joint command, clamped to their ranges, by name.

        :param names: of joints or actuators, each once
        :param position: [rad or m], as many as names, or empty; NaN leaves one out
        :param velocity: likewise
        :param effort: likewise
        :raises CommandError: if the numbers do not fit the names
        :raises UnknownNameError: if a name is unknown
        """
        columns = {'position': position, 'velocity': velocity, 'effort': effort}
        if not names or len(set(names)) != len(names):
            raise CommandError(f'{self._part}: a joint command needs names, each of them once')
        for quantity, values in columns.items():
            if len(values) not in (0, len(names)):
                raise CommandError(f'{self._part}: expected {len(names)} numbers in {quantity}, '
                                   f'one for each name, or none, got {len(values)}')
        return dict(self._controls(names, columns))

    def _controls(self, names: Sequence[str], columns: dict[str, Sequence[float]]
                  ) -> Iterator[tuple[str, float]]:
        model = self._physics.model
        for index, name in enumerate(names):
            accepted, actuator = self.control(name)
            for quantity, values in columns.items():
                value = float(values[index]) if len(values) else math.nan
                if math.isinf(value):
                    raise CommandError(f"{self._part}: {quantity} of '{name}' must be finite")
                if math.isnan(value):
                    continue
                if quantity != accepted:
                    raise CommandError(f"{self._part}: '{name}' takes a {accepted}, got a "
                                       f'{quantity}')
                if model.actuator_ctrllimited[actuator]:
                    value = min(max(value, float(model.actuator_ctrlrange[actuator, 0])),
                                float(model.actuator_ctrlrange[actuator, 1]))
                if abs(value) > mujoco.mjMAXVAL:
                    raise CommandError(f"{self._part}: {quantity} of '{name}' must be within "
                                       f'{mujoco.mjMAXVAL:g}, got {value:g}')
                yield name, value

    def command(self, controls: Mapping[str, float]) -> None:
        """
        Let actuators act from the next control period on.

        :param controls: from :meth:`checked`
        """
        for name, value in controls.items():
            self._physics.ctrl[self.control(name)[1]] = value
