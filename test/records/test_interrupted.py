# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Writers that end before their record does, and files that are damaged."""

import dataclasses
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import tracemalloc

from hypothesis import example, given, HealthCheck, settings
from hypothesis import strategies as st
import pytest

from manip_sim.cli.main import main
from manip_sim.errors import RecordError

for needed in ('mcap', 'mcap_ros2', 'rosbags'):
    pytest.importorskip(needed, reason='needs the extras records and test')

from mcap.reader import NonSeekingReader  # noqa: E402

from manip_sim.records.record_file import definition, encoder, RecordFile  # noqa: E402
from manip_sim.records.recorded import _KEYS, check_about, Record  # noqa: E402

WRITER = """
import sys
from pathlib import Path
from manip_sim.errors import ManipSimError
from manip_sim.records import EpisodeRecorder
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode

task = create_task('reach', 'Panda')
episode = Episode(task, Simulation(task.world))
try:
    with EpisodeRecorder(Path(sys.argv[1]), episode) as recorder:
        for seed in range(1000):
            episode.reset(seed)
            recorder.begin(seed)
            for period in range(12):
                episode.step([0.1] * 7)
                recorder.period([0.1] * 7)
                print(seed, period, flush=True)
            recorder.end()
except ManipSimError as error:
    sys.exit(str(error))
"""


def readable_messages(path):
    """Return how many messages the reader of the library mcap finds before it gives up."""
    count = 0
    try:
        with path.open('rb') as file:
            for _ in NonSeekingReader(file).iter_messages(log_time_order=False):
                count += 1
    except Exception:  # It raises whatever it comes upon at the end.
        pass
    return count


@pytest.mark.full
def test_a_killed_writer_leaves_a_record_that_is_read_and_verified_up_to_there(tmp_path, capsys):
    path = tmp_path / 'killed.mcap'
    with subprocess.Popen([sys.executable, '-c', WRITER, str(path)], stdout=subprocess.PIPE,
                          text=True) as writer:
        for line in writer.stdout:
            if line == '2 6\n':
                writer.kill()
                break
    record = Record(path)
    episodes = list(record.episodes())
    assert record.cut_off and len(episodes) >= 2
    assert all(recorded.result is not None for recorded in episodes[:2])
    assert readable_messages(path) > 200
    assert main(['replay', '--verify', str(path)]) == 1
    assert capsys.readouterr().out == (
        f'{path}: the file ends early, and was read up to there\n'
        f'{len(episodes)} of {len(episodes)} equal\n')


@pytest.mark.full
def test_a_full_disk_is_one_line_and_leaves_whole_chunks(tmp_path, capsys):
    path = tmp_path / 'full.mcap'
    done = subprocess.run(
        [sys.executable, '-c', WRITER, str(path)], capture_output=True, text=True, timeout=100,
        # What coverage would write is larger too.
        env={name: value for name, value in os.environ.items() if 'COVERAGE' not in name},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)))
    assert done.returncode == 1
    assert done.stderr == (f'{path}: File too large; what was recorded before can be read\n')
    assert 30_000 < path.stat().st_size <= 60_000
    record = Record(path)
    episodes = list(record.episodes())
    assert record.cut_off and episodes[0].result is not None
    assert main(['replay', '--verify', str(path)]) == 1
    assert f'\n{len(episodes)} of {len(episodes)} equal\n' in capsys.readouterr().out


@pytest.mark.full
@pytest.mark.skipif(os.geteuid() != 0, reason='only root can mount a small file system')
def test_a_file_system_that_is_full_is_the_same(tmp_path):
    if subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=60k', 'tmpfs', str(tmp_path)],
                      capture_output=True).returncode:
        pytest.skip('no file system can be mounted here')
    try:
        path = tmp_path / 'full.mcap'
        done = subprocess.run([sys.executable, '-c', WRITER, str(path)], capture_output=True,
                              text=True, timeout=100)
        assert 'No space left on device; what was recorded before can be read' in done.stderr
        assert next(Record(path).episodes()).result is not None
    finally:
        subprocess.run(['umount', str(tmp_path)], check=True)


def test_every_cut_is_read_up_to_there(recording, tmp_path):
    content = recording.read_bytes()
    path = tmp_path / 'cut.mcap'
    seen = set()
    for size in [*range(0, len(content), 2503), len(content) - 1, len(content)]:
        path.write_bytes(content[:size])
        record = Record(path)
        try:
            episodes = list(record.episodes())
        except RecordError as error:
            assert str(error).startswith(f'{path}: ') and '\n' not in str(error)
            assert 'no MCAP file' in str(error) or 'ends early' in str(error)
            seen.add(0)
        else:
            seen.add(len(episodes))
            assert record.cut_off or episodes[-1].result is not None
    assert seen == {0, 1, 2}


@pytest.mark.full
@settings(max_examples=60, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(flips=st.lists(st.tuples(st.integers(0, 2**20), st.integers(0, 255)), min_size=1,
                      max_size=4), cut=st.booleans())
@example(flips=[(9, 255)], cut=False)
def test_flipped_bytes_are_an_error_in_one_line_with_bounded_memory(
        recording, tmp_path, flips, cut):
    content = bytearray(recording.read_bytes())
    for place, value in flips:
        content[place % len(content)] = value
    path = tmp_path / 'flipped.mcap'
    path.write_bytes(content[:-8] if cut else content)
    tracemalloc.start()
    try:
        for recorded in Record(path).episodes():
            assert len(recorded.actions) <= len(recorded.states)
            assert recorded.digests is not None
    except RecordError as error:
        assert '\n' not in str(error)
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 2**28


@settings(max_examples=30, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300), magic=st.booleans())
def test_what_is_no_record_is_an_error(tmp_path, content, magic):
    path = tmp_path / 'random.mcap'
    path.write_bytes((b'\x89MCAP0\r\n' if magic else b'') + content)
    with pytest.raises(RecordError):
        list(Record(path).episodes())


TEXTS = st.text(max_size=9) | st.floats().map(str) | st.integers().map(str) | st.sampled_from([
    '5e-324', '1e300', '[]', '{}', 'null', '{"robot": 5}', '[[1]]', '"x"', '[' * 10**5])


@given(changes=st.dictionaries(st.sampled_from(_KEYS + ('format', 'drawn', 'noise')), TEXTS,
                               min_size=1, max_size=3))
@example(changes={'period_s': '5e-324'})
@example(changes={'format': '2'})
def test_an_episode_that_is_described_by_anything_is_read_or_an_error_in_one_line(
        recording, changes):
    first = next(Record(recording).episodes())
    about = {**first.about, **changes}
    try:
        check_about(about)
        found = dataclasses.replace(first, about=about)
        assert isinstance(found.digests, dict) and found.period_s > 0.0
        assert isinstance(found.number, int) and isinstance(found.seed, int)
        assert all(isinstance(found.json(key), dict) for key in (
            'arguments', 'latency', 'settings', 'drawn', 'noise'))
    except RecordError as error:
        assert '\n' not in str(error) and len(str(error)) < 1000


def test_a_flipped_bit_in_a_complete_record_is_found(recording, tmp_path, capsys):
    content = bytearray(recording.read_bytes())
    path = Path(tmp_path, 'flipped.mcap')
    place = content.index(b'manip_sim/episode') + 40
    content[place] ^= 1
    path.write_bytes(content)
    assert main(['replay', '--verify', str(path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f'manip_sim: {path}: ') and error.count('\n') == 1


def test_a_chunk_that_unpacks_to_more_than_it_says_is_not_unpacked(tmp_path):
    import lz4.frame
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, Header
    builder = RecordBuilder()
    Header('ros2', 'x').write(builder)
    Chunk('lz4', lz4.frame.compress(bytes(2**27)), 0, 0, 0, 100).write(builder)
    path = tmp_path / 'bomb.mcap'
    path.write_bytes(b'\x89MCAP0\r\n' + builder.end())
    tracemalloc.start()
    with pytest.raises(RecordError, match='a chunk does not have the size that it states'):
        list(Record(path).episodes())
    assert tracemalloc.get_traced_memory()[1] < 2**23
    tracemalloc.stop()


@pytest.mark.full
def test_an_interrupted_command_ends_without_a_traceback(recording, tmp_path):
    files = [str(recording)] * 200
    with subprocess.Popen([sys.executable, '-m', 'manip_sim.cli', 'convert', *files, '--to',
                           'hdf5', str(tmp_path / 'out.hdf5')], stderr=subprocess.PIPE,
                          text=True) as command:
        try:
            command.wait(4)
        except subprocess.TimeoutExpired:
            command.send_signal(signal.SIGINT)
        assert 'Traceback' not in command.stderr.read()
    assert command.returncode != 2  # The command line is right.
    assert not (tmp_path / 'out.hdf5').exists() or command.returncode == 0


def test_what_was_written_is_in_the_file_after_a_second_without_further_messages(
        tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr('time.monotonic', lambda: now[0])
    file = RecordFile(tmp_path / 'latched.mcap')
    channel = file.channel('/text', 'std_msgs/msg/String', definition('std_msgs/String'))
    file.write(channel, 0, encoder('std_msgs/String')({'data': 'a'}))
    now[0] = 0.9
    file.flush_when_due()
    assert readable_messages(file.path) == 0
    now[0] = 1.1
    file.flush_when_due()
    assert readable_messages(file.path) == 1
