# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""TorchScript and ONNX files as policies: rows as those of the same policy in Python."""

import importlib.util
from pathlib import Path

import pytest

from manip_sim.errors import ModelError
from manip_sim.experiments import Experiment, Worker
from manip_sim.tasks import Setting

IN_PYTHON = f'{Path(__file__).with_name("policies_under_test.py")}:Towards'


def rows_of(policy):
    worker = Worker(Experiment(Setting('reach'), str(policy)))
    return [worker.run(seed) for seed in range(3)]


def rows_at_once(policy):
    worker = Worker(Experiment(Setting('reach'), str(policy), batch=3))
    return sorted(worker.run_at_once(range(3)), key=lambda row: row.seed)


@pytest.fixture(scope='module')
def like():
    """Return the rows of the policy in Python."""
    return rows_of(IN_PYTHON)


def assert_alike(rows, like):
    """Compare rows; numbers of a network are float32."""
    assert all(row.success and not row.error for row in rows)
    assert [row.periods for row in rows] == [row.periods for row in like]
    assert [row.returned for row in rows] == pytest.approx([row.returned for row in like],
                                                           rel=1e-4)


@pytest.mark.filterwarnings('ignore::FutureWarning', 'ignore::DeprecationWarning')
@pytest.mark.parametrize('takes', ['dictionary', 'array'])
def test_a_torch_script_gives_the_rows_of_the_policy_in_python(takes, like, tmp_path):
    torch = pytest.importorskip('torch', reason='torch is not installed; it is the extra torch')
    from networks_under_test import OfArray, OfDictionary
    network = {'dictionary': OfDictionary, 'array': OfArray}[takes]()
    torch.jit.script(network).save(str(tmp_path / 'network.pt'))
    assert_alike(rows_of(tmp_path / 'network.pt'), like)


def assert_draws_depend_on_the_seed_alone(policy):
    rows = rows_of(policy)
    worker = Worker(Experiment(Setting('reach'), str(policy)))
    assert [worker.run(seed) for seed in (2, 1)] == [rows[2], rows[1]]
    assert len({row.digest for row in rows}) == 3


def test_what_a_policy_draws_depends_on_the_seed_alone():
    assert_draws_depend_on_the_seed_alone(IN_PYTHON.replace(':Towards', ':Draws'))


@pytest.mark.filterwarnings('ignore::FutureWarning', 'ignore::DeprecationWarning')
def test_what_a_network_draws_depends_on_the_seed_alone(tmp_path):
    torch = pytest.importorskip('torch', reason='torch is not installed; it is the extra torch')
    from networks_under_test import Draws
    torch.jit.script(Draws()).save(str(tmp_path / 'network.pt'))
    assert_draws_depend_on_the_seed_alone(tmp_path / 'network.pt')


@pytest.mark.full
@pytest.mark.parametrize('takes', ['dictionary', 'array'])
def test_an_onnx_file_gives_the_rows_of_the_policy_in_python(takes, like, tmp_path):
    pytest.importorskip('onnxruntime', reason='onnxruntime is not installed; it is the extra onnx')
    onnx = pytest.importorskip('onnx', reason='onnx, which writes the file, is not installed')
    helper, kinds = onnx.helper, onnx.TensorProto
    own = {'dictionary': ('eef_pose', [None, 1, 7], 2, 0),
           'array': ('all', [None, 22], 1, 0)}[takes]
    name, shape, axis, begin = own

    def ints(key, *values):
        return helper.make_tensor(key, kinds.INT64, [len(values)], values)

    nodes = [helper.make_node('Slice', [name, 'begin', 'end', 'axis'], ['part']),
             helper.make_node('Reshape', ['part', 'three'], ['end_effector'])]
    inputs = [helper.make_tensor_value_info(name, kinds.FLOAT, shape)]
    if takes == 'array':  # Sorted: eef_pose, eef_twist, external_wrench, goal, joints.
        inputs = [helper.make_tensor_value_info(name, kinds.FLOAT, [None, None])]
        nodes.append(helper.make_node('Slice', [name, 'goal0', 'goal1', 'axis'], ['goal']))
    else:
        inputs.append(helper.make_tensor_value_info('goal', kinds.FLOAT, [None, 3]))
    nodes += [helper.make_node('Sub', ['goal', 'end_effector'], ['way']),
              helper.make_node('Div', ['way', 'scale'], ['steps']),
              helper.make_node('Clip', ['steps', 'low', 'high'], ['move']),
              helper.make_node('Pad', ['move', 'widths'], ['action'])]
    graph = helper.make_graph(
        nodes, 'towards', inputs,
        [helper.make_tensor_value_info('action', kinds.FLOAT, [None, 7])],
        [ints('begin', begin), ints('end', begin + 3), ints('axis', axis), ints('three', -1, 3),
         ints('widths', 0, 0, 0, 4),
         ints('goal0', 19), ints('goal1', 22),
         helper.make_tensor('scale', kinds.FLOAT, [], [0.05]),
         helper.make_tensor('low', kinds.FLOAT, [], [-1.0]),
         helper.make_tensor('high', kinds.FLOAT, [], [1.0])])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 13)])
    model.ir_version = 8
    onnx.save(model, tmp_path / 'network.onnx')
    assert_alike(rows_of(tmp_path / 'network.onnx'), like)
    assert_alike(rows_at_once(tmp_path / 'network.onnx'), like)


@pytest.mark.parametrize('suffix, library', [('.pt', 'torch'), ('.onnx', 'onnxruntime')])
def test_a_file_that_is_no_network_is_one_line(suffix, library, tmp_path):
    file = tmp_path / f'network{suffix}'
    file.write_text('x')
    with pytest.raises(ModelError) as raised:
        rows_of(file)
    if importlib.util.find_spec(library) is None:
        assert f'needs {library}: pip install' in str(raised.value)
    assert str(raised.value).startswith('policy ') and '\n' not in str(raised.value)
    with pytest.raises(ModelError, match='there is no such file'):
        rows_of(tmp_path / f'missing{suffix}')
