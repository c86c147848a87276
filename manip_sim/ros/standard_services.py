# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of the package ``simulation_interfaces``, where that is installed."""

from __future__ import annotations

from manip_sim.models.regular_files import FilesBelow
from manip_sim.ros.entity_services import EntityServices
from manip_sim.ros.feature import Feature
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.optional_packages import import_optional
from manip_sim.ros.spawning_services import SpawningServices
from manip_sim.ros.standard_answers import StandardTypes
from manip_sim.ros.standard_simulation import SimulationInterfaces
from manip_sim.ros.world_services import WorldServices

TYPES = StandardTypes(*(import_optional(f'simulation_interfaces.{kind}')
                        for kind in ('srv', 'msg', 'action')))
#: Whether the package is installed.
AVAILABLE = TYPES.services is not None


class StandardServices(Feature):
    """
    The services of the standard under ``~/``; without their package a note.

    :param files: those that a request may name
    """

    def __init__(self, context: NodeContext, files: FilesBelow) -> None:
        if not AVAILABLE:
            context.missing['simulation_interfaces'] = 'standard simulation services'
            return
        self._simulation = SimulationInterfaces(context, TYPES)
        self._entities = EntityServices(context, TYPES)
        spawning = SpawningServices(context, files, TYPES)
        WorldServices(context, self._simulation, files, TYPES, spawning.group)

    def world_changed(self) -> None:
        if AVAILABLE:
            self._entities.forget_gone()

    def close(self) -> None:
        if AVAILABLE:
            self._simulation.close()
