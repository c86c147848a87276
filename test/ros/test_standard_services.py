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

from geometry_msgs.msg import Accel, Point, Pose, PoseStamped, Twist
import numpy as np
import pytest
from std_msgs.msg import Header

from manip_sim.errors import DivergenceError
from manip_sim.interface.composition import Composition
from manip_sim.models import compose
from manip_sim.models.user_files import AllowedRoots
from manip_sim.physics import object_spawning
from manip_sim.ros import spawning_services
from manip_sim.ros.feature import NodeContext
from manip_sim.ros.spawning_services import (
    BoundsType, Category, FeatureCode, LoadCode, ResultCode, ScopeCode, SetEntityCode,
    SetStateCode, SpawnAllCode, SpawnCode, SpawningServices, StandardTypes, StateCode, TagsMode,
    WorldCode)
from manip_sim.ros.standard_services import EntityServices, SimulationInterfaces, WorldServices
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import Simulation

OK, FAILED = ResultCode.RESULT_OK, ResultCode.RESULT_OPERATION_FAILED
UNSUPPORTED, NOT_FOUND = ResultCode.RESULT_FEATURE_UNSUPPORTED, ResultCode.RESULT_NOT_FOUND
STOPPED, PLAYING, PAUSED, NO_WORLD = StateCode
PERIOD_NS = 10_000_000
BALL = '{name: ball, shape: sphere, size: 0.1, mass: 0.2}'
MJCF = ('<mujoco><worldbody><body name="can"><freejoint/>'
        '<geom size="0.03" mass="0.1"/></body></worldbody></mujoco>')
OF_MESH = ('<mujoco><asset><mesh name="m" file="{}"/></asset><worldbody><body name="can">'
           '<geom type="mesh" mesh="m" mass="1"/></body></worldbody></mujoco>')
SERVICES = (
    'GetSimulatorFeatures', 'GetSimulationState', 'SetSimulationState', 'StepSimulation',
    'ResetSimulation', 'GetEntities', 'GetEntitiesStates', 'GetEntityInfo', 'SetEntityInfo',
    'GetEntityBounds', 'GetEntityState', 'SetEntityState', 'SpawnEntity', 'SpawnEntities',
    'DeleteEntity', 'GetSpawnables', 'GetNamedPoses', 'GetNamedPoseBounds', 'LoadWorld',
    'UnloadWorld', 'GetCurrentWorld', 'GetAvailableWorlds')


def state_message():
    return Plain(header=Header(), pose=Pose(), twist=Twist(), acceleration=Accel())


def spawn_request(text, uri='', name='', allow_renaming=False, namespace='', frame='', w=1.0,
                  height=1.0):
    pose = PoseStamped(header=Header(frame_id=frame))
    pose.pose.position.z, pose.pose.orientation.w = height, w
    return {'name': name, 'allow_renaming': allow_renaming, 'uri': str(uri),
            'resource_string': text, 'entity_namespace': namespace, 'initial_pose': pose}


TYPES = StandardTypes(Plain(**{name: name for name in SERVICES}),
                      Plain(EntityState=state_message, SpawnResult=lambda: Plain(
                          result=Plain(result=0, error_message=''), entity_name=''),
                          WorldResource=lambda: world_message(), NamedPose=lambda name: Plain(
                              name=name, description='', tags=[], pose=Pose()),
                          Spawnable=lambda description: Plain(
                              description=description, entity_resource=Plain(
                                  uri='', resource_string=''))), None)


def world_message():
    return Plain(name='', description='', tags=[],
                 world_resource=Plain(uri='', resource_string=''))


class Standard:
    """A simulation with the services, called as the executor calls them."""

    executor = None

    def __init__(self, folder):
        self.world = compose('Panda', arena='table', cube=True)
        self.simulation = Simulation(self.world)
        self.thread = SimulationThread(self.simulation, steps=5, stepping='free', paused=True)
        self.services, self.groups, self.followed = {}, {}, []
        self.parameters = {'task': '', 'cameras': ['']}
        context = NodeContext(
            node=self, simulation=self.simulation, thread=self.thread, robots={}, parameters=Plain(
                value=self.parameters.get),
            log=None, frame_prefix='', inbox=None, publishing=None, table=[],
            composition=Composition([], self.world, 5), features=[
                Plain(world_changed=lambda: self.followed.append(self.simulation))])
        spawning = SpawningServices(context, AllowedRoots([folder], 'spawn_roots'), TYPES)
        states = SimulationInterfaces(context, TYPES, spawning)
        self.entity_services = EntityServices(context, TYPES)
        WorldServices(context, states, TYPES, spawning)
        self.thread.start()

    def create_service(self, service_type, name, callback, callback_group=None):
        self.services[name] = service_type, callback
        self.groups[name] = callback_group

    def call(self, service, /, **request):
        """Return the response to a request."""
        response = Plain(result=Plain(result=0, error_message=''), state=state_message(),
                         features=Plain(), entities=None, entity_name='', states=None,
                         info=Plain(category=Plain(category=None), description='', tags=None),
                         bounds=Plain(type=0, points=[]), results=None, world=world_message())
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

    def entities(self, filter_='', categories=(), tags=(), mode=TagsMode.FILTER_MODE_ANY,
                 bounds=BoundsType.TYPE_EMPTY, points=(), service='get_entities'):
        return self.call(service, filters=Plain(
            filter=filter_, categories=[Plain(category=int(c)) for c in categories],
            tags=Plain(tags=list(tags), filter_mode=int(mode)), bounds=Plain(
                type=int(bounds), points=[Point(**dict(zip('xyz', map(float, p))))
                                          for p in points])))

    def set_info(self, name, category=Category.CATEGORY_OBJECT, description='', tags=()):
        return self.code('set_entity_info', entity=name, info=Plain(
            category=Plain(category=int(category)), description=description, tags=list(tags)))

    def info(self, name):
        info = self.call('get_entity_info', entity=name).info
        return info.category.category, info.description, info.tags

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
        for kind in SERVICES}


def test_a_request_for_many_steps_holds_up_no_other(standard):
    step = standard.groups.pop('~/step_simulation')
    assert step is not None and step not in standard.groups.values()


def test_features_are_numbers_and_formats_are_told(standard):
    features = standard.call('get_simulator_features').features
    assert {type(number) for number in features.features} == {int}
    assert set(features.features) == set(FeatureCode) - {FeatureCode.STEP_SIMULATION_ACTION}
    assert features.spawn_formats == ['mjcf', 'urdf', 'yaml']
    assert 'control period' in features.custom_info


def test_numbers_are_those_of_version_2_1_of_the_package():
    # Of its messages Result, SimulatorFeatures, SpawnResult, EntityCategory, SimulationState,
    # Bounds, and of its services SetSimulationState, SetEntityState, ResetSimulation.
    for codes, numbers in {
            SpawnAllCode: [150], LoadCode: [101, 102], WorldCode: [101],
            ResultCode: [0, 1, 2, 3, 4], SetStateCode: [101, 102], SetEntityCode: [101],
            SpawnCode: [*range(101, 110)], StateCode: [0, 1, 2, 4],
            ScopeCode: [0, 1, 2, 4, 255], Category: [0, 1, 2, 4, 5], BoundsType: [0, 1, 2, 3],
            TagsMode: [0, 1], FeatureCode: [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 20,
                                            22, 23, 24, 25, 26, 31, 32, 33, 40, 43, 44, 45,
                                            50]}.items():
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


@pytest.mark.parametrize(('scope', 'left', 'time'), [
    (ScopeCode.SCOPE_DEFAULT, 0, 1), (ScopeCode.SCOPE_ALL, 0, 1), (ScopeCode.SCOPE_STATE, 2, 6),
    (ScopeCode.SCOPE_STATE | ScopeCode.SCOPE_TIME, 2, 1), (ScopeCode.SCOPE_SPAWNED, 0, 5),
    (ScopeCode.SCOPE_STATE | ScopeCode.SCOPE_SPAWNED, 0, 6),
    (ScopeCode.SCOPE_STATE | ScopeCode.SCOPE_TIME | ScopeCode.SCOPE_SPAWNED, 0, 1)])
def test_a_reset_of_spawned_entities_removes_them_and_no_others(standard, scope, left, time):
    standard.spawn(BALL)
    standard.spawn(BALL, name='second')
    standard.place(position=(0.1, 0.2, 1.5))
    standard.code('step_simulation', steps=4)
    height = standard.entity().state.pose.position.z
    assert standard.code('reset_simulation', scope=int(scope)) == (OK, '')
    assert sorted(standard.entities().entities) == sorted(
        ['robot0_base', 'cube', *['ball', 'second'][:left]])
    assert standard.simulation.time_ns == PERIOD_NS * time
    assert (standard.entity().state.pose.position.z == height) is (
        scope == ScopeCode.SCOPE_SPAWNED)
    # They can come again, and the objects of the start are known for such.
    assert standard.spawn(BALL, name='again').entity_name == 'again'
    assert standard.code('reset_simulation', scope=4) == (OK, '')
    assert standard.entities().entities == ['robot0_base', 'cube']


def test_a_stopped_simulation_has_nothing_that_was_spawned(standard):
    standard.spawn(BALL)
    standard.set_state(PLAYING)
    assert standard.set_state(STOPPED) == (OK, '')
    assert standard.entities().entities == ['robot0_base', 'cube']
    assert standard.state() == STOPPED and standard.simulation.time_ns == PERIOD_NS


def test_objects_of_a_world_that_was_loaded_are_not_spawned_ones(standard):
    load(standard, 'arena:empty')
    standard.spawn(BALL, name='cube')
    load(standard, 'arena:table')
    assert standard.code('reset_simulation', scope=0) == (OK, '')
    assert standard.entities().entities == ['robot0_base', 'cube']


@pytest.mark.parametrize('scope', [ScopeCode.SCOPE_TIME, 5, 8, 64])
def test_scope_that_does_not_work_is_rejected(standard, scope):
    code, text = standard.code('reset_simulation', scope=int(scope))
    assert code == UNSUPPORTED and f'scope {int(scope)} is not supported' in text


def test_simulation_that_diverged_can_be_reset_only(standard):
    standard.spawn(BALL)
    standard.explode()
    for code, text in (
            standard.set_state(PLAYING), standard.code('step_simulation', steps=1),
            standard.place(),
            standard.code('spawn_entity', **spawn_request(BALL, name='second'))):
        assert code in (SetStateCode.STATE_TRANSITION_ERROR, FAILED,
                        ResultCode.RESULT_INCORRECT_STATE)
        assert text.endswith('reset it first')
    rejected = standard.code('reset_simulation', scope=4)
    assert rejected[0] == ResultCode.RESULT_INCORRECT_STATE
    assert rejected[1].endswith('reset it first')
    assert standard.code('reset_simulation', scope=0) == (OK, '')
    assert standard.entities().entities == ['robot0_base', 'cube']
    assert standard.set_state(PLAYING) == (OK, '')


def test_entities_are_found_by_name_and_category(standard):
    assert standard.entities().entities == ['robot0_base', 'cube']
    assert standard.entities('^c').entities == ['cube']
    assert standard.entities(categories=[Category.CATEGORY_ROBOT]).entities == ['robot0_base']
    assert standard.entities(categories=[Category.CATEGORY_OBJECT]).entities == ['cube']
    assert standard.entities(categories=[2]).entities == []


@pytest.mark.parametrize(('filters', 'code', 'text'), [
    ({'filter_': '('}, FAILED, "filter '('"),
    ({'tags': ['red'], 'mode': 2}, UNSUPPORTED, 'filter_mode 2 is not supported'),
    ({'bounds': BoundsType.TYPE_CONVEX_HULL}, UNSUPPORTED, 'bounds of type 2 are not supported'),
    ({'bounds': 9}, UNSUPPORTED, 'bounds of type 9 are not supported'),
    ({'bounds': BoundsType.TYPE_BOX, 'points': [(0, 0, 0)]}, FAILED, 'has 2 points, got 1'),
    ({'bounds': BoundsType.TYPE_BOX, 'points': [(0.0, 0.0, math.nan), (0.0, 0.0, 0.0)]}, FAILED,
     'the numbers of a box must be finite'),
    ({'bounds': BoundsType.TYPE_SPHERE, 'points': [(0.0, 0.0, 0.0), (math.inf, 0.0, 0.0)]},
     FAILED, 'the numbers of a sphere must be finite'),
    ({'bounds': BoundsType.TYPE_SPHERE, 'points': [(0.0, 0.0, 0.0), (-0.1, 0.0, 0.0)]},
     FAILED, 'must not be negative, got -0.1')])
@pytest.mark.parametrize('service', ['get_entities', 'get_entities_states'])
def test_filter_that_does_not_work_is_rejected(standard, filters, code, text, service):
    result = standard.entities(**filters, service=service).result
    assert result.result == code and text in result.error_message


@pytest.mark.parametrize(('bounds', 'points', 'found'), [
    # The cube of 5 cm stands with its middle at (0, 0, 0.825).
    ('BOX', [(0.02, 0.02, 0.9), (0.0, 0.0, 0.86)], []),
    ('BOX', [(0.02, 0.02, 0.9), (0.0, 0.0, 0.84)], ['cube']),
    ('BOX', [(0.0, 0.0, 0.84), (0.02, 0.02, 0.9)], ['cube']),
    ('BOX', [(5.0, 5.0, 5.0), (-5.0, -5.0, -5.0)], ['robot0_base', 'cube']),
    ('SPHERE', [(0.125, 0.0, 0.825), (0.09, math.nan, math.nan)], []),
    ('SPHERE', [(0.125, 0.0, 0.825), (0.11, math.nan, math.nan)], ['cube']),
    ('SPHERE', [(0.0, 0.0, 0.825), (0.0, 0.0, 0.0)], ['cube'])])
def test_entities_are_found_where_their_shapes_are(standard, bounds, points, found):
    response = standard.entities(bounds=BoundsType[f'TYPE_{bounds}'], points=points)
    assert (response.result.result, response.entities) == (OK, found)


def test_states_of_all_entities_are_of_one_instant(standard):
    standard.place(position=(0.0, 0.1, 3.0), linear=(0.5, 0.0, 1.0))
    standard.code('step_simulation', steps=3)
    response = standard.entities(service='get_entities_states')
    assert response.entities == ['robot0_base', 'cube']
    assert response.states == [standard.entity(name).state for name in response.entities]
    assert standard.entities('^c', service='get_entities_states').entities == ['cube']
    nothing = standard.entities('x', service='get_entities_states')
    assert (nothing.result.result, nothing.entities, nothing.states) == (OK, [], [])


def test_what_is_said_about_an_entity_is_kept_and_found_until_it_goes(standard):
    assert standard.info('cube') == (Category.CATEGORY_OBJECT, '', [])
    assert standard.info('robot0_base') == (Category.CATEGORY_ROBOT, '', [])
    assert standard.spawn(BALL).entity_name == 'ball'
    assert standard.set_info('ball', Category.CATEGORY_DYNAMIC_OBJECT, 'it rolls',
                             ['red', 'round']) == (OK, '')
    assert standard.set_info('cube', tags=['red']) == (OK, '')
    assert standard.info('ball') == (Category.CATEGORY_DYNAMIC_OBJECT, 'it rolls',
                                     ['red', 'round'])
    assert standard.entities(categories=[Category.CATEGORY_OBJECT]).entities == ['cube']
    assert standard.entities(categories=[Category.CATEGORY_DYNAMIC_OBJECT]).entities == ['ball']
    for tags, mode, found in ((['red'], 'ANY', ['cube', 'ball']), (['blue'], 'ANY', []),
                              (['round', 'blue'], 'ANY', ['ball']),
                              (['round', 'blue'], 'ALL', []), (['red', 'round'], 'ALL', ['ball'])):
        assert standard.entities(tags=tags, mode=TagsMode[f'FILTER_MODE_{mode}']).entities == found
    assert standard.code('delete_entity', entity='ball') == (OK, '')
    standard.entity_services.forget_gone()
    assert standard.spawn(BALL).entity_name == 'ball'
    assert standard.info('ball') == (Category.CATEGORY_OBJECT, '', [])
    assert standard.info('cube')[2] == ['red']


@pytest.mark.parametrize(('fields', 'code', 'text'), [
    ({'name': 'sphere'}, NOT_FOUND, "'sphere'"), ({'category': 3}, FAILED, 'no category 3'),
    ({'description': 'x' * 10_001}, FAILED, '10000 characters'),
    ({'tags': ['x'] * 101}, FAILED, '100 tags'), ({'tags': ['x' * 201]}, FAILED, '200 char')])
def test_what_cannot_be_said_about_an_entity_is_rejected(standard, fields, code, text):
    found, told = standard.set_info(**{'name': 'cube', **fields})
    assert found == code and text in told
    assert standard.info('cube') == (Category.CATEGORY_OBJECT, '', [])


def test_bounds_are_a_box_in_the_frame_of_the_entity(standard):
    assert standard.place(position=(0.3, 0.1, 3.0)) == (OK, '')
    bounds = standard.call('get_entity_bounds', entity='cube').bounds
    assert bounds.type == BoundsType.TYPE_BOX
    corners = [[point.x, point.y, point.z] for point in bounds.points]
    np.testing.assert_allclose(corners, [[0.025] * 3, [-0.025] * 3], atol=1e-12)
    robot = standard.call('get_entity_bounds', entity='robot0_base').bounds
    high, low = robot.points
    assert high.z > 0.5 and low.x < 0.0 < high.x
    for service in ('get_entity_bounds', 'get_entity_info'):
        assert standard.code(service, entity='sphere')[0] == NOT_FOUND


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
    ({'frame': 'a\nb'}, UNSUPPORTED, "frame_id 'a\\nb' is not supported"),
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
            ({'text': BALL.replace('name: ball, ', ''), 'allow_renaming': True}, 'object'),
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
    ({'text': BALL.replace('name: ball, ', '')}, 'NAME_INVALID', 'it has no name'),
    ({'text': ' '}, 'NO_RESOURCE', 'give a file (uri) or a text'),
    ({'text': '<mujoco>'}, 'RESOURCE_PARSE_ERROR', ''),
    ({'text': '{shape: sfere}'}, 'RESOURCE_PARSE_ERROR', 'sphere'),
    ({'text': BALL, 'w': 0.0}, 'INVALID_POSE', ''),
    ({'uri': 'https://example.com/can.xml'}, 'UNSUPPORTED_FORMAT', 'only paths and file://'),
    ({'uri': '/tmp/can.sdf'}, 'UNSUPPORTED_FORMAT', 'only MJCF (.xml, .mjcf), URDF and YAML'),
    ({'uri': 'nowhere/can.xml'}, 'RESOURCE_PARSE_ERROR', '/nowhere/can.xml'),
    ({'text': OF_MESH.format('nowhere.obj')}, 'MISSING_ASSETS', 'nowhere.obj'),
    ({'text': OF_MESH.format('can.dae'), 'uri': 'can.xml'}, 'UNSUPPORTED_ASSETS', '.dae')])
def test_object_that_cannot_come_is_rejected(standard, tmp_path, request_, code, text):
    if 'uri' in request_ and 'text' in request_:
        (tmp_path / 'can.dae').touch()
        (tmp_path / request_['uri']).write_text(request_['text'])
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
    assert result.result in (SpawnCode.RESOURCE_PARSE_ERROR, SpawnCode.MISSING_ASSETS)
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


def requests(*fields):
    return [Plain(**spawn_request(**one)) for one in fields]


def test_several_entities_come_at_once_each_with_its_result(standard):
    response = standard.call('spawn_entities', spawn_requests=requests(
        {'text': BALL}, {'text': MJCF}))
    assert (response.result.result, [one.entity_name for one in response.results]) == (
        OK, ['ball', 'can'])
    assert standard.call('spawn_entities', spawn_requests=[]).result.result == OK
    response = standard.call('spawn_entities', spawn_requests=requests(
        {'text': BALL}, {'text': BALL, 'allow_renaming': True}, {'text': ''},
        {'text': BALL, 'height': math.nan}))
    assert response.result.result == SpawnAllCode.ENTITIES_SPAWN_FAILED
    assert response.result.error_message == (
        "3 of 4 failed, the first: there is an entity 'ball' already")
    assert [one.result.result for one in response.results] == [
        SpawnCode.NAME_NOT_UNIQUE, OK, SpawnCode.NO_RESOURCE, SpawnCode.INVALID_POSE]
    assert standard.entities().entities == ['robot0_base', 'cube', 'ball', 'can', 'ball_1']


def test_many_objects_are_compiled_at_once_but_for_those_that_the_world_cannot_have(
        standard, monkeypatch):
    compiled = []

    def plan_with(plan, *items):
        compiled.append(len(items))
        return object_spawning.plan_with(plan, *items)
    monkeypatch.setattr(spawning_services, 'plan_with', plan_with)
    many = [{'text': BALL, 'allow_renaming': True} for _ in range(20)]
    response = standard.call('spawn_entities', spawn_requests=requests(*many))
    assert response.result.result == OK and compiled == [20]
    assert [one.entity_name for one in response.results] == [
        'ball', *(f'ball_{number}' for number in range(1, 20))]
    # The lid of the second one would have the name of the first one.
    lid = MJCF.replace('</body>', '<body name="lid"><geom size="0.01"/></body></body>')
    del compiled[:]
    response = standard.call('spawn_entities', spawn_requests=requests(
        {'text': MJCF, 'name': 'can_lid'}, {'text': lid}, *many[:6]))
    assert [one.result.result for one in response.results] == [
        OK, SpawnCode.RESOURCE_PARSE_ERROR] + [OK] * 6
    assert "'can_lid'" in response.result.error_message
    assert compiled == [8, 4, 2, 1, 1, 2, 4]
    assert standard.entities().entities[-7:] == [
        'can_lid', *(f'ball_{number}' for number in range(20, 26))]


def load(standard, uri='', text=''):
    return standard.call('load_world', world_resource=Plain(uri=uri, resource_string=text))


def test_a_world_is_loaded_in_place_of_another_with_its_objects_and_is_stopped(standard):
    assert standard.call('get_current_world').world.name == 'table'
    standard.spawn(BALL)
    standard.code('step_simulation', steps=3)
    standard.set_state(PLAYING)
    response = load(standard, 'arena:bins')
    assert (response.result.result, response.world.name) == (OK, 'bins'), response.result
    assert response.world.world_resource.uri == 'arena:bins'
    assert standard.state() == STOPPED and standard.simulation.time_ns == PERIOD_NS
    assert standard.entities().entities == ['robot0_base']
    assert standard.call('get_current_world').world.name == 'bins'
    assert len(standard.followed) == 3
    # It is used as any other.
    assert standard.set_state(PAUSED) == (OK, '')
    assert standard.spawn(BALL).entity_name == 'ball'
    assert standard.code('step_simulation', steps=3) == (OK, '')
    assert load(standard, 'arena:table').result.result == OK
    assert standard.entities().entities == ['robot0_base', 'cube']
    alone = Simulation(compose('Panda', arena='table'))
    assert standard.simulation.model.nq == alone.model.nq
    np.testing.assert_allclose(standard.simulation.data.qpos, alone.data.qpos, atol=1e-3)


@pytest.mark.parametrize(('arguments', 'code', 'text'), [
    ({}, LoadCode.NO_RESOURCE, 'give the uri'),
    ({'text': MJCF}, UNSUPPORTED, 'from a text'),
    ({'uri': '/tmp/world.sdf'}, LoadCode.UNSUPPORTED_FORMAT, 'such as arena:table'),
    ({'uri': 'arena:tabel'}, NOT_FOUND, "did you mean 'table'"),
    ({'uri': 'arena:../secret.xml'}, NOT_FOUND, 'secret')])
def test_a_world_that_cannot_be_loaded_leaves_the_present_one(standard, arguments, code, text):
    before = standard.entity().state
    result = load(standard, **arguments).result
    assert result.result == code and text in result.error_message
    assert standard.entity().state == before and standard.state() == PAUSED


def test_the_world_of_a_task_stays(standard):
    standard.parameters['task'] = 'lift'
    result = load(standard, 'arena:bins').result
    assert result.result == FAILED and 'belongs to a task' in result.error_message
    assert standard.call('get_current_world').world.name == 'table'


def test_without_a_world_nothing_runs_until_one_is_loaded(standard):
    assert standard.code('unload_world') == (OK, '')
    assert standard.state() == NO_WORLD
    for code, text in (standard.set_state(PLAYING), standard.code('step_simulation', steps=1),
                       standard.code('reset_simulation', scope=0)):
        assert (code, text) == (ResultCode.RESULT_INCORRECT_STATE,
                                'no world is loaded: load one first')
    assert standard.code('unload_world')[0] == WorldCode.NO_WORLD_LOADED
    assert standard.code('get_current_world')[0] == WorldCode.NO_WORLD_LOADED
    assert load(standard, 'arena:table').result.result == OK
    assert standard.state() == STOPPED
    assert standard.set_state(PLAYING) == (OK, '')


def worlds(standard, sources=(), go_on=False, tags=()):
    return standard.call('get_available_worlds', additional_sources=list(sources), filter=Plain(
        tags=list(tags), filter_mode=0), offline_only=True, continue_on_error=go_on)


def test_the_worlds_that_can_be_loaded_are_the_arenas(standard):
    response = worlds(standard)
    assert response.result.result == OK
    found = {world.name: world for world in response.worlds}
    assert found.keys() >= {'empty', 'table', 'bins', 'drawer'}
    assert found['table'].world_resource.uri == 'arena:table'
    assert found['table'].description.startswith('A table in front of the robot')
    assert worlds(standard, tags=['indoor']).result.result == UNSUPPORTED
    rejected = worlds(standard, ['/srv/worlds']).result
    assert rejected.result == FAILED and "cannot search '/srv/worlds'" in rejected.error_message
    response = worlds(standard, ['/srv/worlds'], go_on=True)
    assert response.result.result == OK and len(response.worlds) == len(found)
    assert "cannot search '/srv/worlds'" in response.result.error_message


def test_named_poses_are_the_sites_of_the_arena(standard):
    def poses(tags=(), mode=0):
        return standard.call('get_named_poses', tags=Plain(tags=list(tags), filter_mode=mode))
    (pose,) = poses().poses
    assert pose.name == 'table_top'
    assert (pose.pose.position.x, pose.pose.position.z) == pytest.approx((0.0, 0.8))
    assert pose.pose.orientation.w == pytest.approx(1.0)
    assert poses(tags=['spawn']).poses == []
    assert poses(mode=5).result.result == UNSUPPORTED
    response = standard.call('get_named_pose_bounds', name='table_top')
    assert (response.result.result, response.bounds.type) == (OK, BoundsType.TYPE_EMPTY)
    assert standard.code('get_named_pose_bounds', name='table')[0] == NOT_FOUND
    load(standard, 'arena:bins')
    assert [pose.name for pose in poses().poses] == ['bin1', 'bin2']


def test_what_can_be_spawned_are_files_below_the_roots_and_robots(standard, tmp_path):
    (tmp_path / 'more').mkdir()
    (tmp_path / 'more' / 'can.xml').write_text(MJCF)
    (tmp_path / 'notes.txt').write_text('')
    (tmp_path / 'link.xml').symlink_to('/etc/passwd')
    response = standard.call('get_spawnables', sources=[])
    assert response.result.result == OK and response.result.error_message == ''
    resources = [spawnable.entity_resource for spawnable in response.spawnables]
    (uri,) = [resource.uri for resource in resources if resource.uri]
    assert uri == (tmp_path / 'more' / 'can.xml').as_uri()
    assert standard.spawn('', uri=uri).entity_name == 'can'
    assert '{robot: Panda}' in [resource.resource_string for resource in resources]
    response = standard.call('get_spawnables', sources=[str(tmp_path / 'more'), '/etc', 'x'])
    assert response.result.result == OK and len(response.spawnables) == len(resources)
    assert response.result.error_message == "not below spawn_roots: '/etc', 'x'"
