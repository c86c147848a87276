# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Package manip_sim: for colcon (ament_python) and for pip."""

from pathlib import Path
import sys
from xml.etree import ElementTree

from setuptools import Distribution, find_packages, setup

PACKAGE = 'manip_sim'
# With colcon's --symlink-install this file is run through a link in another folder.
HERE = Path(__file__).resolve().parent
ABOUT = ElementTree.parse(HERE / 'package.xml')
MAINTAINER = ABOUT.find('maintainer')
PROGRAMS = {
    'sim_node': f'{PACKAGE}.__main__:main',
    'sim_view': f'{PACKAGE}.viewer.__main__:main',
    'manip_sim': f'{PACKAGE}.cli.__main__:run',
    'pick_cube': f'{PACKAGE}.examples.__main__:pick_cube',
    'hand_over': f'{PACKAGE}.examples.__main__:hand_over'}


class WithData(Distribution):
    """Lets editable installations have data files too: setuptools asks for ``has_data``."""

    has_data = Distribution.has_data_files


def launchers() -> list:
    """
    Return the data_files entry that lets ``ros2 run`` and launch files find a wheel's programs.

    They look in ``lib/manip_sim``, pip installs programs in ``bin``. With colcon the programs
    themselves are in ``lib/manip_sim``: see setup.cfg.
    """
    if not {'bdist_wheel', 'editable_wheel'} & set(sys.argv):
        return []
    folder = Path('build', 'launchers')
    folder.mkdir(parents=True, exist_ok=True)
    for name in PROGRAMS:
        (folder / name).write_text(f'#!/bin/sh\nexec "$(dirname "$0")/../../bin/{name}" "$@"\n')
        (folder / name).chmod(0o755)
    return [(f'lib/{PACKAGE}', [(folder / name).as_posix() for name in PROGRAMS])]


def files_below(folder: str) -> list:
    """Return the data_files entries that install a folder under share/manip_sim."""
    folders = [path for path in [Path(folder), *Path(folder).rglob('*')] if path.is_dir()]
    return [(f'share/{PACKAGE}/{path.as_posix()}',
             sorted(file.as_posix() for file in path.iterdir() if file.is_file()))
            for path in sorted(folders)]


setup(
    name=PACKAGE,
    distclass=WithData,
    version=ABOUT.findtext('version'),
    # The others have the names by which LeRobot finds environments and robots.
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*', f'lerobot_env_{PACKAGE}',
                                    f'lerobot_robot_{PACKAGE}']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        *files_below('assets'),
        *files_below('config'),
        *launchers(),
    ],
    python_requires='>=3.10,<3.15',
    # A new major version of those with an upper bound may change what is used here, as NumPy 2
    # and pydantic 2 did; for viser, the names of its handles.
    install_requires=['setuptools', 'mujoco>=3.17.0,<5', 'numba>=0.58,<1', 'numpy<3',
                      'pillow>=10.1', 'pydantic>=2,<3', 'pyyaml',
                      'rich>=12'],
    extras_require={
        # What `make bench` draws with.
        'bench': ['matplotlib'],
        'env': ['gymnasium>=1.1'],
        # Regular expressions of `~/get_entities`.
        'filters': ['google-re2'],
        'run': ['pyarrow', 'tqdm'],
        'ray': ['ray>=2.9'],
        'onnx': ['onnxruntime'],
        'torch': ['torch'],
        # It finds the convex parts of meshes.
        'meshes': ['coacd'],
        'docs': ['furo', 'myst-parser', 'sphinx>=7'],
        'jazzy': ['ros-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces'],
        'jazzy-test': ['ros-jazzy-test-msgs'],
        'kilted': ['ros-rclpy[fastrtps]==9.1.2', 'ros-kilted-common-interfaces'],
        'kilted-test': ['ros-kilted-test-msgs'],
        'records': ['av', 'h5py', 'mcap>=1.6,<2', 'mcap-ros2-support>=0.6,<1', 'pyarrow'],
        # trimesh smooths shapes by scipy.
        'viewer': ['msgspec', 'scipy', 'trimesh', 'viser>=1.1,<2', 'websockets>=14'],
        'mutate': ['cosmic-ray'],
        'xacro': ['xacro'],
        'test': ['av', 'coacd', 'colcon-common-extensions', 'coverage>=7.10', 'cyclonedx-bom',
                 'flake8', 'google-re2', 'gymnasium>=1.1', 'h5py', 'hypothesis', 'lxml',
                 'mcap>=1.6,<2', 'mcap-ros2-support>=0.6,<1', 'mypy', 'onnx', 'onnxruntime',
                 'packaging', 'pin', 'playwright', 'pyarrow', 'pytest', 'pytest-timeout',
                 'pytest-xdist', 'reuse', 'rosbags', 'ruff', 'scipy', 'tqdm', 'viser>=1.1,<2',
                 'wheel', 'xacro', 'yourdfpy'],
    },
    zip_safe=False,
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get('email'),
    description=ABOUT.findtext('description'),
    long_description=(HERE / 'README.md').read_text(),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    keywords=['ROS 2', 'MuJoCo', 'robosuite', 'simulation', 'manipulator'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Developers',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 15)),
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    entry_points={
        'console_scripts': [f'{name} = {function}' for name, function in PROGRAMS.items()],
        'pytest11': [f'{PACKAGE} = {PACKAGE}.testing.plugin'],
    },
)
