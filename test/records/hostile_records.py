# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Change what is in a record as somebody who wants to do harm would."""

from dataclasses import replace

from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import CompressionType, Writer

from manip_sim.records.record_file import encoder


def encoded(kind, **content):
    """Return a message as CDR."""
    return encoder(kind)(content)


def rewrite(source, target, change):
    """
    Write a record in which each item is what a function returns for it.

    :param change: takes Attachment, Channel, Message or Metadata and, of messages, the topic; a
        list in place of an item is written item by item
    """
    topics = {}
    with source.open('rb') as read, target.open('wb') as written:
        writer = Writer(written, compression=CompressionType.LZ4)
        writer.start('ros2', 'x')
        for record in StreamReader(read, emit_chunks=True).records:
            for item in breakup_chunk(record) if isinstance(record, Chunk) else [record]:
                if isinstance(item, Schema):
                    writer.register_schema(item.name, item.encoding, item.data)
                elif isinstance(item, Channel):
                    topics.setdefault(item.id, item.topic)
                    if len(topics) == item.id:
                        writer.register_channel(change(item, '').topic, 'cdr', item.schema_id)
                elif isinstance(item, DataEnd):
                    break
                elif isinstance(item, (Attachment, Message, Metadata)):
                    found = change(item, topics.get(getattr(item, 'channel_id', 0), ''))
                    for one in found if isinstance(found, list) else [found]:
                        _write(writer, one)
        writer.finish()
    return target


def _write(writer, item):
    if isinstance(item, Message):
        writer.add_message(item.channel_id, item.log_time, item.data, item.publish_time)
    elif isinstance(item, Metadata):
        writer.flush()
        writer.add_metadata(item.name, item.metadata)
    else:
        writer.flush()
        writer.add_attachment(0, 0, item.name, item.media_type, item.data)


def about(**changes):
    """Return a change of what is said of episodes."""
    def change(item, _):
        return replace(item, metadata={**item.metadata, **changes}) if isinstance(
            item, Metadata) and item.name == 'manip_sim/episode' else item
    return change


def topic(old, new):
    """Return a change of the name of a topic."""
    return lambda item, _: replace(item, topic=new) if isinstance(
        item, Channel) and item.topic == old else item


def content(name, data):
    """Return a change of all messages of a topic."""
    return lambda item, of: replace(item, data=data) if of == name else item


def model(data):
    """Return a change of the model."""
    return lambda item, _: replace(item, data=data) if isinstance(item, Attachment) else item
