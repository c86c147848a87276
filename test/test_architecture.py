# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The layers: ros on simulation on models, and nothing upward; what modules and tests are like."""

import ast
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
import importlib
from pathlib import Path
import re
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'manip_sim'
MODULES = sorted(PACKAGE.rglob('*.py'))
TESTS_FOLDER = Path(__file__).resolve().parent
TESTS = sorted([*TESTS_FOLDER.rglob('*.py'), *(ROOT / 'hardware').rglob('*.py')])
PURE = {'mujoco', 'numpy', 'pydantic', 'yaml'}
#: By folder or module: the layers and the libraries that it may import.
MAY_IMPORT = {
    'sensing': ({'sensing'}, PURE),
    'models': ({'models', 'sensing'}, PURE),
    'models/object_creation.py': ({'models'}, PURE | {'coacd'}),
    # Files of others may have meshes that MuJoCo does not read.
    'models/files': ({'models'}, PURE | {'trimesh', 'xacro'}),
    'physics': ({'models', 'physics'}, PURE),
    'control/law': ({'control', 'physics'}, PURE | {'llvmlite', 'numba'}),
    'control': ({'control', 'models', 'physics', 'sensing'}, PURE),
    'simulation': ({'control', 'models', 'physics', 'sensing', 'simulation'}, PURE),
    'channels': ({'channels', 'control', 'interface', 'models', 'physics', 'rendering', 'sensing',
                  'simulation'}, PURE | {'PIL'}),
    'worlds': ({'control', 'models', 'physics', 'simulation', 'worlds'}, PURE),
    'rendering': ({'rendering'}, PURE),
    'runtime': ({'control', 'runtime', 'simulation'}, PURE),
    'tasks': ({'control', 'models', 'physics', 'sensing', 'simulation', 'rendering', 'tasks'},
              PURE),
    'env/ros.py': ({'env', 'simulation', 'tasks'}, None),
    'env': ({'env', 'models', 'tasks', 'worlds'}, PURE | {'gymnasium'}),
    'records': ({'channels', 'control', 'interface', 'models', 'records', 'rendering',
                 'simulation', 'tasks'},
                PURE | {'PIL', 'av', 'h5py', 'lz4', 'mcap', 'mcap_ros2', 'pyarrow', 'zstandard'}),
    'records/node_recorder.py': ({'records'}, None),
    'identification': ({'channels', 'identification', 'interface', 'models', 'records',
                        'simulation'}, PURE),
    'moveit': ({'models', 'moveit', 'physics', 'simulation'}, PURE),
    # It shares with the node how messages are filled.
    'experiments/ros_policy.py': ({'channels', 'ros', 'tasks'}, None),
    'experiments': ({'experiments', 'records', 'tasks'},
                    PURE | {'draccus', 'evdev', 'lerobot', 'onnxruntime', 'pyarrow', 'ray',
                            'torch'}),
    'cli': ({'cli', 'control', 'experiments', 'identification', 'interface', 'models', 'moveit',
             'physics', 'records', 'sensing', 'simulation', 'rendering', 'tasks', 'viewer'},
            PURE | {'PIL', 'rich', 'tqdm'}),
    'cli/ros_commands.py': (set(), None),
    'viewer/page': ({'viewer'}, PURE | {'msgspec', 'trimesh', 'viser', 'websockets'}),
    # What a client shares with the node: names of topics, how messages and archives are read,
    # what is logged.
    'viewer/discovery.py': ({'interface', 'models', 'ros', 'viewer'}, None),
    'viewer/session.py': ({'interface', 'models', 'ros', 'viewer'}, None),
    'viewer/task_page.py': ({'experiments', 'simulation', 'tasks', 'viewer'}, PURE),
    'viewer': ({'interface', 'models', 'records', 'viewer'}, PURE | {'PIL', 'viser'}),
    'interface': ({'control', 'interface', 'models', 'physics', 'sensing', 'simulation', 'tasks'},
                  PURE),
}
#: The module that imports what rclpy has no public name for, and the layers that use rclpy.
INTERNALS = 'rclpy_internals'
WITH_RCLPY = ('ros', 'env/ros.py', 'examples', 'testing', 'viewer/discovery.py',
              'viewer/session.py', 'records/node_recorder.py', 'experiments/ros_policy.py',
              'cli/ros_commands.py', f'{INTERNALS}.py')
TOP_LEVEL = {'algebra', 'arrays', 'derived', 'errors', 'frame_names',
             'lerobot_units', 'quoting', 'resources', 'ros_environment', 'startup', 'validation'}
FORBIDDEN_NAMES = {'utils.py', 'helpers.py', 'common.py'}


@cache
def nodes(path):
    """Return the imports and comparisons of a module."""
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(
        node, (ast.Import, ast.ImportFrom, ast.Compare, ast.Match))]


def imports(path):
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            yield node.module
            if node.module in ('manip_sim', 'rclpy'):  # Names may be modules.
                yield from (f'{node.module}.{alias.name}' for alias in node.names)


def check_imports(path):
    parts = path.relative_to(PACKAGE).parts
    layer = '/'.join(parts[:2]) if '/'.join(parts[:2]) in MAY_IMPORT else parts[0]
    layers, libraries = MAY_IMPORT.get(layer, (None, None))
    for name in imports(path):
        first, _, rest = name.partition('.')
        if rest == INTERNALS:
            assert layer in WITH_RCLPY, f'{path} imports {name}'
        elif first == 'manip_sim' and layers is not None:
            assert rest.split('.')[0] in layers | TOP_LEVEL, f'{path} imports {name}'
            assert layer != 'viewer/page' or not rest.startswith('viewer') or (
                rest.startswith('viewer.page')), f'{path}: {name}'
        elif libraries is not None and not _is_standard(first):
            assert first in libraries, f'{path} imports {name}'
        elif first == 'rclpy':
            assert layer in WITH_RCLPY, f'{path} imports {name}'
            assert '._' not in name or path.stem == INTERNALS, f'{path} imports {name}'


@pytest.mark.full
def test_a_module_imports_from_its_own_layer_or_below():
    for path in MODULES:
        check_imports(path)


def _is_standard(name):
    return name in sys.stdlib_module_names


def imported_modules(path):
    """Yield the names of all that a module imports, also for types and within functions."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


@pytest.mark.full
def test_modules_and_packages_of_a_room_import_each_other_in_no_circle():
    names = {path: '.'.join(path.relative_to(PACKAGE.parent).with_suffix('').parts).removesuffix(
        '.__init__') for path in MODULES}
    for place in {room(path) for path in names}:
        modules = {name: path for path, name in names.items() if room(path) == place}
        # An error names the modules of the circle.
        TopologicalSorter({
            name: {other for other in imported_modules(path) if other in modules} - {name}
            for name, path in modules.items()}).prepare()


#: Where fields of messages, which are named like modes, are told apart.
FIELDS_OF_MESSAGES = ('viewer', 'runtime/action_goals.py')


@pytest.mark.full
def test_no_module_compares_the_name_of_a_control_mode():
    for path in MODULES:
        if path.relative_to(PACKAGE).as_posix().startswith(FIELDS_OF_MESSAGES):
            continue
        for node in nodes(path):
            if isinstance(node, (ast.Compare, ast.Match)):
                names = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
                assert not {'position', 'velocity', 'effort'}.intersection(map(str, names)), (
                    f'{path}:{node.lineno} compares the name of a mode: ask the mode')


def test_no_module_is_a_drawer_for_odds_and_ends():
    assert not [path for path in MODULES if path.name in FORBIDDEN_NAMES]


def room(path):
    return path.relative_to(PACKAGE).parts[0]


def test_a_module_has_its_name_for_itself_in_its_room():
    names = Counter((room(path), path.stem) for path in MODULES if not path.stem.startswith('__'))
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.full
def test_a_class_has_its_name_for_itself_in_its_room():
    classes = Counter((room(path), name) for path in MODULES
                      for name in re.findall(r'^class (\w+)', path.read_text(), re.MULTILINE))
    assert len(classes) > 500
    assert [name for name, count in classes.items() if count > 1] == []


def skips(tree):
    """Yield what may skip a test, or expects it to fail: its line, and its reason or None."""
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and (
                node.func.attr in ('importorskip', 'skip', 'skipif', 'xfail')):
            given = [keyword.value for keyword in node.keywords if keyword.arg == 'reason']
            if node.func.attr == 'skip':
                given += node.args
            yield node.lineno, given[0] if given else None
        elif (isinstance(node, ast.Attribute) and node.attr in ('skip', 'xfail')
                and id(node) not in called and ast.unparse(node.value).endswith('mark')):
            yield node.lineno, None


@pytest.mark.full
def test_every_test_that_may_be_skipped_says_why():
    for path in TESTS:
        text = path.read_text()
        for line, reason in skips(ast.parse(text)) if re.search('skip|xfail', text) else ():
            assert reason is not None, f'{path}:{line}'
            if isinstance(reason, ast.Constant):
                assert isinstance(reason.value, str) and len(reason.value) > 8, f'{path}:{line}'


@pytest.mark.parametrize('code', [
    'pytest.importorskip("x")', 'pytest.mark.skipif(True)', 'pytest.skip()', 'pytest.mark.xfail',
    '@pytest.mark.skip\ndef test(): pass'])
def test_a_skip_without_a_reason_is_found(code):
    assert [reason for _, reason in skips(ast.parse(code))] == [None]


def test_ci_shows_why_tests_are_skipped():
    # 'a': the reasons of all but passed tests, whatever the command line asks for beside it.
    assert ' -ra"' in (ROOT / 'pyproject.toml').read_text()
    for file in ('Makefile', '.ci/run', *(
            path.relative_to(ROOT) for path in (ROOT / '.github').rglob('*.yml'))):
        text = (ROOT / file).read_text()
        assert not re.search(r'pytest.* (-r[^a]|-p no:terminal|--no-summary|-qq)', text), file


@pytest.mark.full
def test_the_pictures_of_the_architecture_are_those_of_the_code(monkeypatch):
    monkeypatch.syspath_prepend(TESTS_FOLDER.parent / 'docs')
    drawn = importlib.import_module('draw_architecture')
    for path, content in drawn.pictures():
        assert path.read_text() == content, 'run python docs/draw_architecture.py'
    for place, _ in (*drawn.COMMAND, *drawn.STATE):
        assert not place.endswith('.py') or (PACKAGE / place).is_file(), place
    rooms = {name for floor in drawn.FLOORS for name in floor}
    assert rooms == {path.name for path in PACKAGE.iterdir() if (path / '__init__.py').is_file()}
