"""`bagassets.open_dataset` against the real devkit, and against the truth of the sample world."""

import json
import multiprocessing
import os
import pickle
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from devkit import run_devkit

import bagassets
from bagassets.base.errors import DatasetError
from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.reader.reading_files import read_image
from bagassets.formats.reader.table_folder import TableFolder
from bagassets.formats.vision.format import VISION
from bagassets.recipe import load_recipe
from bagassets.recipe.model_splits import Splits
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.sample_drives import VERSION, build_recordings

pytestmark = pytest.mark.xdist_group("reader")

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
CHANNELS = (*CAMERAS, "LIDAR_TOP", "RADAR_FRONT")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A drive in two formats, its nuScenes dataset and its vision dataset."""
    folder = tmp_path_factory.mktemp("reader")
    targets = [
        Target(folder / "recordings" / "drive.bag", "ros1"),
        Target(folder / "recordings" / "drive.mcap", "mcap"),
    ]
    truth = write_recordings(targets, seed=3, duration_s=2.6)
    (folder / "recipe.yaml").write_text(sample_recipe() + "\nvision: {frames: 5}\n")
    recipe = load_recipe(folder / "recipe.yaml")
    made = build_recordings(recipe)
    store = Store(recipe.store_path)
    splits = Splits(pinned={"drive.bag": "train", "drive.mcap": "val"})
    for kind, settings in ((NUSCENES, recipe.nuscenes), (VISION, recipe.vision)):
        parts = [Part(key, key, assets[kind.part].artifact.digest) for key, assets in made.items()]
        assemble(kind, parts, settings, store, settings.output, splits=splits)
    return recipe, truth


@pytest.fixture(scope="module")
def dataset(project):
    return bagassets.open_dataset(project[0].nuscenes.output)


@pytest.fixture(scope="module")
def theirs(project, tmp_path_factory):
    """What the devkit says about the same dataset."""
    file = tmp_path_factory.mktemp("devkit") / "values.pickle"
    run_devkit("devkit_read.py", project[0].nuscenes.output, VERSION, file)
    return pickle.loads(file.read_bytes())


def assert_same_box(ours, box):
    assert (ours.token, ours.instance, ours.category) == (box["token"], box["instance"], box["category"])
    assert (list(ours.attributes), ours.visibility) == (box["attributes"], box["visibility"])
    assert (ours.num_lidar_pts, ours.num_radar_pts) == (box["num_lidar_pts"], box["num_radar_pts"])
    np.testing.assert_allclose(ours.frame_SE3_box, box["pose"], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(ours.size_m, box["size"])
    np.testing.assert_allclose(ours.corners_m, box["corners"], rtol=0, atol=1e-7)


@pytest.fixture(scope="module")
def pairs(dataset, theirs):
    """(our sample, their sample)"""
    return [(dataset.sample(sample["token"]), sample) for scene in theirs for sample in scene["samples"]]


@pytest.fixture(scope="module")
def readings(pairs):
    """(our sample, channel, their reading)"""
    return [(ours, name, one) for ours, sample in pairs for name, one in sample["readings"].items()]


@pytest.mark.devkit
class TestAgainstTheDevkit:
    def test_scenes_and_samples(self, dataset, theirs):
        assert [(scene.name, scene.description) for scene in dataset.scenes] == [
            (scene["name"], scene["description"]) for scene in theirs
        ]
        ours = [[(sample.token, sample.stamp_ns) for sample in scene] for scene in dataset.scenes]
        assert ours == [[(s["token"], 1000 * s["stamp_us"]) for s in scene["samples"]] for scene in theirs]

    def test_channels_files_and_times(self, pairs, readings):
        for ours, sample in pairs:
            assert set(ours.channels) == set(sample["readings"]) == set(CHANNELS)
        for ours, channel, reading in readings:
            found = ours.readings[channel]
            assert (str(found.path), found.stamp_ns) == (reading["path"], 1000 * reading["stamp_us"])
            assert found.modality == reading["modality"]

    def test_poses_and_calibration(self, readings):
        for ours, channel, reading in readings:
            for name in ("global_SE3_ego", "ego_SE3_sensor"):
                matrix = getattr(ours, name)(channel)
                assert (matrix.dtype, matrix.shape) == (np.float64, (4, 4))
                np.testing.assert_allclose(matrix, reading[name], rtol=0, atol=1e-12)
            if "intrinsics" in reading:
                np.testing.assert_array_equal(ours.intrinsics(channel), reading["intrinsics"])

    def test_images_pixel_by_pixel(self, readings):
        for ours, channel, reading in readings:
            if "image" in reading:
                image = ours.image(channel)
                assert (image.dtype, image.shape) == (np.uint8, reading["image"].shape)
                np.testing.assert_array_equal(image, reading["image"])

    def test_images_with_an_older_opencv(self, readings, monkeypatch):
        monkeypatch.delattr(cv2, "IMREAD_COLOR_RGB", raising=False)
        for ours, channel, reading in readings[:5]:
            if "image" in reading:
                np.testing.assert_array_equal(ours.image(channel), reading["image"])

    def test_points_in_each_frame(self, readings):
        for ours, channel, reading in readings:
            if "points" in reading:
                points = ours.points(channel)
                columns = reading["points"].shape[1]  # the devkit drops the ring
                assert (points.dtype, points.shape[1]) == (np.float32, 5 if channel == "LIDAR_TOP" else 18)
                np.testing.assert_array_equal(points[:, :columns], reading["points"])
                # The devkit rounds to float32 after each step.
                np.testing.assert_allclose(points.in_ego()[:, :3], reading["in_ego"], rtol=1e-6, atol=2e-5)
                np.testing.assert_allclose(
                    points.in_global()[:, :3], reading["in_global"], rtol=1e-6, atol=5e-5
                )

    def test_what_was_read_before(self, readings):
        between = 0
        for ours, channel, reading in readings:
            found = ours.sweeps(channel, 1000)
            assert len(found) == len(reading["before"])
            assert [sweep.stamp_ns for sweep in ours.sweeps(channel, 3)] == [
                1000 * other["stamp_us"] for other in reading["before"][:3]
            ]
            for sweep, other in zip(found, reading["before"], strict=True):
                assert (sweep.channel, sweep.reading.modality) == (channel, other["modality"])
                assert str(sweep.reading.path) == other["path"]
                assert sweep.stamp_ns == 1000 * other["stamp_us"] < ours.readings[channel].stamp_ns
                np.testing.assert_allclose(
                    sweep.global_SE3_ego(), other["global_SE3_ego"], rtol=0, atol=1e-12
                )
                np.testing.assert_allclose(
                    sweep.ego_SE3_sensor(), other["ego_SE3_sensor"], rtol=0, atol=1e-12
                )
                between += not other["is_key_frame"]
        assert between > 100, "else the test says nothing"

    def test_boxes_in_the_global_frame(self, pairs):
        assert sum(len(ours.boxes) for ours, _ in pairs) > 100
        for ours, sample in pairs:
            for box, other in zip(ours.boxes, sample["boxes"], strict=True):
                assert_same_box(box, other)

    def test_boxes_in_each_camera(self, readings):
        seen = 0
        for ours, channel, reading in readings:
            if "boxes" in reading:
                for box, other in zip(ours.boxes.in_camera(channel), reading["boxes"], strict=True):
                    assert_same_box(box, other)
                visible = ours.boxes.in_camera(channel, visible_only=True)
                assert [box.token for box in visible] == reading["in_view"]
                seen += len(visible)
        assert seen > 50


class TestAgainstTheTruth:
    def test_a_lidar_point_lies_on_the_parked_car_that_the_world_has_there(self, project, dataset):
        _, truth = project
        sample = dataset[2]
        most = max(
            sample.boxes, key=lambda box: box.num_lidar_pts if "vehicle.parked" in box.attributes else 0
        )
        true = min(
            truth.boxes(sample.stamp_ns),
            key=lambda box: np.linalg.norm(most.center_m - box.odom_SE3_box.translation),
        )
        odom_SE3_box, size = true.odom_SE3_box, true.size_m
        odom = sample.points("LIDAR_TOP").in_global()[:, :3].astype(np.float64)
        local = np.abs(odom_SE3_box.inverse().transform_points(odom))
        half = np.array([size[1], size[0], size[2]]) / 2
        on_it = local[(local <= half + 0.05).all(axis=1)]
        assert len(on_it) > 20
        # At least one of the three coordinates is on a face.
        assert np.median(np.abs(on_it - half).min(axis=1)) < 0.05

    def test_boxes_are_where_the_objects_are(self, project, dataset):
        _, truth = project
        for sample in dataset:
            centres = np.array([box.odom_SE3_box.translation for box in truth.boxes(sample.stamp_ns)])
            for box in sample.boxes:
                assert np.linalg.norm(centres - box.center_m, axis=1).min() < 0.02

    def test_the_ego_pose_is_that_of_the_reading_and_not_of_the_sample(self, project, dataset):
        _, truth = project
        moved = 0
        for channel in CHANNELS:
            sample = dataset[3]
            stamp_ns = sample.readings[channel].stamp_ns
            moved += stamp_ns != sample.stamp_ns
            true = truth.odom_SE3_ego(stamp_ns).matrix
            np.testing.assert_allclose(sample.global_SE3_ego(channel), true, atol=1e-3)
        assert moved, "else the test says nothing"


class TestSweeps:
    def test_they_are_decoded_as_samples_are(self, dataset):
        last = dataset.scenes[0][-1]
        for channel in CHANNELS:
            sweeps = last.sweeps(channel, 1000)
            keyframes = {sample.readings[channel].path: sample for sample in dataset.scenes[0]}
            same = [
                (sweep, keyframes[sweep.reading.path]) for sweep in sweeps if sweep.reading.path in keyframes
            ]
            assert len(same) == len(dataset.scenes[0]) - 1
            assert len(sweeps) > len(same) or channel in CAMERAS
            for sweep, sample in same:
                if channel in CAMERAS:
                    np.testing.assert_array_equal(sweep.image(), sample.image(channel))
                    np.testing.assert_array_equal(sweep.intrinsics(), sample.intrinsics(channel))
                else:
                    points, expected = sweep.points(), sample.points(channel)
                    np.testing.assert_array_equal(points, expected)
                    np.testing.assert_array_equal(points.in_global(), expected.in_global())

    def test_points_between_samples_lie_on_what_stands_still(self, project, dataset):
        """In the global frame, those of ten sweeps are as near the ground as those of the sample."""
        sample = dataset.scenes[0][3]
        heights = []
        for points in (sample.points("LIDAR_TOP"), *(s.points() for s in sample.sweeps("LIDAR_TOP", 10))):
            placed = np.asarray(points.in_global())
            assert len(placed) > 1000
            heights.append(np.percentile(placed[:, 2], 10))
        assert len(heights) == 11
        assert np.ptp(heights) < 0.05

    def test_they_travel_to_other_processes(self, dataset):
        sweep = dataset[4].sweeps("LIDAR_TOP", 5)[3]
        sent = pickle.dumps(sweep)
        assert len(sent) < 1000
        other = pickle.loads(sent)
        assert (other.channel, other.stamp_ns, other.reading.path) == (
            sweep.channel, sweep.stamp_ns, sweep.reading.path,
        )  # fmt: skip
        np.testing.assert_array_equal(other.points(), sweep.points())

    def test_tables_are_read_once_for_each_channel_and_not_before(self, project, monkeypatch):
        opened = bagassets.open_dataset(project[0].nuscenes.output)
        read = []
        rows = TableFolder.rows
        monkeypatch.setattr(TableFolder, "rows", lambda self, name: [read.append(name), rows(self, name)][1])
        sample = opened.scenes[0][0]
        assert sample.sweeps("LIDAR_TOP", 5) == [], "nothing is before the first one"
        assert read.count("sample_data.json") == 1
        for sample in opened.scenes[0][2:]:
            assert [len(sample.sweeps("LIDAR_TOP", number)) for number in (0, 1, 3)] == [0, 1, 3]
        assert (read.count("sample_data.json"), read.count("ego_pose.json")) == (2, 1)

    def test_what_is_not_there_is_said(self, dataset):
        with pytest.raises(KeyError, match="LIDAR_REAR: this sample has no such channel; there is CAM_FRONT"):
            dataset[2].sweeps("LIDAR_REAR", 5)
        with pytest.raises(KeyError, match="no such camera; there is none"):
            dataset[2].sweeps("LIDAR_TOP", 1)[0].image()
        with pytest.raises(KeyError, match="no such lidar or radar; there is none"):
            dataset[2].sweeps("CAM_FRONT", 1)[0].points()
        assert repr(dataset[2].sweeps("LIDAR_TOP", 1)[0]).startswith("<Sweep of LIDAR_TOP at ")


def test_a_camera_without_intrinsics_says_so_and_has_all_the_rest(project, tmp_path):
    folder = shutil.copytree(project[0].nuscenes.output, tmp_path / "dataset")
    (file,) = folder.glob("*/calibrated_sensor.json")
    rows = json.loads(file.read_text())
    file.unlink()
    file.write_text(json.dumps([{**row, "camera_intrinsic": []} for row in rows]))
    sample = bagassets.open_dataset(folder)[2]
    assert len(sample.boxes.in_camera("CAM_FRONT")) == len(sample.boxes) > 0
    assert sample.image("CAM_FRONT").size
    for asked in (
        lambda: sample.intrinsics("CAM_FRONT"),
        lambda: sample.boxes.in_camera("CAM_FRONT", visible_only=True),
        sample.sweeps("CAM_FRONT", 1)[0].intrinsics,
    ):
        with pytest.raises(DatasetError, match=r"CAM_FRONT has no intrinsics .* `intrinsics` in the recipe"):
            asked()


class TestPoints:
    def test_rows_and_copies_know_their_frame(self, dataset):
        points = dataset[0].points("LIDAR_TOP")
        near = points[np.linalg.norm(points[:, :2], axis=1) < 20]
        assert 0 < len(near) < len(points)
        keep = np.linalg.norm(np.asarray(points)[:, :2], axis=1) < 20
        np.testing.assert_array_equal(near.in_global(), points.in_global()[keep])
        for other in (points.copy(), pickle.loads(pickle.dumps(points))):
            np.testing.assert_array_equal(other.in_ego(), points.in_ego())
        assert points.fields == ("x", "y", "z", "intensity", "ring")
        assert type(points.in_ego()) is np.ndarray
        np.testing.assert_array_equal(points.in_ego()[:, 3:], points[:, 3:])

    def test_columns_alone_have_no_frame(self, dataset):
        with pytest.raises(
            ValueError, match=r"5 columns \(x, y, z, intensity, ring\), got an array of shape"
        ):
            dataset[0].points("LIDAR_TOP")[:, 1:4].in_ego()

    def test_they_can_be_changed_without_touching_the_file(self, dataset):
        points = dataset[0].points("LIDAR_TOP")
        points[:] = 0
        assert dataset[0].points("LIDAR_TOP").any()


class TestImages:
    @pytest.mark.parametrize("shape", [(6, 4, 3), (6, 4)])
    @pytest.mark.parametrize("extension", [".png", ".jpg"])
    def test_they_are_rgb_whatever_the_file(self, project, shape, extension, tmp_path):
        """Red stays red; grey images have three equal channels."""
        sample = bagassets.open_dataset(project[0].nuscenes.output)[0]
        image = np.zeros(shape, np.uint8)
        image[..., 2:] = 200
        path = tmp_path / f"image{extension}"
        cv2.imwrite(str(path), image)
        vars(sample)["readings"] = {"CAM_FRONT": replace(sample.readings["CAM_FRONT"], path=path)}
        found = sample.image("CAM_FRONT")
        assert found.shape == (6, 4, 3)
        expected = image[..., ::-1] if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        assert np.abs(found.astype(int) - expected).max() <= (0 if extension == ".png" else 60)


class TestNames:
    def test_unknown_names_say_what_is_there(self, dataset):
        sample = dataset[0]
        for ask in (sample.image, sample.intrinsics, sample.boxes.in_camera):
            with pytest.raises(
                KeyError, match="CAM_REAR: this sample has no such camera; there is CAM_FRONT, CAM_"
            ):
                ask("CAM_REAR")
        with pytest.raises(KeyError, match="no such camera; there is CAM_FRONT"):
            sample.image("LIDAR_TOP")
        with pytest.raises(KeyError, match="no such lidar or radar; there is LIDAR_TOP, RADAR_FRONT"):
            sample.points("CAM_FRONT")
        for ask in (sample.global_SE3_ego, sample.ego_SE3_sensor):
            with pytest.raises(KeyError, match=r"there is CAM_FRONT, .*, LIDAR_TOP, RADAR_FRONT"):
                ask("lidar")
        with pytest.raises(KeyError, match=r"there is drive.bag_000"):
            dataset.scene("monday")
        with pytest.raises(KeyError, match="no sample 0123"):
            dataset.sample("0123")

    def test_a_dataset_is_a_sequence(self, dataset):
        assert len(dataset) == sum(len(scene) for scene in dataset.scenes) > 5
        assert [sample.token for sample in dataset] == [dataset[i].token for i in range(len(dataset))]
        assert dataset[-1].token == dataset.scenes[-1][-1].token == dataset[len(dataset) - 1].token
        assert [sample.index for sample in dataset[1:3]] == [1, 2]
        for samples in (dataset, dataset.scenes[0]):
            with pytest.raises(IndexError, match=rf"there is no sample {len(samples)} in <"):
                samples[len(samples)]
        assert dataset.channels == CHANNELS
        assert set(dataset.splits) == {"custom_train", "custom_val"}
        assert dataset.scene(dataset.splits["custom_val"][0])[0].token in {sample.token for sample in dataset}

    def test_they_are_shown_in_a_line(self, dataset):
        assert "2 scenes, 12 samples, CAM_FRONT, " in repr(dataset)
        assert repr(dataset.scenes[0]) == "<Scene drive.bag_000: 6 samples>"
        assert repr(dataset[0]).startswith("<Sample 0 at ")
        assert "boxes in global: human.pedestrian.adult, vehicle.car" in repr(dataset[0].boxes)


def facts_of(sample):
    """What a training would take of a sample: works in any process."""
    points = sample.points("LIDAR_TOP")
    return (
        sample.index, int(sample.image("CAM_FRONT").sum()), float(points.in_global().sum(dtype=np.float64)),
        [box.token for box in sample.boxes.in_camera("CAM_FRONT", visible_only=True)],
    )  # fmt: skip


def fetch(dataset, numbers):
    """As a worker of a DataLoader: items by number, put together in the worker."""
    return os.getpid(), [facts_of(dataset[number]) for number in numbers]


def work(dataset, tasks, results):
    while (numbers := tasks.get()) is not None:
        results.put(fetch(dataset, numbers))


def reading(sample):
    return sample.readings["CAM_FRONT"]


class TestWorkers:
    """A PyTorch DataLoader gives the dataset to each of its processes once, then sends them numbers."""

    @pytest.mark.once
    @pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
    @pytest.mark.parametrize("used_before", [False, True])
    def test_several_processes_read_the_same(self, project, method, used_before):
        dataset = bagassets.open_dataset(project[0].nuscenes.output)
        expected = [facts_of(sample) for sample in dataset]
        if not used_before:
            dataset = bagassets.open_dataset(project[0].nuscenes.output)
        context = multiprocessing.get_context(method)
        tasks, results = context.Queue(), context.Queue()
        workers = [
            context.Process(target=work, args=(dataset, tasks, results), daemon=True) for _ in range(3)
        ]
        for worker in workers:
            worker.start()
        batches = [range(i, min(i + 2, len(dataset))) for i in range(0, len(dataset), 2)]
        for batch in batches:
            tasks.put(list(batch))
        found = [results.get(timeout=120) for _ in batches]
        for _ in workers:
            tasks.put(None)
        for worker in workers:
            worker.join(120)
            assert worker.exitcode == 0
        assert os.getpid() not in {pid for pid, _ in found}
        assert sorted(facts for _, batch in found for facts in batch) == expected

    def test_samples_and_scenes_travel_too(self, dataset):
        sample, scene = pickle.loads(pickle.dumps((dataset[3], dataset.scenes[1])))
        assert facts_of(sample) == facts_of(dataset[3])
        assert [one.token for one in scene] == [one.token for one in dataset.scenes[1]]
        ours = bagassets.open_dataset(dataset.path)
        assert pickle.loads(pickle.dumps(ours))._source is ours._source, "opened once in a process"
        assert len(pickle.dumps(dataset[3])) < 1000

    def test_threads_read_the_same(self, project):
        dataset = bagassets.open_dataset(project[0].nuscenes.output)
        found = []
        threads = [
            threading.Thread(target=lambda: found.append([facts_of(s) for s in dataset])) for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert found == [[facts_of(sample) for sample in dataset]] * 4


def facts_in_order(samples):
    return [facts_of(sample) for sample in samples]


class TestAhead:
    """Iterating decodes what comes next in threads: the same values, and nothing that the caller does not read."""

    @pytest.fixture
    def decoded(self, monkeypatch):
        """(file, whether the caller's thread read it), of all images; threads may begin two in either order."""
        found = []

        def read(folder, reading):
            found.append((reading.path, threading.current_thread() is threading.main_thread()))
            return read_image(folder, reading)

        monkeypatch.setattr("bagassets.formats.reader.dataset.read_image", read)
        return found

    def test_the_same_values_each_decoded_once(self, dataset, decoded):
        for sample in dataset:
            np.testing.assert_array_equal(
                sample.image("CAM_FRONT"), read_image(sample._source.folder, reading(sample))
            )
        first, *others = [reading(sample).path for sample in dataset]
        assert decoded[0] == (first, True)
        assert sorted(decoded[1:]) == sorted((path, False) for path in others)

    def test_only_what_was_read_of_the_one_before(self, dataset, decoded):
        for number, sample in enumerate(dataset):
            if number == 0:
                sample.image("CAM_FRONT_LEFT")
        assert sorted(path for path, _ in decoded) == sorted(
            dataset[number].readings["CAM_FRONT_LEFT"].path for number in range(3)
        )

    def test_what_is_handed_out_belongs_to_the_caller(self, dataset):
        for sample in dataset:
            first, points = sample.image("CAM_FRONT"), sample.points("LIDAR_TOP")
            expected = first.copy(), points.copy()
            first[:], points[:] = 0, 0
            np.testing.assert_array_equal(sample.image("CAM_FRONT"), expected[0])
            np.testing.assert_array_equal(sample.points("LIDAR_TOP"), expected[1])

    def test_a_damaged_file_is_an_error_where_it_is_asked_for(self, project, tmp_path):
        shutil.copytree(project[0].nuscenes.output, tmp_path / "dataset")
        dataset = bagassets.open_dataset(tmp_path / "dataset")
        broken = reading(dataset[2]).path
        broken.unlink()
        broken.write_bytes(b"no image")
        found = []
        for sample in dataset:
            try:
                sample.image("CAM_FRONT")
            except DatasetError as err:
                found.append((sample.index, str(err).partition(":")[0]))
        assert found == [(2, str(broken))]
        for sample in dataset:  # what was decoded ahead and is not asked for is no error
            if sample.index < 2:
                sample.image("CAM_FRONT")

    @pytest.mark.parametrize("opencv", ["older", "newer"])
    def test_depth_of_16_bits_is_as_written(self, project, tmp_path, monkeypatch, opencv):
        if opencv == "older":
            monkeypatch.delattr(cv2, "IMREAD_COLOR_RGB", raising=False)
        shutil.copytree(project[0].nuscenes.output, tmp_path / "dataset")
        sample = bagassets.open_dataset(tmp_path / "dataset")[0]
        depth_mm = np.array([[100, 300, 0], [2000, 40000, 65535]], np.uint16)
        path = reading(sample).path
        path.unlink()
        path.write_bytes(cv2.imencode(".png", depth_mm)[1].tobytes())
        assert sample.image("CAM_FRONT").dtype == np.uint16
        np.testing.assert_array_equal(sample.image("CAM_FRONT"), depth_mm)

    @pytest.mark.once
    def test_a_fork_in_the_loop_reads_on(self, dataset, monkeypatch):
        def slowly(folder, one):
            if one.path == reading(dataset[4]).path:
                time.sleep(1)  # a thread is at work when the process is forked
            return read_image(folder, one)

        monkeypatch.setattr("bagassets.formats.reader.dataset.read_image", slowly)
        samples = iter(dataset)
        before = [facts_of(next(samples)) for _ in range(3)]
        current = next(samples)
        context = multiprocessing.get_context("fork")
        results = context.Queue()
        child = context.Process(target=lambda: results.put(facts_in_order([current, *samples])), daemon=True)
        child.start()
        assert before + results.get(timeout=120) == [facts_of(dataset[i]) for i in range(len(dataset))]
        child.join(120)
        assert child.exitcode == 0
        assert before + facts_in_order([current, *samples]) == facts_in_order(dataset)


IMPORTS = """
import sys, {module}
print(sorted(name.partition(".")[0] for name in sys.modules))
"""


class TestStart:
    def modules(self, code, *arguments):
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, check=True
        )
        return set(done.stdout.split())

    def test_the_package_imports_nothing(self):
        names = self.modules("import sys, bagassets; dir(bagassets); print(*sys.modules)")
        assert [name for name in names if name.startswith("bagassets.")] == []
        assert not names & {"numpy", "dagster", "cv2"}

    def test_opening_needs_numpy_and_little_else(self, project):
        code = "import sys, bagassets; len(bagassets.open_dataset(sys.argv[1])); print(*sys.modules)"
        names = {name.partition(".")[0] for name in self.modules(code, project[0].nuscenes.output)}
        assert "numpy" in names
        assert not names & {"dagster", "cv2", "nuscenes", "pydantic", "yaml", "click", "pyarrow", "rosbags"}


@pytest.fixture(scope="module")
def sequences(project):
    return bagassets.open_dataset(project[0].vision.output)


class TestVision:
    def test_sequences_are_scenes(self, sequences):
        assert sequences.channels == CAMERAS
        names = [scene.name for scene in sequences.scenes]
        assert "drive.bag/CAM_FRONT/0000" in names
        assert all(len(scene) == 5 for scene in sequences.scenes)
        assert set(sequences.splits) == {"train", "val"}
        assert sorted(name for scenes in sequences.splits.values() for name in scenes) == sorted(names)

    def test_poses_are_true_relative_to_the_first_image(self, project, sequences):
        _, truth = project
        for scene in sequences.scenes:
            (channel,) = scene[0].channels
            first = truth.odom_SE3_ego(scene[0].stamp_ns).inverse()
            for sample in scene:
                true = (first @ truth.odom_SE3_ego(sample.stamp_ns)).matrix
                np.testing.assert_allclose(sample.global_SE3_ego(channel), true, atol=2e-3)
                mounted = truth.ego_SE3_sensor(channel).matrix
                np.testing.assert_allclose(sample.ego_SE3_sensor(channel), mounted, atol=1e-6)

    def test_images_are_those_of_the_other_dataset(self, sequences, dataset):
        keyframes = {
            (sample.readings[name].stamp_ns // 1000, name): sample for sample in dataset.scenes[0] for name in CAMERAS
        }  # fmt: skip
        compared = 0
        for scene in sequences.scenes:
            for sample in scene if scene.name.startswith("drive.bag/") else ():
                (channel,) = sample.channels
                same = keyframes.get((sample.stamp_ns // 1000, channel))
                if same is not None:
                    np.testing.assert_array_equal(sample.image(channel), same.image(channel))
                    np.testing.assert_allclose(
                        sample.intrinsics(channel), same.intrinsics(channel), atol=1e-3
                    )
                    compared += 1
        assert compared > 5

    def test_what_it_has_not_is_said(self, sequences):
        with pytest.raises(KeyError, match="no such lidar or radar; there is none"):
            sequences[0].points("LIDAR_TOP")
        assert len(sequences[0].boxes) == 0
        assert sequences[4].sweeps(*sequences[4].channels, 5) == [], "every image is a sample"
        assert pickle.loads(pickle.dumps(sequences[4])).token == sequences[4].token
