# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The viewer in a real browser, driving a real node over topics; the viewer as a process."""

from __future__ import annotations

import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import time

from harness import END_SIGNALS, Served, START_S
import numpy as np
from PIL import Image
import pytest
from sensor_msgs.msg import JointState

from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without

pytestmark = pytest.mark.full

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

#: OpenGL in software, which smooth edges would cost four times as much in each picture, and no
#: sandbox, which a container does not have.
ARGUMENTS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
             '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist',
             '--webgl-antialiasing-mode=none']
#: Draws the picture less often: so many milliseconds later than the browser would.
SLOWLY = ('const draw = requestAnimationFrame; requestAnimationFrame = '
          'callback => setTimeout(() => draw(callback), {})')
#: A browser on a busy machine without a graphics card is slow [ms].
PATIENCE_MS = 300_000
PROGRAM = ('-m', 'manip_sim.viewer')
VIEWER = [sys.executable, *PROGRAM]


def start_viewer(*arguments, program=PROGRAM):
    """Return a viewer on a free port and its address."""
    process = subprocess.Popen([sys.executable, *program, '--port', '0', *arguments], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    line = process.stdout.readline()
    return process, line.split()[1] if line else ''


def end(process):
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    return process.communicate(timeout=300.0)


@pytest.fixture(scope='module')
def node():
    served = Served({'arena': 'table'})
    yield served.node
    served.close()


@pytest.mark.parametrize('number', END_SIGNALS)
def test_a_signal_ends_it_cleanly(number):
    process, address = start_viewer('--node', 'nobody')
    assert address.startswith('http://127.0.0.1:')
    process.send_signal(number)
    output, errors = process.communicate(timeout=300.0)
    assert (process.returncode, output, errors) == (0, '', '')


def test_the_window_of_mujoco_ends_cleanly_too(node):
    if shutil.which('Xvfb') is None:
        pytest.skip('there is no Xvfb')
    screen = subprocess.Popen(['Xvfb', '-displayfd', '1', '-screen', '0', '640x480x24'],
                              text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        process = subprocess.Popen(
            [*VIEWER, '--native'], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env={**os.environ, 'DISPLAY': f':{screen.stdout.readline().strip()}'})
        assert process.stdout.readline() == 'sim_view: waiting for the node /manip_sim\n'
        assert process.stdout.readline() == 'sim_view: a window shows /manip_sim\n'
        time.sleep(1.0)  # While it draws.
        _, errors = end(process)
        assert (process.returncode, errors) == (0, '')
    finally:
        end(screen)


def test_the_window_of_mujoco_says_at_once_that_it_waits(monkeypatch):
    monkeypatch.delenv('PYTHONUNBUFFERED', raising=False)
    process = subprocess.Popen(
        [*VIEWER, '--native', '--node', 'nobody'], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env={**os.environ, 'DISPLAY': ':0'})
    assert process.stdout.readline() == 'sim_view: waiting for the node /nobody\n'
    _, errors = end(process)
    assert (process.returncode, errors) == (0, '')


def run_viewer(*arguments, environment=None):
    return subprocess.run([*VIEWER, *arguments], capture_output=True, text=True, timeout=300.0,
                          env=environment, check=False)


def test_a_port_that_is_taken_is_told_in_one_line():
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = run_viewer('--port', str(port))
    assert done.returncode == 1
    assert done.stdout == ''
    assert done.stderr == (f'sim_view: cannot listen on 127.0.0.1:{port}: Address already in use; '
                           'choose another port with --port, or another address with --listen\n')


@pytest.mark.parametrize('arguments, code, told', [
    (['--ros-args', '-r', 'nonsense'], 1, "bad ROS arguments: '-r nonsense' must be -r OLD:=NEW"),
    (['robot:=Panda'], 2, "unknown argument 'robot:=Panda'"),
    (['--port', 'x'], 2, "argument --port: invalid int value: 'x'; see --help")])
def test_bad_arguments_are_told_in_one_line(arguments, code, told):
    done = run_viewer(*arguments)
    assert done.returncode == code
    assert done.stderr.startswith(f'sim_view: {told}')
    assert done.stderr.count('\n') == 1


@pytest.fixture(scope='module')
def address(node):
    process, address = start_viewer()
    yield address
    _, errors = end(process)
    assert process.returncode == 0
    assert errors == ''


@pytest.fixture(scope='module')
def browser():
    playwright = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    chromium = shutil.which('chromium') or shutil.which('chromium-browser')
    if chromium is None:
        pytest.skip('there is no chromium')
    with playwright.sync_playwright() as library:
        browser = library.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope='module')
def page(browser, address):
    """Return the page when the robot is on it."""
    page = browser.new_page(viewport={'width': 640, 'height': 400})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    page.get_by_text('arm [rad]').wait_for()
    yield page
    page.close()


def act_until(client, act, condition):
    """Act on the page until a condition holds: while it is rebuilt it takes no key or click."""
    for _ in range(6):
        act()
        end_s = time.monotonic() + START_S / 30.0
        client.spin_until(lambda until=end_s: condition() or time.monotonic() > until)
        if condition():
            return
    pytest.fail('nothing has come of it')


def slider(page, label):
    """Return the thumb of a slider."""
    found = page.get_by_text(label, exact=True).first
    return page.locator(f'[id="{found.get_attribute("for")}"] [role=slider]')


def test_a_slider_moves_the_robot_and_reset_brings_it_back(page, client):
    states = client.listen(JointState, 'joint_states', 1)
    client.spin_until(lambda: bool(states))
    joint = list(states[0].name).index('robot0_joint1')
    start = states[0].position[joint]
    # As far as it goes, 2.9 rad.
    act_until(client, lambda: slider(page, 'joint1').press('End'),
              lambda: states[-1].position[joint] > start + 0.5)
    thumb = slider(page, 'joint1')
    page.get_by_role('button', name='Reset').dispatch_event('click')
    client.spin_until(lambda: abs(states[-1].position[joint] - start) < 1e-3)
    client.spin_until(lambda: not states[-1].velocity[joint] > 1e-2)
    # The slider follows when the hand is off it.
    page.wait_for_function(
        'thumb => Math.abs(thumb.getAttribute("aria-valuenow")) < 0.05',
        arg=thumb.element_handle())


def test_fingers_close_by_a_button_and_open_by_another(page, client):
    fingers = client.listen(JointState, 'right/gripper/joint_states', 1)
    for button, position in (('Open', 0.04), ('Close', 0.0)):
        found = page.get_by_role('button', name=button, exact=True)
        act_until(client, lambda on=found: on.dispatch_event('click'),
                  lambda at=position: fingers and abs(fingers[-1].position[0] - at) < 2e-3)


def test_pause_stops_the_time_and_the_page_says_so(page, client, node):
    page.get_by_role('button', name='Pause').dispatch_event('click')
    page.get_by_text('paused at').wait_for()
    assert node.thread.paused
    before = node.thread.progress.time_ns
    page.get_by_role('button', name='Step').dispatch_event('click')
    client.spin_until(lambda: node.thread.progress.time_ns == before + 10_000_000)
    page.get_by_role('button', name='Resume').dispatch_event('click')
    client.spin_until(lambda: not node.thread.paused)


def test_the_picture_goes_back_a_minute_while_the_node_goes_on(page, client, node):
    page.get_by_role('button', name='Last minute').dispatch_event('click')
    act_until(client, lambda: slider(page, 'Seconds').press('Home'),
              lambda: page.get_by_text('before it was stopped').count()
              and 's, 0.00 s before' not in page.content())
    before = node.thread.progress.time_ns
    client.spin_until(lambda: node.thread.progress.time_ns > before)
    page.get_by_role('button', name='Live', exact=True).dispatch_event('click')
    page.get_by_text('before it was stopped').wait_for(state='detached')


#: The first row and the last column of the picture that no panel or notice covers.
ROW, COLUMN = 160, 300


def picture(page):
    """Return what is seen beside the panel and a notice of the browser, shape (m, n, 3)."""
    shown = Image.open(io.BytesIO(page.screenshot())).convert('RGB')
    return np.asarray(shown).astype(int)[ROW:, :COLUMN]


def is_red(pixels):
    """Return where a picture is as red as nothing but the cube."""
    return pixels[..., 0] - pixels[..., 1:].max(axis=2) > 40


def test_the_mouse_lifts_the_cube(page, client, node):
    page.get_by_role('tab', name='View').click(force=True)
    page.get_by_label('Pull', exact=True).dispatch_event('click')
    height = node.simulation.data.body('cube').xpos[2]
    for _ in range(40):
        found = np.argwhere(is_red(picture(page)))
        if len(found) > 60:
            break
    y, x = np.median(found, axis=0) + [ROW, 0]
    page.mouse.move(x, y)
    page.mouse.down()
    # The browser draws a picture for each move, half a second without a graphics card.
    act_until(client, lambda: page.mouse.move(x, y - 95, steps=3),
              lambda: node.simulation.data.body('cube').xpos[2] > height + 0.02)
    page.mouse.up()
    client.spin_until(lambda: not node.simulation.pulls)
    page.get_by_label('Pull', exact=True).dispatch_event('click')
    page.get_by_role('tab', name='Control').click(force=True)


def test_the_picture_shows_the_cube_and_the_robot(page):
    # The cube is the only thing that is red, and little but the mount is as dark. The camera is
    # farther away if it was aimed while an arm was stretched out.
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        pixels = picture(page)
        brightness, red = pixels.max(axis=2), is_red(pixels)
        dark = 255 - brightness > 0.45 * (255 - brightness.min())
        if red.sum() > 90 and dark.sum() > 3000:
            return
        page.wait_for_timeout(500)
    pytest.fail(f'{red.sum()} red and {dark.sum()} dark pixels')


def change_objects(node, change):
    """Change the objects of a node as the services of simulation_interfaces do."""
    simulation = node.simulation

    def serve():
        plan = change(simulation.plan)
        node.thread.call(lambda: simulation.change_objects(plan))
        node.shared.world_changed()
    node.executor.create_task(serve)


def test_an_object_that_is_spawned_comes_into_the_picture_and_goes_with_it(page, node):
    # Beside the cube, on the table.
    box = create_object({'name': 'box', 'shape': 'box', 'size': [0.15, 0.15, 0.15], 'mass': 0.1,
                         'position': [0.1, -0.25, 0.9], 'rgba': [0.0, 1.0, 0.0, 1.0]})

    def greens():
        pixels = picture(page)
        # Light makes it paler; nothing else is greener than red and blue.
        return (pixels[..., 1] - pixels[:, :, ::2].max(axis=2) > 40).sum()

    def wait(condition):
        for _ in range(40):
            if condition(greens()):
                return
            page.wait_for_timeout(500)
        pytest.fail(f'{greens()} green pixels')

    wait(lambda count: count == 0)
    change_objects(node, lambda plan: plan_with(plan, box))
    wait(lambda count: count > 60)
    change_objects(node, lambda plan: plan_without(plan, 'box'))
    wait(lambda count: count == 0)


def leave_pages(browser):
    """Let no page draw: without a graphics card one that nobody looks at takes as much."""
    for context in browser.contexts:
        for page in context.pages:
            page.goto('about:blank')


@pytest.mark.timeout(300)  # Two nodes after each other, and a page for each.
def test_without_a_node_it_waits_and_a_node_that_comes_is_shown_until_it_goes(browser, process):
    leave_pages(browser)
    viewer, address = start_viewer('--node', 'late', '--ros-args', '-r', '__ns:=/cell')
    page = browser.new_page(viewport={'width': 480, 'height': 360})
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script(SLOWLY.format(1000))
    try:
        page.goto(address)
        page.get_by_text('waiting for the node /cell/late').wait_for()
        # It is not pale for ever where it is drawn slowly.
        page.wait_for_function(
            'canvas => ["", "1"].includes(canvas.style.opacity)',
            arg=page.locator('canvas[data-engine]').element_handle())
        for _ in range(2):
            late = process('--ros-args', '-r', '__node:=late', '-r', '__ns:=/cell',
                           '-p', 'robot:=UR5e', '-p', 'gripper:=none')
            page.get_by_text('× real time').wait_for()
            page.get_by_text('arm [rad]').wait_for()
            late.send_signal(signal.SIGINT)
            assert late.wait() == 0
            page.get_by_text('/cell/late is gone').wait_for()
    finally:
        page.close()
        _, errors = end(viewer)
    assert (viewer.returncode, errors) == (0, '')
