"""One flipped bit where a file says what is in it: no message disappears without a word, and none more than it has to."""

import sqlite3

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer

from bagassets.recordings.salvage.examine import examine
from bagassets_tests.recorded_bags import NOON_NS, ROS1, SECOND, text, write_ros2

pytestmark = pytest.mark.once

NUMBER = 8


def write_bag(path):
    writer = Rosbag1Writer(path)
    writer.chunk_threshold = 60  # two messages
    string = ROS1.types["std_msgs/msg/String"]
    with writer:
        both = [writer.add_connection(topic, "std_msgs/msg/String", typestore=ROS1) for topic in ("/a", "/b")]
        for number in range(NUMBER):
            data = ROS1.serialize_ros1(string(f"message {number} of several"), "std_msgs/msg/String")
            writer.write(both[number % 2], NOON_NS + number * SECOND, data)
    return path


def write_mcap(path, *, has_checksums=True):
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=100, compression=CompressionType.NONE, enable_crcs=has_checksums)
        writer.start("", "")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        both = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for number in range(NUMBER):
            text = f"message {number} of several\0".encode()
            data = b"\0\1\0\0" + len(text).to_bytes(4, "little") + text
            writer.add_message(both[number % 2], NOON_NS + number * SECOND, data, NOON_NS)
        writer.finish()
    return path


def flipped(data, place, bit):
    changed = bytearray(data)
    changed[place] ^= 1 << bit
    return changed


def places_after(data, name, size):
    at = data.find(name)
    while at >= 0:
        yield from range(at + len(name), at + len(name) + size)
        at = data.find(name, at + 1)


def mcap_records(data):
    at = 8
    while at < len(data) - 8:
        yield at
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")


def read_of(path):
    """Return how many messages can be read, after asking whether what is said about the others is true."""
    found = examine(path)
    read = sum(number for _, number in found.topics.values())
    if found.damage is None:
        assert read == (NUMBER if found.verdict == "sound" else 0)
        return read
    assert found.damage.findings or found.damage.holes or found.damage.lost or read == NUMBER
    assert read == NUMBER or not found.damage.is_complete
    if found.damage.is_total_known:
        assert read + sum(found.damage.lost.values()) == NUMBER
    return read


@pytest.mark.parametrize(
    "name", [b"index_pos=", b"chunk_count=", b"conn_count=", b"conn=", b"op=", b"\0count="]
)
def test_what_a_bag_says_of_its_content(tmp_path, name):
    path = write_bag(tmp_path / "a.bag")
    data = path.read_bytes()
    for place in places_after(data, name, {b"index_pos=": 8, b"chunk_count=": 4}.get(name, 1)):
        for bit in range(8):
            path.write_bytes(flipped(data, place, bit))
            least = 0 if name in {b"op=", b"conn=", b"\0count="} else NUMBER - 2
            assert read_of(path) >= least, (place, bit)


def test_what_the_summary_of_an_mcap_says(tmp_path):
    path = write_mcap(tmp_path / "a.mcap")
    data = path.read_bytes()
    (end_of_data,) = (at for at in mcap_records(data) if data[at] == 0x0F)
    for place in range(end_of_data, len(data)):
        path.write_bytes(flipped(data, place, place % 8))
        assert read_of(path) == NUMBER, place


def test_channels_of_the_summary_of_an_mcap_without_checksums(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", has_checksums=False)
    data = path.read_bytes()
    places = [at + 9 for at in mcap_records(data) if data[at] == 0x04]
    for place in places:
        for bit in range(8):
            path.write_bytes(flipped(data, place, bit))
            assert read_of(path) == NUMBER, (place, bit)


@pytest.mark.parametrize("has_checksums", [True, False])
def test_records_of_an_mcap(tmp_path, has_checksums):
    path = write_mcap(tmp_path / "a.mcap", has_checksums=has_checksums)
    data = path.read_bytes()
    begins = [at for at in mcap_records(data) if data[at] in {0x06, 0x07}]
    for place in [one for begin in begins for one in (begin, begin + 1, begin + 9)]:
        for bit in range(8):
            path.write_bytes(flipped(data, place, bit))
            assert read_of(path) >= NUMBER - 2, (place, bit)  # a chunk


def test_one_impossible_time_costs_one_message(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", has_checksums=False)
    data = path.read_bytes()
    at = data.rindex((NOON_NS + 3 * SECOND).to_bytes(8, "little"), 0, data.index(b"message 3")) + 7
    path.write_bytes(flipped(data, at, 7))
    assert read_of(path) == NUMBER - 1


@pytest.mark.parametrize("is_bare", [True, False])
def test_a_message_of_a_topic_that_a_database_does_not_name(tmp_path, is_bare):
    write_ros2(tmp_path / "a", [text(NOON_NS + number * SECOND) for number in range(NUMBER)])
    (path,) = (tmp_path / "a").glob("*.db3")
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET topic_id = topic_id + 8 WHERE id = 3")
    database.close()
    assert read_of(path if is_bare else tmp_path / "a") == NUMBER - 1


@pytest.mark.parametrize("field", ["name:", "type:", "message_count:", "topic_metadata:"])
@pytest.mark.parametrize("value", ["", " [1]", " x"])
def test_what_metadata_say_of_topics(tmp_path, field, value):
    write_ros2(tmp_path / "a", [text(NOON_NS + number * SECOND) for number in range(NUMBER)])
    metadata = tmp_path / "a" / "metadata.yaml"
    told = metadata.read_text()
    before, _, after = told.partition("topics_with_message_count:")
    changed = after.replace(field, f"{field}{value} #" if value else f"x{field}", 1)
    assert changed != after
    metadata.write_text(f"{before}topics_with_message_count:{changed}")
    found = examine(tmp_path / "a")
    assert sum(number for _, number in found.topics.values()) == NUMBER
