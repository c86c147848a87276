# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Configuration of Sphinx: Markdown pages, and the Python API from docstrings."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
import sys
from xml.etree import ElementTree

# rosdoc2 executes this file from another folder, and puts the package on the path by itself.
ROOT = Path(__file__).resolve().parents[1] if '__file__' in globals() else Path.cwd()
sys.path.insert(0, str(ROOT))

project = 'manip_sim'
author = 'The manip_sim developers'
project_copyright = f'2026, {author}'
_package = ROOT / 'package.xml'
if _package.exists():
    release = version = ElementTree.parse(_package).findtext('version')

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.viewcode']
source_suffix = {'.md': 'markdown'}
# _front_page.md is a link to README.md, because rosdoc2 copies this folder alone.
exclude_patterns = ['_build', '_front_page.md']

myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4
# Command lines with placeholders are not valid shell, so nothing is highlighted by default.
highlight_language = 'none'

autodoc_mock_imports = ['rclpy']
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented_params'
autodoc_member_order = 'bysource'
autodoc_preserve_defaults = True
autodoc_inherit_docstrings = False
add_module_names = False
python_use_unqualified_type_names = True

nitpicky = True
# Types of other packages, and of the standard library, are not linked: builds need no network.
nitpick_ignore_regex = [
    ('py:.*', r'(gymnasium|mujoco|np|numpy|os|collections|typing|pathlib|enum|dataclasses)\..*'),
    ('py:.*', r'(Any|ArrayLike|(Bool|Float|Int)Array|Callable|Iterable|Mapping|Path|PathLike)'),
    ('py:.*', 'AutoresetMode'),
    ('py:.*', 'Sequence'),
    ('py:.*', 'Union'),
    ('py:.*', r'(abc\..*|C|P|T|GripperT|.*\.[CPT]|.*\.GripperT|(.*\.)?Sent)'),
    # Fields of instances are part of the text of their class.
    ('py:(attr|data)', '.*'),
    # Classes and functions that the documented ones use.
    ('py:(class|func)', r'.*(Controller|Description|Frames|GripperJoints|HandFromFile|ModelFile'
                        r'|_TaskEpisodes|RobotPlan|RobotRun|ImageSettings|CameraModel|Camera'
                        r'|InitializationNoise|create_camera|Files|AllowedRoots|ActuatorEfforts'
                        r'|Clock|ControlledJoints|Physics|TakenNames|Offer|Episode|Hold'
                        r'|KinematicChain|ArmAction|Registry|Robot|Gripper|Grippers|LatencyLike'
                        r'|CameraLike|AnswerTimeLike|Pictures|FrictionLaw|Friction|TorqueSpeed'
                        r'|Shard|Base|PictureThreads'
                        r'|create_lidar|LidarModel|LidarLike|RandomizationLike|Measured'
                        r'|FaultsLike|FaultPlan|_LikeTable'
                        r'|ControlState|ElementMap|Operations|Part|RobotJoints|Targets'
                        r'|SeatState|Surroundings|Hardware)'),
]

# The theme of docs.ros.org where furo is not installed.
html_theme = 'furo' if find_spec('furo') else 'sphinx_rtd_theme'
html_title = 'manip_sim'
html_static_path = ['_static']
html_css_files = ['wide.css']
html_show_sphinx = False


def _begin_with_front_page(app, docname, source):
    """Begin the index with README.md, whose links are those of the folder above."""
    if docname == 'index':
        page = Path(app.srcdir, '_front_page.md').read_text().partition('## Documentation')[0]
        source[0] = page.replace('](docs/', '](') + source[0]


def _resolve_short_name(app, env, node, contnode):
    """Link a name in a docstring that is defined in another module."""
    if node.get('refdomain') != 'py' or node.get('reftype') not in ('class', 'func', 'meth'):
        return None
    node['refspecific'] = True
    return env.get_domain('py').resolve_xref(
        env, node['refdoc'], app.builder, node['reftype'], node['reftarget'], node, contnode)


def setup(app):
    app.connect('source-read', _begin_with_front_page)
    app.connect('missing-reference', _resolve_short_name)
    # Sphinx looks for it below the folder that it runs in.
    app.config.html_search_scorer = str(Path(app.srcdir, '_static', 'scorer.js'))
