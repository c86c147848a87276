# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records of somebody who wants to do harm: one line that names the file, and nothing written."""

from dataclasses import replace
from functools import cache
import io
import json
import os
import re
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

pytestmark = pytest.mark.full

for needed in ('mcap', 'mcap_ros2', 'pyarrow', 'av', 'h5py'):
    pytest.importorskip(needed, reason='needs the extra records')

from hostile_records import about, content, encoded, model, rewrite, topic  # noqa: E402
from mcap.records import Message  # noqa: E402

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import RecordError  # noqa: E402
from manip_sim.records import converting  # noqa: E402
from manip_sim.records.record_file import definition, RecordFile  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402
from manip_sim.viewer.playback import entries_in  # noqa: E402

IMAGES, JOINTS, ACTION = '/front/color/image_raw/compressed', '/joint_states', '/episode/action'
EEF_POSE = '/right/eef_pose'


def png(width, height):
    """Return a black image of one bit per pixel."""
    def chunk(name, data):
        return struct.pack('>I', len(data)) + name + data + struct.pack(
            '>I', zlib.crc32(name + data))
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', width, height, 1, 0, 0,
                                                              0, 0))
            + chunk(b'IDAT', zlib.compress(bytes(((width + 7) // 8 + 1) * height), 9))
            + chunk(b'IEND', b''))


def images(data):
    return content(IMAGES, encoded('sensor_msgs/CompressedImage', format='png', data=data,
                                   header={'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': ''}))


def joints(names, positions):
    return content(JOINTS, encoded(
        'sensor_msgs/JointState', name=names, position=positions, velocity=positions, effort=[],
        header={'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': ''}))


def numbers(name, values):
    return content(name, encoded('std_msgs/Float64MultiArray', data=values,
                                 layout={'dim': [], 'data_offset': 0}))


def archive(xml):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, 'w', zipfile.ZIP_DEFLATED) as file:
        file.writestr('model.xml', xml)
    return model(stream.getvalue())


def when_used(make):
    """Return a change that is made when it is used first: not in each process that finds tests."""
    made = cache(make)
    return lambda item, of: made()(item, of)


NO_TOPIC, NO_USE = 'cannot be the name of a topic', 'the description of an episode cannot be used'
CASES = {
    'a camera above the folder': (topic(IMAGES, f'/../../../evil{IMAGES[6:]}'), NO_TOPIC),
    'a camera behind another': (topic(IMAGES, f'/a/../../../../evil{IMAGES[6:]}'), NO_TOPIC),
    'a camera that is the folder': (topic(IMAGES, f'/.{IMAGES[6:]}'), NO_TOPIC),
    'a camera with a null character': (topic(IMAGES, f'/a\0b{IMAGES[6:]}'), NO_TOPIC),
    'a camera with a line end': (topic(IMAGES, f'/a\nb{IMAGES[6:]}'), NO_TOPIC),
    'a long camera': (topic(IMAGES, f'/{"a" * 5000}{IMAGES[6:]}'), NO_TOPIC),
    'an object without a name': (topic(EEF_POSE, '/objects/pose'), 'does not say of what it is'),
    'robots that are numbers': (about(robots='{"a": 5}'), NO_USE),
    'joints that are numbers': (about(robots='{"a": {"right_gripper": 5}}'), NO_USE),
    'joints that are lists': (about(robots='{"a": {"right_gripper": [[1]]}}'), NO_USE),
    'names that are numbers': (about(action_names='[1, 2, 3, 4, 5, 6, {}]'), NO_USE),
    'deep arguments': (about(arguments=f'{{"a": {"[" * 900}{"]" * 900}}}'), NO_USE),
    'a period of weeks': (about(period_s='1e6'), NO_USE),
    'steps before the begin': (about(steps='-5'), NO_USE),
    'a huge seed': (about(seed=str(10**30)), 'data sets hold whole numbers below 2'),
    'an image of 144 megapixels': (
        when_used(lambda: images(png(12000, 12000))), 'it has too many pixels'),
    'an image of 81 megapixels': (
        when_used(lambda: images(png(9000, 9000))), 'it has 9000 times 9000 pixels'),
    'an image that is text': (images(b'#!/bin/sh'), 'image of front .* neither JPEG nor PNG'),
    'an image that is cut off': (images(png(64, 48)[:20]), 'image of front cannot be read'),
    'no numbers in an action': (numbers(ACTION, []), 'has no actions'),
    'an action without end': (numbers(ACTION, [np.inf] * 7), 'action has numbers .* not finite'),
    'a reward that is no number': (content('/episode/reward', encoded(
        'std_msgs/Float64', data=np.nan)), 'reward has numbers that are not finite'),
    'a joint that is nowhere': (joints(['a'], [np.nan]), 'joint_states has numbers that are not'),
    'more joints than it has': (content(JOINTS, b'\0\1\0\0' + struct.pack(
        '<5I', 0, 0, 1, 0, 2**32 - 1)), 'JointState cannot be read')}
MODELS = {
    'a model that unpacks to much': (
        when_used(lambda: archive(b' ' * 2**28)), 'at most 67108864 are unpacked'),
    'a model with null characters': (archive(b'\0<mujoco/>'), 'it is no text')}


def check_one_line(capsys, path, message):
    error = capsys.readouterr().err
    assert error.startswith(f'manip_sim: {path}: ') and error.count('\n') == 1
    assert re.search(message, error) and len(error) < 1000


@pytest.mark.parametrize('case, target', [
    *((case, target) for case in CASES for target in ('lerobot', 'hdf5')),
    *((case, 'hdf5') for case in MODELS)])
def test_a_hostile_record_is_one_line_and_nothing_is_written(
        recording, tmp_path, capsys, case, target):
    change, message = {**CASES, **MODELS}[case]
    folder = tmp_path / 'a' / 'b' / 'c'
    folder.mkdir(parents=True)
    path = rewrite(recording, folder / 'record.mcap', change)
    there = {*tmp_path.rglob('*')}
    assert main(['convert', str(path), '--to', target, str(folder / 'set')]) == 1
    check_one_line(capsys, path, message)
    assert {*tmp_path.rglob('*')} == there


@pytest.mark.parametrize('size', [12000, 8500])
def test_the_pixels_of_an_image_that_is_too_large_are_not_unpacked(recording, tmp_path, size):
    path = rewrite(recording, tmp_path / 'a.mcap', images(png(size, size)))
    frames = converting.Frames(next(Record(path).episodes()))
    tracemalloc.start()
    with pytest.raises(RecordError, match='pixels'):
        list(frames.images('front'))
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


def test_a_model_that_unpacks_to_much_takes_no_memory(recording, tmp_path, capsys):
    path = rewrite(recording, tmp_path / 'a.mcap', archive(b' ' * 2**28))
    tracemalloc.start()
    main(['replay', str(path)])
    assert main(['convert', str(path), '--to', 'hdf5', str(tmp_path / 'set')]) == 1
    assert tracemalloc.get_traced_memory()[1] < 2**26
    tracemalloc.stop()


def test_messages_without_content_count_too(recording, tmp_path, monkeypatch):
    monkeypatch.setattr('manip_sim.records.recorded.MAX_BYTES', 2**24)

    def many(item, of):
        return [replace(item, data=b'')] * 50_000 if of == '/episode/digest' and isinstance(
            item, Message) else item
    path = rewrite(recording, tmp_path / 'a.mcap', many)
    with pytest.raises(RecordError, match='has more than 16777216 bytes'):
        list(Record(path).episodes())


def test_a_pipe_is_no_record(tmp_path, capsys):
    path = tmp_path / 'pipe.mcap'
    os.mkfifo(path)
    assert main(['replay', str(path)]) == 1
    assert capsys.readouterr().err == f'manip_sim: {path}: it is a device or a pipe\n'
    assert main(['replay', str(tmp_path)]) == 1


def test_two_topics_of_one_end_effector_are_an_error(recording):
    episode = next(Record(recording).episodes())
    (robot,) = converting.Frames(episode).robots
    other = f'/{robot}{EEF_POSE}'
    with pytest.raises(RecordError, match=f"{other} is of '{robot}/right', as another topic is"):
        converting.Frames(replace(
            episode, types={**episode.types, other: episode.types[EEF_POSE]},
            messages={**episode.messages, other: episode.messages[EEF_POSE]}))


def test_a_task_of_a_record_that_is_no_path_is_one_line(recording, tmp_path, capsys):
    path = rewrite(recording, tmp_path / 'a.mcap', about(task='\0../task.yaml'))
    assert main(['replay', str(path)]) == 1
    check_one_line(capsys, path, 'unknown task ')


def test_a_data_set_that_another_process_has_written_meanwhile_is_kept(
        recording, tmp_path, capsys, monkeypatch):
    target = tmp_path / 'set.hdf5'

    def write(frames, path):
        periods = converting.write_hdf5(frames, path)
        assert path.name != target.name and [*tmp_path.glob('*')] != [target]
        target.write_text('precious')
        return periods
    monkeypatch.setitem(converting.FORMATS, 'hdf5', write)
    assert main(['convert', str(recording), '--to', 'hdf5', str(target)]) == 1
    assert capsys.readouterr().err == (
        f'manip_sim: {target} is there by now, and is not overwritten\n')
    assert [item.name for item in tmp_path.iterdir()] == ['set.hdf5']
    assert target.read_text() == 'precious'


def test_what_two_processes_have_begun_of_one_data_set_are_two_files(
        recording, tmp_path, monkeypatch):
    begun = []

    def write(frames, path):
        begun.append(path)
        if len(begun) == 1:
            converting.convert([recording], 'hdf5', tmp_path / 'set')
            (tmp_path / 'set').unlink()
        return converting.write_hdf5(frames, path)
    monkeypatch.setitem(converting.FORMATS, 'hdf5', write)
    converting.convert([recording], 'hdf5', tmp_path / 'set')
    assert len({*begun}) == 2 and [*tmp_path.iterdir()] == [tmp_path / 'set']


def test_a_large_file_of_zeros_is_given_up_soon(tmp_path, capsys):
    path = tmp_path / 'zeros.mcap'
    with open(path, 'wb') as file:
        file.write(b'\x89MCAP0\r\n')
        file.truncate(10 << 30)
    for verb in (['replay', '--verify'], ['convert', '--to', 'hdf5', str(tmp_path / 'a.hdf5')]):
        assert main([verb[0], str(path), *verb[1:]]) == 1
        error = capsys.readouterr().err
        assert error.count('\n') == 1 and 'no record of a known kind' in error


def journal(path, start, *entries):
    """Write a record of a node that has nothing but a journal."""
    file = RecordFile(path)
    file.describe('manip_sim/node', {'node': '/manip_sim', 'manip_sim': '0', 'mujoco': '0',
                                     'parameters': '{}', 'begin_ns': '0'})
    channel = file.channel('/manip_sim/journal', 'std_msgs/msg/String', definition(
        'std_msgs/String'))
    text = json.dumps({'number': 0, 'entries': [['start', start, {}], *entries]})
    file.write(channel, 0, encoded('std_msgs/String', data=text))
    file.close()


BALLS = [f'{{shape: sphere, name: b{n}, size: [0.1]}}' for n in range(20000)]


@pytest.mark.parametrize('parameters, objects, text', [
    ({'objects': BALLS}, [], "the parameter 'objects' has 20000 items, and at most 1000"),
    ({'cameras': BALLS}, [], "the parameter 'cameras' has 20000 items, and at most 1000"),
    ({'robots': [f'r{n}' for n in range(200)]}, [],
     "the parameter 'robots' has 200 items, and at most 32"),
    ({}, [['b', 'x', None, None, None]] * 20000, 'the record has 20000 objects, and at most 1000'),
])
def test_a_journal_that_asks_for_very_many_things_takes_neither_memory_nor_time(
        parameters, objects, text, tmp_path, capsys):
    path = tmp_path / 'bomb.mcap'
    journal(path, {'parameters': {'robot': 'Panda', **parameters}, 'task_seed': None,
                   'objects': objects})
    tracemalloc.start()
    try:
        assert main(['replay', str(path), '--verify']) == 1
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    captured = capsys.readouterr()
    assert text in captured.out + captured.err
    assert most < 100e6


def test_a_text_of_very_many_items_takes_little_more_memory_than_itself(
        recording, tmp_path, capsys):
    text = f'[{"[]," * 4_000_000}[]]'
    journal(tmp_path / 'journal.mcap', {}, [text])
    path = rewrite(recording, tmp_path / 'episode.mcap', about(arguments=text))
    for arguments in (['replay', str(tmp_path / 'journal.mcap')],
                      ['convert', str(path), '--to', 'hdf5', str(tmp_path / 'set')]):
        tracemalloc.start()
        assert main(arguments) == 1
        assert tracemalloc.get_traced_memory()[1] < 8 * len(text)
        tracemalloc.stop()
        assert 'cannot be read: it has more than 5000000 items' in capsys.readouterr().err


def test_a_damaged_record_among_others_is_told_and_the_others_are_shown(recording, tmp_path):
    damaged = tmp_path / 'damaged.mcap'
    damaged.write_bytes(recording.read_bytes()[:100])
    told = []
    entries = entries_in([damaged, recording], told.append)
    assert {entry.path for entry in entries} == {recording}
    assert len(told) == 1 and str(damaged) in told[0]
    with pytest.raises(RecordError, match=re.escape(str(damaged))):
        entries_in([damaged], told.append)
