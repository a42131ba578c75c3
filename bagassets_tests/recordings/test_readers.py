"""Reading recordings: every format, odd ones, broken ones."""

import re
import sqlite3
import struct

import pytest
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import Writer as Rosbag1Writer

from bagassets.base.errors import RecordingError
from bagassets.recordings.mcap_index import walk
from bagassets.recordings.open import open_recording
from bagassets.recordings.salvage.open import open_salvaged
from bagassets.recordings.topic import RefusedBytes
from bagassets_tests.small_drive import START_NS, STORE1, messages, write_drive

TOPICS = ["/cam/camera_info", "/cam/image_raw", "/odom", "/points", "/tf_static"]

NO_RECORDING = r"; it is no recording, .* bags\.exclude"
NOTHING = "the file is empty; a copy or a recorder stopped before .* copy it again"


@pytest.fixture(params=[("ros1", "a.bag"), ("ros2", "b"), ("mcap", "c.mcap")], ids=lambda p: p[0])
def drive(request, tmp_path):
    file_format, name = request.param
    return write_drive(tmp_path / name, file_format, duration_s=1.0)


def test_topics_and_messages_in_order_of_log_time(drive):
    with open_recording(drive) as recording:
        assert list(recording.topics) == TOPICS
        read = [(m.topic, m.log_time_ns) for m in recording.messages(TOPICS)]
        assert len(read) == sum(info.count for info in recording.topics.values())
        assert [time for _, time in read] == sorted(time for _, time in read)


@pytest.mark.parametrize("chunks", ["one", "several", "none"])
def test_messages_of_an_mcap_that_were_written_late_come_in_order(tmp_path, chunks):
    written = [(5, b"a"), (3, b"b"), (9, b"c"), (3, b"d"), (1, b"e"), (9, b"f"), (4, b"g")]
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(
            stream, chunk_size=1 if chunks == "several" else 1 << 20, use_chunking=chunks != "none"
        )
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/UInt8", "ros1msg", b"uint8 data\n")
        channel = writer.register_channel("/late", "ros1", schema)
        for time_ns, data in written:
            writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()
    with open_recording(path) as recording:
        read = [(message.log_time_ns, bytes(message.data)) for message in recording.messages(["/late"])]
    assert read == sorted(
        written, key=lambda message: message[0]
    )  # stable: those of one time as they were written


def test_the_schema_says_how_messages_are_encoded_where_a_converter_said_cdr_of_all(tmp_path):
    path, stamp_ns = tmp_path / "a.mcap", START_NS + 5
    definition = STORE1.generate_msgdef("std_msgs/msg/Header", ros_version=1)[0].encode()
    stamp = STORE1.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    head = STORE1.types["std_msgs/msg/Header"](198157, stamp, "arm")
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/Header", "ros1msg", definition)
        channel = writer.register_channel("/head", "cdr", schema)
        writer.add_message(
            channel, stamp_ns, bytes(STORE1.serialize_ros1(head, "std_msgs/msg/Header")), stamp_ns
        )
        writer.finish()
    with open_recording(path) as recording:
        (message,) = recording.messages(["/head"])
        decoded = recording.decode(message)
    assert (decoded.stamp.sec, decoded.stamp.nanosec, decoded.frame_id) == (*divmod(stamp_ns, 10**9), "arm")


def test_headers_are_read_without_decoding(drive):
    with open_recording(drive) as recording:
        for message in recording.messages(TOPICS):
            decoded = recording.decode(message)
            header = decoded.transforms[0].header if message.topic == "/tf_static" else decoded.header
            stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec
            assert recording.topics[message.topic].header(message.data) == (stamp_ns, header.frame_id)


def test_messages_that_differ_in_their_stamps_only_are_told(drive):
    with open_recording(drive) as recording:
        infos = [bytes(m.data) for m in recording.messages(["/cam/camera_info"])]
        topic = recording.topics["/cam/camera_info"]
        assert len(set(infos)) > 1
        assert len({topic.unstamped(memoryview(data)) for data in infos}) == 1
        # A header of ROS 1 begins with a number, CDR with four bytes about itself.
        for at in range(len(infos[0])):
            changed = bytearray(infos[0])
            changed[at] ^= 2
            is_stamp = at < 12 and (recording.format == "ros1" or at >= 4)
            assert (topic.unstamped(bytes(changed)) == topic.unstamped(infos[0])) == is_stamp
        (transforms,) = recording.messages(["/tf_static"])
        assert recording.topics["/tf_static"].unstamped(transforms.data) is None
        assert topic.unstamped(RefusedBytes()) is None


def test_a_view_offers_the_declared_topics_only(drive):
    with open_recording(drive) as recording:
        view = recording.restrict(["/odom"])
        assert list(view.topics) == ["/odom"]
        assert len(list(view.messages(["/odom"]))) == 51
        with pytest.raises(KeyError, match="/points"):
            view.messages(["/points"])


@pytest.mark.parametrize(
    "compression", [Rosbag1Writer.CompressionFormat.LZ4, Rosbag1Writer.CompressionFormat.BZ2]
)
def test_compressed_ros1_bags_hold_the_same(tmp_path, compression):
    plain = write_drive(tmp_path / "plain.bag", "ros1", duration_s=1.0)
    writer = Rosbag1Writer(tmp_path / "small.bag")
    writer.set_compression(compression)
    with writer:
        connections = {}
        for topic, msgtype, stamp_ns, message in messages(STORE1, 1.0, ros1=True):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE1)
            writer.write(connections[topic], stamp_ns + 3_000_000, STORE1.serialize_ros1(message, msgtype))
    with open_recording(plain) as a, open_recording(tmp_path / "small.bag") as b:
        both = [[(m.topic, m.log_time_ns, bytes(m.data)) for m in r.messages(TOPICS)] for r in (a, b)]
    assert both[0] == both[1]


def test_a_bare_database_is_read_without_metadata(tmp_path):
    folder = write_drive(tmp_path / "b", "ros2", duration_s=1.0)
    (database,) = folder.glob("*.db3")
    bare = database.rename(tmp_path / "bare.db3")
    with open_recording(bare) as recording:
        assert list(recording.topics) == TOPICS
        first = next(recording.messages(["/odom"]))
        assert recording.decode(first).header.stamp.sec == START_NS // 10**9


def test_a_bad_type_costs_its_topic_only(tmp_path):
    folder = write_drive(tmp_path / "b", "ros2", duration_s=1.0)
    (database,) = folder.glob("*.db3")
    with sqlite3.connect(database) as connection:
        connection.execute("UPDATE topics SET type = 'nobody_msgs/msg/Knows' WHERE name = '/points'")
    bare = database.rename(tmp_path / "bare.db3")
    with open_recording(bare) as recording:
        assert "nobody_msgs/msg/Knows" in recording.topics["/points"].problem
        assert recording.topics["/odom"].problem is None


@pytest.mark.parametrize(
    ("name", "content", "advice"),
    [
        ("empty.bag", b"", NOTHING),
        ("empty.mcap", b"", NOTHING),
        ("empty.db3", b"", NOTHING),
        ("text.bag", b"not a bag at all\n" * 50, NO_RECORDING),
        ("cut.bag", b"#ROSBAG V2.0\nxxxx", "rosbag reindex"),
        ("text.mcap", b"not an mcap\n" * 50, NO_RECORDING),
        ("text.db3", b"not a database\n" * 100, NO_RECORDING),
        ("cut.mcap", b"\x89MCAP0\r\nxxxx", "mcap recover"),
        ("cut.db3", b"SQLite format 3\0xxxx", r"FILE \.recover"),
    ],
)
def test_broken_files_are_refused_with_what_to_do(tmp_path, name, content, advice):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=advice) as caught:
        open_recording(tmp_path / name)
    assert name in str(caught.value)
    if advice in {NO_RECORDING, NOTHING}:  # which no repair helps
        assert not re.search("try|reindex|mcap recover|sqlite3", str(caught.value))
    if advice == NO_RECORDING:
        with pytest.raises(RecordingError, match=advice):
            open_salvaged(tmp_path / name)


@pytest.mark.parametrize(("file_format", "name"), [("ros1", "a.bag"), ("mcap", "c.mcap")])
def test_truncated_files_are_refused(tmp_path, file_format, name):
    path = write_drive(tmp_path / name, file_format, duration_s=1.0)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match=r"cannot be read|no summary"):
        open_recording(path)


def test_an_mcap_that_was_cut_short_says_where_and_what_to_do(tmp_path):
    path = write_drive(tmp_path / "c.mcap", "mcap", duration_s=1.0)
    data = path.read_bytes()
    with path.open("rb") as file:
        ends = [MAGIC_SIZE, *(end for _, _, end in walk(file, len(data)))]
    for size in (len(data) // 2, len(data) - 30, ends[-1] + 3, ends[1]):
        path.write_bytes(data[:size])
        whole = max(end for end in ends if end <= size)
        what = "it is cut short" if size <= ends[-1] + 3 else "its end is missing or damaged"
        with pytest.raises(RecordingError) as caught:
            open_recording(path)
        output = str(caught.value)
        assert f"({what}: of its {size} bytes, the records up to byte {whole} are whole)" in output
        assert "try `mcap recover`, or copy it again" in output
    # What a full disk or a crash leaves may go on with zeros.
    path.write_bytes(data[: len(data) // 2] + bytes(10_000))
    with pytest.raises(RecordingError, match="it is cut short"):
        open_recording(path)
    path.write_bytes(data[: ends[1]] + bytes(10_000))
    with pytest.raises(RecordingError, match=f"it is cut short.* up to byte {ends[1]} are"):
        open_recording(path)


# --- ROS 1 records, which are read without rosbags -------------------------------------------


def header_of(**fields):
    """The header of a record, its fields in this order."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    body = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(body)) + body


def message_header(connection, time_ns, order=("op", "conn", "time")):
    values = {
        "op": b"\x02",
        "conn": struct.pack("<I", connection),
        "time": struct.pack("<II", *divmod(time_ns, 10**9)),
    }
    return header_of(**{name: values[name] for name in order})


def with_headers(bag, change):
    """Rewrite the header of each message record of an uncompressed bag; its length must stay."""
    data = bytearray(bag.read_bytes())
    with Rosbag1Reader(bag) as reader:
        places = [
            (reader.chunks[entry.chunk_pos].datapos + entry.offset, connection.id, entry.time)
            for connection in reader.connections
            for entry in reader.indexes[connection.id]
        ]
    for number, (at, connection, time_ns) in enumerate(sorted(places)):
        header = change(number, connection, time_ns)
        (length,) = struct.unpack_from("<I", data, at)
        assert len(header) == 4 + length
        data[at : at + len(header)] = header
    bag.write_bytes(data)
    return len(places)


@pytest.mark.parametrize("compression", [None, "LZ4", "BZ2"])
def test_ros1_messages_are_those_that_rosbags_reads(tmp_path, compression):
    bag = write_drive(tmp_path / "a.bag", "ros1", duration_s=1.0)
    if compression is not None:
        rewrite = Rosbag1Writer(tmp_path / "packed.bag")
        rewrite.set_compression(Rosbag1Writer.CompressionFormat[compression])
        with Rosbag1Reader(bag) as reader, rewrite:
            added = {
                c.id: rewrite.add_connection(c.topic, c.msgtype, typestore=STORE1) for c in reader.connections
            }
            for connection, time_ns, data in reader.messages():
                rewrite.write(added[connection.id], time_ns, data)
        bag = tmp_path / "packed.bag"
    with Rosbag1Reader(bag) as reader, open_recording(bag) as recording:
        theirs = [(c.topic, time_ns, data) for c, time_ns, data in reader.messages()]
        ours = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages(TOPICS)]
    assert ours == theirs


def test_fields_of_a_ros1_header_may_stand_in_any_order_and_change_it(tmp_path):
    bag = write_drive(tmp_path / "a.bag", "ros1", duration_s=1.0)
    orders = [("op", "conn", "time"), ("time", "conn", "op"), ("conn", "time", "op")]
    with open_recording(bag) as recording:
        before = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages(TOPICS)]
    changed = with_headers(bag, lambda number, *facts: message_header(*facts, order=orders[number % 3]))
    assert changed == len(before)
    with open_recording(bag) as recording:
        assert [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages(TOPICS)] == before


@pytest.mark.parametrize(
    "wrong",
    [
        lambda connection, time_ns: message_header(connection, time_ns + 1),
        lambda connection, time_ns: message_header(connection + 1, time_ns),
        lambda connection, time_ns: message_header(connection, time_ns).replace(b"op=\x02", b"op=\x04"),
    ],
    ids=["another time", "another connection", "no message"],
)
def test_a_ros1_record_that_is_not_what_the_index_says_is_damage(tmp_path, wrong):
    bag = write_drive(tmp_path / "a.bag", "ros1", duration_s=1.0)

    def change(number, connection, time_ns):
        return wrong(connection, time_ns) if number == 20 else message_header(connection, time_ns)

    with_headers(bag, change)
    with (
        pytest.raises(
            RecordingError, match=r"the index announces a message of .* where none is.*rosbag reindex"
        ),
        open_recording(bag) as recording,
    ):
        list(recording.messages(TOPICS))
