# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The XML files of the package are well formed, and package.xml tells what setup.py tells."""

from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest

import manip_sim

ROOT = Path(__file__).resolve().parents[1]
FILES = [ROOT / 'package.xml', *sorted((ROOT / 'hardware').glob('*.xml')),
         *sorted((ROOT / 'assets').rglob('*.xml'))]


@pytest.mark.parametrize('file', FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_an_xml_file_is_well_formed(file):
    ElementTree.parse(file)


def test_package_xml_and_setup_py_agree():
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    maintainer = package.find('maintainer')
    assert package.get('format') == '3'
    assert re.fullmatch(r'[^@\s]+@[^@\s]+\.[^@\s]+', maintainer.get('email'))
    told = subprocess.run(
        [sys.executable, '-W', 'ignore', 'setup.py', '--quiet', '--name', '--version',
         '--license', '--maintainer', '--maintainer-email', '--description'],
        cwd=ROOT, capture_output=True, text=True, check=True)
    assert told.stdout.splitlines() == [
        package.findtext('name'), package.findtext('version'), package.findtext('license'),
        maintainer.text, maintainer.get('email'), package.findtext('description')]
    assert manip_sim.__version__ == package.findtext('version')
    hardware = ElementTree.parse(ROOT / 'hardware' / 'package.xml').getroot()
    for field in ('version', 'maintainer', 'license'):
        assert hardware.findtext(field) == package.findtext(field)
    assert f'version: {manip_sim.__version__}\n' in (ROOT / 'CITATION.cff').read_text()


def test_every_ros_package_that_is_imported_is_declared():
    declared = {element.text for element in
                ElementTree.parse(ROOT / 'package.xml').getroot().iter('exec_depend')}
    imported = set()
    for file in (ROOT / 'manip_sim').rglob('*.py'):
        imported |= set(re.findall(r'^(?:from|import) (rclpy|\w+_msgs|\w+_srvs|\w+_interfaces)\b',
                                   file.read_text(), re.MULTILINE))
    assert imported <= declared
    assert 'rclpy' in imported
