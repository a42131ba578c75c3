"""The asset `calibration`: extrinsics from every source, intrinsics, contradictions and what is missing."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bagassets.assets.asset import as_json
from bagassets.assets.calibration import CALIBRATION, make_calibration
from bagassets.assets.sensors import camera_info_topic, is_rectified
from bagassets.base.errors import CalibrationError, DecodeError
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3
from bagassets.recipe.model import Rig
from bagassets.store.canonical import digest_bytes
from bagassets_tests.facts import MadeUpFacts, use_of
from bagassets_tests.pose_data import (
    CAMERA_INFO,
    CLOUD,
    IMAGE,
    T0,
    TFMESSAGE,
    Msg,
    Recorded,
    S,
    Written,
    about_z,
    camera_info,
    header,
    tf,
    transform,
)

CAM = SE3.create((0.5, -0.5, 0.5, -0.5), (1.5, 0.1, 1.4))
LIDAR = SE3.create(about_z(0.3), (0.9, 0.0, 1.8))
STATIC = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "cam", CAM)))
LENS = ("/cam/camera_info", CAMERA_INFO, T0, camera_info(d=(-0.2, 0.1, 0.0, 0.0, 0.0)))


def reading(topic, msgtype, frame, t=0.0):
    return topic, msgtype, T0 + round(t * S), Msg(header=header(T0 + round(t * S), frame))


IMAGES = reading("/cam/image_raw", IMAGE, "cam")
CLOUDS = reading("/points", CLOUD, "/lidar")


def rig(camera=None, lidar=None, **fields):
    channels = {}
    if camera is not None:
        channels["CAM_FRONT"] = {"modality": "camera", "topic": "/cam/image_raw"} | camera
    if lidar is not None:
        channels["LIDAR_TOP"] = {"modality": "lidar", "topic": "/points"} | lidar
    return Rig.model_validate({"name": "car", "channels": channels, "ego_pose": {"source": "fixed"}} | fields)


def calibration_use(the_rig, inventory):
    return use_of(CALIBRATION, the_rig, MadeUpFacts(inventory))


class Calibrated:
    """The asset, made of a recording."""

    def __init__(self, folder, the_rig, *entries, urdf=None):
        self.recording = Recorded(*entries)
        if urdf is not None:
            path = folder / "car.urdf"
            path.write_bytes(urdf)
            the_rig = the_rig.model_copy(update={"urdf": path})
        self.use = calibration_use(the_rig, self.recording.inventory())
        made = Written(folder / "out", lambda out: make_calibration(self.use.params, self.recording, out))
        self.summary, self.json = made.summary, made.artifact.read_json("calibration.json")
        self.digest = made.digest
        self.channels = self.json["channels"]

    def pose(self, channel):
        value = self.channels[channel]["ego_SE3_sensor"]
        return SE3.create(value["rotation"], value["translation"])

    def camera(self, channel):
        return Calibration.from_json(self.json).channels[channel].camera


def assert_same(found, truth):
    np.testing.assert_allclose(found.matrix, truth.matrix, atol=1e-10)


def fixed_joint(parent, child, xyz, rpy="0 0 0"):
    return (
        f'<robot name="car"><joint name="j" type="fixed"><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/></joint></robot>'
    ).encode()


class TestExtrinsics:
    """Where each sensor sits, `ego <- sensor`."""

    def test_from_tf_static(self, tmp_path):
        made = Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS)
        assert_same(made.pose("CAM_FRONT"), CAM)
        assert made.channels["CAM_FRONT"]["source"] == "tf_static"
        assert made.summary["notes"] == []

    def test_transforms_that_cannot_be_decoded_are_named_where_a_frame_is_missing(self, tmp_path):
        damaged = ("/tf_static", TFMESSAGE, T0, DecodeError("it is cut off"))
        nonsense = ("/tf", TFMESSAGE, T0, tf(transform(0, "", "cam", CAM)))
        with pytest.raises(CalibrationError) as caught:
            Calibrated(tmp_path, rig({}), damaged, nonsense, IMAGES, LENS)
        text = str(caught.value)
        assert "no frames are known at all" in text
        assert "could not be decoded in /tf (it lacks a frame id), /tf_static (it is cut off)," in text
        advice = "or give the channel `extrinsics: {translation: [x, y, z], rotation: [w, x, y, z]}`; leave the channel out if its mount moves."
        assert text.endswith(advice)

    def test_whole_transforms_are_not_blamed_for_a_missing_frame(self, tmp_path):
        with pytest.raises(CalibrationError) as caught:
            Calibrated(tmp_path, rig({}, ego_frame="base"), STATIC, IMAGES, LENS)
        assert "decoded" not in str(caught.value)

    def test_from_fixed_joints_in_tf(self, tmp_path):
        """As robot_state_publisher of ROS 1 sends them, among edges that move."""
        entries = [
            (
                "/tf", TFMESSAGE, T0 + i * S // 10,
                tf(
                    transform(T0 + i, "/base_link", "/lidar", LIDAR),
                    transform(T0 + i, "odom", "base_link", SE3.create((1, 0, 0, 0), (i, 0, 0))),
                ),
            )
            for i in range(5)
        ]  # fmt: skip
        made = Calibrated(tmp_path, rig(lidar={}), CLOUDS, *entries)
        assert_same(made.pose("LIDAR_TOP"), LIDAR)
        assert made.channels["LIDAR_TOP"]["source"] == "tf"

    def test_from_a_urdf(self, tmp_path):
        urdf = fixed_joint("base_link", "lidar", "0.9 0 1.8", "0 0 0.3")
        made = Calibrated(tmp_path, rig(lidar={}), CLOUDS, urdf=urdf)
        assert_same(made.pose("LIDAR_TOP"), LIDAR)
        assert made.channels["LIDAR_TOP"]["source"] == "urdf"
        assert set(made.use.inputs) == {"urdf"}

    def test_from_the_recipe_which_wins_and_spares_reading_transforms(self, tmp_path):
        given_by_hand = {"translation": [1.0, 2.0, 3.0], "rotation": [0.5, 0.5, 0.5, 0.5]}
        made = Calibrated(tmp_path, rig({"extrinsics": given_by_hand}), STATIC, IMAGES, LENS)
        assert_same(made.pose("CAM_FRONT"), SE3.create((0.5, 0.5, 0.5, 0.5), (1, 2, 3)))
        assert made.channels["CAM_FRONT"]["source"] == "recipe"
        assert made.use.topics == ("/cam/camera_info",)

    def test_a_chain_through_all_sources(self, tmp_path):
        urdf = fixed_joint("mast", "plate", "0 0 1")
        moved = tf(transform(T0, "plate", "lidar", SE3.create((1, 0, 0, 0), (0, 0.5, 0))))
        made = Calibrated(
            tmp_path, rig(lidar={}), CLOUDS, ("/tf", TFMESSAGE, T0, moved),
            ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "mast", SE3((1.0, 0, 0, 0), (2, 0, 0))))), urdf=urdf,
        )  # fmt: skip
        assert made.pose("LIDAR_TOP").translation == (2.0, 0.5, 1.0)
        assert made.channels["LIDAR_TOP"]["source"] == "tf+tf_static+urdf"

    def test_tf_is_not_read_where_static_transforms_suffice(self, tmp_path):
        entry = ("/tf", TFMESSAGE, T0, tf(transform(T0, "odom", "base_link", SE3())))
        made = Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS, entry)
        assert "/tf" in made.use.topics
        assert "/tf" not in made.recording.read

    def test_a_sensor_in_the_ego_frame(self, tmp_path):
        made = Calibrated(tmp_path, rig(lidar={}, ego_frame="lidar"), CLOUDS)
        assert made.pose("LIDAR_TOP") == SE3()

    def test_the_recipe_may_name_the_frame(self, tmp_path):
        made = Calibrated(tmp_path, rig(lidar={"frame": "/cam"}), CLOUDS, STATIC)
        assert_same(made.pose("LIDAR_TOP"), CAM)

    @settings(deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(v * v for v in q) > 0.1),
        st.tuples(*[st.floats(-5, 5)] * 3),
    )
    def test_any_mount_survives(self, tmp_path_factory, rotation, translation):
        mount = SE3.create(rotation, translation)
        static = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "lidar", "base_link", mount.inverse())))
        made = Calibrated(tmp_path_factory.mktemp("c"), rig(lidar={}), CLOUDS, static)
        np.testing.assert_allclose(made.pose("LIDAR_TOP").matrix, mount.matrix, atol=1e-9)


class TestContradictions:
    """The most trusted source is used, and a note says so."""

    def test_sources_that_differ_are_noted(self, tmp_path):
        urdf = fixed_joint("base_link", "cam", "1.5 0.4 1.4", "-1.5707963267948966 0 -1.5707963267948966")
        made = Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS, urdf=urdf)
        assert_same(made.pose("CAM_FRONT"), CAM)
        (note,) = made.summary["notes"]
        assert note == (
            "CAM_FRONT: urdf puts cam 0.300 m and 0.0 degrees away from where tf_static, which is used, "
            "has it in base_link."
        )
        assert made.json["notes"] == [note]

    @pytest.mark.parametrize(
        ("xyz", "rpy", "metres", "degrees"),
        [
            ("1.8 0.1 1.4", "-1.5707963267948966 0 -1.5707963267948966", "0.300", "0.0"),
            ("1.5 0.1 1.1", "-1.5707963267948966 0 -1.5707963267948966", "0.300", "0.0"),
            ("1.8 0.5 1.4", "-1.5707963267948966 0 -1.5707963267948966", "0.500", "0.0"),
            ("1.5 0.1 1.4", "-1.5707963267948966 0 -1.2217304763960306", "0.000", "20.0"),
            ("1.5 0.1 1.4", "-1.2217304763960306 0 -1.5707963267948966", "0.000", "20.0"),
            ("1.5 0.1 1.4", "1.5707963267948966 0 1.5707963267948966", "0.000", "180.0"),
        ],
    )
    def test_how_far_sources_are_apart(self, tmp_path, xyz, rpy, metres, degrees):
        urdf = fixed_joint("base_link", "cam", xyz, rpy)
        (note,) = Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS, urdf=urdf).summary["notes"]
        assert f"urdf puts cam {metres} m and {degrees} degrees away" in note

    def test_sources_that_agree_are_not(self, tmp_path):
        urdf = fixed_joint("base_link", "cam", "1.5 0.1 1.4", "-1.5707963267948966 0 -1.5707963267948966")
        assert Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS, urdf=urdf).summary["notes"] == []

    def test_a_static_transform_published_with_two_values(self, tmp_path):
        other = SE3.create(CAM.rotation, (1.6, 0.1, 1.4))
        entry = ("/tf_static", TFMESSAGE, T0 + S, tf(transform(1, "base_link", "cam", other)))
        words = r"base_link -> cam \(tf_static\) moves during the recording\. .*leave the channel out if its mount moves"
        with pytest.raises(CalibrationError, match=words):
            Calibrated(tmp_path, rig({}), STATIC, entry, IMAGES, LENS)

    def test_a_static_transform_with_two_values_at_one_time(self, tmp_path):
        other = SE3.create(CAM.rotation, (1.6, 0.1, 1.4))
        entry = ("/tf_static", TFMESSAGE, T0 + S, tf(transform(0, "base_link", "cam", other)))
        with pytest.raises(
            CalibrationError,
            match=r"CAM_FRONT .*base_link -> cam \(tf_static\) has several values at one time",
        ):
            Calibrated(tmp_path, rig({}), STATIC, entry, IMAGES, LENS)

    def test_a_topic_to_choose_where_a_static_transform_has_two_values_on_two_topics(self, tmp_path):
        other = ("/more", TFMESSAGE, T0, tf(transform(0, "base_link", "cam", CAM.inverse())))
        both = rig({}, tf_static=["/tf_static", "/more"])
        with pytest.raises(CalibrationError, match="so name only one of /more and /tf_static in the recipe"):
            Calibrated(tmp_path / "a", both, STATIC, other, IMAGES, LENS)
        made = Calibrated(tmp_path / "b", rig({}), STATIC, other, IMAGES, LENS)
        assert_same(made.pose("CAM_FRONT"), CAM)

    def test_a_loop_never_inverts_extrinsics(self, tmp_path):
        back = ("/tf_static", TFMESSAGE, T0 + S, tf(transform(1, "lidar", "base_link", LIDAR)))
        down = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "lidar", LIDAR)))
        with pytest.raises(
            CalibrationError, match=r"LIDAR_TOP .*: the transforms go round in a circle, .*Correct ego_frame"
        ):
            Calibrated(tmp_path / "a", rig(lidar={}), CLOUDS, down, back)
        made = Calibrated(tmp_path / "b", rig({}), STATIC, IMAGES, LENS, down, back)
        assert_same(made.pose("CAM_FRONT"), CAM)

    def test_two_parents(self, tmp_path):
        entry = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "mast", "cam", CAM)))
        with pytest.raises(CalibrationError, match=r"cam has more than one parent, base_link .* and mast"):
            Calibrated(tmp_path, rig({}), STATIC, entry, IMAGES, LENS)

    def test_a_topic_with_messages_of_two_frames(self, tmp_path):
        with pytest.raises(
            CalibrationError,
            match=r"LIDAR_TOP: the messages of /points are in several frames \(lidar, rear\)",
        ):
            Calibrated(tmp_path, rig(lidar={}), CLOUDS, reading("/points", CLOUD, "rear", 1.0))


class TestMissing:
    """One sentence that says which sensor, what was looked for, and what to do."""

    def test_no_transform(self, tmp_path):
        with pytest.raises(
            CalibrationError,
            match=r"LIDAR_TOP \(/points\): no transform from lidar to base_link: lidar is not a frame known here "
            r"\(known frames: base_link, cam\). Correct ego_frame or the channel's frame in the recipe",
        ):
            Calibrated(tmp_path, rig({}, {}), STATIC, IMAGES, LENS, CLOUDS)

    def test_a_sensor_that_moves(self, tmp_path):
        entries = [
            ("/tf", TFMESSAGE, T0 + i, tf(transform(T0 + i, "base_link", "lidar", SE3((1.0, 0, 0, 0), (i, 0, 0)))))
            for i in range(3)
        ]  # fmt: skip
        with pytest.raises(CalibrationError, match=r"base_link -> lidar \(tf\) moves"):
            Calibrated(tmp_path, rig(lidar={}), CLOUDS, *entries)

    def test_messages_without_a_frame(self, tmp_path):
        with pytest.raises(CalibrationError, match="the messages of /points name no frame; give `frame` or"):
            Calibrated(tmp_path / "a", rig(lidar={}), reading("/points", CLOUD, ""))
        with pytest.raises(CalibrationError, match="the messages of /points name no frame; give `frame` or"):
            Calibrated(tmp_path / "b", rig(lidar={}), ("/points", CLOUD, T0, Msg()))

    def test_channels_that_are_not_recorded_need_no_calibration(self, tmp_path):
        made = Calibrated(tmp_path, rig({}, {}), STATIC, IMAGES, LENS)
        assert set(made.channels) == {"CAM_FRONT"}

    def test_transforms_that_are_nonsense_are_counted(self, tmp_path):
        broken = transform(0, "base_link", "lidar", SE3())
        broken.transform.rotation.w = 0.0
        entry = ("/tf_static", TFMESSAGE, T0 - 1, tf(broken, transform(0, "base_link", "lidar", LIDAR)))
        garbage = ("/tf_static", TFMESSAGE, T0, DecodeError("its bytes do not fit"))
        made = Calibrated(tmp_path, rig(lidar={}), CLOUDS, entry, garbage)
        assert_same(made.pose("LIDAR_TOP"), LIDAR)
        assert made.summary["transforms"] == {
            "read": 3, "written": 1, "merged": 0,
            "lost": {"its quaternion is not of unit length": 1, "its bytes do not fit": 1},
        }  # fmt: skip


class TestIntrinsics:
    """What a camera sees; from CameraInfo or by hand."""

    def test_from_camera_info(self, tmp_path):
        camera = Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS).channels["CAM_FRONT"]["camera"]
        assert (camera["model"], camera["d"], camera["source"]) == (
            "plumb_bob",
            [-0.2, 0.1, 0.0, 0.0, 0.0],
            "camera_info",
        )
        assert camera["k"] == [400.0, 0, 320.0, 0, 410.0, 240.0, 0, 0, 1]

    def test_by_hand(self, tmp_path):
        by_hand = {"width": 640, "height": 480, "fx": 1.0, "fy": 2.0, "cx": 3.0, "cy": 4.0}
        made = Calibrated(tmp_path, rig({"intrinsics": by_hand}), STATIC, IMAGES, LENS)
        camera = made.channels["CAM_FRONT"]["camera"]
        assert (camera["model"], camera["k"], camera["source"]) == (
            "none",
            [1, 0, 3, 0, 2, 4, 0, 0, 1],
            "recipe",
        )
        assert (camera["width"], camera["height"], camera["binning"], camera["d"]) == (640, 480, [1, 1], [])
        assert (camera["r"], camera["p"]) == (
            [1, 0, 0, 0, 1, 0, 0, 0, 1],
            [1, 0, 3, 0, 0, 2, 4, 0, 0, 0, 1, 0],
        )
        assert {key: camera["roi"][key] for key in ("x_offset", "y_offset", "width", "height")} == {
            "x_offset": 0, "y_offset": 0, "width": 640, "height": 480,
        }  # fmt: skip
        assert "/cam/camera_info" not in made.use.topics

    def test_an_ideal_equidistant_lens_by_hand(self, tmp_path):
        by_hand = {
            "model": "equidistant",
            "width": 9,
            "height": 9,
            "fx": 1.0,
            "fy": 2.0,
            "cx": 3.0,
            "cy": 4.0,
        }
        camera = Calibrated(tmp_path, rig({"intrinsics": by_hand}), STATIC, IMAGES).channels["CAM_FRONT"][
            "camera"
        ]
        assert (camera["model"], camera["d"]) == ("equidistant", [0.0] * 4)

    def test_nonsense_by_hand(self, tmp_path):
        by_hand = {"width": 640, "height": 480, "fx": 1.0, "fy": 2.0, "cx": 900.0, "cy": 4.0}
        with pytest.raises(
            CalibrationError, match=r"CAM_FRONT: intrinsics in the recipe: its principal point"
        ):
            Calibrated(tmp_path, rig({"intrinsics": by_hand}), STATIC, IMAGES)

    def test_a_camera_without_camera_info(self, tmp_path):
        with pytest.raises(
            CalibrationError,
            match=r"CAM_FRONT \(/cam/image_raw\): no CameraInfo on /cam/camera_info, which undistortion needs; name "
            "the topic in `camera_info`, give `intrinsics`, or set `undistort: false`",
        ):
            Calibrated(tmp_path, rig({}), STATIC, IMAGES)

    def test_a_camera_without_camera_info_that_is_not_undistorted(self, tmp_path):
        made = Calibrated(tmp_path, rig({"undistort": False}), STATIC, IMAGES)
        assert made.channels["CAM_FRONT"]["camera"] is None
        assert made.summary["cameras"] == 0

    def test_a_camera_that_was_never_calibrated(self, tmp_path):
        empty = camera_info()
        empty.k = np.zeros(9)
        entry = ("/cam/camera_info", CAMERA_INFO, T0, empty)
        with pytest.raises(
            CalibrationError, match=r"no usable CameraInfo on /cam/camera_info: its K is all zeros"
        ):
            Calibrated(tmp_path / "a", rig({}), STATIC, IMAGES, entry)
        made = Calibrated(tmp_path / "b", rig({"undistort": False}), STATIC, IMAGES, entry)
        assert made.channels["CAM_FRONT"]["camera"] is None
        assert made.summary["notes"] == [
            (
                "CAM_FRONT: no usable CameraInfo on /cam/camera_info: its K is all zeros, and P has no focal lengths, so the "
                "camera was not calibrated; its images have no intrinsics."
            )
        ]

    def test_messages_before_the_first_usable_one_are_noted(self, tmp_path):
        empty = camera_info()
        empty.k = np.zeros(9)
        entry = ("/cam/camera_info", CAMERA_INFO, T0 - 5, empty)
        made = Calibrated(tmp_path, rig({}), STATIC, IMAGES, entry, LENS)
        assert made.channels["CAM_FRONT"]["camera"]["source"] == "camera_info"
        (note,) = made.summary["notes"]
        assert note == (
            "CAM_FRONT: 1 messages on /cam/camera_info cannot be used: its K is all zeros, and P has no focal lengths, so "
            "the camera was not calibrated."
        )

    def test_what_a_camera_repeats_is_decoded_once(self, tmp_path):
        again = [("/cam/camera_info", CAMERA_INFO, T0 + n, camera_info(T0 + n)) for n in range(10)]
        # A binning of 1 means the same as 0, in other bytes.
        other = ("/cam/camera_info", CAMERA_INFO, T0 + 20, camera_info(T0 + 20, binning_x=1))
        nothing = camera_info(T0 + 30)
        nothing.k = np.zeros(9)
        unusable = [("/cam/camera_info", CAMERA_INFO, T0 + 30 + n, nothing) for n in range(2)]
        made = Calibrated(tmp_path, rig({}), STATIC, IMAGES, *again, other, *unusable)
        assert made.channels["CAM_FRONT"]["camera"]["source"] == "camera_info"
        assert "CAM_FRONT: 2 messages on /cam/camera_info cannot be used" in made.summary["notes"][0]
        # The static transform, the first, the other, the unusable ones.
        assert made.recording.decoded == 1 + 1 + 1 + 2

    def test_a_calibration_that_changes_after_it_was_repeated(self, tmp_path):
        again = [("/cam/camera_info", CAMERA_INFO, T0 + n, camera_info(T0 + n)) for n in range(3)]
        later = ("/cam/camera_info", CAMERA_INFO, T0 + S, camera_info(T0 + S, d=(0.1, 0.0, 0.0, 0.0, 0.0)))
        with pytest.raises(CalibrationError, match=r"camera_info changes at 2023-11-14T22:13:21\.000Z;"):
            Calibrated(tmp_path, rig({}), STATIC, IMAGES, *again, later)

    def test_a_calibration_that_changes(self, tmp_path):
        later = ("/cam/camera_info", CAMERA_INFO, T0 + S, camera_info(T0 + S, k=(401.0, 410.0, 320.0, 240.0)))
        with pytest.raises(
            CalibrationError, match=r"calibration on /cam/camera_info changes at 2023-11-14T22:13:21\.000Z;"
        ):
            Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS, later)

    def test_a_changed_rectification_changes_nothing(self, tmp_path):
        later = camera_info(T0 + S, d=(-0.2, 0.1, 0.0, 0.0, 0.0), p=np.ones(12))
        entry = ("/cam/camera_info", CAMERA_INFO, T0 + S, later)
        made = Calibrated(tmp_path, rig({}), STATIC, IMAGES, LENS, entry)
        assert made.channels["CAM_FRONT"]["camera"]["p"] == [0.0] * 12

    @pytest.mark.parametrize(
        ("topic", "beside"),
        [
            ("/cam/image_raw", "/cam/camera_info"),
            ("/cam/image_raw/compressed", "/cam/camera_info"),
            ("/cam/compressed", "/camera_info"),  # image_transport: the images are on /cam
            ("cam", "camera_info"),
        ],
    )
    def test_the_topic_beside_the_images(self, topic, beside):
        channel = rig({"topic": topic}).channels["CAM_FRONT"]
        assert camera_info_topic(channel) == beside
        assert camera_info_topic(channel.model_copy(update={"camera_info": "/x"})) == "/x"


class TestRectified:
    """Images that were rectified before they were recorded: P and R hold."""

    TURN = SE3.create((np.cos(0.02), 0.0, np.sin(0.02), 0.0), (0, 0, 0))
    P = np.array([300.0, 0, 310, -45.0, 0, 300, 230, 0, 0, 0, 1, 0])

    def entries(self, topic="/cam/image_rect_color", **changes):
        fields = {"r": self.TURN.rotation_matrix.reshape(-1), "p": self.P} | changes
        message = camera_info(d=(-0.2, 0.1, 0.0, 0.0, 0.0), **fields)
        return [STATIC, reading(topic, IMAGE, "cam"), ("/cam/camera_info", CAMERA_INFO, T0, message)]

    def test_intrinsics_are_those_of_p_and_the_extrinsics_include_r(self, tmp_path):
        made = Calibrated(tmp_path, rig({"topic": "/cam/image_rect_color"}), *self.entries())
        camera = made.channels["CAM_FRONT"]["camera"]
        assert (camera["model"], camera["d"]) == ("none", [])
        assert camera["k"] == [300.0, 0, 310.0, 0, 300.0, 230.0, 0, 0, 1]
        # A point seen in the rectified image, which is R times the point in the camera's frame.
        point_cam = np.array([[0.3, -0.2, 4.0]])
        point_image = self.TURN.transform_points(point_cam)
        np.testing.assert_allclose(
            made.pose("CAM_FRONT").transform_points(point_image), CAM.transform_points(point_cam), atol=1e-9
        )
        assert made.summary["notes"] == [
            (
                "CAM_FRONT: P puts its centre 0.15 m beside the first camera of a stereo pair; its frame cam is taken "
                "for its own centre, so nothing is added."
            ),
            "CAM_FRONT: its images are rectified by a turn of 2.29 degrees, which its extrinsics include.",
        ]

    def test_a_point_lands_where_p_puts_it(self, tmp_path):
        """The whole way: ego frame -> camera -> rectified pixel."""
        made = Calibrated(tmp_path, rig({"topic": "/cam/image_rect_color"}), *self.entries())
        model = CameraModel.from_calibration(made.camera("CAM_FRONT"))
        point_ego = np.array([[12.0, 1.0, 0.5]])
        pixel = model.project(made.pose("CAM_FRONT").inverse().transform_points(point_ego))[0][0]
        x, y, z = self.TURN.transform_points(CAM.inverse().transform_points(point_ego))[0]
        np.testing.assert_allclose(pixel, [300 * x / z + 310, 300 * y / z + 230], atol=1e-6)

    @pytest.mark.parametrize(
        ("topic", "said", "rectified"),
        [
            ("/cam/image_raw", None, False),
            ("/cam/image_rect", None, True),
            ("/cam/image_rect_color/compressed", None, True),
            ("/cam/image_rect", False, False),
            ("/cam/image_raw", True, True),
        ],
    )
    def test_the_recipe_says_or_the_name_of_the_topic(self, topic, said, rectified):
        channel = rig({"topic": topic} | ({} if said is None else {"rectified": said})).channels["CAM_FRONT"]
        assert is_rectified(channel) == rectified

    def test_without_a_projection_it_is_refused(self, tmp_path):
        with pytest.raises(
            CalibrationError, match=r"images are rectified, but P in the CameraInfo on /cam/camera_info"
        ):
            Calibrated(
                tmp_path, rig({"topic": "/cam/image_rect"}), *self.entries("/cam/image_rect", p=np.zeros(12))
            )

    @pytest.mark.parametrize("camera", [{}, {"undistort": False}, {"rectified": False}])
    @pytest.mark.parametrize("topic", ["/cam/image_raw", "/cam/image_rect"])
    def test_where_only_p_is_filled_in_the_images_are_rectified(self, tmp_path, camera, topic):
        message = camera_info(d=(), model="", p=self.P, r=self.TURN.rotation_matrix.reshape(-1))
        message.k = np.zeros(9)
        entries = [STATIC, reading(topic, IMAGE, "cam"), ("/cam/camera_info", CAMERA_INFO, T0, message)]
        made = Calibrated(tmp_path, rig({"topic": topic} | camera), *entries)
        found = made.channels["CAM_FRONT"]["camera"]
        assert (found["model"], found["k"]) == ("none", [300.0, 0, 310.0, 0, 300.0, 230.0, 0, 0, 1])
        assert_same(made.pose("CAM_FRONT"), CAM @ self.TURN.inverse())
        said = "CAM_FRONT: K in the CameraInfo on /cam/camera_info is zero, so its images are taken for rectified: P and R hold."
        assert (said in made.summary["notes"]) == (topic == "/cam/image_raw" or "rectified" in camera)
        assert any("its images are rectified by a turn" in note for note in made.summary["notes"])

    def test_of_a_raw_image_k_counts_whatever_p_says(self, tmp_path):
        made = Calibrated(tmp_path, rig({}), *self.entries("/cam/image_raw"))
        found = made.channels["CAM_FRONT"]["camera"]
        assert (found["model"], found["k"][0]) == ("plumb_bob", 400.0)
        assert_same(made.pose("CAM_FRONT"), CAM)

    def test_where_only_p_is_filled_in_it_may_not_change(self, tmp_path):
        messages = [
            camera_info(d=(), p=self.P * [1, 1, 1, factor, 1, 1, 1, 1, 1, 1, 1, 1]) for factor in (1.0, 1.5)
        ]
        for message in messages:
            message.k = np.zeros(9)
        infos = [("/cam/camera_info", CAMERA_INFO, T0 + i, message) for i, message in enumerate(messages)]
        with pytest.raises(CalibrationError, match="changes at"):
            Calibrated(tmp_path, rig({}), STATIC, IMAGES, *infos)

    @pytest.mark.parametrize(
        "r", [np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.ones((3, 3)), np.diag([1.0, 2.0, 2.0])]
    )
    def test_an_r_that_is_no_rotation_is_refused(self, tmp_path, r):
        with pytest.raises(
            CalibrationError,
            match=r"CAM_FRONT: .* but R of their CameraInfo is no rotation",
        ):
            Calibrated(
                tmp_path / "a",
                rig({"topic": "/cam/image_rect"}),
                *self.entries("/cam/image_rect", r=r.reshape(-1)),
            )
        made = Calibrated(tmp_path / "b", rig({}), *self.entries("/cam/image_raw", r=r.reshape(-1)))
        assert_same(made.pose("CAM_FRONT"), CAM)

    def test_an_r_of_four_digits_is_a_rotation(self, tmp_path):
        r = np.round(self.TURN.rotation_matrix, 4).reshape(-1)
        made = Calibrated(tmp_path, rig({"topic": "/cam/image_rect"}), *self.entries("/cam/image_rect", r=r))
        np.testing.assert_allclose(
            made.pose("CAM_FRONT").matrix, (CAM @ self.TURN.inverse()).matrix, atol=2e-4
        )

    def test_a_projection_that_changes(self, tmp_path):
        *entries, (topic, kind, _, message) = self.entries("/cam/image_rect")
        later = Msg(**vars(message) | {"p": self.P * 1.5})
        with pytest.raises(CalibrationError, match="changes at"):
            Calibrated(
                tmp_path,
                rig({"topic": "/cam/image_rect"}),
                *entries,
                (topic, kind, T0, message),
                (topic, kind, T0 + 1, later),
            )


class TestStereo:
    """The second camera of a stereo pair: P holds for points in the frame of the first."""

    FIRST_TURN = SE3.create((np.cos(0.01), 0.0, np.sin(0.01), 0.0), (0, 0, 0))
    SECOND_TURN = SE3.create((np.cos(0.02), np.sin(0.02), 0.0, 0.0), (0, 0, 0))
    P = np.array([300.0, 0, 310, 0, 0, 300, 230, 0, 0, 0, 1, 0])

    def entries(self, *, frame="cam", tx=-45.0, ty=0.0, image="image_rect", first_tx=0.0):
        second_p, first_p = self.P.copy(), self.P.copy()
        second_p[3], second_p[7], first_p[3] = tx, ty, first_tx
        first = camera_info(r=self.FIRST_TURN.rotation_matrix.reshape(-1), p=first_p)
        second = camera_info(r=self.SECOND_TURN.rotation_matrix.reshape(-1), p=second_p)
        first.header.frame_id, second.header.frame_id = "cam", frame
        own = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "own", CAM)))
        return [
            STATIC, own, reading(f"/right/{image}", IMAGE, frame), ("/left/camera_info", CAMERA_INFO, T0, first),
            ("/right/camera_info", CAMERA_INFO, T0, second),
        ]  # fmt: skip

    def made(self, folder, *, camera=None, **fields):
        topic = f"/right/{fields.get('image', 'image_rect')}"
        return Calibrated(folder, rig({"topic": topic} | (camera or {})), *self.entries(**fields))

    @pytest.mark.parametrize(("tx", "ty"), [(-45.0, 0.0), (45.0, 0.0), (0.0, -60.0)])
    def test_a_point_lands_where_p_puts_it(self, tmp_path, tx, ty):
        """The whole way, by the definition of the message: [u v w] = P [X Y Z 1], rectified frame of the first."""
        made = self.made(tmp_path, tx=tx, ty=ty)
        model = CameraModel.from_calibration(made.camera("CAM_FRONT"))
        point_ego = np.array([[12.0, 1.0, 0.5]])
        pixel = model.project(made.pose("CAM_FRONT").inverse().transform_points(point_ego))[0][0]
        x, y, z = self.FIRST_TURN.transform_points(CAM.inverse().transform_points(point_ego))[0]
        np.testing.assert_allclose(
            pixel, [(300 * x + 310 * z + tx) / z, (300 * y + 230 * z + ty) / z], atol=1e-6
        )
        beside_m = np.hypot(tx, ty) / 300
        assert made.summary["notes"][0] == (
            f"CAM_FRONT: P puts its centre {beside_m:.4g} m beside the first camera of a stereo pair, whose frame cam it "
            "names (/left/camera_info); its extrinsics include that."
        )

    def test_the_baseline_counts_where_only_p_is_filled_in(self, tmp_path):
        entries = self.entries(image="image_raw")
        for _, kind, _, message in entries:
            if kind == CAMERA_INFO:
                message.k, message.r, message.d = np.zeros(9), np.zeros(9), np.zeros(0)
        made = Calibrated(tmp_path, rig({"topic": "/right/image_raw"}), *entries)
        assert_same(made.pose("CAM_FRONT"), CAM @ SE3.create((1, 0, 0, 0), (0.15, 0, 0)))
        assert made.channels["CAM_FRONT"]["camera"]["k"][0] == 300.0

    def test_a_camera_with_a_frame_of_its_own_stays_there(self, tmp_path):
        made = self.made(tmp_path, frame="own")
        assert made.pose("CAM_FRONT").translation == pytest.approx(CAM.translation)
        assert "its frame own is taken for its own centre" in made.summary["notes"][0]
        assert made.use.topics == ("/right/camera_info", "/tf_static")

    def test_a_frame_shared_with_cameras_that_are_not_the_first_is_its_own(self, tmp_path):
        made = self.made(tmp_path, first_tx=-45.0)
        assert made.pose("CAM_FRONT").translation == pytest.approx(CAM.translation)
        assert "taken for its own centre" in made.summary["notes"][0]

    def test_extrinsics_in_the_recipe_win(self, tmp_path):
        given = {"translation": [1.0, 2.0, 3.0], "rotation": [1.0, 0.0, 0.0, 0.0]}
        made = self.made(tmp_path, camera={"extrinsics": given})
        assert made.pose("CAM_FRONT").translation == pytest.approx((1.0, 2.0, 3.0))
        assert "the extrinsics in the recipe are taken for its own centre" in made.summary["notes"][0]

    def test_images_that_are_not_rectified_are_noted(self, tmp_path):
        made = self.made(tmp_path, image="image_raw")
        assert_same(made.pose("CAM_FRONT"), CAM)
        (note,) = made.summary["notes"]
        assert "its extrinsics do not include that, as its images are not rectified" in note

    @pytest.mark.parametrize("frame", ["cam", "own"])
    def test_one_camera_alone_is_not_noted(self, tmp_path, frame):
        made = self.made(tmp_path, tx=0.0, image="image_raw", frame=frame)
        assert made.summary["notes"] == []


def test_a_urdf_that_is_not_there_is_named(tmp_path):
    the_rig = rig(lidar={}, urdf=str(tmp_path / "none.urdf"))
    with pytest.raises(CalibrationError, match=r"none\.urdf: the URDF cannot be read"):
        calibration_use(the_rig, Recorded(CLOUDS).inventory())


def test_a_urdf_enters_by_its_digest_alone(tmp_path):
    urdf = b'<robot name="car"><link name="base_link"/></robot>'
    known = Calibrated(tmp_path, rig(lidar={}, ego_frame="lidar"), CLOUDS, urdf=urdf).use
    assert known.inputs == {"urdf": digest_bytes(urdf)}
    assert as_json(known.params).keys() == {"ego_frame", "channels", "tf_static", "tf"}


def test_where_all_sensors_are_placed_by_hand_transforms_are_not_read(tmp_path):
    by_hand = {"extrinsics": {"translation": (1.0, 0.0, 2.0)}}
    made = Calibrated(tmp_path, rig(lidar=by_hand), CLOUDS, STATIC, urdf=b"no XML")
    assert made.use.topics == ()
    assert made.use.inputs == {}
    assert made.channels["LIDAR_TOP"]["source"] == "recipe"


def test_the_key_holds_what_is_read_and_nothing_else():
    inventory = Recorded(STATIC, IMAGES, LENS, CLOUDS).inventory()
    base = calibration_use(rig({}, {}), inventory)
    assert base.topics == ("/cam/camera_info", "/tf_static")
    assert calibration_use(rig({"quality": 50}, {"min_range_m": 1.0}), inventory) == base
    assert calibration_use(rig({}, {}, location="elsewhere"), inventory) == base
    assert calibration_use(rig({}, {}, ego_frame="x"), inventory) != base
