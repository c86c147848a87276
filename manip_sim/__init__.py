# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated manipulators served over ROS 2: models, simulation and the node."""


def __getattr__(name: str) -> str:
    if name == '__version__':
        from manip_sim.resources import package_version
        return package_version()
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
