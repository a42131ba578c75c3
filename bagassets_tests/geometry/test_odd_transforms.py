"""Drives with odd static transforms: what is sent again changes nothing, what contradicts itself is refused."""

import pytest

from bagassets.engine.execute import BuildFailure
from bagassets_tests.odd_drive import OddDrive


def places(artifacts):
    """Where calibration has the sensors: channel -> metres."""
    channels = artifacts["calibration"].read_json("calibration.json")["channels"]
    return {name: sensor["ego_SE3_sensor"]["translation"] for name, sensor in channels.items()}


def test_a_static_transform_that_is_sent_again_changes_nothing(tmp_path):
    plain, again = (
        OddDrive(tmp_path / str(odd), *odd).made("calibration") for odd in ((), ("static-again",))
    )
    assert places(plain)["LIDAR_TOP"] == [0.9, 0.0, 1.85]
    assert again["calibration"].read_json("calibration.json") == plain["calibration"].read_json(
        "calibration.json"
    )


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        ("static-disputed", r"base_link -> lidar_top \(tf_static\) has several values at one time; correct what publishes it\. .*give the channel `extrinsics: \{translation: "),
        ("static-loop", "the transforms go round in a circle, lidar_top <- base_link <- lidar_top"),
    ],
)  # fmt: skip
def test_a_lidar_whose_place_nobody_can_tell_is_refused(tmp_path, odd, said):
    drive = OddDrive(tmp_path, odd)
    with pytest.raises(BuildFailure, match=rf"LIDAR_TOP \(/lidar_top/points\): no transform from .*: {said}"):
        drive.made("calibration")
    found = places(drive.made("calibration", without="LIDAR_TOP"))
    for channel, camera in drive.truth.cameras.items():
        assert found[channel] == pytest.approx(camera.ego_SE3_cam.translation, abs=1e-9)
