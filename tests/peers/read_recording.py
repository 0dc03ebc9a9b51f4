"""Reads a recording with rosbags and with mcap-ros2-support and compares what they see.

Usage: read_recording.py FILE

Prints one JSON object: messages by topic as each of them decodes them, messages that have no ROS 2 type, and where they
disagree. Exits with 1 when they disagree or when a message cannot be decoded.
"""

import json
import sys
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

# Of every topic, this many messages are compared field by field; the rest are decoded and counted.
COMPARED = 1000


def plain(value):
    """A decoded message as lists, numbers and texts, whichever library decoded it."""
    if is_dataclass(value):
        # Constants of a message are in capitals; its type name begins with an underscore.
        names = [field.name for field in fields(value) if not field.name.startswith("_") and not field.name.isupper()]
        return [plain(getattr(value, name)) for name in names]
    if hasattr(value, "__slots__"):
        return [plain(getattr(value, name)) for name in value.__slots__]
    if isinstance(value, numpy.ndarray):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(element) for element in value]
    return value


def by_rosbags(path):
    """Counts, times with first contents by topic, and counts of what has no type."""
    counts, contents, raw = Counter(), {}, Counter()
    with AnyReader([path]) as reader:
        for connection, log_time, payload in reader.messages():
            if connection.ext.serialization_format != "cdr":
                raw[connection.topic] += 1
                continue
            message = reader.deserialize(payload, connection.msgtype)
            counts[connection.topic] += 1
            kept = contents.setdefault(connection.topic, [])
            if len(kept) < COMPARED:
                kept.append((log_time, plain(message)))
    return counts, contents, raw


def by_mcap_ros2(path):
    """The same with mcap and mcap-ros2-support."""
    counts, contents, raw = Counter(), {}, Counter()
    factory, decoders = DecoderFactory(), {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.id not in decoders:
                decoders[channel.id] = factory.decoder_for(channel.message_encoding, schema)
            decode = decoders[channel.id]
            if decode is None:
                raw[channel.topic] += 1
                continue
            decoded = decode(message.data)
            counts[channel.topic] += 1
            kept = contents.setdefault(channel.topic, [])
            if len(kept) < COMPARED:
                kept.append((message.log_time, plain(decoded)))
    return counts, contents, raw


def disagreements(ours, theirs):
    """One line for each topic on which the two differ."""
    lines = []
    for what, a, b in (("messages", ours[0], theirs[0]), ("untyped messages", ours[2], theirs[2])):
        for topic in sorted(a.keys() | b.keys()):
            if a[topic] != b[topic]:
                lines.append(f"{topic}: {a[topic]} {what} by rosbags, {b[topic]} by mcap_ros2")
    for topic in sorted(ours[1].keys() & theirs[1].keys()):
        for index, (a, b) in enumerate(zip(ours[1][topic], theirs[1][topic])):
            if a != b:
                lines.append(f"{topic}: message {index} is {a} by rosbags, {b} by mcap_ros2")
                break
    return lines


def main():
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    path = Path(sys.argv[1])
    ours, theirs = by_rosbags(path), by_mcap_ros2(path)
    lines = disagreements(ours, theirs)
    compared = {topic: len(kept) for topic, kept in sorted(ours[1].items())}
    result = {
        "file": path.name,
        "rosbags": dict(sorted(ours[0].items())),
        "mcap_ros2": dict(sorted(theirs[0].items())),
        "untyped": dict(sorted(ours[2].items())),
        "compared": compared,
        "disagreements": lines,
    }
    print(json.dumps(result, indent=2))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
