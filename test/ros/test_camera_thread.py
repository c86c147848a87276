# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that renders: the newest state wins, objects come and go, failures end quietly."""

import os
import queue
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from manip_sim.models import World
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.rendering import choose_gl, OffscreenRenderer
from manip_sim.ros.camera_publishers import _Order, CameraThread, CameraView
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import take_snapshot, VisibleWorld

WAIT_S = 300.0
BALL = {'name': 'ball', 'shape': 'sphere', 'size': 0.2, 'position': [3.0, 0.0, 1.0],
        'rgba': [0.0, 0.0, 1.0, 1.0]}
EYE = {'name': 'eye', 'position': [2.0, 0.0, 1.0], 'fovy': 60}
VIEW = CameraView('eye', 64, 48)


@pytest.fixture
def simulation(one_joint_arm):
    return Simulation(World([one_joint_arm()], objects=[BALL], cameras=[EYE]))


@pytest.fixture
def cameras(simulation, renderer, monkeypatch):
    """Return a function that starts a thread; shots and failures are in its queues."""
    monkeypatch.setenv('MUJOCO_GL', os.environ.get('MUJOCO_GL', 'egl'))
    started = []

    def start(deliver=None):
        shots, failures = queue.Queue(), queue.Queue()

        def take(shot):
            shots.put(shot)
            if deliver is not None:
                deliver(shot)
        thread = CameraThread(choose_gl(), VisibleWorld(simulation.plan), [VIEW], take,
                              failures.put)
        started.append(thread)
        thread.start(WAIT_S)
        return thread, shots, failures
    yield start
    for thread in started:
        assert thread.stop(WAIT_S)


def order(thread, simulation, rgb=True, depth=True, labels=False):
    thread.order(VIEW, take_snapshot(simulation), rgb, depth, labels)


def ahead_m(shot):
    """Return how far it is to what is in the middle of the image [m]."""
    return shot.picture.depth[24, 32]


@pytest.mark.full
def test_a_shot_shows_the_instant_of_its_snapshot(cameras, simulation):
    thread, shots, _ = cameras()
    order(thread, simulation)
    # The simulation goes on while the thread renders.
    simulation.entities.place(simulation.data, 'ball', Pose.checked([5.0, 0, 1], [0, 0, 0, 1]),
                              None)
    simulation.advance(1)
    shot = shots.get(timeout=WAIT_S)
    assert shot.snapshot.time_ns == 0
    assert ahead_m(shot) == pytest.approx(0.8, rel=1e-2)
    order(thread, simulation)
    shot = shots.get(timeout=WAIT_S)
    assert shot.snapshot.time_ns == simulation.time_ns
    assert ahead_m(shot) == pytest.approx(2.8, rel=1e-2)


@pytest.mark.full
def test_of_states_that_come_while_one_is_rendered_the_newest_is_next(cameras, simulation):
    go_on = threading.Event()
    thread, shots, _ = cameras(lambda _: go_on.wait(WAIT_S))
    order(thread, simulation)
    shots.get(timeout=WAIT_S)
    for _ in range(5):
        simulation.advance(1)
        order(thread, simulation)
    go_on.set()
    assert shots.get(timeout=WAIT_S).snapshot.time_ns == simulation.time_ns
    assert thread.left_out['eye'] == 4
    assert thread.stop(WAIT_S)
    assert shots.empty()


def test_the_same_state_is_rendered_once_and_more_of_it_when_more_is_asked_for(cameras,
                                                                               simulation):
    thread, shots, _ = cameras()

    def next_shot(**what):
        order(thread, simulation, **what)
        return shots.get(timeout=WAIT_S)
    first = next_shot(depth=False)
    assert next_shot(depth=False).picture is first.picture
    assert next_shot().picture.depth is not None
    assert next_shot(labels=True).picture.labels is not None
    # Something is put elsewhere while time stands still.
    before = next_shot()
    simulation.entities.place(simulation.data, 'ball', Pose.checked([4.0, 0, 1], [0, 0, 0, 1]),
                              None)
    assert ahead_m(next_shot()) > ahead_m(before) + 0.5


@pytest.mark.full
def test_objects_that_come_and_go_are_seen(cameras, simulation):
    thread, shots, _ = cameras()
    simulation.change_objects(plan_with(simulation.plan, create_object(
        {**BALL, 'name': 'nearer', 'position': [2.5, 0.0, 1.0]})))
    order(thread, simulation)
    assert ahead_m(shots.get(timeout=WAIT_S)) == pytest.approx(0.3, rel=1e-2)
    for name in ('nearer', 'ball'):
        simulation.change_objects(plan_without(simulation.plan, name))
    order(thread, simulation)
    assert ahead_m(shots.get(timeout=WAIT_S)) > 1.0


def test_a_camera_that_has_gone_with_its_object_is_left_out(cameras, simulation):
    thread, shots, failures = cameras()
    thread.order(CameraView('gone', 64, 48), take_snapshot(simulation), True, True)
    order(thread, simulation)
    assert shots.get(timeout=WAIT_S).view.camera == 'eye'
    assert failures.empty()


def test_shapes_that_cannot_collide_are_seen(one_joint_arm):
    arm = one_joint_arm(worldbody="""
        <body name="base"><geom size="0.05" mass="1"/>
          <geom name="painted" size="0.2" contype="0" conaffinity="0" group="1"/>
          <body name="link1"><joint name="joint1" axis="0 1 0" range="-2 2"/>
            <geom size="0.02" mass="1"/><body name="right_hand"/></body></body>""")
    simulation = Simulation(World([arm], cameras=[EYE]))
    visible = VisibleWorld(simulation.plan)
    names = [visible.model.geom(index).name for index in range(visible.model.ngeom)]
    assert any('painted' in name for name in names)
    assert visible.model.nq == simulation.model.nq
    assert visible.cameras[-1] == 'eye'


def test_a_rendering_that_fails_is_told_once_and_ends_the_thread(cameras, simulation,
                                                                 monkeypatch):
    def fail(*_, **__):
        raise RuntimeError('the driver is gone')
    monkeypatch.setattr(OffscreenRenderer, 'render', fail)
    thread, shots, failures = cameras()
    order(thread, simulation)
    assert str(failures.get(timeout=WAIT_S)).endswith(': the driver is gone')
    assert thread.stop(WAIT_S)
    for _ in range(3):
        order(thread, simulation)
    assert failures.empty()
    assert shots.empty()
    assert 'the driver is gone' in str(thread.failed)


def test_a_rendering_that_hangs_is_left_behind(cameras, simulation):
    go_on = threading.Event()
    thread, shots, _ = cameras(lambda _: go_on.wait(WAIT_S))
    order(thread, simulation)
    shots.get(timeout=WAIT_S)
    assert not thread.stop(0.1)
    assert next(t for t in threading.enumerate() if t.name == 'cameras').daemon
    go_on.set()
    assert thread.stop(WAIT_S)


def test_without_opengl_the_start_returns_and_the_reason_is_told(simulation, monkeypatch):
    monkeypatch.setenv('MUJOCO_GL', 'egl')
    failures = queue.Queue()
    thread = CameraThread('missing', VisibleWorld(simulation.plan), [VIEW], failures.put,
                          failures.put)
    thread.start(WAIT_S)
    assert 'cannot render with MUJOCO_GL=egl: No module named' in str(
        failures.get(timeout=WAIT_S))
    order(thread, simulation)
    assert thread.stop(WAIT_S)
    assert failures.empty()


def test_a_snapshot_is_a_copy(simulation):
    snapshot = take_snapshot(simulation)
    before = snapshot.qpos.copy()
    simulation.data.qpos[:] = 0.5
    np.testing.assert_array_equal(snapshot.qpos, before)
    assert not snapshot.shows_the_same_as(take_snapshot(simulation))


def test_snapshots_of_one_instant_are_the_same_until_an_object_is_replaced(simulation):
    before = take_snapshot(simulation)
    assert before.shows_the_same_as(take_snapshot(simulation))
    # A ball of another size at the same place: no number of the state tells of it.
    simulation.change_objects(plan_without(simulation.plan, 'ball'))
    simulation.change_objects(plan_with(simulation.plan, create_object({**BALL, 'size': 0.3})))
    after = take_snapshot(simulation)
    np.testing.assert_array_equal(after.qpos, before.qpos)
    assert after.time_ns == before.time_ns
    assert not after.shows_the_same_as(before)


@pytest.mark.parametrize('wanted', ['rgb', 'depth', 'labels'])
def test_a_shot_without_an_image_that_is_wanted_is_not_the_one(wanted):
    snapshot = SimpleNamespace(shows_the_same_as=lambda _: True)
    request = _Order(VIEW, snapshot, **{
        kind: kind == wanted for kind in ('rgb', 'depth', 'labels')}, noise=None)

    def shot(*kinds):
        return SimpleNamespace(view=VIEW, snapshot=snapshot, picture=SimpleNamespace(**{
            kind: kind if kind in kinds else None for kind in ('rgb', 'depth', 'labels')}))
    assert request.is_met_by(shot(wanted))
    assert request.is_met_by(shot('rgb', 'depth', 'labels'))
    assert not request.is_met_by(shot(*{'rgb', 'depth', 'labels'} - {wanted}))
