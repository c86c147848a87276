# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of what reads YAML, descriptions and parameters, for any text and values."""

import copy
import math
import re

import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402
import numpy as np  # noqa: E402
import yaml  # noqa: E402

from manip_sim.errors import ManipSimError, ModelError, ParameterError  # noqa: E402
from manip_sim.interface.parameter_spec import (  # noqa: E402
    check_names, GivenParameters, read_parameters)
from manip_sim.interface.parameters import (  # noqa: E402
    composition_parameters, node_parameters, periods_per_message, place_parameters,
    steps_per_period)
from manip_sim.interface.part_parameters import (  # noqa: E402
    cartesian_parameters, mode_parameters, stream_parameters, timeout_parameters,
    wrench_parameters)
from manip_sim.interface.topics import Scope  # noqa: E402
from manip_sim.models.cameras import create_camera  # noqa: E402
from manip_sim.models.object_creation import create_object  # noqa: E402
from manip_sim.models.user_files import parse_yaml  # noqa: E402
from manip_sim.models.world import read_gripper  # noqa: E402

SCOPE = Scope()
SPECS = [*node_parameters(), *composition_parameters(SCOPE),
         *place_parameters(SCOPE, [0.0, 0.0, 0.0]), *mode_parameters(SCOPE, ['arm', 'base']),
         *timeout_parameters(SCOPE, ['arm', 'base']), *stream_parameters(SCOPE, ['arm', 'base']),
         *cartesian_parameters(SCOPE, ['right']), *wrench_parameters(SCOPE, ['right'])]

SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6) | (
    st.sampled_from([10**400, -10**400, math.nan, math.inf, 1e308]))
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4)
                      | st.dictionaries(st.text(max_size=4), inner, max_size=3), max_leaves=6)
SMALL = st.floats(-2.0, 2.0)


def told_on_one_line(error):
    assert str(error).isprintable(), str(error)
    assert 0 < len(str(error)) < 1200


@pytest.mark.full
@given(st.text(max_size=40) | st.binary(max_size=40)
       | st.text('{}[]:,-&*!|>\'"#%@` \n\tab01.~<=?', max_size=30))
def test_any_text_is_read_as_a_mapping_or_rejected_on_one_line(text):
    try:
        values = parse_yaml(text, 'here')
    except ModelError as error:
        told_on_one_line(error)
    else:
        assert isinstance(values, dict) and all(isinstance(key, str) for key in values)


class _WithoutAliases(yaml.SafeDumper):
    def ignore_aliases(self, data):
        return True


@given(st.dictionaries(st.text(max_size=6), VALUES, max_size=4))
def test_what_is_written_as_yaml_is_read_back_unless_an_integer_is_too_large(values):
    text = yaml.dump(values, Dumper=_WithoutAliases, allow_unicode=True)
    try:
        found = parse_yaml(text, 'here')
    except ModelError as error:
        assert 'at most 64 bits' in str(error)
        assert any(len(number) > 18 for number in re.findall('[0-9]+', text))
        return
    # NaN is not equal to itself.
    assert repr(found) == repr(yaml.safe_load(text) or {})


OBJECT = st.fixed_dictionaries({}, optional={
    'name': st.sampled_from(['box', 'a_1', '', 'a b', 'world']) | VALUES,
    'shape': st.sampled_from(['box', 'sphere', 'cylinder', 'capsule', 'ellipsoid']) | VALUES,
    'size': st.lists(st.floats(1e-5, 200.0), max_size=4) | SMALL | VALUES,
    'mass': st.floats(0.0, 1e7) | VALUES, 'density': st.floats(0.0, 2e5) | VALUES,
    'friction': st.lists(SMALL, max_size=4) | VALUES, 'rgba': st.lists(SMALL, max_size=5) | VALUES,
    'condim': st.integers(0, 7) | VALUES, 'position': st.lists(SMALL, max_size=4) | VALUES,
    'rpy': st.lists(SMALL, max_size=4) | VALUES, 'file': VALUES,
    'quat_xyzw': st.just([0.0, 0.0, 0.0, 1.0]) | st.lists(SMALL, max_size=4) | VALUES})
SPHERE = st.fixed_dictionaries({'name': st.just('ball'), 'shape': st.just('sphere')}, optional={
    'size': st.floats(1e-4, 100.0), 'mass': st.floats(1e-6, 1e6), 'density': st.floats(1e-6, 1e5),
    'friction': st.lists(st.floats(0.0, 100.0), min_size=1, max_size=3),
    'position': st.lists(st.floats(-1e4, 1e4), min_size=3, max_size=3)})


@pytest.mark.full
@settings(max_examples=200)
@given(OBJECT | SPHERE | st.dictionaries(st.text(max_size=4), VALUES, max_size=3))
def test_a_description_of_an_object_is_rejected_or_compiles(values):
    before = copy.deepcopy(values)
    try:
        found = create_object(values)
    except ModelError as error:
        told_on_one_line(error)
        return
    finally:
        assert repr(values) == repr(before)
    model = found.spec.compile()
    assert model.nbody == 2
    assert math.isfinite(model.body_mass[1]) and model.body_mass[1] > 0.0
    if values.get('mass') is not None:
        assert model.body_mass[1] == pytest.approx(values['mass'])
    assert np.isfinite(model.geom_size).all() and np.isfinite(model.body_inertia).all()


CAMERA = st.fixed_dictionaries({}, optional={
    'name': st.sampled_from(['front', '', 'a b']) | VALUES,
    'position': st.lists(SMALL, min_size=3, max_size=3) | VALUES,
    'look_at': st.lists(SMALL, min_size=3, max_size=3) | VALUES,
    'rpy': st.lists(SMALL, min_size=3, max_size=3) | VALUES,
    'fovy': st.floats(-10.0, 200.0) | VALUES, 'width': st.integers(-2, 5000) | VALUES,
    'body': st.text(max_size=3) | VALUES, 'other': SCALARS})


@given(CAMERA)
def test_a_description_of_a_camera_is_rejected_or_is_one(values):
    try:
        create_camera(values)
    except ModelError as error:
        told_on_one_line(error)


@given(st.text(max_size=12) | st.sampled_from(['{right: PandaGripper}', '{left: none', '{}', '[]'])
       | st.text('{}[]:, arightleft&*', max_size=20))
def test_a_text_that_tells_grippers_by_arm_is_rejected_or_names_them(text):
    try:
        found = read_gripper(text)
    except ModelError as error:
        told_on_one_line(error)
    else:
        assert isinstance(found, str) or all(
            isinstance(name, str) for item in found.items() for name in item)


@pytest.mark.parametrize('spec', SPECS, ids=lambda spec: spec.name)
@settings(max_examples=15)
@given(data=st.data())
def test_a_value_is_rejected_or_has_the_type_and_limits_of_its_parameter(spec, data):
    near = {float: st.floats(-10.0, 1e4), int: st.integers(-10, 10**10), bool: st.booleans(),
            str: st.sampled_from([*spec.choices, '']) | st.text(max_size=9),
            list: st.lists(SMALL, max_size=4) | st.lists(st.text(max_size=4), max_size=3)}
    check_value(spec, data.draw(near[type(spec.default)] | VALUES))


@pytest.mark.parametrize('spec', SPECS, ids=lambda spec: spec.name)
def test_a_value_of_the_wrong_kind_or_size_is_rejected(spec):
    for value in (None, 10**400, -10**400, [10**400] * 3, [[]], [None], {}, {'a': {}}, math.nan,
                  math.inf, 'x' * 10_000, [math.nan] * 4, '', [], 0, 1, True):
        check_value(spec, value)


def check_value(spec, given_value):
    """Check that a value is rejected as documented, or is one that the parameter may have."""
    parameters = GivenParameters({spec.name: given_value})
    try:
        parameters.declare([spec])
    except ParameterError as error:
        assert spec.name in str(error)
        assert parameters.value(spec.name) == spec.default
        return
    value = parameters.value(spec.name)
    assert type(value) is type(spec.default)
    if isinstance(value, float):
        assert spec.minimum is None or spec.minimum <= value <= spec.maximum
    if spec.choices and not spec.kind:
        assert value in spec.choices
    if spec.length:
        assert len(value) == spec.length and np.isfinite(value).all()


@given(st.lists(st.text(max_size=12), max_size=3))
def test_names_of_parameters_are_known_or_rejected(names):
    known = [spec.name for spec in SPECS]
    try:
        check_names(names, known)
    except ParameterError as error:
        assert 'unknown parameter' in str(error)
    else:
        assert all(name in known or name.startswith('qos_overrides.') for name in names)


@given(st.text('/*: {}\n manip_simros__parameters1.5', max_size=60) | st.dictionaries(
    st.sampled_from(['/**', 'manip_sim', '/manip_sim', '*', 'a']), st.dictionaries(
        st.sampled_from(['ros__parameters', 'b']), VALUES, max_size=2), max_size=3).map(
            lambda values: yaml.dump(values, Dumper=_WithoutAliases)))
def test_a_file_of_parameters_is_rejected_or_gives_names_and_values(tmp_path_factory, text):
    file = tmp_path_factory.getbasetemp() / 'any.yaml'
    file.write_text(text, newline='')
    try:
        found = read_parameters(file)
    except ManipSimError as error:
        told_on_one_line(error)
    else:
        assert all(isinstance(name, str) and not isinstance(value, dict)
                   for name, value in found.items())


@given(st.floats(1.0, 1e4) | st.sampled_from([50.0, 100.0, 250.0, 500.0, 1000.0]),
       st.floats(1e-4, 1e-2) | st.sampled_from([0.001, 0.002, 0.005]), st.floats(0.1, 1e4))
def test_a_rate_is_rejected_or_that_of_whole_timesteps(publish_rate, timestep, rate):
    try:
        steps = steps_per_period(publish_rate, timestep)
    except ParameterError as error:
        told_on_one_line(error)
        return
    assert steps >= 1 and steps * timestep * publish_rate == pytest.approx(1.0, abs=1e-6)
    periods = periods_per_message(publish_rate, rate)
    assert periods >= 1
    # No other whole number of periods comes nearer.
    error = abs(publish_rate / periods - rate)
    for other in (periods - 1, periods + 1):
        assert other < 1 or abs(publish_rate / other - rate) >= error - 1e-9 * rate
