# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The handlers of the services of simulation_interfaces, with plain objects of the same fields.

The package itself need not be installed; test_simulation_interfaces.py has tests with it.
"""

import io
import math
from types import SimpleNamespace as Plain
import zipfile

from geometry_msgs.msg import Accel, Pose, PoseStamped, Twist
import numpy as np
import pytest
from std_msgs.msg import Header

from manip_sim.errors import DivergenceError
from manip_sim.models import compose
from manip_sim.models.regular_files import FilesBelow
from manip_sim.ros import spawning_services
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.spawning_services import SpawningServices
from manip_sim.ros.standard_answers import (
    BoundsType, Category, FeatureCode, ResultCode, ScopeCode, SetEntityCode, SetStateCode,
    SpawnCode, StateCode)
from manip_sim.ros.standard_services import EntityServices
from manip_sim.ros.standard_services import SimulationInterfaces
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import Simulation

OK, FAILED = ResultCode.RESULT_OK, ResultCode.RESULT_OPERATION_FAILED
UNSUPPORTED, NOT_FOUND = ResultCode.RESULT_FEATURE_UNSUPPORTED, ResultCode.RESULT_NOT_FOUND
STOPPED, PLAYING, PAUSED = StateCode
PERIOD_NS = 10_000_000
BALL = '{name: ball, shape: sphere, size: 0.1, mass: 0.2}'
MJCF = ('<mujoco><worldbody><body name="can"><freejoint/>'
        '<geom size="0.03" mass="0.1"/></body></worldbody></mujoco>')
TYPES = Plain(**{name: name for name in (
    'GetSimulatorFeatures', 'GetSimulationState', 'SetSimulationState', 'StepSimulation',
    'ResetSimulation', 'GetEntities', 'GetEntityState', 'SetEntityState', 'SpawnEntity',
    'DeleteEntity')})


def state_message():
    return Plain(header=Header(), pose=Pose(), twist=Twist(), acceleration=Accel())


def spawn_request(text, uri='', name='', allow_renaming=False, namespace='', frame='', w=1.0,
                  height=1.0):
    pose = PoseStamped(header=Header(frame_id=frame))
    pose.pose.position.z, pose.pose.orientation.w = height, w
    return {'name': name, 'allow_renaming': allow_renaming, 'uri': str(uri),
            'resource_string': text, 'entity_namespace': namespace, 'initial_pose': pose}


class Standard:
    """A simulation with the services, called as the executor calls them."""

    executor = None

    def __init__(self, folder):
        self.world = compose('Panda', arena='table', cube=True)
        self.simulation = Simulation(self.world)
        self.thread = SimulationThread(self.simulation, steps=5, stepping='free', paused=True)
        self.services, self.groups, self.followed = {}, {}, []
        context = NodeContext(
            node=self, simulation=self.simulation, thread=self.thread, robots={}, parameters=None,
            log=None, frame_prefix='', inbox=None, publishing=None, table=[], features=[
                Plain(world_changed=lambda: self.followed.append(self.simulation))])
        SimulationInterfaces(context, TYPES)
        EntityServices(context, TYPES)
        SpawningServices(context, FilesBelow([folder], 'spawn_roots'), TYPES)
        self.thread.start()

    def create_service(self, service_type, name, callback, callback_group=None):
        self.services[name] = service_type, callback
        self.groups[name] = callback_group

    def call(self, service, /, **request):
        """Return the response to a request."""
        response = Plain(result=Plain(result=0, error_message=''), state=state_message(),
                         features=Plain(), entities=None, entity_name='')
        answer = self.services[f'~/{service}'][1](Plain(**request), response)
        if hasattr(answer, 'send'):
            try:
                while True:
                    answer.send(None)
            except StopIteration as end:
                answer = end.value
        return answer

    def code(self, service, /, **request):
        """Return code and text of the result of a request."""
        result = self.call(service, **request).result
        # The type support takes these types only.
        assert type(result.result) is int and type(result.error_message) is str
        return result.result, result.error_message

    def state(self):
        return self.call('get_simulation_state').state.state

    def set_state(self, state):
        return self.code('set_simulation_state', state=Plain(state=int(state)))

    def entities(self, filter_='', categories=(), tags=(), bounds=0):
        return self.call('get_entities', filters=Plain(
            filter=filter_, categories=[Plain(category=int(c)) for c in categories],
            tags=Plain(tags=list(tags)), bounds=Plain(type=bounds)))

    def entity(self, name='cube'):
        return self.call('get_entity_state', entity=name)

    def place(self, name='cube', frame='', position=(0.0, 0.0, 1.5), w=1.0, linear=(0.0,) * 3,
              **flags):
        message = state_message()
        message.header.frame_id = frame
        for field, value in zip('xyz', position):
            setattr(message.pose.position, field, value)
        for field, value in zip('xyz', linear):
            setattr(message.twist.linear, field, value)
        message.pose.orientation.w = w
        return self.code('set_entity_state', entity=name, state=message, **flags)

    def spawn(self, text='', **fields):
        return self.call('spawn_entity', **spawn_request(text, **fields))

    def explode(self):
        def change():
            self.simulation.data.qvel[-1] = 1e9
            with pytest.raises(DivergenceError):
                self.simulation.advance(1)
        self.thread.call(change)
        assert self.simulation.diverged is not None


@pytest.fixture
def standard(tmp_path):
    started = Standard(tmp_path)
    yield started
    started.thread.stop()


def test_each_service_has_the_type_of_its_name(standard):
    assert {name: kind for name, (kind, _) in standard.services.items()} == {
        '~/' + ''.join('_' * bool(i) * c.isupper() + c.lower() for i, c in enumerate(kind)): kind
        for kind in vars(TYPES)}


def test_a_request_for_many_steps_holds_up_no_other(standard):
    step = standard.groups.pop('~/step_simulation')
    assert step is not None and step not in standard.groups.values()


def test_features_are_numbers_and_formats_are_told(standard):
    features = standard.call('get_simulator_features').features
    assert {type(number) for number in features.features} == {int}
    assert set(features.features) == set(FeatureCode)
    assert features.spawn_formats == ['mjcf', 'urdf', 'yaml']
    assert 'control period' in features.custom_info


def test_numbers_are_those_of_version_2_1_of_the_package():
    # Of its messages Result, SimulatorFeatures, SpawnResult, EntityCategory, SimulationState,
    # Bounds, and of its services SetSimulationState, SetEntityState, ResetSimulation.
    for codes, numbers in {
            ResultCode: [0, 1, 2, 3, 4], SetStateCode: [101, 102], SetEntityCode: [101],
            SpawnCode: [101, 102, 103, 104, 105, 106, 109], StateCode: [0, 1, 2],
            ScopeCode: [0, 1, 2, 255], Category: [0, 1], BoundsType: [0],
            FeatureCode: [0, 1, 8, 9, 10, 11, 20, 22, 24, 25, 26, 31, 32]}.items():
        assert [int(code) for code in codes.__members__.values()] == numbers


@pytest.mark.parametrize('length, quick', [(10, True), (5000, False)])
def test_short_texts_alone_are_made_at_once(length, quick):
    text = MJCF.replace('<mujoco', f'<!-- {"x" * length} --><mujoco', 1)
    found, _ = spawning_services._prepared(Plain(**spawn_request(text)), None)
    assert found is quick


def test_simulation_plays_is_paused_and_stopped(standard):
    assert standard.state() == PAUSED
    for state in (PLAYING, STOPPED, PAUSED, STOPPED, PLAYING, PAUSED):
        assert standard.set_state(state) == (OK, '')
        assert standard.state() == state
        code, text = standard.set_state(state)
        assert code == SetStateCode.ALREADY_IN_TARGET_STATE and text
    code, text = standard.set_state(4)
    assert code == UNSUPPORTED and text.startswith('state 4 cannot be set')


def test_steps_are_control_periods(standard):
    before = standard.simulation.time_ns
    assert standard.code('step_simulation', steps=3) == (OK, '')
    assert standard.simulation.time_ns == before + 3 * PERIOD_NS
    assert standard.code('step_simulation', steps=0) == (
        FAILED, 'steps must be 1 or more, got 0')
    standard.set_state(STOPPED)
    assert standard.code('step_simulation', steps=1)[1] == (
        'the simulation is stopped: pause it first')
    standard.set_state(PLAYING)
    code, text = standard.code('step_simulation', steps=1)
    assert code == FAILED and 'pause it first' in text


def test_steps_that_were_made_are_told_when_the_next_one_cannot_be(standard):
    made = []

    def explode(_):
        made.append(None)
        if len(made) == 3:
            standard.simulation.data.qvel[-1] = 1e9
    standard.thread.observe(explode)
    code, text = standard.code('step_simulation', steps=10)
    assert code == FAILED and text.endswith(
        f'reset it first (after {len(made)} of 10 steps)')


@pytest.mark.parametrize(('scope', 'restarts'), [
    (ScopeCode.SCOPE_DEFAULT, True), (ScopeCode.SCOPE_ALL, True), (ScopeCode.SCOPE_STATE, False),
    (ScopeCode.SCOPE_STATE | ScopeCode.SCOPE_TIME, True)])
def test_reset_puts_all_back_and_keeps_or_restarts_time(standard, scope, restarts):
    start = standard.entity().state.pose.position
    standard.place(position=(0.1, 0.2, 1.5))
    standard.code('step_simulation', steps=10)
    assert standard.code('reset_simulation', scope=int(scope)) == (OK, '')
    assert standard.simulation.time_ns == PERIOD_NS * (1 if restarts else 12)
    assert standard.entity().state.pose.position == start


@pytest.mark.parametrize('scope', [ScopeCode.SCOPE_TIME, 4, 6, 64])
def test_scope_that_does_not_work_is_rejected(standard, scope):
    code, text = standard.code('reset_simulation', scope=int(scope))
    assert code == UNSUPPORTED and f'scope {int(scope)} is not supported' in text


def test_simulation_that_diverged_can_be_reset_only(standard):
    standard.explode()
    for code, text in (
            standard.set_state(PLAYING), standard.code('step_simulation', steps=1),
            standard.place(), standard.code('spawn_entity', **spawn_request(BALL))):
        assert code in (SetStateCode.STATE_TRANSITION_ERROR, FAILED,
                        ResultCode.RESULT_INCORRECT_STATE)
        assert text.endswith('reset it first')
    assert standard.code('reset_simulation', scope=0) == (OK, '')
    assert standard.set_state(PLAYING) == (OK, '')


def test_entities_are_found_by_name_and_category(standard):
    assert standard.entities().entities == ['robot0_base', 'cube']
    assert standard.entities('^c').entities == ['cube']
    assert standard.entities(categories=[Category.CATEGORY_ROBOT]).entities == ['robot0_base']
    assert standard.entities(categories=[Category.CATEGORY_OBJECT]).entities == ['cube']
    assert standard.entities(categories=[2]).entities == []


@pytest.mark.parametrize(('filters', 'code', 'text'), [
    ({'filter_': '('}, FAILED, "filter '('"), ({'tags': ['red']}, UNSUPPORTED, 'no tags'),
    ({'bounds': 3}, UNSUPPORTED, 'no bounds')])
def test_filter_that_does_not_work_is_rejected(standard, filters, code, text):
    result = standard.entities(**filters).result
    assert result.result == code and text in result.error_message


def test_state_of_an_entity_is_where_it_was_put_and_falls_to(standard):
    assert standard.place(position=(0.0, 0.1, 3.0), linear=(0.5, 0.0, 1.0)) == (OK, '')
    standard.code('step_simulation', steps=20)
    response = standard.entity()
    assert response.result.result == OK
    state, time_s = response.state, 0.2
    assert state.header.frame_id == 'world'
    assert state.header.stamp.nanosec == standard.simulation.time_ns
    position, velocity = state.pose.position, state.twist.linear
    np.testing.assert_allclose(
        [position.x, position.y, position.z],
        [0.5 * time_s, 0.1, 3.0 + time_s - 9.81 * time_s**2 / 2.0], atol=2e-3)
    np.testing.assert_allclose([velocity.x, velocity.z], [0.5, 1.0 - 9.81 * time_s], atol=1e-6)
    assert state.acceleration.linear.z == pytest.approx(-9.81)
    assert state.pose.orientation.w == pytest.approx(1.0)
    assert standard.entity('sphere').result.result == NOT_FOUND


def test_version_two_of_the_standard_says_what_to_set(standard):
    assert standard.place(position=(0.0, 0.1, 3.0), set_pose=True, set_twist=False)[0] == OK
    assert standard.place(linear=(0.0, 0.0, 2.0), set_pose=False, set_twist=True)[0] == OK
    state = standard.entity().state
    assert (state.pose.position.z, state.twist.linear.z) == pytest.approx((3.0, 2.0))
    code, text = standard.place(set_pose=False, set_twist=False)
    assert code == FAILED and text.startswith('nothing to set')


@pytest.mark.parametrize(('request_', 'code', 'text'), [
    ({'name': 'robot0_base'}, FAILED, 'only free bodies can'),
    ({'name': 'sphere'}, NOT_FOUND, "'sphere'"),
    ({'frame': 'table'}, UNSUPPORTED, "frame_id 'table' is not supported"),
    ({'w': 0.0}, SetEntityCode.INVALID_POSE, ''),
    ({'position': (math.nan, 0.0, 0.0)}, SetEntityCode.INVALID_POSE, 'nan'),
    ({'linear': (0.0, math.inf, 0.0)}, FAILED, 'inf')])
def test_state_that_cannot_be_set_is_rejected(standard, request_, code, text):
    before = standard.entity().state
    found, told = standard.place(**request_)
    assert found == code and text in told and told
    assert standard.entity().state == before


def test_object_comes_from_a_text_or_a_file_and_goes(standard, tmp_path):
    paths = {'can.xml': MJCF, 'ball.yaml': f'objects: [{BALL}]'}
    for name, text in paths.items():
        (tmp_path / name).write_text(text)
    for number, (source, expected) in enumerate((
            ({'text': BALL}, 'ball'), ({'text': MJCF}, 'can'),
            ({'text': '{shape: sphere, size: 0.1, mass: 0.2}'}, 'object'),
            ({'uri': tmp_path / 'can.xml', 'name': 'tin'}, 'tin'),
            ({'uri': f'file://{tmp_path}/ball.yaml', 'name': 'globe'}, 'globe')), start=1):
        response = standard.spawn(**source, height=float(number))
        assert (response.result.result, response.entity_name) == (OK, expected), response
        assert standard.entity(expected).state.pose.position.z == pytest.approx(number)
        assert len(standard.followed) == number
    assert standard.code('delete_entity', entity='can') == (OK, '')
    assert standard.entities().entities == ['robot0_base', 'cube', 'ball', 'object', 'tin',
                                            'globe']
    assert len(standard.followed) == 6


def test_name_that_is_taken_gets_a_number_if_it_may_be_changed(standard):
    assert standard.spawn(BALL).entity_name == 'ball'
    assert standard.spawn(BALL).result.result == SpawnCode.NAME_NOT_UNIQUE
    assert standard.spawn(BALL, allow_renaming=True).entity_name == 'ball_1'
    assert standard.spawn(BALL, name='1 red/ball', allow_renaming=True).entity_name == 'red_ball'
    assert standard.spawn(BALL, name='***', allow_renaming=True).entity_name == 'object'


@pytest.mark.parametrize(('request_', 'code', 'text'), [
    ({'text': BALL, 'namespace': 'left'}, 'NAMESPACE_INVALID', 'has no namespace'),
    ({'text': BALL, 'name': 'red ball'}, 'NAME_INVALID', "'red ball'"),
    ({'text': ' '}, 'NO_RESOURCE', 'give a file (uri) or a text'),
    ({'text': '<mujoco>'}, 'RESOURCE_PARSE_ERROR', ''),
    ({'text': '{shape: sfere}'}, 'RESOURCE_PARSE_ERROR', 'sphere'),
    ({'text': BALL, 'w': 0.0}, 'INVALID_POSE', ''),
    ({'uri': 'https://example.com/can.xml'}, 'UNSUPPORTED_FORMAT', 'only paths and file://'),
    ({'uri': '/tmp/can.sdf'}, 'UNSUPPORTED_FORMAT', 'only MJCF (.xml, .mjcf), URDF and YAML'),
    ({'uri': 'nowhere/can.xml'}, 'RESOURCE_PARSE_ERROR', '/nowhere/can.xml')])
def test_object_that_cannot_come_is_rejected(standard, request_, code, text):
    result = standard.spawn(**request_).result
    assert result.result == SpawnCode[code] and text in result.error_message
    assert result.error_message and standard.entities().entities == ['robot0_base', 'cube']


@pytest.mark.parametrize('request_', [
    {'text': '<mujoco><asset><texture name="t" type="2d" file="SECRET" content_type="image/ktx"/>'
             '</asset><worldbody><body><geom size="1"/></body></worldbody></mujoco>'},
    {'text': '{name: can, file: SECRET}'}, {'text': '<mujoco><include file="SECRET"/></mujoco>'},
    {'uri': 'SECRET'}, {'uri': 'file://SECRET'}, {'uri': '../SECRET'}, {'uri': 'link.xml'},
    {'uri': 'textured.xml'}])
def test_a_file_that_may_not_be_read_never_reaches_the_archive(standard, request_, tmp_path):
    private = tmp_path.parent / f'{tmp_path.name}_private.xml'
    private.write_text(f'<!-- SECRET --> {MJCF}')
    (tmp_path / 'link.xml').symlink_to(private)
    (tmp_path / 'textured.xml').write_text(
        f'<mujoco><asset><texture name="t" type="2d" file="../{private.name}" content_type='
        '"image/ktx"/></asset><worldbody><body><geom size="1"/></body></worldbody></mujoco>')
    request_ = {key: text.replace('SECRET', private.name if '..' in text else str(private))
                for key, text in {'text': '', **request_}.items()}
    result = standard.spawn(**request_).result
    assert result.result == SpawnCode.RESOURCE_PARSE_ERROR
    assert 'must not' in result.error_message and '\n' not in result.error_message
    assert standard.entities().entities == ['robot0_base', 'cube']


@pytest.mark.parametrize('uri', ['http://[', 'file://elsewhere/a.xml', 'package://a/b.xml'])
def test_a_uri_of_another_kind_is_rejected(standard, uri):
    result = standard.spawn('', uri=uri).result
    assert result.result == SpawnCode.UNSUPPORTED_FORMAT and "uri '" in result.error_message


@pytest.mark.full
def test_a_mesh_of_a_file_is_in_the_archive(standard, tmp_path):
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    text = ''.join(f'v {x} {y} {z}\n' for x, y, z in corners) + (
        'f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n')
    (tmp_path / 'm.obj').write_text(text)
    (tmp_path / 'can.xml').write_text(
        '<mujoco><asset><mesh name="m" file="m.obj" scale="0.1 0.1 0.1"/></asset><worldbody>'
        '<body name="can"><geom type="mesh" mesh="m"/></body></worldbody></mujoco>')
    assert standard.spawn('', uri='can.xml').entity_name == 'can'
    (tmp_path / 'm.obj').unlink()
    assert standard.spawn(BALL).entity_name == 'ball'
    world = standard.world.with_objects(standard.simulation.plan.objects)
    with zipfile.ZipFile(io.BytesIO(world.to_archive())) as archive:
        packed = [archive.read(name).decode() for name in archive.namelist() if 'obj' in name]
    assert packed == [text]


def test_object_in_another_frame_is_rejected(standard):
    result = standard.spawn(BALL, frame='table').result
    assert result.result == UNSUPPORTED and "write 'world'" in result.error_message


def test_what_is_no_object_cannot_be_deleted(standard):
    code, text = standard.code('delete_entity', entity='robot0_base')
    assert code == FAILED and 'a robot that was there at the' in text
    assert standard.code('delete_entity', entity='sphere')[0] == NOT_FOUND
