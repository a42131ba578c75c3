"""Odd files as rosbags and mcap read them, and as bagassets does: what the table in `docs/decoders.md` says of them."""

import re
import sqlite3
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.wrappers_pb2 import StringValue
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import ReaderError, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

from bagassets.base.errors import BagAssetsError
from bagassets.recordings.open import open_recording

REPOSITORY = Path(__file__).parents[2]
PAGE = (REPOSITORY / "docs/decoders.md").read_text()
VERSIONS = dict(re.findall(r"(rosbags|mcap) (\d[\d.]*\d)", PAGE))
pytestmark = pytest.mark.once  # what other versions make of these files is not on the page
STRING, NUMBER = "std_msgs/msg/String", 3
HELLO = b"\0\1\0\0" + struct.pack("<I", 6) + b"hello\0"
PLAIN = ("/text", STRING, "ros2msg", "string data\n", "cdr", HELLO)
"""An ordinary topic: name, type, language and text of its definition, encoding and bytes of its messages."""


_FILES = FileDescriptorSet()
StringValue.DESCRIPTOR.file.CopyToProto(_FILES.file.add())
PROTOBUF = (
    "/own", "google.protobuf.StringValue", "protobuf", _FILES.SerializeToString(), "protobuf",
    StringValue(value="hello").SerializeToString(),
)  # fmt: skip
# What `rclpy.serialization.serialize_message` of Jazzy (7.1.6) makes of JointState(name=["elbow"], position=[1.5]).
JOINTS = (
    "/joint_states", "sensor_msgs/msg/JointState", "ros2msg",
    get_typestore(Stores.ROS2_JAZZY).generate_msgdef("sensor_msgs/msg/JointState", ros_version=2)[0], "cdr",
    bytes.fromhex(
        "0001000000000000000000000100000000047c1f0100000006000000656c626f77000000"
        "0100000000000000000000000000f83f000000000000000000007c0474190000"
    ),
)  # fmt: skip


def write_mcap(path, *topics, profile="ros2"):
    """Write three messages of each topic into a chunk that is not compressed."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile=profile)
        for topic, msgtype, language, definition, encoding, data in topics:
            schema = writer.register_schema(
                msgtype, language, definition.encode() if isinstance(definition, str) else definition
            )
            channel = writer.register_channel(topic, encoding, schema)
            for number in range(NUMBER):
                writer.add_message(channel, number, data, number)
        writer.finish()
    return path


def write_folder(path):
    """Write a ROS 2 bag in SQLite with a topic."""
    written = path.with_name("bag")  # rosbags writes no others, either
    with FolderWriter(written, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/text", STRING, typestore=get_typestore(Stores.ROS2_HUMBLE))
        for number in range(NUMBER):
            writer.write(connection, number, HELLO)
    return written.rename(path)


def edited(path, change):
    """Write such a bag and change its metadata."""
    metadata = write_folder(path) / "metadata.yaml"
    content = yaml.safe_load(metadata.read_text())
    change(content["rosbag2_bagfile_information"])
    metadata.write_text(yaml.safe_dump(content))
    return path


def without_definitions(path):
    """Write one as recorders before Iron did."""
    edited(path, lambda bag: bag.update(version=4))
    with sqlite3.connect(path / "bag.db3") as database:
        for table in ("message_definitions", "schema", "metadata"):
            database.execute(f"DROP TABLE {table}")
    return path


def with_a_flipped_bit(path):
    """Write one that is damaged within a message."""
    data = bytearray(write_mcap(path, PLAIN).read_bytes())
    data[data.index(b"hello")] ^= 1
    path.write_bytes(data)
    return path


def latched_by_one(path):
    """Write a ROS 1 bag of a topic that has two publishers."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with BagWriter(path) as writer:
        for latching in (1, 0):
            connection = writer.add_connection(
                "/text", STRING, typestore=store, latching=latching, callerid=f"/{latching}"
            )
            writer.write(connection, latching, store.serialize_ros1(store.types[STRING]("hello"), STRING))
    return path


def named_in_lower_case(path):
    """Write a ROS 1 bag whose type has constants that are named in lower case."""
    with BagWriter(path) as writer:
        definition, digest = "uint8 Idle=0\nuint8 Hover=1\nuint8 mode\n", "0" * 32
        connection = writer.add_connection("/mode", "acme_msgs/msg/Mode", msgdef=definition, md5sum=digest)
        writer.write(connection, 1, b"\x01")
    return path


def other(definition, data=HELLO, language="ros2msg", encoding="cdr"):
    """Return a topic of an own type."""
    return ("/own", "acme_msgs/msg/Own", language, definition, encoding, data)


@dataclass(frozen=True)
class Odd:
    """An odd file, and what is made of it: numbers of messages, or what an error says.

    Attributes:
        name: as in the page.
        write: writes it.
        rosbags: what rosbags decodes.
        mcap: number of messages that mcap hands out; None if it is no MCAP.
        ours: what bagassets decodes, or says of a topic.
        file: its name.
    """

    name: str
    write: Callable[[Path], Path]
    rosbags: int | str
    mcap: int | None
    ours: int | str
    file: str = "a.mcap"


ODD = [
    Odd("an MCAP with an empty profile", lambda path: write_mcap(path, PLAIN, profile=""), "Profile is not ros2", 3, 3),
    Odd(
        "an MCAP with a protobuf channel beside others",
        lambda path: write_mcap(path, PLAIN, PROTOBUF),
        "UnicodeDecodeError: ", 6, 6,
    ),
    Odd(
        "a definition with the line ends of Windows",
        lambda path: write_mcap(path, PLAIN, other("string data\r\n")),
        "Could not parse", 6, 6,
    ),
    Odd(
        "a definition with `wstring`",
        lambda path: write_mcap(path, PLAIN, other("wstring data\n")),
        "KeyError: 'acme_msgs/msg/wstring'", 6, "/own: the definition of acme_msgs/msg/Own cannot be used",
    ),
    Odd(
        "a message of `serialize_message` (ROS 2) with an empty `float64[]`, such as joint states without velocities",
        lambda path: write_mcap(path, PLAIN, JOINTS),
        "CDR message size mismatch", 6, 6,
    ),
    Odd("a flipped bit in an MCAP", with_a_flipped_bit, "Chunk checksum mismatch", 3, "checksum"),
    Odd("a SQLite bag with `#`, `%` or `?` in its path", write_folder, "Cannot open database", None, 3, "a#%41?"),
    Odd(
        "an empty `storage_identifier`",
        lambda path: edited(path, lambda bag: bag.update(storage_identifier="")),
        "Storage plugin '' not supported", None, 3, "a",
    ),
    Odd("a SQLite bag without message definitions", without_definitions, "Bag contains no type definitions", None, 3, "a"),
    Odd(
        "a topic that `metadata.yaml` does not list",
        lambda path: edited(path, lambda bag: bag["topics_with_message_count"].clear()),
        0, None, 3, "a",
    ),
    Odd(
        "a file that `metadata.yaml` lists twice",
        lambda path: edited(path, lambda bag: bag.update(relative_file_paths=["bag.db3", "bag.db3"])),
        6, None, 3, "a",
    ),
    Odd(
        "a ROS 1 definition with constants in lower case (`uint8 Idle=0`)",
        named_in_lower_case,
        "Could not parse", None, 1, "a.bag",
    ),
    Odd("a ROS 1 topic that one of two nodes latches", latched_by_one, 2, None, 2, "a.bag"),
]  # fmt: skip


def outcome(read):
    """Return what a reader made of a file, or what it said."""
    try:
        return read()
    except (AnyReaderError, ReaderError, KeyError, UnicodeDecodeError, BagAssetsError) as error:
        return f"{type(error).__name__}: {error}"


def by_rosbags(path):
    with AnyReader([path]) as reader:
        return len(
            [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages()]
        )


def by_mcap(path):
    with path.open("rb") as file:
        return len(list(make_reader(file).iter_messages()))


def by_us(path):
    with open_recording(path) as recording:
        recording.check_content()
        messages = list(recording.messages(list(recording.topics)))
        for name, topic in recording.topics.items():
            if topic.problem is not None:
                return f"{name}: {topic.problem}"
        return len([recording.decode(message) for message in messages])


READERS = {"rosbags": by_rosbags, "mcap": by_mcap, "bagassets": by_us}
CASES = [
    pytest.param(odd, reader, expected, id=f"{odd.name}, {reader}")
    for odd in ODD
    for reader, expected in (("rosbags", odd.rosbags), ("mcap", odd.mcap), ("bagassets", odd.ours))
    if expected is not None
]


@pytest.mark.parametrize(("odd", "reader", "expected"), CASES)
def test_it_is_read_as_the_page_says(tmp_path, odd, reader, expected):
    path = odd.write(tmp_path / odd.file)
    came = outcome(lambda: READERS[reader](path))
    assert came == expected if isinstance(expected, int) else expected in str(came), came


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: odd.name)
def test_the_page_tells_of_it(odd):
    assert f"\n| {odd.name} |" in PAGE


def test_the_page_is_about_the_versions_that_are_tested():
    locked = dict(
        re.findall(r"^(rosbags|mcap)==(.*)$", (REPOSITORY / "requirements.lock").read_text(), re.MULTILINE)
    )
    assert locked == VERSIONS


def test_what_the_page_refers_to_is_there():
    table = PAGE.partition("## Odd files")[2]
    named = re.findall(r"`(findings/\w+\.sh)`|`(test_\w+)`", table)
    assert len(named) > 4
    for script, test in named:
        assert list(REPOSITORY.glob(script or f"bagassets_tests/**/{test}.py")), script or test
