"""Calibration files in builds: what is made again when one changes, and that images are those of a CameraInfo with the same numbers."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from bagassets.cli.main import main
from bagassets.engine.execute import BuildFailure
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets.geometry.camera import CameraModel
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.sample.rig import EGO_SE3_LIDAR
from bagassets.store.store import Store
from bagassets_tests.calibration_texts import camchain, kalibr_camera, opencv, ros
from bagassets_tests.in_process import QUICK, build, make_project, states, survey
from bagassets_tests.recording_build import RecordingBuild
from bagassets_tests.small_drive import HEIGHT, WIDTH

pytestmark = pytest.mark.once

KEY = "a.bag"
LENS = CameraModel("plumb_bob", WIDTH, HEIGHT, 30.0, 30.0, 16.0, 12.0, (-0.1, 0.0, 0.0, 0.0, 0.0))
FRONT = "      CAM_FRONT: {{modality: camera, topic: /cam/image_raw}}\n"
TWO = QUICK.replace(
    FRONT,
    "      CAM_FRONT: {{modality: camera, topic: /cam/image_raw, intrinsics: {{file: calib/front/ost.yaml}}}}\n"
    "      CAM_BACK: {{modality: camera, topic: /cam/image_raw, intrinsics: {{file: calib/back/ost.yaml}}, "
    "extrinsics: {{translation: [0, 0, 1], rotation: [0.5, -0.5, 0.5, -0.5]}}}}\n",
)


class TestStale:
    """What a change of a file makes stale, and what does not."""

    @pytest.fixture(scope="class")
    @classmethod
    def project(cls, tmp_path_factory):
        folder = tmp_path_factory.mktemp("calibrated")
        for side in ("front", "back"):
            (folder / "calib" / side).mkdir(parents=True)
            (folder / "calib" / side / "ost.yaml").write_text(ros(LENS))
        return make_project(folder, [KEY], text=TWO, duration_s=1.5)

    @pytest.fixture
    def fresh(self, project, monkeypatch):
        report, _ = build(project, monkeypatch)
        assert report.succeeded, report.as_json()
        assert self.is_quick(project)
        return project

    @staticmethod
    def is_quick(recipe):
        return nothing_to_do(["build", "--recipe", str(recipe)]) is not None

    @staticmethod
    def parts(recipe):
        """Asset and channel -> digest of the artifact, and what of it ran last."""
        plan = survey(recipe).plan.bags[KEY]
        store = Store(load_recipe(recipe).store_path)
        frames = store.artifact(plan.assets["frames"].data_version).read_json("channels.json")
        return {name: asset.data_version for name, asset in plan.assets.items()} | {
            name: entry["artifact"] for name, entry in frames.items()
        }

    def test_a_file_that_is_written_again_makes_nothing(self, fresh, monkeypatch):
        path = fresh.parent / "calib" / "back" / "ost.yaml"
        text = path.read_text()
        path.write_text(text)
        assert not self.is_quick(fresh), "only its content tells"
        report, runs = build(fresh, monkeypatch)
        assert (report.succeeded, runs) == (True, [])
        assert self.is_quick(fresh)

    def test_a_change_makes_the_images_of_that_camera(self, fresh, monkeypatch, capsys):
        before = self.parts(fresh)
        path = fresh.parent / "calib" / "back" / "ost.yaml"
        path.write_text(ros(replace(LENS, fx=31.0)))
        assert not self.is_quick(fresh), "the quick path notices"
        planned = survey(fresh)
        found = planned.plan.bags[KEY].assets
        assert found["calibration"].state == "stale"
        assert found["calibration"].reason == "calibration file back/ost.yaml changed"
        assert found["frames"].reason == "waits for calibration — calibration file back/ost.yaml changed"
        fresh_ones = {name for name, state in states(planned, KEY).items() if state == "fresh"}
        assert {"bag", "inventory", "ego_poses"} <= fresh_ones
        assert main(["explain", KEY, "calibration", "--recipe", str(fresh)]) == 0
        output = capsys.readouterr().out
        assert "is stale: calibration file back/ost.yaml changed" in output
        assert "front/ost.yaml" in output
        report, runs = build(fresh, monkeypatch)
        assert report.succeeded
        assert runs
        after = self.parts(fresh)
        changed = {name for name in before if before[name] != after[name]}
        assert changed == {"calibration", "frames", "CAM_BACK", "nuscenes_tables"}
        assert self.is_quick(fresh)

    def test_a_remark_in_a_file_costs_the_calibration_alone(self, fresh, monkeypatch):
        before = self.parts(fresh)
        path = fresh.parent / "calib" / "front" / "ost.yaml"
        path.write_text(path.read_text() + "# calibrated anew, and the same\n")
        assert survey(fresh).plan.bags[KEY].assets["calibration"].state == "stale"
        report, _ = build(fresh, monkeypatch)
        assert report.succeeded
        assert self.parts(fresh) == before

    def test_a_file_that_is_gone_is_named(self, fresh, capsys):
        path = fresh.parent / "calib" / "front" / "ost.yaml"
        aside = path.rename(path.with_suffix(".old"))
        assert not self.is_quick(fresh)
        assert main(["build", "--recipe", str(fresh)]) == 1
        output = capsys.readouterr().err
        aside.rename(path)
        assert f"rigs[car].channels.CAM_FRONT.intrinsics.file: there is no file {path}" in output
        assert "Traceback" not in output

    def test_a_damaged_file_fails_the_calibration_in_a_sentence(self, fresh, monkeypatch, capsys):
        path = fresh.parent / "calib" / "front" / "ost.yaml"
        text = path.read_text()
        path.write_text(text.replace("camera_matrix", "camera_matrx"))
        report, _ = build(fresh, monkeypatch)
        path.write_text(text)
        assert not report.succeeded
        (failure,) = [one for one in str(report.as_json()).split("'") if "camera_matrix" in one][:1]
        assert f"CAM_FRONT: {path}: camera_matrix: this field is missing" in failure


class TestSampleWorld:
    """The sample drive, whose CameraInfo and TF are its truth, built from files with the same numbers."""

    @pytest.fixture(scope="class")
    @classmethod
    def folder(cls, tmp_path_factory):
        folder = tmp_path_factory.mktemp("world")
        target = Target(folder / "recordings" / "drive.mcap", "mcap")
        cls.write_files(folder, write_recordings([target], 3, "small", 0.6))
        return folder

    @staticmethod
    def write_files(folder, truth):
        front, left, right = (
            truth.cameras[name] for name in ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
        )
        # The lidar stands in for the IMU: its frame is in TF.
        cameras = [
            kalibr_camera(one.model, f"/{one.name}/image_raw", one.ego_SE3_cam.inverse() @ EGO_SE3_LIDAR)
            for one in (front, right)
        ]
        (folder / "camchain.yaml").write_text(camchain(*cameras))
        opencv(left.model, folder / "left.yaml")
        (folder / "left.ost.yaml").write_text(ros(left.model))

    @staticmethod
    def made(folder, name, **channels):
        data = yaml.safe_load(sample_recipe(root="recordings", name=name))
        for channel, fields in channels.items():
            data["rigs"][0]["channels"][channel] |= fields
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data | {"state": f".{name}"}))
        recipe = load_recipe(folder / f"{name}.yaml")
        (recording,) = discover(recipe.bags).recordings.values()
        store = Store(recipe.store_path)
        digest = recording_digest(recording).digest
        run = RecordingBuild(recipe, store, recording, digest, recording_stat(recording))
        list(run.build(["inventory", "calibration", "frames"]))
        images = {
            channel: [(row["file"], row["digest"]) for row in part.read_table("index.parquet").to_pylist()]
            for channel, part in run.last.inputs.channels("frames").items()
        }
        return run.last.inputs.calibration, images

    def test_images_are_byte_for_byte_those_of_the_camera_info(self, folder):
        lidar = {"relative_to": "lidar_top"}
        known, images = self.made(folder, "recorded")
        chain = {"file": "camchain.yaml"}
        found, same = self.made(
            folder,
            "files",
            CAM_FRONT={"intrinsics": chain, "extrinsics": chain | lidar},
            CAM_FRONT_LEFT={"intrinsics": {"file": "left.yaml"}},
            CAM_FRONT_RIGHT={"intrinsics": chain, "extrinsics": chain | lidar},
        )
        assert same == images
        assert sum(map(len, images.values())) > 10
        for name, sensor in known.channels.items():
            np.testing.assert_allclose(
                found.channels[name].ego_SE3_sensor.matrix,
                sensor.ego_SE3_sensor.matrix,
                atol=1e-9,
                err_msg=name,
            )
        sources = {
            name: (one.source, one.camera and one.camera.source) for name, one in found.channels.items()
        }
        assert sources["CAM_FRONT_RIGHT"] == ("camchain.yaml+tf_static", "camchain.yaml")
        assert sources["CAM_FRONT_LEFT"] == ("tf_static", "left.yaml")

    def test_a_calibration_of_another_size_is_refused_by_name(self, folder):
        text = (folder / "left.ost.yaml").read_text()
        (width,) = [line for line in text.splitlines() if line.startswith("image_width")]
        (folder / "wide.ost.yaml").write_text(text.replace(width, "image_width: 2000"))
        with pytest.raises(BuildFailure) as caught:
            self.made(folder, "wide", CAM_FRONT_LEFT={"intrinsics": {"file": "wide.ost.yaml"}})
        (output,) = {str(error) for error in caught.value.errors.values() if "wide.ost.yaml" in str(error)}
        assert "but the calibration in wide.ost.yaml is for 2000x" in output
        assert output.endswith(
            "; name the calibration of these images in `intrinsics`, or, if the size of images changes there, split the recording."
        )
