"""Scans of written recordings, and the recipes proposed from them."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from small_drive import START_NS, STORE1, write_drive

from bagassets.decode.point_times import TIME_NAMES
from bagassets.propose.frames import is_optical
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.propose.sensors import find_sensors, modality_of
from bagassets.propose.summary import merge_recordings
from bagassets.recipe import parse_recipe
from bagassets.recordings.discover import find_one
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording
from bagassets_tests.ncom_data import ncom
from bagassets_tests.recorded_bags import NOON_NS, SECOND, text, write_ros2
from bagassets_tests.sweep_data import vlp16_packets

pytestmark = pytest.mark.once

TEXT = "std_msgs/msg/String"
SUFFIX = {"ros1": ".bag", "ros2": "", "mcap": ".mcap"}


def scan(path):
    with open_recording(path) as recording:
        return scan_recording(recording)


class Bag:
    """A ROS 1 bag with messages at given times after START_NS."""

    def __init__(self, path):
        self.path, self.messages = path, []
        self.types = STORE1.types

    def header(self, seconds, frame, stamped=True):
        stamp_ns = START_NS + int(seconds * 1e9) if stamped else 0
        stamp = self.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        return self.types["std_msgs/msg/Header"](0, stamp, frame)

    def transform(self, seconds, parent, child, x=0.0, topic="/tf", w=1.0):
        vector, quaternion = (
            self.types["geometry_msgs/msg/Vector3"],
            self.types["geometry_msgs/msg/Quaternion"],
        )
        value = self.types["geometry_msgs/msg/Transform"](vector(x, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, w))
        stamped = self.types["geometry_msgs/msg/TransformStamped"](self.header(seconds, parent), child, value)
        self.add(seconds, topic, "tf2_msgs/msg/TFMessage", self.types["tf2_msgs/msg/TFMessage"]([stamped]))

    def image(self, seconds, topic="/cam/image_raw", encoding="mono16", stamped=True):
        image = self.types["sensor_msgs/msg/Image"]
        data = np.zeros(8, np.uint8)
        header = self.header(seconds, "/cam", stamped)
        self.add(seconds, topic, "sensor_msgs/msg/Image", image(header, 2, 2, encoding, 0, 4, data))

    def imu(self, seconds, topic, covariance, frame="imu", acceleration=(0.0, 0.0, 0.0)):
        vector = self.types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        measured = self.types["geometry_msgs/msg/Vector3"](*acceleration)
        quaternion = self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        first = np.array([covariance, *[0.0] * 8])
        zero = np.zeros(9)
        value = self.types["sensor_msgs/msg/Imu"](
            self.header(seconds, frame), quaternion, first, vector, zero, measured, zero
        )
        self.add(seconds, topic, "sensor_msgs/msg/Imu", value)

    def text(self, seconds, topic):
        self.add(seconds, topic, TEXT, self.types[TEXT]("hello"))

    def add(self, seconds, topic, msgtype, message):
        self.messages.append((START_NS + int(seconds * 1e9) + 2_000_000, topic, msgtype, message))

    def scan(self):
        with Writer(self.path) as writer:
            connections = {}
            for time_ns, topic, msgtype, message in sorted(self.messages, key=lambda entry: entry[0]):
                key = topic, msgtype
                if key not in connections:
                    connections[key] = writer.add_connection(topic, msgtype, typestore=STORE1)
                data = b"x" if message is None else STORE1.serialize_ros1(message, msgtype)
                writer.write(connections[key], time_ns, data)
        return scan(self.path)


@pytest.mark.parametrize("duration_s", [0.4, 3.0])
def test_no_message_is_read_twice(tmp_path, monkeypatch, duration_s):
    path = write_drive(tmp_path / "drive.mcap", "mcap", duration_s=duration_s)
    read, messages = Counter(), Recording.messages

    def counted(recording, topics):
        for message in messages(recording, topics):
            read[message.topic, message.log_time_ns] += 1
            yield message

    monkeypatch.setattr(Recording, "messages", counted)
    assert set(scan(path).short_s) == ({"/cam/image_raw", "/points"} if duration_s < 1 else set())
    assert {topic for topic, _ in read} == {
        "/cam/image_raw",
        "/cam/camera_info",
        "/points",
        "/odom",
        "/tf_static",
    }
    assert max(read.values()) == 1


@pytest.mark.parametrize("file_format", ["ros1", "ros2", "mcap"])
def test_every_format_gives_the_same_recipe(file_format, tmp_path):
    path = write_drive(tmp_path / f"drive{SUFFIX[file_format]}", file_format)
    seen = scan(path)
    assert seen.topics["/odom"].child_frames == ("base_link",)
    assert seen.topics["/cam/camera_info"].calibrated is True
    assert seen.topics["/cam/image_raw"].encoding == "rgb8"
    assert seen.topics["/points"].offset_s == pytest.approx(0.003)
    assert seen.edges == {("base_link", "cam"), ("base_link", "lidar")}
    text = propose_recipe({"drive": seen}, name="drive", root=tmp_path).text
    (rig,) = parse_recipe(text, tmp_path / "recipe.yaml").rigs
    assert {name: channel.topic for name, channel in rig.channels.items()} == {
        "CAM_FRONT": "/cam/image_raw",
        "LIDAR_TOP": "/points",
    }
    assert (rig.ego_frame, rig.ego_pose.source) == ("base_link", "odometry")
    assert "to be decided" not in text.split("\n\n", 1)[1]


def test_one_rig_whatever_the_format(tmp_path):
    seen = {name: scan(write_drive(tmp_path / f"drive{s}", name, 0.5)) for name, s in SUFFIX.items()}
    assert (
        len(parse_recipe(propose_recipe(seen, name="x", root=tmp_path).text, tmp_path / "recipe.yaml").rigs)
        == 1
    )


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_metadata_that_announce_no_message_at_all_are_not_believed(storage, tmp_path):
    """A recorder writes them first and counts at its end, which it may not have lived to see."""
    bag = write_ros2(tmp_path / "bag", [text(NOON_NS + number * SECOND) for number in range(3)], storage)
    metadata = bag / "metadata.yaml"
    announced = metadata.read_text()
    metadata.write_text(announced.replace("message_count: 3", "message_count: 0"))
    with open_recording(find_one(bag)) as recording:
        found = scan_recording(recording).topics["/text"]
    assert (found.count, found.rate_hz) == (3, 1.0)


def test_moving_edges_and_sign_of_quaternions(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    for n in range(5):
        bag.transform(n * 0.1, "/map", "/base_link", x=0.1 * n)
        bag.transform(n * 0.1, "base_link", "lidar", w=(-1.0) ** n)
    seen = bag.scan()
    assert seen.edges == {("map", "base_link"), ("base_link", "lidar")}
    assert seen.moving == {("map", "base_link")}


def test_latched_transforms_that_come_late_are_seen(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    for n in range(40):
        bag.image(n)
    bag.transform(30, "base_link", "cam", topic="/tf_static")
    assert bag.scan().edges == {("base_link", "cam")}


@pytest.mark.parametrize("texts_s", [(-0.1,), (2.0,), tuple(0.4 * n + 0.1 for n in range(8)), (-6.0,)])
def test_messages_of_another_type_do_not_count_against_their_topic(tmp_path, texts_s):
    plain, mixed = (Bag(tmp_path / name) for name in ("plain.bag", "mixed.bag"))
    for bag in (plain, mixed):
        for n in range(10):
            bag.image(0.4 * n)
            bag.imu(0.4 * n, "/imu", 0.01)
        for n in range(9):
            bag.transform(0.4 * n, "map", "base_link", x=n)
        bag.transform(0.1, "base_link", "cam", topic="/tf_static")
        bag.transform(3.0, "base_link", "imu", topic="/tf_static")
    for topic in ("/cam/image_raw", "/imu", "/tf"):
        for seconds in texts_s:
            mixed.text(seconds, topic)
    mixed.text(min(texts_s), "/tf_static")
    clean, seen = plain.scan(), mixed.scan()
    for topic in ("/cam/image_raw", "/imu", "/tf", "/tf_static"):
        more = 1 if topic == "/tf_static" else len(texts_s)
        assert seen.topics[topic] == replace(clean.topics[topic], count=clean.topics[topic].count + more)
    assert (seen.transforms, seen.moving) == (clean.transforms, clean.moving)


def test_a_topic_with_no_message_of_its_type_is_left_out_with_the_reason(tmp_path):
    """Its metadata say another type than the file."""
    folder = write_drive(tmp_path / "drive", "ros2", 0.5)
    metadata = folder / "metadata.yaml"
    facts = metadata.read_text("utf-8")
    assert facts.count("sensor_msgs/msg/PointCloud2") == 1
    metadata.write_text(facts.replace("sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"), "utf-8")
    seen = scan(folder)
    assert seen.topics["/points"].problem == (
        "it is sensor_msgs/msg/PointCloud2, and most on its topic are sensor_msgs/msg/LaserScan"
    )
    assert [left.topic.name for left in find_sensors(seen)[1] if left.status == "not decodable"] == [
        "/points"
    ]


def test_one_damaged_message_does_not_make_its_topic_undecodable(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    for n in range(5):
        bag.image(n * 0.4)
    bag.messages[1] = (*bag.messages[1][:3], None)
    seen = bag.scan().topics["/cam/image_raw"]
    assert (seen.problem, seen.encoding) == (None, "mono16")


def test_only_the_first_seconds_are_decoded(tmp_path, monkeypatch):
    bag = Bag(tmp_path / "a.bag")
    for n in range(400):
        bag.transform(n * 0.1, "map", "base_link", x=n)
        bag.image(n * 0.1)
    seen = bag.scan()
    assert seen.topics["/tf"].count == 400
    decoded = []
    with open_recording(bag.path) as recording:
        decode = recording.decode
        monkeypatch.setattr(
            recording, "decode", lambda message: decoded.append(message.topic) or decode(message)
        )
        scan_recording(recording)
    assert decoded.count("/cam/image_raw") <= 3
    assert decoded.count("/tf") <= 20


def test_unset_stamps_frames_with_slash_and_orientation(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    bag.image(0, stamped=False)
    bag.image(1, "/good/image_raw")
    bag.imu(0, "/imu/raw", -1.0)
    bag.imu(0, "/imu/data", 0.01)
    topics = bag.scan().topics
    assert topics["/cam/image_raw"].unstamped
    assert topics["/cam/image_raw"].offset_s is None
    assert topics["/cam/image_raw"].frames == ("cam",)
    assert not topics["/good/image_raw"].unstamped
    assert topics["/good/image_raw"].offset_s == pytest.approx(0.002)
    assert (topics["/imu/raw"].oriented, topics["/imu/data"].oriented) == (False, True)


def test_merged_recordings_add_up(tmp_path):
    one, other = Bag(tmp_path / "a.bag"), Bag(tmp_path / "b.bag")
    one.image(0)
    one.transform(0, "map", "base_link")
    other.image(0)
    other.image(1, "/more/image_raw")
    merged = merge_recordings([one.scan(), other.scan()])
    assert merged.topics["/cam/image_raw"].count == 2
    assert merged.topics["/more/image_raw"].count == 1
    assert merged.edges == {("map", "base_link")}


def test_empty_recording(tmp_path):
    seen = Bag(tmp_path / "a.bag").scan()
    assert not seen.topics
    proposal = propose_recipe({"a.bag": seen}, name="x", root=tmp_path)
    assert [(one.path, one.reason) for one in proposal.bare] == [
        ("a.bag", "nothing to convert: it has no camera, lidar or radar")
    ]


@pytest.mark.parametrize(
    ("acceleration", "optical", "ego_frame"),
    [
        ((0.3, -9.8, 0.2), True, "base_link"),
        ((0.1, 0.4, 9.7), False, "cam"),
        ((9.8, 0.0, 0.0), None, "base_link"),
        ((0.3, 9.8, 0.2), None, "base_link"),
    ],
)
def test_gravity_shows_whether_a_frame_is_optical(tmp_path, acceleration, optical, ego_frame):
    """A camera in a frame with z up, which some drivers name, still looks along that frame's x axis."""
    bag = Bag(tmp_path / "a.bag")
    bag.transform(0, "cam", "imu")
    for number in range(5):
        bag.image(number, encoding="mono8")
        bag.imu(number, "/imu", -1.0, acceleration=acceleration)
    summary = bag.scan()
    assert is_optical(summary, "cam") is optical
    text = propose_recipe({"a.bag": summary}, name="x", root=tmp_path).text
    (rig,) = parse_recipe(text.replace("# source: fixed", "source: fixed"), tmp_path / "recipe.yaml").rigs
    assert rig.ego_frame == ego_frame
    assert rig.channels["CAM_FRONT"].extrinsics.rotation == (0.5, -0.5, 0.5, -0.5)


def test_robots_that_differ_in_their_ego_frame_alone_are_two_rigs(tmp_path):
    summaries = {}
    for name in ("red", "blue"):
        bag = Bag(tmp_path / f"{name}.bag")
        bag.transform(0, f"{name}_base", "cam")
        bag.image(0)
        bag.image(1)
        summaries[f"{name}.bag"] = bag.scan()
    text = propose_recipe(summaries, name="x", root=tmp_path).text
    rigs = parse_recipe(text.replace("# source: fixed", "source: fixed"), tmp_path / "recipe.yaml").rigs
    assert {rig.ego_frame for rig in rigs} == {"red_base", "blue_base"}


def test_an_imu_that_measures_no_acceleration_shows_nothing(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    bag.imu(0, "/imu", 0.01, acceleration=(0.0, 0.0, 9.8))
    topic = bag.messages[-1]
    topic[3].linear_acceleration_covariance[0] = -1.0
    assert bag.scan().topics["/imu"].acceleration is None


@pytest.mark.parametrize(
    ("seconds", "short_s"), [(0, 0.0), (0.5, 0.5), (0.999, 0.999), (1.0, None), (7, None)]
)
def test_recordings_too_short_for_a_scene_say_how_short(tmp_path, seconds, short_s):
    bag = Bag(tmp_path / "a.bag")
    bag.image(0)
    bag.image(seconds)
    bag.imu(30, "/imu", 0.01)  # no sensor whose readings a scene is made of
    found = bag.scan().short_s
    assert found == ({} if short_s is None else {next(iter(found)): pytest.approx(short_s)})


def test_sensors_that_are_long_enough_together_are_too_short_each(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    for seconds, topic in ((0, "/a"), (0.6, "/a"), (0.5, "/b"), (1.1, "/b"), (0.2, "/c"), (1.3, "/c")):
        bag.image(seconds, topic)
    assert bag.scan().short_s == {"/a": pytest.approx(0.6), "/b": pytest.approx(0.6)}


def cloud_of_two(bag, name, last):
    """Two points, whose field `name` is 0 and `last`."""
    field = bag.types["sensor_msgs/msg/PointField"]
    fields = [field(axis, 4 * place, 7, 1) for place, axis in enumerate(("x", "y", "z", name.upper()))]
    data = np.array([[1, 2, 3, 0], [4, 5, 6, last]], ">f4").view(np.uint8).reshape(-1)
    cloud = bag.types["sensor_msgs/msg/PointCloud2"]
    bag.add(
        0,
        "/points",
        "sensor_msgs/msg/PointCloud2",
        cloud(bag.header(0, "lidar"), 1, 2, fields, True, 16, 32, data, True),
    )
    return bag.scan().topics["/points"]


@pytest.mark.parametrize("name", [*TIME_NAMES, "intensity", "ring", "tone"])
def test_clouds_say_whether_their_points_have_times(tmp_path, name):
    assert cloud_of_two(Bag(tmp_path / "a.bag"), name, 0.05).timed == (name in TIME_NAMES)


def test_times_that_a_build_would_not_use_are_none(tmp_path):
    assert cloud_of_two(Bag(tmp_path / "a.bag"), "time", 0.0).timed is False


def test_the_times_of_points_are_looked_at_in_several_clouds(tmp_path):
    """Whether they are nanoseconds or microseconds shows in the time from one to the next; the points at zero do not count."""
    bag = Bag(tmp_path / "a.bag")
    field, cloud = (bag.types[f"sensor_msgs/msg/{name}"] for name in ("PointField", "PointCloud2"))
    fields = [
        field(name, 4 * place, kind, 1)
        for place, (name, kind) in enumerate(zip("xyzt", (7, 7, 7, 6), strict=True))
    ]
    points = np.zeros(60, [("xyz", "<f4", 3), ("t", "<u4")])
    points["xyz"][:40], points["t"][:40] = 1.0, np.linspace(0, 99_000, 40)
    data = points.view(np.uint8).reshape(-1)
    for number in range(30):
        message = cloud(bag.header(number / 10, "lidar"), 1, 60, fields, False, 16, 960, data, True)
        bag.add(number / 10, "/points", "sensor_msgs/msg/PointCloud2", message)
    clock = bag.scan().topics["/points"].clock
    assert (clock.field, clock.unit, clock.origin) == ("t", "ns", "header")
    assert clock.doubt == "they last 9.9e-05 s a cloud as nanoseconds, and 0.099 s as microseconds"


@pytest.mark.parametrize("increment_s", [0.0, 0.001])
def test_scans_say_whether_their_rays_have_times(tmp_path, increment_s):
    bag = Bag(tmp_path / "a.bag")
    ranges = np.ones(3, np.float32)
    message = bag.types["sensor_msgs/msg/LaserScan"](
        bag.header(0, "lidar"), 0.0, 1.0, 0.5, increment_s, 0.1, 0.1, 30.0, ranges, ranges
    )
    bag.add(0, "/scan", "sensor_msgs/msg/LaserScan", message)
    assert bag.scan().topics["/scan"].timed == (increment_s > 0)


def camera_info(bag, cx):
    k = np.array([100.0, 0, cx, 0, 100.0, 50.0, 0, 0, 1])
    region = bag.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return bag.types["sensor_msgs/msg/CameraInfo"](
        bag.header(0, "cam"), 100, 100, "plumb_bob", np.zeros(5), k, np.zeros(9), np.zeros(12), 0, 0, region
    )


@pytest.mark.parametrize(("cx", "calibrated"), [(50.0, True), (500.0, False)])
def test_a_calibration_that_a_build_would_refuse_is_none(tmp_path, cx, calibrated):
    bag = Bag(tmp_path / "a.bag")
    bag.add(0, "/cam/camera_info", "sensor_msgs/msg/CameraInfo", camera_info(bag, cx))
    assert bag.scan().topics["/cam/camera_info"].calibrated is calibrated


def test_images_that_no_decoder_reads_are_left_out_with_its_words(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    for number in range(3):
        bag.image(number, "/flow/image", encoding="32FC2")
    seen = bag.scan()
    assert seen.topics["/flow/image"].refusal == "image encoding '32FC2' is not supported"
    (bare,) = propose_recipe({"a.bag": seen}, name="x", root=tmp_path).bare
    assert bare.reason == "no camera, lidar or radar that can be used"
    assert [(use.topic.name, use.status, use.text) for use in bare.topic_uses] == [
        ("/flow/image", "not decodable", "image encoding '32FC2' is not supported")
    ]


def test_a_camera_that_takes_time_to_start_is_looked_at_longer(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    for number in range(12):
        bag.image(number / 10, encoding="mono16" if number > 8 else "unset")
    topic = bag.scan().topics["/cam/image_raw"]
    assert (topic.refusal, topic.encoding, topic.is_16_bit) == (None, "mono16", True)


def packet(bag, topic, data):
    layout = bag.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    message = bag.types["std_msgs/msg/UInt8MultiArray"](layout, np.frombuffer(data, np.uint8))
    bag.add(0, topic, "std_msgs/msg/UInt8MultiArray", message)


def test_packets_are_recognized_by_their_bytes_whatever_the_type_of_their_message(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    damaged = bytearray(ncom())
    damaged[30] ^= 1
    sent = {
        "/lidar": vlp16_packets(1)[0].tobytes(),
        "/oxts": ncom(),
        "/damaged": damaged,
        "/other": bytes(1206),
    }
    for topic, data in sent.items():
        packet(bag, topic, bytes(data))
    topics = bag.scan().topics
    assert {name for name, topic in topics.items() if topic.packets_of} == {"/lidar"}
    assert {name: topic.timed for name, topic in topics.items() if topic.timed is not None} == {
        "/lidar": True
    }
    assert {name for name, topic in topics.items() if topic.ncom_sender is not None} == {"/oxts"}
    assert [name for name, topic in topics.items() if modality_of(topic) == "lidar"] == ["/lidar"]


def test_transforms_that_a_build_would_refuse_connect_nothing(tmp_path):
    bag = Bag(tmp_path / "a.bag")
    bag.transform(0, "base_link", "lidar", w=0.0)
    bag.transform(0, "base_link", "cam")
    assert bag.scan().edges == {("base_link", "cam")}


def robots_bag(path, *robots):
    """Robots of one world each, 5 m apart, and a TF topic that is no robot's."""
    bag = Bag(path)
    for number, robot in enumerate(robots):
        for seconds in (0.1, 0.2, 0.3):
            bag.transform(seconds, "odom", "base_link", 5.0 * number + seconds, f"{robot}/tf")
            bag.image(seconds, f"{robot}/cam/image_raw")
        bag.transform(0.0, "base_link", f"only{robot}", 1.0 + number, f"{robot}/tf_static")
    bag.transform(0.05, "odom", "elsewhere", 9.0, "/fleet/tf_static")
    return bag


def test_transforms_of_another_robot_are_not_read(tmp_path):
    bag = robots_bag(tmp_path / "a.bag", "/two", "/one")  # "two" comes first in the recording
    bag.transform(0.0, "odom", "everyones", 7.0)  # /tf: /one has its own
    one = bag.scan()
    assert one.robots == {"/one": True, "/two": True}
    assert list(one.topics) == ["/one/cam/image_raw", "/one/tf", "/one/tf_static", "/fleet/tf_static"]
    assert one.edges == {("odom", "base_link"), ("base_link", "only/one"), ("odom", "elsewhere")}
    assert one.transforms["odom", "base_link"].translation[0] == 5.1
    assert one.moving == {("odom", "base_link")}


def test_a_robot_without_namespace_is_asked_about_too(tmp_path):
    text = propose_recipe(
        {"a.bag": robots_bag(tmp_path / "a.bag", "", "/two").scan()}, name="n", root="b"
    ).text
    assert "(the one without namespace, /two), and a recording has one" in " ".join(
        text.replace("#", "").split()
    )
    assert "topic: /cam/image_raw" in text
    assert "/two/" not in text


def test_of_robots_of_which_one_has_sensors_that_one_is_taken_and_the_others_are_named(tmp_path):
    bag = robots_bag(tmp_path / "a.bag", "/seeing")
    bag.transform(0.1, "odom", "base_link", 20.0, "/blind/tf")
    proposal = propose_recipe({"a.bag": bag.scan()}, name="n", root="b")
    assert [question.subject for question in proposal.questions if question.subject == "ego_pose"] == []
    assert "# left out: all below /blind (another robot)" in proposal.text
    assert proposal.rigs[0].name == "seeing"


def test_recordings_with_and_without_the_other_robot_are_of_one_rig_with_one_question(tmp_path):
    summaries = {
        "alone.bag": robots_bag(tmp_path / "alone.bag", "/one").scan(),
        "both.bag": robots_bag(tmp_path / "both.bag", "/one", "/two").scan(),
        "three.bag": robots_bag(tmp_path / "three.bag", "/one", "/three").scan(),
    }
    assert summaries["alone.bag"].robots == {}
    proposal = propose_recipe(summaries, name="n", root="b")
    (rig,) = proposal.rigs
    assert rig.recordings == ("alone.bag", "both.bag", "three.bag")
    assert list(rig.summary.robots) == ["/one", "/two", "/three"]
    (text,) = [question.text for question in proposal.questions if question.subject == "ego_pose"]
    assert "3 robots were recorded together (/one, /two, /three)" in text
