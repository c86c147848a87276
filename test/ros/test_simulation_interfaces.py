# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The services of the package simulation_interfaces, versions 1 and 2."""

import math
from pathlib import Path
import re

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Twist, Vector3
import numpy as np
import pytest
from rclpy.action import ActionClient
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

pytest.importorskip('simulation_interfaces',
                    reason='the optional package simulation_interfaces is not installed')

from simulation_interfaces import msg as messages  # noqa: E402
from simulation_interfaces import srv  # noqa: E402
from simulation_interfaces.action import SimulateSteps  # noqa: E402
from simulation_interfaces.msg import (  # noqa: E402
    Bounds, EntityCategory, EntityFilters, EntityInfo, Result, SimulationState, SimulatorFeatures,
    TagsFilter)
from simulation_interfaces.srv import (  # noqa: E402
    DeleteEntity, GetEntities, GetEntitiesStates, GetEntityBounds, GetEntityInfo, GetEntityState,
    GetSimulationState, GetSimulatorFeatures, ResetSimulation, SetEntityInfo, SetEntityState,
    SetSimulationState, SpawnEntity, StepSimulation)

from manip_sim.ros import spawning_services as codes  # noqa: E402

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
STOPPED, PLAYING, PAUSED = (
    SimulationState.STATE_STOPPED, SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED)
OK, UNSUPPORTED, NOT_FOUND = (
    Result.RESULT_OK, Result.RESULT_FEATURE_UNSUPPORTED, Result.RESULT_NOT_FOUND)
FAILED, INCORRECT_STATE = Result.RESULT_OPERATION_FAILED, Result.RESULT_INCORRECT_STATE
INVALID_POSE = SetEntityState.Response.INVALID_POSE
HAS_FLAGS = 'set_pose' in SetEntityState.Request.get_fields_and_field_types()
NAN = math.nan
#: Since version 2 and 1.1.
HAS_WORLDS = hasattr(srv, 'LoadWorld')
HAS_SPAWN_ENTITIES = hasattr(srv, 'SpawnEntities')
#: The first instant is one control period after zero, which as a stamp means none.
FIRST_NS = 10_000_000


def get_state(client):
    response = client.call(GetSimulationState, 'manip_sim/get_simulation_state')
    assert response.result.result == OK
    return response.state.state


def set_state(client, state):
    request = SetSimulationState.Request(state=SimulationState(state=state))
    return client.call(SetSimulationState, 'manip_sim/set_simulation_state', request).result


def step(client, steps):
    request = StepSimulation.Request(steps=steps)
    return client.call(StepSimulation, 'manip_sim/step_simulation', request).result


def reset(client, scope):
    request = ResetSimulation.Request(scope=scope)
    return client.call(ResetSimulation, 'manip_sim/reset_simulation', request).result


def entities(client, **filters):
    request = GetEntities.Request(filters=EntityFilters(**filters))
    return client.call(GetEntities, 'manip_sim/get_entities', request)


def entity_state(client, name):
    request = GetEntityState.Request(entity=name)
    return client.call(GetEntityState, 'manip_sim/get_entity_state', request)


def place(client, name='cube', frame='', position=(0.0, 0.0, 1.5),
          orientation=(0.0, 0.0, 0.0, 1.0), linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0),
          **flags):
    request = SetEntityState.Request(entity=name)
    request.state.header.frame_id = frame
    request.state.pose = Pose(position=filled(Point, position),
                              orientation=filled(Quaternion, orientation))
    request.state.twist = Twist(linear=filled(Vector3, linear), angular=filled(Vector3, angular))
    if HAS_FLAGS:
        request.set_pose, request.set_twist = True, True
    for flag, value in flags.items():
        setattr(request, flag, value)
    return client.call(SetEntityState, 'manip_sim/set_entity_state', request).result


def filled(message_type, values):
    return message_type(**dict(zip('xyzw', values)))


def numbers(message):
    return [getattr(message, field) for field in message.get_fields_and_field_types()]


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


@pytest.mark.parametrize(('ours', 'theirs'), [
    (codes.ResultCode, Result), (codes.SetStateCode, SetSimulationState.Response),
    (codes.SetEntityCode, SetEntityState.Response), (codes.SpawnCode, SpawnEntity.Response),
    (codes.StateCode, SimulationState), (codes.ScopeCode, ResetSimulation.Request),
    (codes.Category, EntityCategory), (codes.BoundsType, Bounds),
    (codes.TagsMode, TagsFilter), (codes.FeatureCode, SimulatorFeatures), *(
        [(codes.LoadCode, srv.LoadWorld.Response), (codes.WorldCode, srv.UnloadWorld.Response),
         (codes.WorldCode, srv.GetCurrentWorld.Response)] if HAS_WORLDS else []), *(
        [(codes.SpawnAllCode, srv.SpawnEntities.Response)] if HAS_SPAWN_ENTITIES else [])],
    ids=lambda kind: kind.__name__)
def test_the_numbers_are_those_of_the_package(ours, theirs):
    assert {code.name: code.value for code in ours} == {
        code.name: getattr(theirs, code.name, code.value) for code in ours}
    # Older versions lack some.
    assert any(hasattr(theirs, code.name) for code in ours)


def test_the_features_are_those_that_work(serve, client):
    serve(start_paused=True)
    features = client.call(
        GetSimulatorFeatures, 'manip_sim/get_simulator_features').features
    assert set(features.features) == {
        SimulatorFeatures.ENTITY_CATEGORIES, SimulatorFeatures.ENTITY_STATE_GETTING,
        SimulatorFeatures.ENTITY_STATE_SETTING, SimulatorFeatures.SIMULATION_RESET,
        SimulatorFeatures.SIMULATION_RESET_STATE, SimulatorFeatures.SIMULATION_RESET_SPAWNED,
        SimulatorFeatures.SIMULATION_STATE_GETTING,
        SimulatorFeatures.SIMULATION_STATE_SETTING, SimulatorFeatures.SIMULATION_STATE_PAUSE,
        SimulatorFeatures.STEP_SIMULATION_SINGLE, SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
        SimulatorFeatures.SPAWNING, SimulatorFeatures.SPAWNING_RESOURCE_STRING,
        SimulatorFeatures.DELETING, SimulatorFeatures.ENTITY_TAGS,
        SimulatorFeatures.ENTITY_BOUNDS, SimulatorFeatures.ENTITY_BOUNDS_BOX,
        SimulatorFeatures.ENTITY_INFO_GETTING, SimulatorFeatures.ENTITY_INFO_SETTING,
        SimulatorFeatures.STEP_SIMULATION_ACTION, SimulatorFeatures.NAMED_POSES,
        SimulatorFeatures.POSE_BOUNDS, SimulatorFeatures.SPAWNABLES, *(
            [SimulatorFeatures.WORLD_LOADING, SimulatorFeatures.WORLD_UNLOADING,
             SimulatorFeatures.WORLD_INFO_GETTING, SimulatorFeatures.AVAILABLE_WORLDS]
            if HAS_WORLDS else []), *(
            [SimulatorFeatures.SPAWNING_ENTITIES] if HAS_SPAWN_ENTITIES else [])}
    assert list(features.spawn_formats) == ['mjcf', 'urdf', 'yaml']
    assert 'control period' in features.custom_info


def test_the_services_are_documented_with_their_types(serve, client):
    node = serve()
    client.state()
    services = node.get_service_names_and_types_by_node('manip_sim', '/')
    found = {(name.replace('/manip_sim/', '~/'), kinds[0].replace('/srv/', '/'))
             for name, kinds in services if kinds[0].startswith('simulation_interfaces/srv/')}
    page = Path(__file__).resolve().parents[2] / 'docs' / 'reference' / 'services.md'
    documented = set(re.findall(r'^\| `(~/\w+)` \| (simulation_interfaces/\w+) \|',
                                page.read_text(), re.MULTILINE))
    # What an older version of the package does not have is not offered.
    assert found == {row for row in documented if hasattr(srv, row[1].partition('/')[2])}
    assert {kind.partition('/')[2] for _, kind in documented} >= {
        name for name in vars(srv) if name[0].isupper() and '_' not in name}
    assert client.node.count_services('/manip_sim/simulate_steps/_action/send_goal') == 1


def test_a_simulation_plays_is_paused_and_stopped(serve, client):
    serve()
    client.state()
    assert get_state(client) == PLAYING
    for state in (PAUSED, PLAYING, STOPPED, PAUSED, STOPPED, PLAYING):
        assert set_state(client, state).result == OK
        assert get_state(client) == state
        again = set_state(client, state)
        assert again.result == SetSimulationState.Response.ALREADY_IN_TARGET_STATE
        assert again.error_message


def test_pause_and_the_states_of_the_standard_are_one(serve, client):
    serve(start_paused=True)
    assert get_state(client) == PAUSED
    client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=False))
    assert get_state(client) == PLAYING
    assert set_state(client, STOPPED).result == OK
    assert client.call(Trigger, 'manip_sim/step').success
    assert get_state(client) == PAUSED


@pytest.mark.parametrize('state', [SimulationState.STATE_QUITTING, SimulationState.STATE_NO_WORLD,
                                   SimulationState.STATE_LOADING_WORLD, 77])
def test_a_state_that_cannot_be_set_is_rejected(state, serve, client):
    serve()
    rejected = set_state(client, state)
    assert rejected.result == UNSUPPORTED and str(state) in rejected.error_message
    assert get_state(client) == PLAYING


def test_stopped_is_at_the_start_of_time(serve, client):
    serve()
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
    client.spin_until(lambda: client.state().position[0] > 0.1)
    states, clocks = client.listen(JointState, 'joint_states'), client.listen(Clock, '/clock')
    assert set_state(client, STOPPED).result == OK
    client.spin_until(lambda: bool(states) and nanoseconds(states[-1].header.stamp) == FIRST_NS)
    client.spin_until(lambda: bool(clocks) and nanoseconds(clocks[-1].clock) == FIRST_NS)
    assert abs(states[-1].position[0]) < 1e-6
    rejected = step(client, 1)
    assert rejected.result == FAILED and 'pause it first' in rejected.error_message
    assert set_state(client, PAUSED).result == OK
    assert step(client, 1).result == OK
    client.spin_until(lambda: nanoseconds(states[-1].header.stamp) == FIRST_NS + 10_000_000)


@pytest.mark.parametrize('stepping', ['realtime', 'free', 'lockstep'])
def test_steps_are_control_periods_and_are_done_when_the_answer_comes(stepping, serve, client):
    node = serve(stepping=stepping, start_paused=True)
    states = client.listen(JointState, 'joint_states')
    for steps, time_ns in ((1, 10_000_000), (20, 210_000_000)):
        assert step(client, steps).result == OK
        assert node.simulation.time_ns == FIRST_NS + time_ns
    client.spin_until(lambda: nanoseconds(states[-1].header.stamp) == FIRST_NS + 210_000_000)
    assert get_state(client) == PAUSED


def test_steps_are_rejected_while_the_simulation_plays(serve, client):
    serve()
    rejected = step(client, 1)
    assert rejected.result == FAILED and 'pause it first' in rejected.error_message
    set_state(client, PAUSED)
    rejected = step(client, 0)
    assert rejected.result == FAILED and 'got 0' in rejected.error_message


def test_the_node_stays_responsive_while_it_makes_many_steps(serve, client):
    node = serve(start_paused=True)
    stepper = client.node.create_client(StepSimulation, 'manip_sim/step_simulation')
    client.spin_until(stepper.service_is_ready)
    future = stepper.call_async(StepSimulation.Request(steps=2**63))
    client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
    client.spin_until(lambda: node.simulation.time_ns > 10**9)
    assert client.state().position[0] > 0.01
    assert not future.done()
    client.call(SetBool, 'manip_sim/pause', SetBool.Request(data=False))
    client.spin_until(future.done)
    result = future.result().result
    assert result.result == FAILED and f'of {2**63} steps' in result.error_message


def test_the_node_ends_while_it_makes_many_steps(sim_process, client):
    started = sim_process('start_paused:=true')
    stepper = client.node.create_client(StepSimulation, 'manip_sim/step_simulation')
    client.spin_until(stepper.service_is_ready)
    clocks = client.listen(Clock, '/clock')
    stepper.call_async(StepSimulation.Request(steps=2**63))
    client.spin_until(lambda: len(clocks) > 100)
    started.terminate()
    _, errors = started.communicate(timeout=300.0)
    assert (started.returncode, 'Traceback' in errors) == (0, False)


@pytest.fixture
def action(client):
    """Return a function that sends a goal, and lists that are filled with feedback."""
    action = ActionClient(client.node, SimulateSteps, 'manip_sim/simulate_steps')

    def send(steps):
        seen = []
        client.spin_until(action.server_is_ready)
        sent = action.send_goal_async(SimulateSteps.Goal(steps=steps),
                                      feedback_callback=lambda m: seen.append(m.feedback))
        client.spin_until(sent.done)
        return sent.result(), seen
    yield send
    action.destroy()


def outcome(client, handle):
    result = handle.get_result_async()
    client.spin_until(result.done)
    return result.result().status, result.result().result.result


def test_the_action_makes_steps_with_feedback_after_each(sim_process, client, action):
    sim_process('start_paused:=true')
    clocks = client.listen(Clock, '/clock')
    # An ActionClient drops feedback that comes after the result.
    messages = client.listen(SimulateSteps.Impl.FeedbackMessage,
                             'manip_sim/simulate_steps/_action/feedback')
    handle, _ = action(5)
    status, result = outcome(client, handle)
    assert (status, result.result, result.error_message) == (
        GoalStatus.STATUS_SUCCEEDED, OK, '')
    client.spin_until(lambda: len(messages) == 5)
    assert [(m.feedback.completed_steps, m.feedback.remaining_steps) for m in messages] == [
        (n, 5 - n) for n in range(1, 6)]
    client.spin_until(lambda: nanoseconds(clocks[-1].clock) == FIRST_NS + 50_000_000)
    assert get_state(client) == PAUSED


def test_the_action_is_cancelled_between_two_steps_and_takes_one_goal(serve, client, action):
    node = serve(start_paused=True)
    handle, seen = action(2**63)
    client.spin_until(lambda: len(seen) > 3)
    assert not action(1)[0].accepted
    canceling = handle.cancel_goal_async()
    client.spin_until(canceling.done)
    status, result = outcome(client, handle)
    assert (status, result.result) == (GoalStatus.STATUS_CANCELED, FAILED)
    made = int(re.fullmatch(rf'canceled after (\d+) of {2**63} steps', result.error_message)[1])
    assert node.simulation.time_ns == FIRST_NS + made * 10_000_000
    assert outcome(client, action(1)[0])[0] == GoalStatus.STATUS_SUCCEEDED
    assert node.simulation.time_ns == FIRST_NS + (made + 1) * 10_000_000


@pytest.mark.parametrize(('steps', 'parameters', 'text'), [
    (0, {'start_paused': True}, 'steps must be 1 or more'), (3, {}, 'pause it first')])
def test_steps_of_the_action_that_cannot_be_made_abort_it(
        steps, parameters, text, serve, client, action):
    serve(**parameters)
    status, result = outcome(client, action(steps)[0])
    assert (status, result.result) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert text in result.error_message


def test_the_node_ends_while_the_action_makes_steps(sim_process, client, action):
    started = sim_process('start_paused:=true')
    _, seen = action(2**63)
    client.spin_until(lambda: len(seen) > 20)
    started.terminate()
    _, errors = started.communicate(timeout=300.0)
    assert (started.returncode, 'Traceback' in errors) == (0, False), errors


@pytest.mark.parametrize('scope, restarts', [
    (ResetSimulation.Request.SCOPE_DEFAULT, True), (ResetSimulation.Request.SCOPE_ALL, True),
    (ResetSimulation.Request.SCOPE_STATE, False),
    (ResetSimulation.Request.SCOPE_STATE | ResetSimulation.Request.SCOPE_TIME, True)])
def test_a_reset_puts_all_back_and_keeps_or_restarts_time(scope, restarts, serve, client):
    node = serve(arena='table', start_paused=True)
    start = numbers(entity_state(client, 'cube').state.pose.position)
    assert place(client, position=(0.1, 0.2, 1.5)).result == OK
    assert step(client, 10).result == OK
    assert reset(client, scope).result == OK
    assert node.simulation.time_ns == FIRST_NS + (0 if restarts else 110_000_000)
    np.testing.assert_array_equal(
        numbers(entity_state(client, 'cube').state.pose.position), start)
    assert get_state(client) == PAUSED


@pytest.mark.parametrize('scope', [ResetSimulation.Request.SCOPE_DEFAULT,
                                   ResetSimulation.Request.SCOPE_SPAWNED])
def test_a_reset_removes_what_was_spawned(scope, sim_process, client):
    sim_process('arena:=table')
    assert spawn(client).result.result == OK
    assert spawn(client, '{robot: UR5e, name: second}').result.result == OK
    client.spin_until(lambda: client.node.count_publishers('second/joint_states') == 1)
    assert reset(client, scope).result == OK
    assert entities(client).entities == ['robot0_base', 'cube']
    client.spin_until(lambda: client.node.count_publishers('second/joint_states') == 0
                      and client.node.count_publishers('objects/ball/pose') == 0)


@pytest.mark.parametrize('scope', [ResetSimulation.Request.SCOPE_TIME,
                                   ResetSimulation.Request.SCOPE_TIME
                                   | ResetSimulation.Request.SCOPE_SPAWNED, 64])
def test_a_scope_that_does_not_work_is_rejected(scope, serve, client):
    node = serve(start_paused=True)
    step(client, 1)
    rejected = reset(client, scope)
    assert rejected.result == UNSUPPORTED and f'scope {scope}' in rejected.error_message
    assert node.simulation.time_ns == FIRST_NS + 10_000_000


def test_a_simulation_that_diverged_can_be_reset_only(serve, client):
    node = serve(arena='table')
    client.state()

    def explode():
        node.simulation.data.qvel[-1] = 1e9
    node.thread.call(explode)
    client.spin_until(lambda: node.simulation.diverged is not None)
    assert set_state(client, PAUSED).result == OK
    playing = set_state(client, PLAYING)
    assert playing.result == SetSimulationState.Response.STATE_TRANSITION_ERROR
    assert 'reset it first' in playing.error_message
    rejected = step(client, 1)
    assert rejected.result == FAILED and 'reset it first' in rejected.error_message
    rejected = place(client)
    assert rejected.result == INCORRECT_STATE and 'reset it first' in rejected.error_message
    assert reset(client, ResetSimulation.Request.SCOPE_ALL).result == OK
    assert set_state(client, PLAYING).result == OK


def test_entities_are_the_robot_and_what_moves_freely(serve, client):
    serve(arena='table', prefix='left_')
    assert entities(client).entities == ['left_base', 'cube']
    assert entity_state(client, 'left_base').result.result == OK
    assert entity_state(client, 'robot0_base').result.result == NOT_FOUND


@pytest.mark.parametrize('pattern, expected', [
    ('cube', ['cube']), ('^(cube|sphere)$', ['cube']), ('^robot[[:digit:]]+_', ['robot0_base']),
    ('e$', ['robot0_base', 'cube']), ('nothing', []), ('-v', [])])
def test_entities_are_filtered_by_posix_extended_expressions(pattern, expected, serve, client):
    serve(arena='table')
    response = entities(client, filter=pattern)
    assert response.result.result == OK
    assert response.entities == expected


def test_entities_are_filtered_by_category(serve, client):
    serve(arena='table')
    for category, expected in ((EntityCategory.CATEGORY_ROBOT, ['robot0_base']),
                               (EntityCategory.CATEGORY_OBJECT, ['cube']),
                               (EntityCategory.CATEGORY_HUMAN, [])):
        categories = [EntityCategory(category=category)]
        assert entities(client, categories=categories).entities == expected


@pytest.mark.parametrize('filters, code, text', [
    ({'filter': '('}, FAILED, '('), ({'filter': 'x' * 200_000}, FAILED, 'filter'),
    ({'tags': TagsFilter(tags=['red'], filter_mode=7)}, UNSUPPORTED, 'tags'),
    ({'bounds': Bounds(type=Bounds.TYPE_CONVEX_HULL)}, UNSUPPORTED, 'bounds'),
    ({'bounds': Bounds(type=Bounds.TYPE_SPHERE)}, FAILED, 'has 2 points, got 0')])
def test_a_filter_that_does_not_work_is_rejected(filters, code, text, serve, client):
    serve(arena='table')
    result = entities(client, **filters).result
    assert result.result == code and text in result.error_message


def test_a_falling_cube_obeys_the_laws_of_motion(serve, client):
    serve(arena='table', start_paused=True)
    height, time_s, gravity = 3.0, 0.2, 9.81
    assert place(client, position=(0.0, 0.0, height), linear=(0.5, 0.0, 1.0)).result == OK
    assert step(client, 20).result == OK
    response = entity_state(client, 'cube')
    assert response.result.result == OK
    state = response.state
    assert state.header.frame_id == 'world'
    assert nanoseconds(state.header.stamp) == FIRST_NS + 200_000_000
    np.testing.assert_allclose(
        numbers(state.pose.position),
        [0.5 * time_s, 0.0, height + time_s - gravity * time_s**2 / 2], atol=2e-3)
    np.testing.assert_allclose(numbers(state.twist.linear), [0.5, 0.0, 1.0 - gravity * time_s],
                               atol=1e-6)
    np.testing.assert_allclose(numbers(state.acceleration.linear), [0.0, 0.0, -gravity], atol=1e-6)


def test_a_turning_cube_turns_about_the_axis_of_the_world(serve, client):
    serve(arena='table', start_paused=True)
    half = math.sqrt(0.5)
    # On its side: the body's z lies along the world's -y.
    assert place(client, position=(0.0, 0.0, 3.0), orientation=(half, 0.0, 0.0, half),
                 angular=(0.0, 0.0, 2.0)).result == OK
    state = entity_state(client, 'cube').state
    np.testing.assert_allclose(numbers(state.pose.orientation), [half, 0.0, 0.0, half], atol=1e-12)
    np.testing.assert_allclose(numbers(state.twist.angular), [0.0, 0.0, 2.0], atol=1e-12)
    assert step(client, 25).result == OK
    state = entity_state(client, 'cube').state
    # Half a radian about the world's z, after a quarter turn about x.
    x, w = math.sin(0.25), math.cos(0.25)
    expected = half * np.array([w, x, x, w])
    np.testing.assert_allclose(numbers(state.pose.orientation), expected, atol=1e-6)
    np.testing.assert_allclose(numbers(state.twist.angular), [0.0, 0.0, 2.0], atol=1e-6)


def test_the_robot_stands_still_where_it_is_mounted(serve, client):
    node = serve(start_paused=True)
    state = entity_state(client, 'robot0_base').state
    expected = node.simulation.robot.robot_model.base_xpos_offset['empty']
    np.testing.assert_allclose(numbers(state.pose.position)[:2], expected[:2], atol=1e-9)
    for field in (state.twist, state.acceleration):
        np.testing.assert_allclose(numbers(field.linear) + numbers(field.angular), 0.0, atol=1e-9)


def test_a_mobile_robot_is_where_its_base_is(serve, client):
    serve(robot='PandaOmron', start_paused=True)
    start = entity_state(client, 'robot0_base').state
    client.publish('base/cmd_vel', Twist(linear=Vector3(x=0.3)))
    assert step(client, 30).result == OK
    state = entity_state(client, 'robot0_base').state
    moved = np.subtract(numbers(state.pose.position), numbers(start.pose.position))
    assert np.linalg.norm(moved) > 0.05
    assert np.linalg.norm(numbers(state.twist.linear)) == pytest.approx(0.3, abs=0.03)


def test_an_unknown_entity_is_not_found(serve, client):
    serve(arena='table')
    for result in (entity_state(client, 'cub').result, place(client, name='cub')):
        assert result.result == NOT_FOUND
        assert "did you mean 'cube'?" in result.error_message


@pytest.mark.parametrize('request_, code, text', [
    ({'position': (0.0, NAN, 1.0)}, INVALID_POSE, 'position must be finite, got nan'),
    ({'position': (0.0, 0.0, 1e9)}, INVALID_POSE, 'within 10000 m'),
    ({'orientation': (0.0, 0.0, 0.0, 0.0)}, INVALID_POSE, 'length 0'),
    ({'orientation': (0.0, 0.0, 0.0, 2.0)}, INVALID_POSE, 'length 2'),
    ({'orientation': (0.0, 0.0, math.inf, 0.0)}, INVALID_POSE, 'orientation must be finite'),
    ({'linear': (NAN, 0.0, 0.0)}, FAILED, 'linear velocity must be finite'),
    ({'angular': (0.0, 0.0, 1e30)}, FAILED, 'angular velocity must be within 1000'),
    ({'frame': 'robot0_link1'}, UNSUPPORTED, "frame_id 'robot0_link1'"),
    ({'name': 'robot0_base'}, FAILED, 'cannot be moved')])
def test_a_request_that_is_rejected_changes_nothing(request_, code, text, serve, client):
    node = serve(arena='table', start_paused=True)
    before = node.simulation.data.qpos.copy(), node.simulation.data.qvel.copy()
    rejected = place(client, **request_)
    assert rejected.result == code and text in rejected.error_message
    np.testing.assert_array_equal(node.simulation.data.qpos, before[0])
    np.testing.assert_array_equal(node.simulation.data.qvel, before[1])


@pytest.mark.skipif(not HAS_FLAGS, reason='version 1 of the standard has no flags')
def test_only_what_is_flagged_is_set(serve, client):
    serve(arena='table', start_paused=True)
    place(client, position=(0.0, 0.0, 2.0), linear=(1.0, 0.0, 0.0))
    assert place(client, set_pose=False, orientation=(0.0, 0.0, 0.0, 0.0),
                 linear=(0.0, 0.5, 0.0)).result == OK
    state = entity_state(client, 'cube').state
    assert numbers(state.pose.position) == [0.0, 0.0, 2.0]
    assert numbers(state.twist.linear) == [0.0, 0.5, 0.0]
    assert place(client, set_twist=False, linear=(NAN, 0.0, 0.0)).result == OK
    state = entity_state(client, 'cube').state
    assert numbers(state.pose.position) == [0.0, 0.0, 1.5]
    assert numbers(state.twist.linear) == [0.0, 0.5, 0.0]
    rejected = place(client, set_pose=False, set_twist=False, set_acceleration=True)
    assert rejected.result == FAILED and 'nothing to set' in rejected.error_message


def test_what_is_said_about_an_entity_its_bounds_and_all_states_come_over_ros(
        sim_process, client):
    sim_process('arena:=table', 'start_paused:=true')

    def call(kind, name, **fields):
        return client.call(kind, f'manip_sim/{name}', kind.Request(**fields))
    info = EntityInfo(category=EntityCategory(category=EntityCategory.CATEGORY_DYNAMIC_OBJECT),
                      description='to be moved', tags=['red', 'small'])
    assert call(SetEntityInfo, 'set_entity_info', entity='cube', info=info).result.result == OK
    told = call(GetEntityInfo, 'get_entity_info', entity='cube')
    assert (told.result.result, told.info) == (OK, info)
    assert entities(client, tags=TagsFilter(tags=['red'])).entities == ['cube']
    bounds = call(GetEntityBounds, 'get_entity_bounds', entity='cube').bounds
    assert bounds.type == Bounds.TYPE_BOX
    np.testing.assert_allclose([numbers(point) for point in bounds.points],
                               [[0.025] * 3, [-0.025] * 3])
    near = Bounds(type=Bounds.TYPE_SPHERE, points=[Vector3(z=0.825), Vector3(x=0.001)])
    found = call(GetEntitiesStates, 'get_entities_states', filters=EntityFilters(bounds=near))
    assert found.result.result == OK and found.entities == ['cube']
    assert found.states == [entity_state(client, 'cube').state]
    for kind, name in ((GetEntityInfo, 'get_entity_info'), (SetEntityInfo, 'set_entity_info'),
                       (GetEntityBounds, 'get_entity_bounds')):
        assert call(kind, name, entity='sphere').result.result == NOT_FOUND


# ---------------------------------------------------------------------- objects that come and go

BALL = '{name: ball, shape: sphere, size: 0.1, mass: 0.2}'
MJCF = """<mujoco><worldbody><body name="pin">
  <geom type="capsule" size="0.02 0.05" mass="0.1"/></body></worldbody></mujoco>"""
Code = SpawnEntity.Response


def spawn(client, text=BALL, name='', rename=False, uri='', position=(1.5, 0.0, 1.0), **more):
    request = SpawnEntity.Request(name=name, allow_renaming=rename)
    resource = getattr(request, 'entity_resource', request)  # Of version 2; of version 1.
    resource.uri, resource.resource_string = uri, text
    request.initial_pose.pose.position = Point(x=position[0], y=position[1], z=position[2])
    for field, value in more.items():
        setattr(request, field, value)
    return client.call(SpawnEntity, 'manip_sim/spawn_entity', request)


def delete(client, name):
    request = DeleteEntity.Request(entity=name)
    return client.call(DeleteEntity, 'manip_sim/delete_entity', request).result


@pytest.mark.parametrize(('text', 'name'), [(BALL, 'ball'), (MJCF, 'pin')])
def test_an_object_comes_moves_is_published_and_goes(text, name, serve, client):
    serve(arena='table')
    response = spawn(client, text)
    assert (response.result.result, response.entity_name) == (OK, name), response.result
    assert name in entities(client).entities
    poses = client.listen(PoseStamped, f'objects/{name}/pose')
    client.spin_until(lambda: poses and poses[-1].pose.position.z < 0.2)
    assert poses[-1].pose.position.x == pytest.approx(1.5, abs=0.05)
    assert delete(client, name).result == OK
    assert name not in entities(client).entities
    assert delete(client, name).result == NOT_FOUND
    client.spin_until(lambda: client.node.count_publishers(f'objects/{name}/pose') == 0)


def test_a_moving_arm_does_not_notice_that_an_object_comes_and_goes(serve, client):
    serve(arena='table', objects=[BALL.replace('ball', 'other')])
    names = ARM[:1]
    client.publish('arm/joint_command', JointState(name=names, position=[1.0]))
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: states and states[-1].velocity[0] > 0.5)
    for _ in range(3):
        assert spawn(client).result.result == OK
        assert delete(client, 'ball').result == OK
    client.spin_until(lambda: abs(states[-1].position[0] - 1.0) < 1e-4)
    velocity = np.array([state.velocity[0] for state in states])
    stamps = np.array([s.header.stamp.sec + s.header.stamp.nanosec * 1e-9 for s in states])
    assert np.abs(np.diff(velocity) / np.diff(stamps)).max() < 25.0
    assert velocity.min() > -1e-3


def test_names_are_unique_or_made_so(serve, client):
    serve(arena='table')
    assert spawn(client).entity_name == 'ball'
    assert spawn(client).result.result == Code.NAME_NOT_UNIQUE
    assert spawn(client, rename=True).entity_name == 'ball_1'
    assert spawn(client, name='1 Ball!', rename=True).entity_name == 'Ball_'
    assert spawn(client, name='cube').result.result == Code.NAME_NOT_UNIQUE
    assert spawn(client, name='a b').result.result == Code.NAME_INVALID


@pytest.mark.parametrize(('arguments', 'code', 'what'), [
    ({'text': ''}, Code.NO_RESOURCE, 'give a file'),
    ({'text': '<mujoco'}, Code.RESOURCE_PARSE_ERROR, 'is not well-formed XML'),
    ({'text': '{shape: sfere, size: 1.0}'}, Code.RESOURCE_PARSE_ERROR, 'sphere'),
    ({'uri': 'http://example.org/a.xml'}, Code.UNSUPPORTED_FORMAT, 'only paths and file://'),
    ({'uri': 'a.usd'}, Code.UNSUPPORTED_FORMAT, 'only MJCF'),
    ({'uri': 'missing.xml'}, Code.RESOURCE_PARSE_ERROR, 'missing.xml'),
    ({'entity_namespace': 'a'}, Code.NAMESPACE_INVALID, 'no namespace'),
    ({'position': (NAN, 0.0, 0.0)}, Code.INVALID_POSE, 'finite')])
def test_what_cannot_be_spawned_is_told_and_changes_nothing(arguments, code, what, serve, client):
    serve(arena='table')
    before = list(entities(client).entities)
    result = spawn(client, **arguments).result
    assert result.result == code, result
    assert what in result.error_message and '\n' not in result.error_message
    assert list(entities(client).entities) == before


def test_what_is_not_an_object_is_not_deleted(serve, client):
    serve(arena='table')
    result = delete(client, 'robot0_base')
    assert result.result == FAILED
    assert 'cannot be deleted' in result.error_message


def test_a_reset_brings_spawned_objects_back_to_where_they_came(serve, client):
    serve(arena='table')
    assert spawn(client).result.result == OK
    client.spin_until(lambda: entity_state(client, 'ball').state.pose.position.z < 0.2)
    set_state(client, PAUSED)
    assert client.call(Trigger, 'manip_sim/reset').success
    assert entity_state(client, 'ball').state.pose.position.z == pytest.approx(1.0)


@pytest.mark.skipif(not HAS_SPAWN_ENTITIES, reason='this version has no SpawnEntities')
def test_several_entities_come_at_once(sim_process, client):
    sim_process('arena:=table')
    request = srv.SpawnEntities.Request()
    for text in (BALL, MJCF, BALL):
        request.spawn_requests.append(messages.SpawnEntity(entity_resource=messages.Resource(
            resource_string=text)))
        request.spawn_requests[-1].initial_pose.pose.position.x = 1.5
        request.spawn_requests[-1].initial_pose.pose.position.y = float(
            len(request.spawn_requests))
    response = client.call(srv.SpawnEntities, 'manip_sim/spawn_entities', request)
    assert response.result.result == srv.SpawnEntities.Response.ENTITIES_SPAWN_FAILED
    assert [(one.result.result, one.entity_name) for one in response.results] == [
        (OK, 'ball'), (OK, 'pin'), (Code.NAME_NOT_UNIQUE, '')]
    assert set(entities(client).entities) == {'robot0_base', 'cube', 'ball', 'pin'}


def load(client, uri):
    request = srv.LoadWorld.Request()
    getattr(request, 'world_resource', request).uri = uri
    return client.call(srv.LoadWorld, 'manip_sim/load_world', request)


@pytest.mark.skipif(not HAS_WORLDS, reason='this version has no worlds')
@pytest.mark.parametrize('stepping', ['realtime', 'lockstep'])
def test_worlds_are_loaded_and_unloaded_and_followed(stepping, sim_process, client):
    sim_process('arena:=table', f'stepping:={stepping}', 'cameras:=[agentview]')
    clocks = client.listen(Clock, '/clock')
    available = client.call(srv.GetAvailableWorlds, 'manip_sim/get_available_worlds')
    uris = {world.name: world.world_resource.uri for world in available.worlds}
    assert available.result.result == OK and {'table', 'bins', 'drawer', 'empty'} <= set(uris)
    assert spawn(client).result.result == OK
    assert spawn(client, '{robot: UR5e, name: second}').result.result == OK
    client.spin_until(lambda: client.node.count_publishers('second/joint_states') == 1)
    response = load(client, uris['drawer'])
    assert (response.result.result, response.world.name) == (OK, 'drawer'), response.result
    assert get_state(client) == STOPPED
    assert entities(client).entities == ['robot0_base']
    client.spin_until(lambda: nanoseconds(clocks[-1].clock) == FIRST_NS)
    client.spin_until(lambda: client.node.count_publishers('second/joint_states') == 0
                      and client.node.count_publishers('objects/cube/pose') == 0)
    poses = client.call(srv.GetNamedPoses, 'manip_sim/get_named_poses').poses
    assert [pose.name for pose in poses] == ['table_top', 'handle']
    bounds = client.call(srv.GetNamedPoseBounds, 'manip_sim/get_named_pose_bounds',
                         srv.GetNamedPoseBounds.Request(name='handle'))
    assert (bounds.result.result, bounds.bounds.type) == (OK, Bounds.TYPE_EMPTY)
    unload = client.call(srv.UnloadWorld, 'manip_sim/unload_world').result
    assert unload.result == OK and get_state(client) == SimulationState.STATE_NO_WORLD
    assert set_state(client, PLAYING).result == INCORRECT_STATE
    assert load(client, 'arena:nowhere').result.result == NOT_FOUND
    assert load(client, uris['table']).result.result == OK
    current = client.call(srv.GetCurrentWorld, 'manip_sim/get_current_world')
    assert (current.result.result, current.world.name) == (OK, 'table')
    assert entities(client).entities == ['robot0_base', 'cube']
    client.spin_until(lambda: client.node.count_publishers('objects/cube/pose') == 1)
    if stepping == 'realtime':
        assert set_state(client, PLAYING).result == OK
        client.publish('arm/joint_command', JointState(name=[ARM[0]], position=[0.5]))
        client.spin_until(lambda: client.state().position[0] > 0.4)


def test_what_can_be_spawned_is_spawned(serve, client, tmp_path):
    (tmp_path / 'pin.xml').write_text(MJCF)
    serve(arena='table', spawn_roots=[str(tmp_path)])
    response = client.call(srv.GetSpawnables, 'manip_sim/get_spawnables',
                           srv.GetSpawnables.Request(sources=['/nowhere']))
    assert response.result.result == OK and '/nowhere' in response.result.error_message
    uris = [getattr(one, 'entity_resource', one).uri for one in response.spawnables]
    (uri,) = filter(None, uris)
    assert spawn(client, '', uri=uri).entity_name == 'pin'
