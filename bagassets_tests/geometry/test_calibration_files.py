"""Calibration files of other tools: what each format says is what the camera sees, and what is wrong with a file is reported."""

import json
import re
from dataclasses import replace
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
import yaml

from bagassets.assets.calibration_files import short_names
from bagassets.base.errors import BagAssetsError, CalibrationError
from bagassets.geometry.calibration_files.read import MOST_BYTES, read_calibration_file
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3
from bagassets.recipe import parse_recipe
from bagassets.sample.rig import cameras
from bagassets.store.canonical import digest_bytes
from bagassets_tests.assets.test_calibration import IMAGES, STATIC, Calibrated, assert_same, rig
from bagassets_tests.calibration_texts import (
    camchain,
    kalibr_camera,
    kapture_rigs,
    kapture_sensors,
    opencv,
    ros,
    ros_fields,
)
from bagassets_tests.pose_data import T0, TFMESSAGE, about_z, tf, transform

CAMERAS = {camera.channel: camera for camera in cameras(640, 480)}
FRONT, LEFT, RIGHT = (CAMERAS[name] for name in ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"))
TOPIC = "/cam/image_raw"
EGO_SE3_IMU = SE3.create((0.7, 0.1, -0.2, 0.3), (0.4, -0.2, 0.9))
IMU = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "imu", EGO_SE3_IMU)))


def write(folder, text, name="calibration.yaml"):
    path = folder / name
    path.write_text(text)
    return path


def calibrated(folder, text, *entries, name="calibration.yaml", extrinsics=None, channel=(), **intrinsics):
    """The asset with a camera whose intrinsics, or extrinsics, are in a file with this text."""
    path = str(write(folder, text, name))
    fields = dict(channel)
    if extrinsics is not None:
        fields["undistort"] = False
        fields["extrinsics"] = {"file": path, **extrinsics}
    if extrinsics is None or intrinsics:
        fields["intrinsics"] = {"file": path, **intrinsics}
    return Calibrated(folder, rig(fields), *(entries or (STATIC,)), IMAGES)


def second(folder):
    """Another folder, for another asset of the same test."""
    (folder / "second").mkdir()
    return folder / "second"


def model_of(made):
    return CameraModel.from_calibration(made.camera("CAM_FRONT"))


def points_in_view(model, seed=1):
    """(N, 3) points that the lens maps into its image."""
    rng = np.random.default_rng(seed)
    points = np.stack([rng.uniform(-4, 4, 400), rng.uniform(-3, 3, 400), rng.uniform(3, 30, 400)], axis=1)
    pixels, _ = model.project(points)
    inside = (pixels >= 0).all(axis=1) & (pixels < (model.width, model.height)).all(axis=1)
    assert inside.sum() > 100
    return points[inside]


def assert_sees_the_same(found, truth):
    points = points_in_view(truth)
    np.testing.assert_allclose(found.project(points)[0], truth.project(points)[0], atol=1e-8)
    assert (found.width, found.height) == (truth.width, truth.height)


class TestLenses:
    """A lens in every format that knows its model, held against the projection of the sample world."""

    @pytest.mark.parametrize("camera", CAMERAS.values(), ids=list(CAMERAS))
    def test_ros(self, tmp_path, camera):
        made = calibrated(tmp_path, ros(camera.model))
        assert_sees_the_same(model_of(made), camera.model)
        assert made.channels["CAM_FRONT"]["camera"]["source"] == "calibration.yaml"

    @pytest.mark.parametrize("camera", CAMERAS.values(), ids=list(CAMERAS))
    def test_opencv(self, tmp_path, camera):
        text = opencv(camera.model, tmp_path / "opencv.yaml", calibration_time="Sun Nov 22 20:00:00 2026")
        assert text.startswith("%YAML:1.0\n")
        assert "!!opencv-matrix" in text
        assert_sees_the_same(model_of(calibrated(tmp_path, text)), camera.model)

    def test_opencv_in_json(self, tmp_path):
        text = opencv(FRONT.model, tmp_path / "opencv.json")
        assert json.loads(text)["camera_matrix"]["type_id"] == "opencv-matrix"
        assert_sees_the_same(model_of(calibrated(tmp_path, text, name="front.json")), FRONT.model)

    @pytest.mark.parametrize("camera", [FRONT, RIGHT], ids=["radtan", "equidistant"])
    def test_kalibr(self, tmp_path, camera):
        made = calibrated(tmp_path, camchain(kalibr_camera(camera.model, TOPIC)))
        assert_sees_the_same(model_of(made), camera.model)

    def test_kalibr_without_distortion(self, tmp_path):
        pinhole = replace(FRONT.model, model="none", distortion=())
        made = calibrated(tmp_path, camchain(kalibr_camera(pinhole, TOPIC)))
        assert_sees_the_same(model_of(made), pinhole)

    @pytest.mark.parametrize(
        ("kind", "model", "distortion"),
        [
            ("SIMPLE_PINHOLE", "none", ()),
            ("PINHOLE", "none", ()),
            ("SIMPLE_RADIAL", "plumb_bob", (-0.1, 0, 0, 0)),
            ("RADIAL", "plumb_bob", (-0.1, 0.02, 0, 0)),
            ("OPENCV", "plumb_bob", (-0.1, 0.02, 0.001, -0.002)),
            ("FULL_OPENCV", "rational_polynomial", LEFT.model.distortion),
            ("OPENCV_FISHEYE", "equidistant", RIGHT.model.distortion),
            ("SIMPLE_RADIAL_FISHEYE", "equidistant", (0.03, 0, 0, 0)),
            ("RADIAL_FISHEYE", "equidistant", (0.03, -0.01, 0, 0)),
        ],
    )
    def test_kapture(self, tmp_path, kind, model, distortion):
        truth = replace(FRONT.model, model=model, distortion=distortion)
        focal = (truth.fx,) if kind.startswith(("SIMPLE", "RADIAL")) else (truth.fx, truth.fy)
        number = {"SIMPLE_RADIAL": 1, "RADIAL": 2}.get(kind.removesuffix("_FISHEYE"), len(distortion))
        numbers = (truth.width, truth.height, *focal, truth.cx, truth.cy, *distortion[:number])
        text = kapture_sensors(cam0=(kind, numbers))
        assert_sees_the_same(model_of(calibrated(tmp_path, text, name="sensors.txt")), truth)

    def test_ros_without_the_name_of_a_model_is_plumb_bob(self, tmp_path):
        """As camera_calibration_parsers takes it."""
        fields = ros_fields(FRONT.model)
        del fields["distortion_model"]
        assert_sees_the_same(model_of(calibrated(tmp_path, yaml.safe_dump(fields))), FRONT.model)

    def test_the_recipe_names_the_model_of_an_opencv_fisheye_without_a_mark(self, tmp_path):
        text = opencv(RIGHT.model, tmp_path / "opencv.yaml").replace("fisheye_model: 1\n", "")
        assert model_of(calibrated(tmp_path, text)).model == "plumb_bob"
        assert_sees_the_same(model_of(calibrated(second(tmp_path), text, model="equidistant")), RIGHT.model)

    def test_a_driver_without_coefficients(self, tmp_path):
        """`rows: 0` or an empty list: no distortion, as in a CameraInfo."""
        made = calibrated(tmp_path, ros(replace(FRONT.model, distortion=())))
        assert model_of(made).model == "none"

    def test_numbers_that_yaml_takes_for_text(self, tmp_path):
        text = ros(FRONT.model).replace("- -0.0006\n", "- -6e-4\n")
        assert "-6e-4" in text
        assert_sees_the_same(model_of(calibrated(tmp_path, text)), FRONT.model)

    def test_rectified_images_have_p_and_are_turned_by_r(self, tmp_path):
        turn = SE3.create(about_z(0.02), (0, 0, 0))
        p = [500.0, 0, 310, 0, 0, 505, 235, 0, 0, 0, 1, 0]
        text = ros(FRONT.model, r=turn.rotation_matrix.reshape(-1), p=p)
        made = calibrated(tmp_path, text, channel={"rectified": True})
        camera = made.channels["CAM_FRONT"]["camera"]
        assert (camera["model"], camera["k"]) == ("none", [500.0, 0, 310.0, 0, 505.0, 235.0, 0, 0, 1])
        raw = calibrated(second(tmp_path), text)
        assert raw.channels["CAM_FRONT"]["camera"]["model"] == "plumb_bob"
        assert_same(made.pose("CAM_FRONT"), raw.pose("CAM_FRONT") @ turn.inverse())

    def test_a_file_without_p_is_of_the_recorded_images(self, tmp_path):
        text = camchain(kalibr_camera(FRONT.model, TOPIC))
        made = calibrated(tmp_path, text, channel={"rectified": True})
        assert_sees_the_same(model_of(made), FRONT.model)

    def test_rectified_images_need_p_of_a_ros_file(self, tmp_path):
        text = ros(FRONT.model, p=[0.0] * 12)
        with pytest.raises(CalibrationError, match=r"but P in calibration\.yaml has no focal length"):
            calibrated(tmp_path, text, channel={"rectified": True})


class TestPoses:
    """Where cameras sit, from files, held against the truth of the sample world."""

    def chain(self, *sensors, imu=True):
        entries = []
        for number, camera in enumerate(sensors):
            cam_SE3_ego = camera.ego_SE3_cam.inverse()
            before = sensors[number - 1].ego_SE3_cam if number else None
            entries.append(
                kalibr_camera(
                    camera.model,
                    f"/{camera.name}/image_raw",
                    cam_SE3_ego @ EGO_SE3_IMU if imu else None,
                    None if before is None else cam_SE3_ego @ before,
                )
            )
        return entries

    def test_kalibr_relative_to_the_imu(self, tmp_path):
        text = camchain(*self.chain(FRONT, RIGHT))
        made = calibrated(
            tmp_path, text, IMU, extrinsics={"camera": "cam1", "relative_to": "/imu"}, camera="cam1"
        )
        assert_same(made.pose("CAM_FRONT"), RIGHT.ego_SE3_cam)
        assert made.channels["CAM_FRONT"]["source"] == "calibration.yaml+tf_static"
        assert made.summary["notes"] == []
        ego_points = RIGHT.ego_SE3_cam.transform_points(points_in_view(RIGHT.model))
        seen, _ = model_of(made).project(made.pose("CAM_FRONT").inverse().transform_points(ego_points))
        truth, _ = RIGHT.model.project(points_in_view(RIGHT.model))
        np.testing.assert_allclose(seen, truth, atol=1e-6)

    def test_kalibr_whose_imu_is_the_ego_frame(self, tmp_path):
        text = camchain(*self.chain(FRONT))
        made = calibrated(tmp_path, text, extrinsics={"relative_to": "base_link"})
        assert_same(made.pose("CAM_FRONT"), EGO_SE3_IMU.inverse() @ FRONT.ego_SE3_cam)
        assert made.summary["notes"] == []
        assert "/tf_static" not in made.use.topics, "no transform is needed"

    def test_without_a_frame_the_imu_is_taken_for_the_ego_frame_and_a_note_says_so(self, tmp_path):
        made = calibrated(tmp_path, camchain(*self.chain(FRONT)), extrinsics={})
        assert_same(made.pose("CAM_FRONT"), EGO_SE3_IMU.inverse() @ FRONT.ego_SE3_cam)
        (note,) = made.summary["notes"]
        assert note == (
            "CAM_FRONT: calibration.yaml places it relative to the IMU, whose frame is taken for base_link; name that "
            "frame in `relative_to` of `extrinsics`."
        )

    def test_a_camera_without_the_imu_is_reached_along_the_chain(self, tmp_path):
        cameras = self.chain(FRONT, LEFT_RADTAN, RIGHT)
        for camera in cameras[1:]:
            del camera["T_cam_imu"]
        made = calibrated(
            tmp_path, camchain(*cameras), IMU, extrinsics={"camera": "cam2", "relative_to": "imu"}
        )
        assert_same(made.pose("CAM_FRONT"), RIGHT.ego_SE3_cam)

    def test_cameras_alone_are_relative_to_the_first(self, tmp_path):
        frame = ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "cam0", FRONT.ego_SE3_cam)))
        text = camchain(*self.chain(FRONT, LEFT_RADTAN, RIGHT, imu=False))
        given = {"camera": "cam2", "relative_to": "cam0"}
        assert_same(calibrated(tmp_path, text, frame, extrinsics=given).pose("CAM_FRONT"), RIGHT.ego_SE3_cam)
        with pytest.raises(CalibrationError, match=r"relative to cam0, not to an IMU .* in `relative_to`"):
            calibrated(second(tmp_path), text, frame, extrinsics={"camera": "cam2"})

    def test_a_shift_of_time_is_reported(self, tmp_path):
        (camera,) = self.chain(FRONT)
        text = camchain(camera | {"timeshift_cam_imu": -0.0125})
        made = calibrated(tmp_path, text, IMU, extrinsics={"relative_to": "imu"})
        assert made.summary["notes"] == [
            "CAM_FRONT: calibration.yaml: timeshift_cam_imu of cam0 is -12.5 ms; stamps are not shifted by it."
        ]

    def test_kapture(self, tmp_path):
        text = kapture_rigs("car", cam0=FRONT.ego_SE3_cam.inverse(), cam1=RIGHT.ego_SE3_cam.inverse())
        made = calibrated(
            tmp_path, text, name="rigs.txt", extrinsics={"camera": "cam1", "relative_to": "base_link"}
        )
        assert_same(made.pose("CAM_FRONT"), RIGHT.ego_SE3_cam)

    def test_a_frame_that_nothing_relates_is_named(self, tmp_path):
        with pytest.raises(CalibrationError) as caught:
            calibrated(tmp_path, camchain(*self.chain(FRONT)), extrinsics={"relative_to": "imu_link"})
        text = str(caught.value)
        assert text.startswith("CAM_FRONT: calibration.yaml, relative_to: imu_link: ")
        assert "Correct `relative_to`, or name a `urdf` with imu_link." in text


LEFT_RADTAN = replace(LEFT, model=replace(LEFT.model, model="plumb_bob", distortion=FRONT.model.distortion))


class TestWhichCamera:
    """Of several cameras in a file."""

    TEXT = camchain(
        kalibr_camera(FRONT.model, "/other/image_raw"), kalibr_camera(RIGHT.model, "cam/image_raw/compressed")
    )

    def test_the_one_of_the_topic(self, tmp_path):
        assert model_of(calibrated(tmp_path, self.TEXT)).model == "equidistant"

    def test_the_one_that_is_named(self, tmp_path):
        assert model_of(calibrated(tmp_path, self.TEXT, camera="cam0")).model == "plumb_bob"

    def test_the_only_one_whatever_its_topic(self, tmp_path):
        text = camchain(kalibr_camera(FRONT.model, "/other/image_raw"))
        assert_sees_the_same(model_of(calibrated(tmp_path, text)), FRONT.model)

    def test_the_name_in_a_ros_file(self, tmp_path):
        made = calibrated(tmp_path, ros(FRONT.model, name="front"), camera="front")
        assert_sees_the_same(model_of(made), FRONT.model)

    @pytest.mark.parametrize(
        ("text", "camera", "words"),
        [
            (TEXT.replace("cam/image", "b/image"), None, ("the cameras cam0 (/other/image_raw), cam1 (b/image_raw/compressed), of "
             f"which none is of topic {TOPIC}; name one in `camera`.")),
            (TEXT.replace("/other", "/cam"), None, "of which several are of topic"),
            (TEXT, "cam2", "there is no camera cam2, only cam0, cam1; correct `camera`."),
            (ros(FRONT.model, name="front"), "back", "there is no camera back, only front; correct"),
            (ros(FRONT.model, name=""), "back", "its camera has no name, so `camera: back` cannot be found; remove"),
            (kapture_sensors(), None, "a sensors.txt of kapture without a camera; name another file."),
        ],
    )  # fmt: skip
    def test_none_or_several(self, tmp_path, text, camera, words):
        with pytest.raises(CalibrationError) as caught:
            calibrated(tmp_path, text, camera=camera)
        assert str(caught.value).startswith(f"CAM_FRONT: {tmp_path}/calibration.yaml: ")
        assert words in str(caught.value)

    def test_another_camera_of_the_file_may_be_of_a_model_that_is_not_supported(self, tmp_path):
        omni = kalibr_camera(RIGHT.model, "/other") | {"camera_model": "omni"}
        text = camchain(kalibr_camera(FRONT.model, TOPIC), omni)
        assert_sees_the_same(model_of(calibrated(tmp_path, text)), FRONT.model)


def ros_with(**fields):
    return yaml.safe_dump(ros_fields(FRONT.model) | fields)


def ros_without(field):
    fields = ros_fields(FRONT.model)
    del fields[field]
    return yaml.safe_dump(fields)


def kalibr_with(**fields):
    return camchain(kalibr_camera(FRONT.model, TOPIC, imu=EGO_SE3_IMU) | fields)


def rows(*, times=1.0, last=(0, 0, 0, 1)):
    matrix = EGO_SE3_IMU.matrix
    matrix[0, :3] *= times
    matrix[3] = last
    return matrix.tolist()


IMU_YAML = "rostopic: /imu\nupdate_rate: 200.0\naccelerometer_noise_density: 0.01\n"
BAD = {
    "not YAML": ("camera_matrix: [1, 2\nx: }", {}, ", line 2: it is not YAML (expected ',' or ']'"),
    "OpenCV's directive is a line": ("%YAML:1.0\n---\na: [1\nb: }", {}, ", line 4: it is not YAML"),
    "nested": ("[" * 5000, {}, "it is not YAML (it is nested too deeply)"),
    "binary": (b"\x89PNG\xff", {}, ": it is not UTF-8 text; expected a ROS camera_calibration"),
    "XML": ('<?xml version="1.0"?><opencv_storage/>', {}, ": it is XML; expected a ROS"),
    "empty": ("", {}, ": it holds nothing; expected a ROS camera_calibration or OpenCV YAML"),
    "a list": ("[1, 2]", {}, ": it holds a list; expected"),
    "text": ("hello", {}, ": it holds plain text; expected"),
    "another kind": (IMU_YAML, {}, ": it holds the fields rostopic, update_rate, accelerometer_noise_density; expected"),
    "ros, no size": (ros_without("image_width"), {}, ": image_width: this field is missing, expected the width"),
    "ros, size in words": (ros_with(image_width="wide"), {}, (": image_width: expected the width of the images in pixels, in "
                           "numbers, found 'wide'; correct the file or name another one.")),
    "ros, half a pixel": (ros_with(image_height=480.5), {}, (": image_height: expected the height of the images in pixels, a "
                          "positive whole number, found 480.5")),
    "ros, K is a list": (ros_with(camera_matrix=[1.0]), {}, (": camera_matrix: expected the intrinsic matrix K, a mapping, found a "
                         "list of 1")),
    "ros, K of 3x4": (ros_with(camera_matrix={"rows": 3, "cols": 4, "data": [0.0] * 12}), {}, (": camera_matrix: expected the "
                      "intrinsic matrix K, 3x3, found 3x4")),
    "ros, K too short": (ros_with(camera_matrix={"rows": 3, "cols": 3, "data": [1.0] * 8}), {}, (": camera_matrix.data: expected the "
                         "intrinsic matrix K, 9 numbers, found 8")),
    "ros, K of nothing": (ros_with(camera_matrix={"rows": 3, "cols": 3}), {}, ": camera_matrix.data: this field is missing"),
    "ros, a focal length of zero": (ros_with(camera_matrix={"data": [0.0] * 8 + [1.0]}), {}, (": the intrinsics of narrow_stereo "
                                    "cannot be used: its focal lengths must be positive")),
    "ros, not finite": (ros_with(camera_matrix={"data": [float("nan")] * 9}), {}, (": camera_matrix.data: expected the intrinsic "
                        "matrix K, in numbers, found '.nan'")),
    "ros, an unknown model": (ros_with(distortion_model="thin_prism"), {}, (": the intrinsics of narrow_stereo cannot be used: "
                              "distortion model 'thin_prism' is not known (known are plumb_bob, rational_polynomial, equidistant)")),
    "ros, another number of coefficients": (
        ros_with(distortion_model="equidistant"), {}, "distortion model equidistant has 4 coefficients, it holds 5"
    ),
    "ros, coefficients and shape": (
        ros_with(distortion_coefficients={"rows": 1, "cols": 4, "data": [0.0] * 5}), {},
        ": distortion_coefficients: `rows` and `cols` say 1x4, but `data` has 5 numbers",
    ),
    "ros, coefficients in a square": (
        ros_with(distortion_coefficients={"rows": 2, "cols": 2, "data": [0.0] * 4}), {},
        ": distortion_coefficients: expected the coefficients of the lens in one row or column, found 2x2",
    ),
    "ros, no camera_matrix": (ros_without("camera_matrix"), {}, ": camera_matrix: this field is missing"),
    "ros, coefficients missing": (ros_without("distortion_coefficients"), {}, ": distortion_coefficients: this field is missing"),
    "ros, P too short": (ros_with(projection_matrix={"data": [1.0]}), {}, (": projection_matrix.data: expected the projection "
                         "matrix P, 12 numbers, found 1")),
    "ros, a model in the recipe": (ros(FRONT.model), {"model": "plumb_bob"}, (": a ROS camera calibration names its distortion model "
                                   "itself; remove `model: plumb_bob`.")),
    "opencv, six coefficients": (
        ("%YAML:1.0\n---\nimage_width: 4\nimage_height: 3\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [1., 0., 1., 0., 1., 1., 0., 0., 1.]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 6\n   cols: 1\n   dt: d\n   data: [0., 0., 0., 0., 0., 0.]\n"),
        {}, ": distortion_coefficients: OpenCV's lenses have 4, 5, 8, 12 or 14 coefficients, found 6",
    ),
    "kalibr, omni": (kalibr_with(camera_model="omni"), {}, ": cam0.camera_model: the model omni is not supported, only pinhole is"),
    "kalibr, fov": (kalibr_with(distortion_model="fov"), {}, (": cam0.distortion_model: the model fov is not supported, only radtan, "
                    "equidistant and none are")),
    "kalibr, three intrinsics": (kalibr_with(intrinsics=[1.0, 1.0, 1.0]), {}, (": cam0.intrinsics: expected fu, fv, pu, pv, 4 numbers, "
                                 "found 3; correct the file or name another one.")),
    "kalibr, five coefficients": (kalibr_with(distortion_coeffs=[0.1] * 5), {}, (": cam0.distortion_coeffs: expected the coefficients "
                                  "of radtan, 4 numbers, found 5")),
    "kalibr, no resolution": (kalibr_with(resolution=None), {}, ": cam0.resolution: expected width and height in pixels"),
    "kalibr, resolution of zero": (kalibr_with(resolution=[640, 0]), {}, (": cam0.resolution: expected width and height in pixels, "
                                   "found 640 and 0")),
    "kalibr, a camera of text": ("cam0: {}\ncam1: here\n", {}, ": cam1: expected the parameters of a camera, a mapping, found 'here'"),
    "kapture, FOV": (kapture_sensors(c=("FOV", [4, 3, 1, 1, 1, 1, 1])), {}, (", line 4: the camera model FOV of c is not supported, only "
                     "SIMPLE_PINHOLE, PINHOLE,")),
    "kapture, too few": (kapture_sensors(c=("PINHOLE", [4, 3, 1])), {}, (", line 4: PINHOLE takes the numbers width, height, fx, fy, cx, "
                         "cy, found 4.0, 3.0, 1.0; correct the line.")),
    "kapture, no number": ("# kapture format: 1.1\nc, , camera, PINHOLE, 4, 3, 1, 1, x, 1\n", {}, ", line 2: PINHOLE takes the numbers"),
    "kapture, twice": ("# kapture format: 1.1\nc, , camera, PINHOLE\n\nc, , camera, PINHOLE\n", {}, (", line 4: c stands there a second "
                       "time, first in line 2")),
    "kapture, poses": (kapture_rigs("car", c=EGO_SE3_IMU), {}, ": a rigs.txt of kapture holds no intrinsics; name the sensors.txt"),
}  # fmt: skip
BAD_POSES = {
    "ros": (ros(FRONT.model), {}, ": a ROS camera calibration holds no pose of its camera, as `extrinsics` needs; name a Kalibr"),
    "kapture, lenses": (kapture_sensors(c=("PINHOLE", [4, 3, 1, 1, 1, 1])), {}, ": a sensors.txt of kapture holds no pose, as"),
    "three rows": (kalibr_with(T_cam_imu=rows()[:3]), {}, (": cam0.T_cam_imu: expected the transform from the IMU to the camera, four rows "
                   "of four numbers, found rows of 4, 4, 4; correct the file")),
    "flat": (kalibr_with(T_cam_imu=[1.0] * 16), {}, (": cam0.T_cam_imu: expected the transform from the IMU to the camera, four rows of four "
             "numbers, found a list of 16")),
    "scaled": (kalibr_with(T_cam_imu=rows(times=1.01)), {}, (": cam0.T_cam_imu: expected the transform from the IMU to the camera, a "
               "rotation beside a translation, and last the row 0 0 0 1")),
    "mirrored": (kalibr_with(T_cam_imu=rows(times=-1.0)), {}, "a rotation beside a translation"),
    "projective": (kalibr_with(T_cam_imu=rows(last=(0, 0, 1, 1))), {}, "and last the row 0 0 0 1"),
    "words": (kalibr_with(T_cam_imu=[["a"] * 4] * 4), {}, "in numbers, found 'a'"),
    "a gap in the chain": (
        yaml.safe_dump({"cam2": kalibr_camera(FRONT.model, TOPIC, previous=EGO_SE3_IMU)}), {"relative_to": "base_link"},
        ": the chain from cam2 needs cam1, which is missing; name the file with all cameras.",
    ),
    "no chain": (
        camchain(kalibr_camera(FRONT.model, "/a"), kalibr_camera(FRONT.model, TOPIC)), {},
        ": cam1.T_cn_cnm1: this field is missing, expected the transform from the camera before it",
    ),
}  # fmt: skip


class TestBadFiles:
    """One sentence each, which names the file, the field, what was expected, and what to do."""

    @pytest.mark.parametrize(("text", "fields", "words"), BAD.values(), ids=list(BAD))
    def test_intrinsics(self, tmp_path, text, fields, words):
        path = write(tmp_path, "")
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        self.assert_reported(tmp_path, {"intrinsics": {"file": str(path), **fields}}, path, words)

    @pytest.mark.parametrize(("text", "fields", "words"), BAD_POSES.values(), ids=list(BAD_POSES))
    def test_extrinsics(self, tmp_path, text, fields, words):
        path = write(tmp_path, text)
        self.assert_reported(tmp_path, {"extrinsics": {"file": str(path), **fields}}, path, words)

    def test_a_file_that_is_gone(self, tmp_path):
        path = tmp_path / "none.yaml"
        words = (
            ": the calibration file cannot be read (No such file or directory); correct `file` in the recipe"
        )
        self.assert_reported(tmp_path, {"intrinsics": {"file": str(path)}}, path, words, channel="")

    def test_a_file_that_is_no_text_file_at_all(self, tmp_path):
        path = write(tmp_path, "#" * (MOST_BYTES + 1))
        words = ": 1000001 bytes are too many for a calibration file; name another file."
        self.assert_reported(tmp_path, {"intrinsics": {"file": str(path)}}, path, words, channel="")

    @staticmethod
    def assert_reported(folder, camera, path, words, channel="CAM_FRONT: "):
        with pytest.raises(BagAssetsError) as caught:
            Calibrated(folder, rig(camera), STATIC, IMAGES)
        text = str(caught.value)
        assert text.startswith(f"{channel}{path}{words}" if words[0] in ":," else channel), text
        assert words in text
        assert text.endswith(".")
        assert "\n" not in text


class TestKeys:
    """What of a file an action knows."""

    def test_the_digest_of_the_content_and_the_end_of_the_path(self, tmp_path):
        text = camchain(kalibr_camera(FRONT.model, TOPIC, imu=EGO_SE3_IMU))
        made = calibrated(tmp_path, text, IMU, extrinsics={"relative_to": "imu"}, camera="cam0")
        assert made.use.inputs == {"calibration:calibration.yaml": digest_bytes(text.encode())}
        again = calibrated(second(tmp_path), text, IMU, extrinsics={"relative_to": "imu"}, camera="cam0")
        assert (again.use.params.channels, again.use.inputs) == (made.use.params.channels, made.use.inputs)
        assert again.digest == made.digest, "whatever folder they lie in"

    def test_names_are_as_short_as_they_can_be(self, tmp_path):
        left, right, other = (tmp_path / name for name in ("left/ost.yaml", "right/ost.yaml", "chain.yaml"))
        assert short_names([left, right, other]) == {
            left: "left/ost.yaml",
            right: "right/ost.yaml",
            other: "chain.yaml",
        }
        assert short_names([tmp_path / "a" / "x", tmp_path / "b" / "a" / "x", other])[other] == "chain.yaml"
        assert len(set(short_names([tmp_path / "x", tmp_path / "a" / "x"]).values())) == 2


def test_the_example_in_the_docs_loads(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "poses.md").read_text("utf-8")
    example = page.partition("## Calibration files")[2].partition("```yaml\n")[2].partition("```")[0]
    text = "name: x\nbags: {root: bags}\nrigs:\n  - name: car\n    ego_pose: {source: fixed}\n" + indent(
        example, "    "
    )
    named = re.findall(r"file: ([^,}]+)", example)
    assert len(named) == 6
    for name in named:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    channels = parse_recipe(text, tmp_path / "recipe.yaml").rigs[0].channels
    files = {name: sorted(channel.calibration_files) for name, channel in channels.items()}
    both = ["extrinsics", "intrinsics"]
    assert files == {"CAM_FRONT": both[1:], "CAM_LEFT": both, "CAM_RIGHT": both[1:], "CAM_BACK": both}
    assert channels["CAM_BACK"].extrinsics.file == tmp_path / "sensors" / "rigs.txt"


def test_whatever_a_file_holds_is_read_or_refused():
    """Damage at any byte of any format costs a sentence, never a traceback."""
    texts = [
        ros(FRONT.model),
        camchain(kalibr_camera(FRONT.model, TOPIC, imu=EGO_SE3_IMU)),
        kapture_sensors(c=("OPENCV", [4, 3, 1, 1, 1, 1, 0, 0, 0, 0])),
        kapture_rigs("car", c=EGO_SE3_IMU),
    ]
    rng = np.random.default_rng(7)
    outcomes = []
    for text in texts:
        for _ in range(150):
            data = bytearray(text.encode())
            for at in rng.integers(0, len(data), 3):
                data[at] = rng.choice(np.frombuffer(b"\x00:-[]{}&*!%#,\n 9e.x\xff", np.uint8))
            outcomes += [outcome(bytes(data), ask) for ask in ("lens", "pose")]
    assert {type(one).__name__ for one in outcomes} >= {"FileLens", "FilePose", "str"}
    assert all(one.startswith("a file") for one in outcomes if isinstance(one, str))


def outcome(data, ask):
    try:
        file = read_calibration_file(data, "a file")
        camera = file.choose(None, TOPIC)
        return file.lens(camera, None) if ask == "lens" else file.pose(camera)
    except CalibrationError as err:
        return str(err)
