"""The step `sweeps`: what it declares, the files of clouds, and that nothing gets lost unseen."""

import numpy as np
import pytest

from bagassets.assets.asset import as_json
from bagassets.assets.sweeps import SWEEPS
from bagassets.assets.topic_log import TopicLog
from bagassets.base.errors import DecodeError, LossLimitError, RecipeError
from bagassets.recipe.model import RadarChannel, Recipe, Rig
from bagassets.recordings.model import RawMessage
from bagassets_tests.sweep_data import (
    VLP16_PACKET_NS,
    EthernetPacket,
    Scan,
    cloud,
    header,
    raw,
    velodyne_scan,
    vlp16_packets,
)
from bagassets_tests.sweep_run import (
    CLOUD,
    LASER,
    MOUNT,
    PACKET,
    PERIOD_NS,
    SCAN,
    START_NS,
    Runner,
    clouds,
    driving,
    inventory,
    lidar,
    request,
    scans,
    singles,
)


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


MOVED = MOUNT | {"translation": [0.0, 0.0, 0.0]}

# --- what the step declares -----


def test_without_deskewing_neither_poses_nor_extrinsics_enter_the_key():
    plain = request(lidar(), CLOUD)
    assert plain == request(lidar(), CLOUD, mount=MOVED, poses="q")
    assert plain.inputs == {}
    assert "ego_SE3_sensor" not in as_json(plain.params)


def test_with_deskewing_both_do():
    asked = request(lidar(deskew=True), CLOUD, poses="p" * 64)
    assert asked.inputs == {"ego_poses": "p" * 64}
    assert as_json(asked.params)["ego_SE3_sensor"] == MOUNT
    assert asked != request(lidar(deskew=True), CLOUD, mount=MOVED, poses="p" * 64)


def test_fields_that_do_not_shape_the_bytes_do_not_enter_the_key():
    transform = {"translation": (1.0, 2.0, 3.0), "rotation": (1.0, 0.0, 0.0, 0.0)}
    assert request(lidar(), CLOUD) == request(lidar(frame="x", extrinsics=transform), CLOUD)


@pytest.mark.parametrize(
    "changed",
    [
        {"stamp": "start"},
        {"header_stamp_is": "end"},
        {"stamp_offset_s": 0.1},
        {"min_range_m": 1.0},
        {"max_range_m": 100.0},
        {"intensity_scale": 255.0},
        {"zero_points": "keep"},
        {"point_times": "ignore"},
        {"point_times": {"unit": "us", "since": "header"}},
    ],
)
def test_fields_that_shape_the_bytes_enter_the_key(changed):
    assert as_json(request(lidar(**changed), CLOUD).params) != as_json(request(lidar(), CLOUD).params)


def test_packets_have_the_key_that_they_had_before_points_at_zero_were_dropped():
    fields = ["deskew", "header_stamp_is", "zero_points", "point_times", "intensity_scale"]
    assert as_json(request(lidar(), SCAN).params).keys() & set(fields) == {"deskew"}
    assert as_json(request(lidar(), CLOUD).params).keys() & set(fields) == {*fields[:3]}


@pytest.mark.parametrize("msgtype", [SCAN, LASER])
def test_times_of_points_are_those_of_a_pointcloud2(msgtype):
    with pytest.raises(RecipeError, match="point_times can be set for PointCloud2 only, but /sensor carries"):
        request(lidar(point_times="ignore"), msgtype)


@pytest.mark.parametrize("changed", [{"model": "VLP-16"}, {"cut_angle_deg": 180.0}, {"cut_angle_deg": 0.0}])
def test_fields_of_packets_enter_the_key_of_packets_and_are_refused_for_clouds(changed):
    assert request(lidar(**changed), SCAN) != request(lidar(), SCAN)
    with pytest.raises(RecipeError, match=f"{next(iter(changed))}.*/sensor"):
        request(lidar(**changed), CLOUD)


@pytest.mark.parametrize("deskew", [False, True])
def test_sweeps_wait_for_the_ego_poses_only_if_they_are_deskewed(deskew):
    channels = {
        "LIDAR_TOP": lidar(deskew=deskew),
        "LIDAR_LEFT": lidar(),
        "RADAR_FRONT": RadarChannel(topic="/sensor"),
    }
    rig = Rig(name="car", channels=channels, ego_pose={"source": "fixed"})
    recipe = Recipe(name="test", bags={"root": "bags"}, rigs=(rig,))
    needed = SWEEPS.needs(SWEEPS.params(recipe, rig), inventory(CLOUD))
    assert needed == {"inventory", "calibration"} | ({"ego_poses"} if deskew else set())


def test_the_period_is_asked_for_only_if_the_recipe_says_what_the_header_means():
    assert request(lidar(), CLOUD).params.period_ns is None
    assert request(lidar(header_stamp_is="start"), CLOUD).params.period_ns == PERIOD_NS
    assert request(lidar(), CLOUD, period_ns=90_000_000) == request(lidar(), CLOUD)


def period_of(stamps_ns, log_times_ns=None):
    """What the inventory says of the period of a topic."""
    log = TopicLog(CLOUD)
    for number, stamp_ns in enumerate(stamps_ns):
        log_time_ns = stamp_ns if log_times_ns is None else log_times_ns[number]
        log.add(RawMessage("/sensor", CLOUD, log_time_ns, b""), None if log_times_ns else (stamp_ns, "lidar"))
    return log.as_json("")["period_ns"]


def test_the_period_is_the_median_of_the_stamps():
    every = [START_NS + number * PERIOD_NS for number in range(12)]
    assert period_of(every) == PERIOD_NS
    # Clouds that are missing, come late, twice, or after a pause shift nothing.
    assert period_of([stamp for number, stamp in enumerate(every) if number not in {3, 7, 8}]) == PERIOD_NS
    assert period_of([*every[:4], every[5], every[4], *every[6:], every[6]]) == PERIOD_NS
    assert period_of([*every[:6], *(stamp + 3 * 10**9 for stamp in every[6:])]) == PERIOD_NS
    assert period_of([0, *every]) == PERIOD_NS
    assert period_of(every[:1]) is None
    assert period_of([], []) is None
    assert period_of([0] * 12, every) == PERIOD_NS


# --- clouds -----


def test_each_cloud_becomes_a_file_named_by_its_stamp(run):
    result = run(request(lidar(), CLOUD), clouds(3))
    assert [row["stamp_ns"] for row in result.index] == [START_NS + n * PERIOD_NS for n in range(3)]
    for number, row in enumerate(result.index):
        assert row["file"] == f"{row['stamp_ns']}.pcd.bin"
        assert row["log_time_ns"] == START_NS + number * PERIOD_NS + 7_000_000
        assert row["points"] == 4
        assert (row["start_ns"], row["end_ns"]) == (row["stamp_ns"], row["stamp_ns"])
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
    result = run(asked, clouds(2))
    assert result.index[0]["stamp_ns"] == START_NS + round(moved * PERIOD_NS)
    assert result.index[0]["end_ns"] - result.index[0]["start_ns"] == PERIOD_NS


@pytest.mark.parametrize("wanted", ["start", "middle", "end"])
def test_the_stamp_stays_as_recorded_unless_something_says_otherwise(run, wanted):
    result = run(request(lidar(stamp=wanted), CLOUD), clouds(3))
    assert [row["stamp_ns"] for row in result.index] == [START_NS + n * PERIOD_NS for n in range(3)]
    # Of times on another clock only the differences count, and the header stays the stamp.
    boot_s = 77.0 + np.array([0.0, 0.03, 0.06, 0.1])
    result = run(request(lidar(stamp=wanted), CLOUD), clouds(3, timestamp=boot_s))
    assert [row["stamp_ns"] for row in result.index] == [START_NS + n * PERIOD_NS for n in range(3)]
    row = result.index[0]
    assert (row["end_ns"] - row["start_ns"]) == PERIOD_NS


@pytest.mark.parametrize(("source", "msgtype"), [(clouds, CLOUD), (scans, SCAN)])
def test_an_offset_of_the_clock_moves_everything(run, source, msgtype):
    plain = run(request(lidar(), msgtype), source(3))
    moved = run(request(lidar(stamp_offset_s=-0.25), msgtype), source(3))
    for row, other in zip(plain.index, moved.index, strict=True):
        assert row["digest"] == other["digest"]
        for key in ("stamp_ns", "start_ns", "end_ns"):
            assert other[key] - row[key] == -250_000_000


def test_an_offset_of_the_clock_counts_before_deskewing(run):
    times = np.array([0, 30, 60, 100], np.uint32) * 1_000_000
    fields = {"mount": MOUNT, "poses": "p"}
    late = [
        raw(message.data.message, CLOUD, message.log_time_ns + 200_000_000) for message in clouds(2, t=times)
    ]
    for message in late:
        message.data.message.header = header(
            START_NS + 200_000_000 if message is late[0] else START_NS + 300_000_000
        )
    exact = run(request(lidar(deskew=True), CLOUD, **fields), clouds(2, t=times), driving(10.0))
    fixed = run(request(lidar(deskew=True, stamp_offset_s=-0.2), CLOUD, **fields), late, driving(10.0))
    assert [(row["stamp_ns"], row["digest"]) for row in fixed.index] == [
        (row["stamp_ns"], row["digest"]) for row in exact.index
    ]


def test_point_times_fit_the_revolution_better_than_the_period(run):
    offsets = np.array([0, 10, 20, 95], np.uint32) * 1_000_000
    result = run(request(lidar(), CLOUD), clouds(2, t=offsets))
    assert result.index[0]["stamp_ns"] == START_NS + 95_000_000
    assert result.index[0]["start_ns"] == START_NS


def test_a_single_cloud_keeps_its_stamp(run):
    result = run(request(lidar(header_stamp_is="start"), CLOUD, count=1), clouds(1))
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


def with_zeros(number, factors=None):
    """Clouds of five points, the second and fourth of which are at 0, 0, 0, and their twins without these.

    Their times are dates, multiplied by the factors.
    """
    columns = {axis: np.array([1, 0, 3, 0, 5], np.float32) for axis in "xyz"} | {"intensity": np.arange(5.0)}
    for kept in (slice(None), slice(None, None, 2)):
        messages = []
        for stamp in range(START_NS, START_NS + number * PERIOD_NS, PERIOD_NS):
            dates_s = (stamp + np.array([0, 20, 40, 70, 100]) * 1_000_000) / 1e9
            times = {} if factors is None else {"timestamp": dates_s * factors}
            chosen = {name: values[kept] for name, values in (columns | times).items()}
            messages.append(raw(cloud(stamp, chosen), CLOUD, stamp))
        yield messages


@pytest.mark.parametrize("factors", [None, np.ones(5), np.array([1, 0, 1, 0, 1]), np.array([1, 0, 1, 9, 1])])
def test_points_at_zero_are_no_measurements_and_change_nothing(run, factors):
    """Their times, zeros among dates or garbage, do not count, either."""
    odd, twin = (run(request(lidar(), CLOUD), messages) for messages in with_zeros(3, factors))
    assert odd.index == twin.index
    assert odd.summary["points"] == {"read": 15, "written": 9, "dropped": {"no measurement": 6}}


def test_points_at_zero_are_kept_if_the_recipe_says_so(run):
    odd, _ = with_zeros(1)
    result = run(request(lidar(zero_points="keep"), CLOUD), odd)
    assert result.points()[:, 0].tolist() == [1, 0, 3, 0, 5]
    assert result.summary["points"]["dropped"] == {}


def test_points_on_an_axis_are_measurements(run):
    columns = {
        "x": np.array([0, 0, 1e-30, -2.0]),
        "y": np.array([0, -1.0, 0, 0]),
        "z": np.array([1.0, 0, 0, 0]),
    }
    result = run(request(lidar(), CLOUD), [raw(cloud(START_NS, columns), CLOUD, START_NS)])
    assert len(result.points()) == 4


def test_rays_of_a_laser_scan_that_hit_nothing_are_at_zero(run):
    """A driver with range_min 0 sends 0 for no return."""
    scan = Scan(
        header(START_NS), np.array([5, 0, 5], np.float32), np.zeros(0), time_increment=0.001, range_min=0.0
    )
    result = run(request(lidar(), LASER), [raw(scan, LASER, START_NS)])
    assert result.summary["points"] == {"read": 3, "written": 2, "dropped": {"no measurement": 1}}
    assert result.index[0]["end_ns"] == START_NS + 2_000_000


def test_a_cloud_of_nothing_but_points_at_zero_is_lost_and_counted(run):
    columns = {axis: np.zeros(4, np.float32) for axis in "xyz"} | {"t": np.zeros(4, np.uint32)}
    messages = [raw(cloud(START_NS, columns), CLOUD, START_NS), *clouds(2)]
    assert run(request(lidar(), CLOUD), messages).lost == {"no point in it": 1}


@pytest.mark.parametrize(("msgtype", "source"), [(CLOUD, clouds), (SCAN, scans)])
def test_intensities_are_scaled(run, msgtype, source):
    more = {"intensity": np.array([0, 0.25, 0.5, 1.0], np.float32)} if msgtype == CLOUD else {}
    plain = run(request(lidar(), msgtype), source(3, **more))
    scaled = run(request(lidar(intensity_scale=255.0), msgtype), source(3, **more))
    assert np.array_equal(scaled.points()[:, 3], plain.points()[:, 3] * np.float32(255))
    assert np.array_equal(scaled.points()[:, [0, 1, 2, 4]], plain.points()[:, [0, 1, 2, 4]])


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
    assert [row["stamp_ns"] - START_NS for row in result.index] == [0, 1_000]


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


def laser(number, **fields):
    for index in range(number):
        stamp = START_NS + index * PERIOD_NS
        yield raw(Scan(header(stamp), np.full(11, 5.0, np.float32), np.zeros(0), **fields), LASER, stamp)


@pytest.mark.parametrize("wanted", ["start", "middle", "end"])
@pytest.mark.parametrize("fields", [{}, {"scan_time": 0.1}, {"time_increment": 0.05, "scan_time": 0.1}])
def test_laser_scans_whose_rays_have_no_times_keep_their_stamps(run, wanted, fields):
    result = run(request(lidar(stamp=wanted), LASER), laser(2, **fields))
    assert [row["stamp_ns"] for row in result.index] == [START_NS, START_NS + PERIOD_NS]


def test_no_messages_give_an_empty_index(run):
    result = run(request(lidar(), CLOUD), [])
    assert result.index == []
    assert result.channel["frame_id"] == ""


# --- losses -----


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
    packets = [
        raw(EthernetPacket(header(0), message.data.message.payload), PACKET, 1) for message in singles(1)
    ]
    with pytest.raises(LossLimitError, match="clock: log"):
        run(request(lidar(), PACKET), packets)


def test_simulated_time_may_start_at_zero(run):
    messages = [raw(cloud(n * PERIOD_NS, {axis: np.ones(2) for axis in "xyz"}), CLOUD, n) for n in range(3)]
    assert len(run(request(lidar(), CLOUD), messages).index) == 3


def test_radar_without_header_is_lost_not_a_crash(run):
    with pytest.raises(LossLimitError, match="header"):
        run(request(RadarChannel(topic="/sensor"), "x/msg/Y"), [raw(object(), "x/msg/Y", 1)] * 2)
