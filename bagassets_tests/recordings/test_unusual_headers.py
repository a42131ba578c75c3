"""A recording's own definition of `std_msgs/Header` says where stamp and frame are, whatever ROS has."""

import struct

import pytest

from bagassets.recordings.model import Definition
from bagassets.recordings.topic import Topic, TopicSource

RULE = "=" * 80
STAMP = {"ros1": "time stamp\n", "cdr": "builtin_interfaces/Time stamp\n"}
NS = 1_700_000_000_123_456_789


def topic(serialization, fields, msgtype="sensor_msgs/msg/Range", before=""):
    header = f"std_msgs/Header\n{fields.replace('STAMP', STAMP[serialization])}"
    text = f"{before or 'Header header'}\nfloat32 range\n{RULE}\nMSG: {header}"
    if before:
        text += f"{RULE}\nMSG: geometry_msgs/TransformStamped\nHeader header\nstring child_frame_id\n"
    if serialization == "cdr":
        text += f"{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    return Topic(TopicSource("/range", msgtype, 1, Definition("msg", text), serialization))


def text(value):
    return struct.pack("<I", len(value)) + value


@pytest.mark.parametrize(
    ("serialization", "fields", "head"),
    [
        ("ros1", "uint32 seq\nSTAMPstring frame_id\n", struct.pack("<I2i", 7, *divmod(NS, 10**9))),
        ("ros1", "STAMPstring frame_id\n", struct.pack("<2i", *divmod(NS, 10**9))),
        ("cdr", "STAMPstring frame_id\n", b"\0\1\0\0" + struct.pack("<2i", *divmod(NS, 10**9))),
        ("cdr", "uint32 seq\nSTAMPstring frame_id\n", b"\0\1\0\0" + struct.pack("<I2i", 7, *divmod(NS, 10**9))),
    ],
    ids=["ros1", "ros1 without seq", "cdr", "cdr with seq"],
)  # fmt: skip
def test_the_stamp_is_where_the_definition_has_it(serialization, fields, head):
    frame = text(b"laser") if serialization == "ros1" else text(b"laser\0") + b"\0\0"
    one = topic(serialization, fields)
    assert one.header(head + frame + struct.pack("<f", 1.5)) == (NS, "laser")
    assert one.decode(head + frame + struct.pack("<f", 1.5)).range == 1.5


def test_so_it_is_in_a_list_of_transforms():
    message = (
        struct.pack("<I2i", 1, *divmod(NS, 10**9)) + text(b"map") + text(b"car") + struct.pack("<f", 1.5)
    )
    fields = "STAMPstring frame_id\n"
    one = topic("ros1", fields, "tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms")
    assert one.header(message) == (NS, "map")
    assert one.unstamped(message) is None
