"""Packets of Hesai lidars: models, layouts, correction files, times and points against the manuals."""

import numpy as np
import pytest

from bagassets.base.errors import DecodeError
from bagassets.decode.hesai import MODELS, HesaiLidar, HesaiPackets, corrections_beside, packet_and_model
from bagassets.decode.packets import packets_in
from bagassets_tests.hesai_data import (
    DUAL,
    LAYOUTS,
    SINGLE,
    TRIPLE,
    UNITS_M,
    Packet,
    Scan,
    corrections,
    distance,
    elevation,
    packet,
    seen,
)
from bagassets_tests.sweep_data import header

START_NS = 1_700_000_000_000_000_000
# From the time of a packet: channel 1 of the first block, and the last channel of the last one, as manuals and tables have it.
FIRED_NS = {
    "Pandar40P": (-28_580 - 9 * 55_560 - 42_220, -28_580 - 3_620),
    "Pandar64": (-42_580 - 5 * 55_560 - 23_180, -42_580 - 12_748),
    "QT64": (25_710 + 2_310, 25_710 + 500_000 + 136_450),
    "XT16": (-7 * 50_000 + 6_000, 51_360),
    "XT32": (-7 * 50_000 + 6_000, 52_872),
    "XT32M2X": (-5 * 50_000 + 6_000, 49_320),
    "QT128": (9_000 + 0, 9_000 + 111_110 + 48_976),
}
MODES = [(SINGLE, 1), (DUAL, 2)]


def parsed(model, *payloads, text=None):
    taken = [packet_and_model(payload) for payload in payloads]
    assert {one[1].name for one in taken} == {model}
    lidar = HesaiLidar.parse(taken[0][1], text or corrections(LAYOUTS[model].channels))
    return lidar, np.frombuffer(b"".join(one[0] for one in taken), taken[0][1].packet)


def decoded(model, *payloads, by_log_time=False, text=None):
    lidar, data = parsed(model, *payloads, text=text)
    assert not lidar.refusals(data)
    times_ns = START_NS + 1_000_000 * np.arange(len(data))
    return lidar.decode(HesaiPackets.of(times_ns, data, by_log_time=by_log_time), times_ns)


def test_every_model_is_tested():
    assert [model.name for model in MODELS] == list(LAYOUTS)


@pytest.mark.parametrize(("size", "number"), [(0, 0), (4, 4), (6, 6), (99, 6), (-1, 6), ("4", 6), (None, 6)])
def test_a_message_says_how_much_of_an_array_is_a_packet(size, number):
    message = Scan(header(START_NS), [Packet(header(START_NS).stamp, np.arange(6, dtype=np.uint8), size)])
    assert packets_in(message) == [(START_NS, bytes(range(number)))]


# --- which model it is -----------------------------------------------------------------------


@pytest.mark.parametrize("model", LAYOUTS)
@pytest.mark.parametrize("trailing", [0, 4, 36])
def test_models_are_told_by_their_packets(model, trailing):
    sent = packet(model)
    found = packet_and_model(sent + bytes(trailing))
    assert found is not None
    assert (found[0], found[1].name) == (sent, model)


@pytest.mark.parametrize("model", LAYOUTS)
def test_other_bytes_are_no_packet(model):
    sent = packet(model)
    at = {0: 0, 8: 3}.get(len(LAYOUTS[model].head), 7)  # the number of blocks
    for other in (
        sent[:-1],
        sent + bytes(37),
        bytes(2) + sent[2:],
        sent[:at] + b"\x63" + sent[at + 1 :],
        bytes(1206),
        b"",
    ):
        assert packet_and_model(other) is None


# --- points ----------------------------------------------------------------------------------


@pytest.mark.parametrize("model", LAYOUTS)
def test_points_are_where_they_were_seen(model):
    found = decoded(model, packet(model, 350.0, step=4.0))
    channels, blocks = LAYOUTS[model].channels, LAYOUTS[model].blocks
    assert len(found.points) == channels * blocks
    for block in range(blocks):
        # The file has the highest channel first, and rings count from the lowest.
        for ring, point in enumerate(found.points[block * channels : (block + 1) * channels]):
            channel = channels - 1 - ring
            place = seen(350.0 + 4.0 * block, channel, channels, distance(channel) * UNITS_M[model])
            np.testing.assert_allclose(point[:3], place, atol=1e-5)
            assert point[3:].tolist() == [channel, ring]


@pytest.mark.parametrize("model", LAYOUTS)
def test_channels_fire_one_after_the_other(model):
    found = decoded(model, packet(model), packet(model))
    channels = LAYOUTS[model].channels
    first, last = FIRED_NS[model]
    times_ns = found.times_ns - START_NS
    # Rings count from the lowest channel, which is the last one.
    assert times_ns[channels - 1] == first
    assert times_ns[len(times_ns) // 2 - channels] == pytest.approx(last, abs=1)
    np.testing.assert_array_equal(times_ns[: len(times_ns) // 2] + 1_000_000, times_ns[len(times_ns) // 2 :])
    assert found.begin_ns == times_ns[:channels].min()


def test_firing_times_are_those_of_hesais_tables():
    """Sums of channel times nanoseconds, so that no figure can be mistyped, or swapped with another."""
    sums = {m.name: int((m.channels_ns * np.arange(1, m.channels + 1)).sum()) for m in MODELS}
    assert sums == {
        "Pandar40P": -20_829_490,
        "Pandar64": -46_288_704,
        "QT64": 191_062_750,
        "XT16": 4_112_640,
        "XT32": 16_498_944,
        "XT32M2X": 13_400_320,
        "QT128": 738_949_120,
    }


@pytest.mark.parametrize(
    ("loop", "returns", "channel", "block", "fired_ns"),
    [
        (1, 1, 98, 0, 9_600),  # the first that fires of loop 1
        (1, 1, 64, 1, 111_110 + 9_600),
        (0, 1, 64, 0, 9_600),  # and of loop 2
        (0, 1, 98, 1, 111_110 + 9_600),
        (1, 1, 34, 0, 9_000 + 2_312),
        (0, 1, 0, 0, 9_000 + 2_312),
        (1, 1, 59, 0, 9_000 + 97_352),
        (1, 2, 98, 1, 9_600),  # the second return of the same firing
        (0, 2, 64, 1, 9_600),
        (0, 2, 93, 0, 9_000 + 48_120),
    ],
)
def test_a_qt128_fires_in_two_loops(loop, returns, channel, block, fired_ns):
    sent = packet("QT128", loop=loop, mode=SINGLE if returns == 1 else DUAL, returns=returns)
    found = decoded("QT128", sent, text=corrections(128, lowest_first=True))
    ring = found.points[:, 4] == channel
    assert found.times_ns[ring][block] - START_NS == fired_ns


@pytest.mark.parametrize("model", LAYOUTS)
def test_both_returns_of_a_firing_are_points(model):
    sent = packet(model, 10.0, step=4.0, mode=DUAL, returns=2)
    found = decoded(model, sent)
    channels, blocks = LAYOUTS[model].channels, LAYOUTS[model].blocks
    assert len(found.points) == channels * blocks
    single = decoded(model, packet(model))
    for number in range(0, len(found.points), 2):
        firing, ring = divmod(number // 2, channels)
        channel = channels - 1 - ring
        for late, point in enumerate(found.points[number : number + 2]):
            place = seen(10.0 + 4.0 * firing, channel, channels, distance(channel, late) * UNITS_M[model])
            np.testing.assert_allclose(point[:3], place, atol=1e-5)
            assert point[3:].tolist() == [channel + 100 * late, ring]
        assert found.times_ns[number] == found.times_ns[number + 1]
    if model not in {"QT64", "QT128"}:  # times are those of the last block
        assert found.times_ns[-1] == single.times_ns[-1]


def test_a_return_that_is_reported_twice_counts_once():
    def distances(channel, late):
        return 500 if channel == 3 or late == 0 else 700 + late

    triple = packet("XT32M2X", mode=TRIPLE, returns=3, distances=distances)
    found = decoded("XT32M2X", triple)
    # Reflectivities differ: nothing is reported twice.
    assert len(found.points) == 6 * 32
    assert len(np.unique(found.times_ns)) == 2 * 16  # two firings of sixteen pairs of channels
    at = 12 + 2 + 4 * 3 + 2
    block = 2 + 4 * 32
    alike = bytearray(triple)
    for late in (1, 2):
        alike[at + late * block] = alike[at]
    found = decoded("XT32M2X", bytes(alike))
    assert len(found.points) == 6 * 32 - 2
    ring = found.points[:, 4] == 31 - 3
    assert found.points[ring][:, 3].tolist() == [3, 3, 103, 203]
    alike[at + block] = 103  # the first and the last one are still alike
    assert len(decoded("XT32M2X", bytes(alike)).points) == 6 * 32 - 1


def test_nothing_was_hit_where_the_distance_is_0():
    found = decoded("XT16", packet("XT16", distances=lambda channel, _late: 0 if channel == 5 else 100))
    assert sorted({int(ring) for ring in found.points[:, 4]}) == [ring for ring in range(16) if ring != 10]
    empty = decoded("XT16", packet("XT16", distances=lambda *_: 0))
    assert empty.points.shape == (0, 5)


def test_the_unit_of_distances_is_in_the_packet():
    sent = bytearray(packet("XT16"))
    sent[9] = 2
    found = decoded("XT16", bytes(sent))
    np.testing.assert_allclose(np.linalg.norm(found.points[0, :3]), distance(15) * 0.002, rtol=1e-6)


def test_returns_may_change_in_the_middle_of_a_revolution():
    sent = [packet("XT32", mode=mode, returns=returns) for mode, returns in [*MODES, *MODES]]
    found = decoded("XT32", *sent)
    assert len(found.points) == 4 * 8 * 32
    numbers = np.round((found.times_ns - START_NS) / 1e6).astype(int)
    assert np.bincount(numbers).tolist() == [8 * 32] * 4


def test_what_cannot_be_decoded_is_refused():
    sent = [bytearray(packet("XT16")) for _ in range(6)]
    sent[1][12:14] = (36_000).to_bytes(2, "little")
    mode_at = len(sent[0]) - 24 + 10
    sent[2][mode_at] = 0
    sent[3][mode_at] = TRIPLE  # which eight blocks are no multiple of
    sent[4][12 + 7 * 66 : 14 + 7 * 66] = (35_999).to_bytes(2, "little")
    sent[5][9] = 0
    lidar, data = parsed("XT16", *map(bytes, sent))
    assert lidar.refusals(data) == {
        1: "its packet has azimuths beyond a turn",
        2: "its packet has an unknown return mode",
        3: "its packet has an unknown return mode",
        5: "its packet has no unit of distances",
    }


# --- correction files ------------------------------------------------------------------------

GOOD = corrections(16)


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        b"\xef\xbb\xbf" + GOOD.replace(b"\n", b"\r\n"),
        b"\xef\xbb\xbf" + GOOD.partition(b"\n")[2],
        b"EEFF,1,1\n" + GOOD + b"# a checksum\n0123456789abcdef,\n",
        b"\n".join(reversed(GOOD.split(b"\n"))),
        GOOD.replace(b",", b", "),
        GOOD.replace(b".000\n", b".000,1\n"),
    ],
)
def test_correction_files_are_read_however_they_are_written(text):
    model = MODELS[3]
    lidar = HesaiLidar.parse(model, text)
    assert lidar.angles_deg == tuple((elevation(one, 16), float(one % 3 - 1)) for one in range(16))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"", "each of 16 channels"),
        (b"\xff\xfe\x00", "each of 16 channels"),
        (GOOD.replace(b"\n16,", b"\n17,"), "each of 16 channels"),
        (corrections(32), "each of 16 channels"),
        (GOOD.replace(b",", b";"), "lacks channel,elevation,azimuth of each of 16 channels"),
        (GOOD + b"3,1.0,1.0\n", "channel 3 twice"),
        (
            GOOD.replace(b"Elevation,Azimuth", b"Azimuth,Elevation"),
            "its second column is not the elevation: Laser id,Azimuth,Elevation",
        ),
        (
            GOOD.replace(b"\n", b"\n1,").replace(b"Laser", b"Rig,Laser"),
            "not the elevation: Rig,Laser id,Elevation,Azimuth",
        ),
        (GOOD.replace(b"1,7.000", b"1,nan"), "not degrees"),
        (GOOD.replace(b"1,7.000", b"1,1e9"), "not degrees"),
    ],
)
def test_a_file_without_the_angles_of_each_channel_is_refused(text, why):
    with pytest.raises(DecodeError, match=why):
        HesaiLidar.parse(MODELS[3], text)


def test_corrections_are_published_beside_the_packets():
    assert corrections_beside("/lidar_packets") == "/lidar_corrections"
    assert corrections_beside("/front/lidar_packets") == "/front/lidar_corrections"


# --- times -----------------------------------------------------------------------------------


@pytest.mark.parametrize("model", LAYOUTS)
def test_the_lidar_counts_from_the_top_of_the_hour(model):
    us = 59 * 60_000_000 + 58 * 1_000_000 + 123_456
    _, data = parsed(model, packet(model, us=us))
    assert HesaiPackets(np.array([START_NS]), data).device_us.tolist() == [us]


@pytest.mark.parametrize(("by_log_time", "apart_us"), [(False, [0, 500, 900]), (True, [-900, -400, 0])])
def test_packets_of_one_message_have_the_times_between_them_of_the_lidar(by_log_time, apart_us):
    """Hesai's own driver stamps a message with the time of its first packet."""
    us = [3_599_999_800, 300, 700, 3_000, 3_600]
    _, data = parsed("XT32", *(packet("XT32", us=one) for one in us))
    stamps_ns = np.array([START_NS] * 3 + [START_NS + 5_000_000] * 2)
    packets = HesaiPackets.of(stamps_ns, data, by_log_time=by_log_time)
    assert ((packets.host_ns[:3] - START_NS) // 1000).tolist() == apart_us
    later_us = [-600, 0] if by_log_time else [0, 600]
    assert ((packets.host_ns[3:] - START_NS - 5_000_000) // 1000).tolist() == later_us
    assert isinstance(packets[1:], HesaiPackets)
    assert packets[1:].device_us.tolist() == us[1:]
