"""Packets are taken out of messages without decoding, just as decoding gives them, or left to decoding."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.packets import PAYLOADS, payload
from bagassets.recordings.model import Definition
from bagassets.recordings.topic import RefusedBytes, Topic, TopicSource

NAME = "some_msgs/msg/Packet"
HEADER = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
HEADERS = {"ros1": HEADER, "cdr": "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"}
ETHERNET = "std_msgs/Header header\nuint8[4] sender_ip\nuint16 sender_port\nuint8[] payload\n"
# Its fields need room between them, other than after frames of other lengths.
SPACED = "std_msgs/Header header\nuint8 hops\nfloat64[2] at\nuint8[3] mac\nuint16 port\nuint8[] payload\n"
BOTH = pytest.mark.parametrize("serialization", ["ros1", "cdr"])


def topic_of(text, serialization="ros1", problem=None):
    definition = Definition("msg", f"{text}{'=' * 80}\n{HEADERS[serialization]}")
    return Topic(TopicSource("/packets", NAME, 1, definition, serialization, problem))


@cache
def store_of(text, serialization):
    store = get_typestore(Stores.ROS1_NOETIC if serialization == "ros1" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, NAME))
    return store


def message_of(text, serialization="ros1", stamp=(5, 6), frame="lidar", **values):
    store = store_of(text, serialization)
    number = (7,) if serialization == "ros1" else ()
    head = store.types["std_msgs/msg/Header"](
        *number, store.types["builtin_interfaces/msg/Time"](*stamp), frame
    )
    serialize = store.serialize_ros1 if serialization == "ros1" else store.serialize_cdr
    return bytes(serialize(store.types[NAME](header=head, **values), NAME))


def ethernet(data, serialization="ros1", **header):
    return message_of(
        ETHERNET, serialization, **header, sender_ip=np.array([1, 2, 3, 4], np.uint8), sender_port=2368,
        payload=np.frombuffer(data, np.uint8),
    )  # fmt: skip


def spaced(data, serialization="ros1", **header):
    return message_of(
        SPACED, serialization, **header, hops=3, at=np.array([0.5, -1.0]), mac=np.array([1, 2, 3], np.uint8), port=2368,
        payload=np.frombuffer(data, np.uint8),
    )  # fmt: skip


@BOTH
@pytest.mark.parametrize(("text", "write"), [(ETHERNET, ethernet), (SPACED, spaced)])
@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=1300), st.text(max_size=20), st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))
def test_what_is_skimmed_is_what_decoding_gives(
    text, write, serialization, data, frame, seconds, nanoseconds
):
    topic = topic_of(text, serialization)
    raw = write(data, serialization, frame=frame, stamp=(seconds, nanoseconds))
    decoded = topic.decode(raw)
    packet = topic.packet(memoryview(raw), PAYLOADS)
    assert packet is not None
    assert (packet.stamp_ns, packet.payload) == (stamp_and_frame(decoded.header)[0], payload(decoded))
    assert packet.frame_id == decoded.header.frame_id


def test_nothing_is_skimmed_where_nothing_can_be_decoded():
    raw = ethernet(b"123")
    assert topic_of(ETHERNET).packets([raw, raw], PAYLOADS) is not None
    topic = topic_of(ETHERNET, problem="it carries two types")
    assert topic.packet(raw, PAYLOADS) is topic.packets([raw, raw], PAYLOADS) is None
    with pytest.raises(DecodeError, match="two types"):
        topic.decode(raw)


@BOTH
@pytest.mark.parametrize("cut", [0, 3, 16, 30, -1])
def test_a_message_that_is_cut_off_is_left_to_decoding(serialization, cut):
    raw = ethernet(b"data", serialization)[:cut]
    assert topic_of(ETHERNET, serialization).packet(raw, PAYLOADS) is None


@BOTH
def test_a_message_that_is_longer_than_it_says_is_left_to_decoding(serialization):
    raw = ethernet(b"data", serialization) + b"!"
    assert topic_of(ETHERNET, serialization).packet(raw, PAYLOADS) is None


@BOTH
def test_a_frame_that_is_no_text_is_left_to_decoding(serialization):
    raw = ethernet(b"data", serialization).replace(b"lidar", b"\xff\xfedar")
    assert topic_of(ETHERNET, serialization).packet(raw, PAYLOADS) is None


@pytest.mark.parametrize("begin", [b"\0\0", b"\0\3", b"\1\1"])
def test_other_kinds_of_cdr_are_left_to_decoding(begin):
    topic, raw = topic_of(ETHERNET, "cdr"), ethernet(b"data", "cdr")
    other = begin + raw[2:]
    assert topic.packet(other, PAYLOADS) is None
    assert topic.packets([raw, other], PAYLOADS) is None


def test_a_frame_of_cdr_without_its_end_is_left_to_decoding():
    raw = ethernet(b"data", "cdr").replace(b"lidar\0", b"lidar!")
    assert topic_of(ETHERNET, "cdr").packet(raw, PAYLOADS) is None


@pytest.mark.parametrize(
    "text",
    [
        "uint8[] payload\n",
        "std_msgs/Header header\nuint8[] payload\nuint8 after\n",
        "std_msgs/Header header\nstring name\nuint8[] payload\n",
        "std_msgs/Header header\nstring[2] names\nuint8[] payload\n",
        "std_msgs/Header header\nuint16[] payload\n",
        "std_msgs/Header header\nuint8[4] payload\n",
        "std_msgs/Header header\nuint8[3] payload\nuint8[] data\n",
        "std_msgs/Header header\nuint8[] content\n",
        "std_msgs/Header header\n",
    ],
)
@BOTH
def test_other_layouts_are_left_to_decoding(serialization, text):
    zeros = bytes([0, serialization == "cdr"]) + bytes(62)
    assert topic_of(text, serialization).packet(zeros, PAYLOADS) is None


STAMPS = st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))


@BOTH
@settings(max_examples=60, deadline=None)
@given(st.text(max_size=20), st.lists(STAMPS, min_size=1, max_size=20), st.integers(0, 40))
def test_messages_that_are_alike_are_skimmed_at_once(serialization, frame, stamps, size):
    topic = topic_of(ETHERNET, serialization)
    raws = [
        ethernet(bytes([n]) * size, serialization, frame=frame, stamp=stamp) for n, stamp in enumerate(stamps)
    ]
    each = [topic.packet(raw, PAYLOADS) for raw in raws]
    found = topic.packets(raws, PAYLOADS)
    assert found is not None
    assert found.stamps_ns.tolist() == [packet.stamp_ns for packet in each]
    assert [row.tobytes() for row in found.payloads] == [packet.payload for packet in each]
    assert {found.frame_id} == {packet.frame_id for packet in each}


@BOTH
def test_messages_that_are_not_alike_are_not_skimmed_at_once(serialization):
    topic = topic_of(ETHERNET, serialization)
    one = ethernet(b"data", serialization)
    for other in (
        ethernet(b"data!", serialization),
        ethernet(b"data", serialization, frame="radar"),
        ethernet(b"data5", serialization, frame="lida"),
        ethernet(b"data5", serialization)[:-1],
        RefusedBytes(),
    ):
        assert topic.packets([one, one], PAYLOADS) is not None
        assert topic.packets([one, other], PAYLOADS) is None
        assert topic.packets([other, one], PAYLOADS) is None
    assert topic.packets([], PAYLOADS) is None
