"""Packets of Hesai lidars through the step `sweeps`: revolutions, clocks, corrections, what is lost."""

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest

from bagassets.assets.sweeps import SWEEPS
from bagassets.base.errors import LossLimitError, RecipeError
from bagassets.recipe.model import Rig
from bagassets.recordings.skim import SkimmedPackets
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of
from bagassets_tests.hesai_data import (
    DUAL,
    FRAME,
    LAYOUTS,
    SCAN,
    TURN_NS,
    UNITS_M,
    Packet,
    Scan,
    corrections,
    distance,
    messages,
    packet,
    seen,
    spin,
)
from bagassets_tests.sweep_data import EthernetPacket, Messages, header, raw, vlp16_packets
from bagassets_tests.sweep_run import MOUNT, PACKET, START_NS, Runner, driving, inventory, lidar, scans

FILE = Path("/correction.csv")
BESIDE = "/lidar_corrections"


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


def request(model="XT32", msgtype=SCAN, *, text=None, clock="header", limit=0.0, beside=False, **fields):
    fields = {"metadata": None if beside else FILE, **fields}
    rig = Rig(name="car", channels={"LIDAR_TOP": lidar(**fields)}, ego_pose={"source": "fixed"})
    known = inventory(msgtype)
    if beside:
        published = replace(known.topics["/sensor"], name=BESIDE, msgtype="std_msgs/msg/UInt8MultiArray")
        known = replace(known, topics=MappingProxyType({BESIDE: published, **known.topics}))
    facts = MadeUpFacts(
        known,
        calibration=calibrated(LIDAR_TOP={"ego_SE3_sensor": MOUNT}),
        artifacts={"ego_poses": SimpleNamespace(digest="p")},
        files={FILE: text or corrections(LAYOUTS[model].channels)},
    )
    return use_of(SWEEPS, rig, facts, "LIDAR_TOP", clock=clock, limits={"lost_messages": limit})


def first_ns(model):
    """From the time of a packet to its first firing."""
    return {
        "Pandar40P": -28_580 - 9 * 55_560 - 54_670,
        "Pandar64": -42_580 - 5 * 55_560 - 54_668,
        "QT64": 28_020,
        "XT16": -344_000,
        "XT32": -344_000,
        "XT32M2X": -244_000,
        "QT128": 9_000,
    }[model]


@pytest.mark.parametrize("model", LAYOUTS)
def test_packets_become_complete_revolutions(run, model):
    result = run(request(model), messages(model, 2.5, begin=0.5, start_ns=START_NS))
    number = LAYOUTS[model].steps()
    assert result.lost == {"incomplete revolution": number - round(0.5 * number)}
    assert result.summary["counts"]["read"] == round(3 * number) - round(0.5 * number)
    points = number * LAYOUTS[model].blocks * LAYOUTS[model].channels
    assert [row["points"] for row in result.index] == [points] * 2
    for turn, row in enumerate(result.index, start=1):
        begin_ns = START_NS + turn * TURN_NS + first_ns(model)
        assert abs(row["start_ns"] - begin_ns) <= 1_000, "the lidar's times are microseconds"
        assert row["end_ns"] - row["start_ns"] == pytest.approx(TURN_NS, abs=1_000)
        assert row["stamp_ns"] == row["end_ns"]
    lowest = LAYOUTS[model].channels - 1
    point = result.points()[0]
    np.testing.assert_allclose(
        point[:3],
        seen(0.0, lowest, LAYOUTS[model].channels, distance(lowest) * UNITS_M[model]),
        atol=1e-4,
    )
    assert point[3:].tolist() == [lowest, 0]
    assert result.channel["frame_id"] == "lidar"


def test_points_are_within_the_revolution(run):
    driven = driving(10.0, seconds=2.0)
    asked = request(deskew=True, stamp="start")
    result = run(asked, messages("XT32", 2, start_ns=START_NS), trajectory=driven)
    still = run(request(stamp="start"), messages("XT32", 2, start_ns=START_NS))
    moved = result.points()[:, 0] - still.points()[:, 0]
    # At 10 m/s, from the start of a revolution to when each point was measured.
    assert moved.min() >= -1e-4
    assert moved.max() == pytest.approx(1.0, abs=0.01)


def test_two_returns_take_twice_the_packets(run):
    result = run(request(), messages("XT32", 1, start_ns=START_NS, mode=DUAL, returns=2))
    number = LAYOUTS["XT32"].steps(2)
    assert number == 2 * LAYOUTS["XT32"].steps()
    assert [row["points"] for row in result.index] == [number * 8 * 32]


def test_a_lidar_may_count_other_hours_than_the_host(run):
    result = run(request(), messages("XT32", 3, start_ns=START_NS, start_us=3_599_950_000))
    assert [round((row["start_ns"] - START_NS - first_ns("XT32")) / TURN_NS, 3) for row in result.index] == [
        0,
        1,
        2,
    ]


def test_jitter_of_the_host_does_not_move_revolutions(run):
    sent = []
    # The lidar's microseconds begin again in the middle.
    packets = messages("XT32", 2, start_ns=START_NS, per_message=1, start_us=5_950_000)
    for number, one in enumerate(packets):
        late_ns = 2_000_000 * (number % 5 == 0)
        (only,) = one.data.message.packets
        stamp = header(only.stamp.sec * 10**9 + only.stamp.nanosec + late_ns).stamp
        sent.append(raw(Scan(header(START_NS), [Packet(stamp, only.data, only.size)]), SCAN, START_NS))
    result = run(request(), sent)
    assert abs(result.index[0]["start_ns"] - START_NS - first_ns("XT32")) <= 1_000


@pytest.mark.parametrize("clock", ["header", "log"])
def test_messages_of_hesais_driver_have_one_stamp(run, clock):
    """Its header has the time of the first packet; a message is logged after the last one."""
    sent = list(messages("XT32", 3, start_ns=START_NS, stamped=False, msgtype=FRAME, size=None))
    result = run(request(msgtype=FRAME, clock=clock), sent)
    assert [abs(row["start_ns"] - START_NS - first_ns("XT32") - n * TURN_NS) <= 1_000 for n, row in enumerate(result.index)] == [True] * 3  # fmt: skip


def test_messages_may_hold_single_packets(run):
    sent = [
        raw(EthernetPacket(header(START_NS + since_ns), np.frombuffer(data, np.uint8)), PACKET, START_NS)
        for since_ns, data in spin("XT32", 2)
    ]
    result = run(request(msgtype=PACKET), sent)
    assert len(result.index) == 2


def test_a_part_of_each_turn_is_one_sweep(run):
    def sent():
        for since_ns, data in spin("XT32", 5):
            azimuth_deg = int.from_bytes(data[12:14], "little") / 100
            if not 90 <= azimuth_deg < 200:
                made = Packet(header(START_NS + since_ns).stamp, np.frombuffer(data, np.uint8), len(data))
                yield raw(Scan(header(START_NS), [made]), SCAN, START_NS + since_ns)

    result = run(request(), sent())
    # From 145 degrees to 145 degrees; half of the first one is missing, and of the last one.
    assert len(result.index) == 4
    assert list(result.lost) == ["incomplete revolution"]
    cut = run(request(cut_angle_deg=10), sent())
    assert abs(cut.index[0]["start_ns"] - START_NS - first_ns("XT32") - TURN_NS / 36) < 500_000


def test_what_is_no_data_packet_is_counted(run):
    sent = list(messages("XT32", 1, start_ns=START_NS))
    odd = [bytes(512), bytes(99), packet("XT16"), packet("XT32", mode=0)]
    packets = [Packet(header(START_NS).stamp, np.frombuffer(data, np.uint8), len(data)) for data in odd]
    result = run(request(limit=1.0), [*sent, raw(Scan(header(START_NS), packets), SCAN, START_NS)])
    assert result.lost == {
        "position packet": 1,
        "it holds no data packet of 1076 bytes": 2,
        "its packet has an unknown return mode": 1,
    }
    assert len(result.index) == 1


class Skimmed(Messages):
    """A topic whose packets can be had at once."""

    def packets(self, messages, payloads):
        found = [one.message.payload for one in messages]
        if len({len(payload) for payload in found}) != 1:
            return None
        stamps_ns = np.full(len(found), START_NS, dtype=np.int64)
        return SkimmedPackets(stamps_ns, "lidar", np.stack(found))


def test_packets_of_a_velodyne_on_the_topic_of_a_hesai_are_refused(run):
    def single(data, number):
        payload = np.frombuffer(data, np.uint8)
        return raw(EthernetPacket(header(START_NS + number), payload), PACKET, START_NS)

    ours = [single(data, since_ns) for since_ns, data in spin("XT32", 2)]
    others = [single(data.tobytes(), TURN_NS) for data in vlp16_packets(4)[:256]]
    asked = request(msgtype=PACKET, limit=1.0)
    result = run(asked, [*ours[:256], *others, *ours[256:]], recording=Skimmed())
    assert result.lost["it holds no data packet of 1076 bytes"] == 256
    result = run(request(msgtype=PACKET, metadata=None), others, recording=Skimmed())
    assert result.index, "of a Velodyne, they are read"


def test_packets_of_no_known_lidar_say_which_are(run):
    data = np.frombuffer(b"\xee\xff\x01\x04" + bytes(857), np.uint8)
    odd = raw(Scan(header(START_NS), [Packet(header(START_NS).stamp, data, len(data))]), SCAN, START_NS)
    with pytest.raises(LossLimitError, match=r"no data packet of a Velodyne \(1206 bytes\).*Hesai.*QT128"):
        run(request(), [odd])


# --- correction files ------------------------------------------------------------------------


def test_the_content_of_the_correction_file_is_part_of_the_action():
    one, other = request(), request(text=corrections(32, lowest_first=True))
    assert one.inputs["metadata"] != other.inputs["metadata"]
    assert one.inputs.keys() - request(msgtype=PACKET, metadata=None).inputs.keys() == {"metadata"}


def test_without_a_correction_file_it_is_asked_for(run):
    with pytest.raises(RecipeError) as caught:
        run(request(metadata=None), messages("XT32", 1, start_ns=START_NS))
    assert str(caught.value) == (
        "LIDAR_TOP: the packets in /sensor are of a Hesai XT32, and do not say where its channels point; name the correction file "
        "of the lidar (CSV) in `metadata` of the channel."
    )


def test_a_correction_file_of_another_model_is_refused(run):
    with pytest.raises(
        RecipeError, match=r"Hesai XT32, but the file in `metadata`.*each of 32 channels; name"
    ):
        run(request(text=corrections(16)), messages("XT32", 1, start_ns=START_NS))


def test_a_correction_file_that_cannot_be_read_is_an_error():
    with pytest.raises(RecipeError, match=r"LIDAR_TOP: /other.csv: the metadata cannot be read"):
        request(metadata=Path("/other.csv"))


@pytest.mark.parametrize("model", [None, "VLP-16"])
def test_a_velodyne_has_no_correction_file(run, model):
    asked = request()
    with pytest.raises(
        RecipeError, match=r"LIDAR_TOP: metadata can be set for packets of Ouster and Hesai only.*Velodyne"
    ):
        run(replace(asked, params=replace(asked.params, model=model)), scans(1))


def test_the_model_of_a_velodyne_is_none_of_a_hesai(run):
    asked = request(metadata=None)
    with pytest.raises(LossLimitError, match="no data packet of 1206 bytes"):
        run(
            replace(asked, params=replace(asked.params, model="VLP-16")),
            messages("XT32", 1, start_ns=START_NS),
        )


class Published(Messages):
    """A recording in which Hesai's driver published these correction files."""

    def __init__(self, *texts):
        super().__init__()
        self.texts = texts

    @contextmanager
    def open(self, topics):
        assert topics == (BESIDE,)
        yield self

    def messages(self, topics):
        arrays = [SimpleNamespace(data=np.frombuffer(text, np.uint8)) for text in self.texts]
        return [raw(one, "std_msgs/msg/UInt8MultiArray", 0, topics[0]) for one in arrays]


def of_recording(folder, *texts):
    asked = request(beside=True)
    assert (asked.topics, "metadata" in asked.inputs) == (("/sensor", BESIDE), False)
    recording = Published(*texts)
    inputs = SimpleNamespace(messages=recording.open)
    extractor = SWEEPS.extract(asked, inputs, recording, ArtifactWriter(folder / "made"), None)
    for message in messages("XT32", 1, start_ns=START_NS):
        extractor.add(message)
    return extractor.finish()


def test_a_correction_file_that_was_published_is_found(tmp_path):
    text = corrections(32)
    assert of_recording(tmp_path, text, text, text + b"another checksum")["counts"]["written"] == 1


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        ((), "it is empty"),
        ((corrections(16),), "each of 32 channels"),
        ((corrections(32), corrections(32, lowest_first=True)), "in 2 ways"),
    ],
)
def test_what_was_published_must_say_where_channels_point(tmp_path, texts, why):
    with pytest.raises(
        RecipeError, match=rf"but {BESIDE} does not say where its channels point: .*{why}; name"
    ):
        of_recording(tmp_path, *texts)


def test_a_velodyne_beside_published_corrections_is_read(tmp_path):
    asked = request(beside=True, msgtype=PACKET)
    recording = Published()
    extractor = SWEEPS.extract(asked, SimpleNamespace(), recording, ArtifactWriter(tmp_path / "made"), None)
    for number, data in enumerate(vlp16_packets(1)):
        extractor.add(
            raw(
                EthernetPacket(
                    header(START_NS + number * 1_327_104), np.frombuffer(data.tobytes(), np.uint8)
                ),
                PACKET,
                START_NS,
            )
        )
    assert extractor.finish()["counts"]["written"] == 1
