"""Which messages the inventory puts aside: small ones of topics that stay small, in order, and never too many together."""

import pytest

from bagassets.assets import kept_messages
from bagassets.assets.kept_messages import KeptMessages
from bagassets.recordings.model import RawMessage

pytestmark = pytest.mark.once

PACKET = "ethernet_msgs/msg/Packet"


def message(topic, size=10, kind="std_msgs/msg/String"):
    return RawMessage(topic, kind, 0, bytes(size))


def kept(*messages, topics=("/a", "/b")):
    keeper = KeptMessages(topics)
    for number, one in enumerate(messages):
        keeper.add(number, one)
    return keeper


def sizes(keeper):
    return [(one.topic, len(one.data)) for one in keeper.in_order()]


def test_messages_come_back_in_order_and_others_are_passed_over():
    keeper = kept(message("/b", 1), message("/c", 2), message("/a", 3), message("/b", 4))
    assert sizes(keeper) == [("/b", 1), ("/a", 3), ("/b", 4)]
    assert keeper.topics == {"/a", "/b"}


def test_what_is_kept_outlasts_the_buffer_it_came_in():
    buffer = bytearray(b"before")
    keeper = kept(RawMessage("/a", "std_msgs/msg/String", 0, memoryview(buffer)))
    buffer[:] = b"after!"
    assert keeper.in_order()[0].data == b"before"


@pytest.mark.parametrize(
    ("kind", "size", "stays"),
    [
        (PACKET, 512, True),
        (PACKET, 513, False),
        ("udp_msgs/msg/UdpPacket", 513, False),
        ("x/msg/Y", 513, True),
    ],
)
def test_large_packets_are_bulk(kind, size, stays):
    assert ("/a" in kept(message("/a", size, kind)).topics) == stays


def test_packets_are_judged_by_their_mean():
    assert "/a" in kept(message("/a", 500, PACKET), message("/a", 524, PACKET)).topics
    assert "/a" not in kept(message("/a", 500, PACKET), message("/a", 525, PACKET)).topics


def test_a_topic_may_become_too_large(monkeypatch):
    monkeypatch.setattr(kept_messages, "MOST_TOPIC_BYTES", 100)
    assert "/a" in kept(message("/a", 60), message("/a", 40)).topics
    keeper = kept(message("/a", 60), message("/b", 1), message("/a", 41), message("/a", 1))
    assert keeper.topics == {"/b"}
    assert sizes(keeper) == [("/b", 1)]


def test_topics_of_large_messages_are_not_kept_however_few():
    most = kept_messages.MOST_MEAN_BYTES
    assert sizes(kept(message("/a", most), message("/b", 1))) == [("/a", most), ("/b", 1)]
    assert sizes(kept(message("/a", most + 1), message("/b", 1))) == [("/b", 1)]
    assert sizes(kept(message("/a", most + 1), message("/a", most - 1))) == [
        ("/a", most + 1),
        ("/a", most - 1),
    ]


@pytest.mark.parametrize(("limit", "topics"), [(1030, {"/a", "/b"}), (1029, {"/b"}), (509, set())])
def test_of_all_together_the_largest_goes_first(monkeypatch, limit, topics):
    """/a holds 20 bytes in two messages, /b 10 bytes in two, each with 250 bytes beside."""
    monkeypatch.setattr(kept_messages, "MOST_BYTES", limit)
    assert kept(message("/b", 5), message("/a", 15), message("/b", 5), message("/a", 5)).topics == topics


def test_among_many_small_messages_their_number_counts(monkeypatch):
    monkeypatch.setattr(kept_messages, "MOST_BYTES", 2000)
    many = [message("/a", 1)] * 5
    keeper = kept(message("/b", 700), *many)
    assert keeper.topics == {"/b"}
    assert "/a" in kept(*many).topics


def test_what_was_dropped_makes_room(monkeypatch):
    monkeypatch.setattr(kept_messages, "MOST_BYTES", 1000)
    monkeypatch.setattr(kept_messages, "MOST_TOPIC_BYTES", 600)
    keeper = kept(message("/a", 601), message("/b", 300), message("/b", 200))
    assert keeper.topics == {"/b"}
