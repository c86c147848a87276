# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The command ``sim_view`` where something is missing that it needs."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from manip_sim.errors import ManipSimError
from manip_sim.viewer.__main__ import check_display

#: Run it as if a module were not installed.
WITHOUT = """
import sys
sys.modules[sys.argv[1]] = None
sys.argv[1:] = sys.argv[2:]
from manip_sim.viewer.__main__ import main
sys.exit(main())
"""


def without(module, *arguments):
    return subprocess.run([sys.executable, '-c', WITHOUT, module, *arguments], text=True,
                          capture_output=True, timeout=300.0, check=False)


def test_without_viser_it_says_what_to_install():
    done = without('viser')
    assert done.returncode == 1
    assert done.stderr == ("sim_view: no module 'viser': install it with pip install "
                           "'manip_sim[viewer]'\n")


@pytest.mark.full
def test_without_ros_it_says_where_it_comes_from():
    pytest.importorskip('viser', reason='the viewer needs the extra viewer')
    done = without('rclpy')
    assert done.returncode == 1
    assert "no module 'rclpy': source ROS 2 Jazzy" in done.stderr
    assert done.stderr.count('\n') == 1


def test_without_a_screen_the_window_is_rejected(monkeypatch):
    if sys.platform != 'linux':
        pytest.skip('other systems have a screen')
    for name in ('DISPLAY', 'WAYLAND_DISPLAY'):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ManipSimError, match='--native needs a screen'):
        check_display()
    monkeypatch.setenv('DISPLAY', ':0')
    check_display()


def test_without_a_screen_the_process_says_so_in_one_line():
    bare = {name: value for name, value in os.environ.items()
            if name not in ('DISPLAY', 'WAYLAND_DISPLAY')}
    if sys.platform != 'linux':
        pytest.skip('other systems have a screen')
    done = subprocess.run([sys.executable, '-m', 'manip_sim.viewer', '--native'], text=True,
                          capture_output=True, timeout=300.0, check=False, env=bare)
    assert done.returncode == 1
    assert done.stderr.startswith('sim_view: --native needs a screen')
    assert done.stderr.count('\n') == 1


def test_an_unknown_option_is_a_wrong_command_line():
    done = subprocess.run([sys.executable, '-m', 'manip_sim.viewer', '--prot', '1'], text=True,
                          capture_output=True, timeout=300.0, check=False)
    assert done.returncode == 2


def test_an_error_of_the_page_is_logged_and_the_next_round_comes(monkeypatch):
    pytest.importorskip('rclpy', reason='the viewer needs ROS 2')
    from manip_sim.viewer import session
    rounds, logged, waits = [], [], []

    class Failing:
        def __init__(self, *_, **__):
            pass

        def update(self, now_s):
            rounds.append(now_s)
            raise ValueError('another model')

        def close(self):
            rounds.append('closed')
    for name in ('open_server', 'page_address', 'close_server'):
        monkeypatch.setattr(session, name, lambda *_: None)
    monkeypatch.setattr(session, 'Session', Failing)
    readers = SimpleNamespace(log=SimpleNamespace(failure=lambda *told: logged.append(told)))
    options = SimpleNamespace(
        allow_host=[], listen='', port=0, dark=False, no_commands=False, poses=None,
        records=None)
    session._serve(None, readers, 'sim', SimpleNamespace(run_ready=lambda: None), options,
                   SimpleNamespace(wait=lambda most_s: waits.append(most_s) or len(rounds) == 3))
    assert max(waits) < len(waits) * session._PERIOD_S
    assert len(rounds) == 4 and rounds[3] == 'closed'
    assert [(kind, what, str(error)) for kind, what, error in logged] == [
        ('callbacks', 'the page', 'another model')] * 3
