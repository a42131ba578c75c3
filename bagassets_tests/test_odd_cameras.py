"""Drives whose CameraInfo is odd, against the truth of their world and beside their plain twin."""

import cv2
import numpy as np
import pytest

from bagassets.propose.scan import scan_recording
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.oddities.cameras import rectified
from bagassets.sample.recipe import sample_recipe
from bagassets.sample.render import CameraView
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild

CHANNELS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")


class Odd:
    """Calibration and frames of a drive of 0.3 s."""

    def __init__(self, folder, *odd):
        self.path = folder / "recordings" / "drive.mcap"
        self.truth = write_recordings([Target(self.path, "mcap")], 3, "small", 0.3, odd=odd)
        (folder / "recipe.yaml").write_text(sample_recipe())
        recipe = load_recipe(folder / "recipe.yaml")
        (recording,) = discover(recipe.bags).recordings.values()
        self.store = Store(recipe.store_path)
        digest, stat = recording_digest(recording).digest, recording_stat(recording)
        build = RecordingBuild(recipe, self.store, recording, digest, stat)
        made = {
            result.asset: result.artifact for result in build.build({"inventory", "calibration", "frames"})
        }
        self.calibration = made["calibration"].read_json("calibration.json")
        self.frames = made["frames"].read_json("channels.json")

    def channel(self, name):
        return self.store.artifact(self.frames[name]["artifact"])


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return Odd(tmp_path_factory.mktemp("plain"))


def test_a_rectified_camera_has_p_for_its_matrix(tmp_path, plain):
    made = Odd(tmp_path, "projection-only")
    for name in CHANNELS:
        camera = rectified(made.truth.cameras[name])
        entry = made.calibration["channels"][name]
        assert entry["ego_SE3_sensor"] == plain.calibration["channels"][name]["ego_SE3_sensor"]
        content = made.channel(name).read_json("channel.json")
        np.testing.assert_allclose(content["camera_intrinsic"], camera.model.matrix, rtol=1e-11)
        index = made.channel(name).read_table("index.parquet")
        assert len(index) == 3
        view = CameraView(made.truth.world, camera)
        for stamp_ns, file in zip(index["stamp_ns"].to_pylist(), index["file"].to_pylist(), strict=True):
            written = cv2.imread(str(made.channel(name).path(file))).astype(float)
            assert np.abs(written - view.image(made.truth.seconds(stamp_ns))).mean() < 6.0
        assert any("its images are taken for rectified" in note for note in made.calibration["notes"])
    with open_recording(made.path) as recording:
        infos = [topic for topic in scan_recording(recording).topics.values() if "camera_info" in topic.name]
    assert [info.calibrated for info in infos] == [True] * 3


def test_p_of_a_raw_camera_does_not_count(tmp_path, plain):
    made = Odd(tmp_path, "projection-differs")
    for name in CHANNELS:
        assert made.channel(name).digest == plain.channel(name).digest
    assert made.calibration["notes"] == []
