# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated manipulators served over ROS 2: models, simulation and the node."""


def __getattr__(name: str) -> str:
    if name == '__version__':
        from manip_sim.resources import package_version
        return package_version()
    if not name.startswith('_'):
        from pathlib import Path
        for file in sorted(Path(__file__).parent.glob('*/__init__.py')):
            if f"'{name}'" in file.read_text():
                raise AttributeError(f'module {__name__!r} has no attribute {name!r}: it is '
                                     f'{__name__}.{file.parent.name}.{name}')
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
