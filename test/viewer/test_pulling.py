# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a drag of a body on the page asks of the node."""

import asyncio
import math
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.models import compose  # noqa: E402
from manip_sim.viewer.page.server import Access  # noqa: E402
from manip_sim.viewer.page.latest import Latest, PoseInWorld  # noqa: E402
from manip_sim.viewer.page.page import Page  # noqa: E402
from manip_sim.viewer.page.server import close_server, open_server  # noqa: E402

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


class Sent:
    """Keeps the pulls that are asked of it."""

    def __init__(self):
        self.pulls = []

    def pull(self, body, number, point, target):
        self.pulls.append((body, number, point.tolist(), target.tolist()))

    def let_go(self, body):
        self.pulls.append(body)

    def step(self):
        """Is not asked for here, nor are these."""

    pause = reset = tare = step

    def taken(self):
        pulls, self.pulls = self.pulls, []
        return pulls


@pytest.fixture(scope='module')
def model():
    return compose('Panda', arena='table').compile()


@pytest.fixture
def sent():
    return Sent()


@pytest.fixture
def page(model, sent):
    server = open_server('127.0.0.1', 0, Access.of({}))
    page = Page(server, sent, lambda camera, wanted: None)
    page.show_model(model, Latest())
    yield page
    close_server(server)


def tick(page, ticked):
    page._pulling._box.value = ticked
    page.events.run()


def drag(page, body, phase, begin=(0.0, 0.0, 0.8), end=(0.0, 0.0, 1.0)):
    """Do what the server does with a message of a browser."""
    handle = next(handle for name, handle in page._scene._moving if name == body)
    for entry in list(handle._impl.drag_cb):
        asyncio.run(entry.callback(SimpleNamespace(
            phase=phase, start_position=begin, end_position=end)))


def update(page, now_s, height=0.825):
    page.update(now_s, Latest(objects={
        'cube': PoseInWorld(np.array([0.0, 0.0, height]), UPRIGHT)}), False)


@pytest.mark.full
def test_a_drag_pulls_twenty_times_a_second_until_the_mouse_lets_go(page, sent):
    tick(page, True)
    drag(page, 'cube', 'start')
    for hundredth in range(100):
        if hundredth == 50:
            drag(page, 'cube', 'update', (9.0, 9.0, 9.0), (0.0, 0.1, 1.1))
        update(page, 10.0 + hundredth / 100.0)
    pulls = sent.taken()
    assert 19 <= len(pulls) <= 21
    assert {(body, *point) for body, _, point, _ in pulls} == {('cube', 0.0, 0.0, 0.8)}
    assert (pulls[0][3], pulls[-1][3]) == ([0.0, 0.0, 1.0], [0.0, 0.1, 1.1])
    assert len({number for _, number, _, _ in pulls}) == 1
    drag(page, 'cube', 'end')
    update(page, 12.0)
    update(page, 13.0)
    assert sent.taken() == ['cube']
    drag(page, 'robot0_link5', 'start')
    update(page, 14.0)
    (body, number, _, _), = sent.taken()
    assert body == 'robot0_link5' and number != pulls[0][1]


def test_an_arrow_goes_from_the_point_that_is_held_to_the_mouse(page):
    tick(page, True)
    update(page, 1.0, height=0.825)
    drag(page, 'cube', 'start', (0.02, 0.0, 0.85), (0.0, 0.0, 1.2))
    update(page, 2.0, height=0.825)
    update(page, 3.0, height=0.925)
    arrow, handle = page._overlays._shown['pull']
    np.testing.assert_allclose(arrow, [[[0.02, 0.0, 0.95], [0.0, 0.0, 1.2]]], atol=1e-6)
    drag(page, 'cube', 'end')
    update(page, 4.0)
    assert 'pull' not in page._overlays._shown


@pytest.mark.full
def test_a_body_that_goes_as_its_drag_begins_has_no_arrow(page):
    tick(page, True)
    drag(page, 'cube', 'start')
    page.show_model(compose('Panda').compile(), Latest())
    page.update(1.0, Latest(), False)
    assert page._pulling._drag is not None
    assert 'pull' not in page._overlays._shown


def test_nothing_is_pulled_without_the_tick_or_in_a_past_picture_or_to_nowhere(page, sent):
    drag(page, 'cube', 'start')
    assert not any(handle._impl.drag_cb for _, handle in page._scene._moving)
    tick(page, True)
    for nowhere in ((0.0, math.nan, 0.0), (0.0, 1.0), None, 'abc', [[1.0]] * 3, {}):
        drag(page, 'cube', 'start', end=nowhere)
        drag(page, 'cube', 'start', begin=nowhere)
    update(page, 1.0)
    assert sent.taken() == []
    drag(page, 'cube', 'start')
    update(page, 2.0)
    tick(page, False)
    drag(page, 'cube', 'update')
    update(page, 3.0)
    assert [pull if isinstance(pull, str) else pull[0] for pull in sent.taken()] == ['cube'] * 2
    tick(page, True)
    drag(page, 'cube', 'start')
    update(page, 4.0)
    page._look_back._rows = np.array([page._posture.data.qpos])
    page._look_back._timeline.index = 0
    for now_s in (5.0, 6.0):
        update(page, now_s)
    assert sent.taken()[1:] == ['cube']


@pytest.mark.full
def test_bodies_that_cannot_move_cannot_be_dragged_and_those_of_another_model_can(
        page, model, sent):
    moving = {name for name, _ in page._scene._moving}
    assert {'cube', 'robot0_link7', 'gripper0_right_leftfinger'} <= moving
    assert not {'table', 'robot0_link0', 'world'} & moving
    tick(page, True)
    page.show_model(model, Latest())
    drag(page, 'cube', 'start')
    update(page, 1.0)
    assert sent.taken()[0][0] == 'cube'
    # Panels of other robots have a box that is not ticked.
    page.show_robots((), ())
    drag(page, 'cube', 'start')
    update(page, 2.0)
    assert sent.taken() == []


def test_a_page_that_only_watches_lets_nothing_be_dragged(model):
    server = open_server('127.0.0.1', 0, Access.of({}))
    try:
        page = Page(server, None, lambda camera, wanted: None)
        page.show_model(model, Latest())
        assert page._pulling is None
        assert not any(handle._impl.drag_cb for _, handle in page._scene._moving)
    finally:
        close_server(server)
