# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Layout in a browser: nothing is cut, covered or wrapped, on a desktop and on a phone."""

from __future__ import annotations

import io

from harness import Served
import numpy as np
from PIL import Image
import pytest

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from test_viewer import browser, end, PATIENCE_MS, SLOWLY, start_viewer  # noqa: E402

assert browser  # A fixture.
pytestmark = pytest.mark.full


@pytest.fixture(scope='module')
def address():
    served = Served({'arena': 'table', 'start_paused': True})
    process, address = start_viewer()
    yield address
    _, errors = end(process)
    served.close()
    assert (process.returncode, errors) == (0, '')


@pytest.fixture(scope='module')
def page(browser, address):
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script(SLOWLY.format(500))  # These tests are about the panel.
    yield page
    page.close()


@pytest.fixture
def opened(page, address):
    """Return a function that opens the page in a window of a width and a height."""
    def open_page(width, height):
        resize(page, width, height)
        page.goto(address)
        page.get_by_text('arm [rad]').wait_for()
        page.get_by_label('Mode', exact=True).first.wait_for(state='attached')
        page.wait_for_timeout(3000)
        return page
    return open_page


def resize(page, width, height):
    page.set_viewport_size({'width': width, 'height': height})


def boxes(page, selector):
    """Return left, top, right and bottom of the elements that are seen, in pixels."""
    found = page.eval_on_selector_all(selector, """elements => elements.map(element => {
        const box = element.getBoundingClientRect();
        return [box.left, box.top, box.right, box.bottom]; })""")
    return [box for box in found if box[2] > box[0] and box[3] > box[1]]


def test_numbers_of_sliders_are_whole_and_hints_are_not_over_buttons(opened):
    page = opened(1280, 800)
    numbers = page.eval_on_selector_all(
        '.mantine-Slider-root ~ .mantine-NumberInput-root input',
        'inputs => inputs.map(one => [one.value, one.scrollWidth <= one.clientWidth])')
    assert '0.7854' in [number for number, _ in numbers]
    assert len(numbers) >= 9 and all(whole for _, whole in numbers)
    buttons = boxes(page, 'button')
    assert len(buttons) > 8
    text = page.get_by_text('joint1', exact=True).first
    page.locator(f'[id="{text.get_attribute("for")}"]').hover(force=True)
    page.locator('.mantine-Tooltip-tooltip').first.wait_for()
    for left, top, right, bottom in boxes(page, '.mantine-Tooltip-tooltip'):
        assert right - left > 100 and left >= 0
        assert not [box for box in buttons if left < box[2] and box[0] < right
                    and top < box[3] and box[1] < bottom]


def test_a_picture_is_what_the_browser_shows(opened):
    page = opened(640, 480)
    with page.expect_download() as download:
        page.get_by_role('button', name='Picture').dispatch_event('click')
    assert download.value.suggested_filename.startswith('manip_sim_')
    with open(download.value.path(), 'rb') as file:
        picture = np.asarray(Image.open(io.BytesIO(file.read())).convert('RGB')).astype(int)
    assert picture.shape[1] >= 300 and picture.max() - picture.min() > 100
    assert (picture[..., 0] - picture[..., 1:].max(axis=2) > 40).any()  # The cube.


def test_on_a_phone_the_panel_is_below_the_middle_and_its_tabs_are_in_one_row(opened):
    page = opened(390, 844)
    for width, height in (390, 844), (320, 568):
        resize(page, width, height)
        page.wait_for_function('width => document.querySelector("canvas").clientWidth == width',
                               arg=width)
        (panel,) = boxes(page, '.mantine-Paper-root[style*="fixed"]')
        assert panel[1] >= 0.54 * height
        assert (panel[0], panel[2]) == (0, width)
        tabs = boxes(page, '[role=tab]')
        assert len(tabs) == 5
        assert len({top for _, top, _, _ in tabs}) == 1 and max(tab[2] for tab in tabs) <= width
