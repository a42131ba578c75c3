"""The step `sweeps`: what it declares, what it writes, and that nothing gets lost unseen."""

import itertools
import json
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pyarrow.parquet as pq
import pytest

from bagassets.bags.inventory import Definition, Gap, Inventory, TopicRecord
from bagassets.errors import CalibrationError, DecodeError, LossLimitError, PoseError, RecipeError
from bagassets.geometry.trajectory import Trajectory
from bagassets.nuscenes.lidar_file import read_lidar_file
from bagassets.nuscenes.radar_file import read_radar_file
from bagassets.recipe.model import LidarChannel, Limits, RadarChannel
from bagassets.steps import sweeps
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.sweep_data import (
    VLP16_PACKET_NS,
    EthernetPacket,
    Header,
    Messages,
    Scan,
    cloud,
    header,
    raw,
    velodyne_scan,
    vlp16_packets,
)

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
CLOUD = "sensor_msgs/msg/PointCloud2"
LASER = "sensor_msgs/msg/LaserScan"
SCAN = "velodyne_msgs/msg/VelodyneScan"
PACKET = "ethernet_msgs/msg/Packet"
MOUNT = {"translation": [1.0, 0.0, 2.0], "rotation": [1.0, 0.0, 0.0, 0.0]}


def inventory(msgtype, count=11, *, period_ns=PERIOD_NS, gaps=(), header_stamps=True):
    span = (count - 1) * period_ns + round(sum(gap.duration_s for gap in gaps) * 1e9)
    stamps = (START_NS, START_NS + span) if header_stamps else (None, None)
    fields = {
        "name": "/sensor", "msgtype": msgtype, "count": count, "bytes": 1, "digest": "d" * 64, "first_ns": START_NS + 5,
        "last_ns": START_NS + 5 + span, "first_stamp_ns": stamps[0], "last_stamp_ns": stamps[1], "rate_hz": 10.0,
        "max_gap_s": 0.1, "gaps": tuple(gaps), "gap_count": len(gaps), "header_offset_s": None, "unordered_stamps": 0,
        "frame_ids": ("lidar",), "packed": False, "problem": None, "definition": Definition("none", ""),
        "serialization": "cdr",
    }  # fmt: skip
    names = TopicRecord.__dataclass_fields__
    record = TopicRecord(**{name: value for name, value in fields.items() if name in names})
    topics = MappingProxyType({"/sensor": record})
    return Inventory("mcap", 1, START_NS, START_NS + span, topics, None, None, ())


def request(channel, msgtype, clock="header", *, limit=0.01, mount=None, poses=None, **options):
    return sweeps.request(
        "LIDAR_TOP" if isinstance(channel, LidarChannel) else "RADAR_FRONT", channel, clock,
        Limits(lost_messages=limit), inventory(msgtype, **options), ego_SE3_sensor=mount, ego_poses_digest=poses,
    )  # fmt: skip


class Run:
    """The result of feeding messages to the step."""

    def __init__(self, folder, asked, messages, trajectory=None):
        self.writer = ArtifactWriter(folder / "artifact")
        extractor = sweeps.SweepExtractor(asked.params, Messages(), self.writer, trajectory)
        assert extractor.topics == asked.topics == ("/sensor",)
        for message in messages:
            extractor.add(message)
        self.summary = extractor.finish()
        self.files = folder / "artifact" / "files"
        self.digest = self.writer.finish(self.summary)
        self.channel = json.loads((self.files / "channel.json").read_text())
        self.index = pq.read_table(self.files / "index.parquet").to_pylist()
        counts, points = self.summary["counts"], self.summary["points"]
        assert counts["read"] == counts["written"] + counts["merged"] + sum(counts["lost"].values())
        assert points["read"] == points["written"] + sum(points["dropped"].values())
        assert counts["written"] == len(self.index)
        assert points["written"] == sum(row["points"] for row in self.index)
        assert self.channel["counts"] == counts
        assert self.summary["bytes"] == sum(row["size"] for row in self.index)

    @property
    def lost(self):
        return self.summary["counts"]["lost"]

    def points(self, row=0):
        return read_lidar_file(self.files / self.index[row]["file"])


@pytest.fixture
def run(tmp_path):
    made = []

    def go(*args, **kwargs):
        made.append(None)
        folder = tmp_path / str(len(made))
        folder.mkdir()
        return Run(folder, *args, **kwargs)

    return go


def lidar(**fields):
    return LidarChannel(topic="/sensor", **fields)


def clouds(number, msgtype=CLOUD, *, log_delay_ns=7_000_000, **columns):
    for index in range(number):
        stamp = START_NS + index * PERIOD_NS
        xyz = {axis: np.arange(1, 5, dtype=np.float32) + index for axis in "xyz"}
        yield raw(cloud(stamp, xyz | columns), msgtype, stamp + log_delay_ns)


# --- what the step declares -----------------------------------------------------------------


def test_without_deskewing_neither_poses_nor_extrinsics_enter_the_key():
    plain = request(lidar(), CLOUD)
    assert plain == request(lidar(), CLOUD, mount=MOUNT, poses="p" * 64)
    assert plain.inputs == {}
    assert json.dumps(plain.params)


def test_with_deskewing_both_do():
    asked = request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p" * 64)
    assert asked.inputs == {"ego_poses": "p" * 64}
    moved = MOUNT | {"translation": [0.0, 0.0, 0.0]}
    assert asked != request(lidar(deskew=True), CLOUD, mount=moved, poses="p" * 64)


def test_fields_that_do_not_shape_the_bytes_do_not_enter_the_key():
    transform = {"translation": (1.0, 2.0, 3.0), "rotation": (1.0, 0.0, 0.0, 0.0)}
    assert request(lidar(), CLOUD) == request(lidar(frame="x", extrinsics=transform), CLOUD)
    assert request(lidar(header_stamp_is="end"), SCAN) == request(lidar(), SCAN)
    assert request(lidar(), SCAN) == request(lidar(cut_angle_deg=0.0), SCAN)


@pytest.mark.parametrize(
    "changed",
    [
        {"stamp": "start"},
        {"header_stamp_is": "end"},
        {"min_range_m": 1.0},
        {"max_range_m": 100.0},
    ],
)
def test_fields_that_shape_the_bytes_enter_the_key(changed):
    assert request(lidar(**changed), CLOUD) != request(lidar(), CLOUD)


@pytest.mark.parametrize("changed", [{"model": "VLP-16"}, {"cut_angle_deg": 180.0}])
def test_fields_of_packets_enter_the_key_of_packets_and_are_refused_for_clouds(changed):
    assert request(lidar(**changed), SCAN) != request(lidar(), SCAN)
    with pytest.raises(RecipeError, match=f"{next(iter(changed))}.*/sensor"):
        request(lidar(**changed), CLOUD)


def test_deskewing_needs_extrinsics_and_poses():
    with pytest.raises(CalibrationError, match="LIDAR_TOP"):
        request(lidar(deskew=True), CLOUD, poses="p")
    with pytest.raises(PoseError, match="LIDAR_TOP"):
        request(lidar(deskew=True), CLOUD, mount=MOUNT)


def test_the_period_leaves_pauses_out():
    assert request(lidar(), CLOUD).params["period_ns"] == PERIOD_NS
    assert request(lidar(), CLOUD, gaps=[Gap(START_NS, 3.0)], count=11).params["period_ns"] > PERIOD_NS * 0.9
    assert request(lidar(), CLOUD, count=1).params["period_ns"] is None
    assert request(lidar(), CLOUD, header_stamps=False).params["period_ns"] == PERIOD_NS


# --- clouds ---------------------------------------------------------------------------------


def test_each_cloud_becomes_a_file_named_by_its_stamp(run):
    result = run(request(lidar(), CLOUD), clouds(3))
    assert [row["stamp_ns"] for row in result.index] == [START_NS + (n + 1) * PERIOD_NS for n in range(3)]
    for number, row in enumerate(result.index):
        assert row["file"] == f"{row['stamp_ns']}.pcd.bin"
        assert row["log_time_ns"] == START_NS + number * PERIOD_NS + 7_000_000
        assert row["points"] == 4
        assert (row["start_ns"], row["end_ns"]) == (row["stamp_ns"] - PERIOD_NS, row["stamp_ns"])
    assert result.points(2)[:, 0].tolist() == [3.0, 4.0, 5.0, 6.0]
    assert result.channel["channel"] == "LIDAR_TOP"
    assert result.channel["frame_id"] == "lidar"
    assert result.channel["fileformat"] == "pcd"
    assert result.channel["camera_intrinsic"] == []
    assert result.summary["counts"] == {"read": 3, "written": 3, "merged": 0, "lost": {}}


@pytest.mark.parametrize(
    ("means", "wanted", "moved"),
    [
        ("start", "end", 1.0), ("start", "start", 0.0), ("start", "middle", 0.5),
        ("end", "end", 0.0), ("end", "start", -1.0), ("end", "middle", -0.5),
        ("middle", "end", 0.5), ("middle", "start", -0.5), ("middle", "middle", 0.0),
    ],
)  # fmt: skip
def test_the_stamp_is_the_wanted_moment_of_the_revolution(run, means, wanted, moved):
    asked = request(lidar(header_stamp_is=means, stamp=wanted), CLOUD)
    result = run(asked, clouds(1))
    assert result.index[0]["stamp_ns"] == START_NS + round(moved * PERIOD_NS)


def test_point_times_tell_the_revolution_better_than_the_period(run):
    offsets = np.array([0, 10, 20, 95], np.uint32) * 1_000_000
    result = run(request(lidar(), CLOUD), clouds(2, t=offsets))
    assert result.index[0]["stamp_ns"] == START_NS + 95_000_000
    assert result.index[0]["start_ns"] == START_NS


def test_a_single_cloud_keeps_its_stamp(run):
    result = run(request(lidar(), CLOUD, count=1), clouds(1))
    assert result.index[0]["stamp_ns"] == START_NS


def test_log_times_move_stamps_and_point_times_alike(run):
    offsets = np.array([0, 10, 20, 95], np.uint32) * 1_000_000
    result = run(request(lidar(), CLOUD, "log"), clouds(2, t=offsets))
    assert result.index[0]["stamp_ns"] == START_NS + 7_000_000 + 95_000_000
    result = run(request(lidar(stamp="start"), CLOUD, "log"), clouds(2))
    assert result.index[0]["stamp_ns"] == START_NS + 7_000_000


def test_range_limits_drop_and_count(run):
    asked = request(lidar(min_range_m=2.0, max_range_m=6.0), CLOUD)
    result = run(asked, clouds(1))  # points at sqrt(3) times 1, 2, 3, 4
    assert result.points()[:, 0].tolist() == [2.0, 3.0]
    assert result.summary["points"]["dropped"] == {
        "nearer than min_range_m": 1,
        "farther than max_range_m": 1,
    }


def test_points_that_are_not_finite_are_counted(run):
    columns = {axis: np.array([1, np.nan, 3], np.float32) for axis in "xyz"}
    result = run(request(lidar(), CLOUD), [raw(cloud(START_NS, columns), CLOUD, START_NS)])
    assert result.summary["points"] == {"read": 3, "written": 2, "dropped": {"no measurement": 1}}


def test_a_cloud_without_points_is_lost_and_counted(run):
    columns = {axis: np.array([np.nan], np.float32) for axis in "xyz"}
    messages = [raw(cloud(START_NS, columns), CLOUD, START_NS), *clouds(2)]
    result = run(request(lidar(), CLOUD), messages)
    assert result.lost == {"no point in it": 1}
    assert len(result.index) == 2


def test_of_two_clouds_in_one_microsecond_the_first_is_kept(run):
    columns = {axis: np.ones(2, np.float32) for axis in "xyz"}
    messages = [raw(cloud(START_NS + extra, columns), CLOUD, START_NS + extra) for extra in (0, 400, 1_000)]
    result = run(request(lidar(), CLOUD), messages)
    assert result.lost == {"duplicate stamp": 1}
    assert [row["stamp_ns"] - PERIOD_NS - START_NS for row in result.index] == [0, 1_000]


def test_the_index_is_sorted_though_messages_are_not(run):
    messages = list(clouds(4))
    result = run(request(lidar(), CLOUD), [messages[place] for place in (2, 0, 3, 1)])
    stamps = [row["stamp_ns"] for row in result.index]
    assert stamps == sorted(stamps)


def test_a_laser_scan_is_stamped_by_its_rays(run):
    scan = Scan(header(START_NS), np.full(11, 5.0, np.float32), np.zeros(0), time_increment=0.001)
    result = run(request(lidar(), LASER), [raw(scan, LASER, START_NS)])
    assert result.index[0]["stamp_ns"] == START_NS + 10_000_000
    assert result.points().shape == (11, 5)


def test_no_messages_give_an_empty_index(run):
    result = run(request(lidar(), CLOUD), [])
    assert result.index == []
    assert result.channel["frame_id"] == ""


# --- losses ---------------------------------------------------------------------------------


def test_a_message_that_does_not_decode_is_counted_up_to_the_limit(run):
    broken = raw(DecodeError("its bytes do not fit its type"), CLOUD, START_NS)
    result = run(request(lidar(), CLOUD, limit=0.25), [broken, *clouds(3)])
    assert result.lost == {"its bytes do not fit its type": 1}
    assert result.summary["counts"]["read"] == 4


def test_beyond_the_limit_the_channel_fails_with_one_sentence(run):
    columns = {"x": np.ones(2, np.float32)}
    broken = [raw(cloud(START_NS, columns), CLOUD, START_NS)] * 2
    with pytest.raises(LossLimitError, match=r"LIDAR_TOP.*/sensor lost 2 of 5 messages.*no field y.*limits"):
        run(request(lidar(), CLOUD), [*broken, *clouds(3)])


def test_a_lost_scan_of_many_packets_weighs_as_a_message(run):
    good = [raw(velodyne_scan(vlp16_packets(1), START_NS, VLP16_PACKET_NS), SCAN, START_NS) for _ in range(3)]
    broken = raw(DecodeError("its bytes do not fit its type"), SCAN, START_NS)
    with pytest.raises(LossLimitError, match="lost 1 of 4 messages"):
        run(request(lidar(), SCAN, limit=0.2), [*good, broken])


def test_messages_without_stamps_ask_for_the_log_clock(run):
    messages = [raw(cloud(0, {axis: np.ones(2) for axis in "xyz"}), CLOUD, START_NS + n) for n in range(3)]
    with pytest.raises(LossLimitError, match="clock: log"):
        run(request(lidar(), CLOUD), messages)
    packets = [raw(EthernetPacket(header(0), message.data.payload), PACKET, 1) for message in singles(1)]
    with pytest.raises(LossLimitError, match="clock: log"):
        run(request(lidar(), PACKET), packets)


def test_simulated_time_may_start_at_zero(run):
    messages = [raw(cloud(n * PERIOD_NS, {axis: np.ones(2) for axis in "xyz"}), CLOUD, n) for n in range(3)]
    assert len(run(request(lidar(), CLOUD), messages).index) == 3


def test_radar_without_header_is_lost_not_a_crash(run):
    with pytest.raises(LossLimitError, match="header"):
        run(request(RadarChannel(topic="/sensor"), "x/msg/Y"), [raw(object(), "x/msg/Y", 1)] * 2)


# --- packets --------------------------------------------------------------------------------


def scans(turns, *, per_message=50, packet_ns=VLP16_PACKET_NS, **options):
    packets = vlp16_packets(turns, **options)
    for first in range(0, len(packets), per_message):
        start = START_NS + first * packet_ns
        part = packets[first : first + per_message]
        log_time = start + len(part) * packet_ns
        yield raw(velodyne_scan(part, start, packet_ns), SCAN, log_time)


def singles(turns, **options):
    for number, packet in enumerate(vlp16_packets(turns, **options)):
        stamp = START_NS + number * VLP16_PACKET_NS
        payload = np.frombuffer(packet.tobytes(), np.uint8)
        yield raw(EthernetPacket(header(stamp), payload), PACKET, stamp + 3_000_000)


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


# --- deskewing ------------------------------------------------------------------------------


def driving(speed, *, start_ns=START_NS - PERIOD_NS, seconds=1.5):
    stamps = start_ns + np.arange(round(seconds * 50)) * 20_000_000
    positions = np.zeros((len(stamps), 3))
    positions[:, 0] = (stamps - START_NS) * 1e-9 * speed
    rotations = np.tile([1.0, 0, 0, 0], (len(stamps), 1))
    return Trajectory(stamps, positions, rotations, max_gap_ns=500_000_000, extrapolate_ns=0)


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


def test_a_missing_trajectory_is_refused(run):
    asked = request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p")
    with pytest.raises(PoseError):
        run(asked, [])


# --- radar ----------------------------------------------------------------------------------


def radar_cloud(stamp_ns, number):
    columns = {name: np.arange(1.0, number + 1) for name in ("x", "y", "rcs")}
    return raw(cloud(stamp_ns, columns, "radar"), CLOUD, stamp_ns + 5)


def test_each_radar_message_becomes_a_file(run):
    messages = [radar_cloud(START_NS + n * 50_000_000, n + 1) for n in range(3)]
    result = run(request(RadarChannel(topic="/sensor"), CLOUD), messages)
    assert [row["points"] for row in result.index] == [1, 2, 3]
    assert [row["stamp_ns"] for row in result.index] == [START_NS + n * 50_000_000 for n in range(3)]
    assert "start_ns" not in result.index[0]
    assert result.index[0]["file"].endswith(".pcd")
    assert read_radar_file(result.files / result.index[2]["file"])["rcs"].tolist() == [1, 2, 3]
    assert result.channel["modality"] == "radar"


def test_a_radar_message_without_targets_becomes_a_file_without_targets(run):
    result = run(request(RadarChannel(topic="/sensor"), CLOUD), [radar_cloud(START_NS, 0)])
    assert result.index[0]["points"] == 0
    assert len(read_radar_file(result.files / result.index[0]["file"])) == 0


def test_of_radar_readings_published_while_they_fill_the_fullest_is_kept(run):
    messages = [radar_cloud(START_NS, n) for n in (1, 2, 4, 3)] + [radar_cloud(START_NS + 50_000_000, 2)]
    result = run(request(RadarChannel(topic="/sensor"), CLOUD), messages)
    assert [row["points"] for row in result.index] == [4, 2]
    assert result.lost == {"duplicate stamp": 3}


@dataclass
class EsrTrack:
    header: Header
    track_id: int
    track_range: float
    track_angle: float = 0.0
    track_range_rate: float = -1.0


def esr_tracks(cycles):
    """Messages of an ESR: 64 numbers every 50 ms, of which a few have a target."""
    for cycle in range(cycles):
        for number in range(1, 65):
            stamp = START_NS + cycle * 50_000_000 + number * 100_000
            distance = 10.0 + number if number % 10 == 0 else 0.0
            track = EsrTrack(header(stamp, "radar"), number, distance)
            yield raw(track, "delphi_esr_msgs/msg/EsrTrack", stamp)


def test_single_tracks_are_collected_into_cycles(run):
    messages = list(esr_tracks(3))
    result = run(request(RadarChannel(topic="/sensor"), "delphi_esr_msgs/msg/EsrTrack"), messages)
    assert [row["stamp_ns"] for row in result.index] == [
        START_NS + n * 50_000_000 + 100_000 for n in range(3)
    ]
    assert [row["points"] for row in result.index] == [6, 6, 6]
    targets = read_radar_file(result.files / result.index[1]["file"])
    assert targets["id"].tolist() == [10, 20, 30, 40, 50, 60]
    assert targets["x"].tolist() == [20, 30, 40, 50, 60, 70]
    assert result.summary["counts"] == {"read": 192, "written": 3, "merged": 189, "lost": {}}
    assert result.summary["points"]["dropped"] == {"no measurement": 174}


def test_a_pause_between_single_tracks_ends_a_cycle(run):
    late = EsrTrack(header(START_NS + 300_000_000, "radar"), 64, 5.0)
    early = EsrTrack(header(START_NS, "radar"), 1, 5.0)
    messages = [raw(track, "delphi_esr_msgs/msg/EsrTrack", START_NS) for track in (early, late)]
    result = run(request(RadarChannel(topic="/sensor"), "delphi_esr_msgs/msg/EsrTrack"), messages)
    assert [row["points"] for row in result.index] == [1, 1]


def test_the_log_clock_holds_for_radar(run):
    result = run(request(RadarChannel(topic="/sensor"), CLOUD, "log"), [radar_cloud(START_NS, 1)])
    assert result.index[0]["stamp_ns"] == START_NS + 5


# --- determinism ----------------------------------------------------------------------------


def test_the_same_messages_give_the_same_artifact(run):
    asked = request(lidar(deskew=True), SCAN, mount=MOUNT, poses="p")
    digests = {run(asked, scans(3), driving(10.0)).digest for _ in range(2)}
    assert len(digests) == 1
