#!/usr/bin/env bash
# Who reads a finished MCAP whose summary leaves out what a summary may leave out? The writer of mcap has a switch for each.
# Guess: mcap reads all of them, rosbags refuses some. Seen with mcap 1.6.0 and rosbags 0.11.9 on 2026-11-28:
# - no index of messages (index_types=CHUNK): mcap yields all 100 messages; rosbags announces 100 and yields none, without an error.
# - channels not repeated (repeat_channels=False): rosbags announces 100 and yields none; mcap's own reader raises KeyError: 1.
# - neither channels nor schemas repeated: rosbags yields all 100, mcap raises KeyError: 1.
# - no statistics, no index of chunks, nothing at all, or no chunks: both read everything.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0 rosbags==0.11.9
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from rosbags.highlevel import AnyReader

TEXT = b"\0\1\0\0\3\0\0\0hi\0"  # a std_msgs/String in CDR


def write(path, options):
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=400, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for number in range(100):
            writer.add_message(channels[number % 2], number, TEXT, number)
        writer.finish()


def by_mcap(path):
    try:
        with path.open("rb") as stream:
            return sum(1 for _ in make_reader(stream).iter_messages())
    except KeyError as err:
        return f"KeyError: {err}"


def by_rosbags(path):
    with AnyReader([path]) as reader:
        return reader.message_count, sum(1 for _ in reader.messages())


nothing = {"index_types": IndexType.NONE, "use_statistics": False, "repeat_channels": False, "repeat_schemas": False}
expected = {
    "everything": ({}, 100, (100, 100)),
    "no statistics": ({"use_statistics": False}, 100, (100, 100)),
    "no index of chunks": ({"index_types": IndexType.MESSAGE}, 100, (100, 100)),
    "no index of messages": ({"index_types": IndexType.CHUNK}, 100, (100, 0)),
    "no channels": ({"repeat_channels": False}, "KeyError: 1", (100, 0)),
    "no channels, no schemas": ({"repeat_channels": False, "repeat_schemas": False}, "KeyError: 1", (100, 100)),
    "nothing": (nothing, 100, (100, 100)),
    "no chunks": ({"use_chunking": False}, 100, (100, 100)),
}
for number, (name, (options, mcap, rosbags)) in enumerate(expected.items()):
    path = Path(f"{number}.mcap")
    write(path, options)
    seen = by_mcap(path), by_rosbags(path)
    print(f"{name}: mcap {seen[0]}, rosbags announces {seen[1][0]} and yields {seen[1][1]}")
    assert seen == (mcap, rosbags), name
PYTHON
