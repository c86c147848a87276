# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Announcements of a node in a domain whose participants find each other by unicast."""

from collections import Counter
import contextlib
import os
from pathlib import Path
import socket

from manip_sim.ros_environment import set_discovery_profile
from manip_sim.testing.domains import reserve_domain
import pytest

#: Participant of the domain that the test plays: its port gets the announcements of all others.
_PARTICIPANT = 9
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')


@pytest.fixture
def announcements():
    """Return a socket that gets announcements of a domain, and the domain."""
    domain, reserved = reserve_domain()
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as port:
        port.bind(('127.0.0.1', 7400 + 250 * domain + 10 + 2 * _PARTICIPANT))
        port.settimeout(60.0)
        yield port, domain
    os.close(reserved)


def test_a_node_announces_itself_often_so_that_a_client_that_missed_an_answer_finds_it(
        announcements, sim_process, monkeypatch):
    port, domain = announcements
    for variable in _VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    sim_process()
    times = Counter()
    # Fast DDS starts with six announcements in half a second, and repeats them each 3 s then.
    port.recv(65536)
    port.settimeout(2.5)
    while sum(times.values()) < 12:
        times[port.recv(65536)[8:20]] += 1
    assert len(times) == 1


def chosen(monkeypatch, **environment):
    """Return the profiles that are set in an environment."""
    for name in _VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **environment}.items():
        monkeypatch.setenv(name, value)
    set_discovery_profile()
    return [os.environ.get(name) for name in _VARIABLES]


def test_both_releases_of_fast_dds_have_a_profile(monkeypatch):
    file, other = chosen(monkeypatch)
    assert file == other and Path(file).is_file()


@pytest.mark.parametrize('variable', _VARIABLES)
def test_a_profile_of_the_user_stays(variable, monkeypatch):
    assert [file for file in chosen(monkeypatch, **{variable: 'mine.xml'}) if file] == ['mine.xml']


def test_a_profile_in_the_folder_stays(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').touch()
    assert chosen(monkeypatch) == [None, None]


def test_a_network_is_not_flooded(monkeypatch):
    assert chosen(monkeypatch, ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET') == [None, None]
