# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every source file says whose it is and under which licence."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HEADER = ('# Copyright 2026 The manip_sim developers\n'
          '# SPDX-License-Identifier: Apache-2.0\n')


def test_every_python_file_begins_with_the_licence():
    folders = ('manip_sim', 'test', 'benchmark')
    files = [ROOT / 'setup.py', *(p for folder in folders for p in (ROOT / folder).rglob('*.py'))]
    assert len(files) > 20
    assert not [str(file) for file in files if not file.read_text().startswith(HEADER)]
