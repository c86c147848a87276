# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files of users that hold any text are read, or rejected on one line."""

import argparse

import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402

from manip_sim.cli.run import _noise  # noqa: E402
from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.models.files.ros_packages import expanded  # noqa: E402
from manip_sim.models.randomization import Randomization  # noqa: E402
from manip_sim.tasks import create_task  # noqa: E402

YAML = st.sampled_from([
    'bodies', 'geoms', 'lights', 'parameters', '"*"', 'box', 'mass', 'size', 'uniform', 'choice',
    'latency.state', 'noise.joint_position', 'name', 'robot', 'objects', 'success', 'task',
    '- ', ': ', ':\n  ', '\n', '[', ']', '{', '}', '0.5', '1', '.nan', '-1e400', '0x1f', '1:30',
    '2001-01-01', 'null', '~', 'true', '!!python/object:os.system', '!!float x', '&a', '*a', '? ',
    '| ', '> ', '"', '\t', '#', '---', '...', '%', '<<: ', '\0', '\x1b', 'é'])
XACRO = st.sampled_from([
    '<link name="$(arg n)"/>', '<link name="${n}"/>', '<xacro:property name="p" value="${1/0}"/>',
    '<xacro:property name="p" value="${p}"/>', '${p}', '${', '}', '$(', '$(find x)', '$(env X)',
    '$(eval 1+', '${exit()}', '${[].__class__}', '${10**10}', '${fatal("x")}', '${open("x")}',
    '<xacro:include filename="f.xacro"/>', '<xacro:include filename="none.xacro"/>',
    '<xacro:macro name="m" params="a b:=1 *c">', '</xacro:macro>', '<xacro:m a="1"/>',
    '<xacro:if value="x">', '</xacro:if>', '<xacro:insert_block name="c"/>', '<a>', '</a>',
    '&amp;', '&x;', '<!--', '-->', '<?', 'x', '1e999'])
HEAD = ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="a">'
        '<xacro:arg name="n" default="1"/>')


def is_read_or_one_line(read):
    try:
        read()
    except ManipSimError as error:
        assert '\n' not in str(error) and len(str(error)) < 2000


@pytest.mark.full
@pytest.mark.parametrize('read', [
    Randomization, create_task,
    lambda file: _noise(argparse.Namespace(noise=[str(file)], latency=[]))],
    ids=['randomization', 'task', 'noise'])
@settings(max_examples=150)
@given(content=st.binary(max_size=60) | st.lists(YAML, max_size=14).map(
    lambda words: ''.join(words).encode()))
def test_any_yaml_is_read_or_rejected_on_one_line(read, content, tmp_path):
    file = tmp_path / 'file.yaml'
    file.write_bytes(content)
    is_read_or_one_line(lambda: read(file))


@settings(max_examples=60)
@given(parts=st.lists(XACRO, max_size=8), whole=st.booleans(),
       arguments=st.dictionaries(st.just('n'), XACRO | st.text(max_size=12)))
def test_any_xacro_with_any_argument_is_expanded_or_rejected_on_one_line(
        parts, whole, arguments, tmp_path, capfd):
    pytest.importorskip('xacro', reason='xacro is not installed')
    file = tmp_path / 'f.xacro'
    file.write_text(''.join([HEAD, *parts, '</robot>'] if whole else parts))
    is_read_or_one_line(lambda: expanded(file, arguments))
