# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The last minute of a live node: what is kept of it, and what a person sees of it."""

import numpy as np
import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.models import compose  # noqa: E402
from manip_sim.viewer.page.server import Access  # noqa: E402
from manip_sim.viewer.page.latest import JointStates, Latest, PoseInWorld  # noqa: E402
from manip_sim.viewer.page.page import Page  # noqa: E402
from manip_sim.viewer.page.server import close_server, open_server  # noqa: E402
from manip_sim.viewer.page.timeline import Timeline  # noqa: E402

JOINT = 'robot0_joint1'
BALL = {'name': 'ball', 'shape': 'sphere', 'size': 0.03, 'position': [0.5, 0.0, 1.0]}


@pytest.fixture(scope='module')
def models():
    """Return a world, and the world that it becomes when an object comes."""
    return (compose('Panda', arena='table').compile(),
            compose('Panda', arena='table', objects=[BALL]).compile())


@pytest.fixture
def page(models):
    server = open_server('127.0.0.1', 0, Access.of({}))
    page = Page(server, None, lambda camera, wanted: None)
    page.show_model(models[0], Latest())
    yield page
    close_server(server)


def at(time_s):
    """Return states in which the joint is at a hundredth of the time, and the cube falls."""
    numbers = np.array([time_s / 100.0])
    return Latest(joints={'/': JointStates([JOINT], numbers, numbers, numbers, time_s)},
                  objects={'cube': PoseInWorld(np.array([0.0, 0.0, 2.0 - time_s / 100.0]),
                                               np.array([1.0, 0.0, 0.0, 0.0]))})


def live(page, first_s, last_s, rate=30.0):
    for time_s in np.arange(first_s, last_s, 1.0 / rate):
        page.update(time_s, at(time_s), False)


def shown(page):
    """Return joint and height of the cube in the scene."""
    data, model = page._posture.data, page._posture.model
    turn, cube = data.joint(JOINT).qpos[0], model.body('cube').id
    frame = page._scene._frames[cube]
    np.testing.assert_allclose(frame.position, data.xpos[cube], atol=1e-4)
    return turn * 100.0, (2.0 - data.xpos[cube, 2]) * 100.0


def press(page, what):
    page._look_back._buttons.value = what
    page.events.run()


@pytest.mark.full
def test_a_person_scrubs_back_while_the_node_goes_on_and_returns_to_the_present(page):
    live(page, 0.0, 40.0)
    press(page, 'Last minute')
    slider = page._look_back._timeline._slider
    assert slider.visible and slider.value == slider.max == 0.0
    for ago_s in (10.0, 35.5, 0.5):
        slider.value = -ago_s
        page.events.run()
        # The node goes on meanwhile, and the picture does not.
        live(page, 41.0 + ago_s, 41.2 + ago_s)
        np.testing.assert_allclose(shown(page), 39.967 - ago_s, atol=0.02)
        assert f'{ago_s:.1f}'[:3] in page._look_back._text._shown
    press(page, 'Live')
    live(page, 90.0, 90.1)
    np.testing.assert_allclose(shown(page), 90.067, atol=0.01)
    assert not slider.visible


@pytest.mark.full
def test_it_goes_back_a_minute_and_takes_no_more_memory_in_an_hour(page):
    for rate, first_s, last_s in ((2.0, 0.0, 3600.0), (500.0, 3600.0, 3700.0)):
        live(page, first_s, first_s + 0.01)
        for time_s in np.arange(first_s, last_s, 1.0 / rate):
            page._take(at(time_s))
    press(page, 'Last minute')
    times, rows = page._look_back._times, page._look_back._rows
    assert 59.9 < times[-1] - times[0] <= 60.0
    assert len(rows) <= 3601 and rows.nbytes < 2**21
    page._look_back._timeline._slider.value = -60.0
    page.events.run()
    page.update(0.0, at(3700.0), False)
    np.testing.assert_allclose(shown(page), times[0], atol=1e-6)


@pytest.mark.full
def test_it_plays_what_it_keeps(page):
    live(page, 0.0, 20.0)
    press(page, 'Last minute')
    timeline = page._look_back._timeline
    timeline._slider.value = -10.0
    timeline._play.value = True
    for now_s in np.arange(100.0, 103.0, 0.05):
        page.update(now_s, at(20.0), False)
    np.testing.assert_allclose(shown(page), 19.967 - 10.0 + 2.95, atol=0.06)
    for now_s in np.arange(103.0, 115.0, 0.5):
        page.update(now_s, at(20.0), False)
    np.testing.assert_allclose(shown(page), 19.967, atol=1e-2)
    assert not timeline._play.value


@pytest.mark.full
def test_another_world_begins_it_again_and_shows_the_present(page, models):
    live(page, 0.0, 20.0)
    press(page, 'Last minute')
    page._look_back._timeline._slider.value = -15.0
    page.events.run()
    page.show_model(models[1], at(20.0))
    page.update(20.0, at(20.0), False)
    np.testing.assert_allclose(shown(page), 20.0, atol=1e-3)
    live(page, 20.0, 25.0)
    press(page, 'Last minute')
    assert page._look_back._times[0] == pytest.approx(20.0)
    assert page._look_back._rows.shape[1] == models[1].nq
    # Panels for other robots or cameras do so too.
    page.show_robots((), ('front',))
    live(page, 25.0, 26.0)
    press(page, 'Last minute')
    assert page._look_back._times[0] == pytest.approx(25.0, abs=0.04)


def test_without_states_there_is_nothing_to_look_back_at(page):
    press(page, 'Last minute')
    page.update(1.0, Latest(), False)
    assert page._look_back.shown is None
    # Simulation time that begins anew, as of another node, is another minute.
    live(page, 50.0, 55.0)
    live(page, 1.0, 3.0)
    press(page, 'Last minute')
    assert page._look_back._times[[0, -1]] == pytest.approx([1.0, 2.967], abs=1e-3)


def test_a_slider_over_one_instant_has_room_for_a_step(page):
    timeline = Timeline(page._server.gui, page.events, 'One', 0.5, lambda index: None)
    timeline.begin(np.array([0.0]), [3.0], 0)
    assert (timeline._slider.min, timeline._slider.max, timeline.index) == (3.0, 3.5, 0)
