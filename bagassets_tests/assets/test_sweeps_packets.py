"""Velodyne packets through the step `sweeps`: revolutions, clocks, deskewing."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bagassets.assets import lidar_sweeps, packet_sweeps
from bagassets.base.errors import LossLimitError, RecipeError
from bagassets.decode.fields import stamp_ns
from bagassets.decode.model import CloudReading
from bagassets.recordings.model import Definition, RawMessage
from bagassets.recordings.topic import Topic, TopicSource
from bagassets_tests.recordings.test_skim import BOTH, ETHERNET, HEADERS, ethernet
from bagassets_tests.sweep_data import (
    VLP16_PACKET_NS,
    EthernetPacket,
    header,
    raw,
    vlp16_packets,
)
from bagassets_tests.sweep_run import (
    CLOUD,
    MOUNT,
    PACKET,
    PERIOD_NS,
    SCAN,
    START_NS,
    Runner,
    clouds,
    driving,
    lidar,
    request,
    scans,
    singles,
)


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


def test_packets_become_complete_revolutions(run):
    result = run(request(lidar(), SCAN), scans(4.5, start_deg=90.0))
    # 270 degrees, three turns, 45 degrees
    assert len(result.index) == 3
    assert set(result.lost) == {"incomplete revolution"}
    counts = result.summary["counts"]
    assert counts["read"] == len(vlp16_packets(4.5))
    assert result.summary["messages"] == len(list(scans(4.5)))
    first_cut_ns = 75_000_000
    for number, row in enumerate(result.index):
        assert abs(row["start_ns"] - START_NS - first_cut_ns - number * PERIOD_NS) < 2 * VLP16_PACKET_NS
        assert abs(row["end_ns"] - row["start_ns"] - PERIOD_NS) < 2 * VLP16_PACKET_NS
        assert row["stamp_ns"] == row["end_ns"]
    for row, following in itertools.pairwise(result.index):
        assert abs(row["end_ns"] - following["start_ns"]) <= 2_000
    azimuth = np.degrees(np.arctan2(-result.points()[:, 1], result.points()[:, 0])) % 360
    assert azimuth[:16].max() < 10
    assert np.abs((azimuth[-16:] + 180) % 360 - 180).max() < 10


def test_the_size_of_messages_does_not_matter(run):
    one = run(request(lidar(), SCAN), scans(3.5, per_message=50))
    other = run(request(lidar(), SCAN), scans(3.5, per_message=7))
    assert [row["digest"] for row in one.index] == [row["digest"] for row in other.index]
    assert one.summary["counts"] == other.summary["counts"]


def test_single_packets_give_what_scans_give(run):
    one = run(request(lidar(), SCAN), scans(3.2))
    other = run(request(lidar(), PACKET), singles(3.2))
    keys = ("stamp_ns", "digest", "points", "start_ns", "end_ns")
    assert [[row[key] for key in keys] for row in one.index] == [
        [row[key] for key in keys] for row in other.index
    ]


@BOTH
@pytest.mark.parametrize("clock", ["header", "log"])
@pytest.mark.parametrize("held", [1, 100, 256])
def test_messages_of_a_recording_give_what_decoded_ones_give(run, monkeypatch, clock, held, serialization):
    monkeypatch.setattr(packet_sweeps, "_MOST_HELD", held)
    definition = Definition("msg", f"{ETHERNET}{'=' * 80}\n{HEADERS[serialization]}")
    topic = Topic(TopicSource("/sensor", PACKET, 1, definition, serialization))
    recording = SimpleNamespace(topics={"/sensor": topic}, decode=lambda message: topic.decode(message.data))
    decoded = list(singles(3.5, start_deg=90.0))
    messages = []
    for message in decoded:
        stamp = divmod(stamp_ns(message.data.message.header.stamp), 10**9)
        data = ethernet(message.data.message.payload.tobytes(), serialization, stamp=stamp)
        messages.append(RawMessage("/sensor", PACKET, message.log_time_ns, memoryview(data)))
    odd = [
        RawMessage("/sensor", PACKET, START_NS, ethernet(data, serialization, stamp=(1, 0)))
        for data in (bytes(512), b"other")
    ]
    for more, lost in (([], {}), (odd, {"position packet": 1, "it holds no data packet of 1206 bytes": 1})):
        asked = request(lidar(), PACKET, clock)
        found = run(asked, messages[:150] + more + messages[150:], recording=recording)
        expected = run(asked, decoded)
        assert [row | {"digest": ""} for row in found.index] == [
            row | {"digest": ""} for row in expected.index
        ]
        assert found.digest == expected.digest or more
        assert [row["digest"] for row in found.index] == [row["digest"] for row in expected.index]
        assert found.lost == expected.lost | lost
        assert found.channel["frame_id"] == "lidar"


def test_a_message_with_several_bad_packets_is_one_message_lost(run):
    messages = list(scans(20, per_message=4))
    damaged = messages[7].data.message.packets
    for packet in damaged[:2]:
        packet.data = packet.data.copy()
        packet.data[0] = 0
    result = run(request(lidar(), SCAN, limit=0.003), messages)
    assert result.lost["its packet does not start with the flag and azimuth of a Velodyne block"] == 2
    with pytest.raises(LossLimitError, match=r"lost 1 of 377 messages.*flag and azimuth"):
        run(request(lidar(), SCAN, limit=0.002), messages)


def test_the_cut_angle_moves_the_revolutions(run):
    result = run(request(lidar(cut_angle_deg=180.0), SCAN), scans(4))
    assert len(result.index) == 3
    assert result.index[0]["start_ns"] - START_NS == pytest.approx(PERIOD_NS / 2, abs=2 * VLP16_PACKET_NS)


def test_with_log_times_packets_had_arrived_when_they_were_logged(run):
    result = run(request(lidar(stamp="start"), PACKET, "log"), singles(2))
    assert result.index[0]["stamp_ns"] == pytest.approx(START_NS + 3_000_000, abs=1_000)
    scanned = run(request(lidar(stamp="start"), SCAN, "log"), scans(2))
    assert scanned.index[0]["stamp_ns"] == pytest.approx(START_NS + VLP16_PACKET_NS, abs=1_000)


def test_position_packets_are_no_failure(run):
    messages = list(singles(2))
    position = raw(EthernetPacket(header(START_NS), np.zeros(512, np.uint8)), PACKET, START_NS)
    result = run(request(lidar(), PACKET), [position, *messages, position])
    assert result.lost == {"position packet": 2}
    assert len(result.index) == 2


def test_bytes_that_are_no_packets_fail_the_channel(run):
    junk = [raw(EthernetPacket(header(START_NS), np.zeros(1000, np.uint8)), PACKET, START_NS)] * 3
    with pytest.raises(LossLimitError, match="1206"):
        run(request(lidar(), PACKET), junk)


def test_range_limits_hold_for_packets(run):
    with_limit = run(request(lidar(max_range_m=10.0), SCAN), scans(2))
    assert with_limit.index == []
    assert set(with_limit.lost) == {"no point in it"}
    assert set(with_limit.summary["points"]["dropped"]) == {"farther than max_range_m"}


# --- deskewing -----


def test_deskewed_points_are_where_they_are_at_the_stamp(run):
    asked = request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p")
    times = np.array([0, 30, 60, 100], np.uint32) * 1_000_000
    result = run(asked, clouds(1, t=times), driving(10.0))
    # At 10 m/s what was seen 0.1 s before the stamp is 1 m nearer now.
    assert np.allclose(result.points()[:, 0], [1 - 1.0, 2 - 0.7, 3 - 0.4, 4 - 0.0], atol=1e-4)
    assert np.allclose(result.points()[:, 1], [1, 2, 3, 4])


def test_packets_are_deskewed_too(run):
    asked = request(lidar(deskew=True), SCAN, mount=MOUNT, poses="p")
    still = run(request(lidar(), SCAN), scans(2))
    result = run(asked, scans(2), driving(10.0))
    moved = still.points()[:, 0].astype(float) - result.points()[:, 0]
    row = result.index[0]
    assert moved[0] == pytest.approx((row["stamp_ns"] - row["start_ns"]) * 1e-9 * 10.0, abs=1e-4)
    assert np.abs(moved[-16:]).max() < 0.02


def test_a_revolution_without_poses_is_lost_and_counted(run):
    asked = request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p")
    times = np.array([0, 30, 60, 100], np.uint32) * 1_000_000
    result = run(asked, clouds(3, t=times), driving(10.0, start_ns=START_NS + 50_000_000))
    assert result.lost == {"no ego pose to deskew with": 1}
    assert len(result.index) == 2


def test_points_without_times_cannot_be_deskewed(run):
    asked = request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p")
    with pytest.raises(RecipeError, match=r"LIDAR_TOP.*/sensor.*deskew: false"):
        run(asked, clouds(2), driving(10.0))


def test_the_points_that_a_plug_in_keeps_are_not_changed(run, monkeypatch):
    asked = request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p")
    asked = replace(asked, params=replace(asked.params, decoder={"distribution": "acme", "version": "1"}))
    kept = np.array([[5, 0, 0, 1, 1], [6, 1, 0, 1, 1]], np.float32)
    before = kept.copy()

    def decode(message, *_):
        stamp = stamp_ns(message.header.stamp)
        return CloudReading(stamp, "lidar", kept, stamp - np.array([50_000_000, 0]))

    monkeypatch.setattr(lidar_sweeps, "keyed_decoder", lambda *_: decode)
    result = run(asked, clouds(3), driving(10.0))
    assert np.array_equal(kept, before)
    for row in range(len(result.index)):
        assert result.points(row)[0, 0] == pytest.approx(4.5, abs=1e-3)


def test_poses_are_asked_for_only_by_what_is_deskewed(run):
    run(request(lidar(), CLOUD), [])
    with pytest.raises(AttributeError, match="trajectory"):
        run(request(lidar(deskew=True), CLOUD), [])


# --- determinism ----


def test_the_same_messages_give_the_same_artifact(run):
    asked = request(lidar(deskew=True), SCAN, mount=MOUNT, poses="p")
    digests = {run(asked, scans(3), driving(10.0)).digest for _ in range(2)}
    assert len(digests) == 1


# --- a restricted field of view ----


def azimuth_deg(packets):
    return packets["blocks"]["azimuth"][:, 0] / 100.0


def reports(packets, first_deg, last_deg):
    """Which packets a lidar sends that reports from one azimuth to another, clockwise."""
    return (azimuth_deg(packets) - first_deg) % 360 <= (last_deg - first_deg) % 360


def restricted(turns, first_deg, last_deg, *, lost=(), **options):
    """Messages of a lidar that is silent outside its field of view, its clock and stamps going on."""
    packets = vlp16_packets(turns, **options)
    sent = np.flatnonzero(reports(packets, first_deg, last_deg))
    for number, index in enumerate(sent.tolist()):
        if number not in lost:
            stamp = START_NS + index * VLP16_PACKET_NS
            payload = np.frombuffer(packets[index].tobytes(), np.uint8)
            yield raw(EthernetPacket(header(stamp), payload), PACKET, stamp + 3_000_000)


VIEWS = [
    (270.0, 90.0),
    (90.0, 270.0),
    (0.0, 180.0),
    (200.0, 120.0),
    (300.0, 330.0),
    (10.0, 350.0),
]


@pytest.mark.parametrize(("first_deg", "last_deg"), VIEWS)
def test_a_restricted_view_gives_a_sweep_each_turn(run, first_deg, last_deg):
    turns = 6
    opposite = (first_deg + last_deg) / 2 + (0 if last_deg < first_deg else 180)
    messages = list(restricted(turns, first_deg, last_deg, start_deg=opposite % 360))
    result = run(request(lidar(), PACKET), messages)
    assert result.lost == {}
    assert len(result.index) == turns
    assert result.summary["counts"]["read"] == len(messages)
    view_ns = ((last_deg - first_deg) % 360) / 360 * PERIOD_NS
    for number, row in enumerate(result.index):
        if 360 - (last_deg - first_deg) % 360 > 20:
            # One sweep from the first to the last azimuth, stamped when it was over and not when the next one began.
            assert row["end_ns"] - row["start_ns"] == pytest.approx(view_ns, abs=2 * VLP16_PACKET_NS)
        assert row["stamp_ns"] == row["end_ns"]
        assert row["start_ns"] - START_NS - number * PERIOD_NS < PERIOD_NS
    # All returns of all packets are points of some sweep.
    assert result.summary["points"]["written"] == len(messages) * 12 * 32


@pytest.mark.parametrize("cut_deg", [90.0, 180.0, 269.0, 123.4])
def test_a_cut_in_the_arc_that_is_not_reported_changes_nothing(run, cut_deg):
    plain = run(request(lidar(), PACKET), restricted(5, 272.0, 88.0, start_deg=180.0))
    cut = run(request(lidar(cut_angle_deg=cut_deg), PACKET), restricted(5, 272.0, 88.0, start_deg=180.0))
    keys = ("stamp_ns", "start_ns", "end_ns", "digest", "points")
    assert len(cut.index) == 5
    assert [[row[key] for key in keys] for row in cut.index] == [
        [row[key] for key in keys] for row in plain.index
    ]


@pytest.mark.parametrize("cut_deg", [0.0, 45.0, 300.0])
def test_a_cut_inside_the_view_is_kept(run, cut_deg):
    messages = list(restricted(6, 270.0, 90.0, start_deg=180.0))
    result = run(request(lidar(cut_angle_deg=cut_deg), PACKET), messages)
    assert len(result.index) == 5  # the first and the last one are parts
    assert set(result.lost) == {"incomplete revolution"}
    for row in result.index:
        assert row["end_ns"] - row["start_ns"] == pytest.approx(PERIOD_NS, abs=2 * VLP16_PACKET_NS)
    azimuths = np.degrees(np.arctan2(-result.points()[:, 1], result.points()[:, 0])) % 360
    assert abs((azimuths[0] - cut_deg + 180) % 360 - 180) < 6


def test_times_follow_the_lidar_over_an_arc_that_is_not_reported(run):
    rng = np.random.default_rng(3)
    asked = request(lidar(cut_angle_deg=0.0), PACKET)
    exact = run(asked, restricted(5, 270.0, 90.0, start_deg=180.0))
    late = []
    for message in restricted(5, 270.0, 90.0, start_deg=180.0):
        stamp = message.log_time_ns - 3_000_000 + int(rng.integers(0, 3_000_000))
        late.append(
            raw(EthernetPacket(header(stamp), message.data.message.payload), PACKET, message.log_time_ns)
        )
    jittered = run(asked, late)
    spans = [[row["end_ns"] - row["start_ns"] for row in result.index] for result in (exact, jittered)]
    assert np.abs(np.array(spans[0]) - spans[1]).max() <= 2_000


def test_a_lidar_whose_clock_does_not_run_may_have_a_restricted_view(run):
    messages = []
    for message in restricted(5, 270.0, 90.0, start_deg=180.0):
        payload = message.data.message.payload.copy()
        payload[1200:1204] = 0
        messages.append(
            raw(EthernetPacket(message.data.message.header, payload), PACKET, message.log_time_ns)
        )
    result = run(request(lidar(), PACKET), messages)
    assert (len(result.index), result.lost) == (5, {})


def test_parts_of_a_restricted_view_are_lost_and_counted(run):
    messages = list(restricted(6.25, 270.0, 90.0, start_deg=0.0))  # begins inside, ends at its last azimuth
    result = run(request(lidar(), PACKET), messages)
    assert len(result.index) == 6
    first_part = sum(message.log_time_ns - START_NS < PERIOD_NS / 2 for message in messages)
    assert result.lost == {"incomplete revolution": first_part}
    # 8 packets in the middle of one sweep are 16 degrees too many of 38.
    whole = list(restricted(6, 270.0, 90.0, start_deg=180.0))
    few = list(restricted(6, 270.0, 90.0, start_deg=180.0, lost=set(range(2 * 38 + 10, 2 * 38 + 18))))
    assert len(whole) - len(few) == 8
    result = run(request(lidar(), PACKET), few)
    assert len(result.index) == 5
    assert result.lost == {"incomplete revolution": pytest.approx(38 - 8, abs=1)}


def test_whole_turns_lost_from_a_restricted_view_join_no_halves(run):
    messages = [
        message
        for message in restricted(6, 270.0, 90.0, start_deg=180.0)
        if not 2.5 <= (message.log_time_ns - START_NS) / PERIOD_NS < 3.5
    ]
    result = run(request(lidar(), PACKET), messages)
    assert len(result.index) == 4
    assert set(result.lost) == {"incomplete revolution"}


def test_packets_lost_by_chance_are_no_restricted_view(run):
    """A seventh of each turn is lost, another one each time."""
    packets = vlp16_packets(6)
    per_turn = len(packets) / 6
    kept = []
    for index, packet in enumerate(packets):
        turn, place = divmod(index / per_turn, 1)
        if not 0 <= (place - 0.21 * turn) % 1 < 0.15:
            stamp = START_NS + index * VLP16_PACKET_NS
            payload = np.frombuffer(packet.tobytes(), np.uint8)
            kept.append(raw(EthernetPacket(header(stamp), payload), PACKET, stamp))
    result = run(request(lidar(), PACKET), kept)
    assert result.index == []
    assert result.lost == {"incomplete revolution": len(kept)}
