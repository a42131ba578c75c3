"""Drives whose CameraInfo is odd, against the truth of their world and beside their plain twin."""

import cv2
import numpy as np
import pytest

from bagassets.propose.scan import scan_recording
from bagassets.recordings.open import open_recording
from bagassets.sample.oddities import rectified
from bagassets.sample.render import CameraView
from bagassets_tests.odd_drive import OddDrive

pytestmark = pytest.mark.once

CHANNELS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return OddDrive(tmp_path_factory.mktemp("plain"))


def test_a_rectified_camera_has_p_for_its_matrix(tmp_path, plain):
    made = OddDrive(tmp_path, "projection-only")
    for name in CHANNELS:
        camera = rectified(made.truth.cameras[name])
        entry = made.calibration["channels"][name]
        assert entry["ego_SE3_sensor"] == plain.calibration["channels"][name]["ego_SE3_sensor"]
        content = made.channel(name).read_json("channel.json")
        np.testing.assert_allclose(content["camera_intrinsic"], camera.model.matrix, rtol=1e-11)
        index = made.channel(name).read_table("index.parquet")
        assert len(index) == 2
        view = CameraView(made.truth.world, camera)
        for stamp_ns, file in zip(index["stamp_ns"].to_pylist(), index["file"].to_pylist(), strict=True):
            written = cv2.imread(str(made.channel(name).path(file))).astype(float)
            assert np.abs(written - view.image(made.truth.seconds(stamp_ns))).mean() < 6.0
        assert any("its images are taken for rectified" in note for note in made.calibration["notes"])
    with open_recording(made.path) as recording:
        infos = [topic for topic in scan_recording(recording).topics.values() if "camera_info" in topic.name]
    assert [info.calibrated for info in infos] == [True] * 3
