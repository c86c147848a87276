# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What ``requirements/`` locks: all that setup.py asks for, with hashes, and from anywhere."""

import importlib.metadata
import importlib.util
import json
from pathlib import Path
import re
import shutil
import subprocess
import sys

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
import pytest
import setuptools

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ('3.10', '3.11', '3.12', '3.13')
FILES = {'run': ['jazzy', 'viewer', 'records'],
         'test': ['jazzy', 'viewer', 'records', 'jazzy-test', 'test', 'docs', 'env', 'filters',
                  'run', 'meshes', 'mutate', 'onnx', 'xacro']}
#: Extras that tests do without; that of the benchmarks is for an environment of its own.
TOO_LARGE = ('bench', 'ray', 'torch')
#: Extras in place of those of Jazzy, of which one environment has only one.
OTHER_ROS = ('kilted', 'kilted-test')


@pytest.fixture(scope='module')
def asked():
    """Return what setup.py gives to setuptools."""
    given = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(setuptools, 'setup', lambda **arguments: given.update(arguments))
        exec(compile((ROOT / 'setup.py').read_text(), str(ROOT / 'setup.py'), 'exec'),
             {'__file__': str(ROOT / 'setup.py'), '__name__': 'setup'})
    return given


def entries(name):
    """Return the lines of a file of requirements, each with its hashes."""
    text = (ROOT / f'requirements/{name}.txt').read_text()
    text = ''.join(line for line in text.splitlines(keepends=True) if not line.startswith('#'))
    return text.replace(' \\\n', ' ').splitlines()


def locked(name, python):
    """Return the versions that a file locks for a Python on Linux."""
    environment = {'python_version': python, 'python_full_version': f'{python}.9',
                   'sys_platform': 'linux', 'platform_system': 'Linux', 'os_name': 'posix',
                   'platform_machine': 'x86_64', 'implementation_name': 'cpython',
                   'platform_python_implementation': 'CPython', 'extra': ''}
    found = {}
    for entry in entries(name):
        requirement = Requirement(entry.partition(' --hash=')[0])
        if requirement.marker is None or requirement.marker.evaluate(environment):
            assert requirement.name not in found, entry
            (specifier,) = requirement.specifier
            assert specifier.operator == '=='
            found[canonicalize_name(requirement.name)] = specifier.version
    return found


@pytest.mark.parametrize('name', FILES)
def test_every_line_has_hashes_and_no_place_to_load_from(name):
    for entry in entries(name):
        requirement, *hashes = entry.split(' --hash=')
        assert Requirement(requirement).url is None
        assert hashes and all(re.fullmatch('sha256:[0-9a-f]{64} *', value) for value in hashes)


@pytest.mark.parametrize('python', PYTHONS)
@pytest.mark.parametrize('name', FILES)
def test_what_setup_py_asks_for_is_locked_within_its_bounds_for_every_python(name, python, asked):
    found = locked(name, python)
    extras = asked['extras_require']
    requirements = [*asked['install_requires'], *(r for extra in FILES[name]
                                                  for r in extras[extra])]
    assert len(requirements) > 12
    for requirement in map(Requirement, requirements):
        version = found.get(canonicalize_name(requirement.name))
        assert version, f'{requirement} is not locked: make requirements'
        assert requirement.specifier.contains(version), f'{requirement} is locked as {version}'
    assert {*FILES['test'], *TOO_LARGE, *OTHER_ROS} == set(extras)


@pytest.mark.parametrize('python', PYTHONS)
def test_tests_run_with_the_versions_that_users_get(python):
    run, test = locked('run', python), locked('test', python)
    assert run.items() <= test.items()


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
@pytest.mark.parametrize('target, file', [('.ready-wheels', 'run'),
                                          ('.ready-to-test-wheels', 'test')])
def test_make_installs_what_is_locked_where_that_is_asked_for(target, file):
    def recipes(*options):
        done = subprocess.run(
            ['make', '--dry-run', '--always-make', 'ROS_DISTRO=', 'VENV=venv', *options,
             f'venv/{target}'], cwd=ROOT, capture_output=True, text=True, check=True)
        text = done.stdout.replace('\\\n', '')
        return re.findall(r'python -m (pip install .*?)(?: > | *$)', text, re.MULTILINE)
    free, bound = recipes(), recipes('LOCKED=1')
    packages = {'run': "--editable '.[jazzy,viewer]'",
                'test': "'manip_sim[docs,jazzy-test,mutate,test]'"}
    assert f'pip install --progress-bar off {packages[file]}' in free
    assert ('pip install --progress-bar off --require-hashes --requirement '
            f'requirements/{file}.txt') in bound
    # Nothing else is installed without a hash.
    assert [line for line in bound if '--require-hashes' not in line] == [
        'pip install --quiet --no-deps --no-build-isolation --editable .']


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
def test_what_builds_packages_without_a_wheel_is_locked_too(tmp_path):
    done = subprocess.run(
        ['make', '--dry-run', '--always-make', 'ROS_DISTRO=', f'VENV={tmp_path}', 'LOCKED=1',
         f'{tmp_path}/.ready-to-test-wheels'], cwd=ROOT, capture_output=True, text=True,
        check=True)
    (prepare,) = re.findall(r'^\.ci/constraints .*', done.stdout, re.MULTILINE)
    subprocess.run(['sh', '-ec', prepare], cwd=ROOT, check=True)
    file = tmp_path / 'locked.txt'
    constraints = list(map(Requirement, file.read_text().splitlines()))
    assert len(constraints) == len(entries('test'))
    assert 'setuptools' in {one.name for one in constraints}
    assert not [one for one in constraints if one.extras]  # pip takes none here.
    installs = re.findall(r'^.*--require-hashes.*', done.stdout, re.MULTILINE)
    assert len(installs) == 2
    for line in installs:
        assert (f'PIP_CONSTRAINT={file} PIP_BUILD_CONSTRAINT={file} {tmp_path}/bin/python -m pip '
                'install') in line


def test_packages_are_locked_with_the_extras_that_others_ask_for():
    # Otherwise pip before 23.3 takes the version of these for missing, as of Python 3.10.
    locked_extras = {}
    for requirement in (Requirement(entry.partition(' --hash=')[0]) for entry in entries('test')):
        locked_extras.setdefault(canonicalize_name(requirement.name), set()).update(
            requirement.extras)
    asking = []
    for distribution in importlib.metadata.distributions():
        if canonicalize_name(distribution.name) not in locked_extras:
            continue
        for one in map(Requirement, distribution.requires or ()):
            if one.extras and (one.marker is None or one.marker.evaluate({'extra': ''})):
                asking.append(one)
    assert asking
    for one in asking:
        assert one.extras <= locked_extras[canonicalize_name(one.name)], one


@pytest.mark.skipif(shutil.which('make') is None, reason='needs make')
def test_a_release_is_built_with_what_is_locked():
    done = subprocess.run(
        ['make', '--dry-run', 'ROS_DISTRO=', 'VENV=venv', 'LOCKED=1', 'release'], cwd=ROOT,
        capture_output=True, text=True, check=True)
    # With isolation, pip would install the newest setuptools.
    (wheel,) = re.findall('pip wheel .*', done.stdout)
    assert '--no-build-isolation' in wheel
    assert {'setuptools', 'wheel'} <= {name.split('==')[0] for name in (
        entry.split()[0] for entry in entries('test'))}


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec('cyclonedx_py') is None,
                    reason='cyclonedx-bom is not installed')
def test_the_bill_of_materials_of_a_release_names_what_is_locked_with_its_hashes(tmp_path):
    recipe = (ROOT / 'Makefile').read_text().partition('-m cyclonedx_py ')[2].partition('\n\n')[0]
    words = recipe.replace('\\\n', ' ').split()
    target = tmp_path / 'bill.json'
    words[words.index('--output-file') + 1] = str(target)
    words.append('--no-validate')  # Against the schema of the format, which takes six seconds.
    subprocess.run([sys.executable, '-m', 'cyclonedx_py', *words], cwd=ROOT, check=True,
                   capture_output=True)
    bill = json.loads(target.read_text())
    assert bill['bomFormat'] == 'CycloneDX'
    found = {(part['name'], part['version']) for part in bill['components']}
    locked = [Requirement(entry.split()[0]) for entry in entries('run')]
    assert {(canonicalize_name(name), version) for name, version in found} == {
        (canonicalize_name(one.name), str(one.specifier).removeprefix('==')) for one in locked}
    assert all(any(reference.get('hashes') for reference in part['externalReferences'])
               for part in bill['components'])
