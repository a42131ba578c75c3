"""Calibration files beside recordings in proposed recipes."""

from dataclasses import replace

import pytest

from bagassets.cli.main import main
from bagassets.propose.calibration_files import calibration_of, find_calibrations
from bagassets.recipe import load_recipe
from bagassets.recipe.yaml_text import read_yaml
from bagassets.sample.rig import cameras
from bagassets_tests.calibration_texts import camchain, kalibr_camera, ros
from bagassets_tests.propose.test_propose import IMAGE, car, info, text_of, topic
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

FRONT, _, RIGHT = (camera.model for camera in cameras(640, 480))
POSE = cameras(640, 480)[0].ego_SE3_cam
INFO_TOPIC = "/cam_front/camera_info"
RAW = "/cam_front/image_raw"
CHAIN = camchain(kalibr_camera(FRONT, RAW, imu=POSE), kalibr_camera(RIGHT, "/cam_right/image_raw", imu=POSE))


def put(folder, **texts):
    for name, text in texts.items():
        path = folder / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_suffix(".yaml").write_text(text)
    return find_calibrations(folder, None)


def uncalibrated(*more):
    return car(*more, without=(INFO_TOPIC,))


def words(text):
    """Comments as they read, on however many lines they stand."""
    return " ".join(text.replace("#", " ").split())


def test_a_file_with_the_topic_stands_in_for_a_camera_info(tmp_path):
    found = put(tmp_path, camchain=CHAIN)
    text = text_of(uncalibrated(), calibrations=found)
    (given,) = [line for line in text.splitlines() if "intrinsics" in line]
    assert read_yaml(given.partition("  #")[0].strip(), tmp_path)[0] == {
        "intrinsics": {"file": f"{tmp_path}/camchain.yaml"}
    }
    assert "guess: no CameraInfo topic; its cam0 has this topic" in words(text)
    assert "undistort: false" not in text


def test_a_recorded_calibration_is_trusted_more(tmp_path):
    assert "intrinsics" not in text_of(car(), calibrations=put(tmp_path, camchain=CHAIN))


def test_an_uncalibrated_camera_info_is_not(tmp_path):
    one = car()
    blank = replace(one, topics=one.topics | {INFO_TOPIC: info(INFO_TOPIC, "cam_front", calibrated=False)})
    text = text_of(blank, calibrations=put(tmp_path, camchain=CHAIN))
    assert "guess: its CameraInfo is not calibrated; its cam0 has this topic" in words(text)


def test_without_a_file_a_recipe_says_that_there_may_be_one():
    output = words(text_of(uncalibrated()))
    assert "`intrinsics` takes a calibration by hand, or a file of ROS, Kalibr or OpenCV" in output


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("ost", ros(FRONT, name="cam_front"), "it is of a camera cam_front"),
        ("ost", ros(FRONT, name="front"), "it is of a camera front"),
        ("front_camera", ros(FRONT), "of its name"),
        ("cam_front__ost", ros(FRONT), "of the name of its folder"),
        ("deep__er__front", ros(FRONT), "of its name"),
        ("ost", ros(FRONT), None),
        ("ost", ros(FRONT, name="back"), None),
        ("camera", ros(FRONT, name="camera"), None),
        ("front", "image_width: 4\ncamera_matrix: {}\n", None),
        ("front", camchain(kalibr_camera(FRONT, RAW) | {"camera_model": "omni"}), None),
        ("front", camchain(kalibr_camera(FRONT, "/other")), None),
        ("front", "[", None),
        (".hidden__front", ros(FRONT), None),
        ("a__b__c__d__front", ros(FRONT), None),
    ],
)
def test_a_name_tells_whose_a_file_is(tmp_path, name, text, reason):
    found = calibration_of(RAW, put(tmp_path, **{name: text}))
    assert (found and found.reason) == reason


def test_two_files_of_a_camera_are_none(tmp_path):
    assert calibration_of(RAW, put(tmp_path, a__front=ros(FRONT), b__front=ros(FRONT))) is None
    assert calibration_of(RAW, put(tmp_path, chain=CHAIN)).reason == "its cam0 has this topic", (
        "a topic says more"
    )


def test_where_the_camera_sits_is_offered_with_the_question(tmp_path):
    lone = topic("/cam_right/image_raw", IMAGE, frame="cam_right", encoding="rgb8")
    text = text_of(uncalibrated(lone), calibrations=put(tmp_path, camchain=CHAIN))
    output = words(text)
    assert "or give `extrinsics`, measured or from a file of Kalibr" in output
    assert "relative to the IMU, whose frame TF or a `urdf` must have:" in output
    assert "          # relative_to: frame\n" in text


@pytest.mark.parametrize("inside", [True, False])
def test_init_proposes_a_recipe_that_loads(tmp_path, inside):
    bags = tmp_path / ("project/bags" if inside else "elsewhere")
    write_drive(bags / "a.bag", "ros1", duration_s=0.5, keep=lambda name, _: name != "/cam/camera_info")
    (bags / "calib").mkdir()
    (bags / "calib" / "camchain.yaml").write_text(camchain(kalibr_camera(FRONT, "/cam/image_raw")))
    assert main(["init", str(tmp_path / "project"), "--bags", str(bags)]) == 0
    recipe = tmp_path / "project" / "recipe.yaml"
    assert ("file: bags/calib/camchain.yaml" in recipe.read_text()) == inside
    (channel,) = [one for one in load_recipe(recipe).rigs[0].channels.values() if one.modality == "camera"]
    assert channel.intrinsics.file == bags / "calib" / "camchain.yaml"
    assert channel.undistort
