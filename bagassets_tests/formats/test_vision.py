"""The vision dataset: sequences, relative trajectories against truth, files that belong together."""

import csv
import json
import math

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.base.errors import DatasetError, RecipeError
from bagassets.decode.fields import stamp_ns
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.format import Part
from bagassets.formats.vision.format import VISION
from bagassets.formats.vision.sequences import cut_sequences
from bagassets.formats.vision.settings import Vision
from bagassets.formats.vision.trajectories import geodetic_columns, relative_poses, roll_pitch_yaw
from bagassets.geometry.se3 import SE3
from bagassets.recipe import load_recipe
from bagassets.recipe.model_splits import Splits
from bagassets.recordings.discover import find_one
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.sample.schedule import MAP_SE3_ODOM
from bagassets.store.store import Store
from bagassets_tests.sample_drives import build_recordings

FRAMES = 5
SECTION = f"""
vision:
  frames: {FRAMES}
  trajectories: ["ego:global", "CAM_FRONT:LIDAR_TOP", "global:CAM_FRONT", "base_link:odom", "CAM_FRONT:map", "nowhere:odom"]
"""
unit = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(unit, unit, unit, unit)
    .filter(lambda q: sum(v * v for v in q) > 0.01)
    .map(lambda q: SE3.create(q, (0.0, 0.0, 0.0)).rotation)
)


class TestCutting:
    @given(
        st.lists(st.tuples(st.integers(1, 30), st.booleans()), max_size=80),
        st.integers(1, 6),
        st.integers(1, 3),
    )
    def test_every_image_is_accounted_for_and_no_sequence_reaches_over_a_gap(self, steps, length, stride):
        stamps = np.cumsum([step for step, _ in steps], dtype=np.int64)
        posed = np.array([pose for _, pose in steps], dtype=bool)
        cuts = cut_sequences(stamps, posed, length=length, stride=stride, max_gap_ns=40)
        assert len(steps) == cuts.sequences.size + cuts.strided + cuts.without_pose + cuts.remainder
        flat = cuts.sequences.ravel()
        assert len(set(flat.tolist())) == len(flat)
        assert posed[flat].all()
        for images in cuts.sequences:
            assert (np.diff(images) == stride).all()
            assert (np.diff(stamps[images]) <= 40).all()

    def test_a_sequence_starts_anew_after_a_gap(self):
        stamps = np.array([0, 1, 2, 3, 4, 50, 51, 52], dtype=np.int64)
        cuts = cut_sequences(stamps, np.ones(8, bool), length=3, stride=1, max_gap_ns=10)
        assert cuts.sequences.tolist() == [[0, 1, 2], [5, 6, 7]]
        assert (cuts.remainder, cuts.breaks) == (2, 1)

    def test_nothing_makes_nothing(self):
        none = cut_sequences(np.zeros(0, np.int64), np.zeros(0, bool), length=3, stride=1, max_gap_ns=1)
        assert none.sequences.shape == (0, 3)


class TestRelativePoses:
    @given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
    def test_angles_of_known_rotations(self, roll, pitch, yaw):
        half = np.array([roll, pitch, yaw]) / 2
        (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
        q = [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
             cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]  # fmt: skip
        assert roll_pitch_yaw(np.array([q]))[0] == pytest.approx([roll, pitch, yaw], abs=1e-6)

    @given(quaternions)
    @settings(max_examples=200)
    def test_angles_give_the_rotation_back(self, q):
        roll, pitch, yaw = roll_pitch_yaw(np.array([q]))[0]
        (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
        again = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        )
        assert again == pytest.approx(SE3(q).rotation_matrix, abs=1e-5)

    def test_at_the_zenith_all_of_it_is_yaw(self):
        half = math.pi / 4
        up = np.array([[math.cos(half), 0.0, math.sin(half), 0.0]])
        assert roll_pitch_yaw(up)[0] == pytest.approx([0.0, math.pi / 2, 0.0], abs=1e-7)

    @given(quaternions, quaternions, st.tuples(unit, unit, unit), st.tuples(unit, unit, unit))
    def test_they_are_composed_not_subtracted(self, q0, q1, t0, t1):
        first, second = SE3(q0, t0), SE3(q1, t1)
        rows = relative_poses(np.array([t0, t1]), np.array([q0, q1]))
        assert rows[0] == pytest.approx([0.0] * 6, abs=1e-8)
        truth = first.inverse() @ second
        assert rows[1][:3] == pytest.approx(truth.translation, abs=1e-6)
        turned = np.array(rows[1][3:]) - roll_pitch_yaw(np.array([truth.rotation]))[0]
        # A half turn is as much to the left as to the right.
        assert np.remainder(turned + np.pi, 2 * np.pi) - np.pi == pytest.approx([0.0] * 3, abs=1e-5)

    def test_a_turned_vehicle_that_drives_ahead_moves_along_its_own_x(self):
        q = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # heading north
        rows = relative_poses(np.array([[5.0, 5.0, 0.0], [5.0, 7.0, 0.0]]), np.array([q, q]))
        assert rows[1] == pytest.approx([2.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-9)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("vision")
    targets = [Target(folder / "recordings" / "drive.bag", "ros1"),
               Target(folder / "recordings" / "drive.mcap", "mcap")]  # fmt: skip
    truth = write_recordings(targets, seed=5, duration_s=2.2)
    (folder / "recipe.yaml").write_text(sample_recipe() + SECTION)
    recipe = load_recipe(folder / "recipe.yaml")
    return recipe, truth, build_recordings(recipe)


def parts_of(made):
    return [Part(key, key, assets["vision_sequences"].artifact.digest) for key, assets in made.items()]


@pytest.fixture(scope="module")
def dataset(built):
    recipe, _, made = built
    splits = Splits(pinned={"drive.bag": "train", "drive.mcap": "val"})
    summary = assemble(
        VISION, parts_of(made), recipe.vision, Store(recipe.store_path), recipe.vision.output, splits=splits
    )
    return recipe.vision.output, summary


def read(output, name):
    return json.loads((output / "annotations" / name).read_bytes())


class TestSequences:
    def test_poses_relative_to_the_first_frame_are_true(self, built, dataset):
        _, truth, _ = built
        output, _ = dataset
        rows = read(output, "train.json")
        assert {row["channel"] for row in rows} == set(truth.cameras)
        for row in rows:
            assert len(row["frames"]) == FRAMES
            first = truth.odom_SE3_ego(row["frames"][0]["stamp_ns"])
            for frame in row["frames"]:
                relative = first.inverse() @ truth.odom_SE3_ego(frame["stamp_ns"])
                assert frame["pose"][:3] == pytest.approx(relative.translation, abs=2e-3)
                angles = roll_pitch_yaw(np.array([relative.rotation]))[0]
                assert frame["pose"][3:] == pytest.approx(angles, abs=1e-3)

    def test_the_images_are_those_of_the_stamps(self, built, dataset):
        recipe, _, made = built
        output, _ = dataset
        channels = made["drive.bag"]["frames"].artifact.read_json("channels.json")
        for row in read(output, "train.json"):
            artifact = Store(recipe.store_path).artifact(channels[row["channel"]]["artifact"])
            for number, frame in enumerate(row["frames"]):
                path = output / row["folder"] / frame["file"]
                assert path.name.startswith(f"{number:06d}.")
                original = artifact.path(f"{frame['stamp_ns']}{path.suffix}")
                assert path.read_bytes() == original.read_bytes()
                assert path.stat().st_ino == original.stat().st_ino, "a link, not a copy"
            image = cv2.imread(str(output / row["folder"] / row["frames"][0]["file"]))
            assert image.shape[:2] == (row["height"], row["width"])

    def test_intrinsics_and_extrinsics_are_those_of_the_written_images(self, built, dataset):
        _, truth, _ = built
        output, _ = dataset
        for row in read(output, "val.json"):
            camera = truth.cameras[row["channel"]].model
            assert np.array(row["intrinsics"]) == pytest.approx(camera.matrix, rel=1e-5)
            ego_SE3_cam = truth.ego_SE3_sensor(row["channel"])
            assert row["ego_SE3_sensor"]["translation"] == pytest.approx(ego_SE3_cam.translation, abs=1e-6)

    def test_each_sequence_has_a_file_of_its_own(self, dataset):
        output, _ = dataset
        for row in read(output, "val.json"):
            own = json.loads((output / f"{row['folder']}.json").read_bytes())
            assert own["frames"] == row["frames"]
            assert row["folder"].endswith(f"{own['channel']}/{own['sequence']}")

    def test_counts_in_are_counts_out(self, built):
        _, _, made = built
        for assets in made.values():
            facts = assets["vision_sequences"].artifact.read_json("facts.json")
            for channel, counts in facts["channels"].items():
                images = assets["frames"].artifact.read_json("channels.json")[channel]["counts"]["written"]
                assert counts["images"] == images
                parts = ("in_sequences", "strided", "without_pose", "remainder")
                assert images == sum(counts[part] for part in parts)
                assert counts["in_sequences"] == FRAMES * counts["sequences"] > 0

    def test_formats_give_the_same_sequences(self, dataset):
        output, _ = dataset
        train, val = read(output, "train.json"), read(output, "val.json")
        assert [row["frames"] for row in train] == [row["frames"] for row in val]


class TestRecordingFiles:
    def folder(self, output):
        return next((output / "recordings").glob("drive.bag-*"))

    def test_metadata_has_place_daylight_and_counts(self, built, dataset):
        _, _, made = built
        metadata = json.loads((self.folder(dataset[0]) / "metadata.json").read_bytes())
        inventory = made["drive.bag"]["inventory"].artifact.read_json("inventory.json")
        assert metadata["name"] == "drive.bag"
        assert metadata["duration_s"] == pytest.approx(2.2, abs=0.3)
        assert metadata["topics"]["/odom"]["messages"] == 111
        assert metadata["messages"] == sum(topic["count"] for topic in inventory["topics"])
        assert metadata["gnss"]["first"]["lat"] == inventory["gnss"]["first"]["lat"]
        assert metadata["daylight"] == ("day" if metadata["sun_elevation_deg"] > 0 else metadata["daylight"])
        assert metadata["daylight"] == inventory["daylight"] is not None

    def test_transforms_have_all_sensors(self, built, dataset):
        transforms = json.loads((self.folder(dataset[0]) / "transforms.json").read_bytes())
        assert {"LIDAR_TOP", "RADAR_FRONT", *built[1].cameras} == set(transforms["sensors"])
        assert len(transforms["sensors"]["CAM_FRONT"]["intrinsics"]) == 3

    def rows(self, output, name):
        with (self.folder(output) / "trajectories" / f"{name}.csv").open() as file:
            return list(csv.DictReader(file))

    def test_the_ego_trajectory_is_true_and_csv_and_parquet_agree(self, built, dataset):
        _, truth, _ = built
        rows = self.rows(dataset[0], "ego-global")
        for row in rows[::10]:
            position = [float(row[name]) for name in "xyz"]
            assert position == pytest.approx(truth.odom_SE3_ego(int(row["stamp_ns"])).translation, abs=1e-3)
        table = pq.read_table(self.folder(dataset[0]) / "trajectories" / "ego-global.parquet")
        assert table.num_rows == len(rows)
        assert [str(v) for v in table["yaw"].to_pylist()] == [row["yaw"] for row in rows]

    def test_pairs_of_fixed_frames_are_one_pose(self, built, dataset):
        _, truth, _ = built
        (row,) = self.rows(dataset[0], "CAM_FRONT-LIDAR_TOP")
        lidar_SE3_cam = truth.ego_SE3_sensor("LIDAR_TOP").inverse() @ truth.ego_SE3_sensor("CAM_FRONT")
        assert [float(row[name]) for name in "xyz"] == pytest.approx(lidar_SE3_cam.translation, abs=1e-6)

    def test_the_world_seen_from_a_sensor_is_the_inverse(self, built, dataset):
        _, truth, _ = built
        row = self.rows(dataset[0], "global-CAM_FRONT")[7]
        global_SE3_cam = truth.odom_SE3_ego(int(row["stamp_ns"])) @ truth.ego_SE3_sensor("CAM_FRONT")
        position = [float(row[name]) for name in "xyz"]
        assert position == pytest.approx(global_SE3_cam.inverse().translation, abs=1e-3)

    def test_frames_that_only_tf_knows_are_followed_through_tf(self, built, dataset):
        _, truth, _ = built
        rows = self.rows(dataset[0], "CAM_FRONT-map")
        assert len(rows) > 100
        for row in rows[::17]:
            map_SE3_cam = (
                MAP_SE3_ODOM @ truth.odom_SE3_ego(int(row["stamp_ns"])) @ truth.ego_SE3_sensor("CAM_FRONT")
            )
            position = [float(row[name]) for name in "xyz"]
            assert position == pytest.approx(map_SE3_cam.translation, abs=1e-3)

    def test_with_log_times_tf_counts_by_log_time_too(self, tmp_path):
        path = tmp_path / "recordings" / "drive.bag"
        write_recordings([Target(path, "ros1")], seed=5, duration_s=1.2)
        (tmp_path / "recipe.yaml").write_text(sample_recipe() + SECTION + "clock: log\n")
        made = build_recordings(load_recipe(tmp_path / "recipe.yaml"))["drive.bag"]["vision_sequences"]
        table = made.artifact.read_table("trajectories/CAM_FRONT-map.parquet")
        with open_recording(find_one(path)) as recording:
            messages = [(raw.log_time_ns, recording.decode(raw)) for raw in recording.messages(["/tf"])]
        logged = {log_time_ns for log_time_ns, _ in messages}
        stamped = {stamp_ns(one.header.stamp) for _, tf in messages for one in tf.transforms}
        assert logged.isdisjoint(stamped), "else the test says nothing"
        assert table.num_rows > 20
        assert set(table["stamp_ns"].to_pylist()) <= logged

    def test_a_frame_that_is_not_there_is_reported_and_costs_nothing_else(self, built, dataset):
        facts = built[2]["drive.bag"]["vision_sequences"].artifact.read_json("facts.json")
        assert set(facts["missing_trajectories"]) == {"nowhere:odom"}
        assert "nowhere" in facts["missing_trajectories"]["nowhere:odom"]
        assert not list((self.folder(dataset[0]) / "trajectories").glob("nowhere*"))

    def test_positions_on_earth_have_utm_coordinates(self):
        origin = {"kind": "wgs84", "lat": 48.08, "lon": 11.64, "alt": 550.0}
        numbers, zones = geodetic_columns(np.array([[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]]), origin)
        assert zones == ["32N", "32N"]
        assert numbers["lat"][0] == pytest.approx(48.08, abs=1e-9)
        # 100 m on the ground are 100 m times the scale of the grid there, between 0.9996 and 1.
        moved_m = math.hypot(np.diff(numbers["northing"])[0], np.diff(numbers["easting"])[0])
        assert 99.96 <= moved_m < 100.0
        assert geodetic_columns(np.zeros((1, 3)), {"kind": "local"}) is None


class TestDataset:
    def test_manifests_count_what_is_there(self, dataset):
        output, summary = dataset
        for name in ("train", "val"):
            manifest, rows = read(output, f"{name}.manifest.json"), read(output, f"{name}.json")
            assert manifest["sequences"] == len(rows) == summary.facts["sequences"][name]
            assert manifest["images"] == sum(len(row["frames"]) for row in rows)
            (bag,) = manifest["bags"]
            assert (output / bag["folder"]).is_dir()
            assert abs(bag["start"]["lat"]) > 1
        assert read(output, "train.manifest.json")["deviation"] == pytest.approx(-0.3, abs=0.01)

    def test_one_file_holds_all_in_order(self, built, tmp_path):
        recipe, _, made = built
        vision = recipe.vision.model_copy(update={"files": "one", "output": tmp_path / "one"})
        assemble(VISION, parts_of(made), vision, Store(recipe.store_path), vision.output, splits=Splits())
        rows = read(tmp_path / "one", "all.json")
        assert {row["recording"] for row in rows} == {"drive.bag", "drive.mcap"}
        assert sorted(path.name for path in (tmp_path / "one" / "annotations").iterdir()) == [
            "all.json", "dataset.lock.json", "train.manifest.json", "val.manifest.json"]  # fmt: skip

    def content(self, root):
        return {
            path.relative_to(root).as_posix(): path.read_bytes()
            for path in sorted(root.rglob("*"))
            if path.is_file() and not path.name.startswith(".bagassets")
        }

    def test_order_and_history_do_not_matter_and_nothing_stays_behind(self, built, tmp_path):
        recipe, _, made = built
        store, parts = Store(recipe.store_path), parts_of(made)
        at = {name: recipe.vision.model_copy(update={"output": tmp_path / name}) for name in "ab"}
        assemble(VISION, parts, at["a"], store, at["a"].output, splits=Splits())
        assemble(VISION, parts[::-1], at["b"], store, at["b"].output, splits=Splits())
        assert self.content(tmp_path / "a") == self.content(tmp_path / "b")
        less = assemble(VISION, parts[:1], at["b"], store, at["b"].output, splits=Splits())
        assert len(list((tmp_path / "b" / "recordings").iterdir())) == 1
        again = assemble(VISION, parts, at["b"], store, at["b"].output, splits=Splits())
        assert self.content(tmp_path / "a") == self.content(tmp_path / "b")
        assert less.digest != again.digest

    def test_a_killed_run_is_cleaned_up_and_equal_content_enters_once(self, built, tmp_path):
        recipe, _, made = built
        vision = recipe.vision.model_copy(update={"output": tmp_path})
        (tmp_path / "annotations.tmp-1").mkdir()
        (tmp_path / "recordings" / "drive.bag-1.tmp-1").mkdir(parents=True)
        (tmp_path / ".bagassets.lock").touch()
        same = [Part(part.key, "same", part.artifact) for part in parts_of(made)]
        summary = assemble(
            VISION,
            same,
            vision,
            Store(recipe.store_path),
            vision.output,
            splits=Splits(),
            skipped={"c": "why"},
        )
        assert summary.duplicates == {"drive.mcap": "drive.bag"}
        assert len(list((tmp_path / "recordings").iterdir())) == 1
        assert sorted(p.name for p in tmp_path.iterdir()) == [".bagassets.lock", "annotations", "recordings"]
        lock = read_lock(tmp_path / "annotations").value
        assert (lock["skipped"], [bag["key"] for bag in lock["bags"]]) == ({"c": "why"}, ["drive.bag"])

    def test_a_folder_of_somebody_else_is_left_alone(self, built, tmp_path):
        recipe, _, made = built
        (tmp_path / "recordings" / "mine").mkdir(parents=True)
        vision = recipe.vision.model_copy(update={"output": tmp_path})
        with pytest.raises(DatasetError, match="not made by bagassets"):
            assemble(VISION, parts_of(made), vision, Store(recipe.store_path), vision.output, splits=Splits())
        assert (tmp_path / "recordings" / "mine").is_dir()


class TestBuild:
    def test_other_settings_cut_again_and_extract_nothing(self, built):
        recipe, _, _ = built
        vision = recipe.vision.model_copy(update={"frames": 4})
        again = build_recordings(recipe.model_copy(update={"vision": vision}))
        ran = {name for assets in again.values() for name, result in assets.items() if not result.cached}
        assert ran == {"vision_sequences"}

    def test_without_a_vision_section_there_is_none(self, built):
        recipe, _, _ = built
        again = build_recordings(recipe.model_copy(update={"vision": None}))
        assert all("vision_sequences" not in assets for assets in again.values())

    def test_images_are_lossless_where_the_recipe_says_so(self, built, tmp_path):
        recipe, _, _ = built
        text = sample_recipe(root=str(recipe.bags.root)) + "vision: {cameras: [CAM_FRONT], frames: 5}\n"
        png = text.replace("CAM_FRONT: {modality: camera,", "CAM_FRONT: {modality: camera, output: png,")
        assert png != text
        (tmp_path / "recipe.yaml").write_text(png)
        lossless = load_recipe(tmp_path / "recipe.yaml")
        made = build_recordings(lossless)
        assemble(
            VISION,
            parts_of(made),
            lossless.vision,
            Store(lossless.store_path),
            lossless.vision.output,
            splits=Splits(),
        )
        images = list(lossless.vision.output.glob("recordings/*/CAM_FRONT/*/*.*"))
        assert {path.suffix for path in images} == {".png"}
        assert all(cv2.imread(str(path)) is not None for path in images[:3])

    def test_cameras_can_be_chosen(self, built):
        recipe, _, _ = built
        vision = recipe.vision.model_copy(update={"cameras": ("CAM_FRONT",), "stride": 2})
        again = build_recordings(recipe.model_copy(update={"vision": vision}))
        facts = again["drive.mcap"]["vision_sequences"].artifact.read_json("facts.json")
        assert set(facts["channels"]) == {"CAM_FRONT"}
        assert facts["channels"]["CAM_FRONT"]["strided"] > 0

    @pytest.mark.parametrize(
        ("fields", "words"),
        [
            ("trajectories: [ego]", "name two frames"),
            ("frames: 0", "must not be smaller than 1"),
            ("cameras: [CAM_FRON]", "no rig has a camera CAM_FRON; did you mean CAM_FRONT?"),
            ("output: .bagassets/vision", "state folder"),
            ("output: nuscenes/vision", "output of nuscenes"),
        ],
    )
    def test_wrong_settings_are_refused(self, tmp_path, fields, words):
        (tmp_path / "recipe.yaml").write_text(sample_recipe() + f"vision:\n  {fields}\n")
        with pytest.raises(RecipeError, match=words):
            load_recipe(tmp_path / "recipe.yaml")

    def test_pairs_are_normalised(self):
        assert Vision(trajectories=("/gps : /map",)).trajectories == ("gps:map",)
