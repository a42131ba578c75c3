"""Velodyne packets: parsing, revolutions, times and points against the manuals."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.assets.revolutions import MOST_PACKETS, RevolutionCutter, packet_times_ns
from bagassets.base.errors import DecodeError, RecipeError
from bagassets.decode import velodyne
from bagassets.decode.packets import Packets, packets_in
from bagassets.decode.velodyne import PacketFilter, RevolutionDecoder
from bagassets.decode.velodyne_lasers import head_of
from bagassets.geometry.kernels import machine_code, returns
from bagassets.geometry.kernels.machine_code import MachineCode
from bagassets.geometry.kernels.returns import BANK_FLAGS, PACKET
from bagassets_tests.sweep_data import (
    VLP16_ELEVATIONS,
    VLP16_PACKET_NS,
    VLS128_PACKET_NS,
    EthernetPacket,
    header,
    velodyne_scan,
    vlp16_packets,
    vls128_packets,
)

START_NS = 1_700_000_000_000_000_000


def parsed(packets, packet_ns=VLP16_PACKET_NS, jitter_ns=None):
    host_ns = START_NS + np.arange(len(packets)) * packet_ns
    return Packets(host_ns if jitter_ns is None else host_ns + jitter_ns, packets.view(PACKET))


def cut(packets, cut_deg=0.0, pushed=256):
    cutter = RevolutionCutter(cut_deg)
    log_times_ns = np.arange(len(packets))
    parts = (slice(first, first + pushed) for first in range(0, len(packets), pushed))
    turns = [turn for part in parts for turn in cutter.push(packets[part], log_times_ns[part])]
    return turns + cutter.flush()


def refusals(packets, model=None):
    return PacketFilter(model).refusals(packets.view(PACKET))


# --- messages and packets -------------------------------------------------------------------


def test_packets_are_found_in_scans_and_in_single_packet_messages():
    packets = vlp16_packets(0.1)
    scan = velodyne_scan(packets, START_NS, VLP16_PACKET_NS)
    assert packets_in(scan) == [
        (START_NS + number * VLP16_PACKET_NS, packet.tobytes()) for number, packet in enumerate(packets)
    ]
    single = EthernetPacket(header(START_NS), np.frombuffer(packets[0].tobytes(), np.uint8))
    assert packets_in(single) == [(None, packets[0].tobytes())]


def test_a_message_without_payload_is_refused():
    with pytest.raises(DecodeError, match="payload"):
        packets_in(header(START_NS))


def test_what_is_no_data_packet_is_refused():
    packets = vlp16_packets(0.1)[:4]
    packets["blocks"]["flag"][1, 0] = 0
    packets["blocks"]["azimuth"][2, 0] = 36_000
    found = refusals(packets)
    assert list(found) == [1, 2]
    assert all("flag and azimuth" in reason for reason in found.values())


def test_a_packet_of_another_model_is_refused():
    packets = np.concatenate([vlp16_packets(0.1)[:1], vls128_packets(2)])
    found = refusals(packets)
    assert list(found) == [1, 2]
    assert all("another Velodyne model" in reason for reason in found.values())
    assert list(refusals(packets, "VLS-128")) == [0]


def test_the_model_of_the_first_packet_counts_from_then_on():
    kept = PacketFilter(None)
    assert not kept.refusals(vlp16_packets(0.1).view(PACKET))
    assert len(kept.refusals(vls128_packets(2).view(PACKET))) == 2


def test_a_model_that_packets_do_not_name_must_be_in_the_recipe():
    packets = vlp16_packets(0.1)[:3]
    packets["product"][:2] = 0x23  # VLP-32A or B
    found = refusals(packets)
    assert list(found) == [0, 1]
    assert all("set `model`" in reason for reason in found.values())
    assert list(refusals(packets, "VLP-32B")) == [2]


def test_a_lidar_that_needs_the_calibration_of_the_unit_is_refused():
    with pytest.raises(RecipeError, match="calibration"):
        PacketFilter("HDL-64E S3")


@pytest.mark.parametrize("name", ["VLP-16", "vlp16", "Puck Lite", "HDL-32E", "Alpha Prime", "VLS-128"])
def test_models_are_known_by_their_names(name):
    PacketFilter(name)
    RevolutionDecoder(name)


def test_an_unknown_model_is_refused():
    with pytest.raises(RecipeError, match=r"VLP-99.*VLS-128"):
        PacketFilter("VLP-99")


# --- revolutions ----------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0, 359.99),
    st.floats(0, 359.99),
    st.floats(0.1, 4.5),
    st.sampled_from([300, 600, 1200]),
)
def test_revolutions_partition_the_packets_at_the_cut(cut_deg, start_deg, turns, rpm):
    packets = parsed(vlp16_packets(turns, rpm=rpm, start_deg=start_deg))
    revolutions = cut(packets, cut_deg)
    assert np.array_equal(np.concatenate([turn.packets.data for turn in revolutions]), packets.data)
    step = rpm * 6 * VLP16_PACKET_NS * 1e-9
    for turn in revolutions[1:]:  # each begins within a packet of the cut
        assert turn.azimuths[0] / 100 <= step + 0.02
    for turn in revolutions[1:-1]:
        assert turn.complete
        assert turn.missing_deg <= step + 0.02
        assert turn.next_packet is not None
    for turn in revolutions:
        covered = len(turn.packets) * step
        if covered < 330:
            assert not turn.complete


def test_first_and_last_count_if_the_recording_starts_and_ends_at_the_cut():
    whole = cut(parsed(vlp16_packets(3)))
    assert [turn.complete for turn in whole] == [True] * 3
    shifted = cut(parsed(vlp16_packets(3, start_deg=90)))
    assert [turn.complete for turn in shifted] == [False, True, True, False]


def test_a_hole_makes_a_revolution_incomplete():
    packets = parsed(vlp16_packets(3))
    per_turn = len(packets) // 3
    few = Packets.joined([packets[: per_turn + 20], packets[per_turn + 22 :]])
    assert [turn.complete for turn in cut(few)] == [True, True, True]
    many = Packets.joined([packets[: per_turn + 20], packets[per_turn + 28 :]])
    assert [turn.complete for turn in cut(many)] == [True, False, True]


def test_a_pause_of_exactly_one_turn_does_not_join_two_halves():
    packets = parsed(vlp16_packets(4))
    per_turn = len(packets) / 4
    kept = Packets.joined([packets[: round(1.5 * per_turn)], packets[round(2.5 * per_turn) :]])
    revolutions = cut(kept)
    assert [turn.complete for turn in revolutions] == [True, False, False, True]


def test_a_lidar_that_does_not_spin_makes_no_endless_revolution():
    packets = vlp16_packets(30)
    packets["blocks"]["azimuth"] = 1_000
    revolutions = cut(parsed(packets))
    assert len(revolutions) > 3
    assert not any(turn.complete for turn in revolutions)


def test_times_follow_the_lidar_and_not_the_jitter_of_the_host():
    rng = np.random.default_rng(1)
    jitter = rng.integers(-2_000_000, 2_000_001, 300)
    jitter -= int(np.median(jitter[:300]))
    packets = parsed(vlp16_packets(4)[:300], jitter_ns=jitter)
    times = packet_times_ns(packets)
    truth = START_NS + np.arange(300) * VLP16_PACKET_NS
    assert np.abs(times - truth).max() <= 100_000  # the median's error, the same for all
    assert np.ptp(times - truth) <= 1_000  # the lidar counts microseconds


def test_times_survive_the_top_of_the_hour():
    packets = parsed(vlp16_packets(1, first_us=3_599_999_000))
    assert packets.device_us[0] > packets.device_us[-1]
    truth = START_NS + np.arange(len(packets)) * VLP16_PACKET_NS
    assert np.abs(packet_times_ns(packets) - truth).max() <= 1_000


@pytest.mark.parametrize("clock", [0, 1_000_000_000])
def test_host_stamps_stand_in_for_a_lidar_without_clock(clock):
    packets = vlp16_packets(1)
    packets["us"] = clock
    found = packet_times_ns(parsed(packets))
    assert np.array_equal(found, START_NS + np.arange(len(packets)) * VLP16_PACKET_NS)


def test_a_revolution_ends_when_the_next_begins():
    revolutions = cut(parsed(vlp16_packets(3)))
    for turn, following in itertools.pairwise(revolutions):
        assert abs(turn.times_ns()[1] - following.times_ns()[0][0]) <= 1_000
    times, end = revolutions[-1].times_ns()
    assert abs(end - times[-1] - VLP16_PACKET_NS) <= 1_000


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([None, 0.0, 123.0]), st.sampled_from([1, 7, 100, 1_000]))
def test_revolutions_do_not_depend_on_how_many_packets_come_at_once(seed, cut_deg, pushed):
    rng = np.random.default_rng(seed)
    packets = vlp16_packets(8, rpm=int(rng.choice([300, 600, 1200])), start_deg=rng.uniform(0, 360))
    jitter_ns = rng.integers(-2_000_000, 2_000_000, len(packets))
    jitter_ns[rng.random(len(packets)) < 0.005] = rng.choice([-(10**9), 10**8, 10**9])  # a clock that is set
    packets = parsed(packets, jitter_ns=jitter_ns)
    lost = int(rng.integers(0, len(packets)))
    packets = Packets.joined([packets[:lost], packets[lost + int(rng.integers(0, 300)) :]])
    found, expected = (
        [
            (
                len(turn.packets),
                turn.azimuths.tolist(),
                turn.log_time_ns,
                turn.blind,
                turn.next_packet is None,
            )
            for turn in cut(packets, cut_deg, number)
        ]
        for number in (pushed, len(packets))
    )
    assert found == expected
    assert sum(number for number, *_ in found) == len(packets)


def test_a_pause_is_told_from_a_late_packet():
    packets = parsed(vlp16_packets(4))
    per_turn = len(packets) // 4
    for pause_ns, complete in ((19_000_000, True), (25_000_000, False)):
        host_ns, data = packets.host_ns.copy(), packets.data.copy()
        host_ns[per_turn * 2 + 30 :] += pause_ns
        data["us"][per_turn * 2 + 30 :] += pause_ns // 1000
        paused = Packets(host_ns, data)
        assert all(turn.complete for turn in cut(paused)) == complete


# --- points ---------------------------------------------------------------------------------


def test_vlp16_points_are_where_the_manual_says():
    packets = vlp16_packets(0.02, start_deg=30.0)[:1]
    times = np.array([START_NS])
    found = RevolutionDecoder(None).decode(parsed(packets), times)
    assert found.points.shape == (384, 5)
    rotation = 600 * 6.0  # degrees per second
    expected = []
    for firing in range(24):
        for laser in range(16):
            at_s = firing * 55.296e-6 + laser * 2.304e-6
            azimuth = math.radians(30 + rotation * at_s)
            elevation = math.radians(VLP16_ELEVATIONS[laser])
            ground = 20 * math.cos(elevation)
            z = 20 * math.sin(elevation)
            ring = sorted(VLP16_ELEVATIONS).index(VLP16_ELEVATIONS[laser])
            expected.append(
                [ground * math.cos(azimuth), -ground * math.sin(azimuth), z, 77, ring, round(at_s * 1e9)]
            )
    expected = np.array(expected)
    # Azimuths are rounded to 0.01 degrees twice: 7 mm at 20 m. The factory's optical offsets are up to 11 mm.
    assert np.abs(found.points[:, :2] - expected[:, :2]).max() < 0.012
    assert np.abs(found.points[:, 2] - expected[:, 2]).max() < 0.015
    assert np.array_equal(found.points[:, 3:], expected[:, 3:5])
    assert np.abs(found.times_ns - START_NS - expected[:, 5]).max() <= 1


def test_vls128_gives_all_its_points_and_times_in_order():
    packets = parsed(vls128_packets(600), VLS128_PACKET_NS)
    (turn, *_) = cut(packets)
    times, end = turn.times_ns()
    found = RevolutionDecoder("VLS-128").decode(turn.packets, times)
    assert len(found.points) == 384 * len(turn.packets)
    distance = np.sqrt((found.points[:, :3].astype(float) ** 2).sum(axis=1))
    assert np.abs(distance - 20.0).max() < 0.02  # lasers sit up to 4 cm above or below the origin
    assert set(np.unique(found.points[:, 4])) == set(range(128))
    assert found.times_ns.min() >= times[0] - 10_000  # the first group fires 7 us early
    assert found.times_ns.max() < end
    # Azimuth, clockwise, grows with time; single lasers are turned by up to 7 degrees.
    azimuth = np.degrees(np.arctan2(-found.points[:, 1], found.points[:, 0])) % 360
    from_time = (found.times_ns - times[0]) * 1e-9 * 3600
    off = (azimuth - from_time + 180) % 360 - 180
    assert np.abs(off).max() < 8


def test_decoding_in_chunks_is_decoding_at_once(monkeypatch):
    packets = parsed(vls128_packets(300), VLS128_PACKET_NS)
    times = packets.host_ns
    chunked = RevolutionDecoder(None).decode(packets, times)
    monkeypatch.setattr("bagassets.decode.velodyne._CHUNK", 10_000)
    at_once = RevolutionDecoder(None).decode(packets, times)
    assert np.array_equal(chunked.points, at_once.points)
    assert np.abs(chunked.times_ns - at_once.times_ns).max() <= 4  # single precision of 52 ms


def test_no_return_gives_no_point_and_a_dual_return_two():
    packets = vlp16_packets(0.02)[:1]
    packets["blocks"]["returns"]["distance"][0, 6:] = 0
    found = RevolutionDecoder(None).decode(parsed(packets), np.array([START_NS]))
    assert len(found.points) == 192
    dual = vlp16_packets(0.02)[:1]
    dual["mode"] = 0x39
    dual["blocks"]["azimuth"][0, 1::2] = dual["blocks"]["azimuth"][0, ::2]
    dual["blocks"]["returns"]["distance"][0, 0::2] = 5_000
    found = RevolutionDecoder(None).decode(parsed(dual), np.array([START_NS]))
    assert len(found.points) == 384
    distances = np.sqrt((found.points[:, :3] ** 2).sum(axis=1))
    assert set(np.round(distances).tolist()) == {10.0, 20.0}


def test_far_points_are_kept():
    packets = vlp16_packets(0.02, distance_mm=130_000)[:1]
    found = RevolutionDecoder(None).decode(parsed(packets), np.array([START_NS]))
    assert len(found.points) == 384


MODELS = {
    "HDL-32E": 0x21,
    "VLP-16": 0x22,
    "Puck Hi-Res": 0x24,
    "VLP-32A": 0x23,
    "VLP-32B": 0x23,
    "VLP-32C": 0x28,
    "VLS-128": 0xA1,
}
MODES = [0, 0x37, 0x38, 0x39]


def any_packets(rng, product, modes):
    """Packets with all that may be in them: lost returns, equal ones, other flags, azimuths that no lidar sends."""
    packets = np.zeros(int(rng.integers(1, 150)), PACKET)
    flags = BANK_FLAGS if product == MODELS["VLS-128"] else BANK_FLAGS[:1]
    blocks = packets["blocks"]
    blocks["flag"] = np.resize(flags, 12) if rng.random() < 0.5 else np.resize(np.repeat(flags, 2), 12)
    damaged = rng.random(blocks.shape) < 0.02
    blocks["flag"][damaged] = rng.choice([0xDDFF, 0xBBFF, 0xAAFF, 0xFFFF, 0xEEFE, 0], damaged.sum())
    steps = rng.integers(0, int(rng.choice([80, 65_536])), blocks.shape)
    blocks["azimuth"] = np.cumsum(steps).reshape(blocks.shape) % int(rng.choice([36_000, 65_536]))
    blocks["flag"][:, 0], blocks["azimuth"][:, 0] = 0xEEFF, blocks["azimuth"][:, 0] % 36_000
    distances = rng.integers(0, 65_536, (*blocks.shape, 32))
    distances[rng.random(distances.shape) < 0.3] = 0
    alike = rng.random((len(packets), 6, 32)) < 0.3
    distances[:, 1::2][alike] = distances[:, ::2][alike]
    blocks["returns"]["distance"] = distances
    blocks["returns"]["intensity"] = rng.integers(0, 256, distances.shape)
    apart_us = rng.choice([53, 58, 100, 153, 154, 160, 166, 167, 173, 179, 180], len(packets))
    packets["us"] = (int(rng.integers(2**32)) + np.cumsum(apart_us)) % 2**32
    packets["mode"], packets["product"] = rng.choice(modes, len(packets)), product
    return packets


@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([MODES, *([mode] for mode in MODES)]))
def test_machine_code_gives_the_bits_of_the_library(model, seed, modes):
    rng = np.random.default_rng(seed)
    packets = any_packets(rng, MODELS[model], modes)
    times_ns = START_NS + np.cumsum(rng.integers(50_000, 2_000_000, len(packets)))
    taken = Packets(times_ns, packets)
    ours, library = RevolutionDecoder(model), RevolutionDecoder(model)
    library._decoder = velodyne._Library(velodyne._model(model)[0]).take
    for part in itertools.pairwise([0, *sorted(rng.integers(0, len(packets), 2)), len(packets)]):
        found, expected = (
            decoder.decode(taken[slice(*part)], times_ns[slice(*part)]) for decoder in (ours, library)
        )
        assert found.points.tobytes() == expected.points.tobytes()
        assert found.times_ns.tolist() == expected.times_ns.tolist()
    assert ours._decoder.func is velodyne._take_by_machine_code


def test_without_machine_code_the_library_decodes(monkeypatch):
    packets = parsed(vls128_packets(300), VLS128_PACKET_NS)
    times_ns = packets.host_ns
    expected = RevolutionDecoder(None).decode(packets, times_ns)
    monkeypatch.setattr(machine_code, "_ALL", [])
    monkeypatch.setattr(returns, "_TAKE", MachineCode("none", lambda: "this is no function"))
    monkeypatch.setattr(velodyne, "all_azimuths", velodyne.all_azimuths.__wrapped__)
    decoder = RevolutionDecoder(None)
    found = decoder.decode(packets, times_ns)
    assert isinstance(decoder._decoder.__self__, velodyne._Library)
    with pytest.raises(RuntimeError, match="no machine code"):
        head_of(velodyne._model("VLS-128")[0], 1)
    assert found.points.tobytes() == expected.points.tobytes()
    assert found.times_ns.tolist() == expected.times_ns.tolist()


def test_packets_whose_stamps_stand_still_are_not_collected_without_end():
    number = MOST_PACKETS + 10
    turns = cut(parsed(np.zeros(number, PACKET), packet_ns=0))
    assert max(len(turn.packets) for turn in turns) == MOST_PACKETS
    assert sum(len(turn.packets) for turn in turns) == number
