"""Proposed recipes: what is guessed, what is left open, and that the text loads."""

from dataclasses import replace

import numpy as np
import pytest

from bagassets.base.errors import RecipeError
from bagassets.base.escaping import yaml_scalar
from bagassets.decode.point_times import PointClock
from bagassets.geometry.se3 import SE3
from bagassets.propose.grouping import match_globs
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.summary import RecordingSummary, TopicSummary
from bagassets.recipe import parse_recipe
from bagassets.recipe.yaml_text import read_yaml
from bagassets.recordings.globs import matches
from bagassets.recordings.topic import UNKNOWN

pytestmark = pytest.mark.once

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CLOUD, INFO, ODOMETRY = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry"


def topic(name, msgtype, count=100, frame=None, **fields):
    return TopicSummary(
        name, msgtype, count, frames=() if frame is None else (frame,), offset_s=0.01, **fields
    )


def odometry(name="/odom", child="base_link", count=500):
    return topic(name, ODOMETRY, count, "odom", child_frames=(child,) if child else ())


def info(name, frame, calibrated=True):
    return topic(name, INFO, 100, frame, calibrated=calibrated)


def summary(*topics, edges=(), moving=(), **fields):
    return RecordingSummary(
        {t.name: t for t in topics}, dict.fromkeys(edges, SE3()), frozenset(moving), **fields
    )


def car(*more, edges=(), without=()):
    topics = [
        topic("/cam_front/image_raw", IMAGE, frame="cam_front", encoding="rgb8"),
        info("/cam_front/camera_info", "cam_front"),
        topic("/velodyne_points", CLOUD, frame="velodyne"),
        odometry(),
        *more,
    ]
    tree = {("odom", "base_link"), ("base_link", "cam_front"), ("base_link", "velodyne"), *edges}
    return summary(*(t for t in topics if t.name not in without), edges=tree, moving={("odom", "base_link")})


def text_of(summaries, **fields):
    if isinstance(summaries, RecordingSummary):
        summaries = {"a.bag": summaries}
    return propose_recipe(summaries, name="yard", root="/bags", **fields).text


def placed(text):
    """A proposed recipe with its templates of extrinsics uncommented."""
    return text.replace("# translation:", "translation:").replace("# rotation:", "rotation:")


def proposed(summaries, tmp_path, **fields):
    return parse_recipe(placed(text_of(summaries, **fields)), tmp_path / "recipe.yaml")


def channels_of(one, tmp_path):
    """Return channel -> topic of the only rig; poses are none of the question."""
    rig = proposed(replace(one, topics={**one.topics, "/odom": odometry()}), tmp_path).rigs[0]
    return {name: channel.topic for name, channel in rig.channels.items()}


def test_everything_guessable_loads_as_it_stands(tmp_path):
    recipe = proposed(car(), tmp_path)
    (rig,) = recipe.rigs
    assert str(recipe.bags.root) == "/bags"
    assert recipe.name == "yard"
    assert recipe.clock == "header"
    assert rig.match == ("**",)
    assert rig.ego_frame == "base_link"
    assert (rig.ego_pose.source, rig.ego_pose.topic) == ("odometry", "/odom")
    assert rig.channels["CAM_FRONT"].camera_info == "/cam_front/camera_info"
    assert rig.channels["CAM_FRONT"].undistort
    assert rig.channels["LIDAR_TOP"].topic == "/velodyne_points"
    text = text_of(car())
    assert "to be decided" not in text.split("\n\n", 1)[1]
    assert "# guess:" in text


def test_same_recordings_in_any_order_give_the_same_text():
    one, other = car(), car(topic("/radar", "radar_msgs/msg/RadarScan", frame="radar"))
    assert text_of({"a": one, "b": other, "c": one}) == text_of({"c": one, "b": other, "a": one})


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        (["/cam/left/image_raw", "/cam/right/image_raw"], ["CAM_LEFT", "CAM_RIGHT"]),
        (["/camera_front_left/image_raw", "/camera_rear/image_raw"], ["CAM_FRONT_LEFT", "CAM_BACK"]),
        (["/cam_fl/image", "/cam_rr/image"], ["CAM_FRONT_LEFT", "CAM_BACK_RIGHT"]),
        (["/sensing/camera/frontright/image_raw"], ["CAM_FRONT_RIGHT"]),
        (["/camera/image_raw"], ["CAM_FRONT"]),
        (["/zed/image_raw"], ["CAM_FRONT"]),
        (
            ["/t265/fisheye1/image_raw", "/t265/fisheye2/image_raw"],
            ["CAM_T265_FISHEYE1", "CAM_T265_FISHEYE2"],
        ),
        (["/a/front/image", "/b/front/image"], ["CAM_FRONT", "CAM_FRONT_2"]),
        (["image_raw", "other/image_raw"], ["CAM_A", "CAM_OTHER"]),
    ],
)
def test_cameras_are_named_by_where_they_look(topics, expected, tmp_path):
    one = summary(*(topic(name, IMAGE, frame=f"f{n}") for n, name in enumerate(topics)))
    assert sorted(channels_of(one, tmp_path)) == sorted(expected)


def test_frames_give_the_direction_if_topics_do_not(tmp_path):
    one = summary(
        topic("/cam0/image_raw", IMAGE, frame="camera_front_optical"),
        topic("/cam1/image_raw", IMAGE, frame="camera_back_optical"),
    )
    assert channels_of(one, tmp_path) == {"CAM_FRONT": "/cam0/image_raw", "CAM_BACK": "/cam1/image_raw"}


def test_lidars_the_one_on_top_first_and_flat_ones_last(tmp_path):
    one = summary(
        topic("/front/scan", "sensor_msgs/msg/LaserScan", 900, "laser"),
        topic("/lidar_left/points", CLOUD, frame="lidar_left"),
        topic("/lidar_roof/points", CLOUD, frame="lidar_roof"),
    )
    assert channels_of(one, tmp_path) == {
        "LIDAR_TOP": "/lidar_roof/points",
        "LIDAR_LEFT": "/lidar_left/points",
        "LIDAR_FRONT": "/front/scan",
    }


def test_radars(tmp_path):
    one = summary(
        topic("/radar_front/points", CLOUD, frame="radar_front"),
        topic("/radar_rear_left/scan", "radar_msgs/msg/RadarScan", frame="r2"),
        topic("/esr/track", "delphi_esr_msgs/msg/EsrTrack", 6400, "esr"),
        topic("/radar_markers", "visualization_msgs/msg/MarkerArray", frame="radar_front"),
    )
    assert channels_of(one, tmp_path) == {
        "RADAR_FRONT": "/radar_front/points",
        "RADAR_BACK_LEFT": "/radar_rear_left/scan",
        "RADAR_ESR": "/esr/track",
    }


@pytest.mark.parametrize(
    ("counts", "chosen"),
    [((100, 100), "/cam/image_raw"), ((99, 100), "/cam/image_raw"), ((10, 100), "/cam/image_raw/compressed")],
)
def test_of_one_camera_the_topic_with_more_messages_then_the_raw_one(counts, chosen, tmp_path):
    one = summary(
        topic("/cam/image_raw", IMAGE, counts[0], "cam"),
        topic("/cam/image_raw/compressed", COMPRESSED, counts[1], "cam"),
        topic("/cam/image_rect_color", IMAGE, counts[0], "cam"),
    )
    assert channels_of(one, tmp_path) == {"CAM_FRONT": chosen}
    assert text_of(one).count("# left out: /cam/image_r") == 2


def test_packets_before_points_of_the_same_lidar(tmp_path):
    one = summary(
        topic("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan", 100, "velodyne", packets_of="Velodyne"),
        topic("/velodyne_points", CLOUD, 100, "velodyne"),
    )
    assert channels_of(one, tmp_path) == {"LIDAR_TOP": "/velodyne_packets"}


def test_lidar_packets_are_recognized_by_their_bytes(tmp_path):
    packets = topic("/eth/lidar", "ethernet_msgs/msg/Packet", frame="v", packets_of="Velodyne")
    other = topic("/eth/ptp", "ethernet_msgs/msg/Packet", frame="e", packets_of="")
    assert channels_of(summary(packets, other), tmp_path) == {"LIDAR_TOP": "/eth/lidar"}


@pytest.mark.parametrize(
    ("extra", "reason"),
    [
        (topic("/rgbd/depth/image_raw", IMAGE, encoding="16UC1"), "depth, not a picture"),
        (topic("/rgbd/depth/points", CLOUD), "the cloud of a depth camera"),
        (topic("/disparity_image", IMAGE, encoding="32FC1"), "depth, not a picture"),
        (topic("/rgbd/z16/image_raw", IMAGE, encoding="32fc1"), "depth, not a picture"),
        (topic("/flow/image", IMAGE, refusal="image encoding '32FC2' is not supported"), "32FC2"),
        (topic("/cam/segmentation/image", IMAGE, encoding="rgb8"), "looks computed"),
        (topic("/obstacles/cloud", CLOUD), "looks computed"),
        # What VINS publishes of the corners that it follows.
        (topic("/feature_tracker/feature", "sensor_msgs/msg/PointCloud"), "looks computed"),
        (topic("/vins_estimator/point_cloud", "sensor_msgs/msg/PointCloud"), "looks computed"),
        (topic("/quiet/image_raw", IMAGE, 0), "no messages"),
        (topic("/odd/image_raw", IMAGE, problem="its bytes are odd"), "its bytes are odd"),
    ],
)
def test_what_is_no_sensor_is_left_out_with_a_reason(extra, reason, tmp_path):
    assert extra.name not in {c.topic for c in proposed(car(extra), tmp_path).rigs[0].channels.values()}
    line = next(entry for entry in text_of(car(extra)).splitlines() if f"left out: {extra.name} (" in entry)
    assert reason in line


def test_camera_without_calibration_is_not_undistorted(tmp_path):
    none = proposed(car(without={"/cam_front/camera_info"}), tmp_path).rigs[0].channels["CAM_FRONT"]
    assert (none.camera_info, none.undistort) == (None, False)
    zero = car(info("/cam_front/camera_info", "cam_front", calibrated=False))
    channel = proposed(zero, tmp_path).rigs[0].channels["CAM_FRONT"]
    assert (channel.camera_info, channel.undistort) == ("/cam_front/camera_info", False)
    assert "not calibrated" in text_of(zero)
    odd = replace(info("/cam_front/camera_info", "cam_front", calibrated=False), refusal="its lens is odd")
    assert "its CameraInfo cannot be used: its lens is odd; `intrinsics`" in " ".join(
        text_of(car(odd)).replace("#", "").split()
    )


def test_camera_info_elsewhere_is_found_by_its_frame(tmp_path):
    one = car(info("/calibration/front", "cam_front"), without={"/cam_front/camera_info"})
    assert proposed(one, tmp_path).rigs[0].channels["CAM_FRONT"].camera_info == "/calibration/front"
    two = car(
        info("/calibration/1", "cam_front"),
        info("/calibration/2", "cam_front"),
        without={"/cam_front/camera_info"},
    )
    assert proposed(two, tmp_path).rigs[0].channels["CAM_FRONT"].camera_info is None


def test_compressed_without_undistortion_passes_through(tmp_path):
    one = summary(topic("/cam/image_raw/compressed", COMPRESSED, frame="cam", encoding="jpeg"), odometry())
    assert proposed(one, tmp_path).rigs[0].channels["CAM_FRONT"].output == "as_recorded"
    calibrated = summary(*one.topics.values(), info("/cam/camera_info", "cam"))
    assert proposed(calibrated, tmp_path).rigs[0].channels["CAM_FRONT"].output == "jpeg"


def test_sixteen_bit_grey_gets_a_rule(tmp_path):
    one = summary(
        topic("/thermal/image_raw", IMAGE, frame="cam", encoding="mono16", is_16_bit=True), odometry()
    )
    assert proposed(one, tmp_path).rigs[0].channels["CAM_FRONT"].to_8bit.percentiles == (1, 99)


def test_clouds_without_point_times_ask_what_their_header_means(tmp_path):
    def lidars(timed):
        return summary(topic("/points", CLOUD, frame="lidar", timed=timed), odometry())

    text = text_of(lidars(False))
    assert "guess: stamps stay as recorded, as the points have no times." in text
    comment = " ".join(
        text.split("points have no times.")[1].split("header_stamp_is:")[0].replace("#", "").split()
    )
    assert comment.endswith(
        "If the header's stamp marks the start of a revolution, uncomment the next line; write middle or end instead of "
        "start if it marks that."
    )
    assert proposed(lidars(False), tmp_path).rigs[0].channels["LIDAR_TOP"].header_stamp_is is None
    said = parse_recipe(placed(text).replace("# header_stamp_is:", "header_stamp_is:"), tmp_path / "r.yaml")
    assert said.rigs[0].channels["LIDAR_TOP"].header_stamp_is == "start"
    for timed in (True, None):
        assert "header_stamp_is" not in text_of(lidars(timed))


def test_times_that_cannot_be_used_are_not_said_to_be_missing():
    clock = PointClock("t", problem="they do not differ")
    text = text_of(summary(topic("/points", CLOUD, frame="lidar", timed=False, clock=clock), odometry()))
    assert "times that cannot be used, as they do not differ. Some" in " ".join(text.replace("#", "").split())


@pytest.mark.parametrize(
    ("clock", "asks"),
    [
        (PointClock("t", "ns", "clock", ahead_ns=-1.7e18), True),
        (PointClock("t", "ns", "other"), True),
        (PointClock("t", "ns", "clock", ahead_ns=-3e8), False),
        (PointClock("t", "ns", "header"), False),
    ],
)
def test_times_of_another_clock_do_not_say_what_the_header_stamp_marks(clock, asks):
    text = text_of(summary(topic("/points", CLOUD, frame="lidar", timed=True, clock=clock), odometry()))
    assert ("# header_stamp_is: start" in text) == asks
    assert ("times of another clock, which do" in " ".join(text.replace("#", "").split())) == asks


@pytest.mark.parametrize("other", ["/robot2/odom", "/z/base/odom", "/a/odom"])
def test_of_two_odometries_alike_that_of_no_namespace_is_taken(tmp_path, other):
    one = summary(topic("/points", CLOUD, frame="lidar", timed=True), odometry(), odometry(other))
    assert proposed(one, tmp_path).rigs[0].ego_pose.topic == "/odom"


def test_times_of_points_that_are_not_sure_are_asked_for(tmp_path):
    def lidar(doubt):
        one = topic("/points", CLOUD, frame="lidar", timed=True, clock=PointClock("t", doubt=doubt))
        return summary(one, odometry(), edges=[("base_link", "lidar")])

    assert questions_of(lidar("")) == []
    asked = lidar("they last 0.0001 s a cloud as nanoseconds, and 0.1 s as microseconds")
    assert questions_of(asked) == [("rig", "LIDAR_TOP")]
    text = text_of(asked)
    said = " ".join(text.replace("#", "").split())
    assert "it is not sure what the times of its points are: they last 0.0001 s a cloud as nano" in said
    answer = text.replace("# point_times: {unit: ns,", "point_times: {unit: us,")
    channel = parse_recipe(answer, tmp_path / "r.yaml").rigs[0].channels["LIDAR_TOP"]
    assert (channel.point_times.unit, channel.point_times.since) == ("us", "header")


@pytest.mark.parametrize(
    ("most", "scale"), [(None, 1.0), (0.75, 255.0), (1.0, 255.0), (255.0, 1.0), (1.5, 1.0)]
)
def test_intensities_up_to_one_are_scaled_to_those_of_nuscenes(tmp_path, most, scale):
    one = summary(topic("/points", CLOUD, frame="lidar", most_intensity=most), odometry())
    assert proposed(one, tmp_path).rigs[0].channels["LIDAR_TOP"].intensity_scale == scale


def test_a_robot_description_that_only_init_can_use_is_named():
    """`convert` writes no file beside the recipe that it guesses, and asks where sensors are."""
    fixed = '<robot name="r"><joint name="j" type="fixed"><parent link="base_link"/><child link="{}"/></joint></robot>'

    def said(child):
        text = replace(topic("/robot_description", "std_msgs/msg/String", 1), urdf=fixed.format(child))
        one = summary(topic("/points", CLOUD, frame="lidar"), odometry(), text)
        (rig,) = propose_recipe({"a.bag": one}, name="yard", root="/bags").rigs
        return {use.topic.name: f"{use.status}: {use.text}" for use in rig.topic_uses}["/robot_description"]

    assert said("lidar").startswith("left out: a URDF that says where sensors are; `bagassets init` uses it")
    assert said("hand") == "not needed: "


def test_missing_transform_is_asked_for_where_the_recipe_is_refused(tmp_path):
    one = summary(topic("/cam/image_raw", IMAGE, frame="cam"), odometry())
    text = text_of(one)
    assert "to be decided: no transform from base_link to cam was seen" in text
    (question,) = propose_recipe({"a.bag": one}, name="yard", root="/bags").questions
    with pytest.raises(
        RecipeError, match=rf":{question.line}: rigs\[rig\]\.channels\.CAM_FRONT\.extrinsics: needs"
    ):
        parse_recipe(text, tmp_path / "r.yaml")
    given = placed(text)
    assert parse_recipe(given, tmp_path / "r.yaml").rigs[0].channels["CAM_FRONT"].extrinsics is not None


def test_camera_whose_headers_name_no_frame_has_that_of_its_calibration(tmp_path):
    camera = replace(car().topics["/cam_front/image_raw"], frames=())
    one = replace(car(), topics={**car().topics, camera.name: camera})
    front = proposed(one, tmp_path).rigs[0].channels["CAM_FRONT"]
    assert (front.frame, front.extrinsics) == ("cam_front", None)
    text = text_of(replace(one, topics={k: v for k, v in one.topics.items() if "camera_info" not in k}))
    assert "to be decided: its headers name no frame" in text
    assert "# frame: base_link" not in text  # it would look along z of the vehicle


def test_sensor_without_frame_and_cameras_that_share_one(tmp_path):
    one = summary(topic("/points", CLOUD), odometry())
    text = text_of(one).replace("# frame:", "frame:")
    assert parse_recipe(text, tmp_path / "r.yaml").rigs[0].channels["LIDAR_TOP"].frame == "base_link"
    two = summary(
        topic("/cam/left/image", IMAGE, frame="x"),
        topic("/cam/right/image", IMAGE, frame="x"),
        odometry(),
        edges=[("base_link", "x")],
    )
    assert "CAM_LEFT, CAM_RIGHT all name the frame x" in " ".join(text_of(two).replace("#", "").split())


NAVSAT, IMU = "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
POSE, PACKETS = "geometry_msgs/msg/PoseStamped", "ethernet_msgs/msg/Packet"


@pytest.mark.parametrize(
    ("topics", "tree", "expected"),
    [
        ([odometry(), topic("/pose", POSE), topic("/fix", NAVSAT)], [], {"source": "odometry", "topic": "/odom"}),
        (
            [odometry("/wheel/odom", count=5000), odometry("/odometry/filtered", count=100)], [],
            {"source": "odometry", "topic": "/odometry/filtered"},
        ),
        ([topic("/slam/pose", POSE), topic("/goal_pose", POSE, 9999)], [], {"source": "pose", "topic": "/slam/pose"}),
        ([topic("/pose", POSE), topic("/fix", NAVSAT)], [], {"source": "pose", "topic": "/pose"}),
        (
            [topic("/vicon/car/car", TRANSFORM, child_frames=("vicon/car/car",))], [],
            {"source": "pose", "topic": "/vicon/car/car", "frame": "base_link"},
        ),
        (
            [topic("/vicon/car/car", TRANSFORM, child_frames=("plate",))], [("base_link", "plate")],
            {"source": "pose", "topic": "/vicon/car/car", "frame": None},
        ),
        ([topic("/fix", NAVSAT)], [("map", "odom"), ("odom", "base_link")], {"source": "tf", "global_frame": "map"}),
        ([], [("odom", "base_link")], {"source": "tf", "global_frame": "odom"}),
        (
            [topic("/eth", PACKETS, ncom_sender="10.1.1.20"), topic("/fix", NAVSAT)], [("map", "base_link")],
            {"source": "ncom", "topic": "/eth", "sender": "10.1.1.20"},
        ),
        ([topic("/udp", PACKETS, ncom_sender="")], [], {"source": "ncom", "sender": None}),
        ([topic("/eth", PACKETS, ncom_sender="10.1.1.20"), odometry()], [], {"source": "odometry"}),
        ([topic("/fix", NAVSAT), topic("/imu", IMU, oriented=True)], [], {"source": "navsat", "imu": "/imu"}),
        ([topic("/fix", NAVSAT), topic("/imu", IMU, oriented=False)], [], {"source": "navsat", "imu": None}),
    ],
)  # fmt: skip
def test_pose_source(topics, tree, expected, tmp_path):
    one = summary(topic("/points", CLOUD, frame="lidar"), *topics, edges=[("base_link", "lidar"), *tree])
    pose = proposed(one, tmp_path).rigs[0].ego_pose
    assert {name: getattr(pose, name) for name in expected} == expected


@pytest.mark.parametrize(
    ("topics", "tree"),
    [
        ([], []),
        ([odometry(count=1)], []),
        ([topic("/goal_pose", POSE)], []),
        ([topic("/fix", NAVSAT, problem="odd")], []),
        # The floor of a laboratory: nothing moves in it.
        ([], [("world", "base_link")]),
    ],
)
def test_without_poses_the_user_decides_at_a_named_line(topics, tree, tmp_path):
    one = summary(topic("/points", CLOUD, frame="lidar"), *topics, edges=[("base_link", "lidar"), *tree])
    text = text_of(one)
    with pytest.raises(RecipeError) as caught:
        parse_recipe(text, tmp_path / "recipe.yaml")
    message = str(caught.value)
    line = int(message.removeprefix(f"{tmp_path / 'recipe.yaml'}:").split(":")[0])
    assert text.splitlines()[line - 1].strip() == "ego_pose:"
    assert "source: fixed" in message
    decided = parse_recipe(text.replace("# source: fixed", "source: fixed"), tmp_path / "recipe.yaml")
    assert decided.rigs[0].ego_pose.source == "fixed"


@pytest.mark.parametrize(
    ("one", "expected"),
    [
        (
            summary(odometry(child="base_footprint"), edges=[("base_footprint", "base_link")]),
            "base_footprint",
        ),
        (summary(odometry(child="odometer"), edges=[("base_link", "lidar")]), "base_link"),
        (summary(odometry(child="imu_link")), "imu_link"),
        (summary(edges=[("map", "base_footprint"), ("base_footprint", "lidar")]), "base_footprint"),
        (summary(edges=[("odom", "trunk"), ("trunk", "lidar"), ("trunk", "cam")]), "trunk"),
        (summary(), "lidar"),
    ],
)
def test_ego_frame(one, expected):
    lidar = topic("/points", CLOUD, frame="lidar")
    text = text_of(replace(one, topics={**one.topics, lidar.name: lidar}))
    assert f"ego_frame: {expected}  # guess:" in text


@pytest.mark.parametrize(
    ("offsets_s", "clock", "words"),
    [
        ({}, "header", ""),
        # The others keep their stamps: by the log, they were where the vehicle was a little later.
        (
            {"/velodyne_points": -37.0},
            "header",
            "clock: log guess: its header stamps are of another clock",
        ),
        ({"/velodyne_points": -37.0, "/cam_front/image_raw": 0.5}, "log", "are 37.5 s apart"),
        # A receiver that counts GPS time, 18 s ahead of UTC; poses that took a while to compute.
        ({"/odom": -18.0}, "log", "header stamps of /odom and /cam_front/image_raw are 18.0 s apart"),
        ({"/odom": 4.0}, "header", ""),
        ({"/odom": None}, "header", ""),
    ],
)
def test_clock(offsets_s, clock, words, tmp_path):
    one = car()
    moved = {name: replace(one.topics[name], offset_s=offset_s) for name, offset_s in offsets_s.items()}
    one = replace(one, topics={**one.topics, **moved})
    assert proposed(one, tmp_path).clock == clock
    assert words in " ".join(text_of(one).replace("#", "").split())


@pytest.mark.parametrize(
    ("offset_s", "clock", "of_channel"),
    [(0.1, "header", "log"), (0.5, "log", None), (-0.1, "log", None)],
)
def test_a_sensor_without_stamps_takes_them_from_others_only_if_their_clock_is_another(
    offset_s, clock, of_channel, tmp_path
):
    one = car()
    lidar = replace(one.topics["/velodyne_points"], offset_s=None, unstamped=True)
    camera = replace(one.topics["/cam_front/image_raw"], offset_s=offset_s)
    one = replace(one, topics={**one.topics, lidar.name: lidar, camera.name: camera})
    recipe = proposed(one, tmp_path)
    assert (recipe.clock, recipe.rigs[0].channels["LIDAR_TOP"].clock) == (clock, of_channel)
    assert recipe.rigs[0].channels["CAM_FRONT"].clock is None
    assert "header stamps are zero" in text_of(one) or "/velodyne_points are zero" in text_of(one)


def test_offset_that_all_sensors_share_keeps_header_stamps(tmp_path):
    one = car()
    one = replace(one, topics={name: replace(t, offset_s=3600.0) for name, t in one.topics.items()})
    assert proposed(one, tmp_path).clock == "header"
    assert "logged 3600.0 s after its stamp" in " ".join(text_of(one).split())


def test_boxes_truth_first_and_the_others_commented_out(tmp_path):
    boxes = "vision_msgs/msg/Detection3DArray"
    one = car(
        topic("/detections", boxes, 900),
        topic("/ground_truth/boxes", boxes, 100),
        topic("/lane_markers", "visualization_msgs/msg/MarkerArray", 100),
    )
    assert [entry.topic for entry in proposed(one, tmp_path).rigs[0].annotations] == ["/ground_truth/boxes"]
    assert "# - topic: /detections" in text_of(one)
    assert "/lane_markers" not in text_of(one)


def test_boxes_drawn_as_markers_are_boxes_if_there_are_no_others_and_the_name_says_so(tmp_path):
    markers = topic("/objects", "visualization_msgs/msg/MarkerArray", 900)
    texts = topic("/objects_text", "visualization_msgs/msg/MarkerArray", 900)
    assert [one.topic for one in proposed(car(markers, texts), tmp_path).rigs[0].annotations] == ["/objects"]
    both = car(markers, texts, topic("/tracks", "vision_msgs/msg/Detection3DArray", 100))
    assert [one.topic for one in proposed(both, tmp_path).rigs[0].annotations] == ["/tracks"]
    assert "# - topic: /objects\n" in text_of(both)
    assert "/objects_text" not in text_of(both)


@pytest.mark.parametrize("moves", [True, False])
def test_a_lidar_on_a_mount_that_nods_is_asked_for_as_such(moves, tmp_path):
    """Nothing in its TF is wrong: builds have one place for a sensor."""
    edge = ("base_link", "velodyne")
    one = replace(
        car(), moving=frozenset({("odom", "base_link"), edge}), static=frozenset() if moves else {edge}
    )
    (said,) = (question.text for question in propose_recipe({"a": one}, name="yard", root="/").questions)
    assert ("leave the channel out" in said) == moves
    assert "correct that and remove this field, or measure `extrinsics`" in said


@pytest.mark.parametrize(
    ("frame", "edges", "poses", "asks"),
    [
        ("odom", (), odometry(), False),
        ("velodyne", (), odometry(), False),
        ("map", [("map", "odom")], odometry(), False),
        ("map", (), odometry(), True),
        ("odom", (), topic("/fix", NAVSAT, frame="gps"), True),
        ("enu", (), topic("/fix", NAVSAT, frame="gps"), False),
        (None, (), topic("/fix", NAVSAT), False),
    ],
)
def test_boxes_in_a_frame_that_builds_will_not_know_are_asked_for(frame, edges, poses, asks):
    boxes = topic("/boxes", "vision_msgs/msg/Detection3DArray", frame=frame)
    lidar = topic("/velodyne_points", CLOUD, frame="velodyne", timed=True)
    one = summary(lidar, boxes, poses, edges=[("base_link", "velodyne"), *edges])
    assert questions_of(one) == ([("rig", "/boxes")] if asks else [])


def test_sweeps_that_can_be_deskewed_have_it_as_a_comment(tmp_path):
    def lidar(timed, *poses):
        one = topic("/points", CLOUD, frame="lidar", timed=timed)
        return summary(one, *poses, edges=[("base_link", "lidar")])

    text = text_of(lidar(True, odometry()))
    assert (
        parse_recipe(text.replace("# deskew", "deskew"), tmp_path / "r.yaml")
        .rigs[0]
        .channels["LIDAR_TOP"]
        .deskew
    )
    assert "deskew" not in text_of(lidar(False, odometry())) + text_of(lidar(True))


def test_recordings_of_two_rigs_and_of_none(tmp_path):
    van, drone = car(), summary(topic("/drone/image_raw", IMAGE, frame="d"), odometry("/vio", "drone"))
    degraded = car(without={"/cam_front/image_raw", "/cam_front/camera_info"})
    bare = summary(topic("/rosout", "rosgraph_msgs/msg/Log"))
    text = text_of(
        {"van/1.bag": van, "van/2/b.bag": degraded, "drone/1.bag": drone, "misc.bag": bare},
        unreadable={"torn.bag": "it is cut off; reindex it."},
        found=50,
    )
    recipe = parse_recipe(placed(text), tmp_path / "recipe.yaml")
    assert [(rig.name, rig.match) for rig in recipe.rigs] == [("van", ("van/**",)), ("drone", ("drone/**",))]
    assert set(recipe.rigs[0].channels) == {"CAM_FRONT", "LIDAR_TOP"}
    assert "left out: misc.bag: nothing to convert: it has no camera, lidar or radar" in text
    assert "left out: torn.bag: it is cut off; reindex it." in text
    assert "from the first seconds of 4 recordings out of 50" in text  # one could not be read


CAMERA_IN = "camera_optical_frame"


def questions_of(summaries, **fields):
    if isinstance(summaries, RecordingSummary):
        summaries = {"a.bag": summaries}
    proposal = propose_recipe(summaries, name="yard", root="/bags", **fields)
    lines = proposal.text.splitlines()
    for question in proposal.questions:
        assert any(
            line.lstrip().startswith("# to be decided: ")
            for line in lines[question.line - 1 : question.line + 1]
        ), question
    return [(question.rig, question.subject) for question in proposal.questions]


def test_what_blocks_the_build_is_a_question():
    assert questions_of(car()) == []
    still = summary(topic("/points", CLOUD, frame="lidar"), edges=[("base_link", "lidar")])
    assert questions_of(still) == [("rig", "ego_pose")]
    far = summary(topic("/cam/image_raw", IMAGE, frame="cam"), odometry())
    assert questions_of(far) == [("rig", "CAM_FRONT")]
    glued = replace(far, transforms={("base_link", "cam"): SE3()})
    assert questions_of(glued) == []
    nowhere = summary(topic("/points", CLOUD), odometry())
    assert questions_of(nowhere) == [("rig", "LIDAR_TOP")]
    two_frames = replace(car().topics["/velodyne_points"], frames=("velodyne", "laser"))
    assert questions_of(replace(car(), topics={**car().topics, two_frames.name: two_frames})) == [
        ("rig", "LIDAR_TOP")
    ]
    elsewhere = replace(car().topics["/odom"], child_frames=("odometer",))
    assert questions_of(replace(car(), topics={**car().topics, "/odom": elsewhere})) == [("rig", "ego_pose")]
    assert questions_of(summary(topic("/rosout", "rosgraph_msgs/msg/Log"))) == [("", "rigs")]


def test_what_is_left_out_beside_a_rig_blocks_nothing():
    bare = summary(topic("/rosout", "rosgraph_msgs/msg/Log"))
    packets = topic(
        "/pandar_packets", "pandar_msgs/msg/PandarScan", 50, problem="there is no definition of it"
    )
    assert questions_of({"a.bag": car(packets), "b.bag": bare}, unreadable={"c.bag": "it is cut off."}) == []


@pytest.mark.parametrize(
    "msgtype",
    [
        "pandar_msgs/msg/PandarScan",
        "hesai_ros_driver/msg/UdpFrame",
        "rslidar_msgs/msg/rslidarScan",
        "theora_image_transport/msg/Packet",
        "foxglove_msgs/msg/CompressedPointCloud",
    ],
)
def test_a_sensor_that_nothing_decodes_is_named_with_its_type(msgtype):
    one = summary(topic("/sensor", msgtype, 7, problem="there is no definition of it; name one"))
    proposal = propose_recipe({"a.bag": one}, name="yard", root="/bags")
    (bare,) = proposal.bare
    assert bare.reason == "no camera, lidar or radar that can be used"
    (use,) = bare.topic_uses
    shown = msgtype.replace("/msg/", "/")
    assert (use.status, use.topic.name) == ("not decodable", "/sensor")
    assert use.text.startswith(f"no decoder for {shown}; ")
    assert [question.subject for question in proposal.questions] == ["rigs"]
    assert f"/sensor: no decoder for {shown}" in proposal.questions[0].text


@pytest.mark.parametrize(
    ("name", "msgtype", "channel"),
    [
        ("/points", "sensor_msgs/msg/PointCloud", "LIDAR_TOP"),
        ("/horizontal_laser_2d", "sensor_msgs/msg/MultiEchoLaserScan", "LIDAR_TOP"),
        ("/radar/targets", "sensor_msgs/msg/PointCloud", "RADAR_FRONT"),
    ],
)
def test_older_types_are_those_of_a_sensor(name, msgtype, channel, tmp_path):
    one = car(topic(name, msgtype, 100, "base_link"), without=["/velodyne_points"])
    assert proposed(one, tmp_path).rigs[0].channels[channel].topic == name


def test_messages_without_a_schema_are_said_to_be():
    proposal = propose_recipe({"a.mcap": summary(topic("/x", UNKNOWN, 7))}, name="yard", root="/bags")
    (bare,) = proposal.bare
    assert bare.reason == "no camera, lidar or radar that can be used"
    assert [(use.status, use.text) for use in bare.topic_uses] == [
        ("not decodable", "no schema says what its messages are; record one")
    ]
    assert "no sensor can be decoded. /x: no schema says" in proposal.questions[0].text


@pytest.mark.parametrize(
    "msgtype",
    ["ouster_msgs/msg/Metadata", "sensor_msgs/msg/CameraInfo", "std_msgs/msg/String", "a/msg/ImageArray"],
)
def test_what_only_goes_with_sensors_is_no_sensor(msgtype):
    proposal = propose_recipe({"a.bag": summary(topic("/x", msgtype, 7))}, name="yard", root="/bags")
    (bare,) = proposal.bare
    assert bare.reason == "nothing to convert: it has no camera, lidar or radar"


def test_poses_alone_are_nothing_to_convert():
    proposal = propose_recipe({"a.bag": summary(odometry())}, name="yard", root="/bags")
    (bare,) = proposal.bare
    assert bare.reason == "nothing to convert: it has poses or transforms, but no camera, lidar or radar"
    assert [(use.topic.name, use.status, use.text) for use in bare.topic_uses] == [("/odom", "used", "poses")]


def test_what_becomes_of_each_topic():
    one = car(
        topic("/cam_front/image_rect", IMAGE, frame="cam_front"),
        topic("/pandar_packets", "pandar_msgs/msg/PandarScan", 50),
        topic("/tf", "tf2_msgs/msg/TFMessage"),
        topic("/truth/boxes", "vision_msgs/msg/Detection3DArray"),
        topic("/boxes", "vision_msgs/msg/Detection3DArray"),
        topic("/rosout", "rosgraph_msgs/msg/Log"),
    )
    (rig,) = propose_recipe({"a.bag": one}, name="yard", root="/bags").rigs
    uses = {use.topic.name: (use.status, use.text) for use in rig.topic_uses}
    assert next(iter(uses)) == "/cam_front/image_raw"
    assert list(uses)[-1] == "/rosout"
    assert set(uses) == set(one.topics)
    undecodable, reason = uses.pop("/pandar_packets")
    assert undecodable == "not decodable"
    assert reason.startswith("no decoder for pandar_msgs/PandarScan")
    assert uses == {
        "/cam_front/image_raw": ("used", "CAM_FRONT"),
        "/cam_front/camera_info": ("used", "calibration of CAM_FRONT"),
        "/velodyne_points": ("used", "LIDAR_TOP"),
        "/odom": ("used", "poses"),
        "/tf": ("used", "transforms"),
        "/truth/boxes": ("used", "boxes"),
        "/boxes": ("left out", "boxes, too; the recipe has it as a comment"),
        "/cam_front/image_rect": ("left out", "the same sensor as /cam_front/image_raw"),
        "/rosout": ("not needed", ""),
    }


@pytest.mark.parametrize(
    ("frame", "says"), [(CAMERA_IN, "is an optical frame"), ("cam", "is taken to be optical")]
)
def test_a_camera_alone_is_no_ego_frame(frame, says, tmp_path):
    one = summary(topic("/cam/image_raw", IMAGE, frame=frame))
    (question,) = propose_recipe({"a.bag": one}, name="yard", root="/bags").questions
    assert question.subject == "ego_pose"
    text = text_of(one)
    assert f"{frame}, the only sensor frame, {says} (z ahead)" in " ".join(text.replace("#", "").split())
    (rig,) = parse_recipe(text.replace("# source: fixed", "source: fixed"), tmp_path / "r.yaml").rigs
    assert rig.ego_frame == "base_link"
    assert rig.channels["CAM_FRONT"].extrinsics.rotation == (0.5, -0.5, 0.5, -0.5)


def test_a_lidar_alone_is_the_ego_frame_unless_its_frame_is_optical(tmp_path):
    for frame, ego_frame, rotation in (
        ("lidar", "lidar", None),
        (CAMERA_IN, "base_link", (0.5, -0.5, 0.5, -0.5)),
    ):
        text = text_of(summary(topic("/points", CLOUD, frame=frame), topic("/slam/pose", POSE)))
        (rig,) = parse_recipe(text, tmp_path / "r.yaml").rigs
        placed = rig.channels["LIDAR_TOP"].extrinsics
        assert (rig.ego_frame, placed and placed.rotation) == (ego_frame, rotation)


@pytest.mark.parametrize(
    ("names", "directions"),
    [
        (["front", "left", "back", "right"], [(1, 0), (0, 1), (-1, 0), (0, -1)]),
        (["left", "right"], [(1, 0), (1, 0)]),  # a stereo pair
        (["fl", "fr"], [(1, 1), (1, -1)]),
    ],
)
def test_templates_of_cameras_look_where_their_names_say(names, directions, tmp_path):
    one = summary(
        *(topic(f"/cam_{name}/image", IMAGE, frame=f"{name}_optical") for name in names), odometry()
    )
    text = placed(text_of(one))
    (rig,) = parse_recipe(text, tmp_path / "r.yaml").rigs
    by_topic = {channel.topic: channel.extrinsics for channel in rig.channels.values()}
    for name, (x, y) in zip(names, directions, strict=True):
        ego_SE3_sensor = SE3.create(by_topic[f"/cam_{name}/image"].rotation, (0, 0, 0))
        ahead, down = ego_SE3_sensor.rotation_matrix[:, 2], ego_SE3_sensor.rotation_matrix[:, 1]
        assert ahead == pytest.approx([x / np.hypot(x, y), y / np.hypot(x, y), 0], abs=1e-5)
        assert down == pytest.approx([0, 0, -1], abs=1e-5)


def robot(child, odom="/odom", frame="lidar"):
    return summary(topic("/points", CLOUD, frame=frame), odometry(odom, child), edges=[(child, frame)])


@pytest.mark.parametrize(
    ("one", "other", "rigs"),
    [
        (robot("base_link"), robot("base_link"), 1),
        (robot("base_link"), robot("base_link", odom="/vio/odometry"), 2),
        (robot("r1/base_link"), robot("r2/base_link"), 2),
        (robot("base_link", frame="r1/lidar"), robot("base_link", frame="r2/lidar"), 2),
        # What lacks something contradicts nothing.
        (robot("base_link"), summary(topic("/points", CLOUD, frame="lidar")), 1),
        (robot("base_link"), summary(topic("/points", CLOUD)), 1),
    ],
)
def test_rigs_differ_by_poses_and_frames(one, other, rigs, tmp_path):
    proposal = propose_recipe({"a.bag": one, "b.bag": other}, name="yard", root="/bags")
    assert len(proposal.rigs) == rigs
    for rig in proposal.rigs:
        assert rig.pose.fields["topic"] in rig.summary.topics
        assert rig.ego.name in {"base_link", "r1/base_link", "r2/base_link"}
    assert len({rig.name for rig in parse_recipe(placed(proposal.text), tmp_path / "r.yaml").rigs}) == rigs


def test_of_several_pose_sources_the_one_that_all_recordings_have(tmp_path):
    both = robot("base_link")
    both = replace(both, topics={**both.topics, "/ekf/odom": odometry("/ekf/odom", count=900)})
    assert proposed(both, tmp_path).rigs[0].ego_pose.topic == "/ekf/odom"
    (rig,) = proposed({"a.bag": both, "b.bag": robot("base_link")}, tmp_path).rigs
    assert rig.ego_pose.topic == "/odom"


def test_poses_as_rare_as_gnss_fixes_may_be_far_apart(tmp_path):
    """With the default, only readings at the very times of the fixes would have a pose."""

    def gap_s(rate_hz):
        fixes = topic("/fix", "sensor_msgs/msg/NavSatFix", rate_hz=rate_hz)
        one = summary(topic("/points", CLOUD, frame="lidar"), fixes, edges=[("base_link", "lidar")])
        return proposed(one, tmp_path).rigs[0].ego_pose.max_gap_s

    assert [gap_s(rate_hz) for rate_hz in (1.0, 0.998, 5.0, None)] == [1.5, 1.6, 0.5, 0.5]


def test_transforms_of_other_topics_are_named(tmp_path):
    tf = "tf2_msgs/msg/TFMessage"
    one = car(topic("/robot1/tf", tf), topic("/robot1/tf_static", tf))
    (rig,) = proposed(one, tmp_path).rigs
    assert (rig.tf, rig.tf_static) == (("/robot1/tf",), ("/robot1/tf_static",))
    (rig,) = proposed(car(topic("/tf", tf)), tmp_path).rigs
    assert (rig.tf, rig.tf_static) == (("/tf",), ("/tf_static",))


def test_each_rig_has_its_clock(tmp_path):
    unset = replace(robot("base_link").topics["/points"], unstamped=True, offset_s=None)
    second = replace(robot("base_link", "/vio"), topics={"/points": unset, "/vio": odometry("/vio")})
    recipe = proposed({"a.bag": car(), "b.bag": second}, tmp_path)
    assert recipe.clock == "header"
    assert {rig.name: recipe.clock_of(rig) for rig in recipe.rigs} == {"a": "header", "b": "log"}
    (alone,) = proposed(second, tmp_path).rigs
    assert alone.clock is None


LIDAR = "/velodyne_points"


@pytest.mark.parametrize(
    ("short_s", "least_s"),
    [
        ([{LIDAR: 0.07}, {LIDAR: 0.5}], 0.0),
        ([{LIDAR: 0.07}, {}], 1.0),  # one is long
        ([{}, {LIDAR: 0.07}], 1.0),
        ([{}], 1.0),
        ([{LIDAR: 0.0}], 0.0),
        ([{"/cam/image_raw": 0.5}], 1.0),  # not the sensor whose readings become keyframes
    ],
)
def test_short_recordings_get_scenes(short_s, least_s, tmp_path):
    recordings = {f"{n}.bag": replace(car(), short_s=one) for n, one in enumerate(short_s)}
    assert proposed(recordings, tmp_path).scenes.min_length_s == least_s


def test_rigs_that_only_names_of_recordings_tell_apart_say_so():
    recordings = {"1.bag": robot("base_link"), "2.bag": robot("r2/base_link"), "3.bag": robot("base_link")}
    text = " ".join(text_of(recordings).replace("#", "").split())
    assert text.count("guess: these recordings by their names; new ones of this rig need a glob") == 1
    assert "by their names" not in text_of({"a/1.bag": robot("base_link"), "b/1.bag": robot("r2/base_link")})


def test_same_topic_of_another_type_is_another_rig(tmp_path):
    other = summary(topic("/velodyne_points", "sensor_msgs/msg/LaserScan", frame="velodyne"), odometry())
    assert len(proposed({"a.bag": car(), "b.bag": other}, tmp_path).rigs) == 2


def test_a_sensor_of_which_no_topic_fits_all_recordings_makes_another_rig(tmp_path):
    """A channel has one topic, so in one rig some recordings would lose the camera, or the lidar."""
    raw, small = (
        topic(f"/cam_front/image_raw{end}", kind, frame="cam_front")
        for end, kind in (("", IMAGE), ("/compressed", COMPRESSED))
    )
    compressed = car(small, without={raw.name})
    renamed = car(topic("/lidar/points", CLOUD, frame="velodyne"), without={LIDAR})
    for other in (compressed, renamed):
        recipe = proposed({"a.bag": car(), "b.bag": other}, tmp_path)
        assert [len(rig.channels) for rig in recipe.rigs] == [2, 2]
        assert {channel.topic for channel in recipe.rigs[1].channels.values()} <= set(other.topics)
    assert len(proposed({"a.bag": car(small), "b.bag": car(), "c.bag": car()}, tmp_path).rigs) == 1
    assert len(proposed({"a.bag": car(small), "b.bag": car(), "c.bag": compressed}, tmp_path).rigs) == 2


def test_nothing_usable_still_shows_what_a_rig_looks_like(tmp_path):
    text = text_of(summary(topic("/rosout", "rosgraph_msgs/msg/Log")))
    with pytest.raises(RecipeError, match=r"recipe.yaml:\d+: rigs: needs a value"):
        parse_recipe(text, tmp_path / "recipe.yaml")
    lines = text.splitlines()
    start = next(n for n, line in enumerate(lines) if line.strip().startswith("# - name"))
    uncommented = [
        line.replace("# ", "", 1) if line.strip().startswith("#") else line for line in lines[start:]
    ]
    lines[start:] = uncommented
    assert parse_recipe("\n".join(lines), tmp_path / "recipe.yaml").rigs[0].name == "rig"


def test_undefined_message_type_asks_for_its_definition(tmp_path):
    packets = topic(
        "/packets", "velodyne_msgs/msg/VelodyneScan", problem="there is no definition of it; name one"
    )
    text = text_of(car(packets))
    assert "message_definitions: [msg]" in text
    (tmp_path / "msg").mkdir()
    given = text.replace("# message_definitions", "message_definitions")
    assert parse_recipe(given, tmp_path / "r.yaml").bags.message_definitions == (tmp_path / "msg",)


def test_radar_alone_gets_a_reference_channel(tmp_path):
    one = summary(topic("/radar/points", CLOUD, frame="radar"), odometry())
    assert proposed(one, tmp_path).scenes.reference == "RADAR_FRONT"


@pytest.mark.parametrize(
    "name", ["/a", "yes", "Null", "12", "1e3", "a: b", "a #b", "", " x", "ü\n\t", '"', "\\", "*a", "{x}"]
)
def test_any_text_survives_as_a_scalar(name, tmp_path):
    assert read_yaml(f"a: {yaml_scalar(name)}", tmp_path)[0] == {"a": name}


@pytest.mark.parametrize("name", ["my yard!", "...", "ünï", "-x-"])
def test_any_project_name_becomes_a_legal_one(name, tmp_path):
    parse_recipe(propose_recipe({"a.bag": car()}, name=name, root="/bags").text, tmp_path / "recipe.yaml")


@pytest.mark.parametrize(
    ("recordings", "others", "expected"),
    [
        (["a/1", "b/2"], [], ["**"]),
        (["a/1", "a/b/2"], ["c/1"], ["a/**"]),
        (["a/x/1", "b/2"], ["a/y/1"], ["a/x/**", "b/**"]),
        (["van_01.bag", "van_02.bag"], ["bus.bag"], ["van_*"]),
        (["van_01.bag", "van_02.bag"], ["van_03.bag"], ["van_01.bag", "van_02.bag"]),
        (["d/van_1.bag", "d/van_2.bag"], ["d/bus.bag"], ["d/van_*"]),
        (["odd[1]?*.bag"], ["x"], ["odd[[]1][?][*].bag"]),
    ],
)
def test_globs_tell_rigs_apart(recordings, others, expected):
    globs = match_globs(recordings, others)
    assert globs == expected
    assert all(any(matches(glob, name) for glob in globs) for name in recordings)
    assert not any(matches(glob, name) for glob in globs for name in others)
