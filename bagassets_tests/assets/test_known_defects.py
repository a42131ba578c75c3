"""The defects seen in other exporters (section 5 of the design), each with a test that would catch it.

===================================================  ==========================================================
defect                                               test
===================================================  ==========================================================
`is_key_frame` as the strings "true" and "false"     test_is_key_frame_is_no_string
column, ring and return packed into the fifth float  test_the_fifth_column_of_lidar_files_is_the_ring…
`fileformat` ".jpg"                                  test_fileformat_has_no_dot
location always "boston-seaport"                     test_location_is_what_the_recipe_says
map file name ""                                     test_the_map_is_a_file
always 40 equidistant keyframes                      test_keyframes_follow_the_length_of_the_scene,
                                                     test_keyframes_are_readings_not_an_even_grid
nearest instead of interpolated pose                 test_poses_are_interpolated_to_the_time_of_each_reading
a 0.2 s header gap aborts the scene                  test_a_short_gap_does_not_abort_a_scene
random tokens that must be rewritten at merge        test_tokens_are_not_rewritten_when_datasets_are_merged,
                                                     test_tokens_are_the_same_on_every_build
stamps scaled by the wrong power of ten              test_stamps_are_microseconds
errors printed, exit status 0, success recorded      test_a_step_that_fails_is_never_recorded_as_done,
                                                     test_a_build_with_a_damaged_recording_exits_with_1…
a whole scene decoded into memory                    test_images_are_not_held_in_memory,
                                                     test_clouds_are_not_held_in_memory
CameraInfo.R applied to images, not to extrinsics    test_rectification_rotates_neither_images_nor_sensors
===================================================  ==========================================================

Most run on the tables of a drive made by hand, and on the writers. `test_sample_truth` holds whole
datasets against the truth of a world, which would notice several of them too.
"""

import json
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace as Msg

import numpy as np
import pytest
from click.testing import CliRunner
from dagster import AssetKey, DagsterInstance
from handmade import T0, Drive, S, ego_pose, make_tables, regular, trajectory

from bagassets.assets.calibration import CALIBRATION, make_calibration
from bagassets.assets.frames import FRAMES, FrameExtractor
from bagassets.assets.image_output import ImageOutput, intrinsic_matrix
from bagassets.assets.lidar_file import lidar_bytes, read_lidar_file
from bagassets.base.errors import PoseError
from bagassets.cli.main import root
from bagassets.decode.model import ImageReading
from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.tables import NUSCENES_TABLES
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Rig
from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.store import Store
from bagassets_tests.cameras import camera_use
from bagassets_tests.facts import MadeUpFacts, use_of
from bagassets_tests.in_process import make_project
from bagassets_tests.pose_data import (
    CAMERA_INFO,
    IMAGE,
    TFMESSAGE,
    Recorded,
    Written,
    camera_info,
    tf,
    transform,
)
from bagassets_tests.sweep_data import cloud, raw
from bagassets_tests.sweep_run import CLOUD, PERIOD_NS, START_NS, Run, lidar, request

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def made(store):
    return make_tables(store)


@pytest.fixture(scope="module")
def dataset(store, made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    return assemble(NUSCENES, [Part("drive_1", "c", made.artifact.digest)], NuScenes(), store, folder).folder


def test_is_key_frame_is_no_string(dataset):
    text = (dataset / "sample_data.json").read_text()
    assert '"is_key_frame":true' in text
    assert '"is_key_frame":false' in text
    assert all(type(row["is_key_frame"]) is bool for row in json.loads(text))


def test_the_fifth_column_of_lidar_files_is_the_ring_and_nothing_else(tmp_path):
    rings = np.arange(128, dtype=np.float32)
    points = np.column_stack([np.ones((128, 3)), np.full(128, 7.0), rings]).astype(np.float32)
    (tmp_path / "cloud.pcd.bin").write_bytes(lidar_bytes(points))
    assert (tmp_path / "cloud.pcd.bin").stat().st_size == 128 * 5 * 4
    np.testing.assert_array_equal(read_lidar_file(tmp_path / "cloud.pcd.bin")[:, 4], rings)


def test_fileformat_has_no_dot(dataset):
    rows = json.loads((dataset / "sample_data.json").read_text())
    assert {row["fileformat"] for row in rows} == {"jpg", "pcd"}


def test_location_is_what_the_recipe_says(dataset):
    (log,) = json.loads((dataset / "log.json").read_text())
    assert log["location"] == "yard"


def test_the_map_is_a_file(dataset):
    (row,) = json.loads((dataset / "map.json").read_text())
    assert (dataset.parent / row["filename"]).is_file()
    assert (dataset.parent / row["filename"]).suffix == ".png"


@pytest.mark.parametrize(("seconds", "keyframes"), [(3.0, 6), (11.0, 22), (27.0, 54)])
def test_keyframes_follow_the_length_of_the_scene(store, seconds, keyframes):
    drive = Drive(seconds=seconds, channels=("LIDAR_TOP",), boxes=False)
    (scene,) = make_tables(store, drive, length_s=60.0).table("scene")
    assert scene["nbr_samples"] == keyframes


def test_keyframes_are_readings_not_an_even_grid(store):
    jitter = np.random.default_rng(3).integers(-S // 50, S // 50, 40)
    drive = Drive(channels=("LIDAR_TOP",), boxes=False, stamps={"LIDAR_TOP": regular(10, 4.0) + jitter})
    stamps = [row["timestamp"] for row in make_tables(store, drive).table("sample")]
    assert set(stamps) <= {int(stamp) // 1000 for stamp in drive.stamps["LIDAR_TOP"]}
    assert len(set(np.diff(stamps))) > 1


def test_poses_are_interpolated_to_the_time_of_each_reading(made):
    """The nearest pose, with 50 ms between poses and 5 m/s, would be up to 12 cm off."""
    for pose in made.table("ego_pose"):
        truth = ego_pose((pose["timestamp"] * 1000 - T0) / S)
        assert np.linalg.norm(np.subtract(pose["translation"], truth.translation)) < 1e-3


def test_a_short_gap_does_not_abort_a_scene(store):
    stamps = regular(10, 6.0)
    without = stamps[(stamps < T0 + 2.05 * S) | (stamps > T0 + 2.35 * S)]
    assert np.diff(without).max() > 0.2 * S
    drive = Drive(seconds=6.0, channels=("LIDAR_TOP",), stamps={"LIDAR_TOP": without}, boxes=False)
    (scene,) = make_tables(store, drive).table("scene")
    assert scene["nbr_samples"] == 12


def test_tokens_are_not_rewritten_when_datasets_are_merged(store, made, dataset, tmp_path):
    other = make_tables(store, Drive(seed=5), key="drive_2")
    parts = [Part("drive_1", "c", made.artifact.digest), Part("drive_2", "d", other.artifact.digest)]
    merged = assemble(NUSCENES, parts, NuScenes(), store, tmp_path).folder
    for name in ("scene", "sample", "sample_data", "ego_pose", "instance", "sample_annotation"):
        alone = json.loads((dataset / f"{name}.json").read_text())
        tokens = [row["token"] for row in json.loads((merged / f"{name}.json").read_text())]
        assert alone == made.table(name)
        assert {row["token"] for row in alone} <= set(tokens)
        assert len(set(tokens)) == len(tokens)


def test_tokens_are_the_same_on_every_build(tmp_path, made):
    again = make_tables(Store(tmp_path / "elsewhere"))
    assert [row["token"] for row in again.table("sample_data")] == [
        row["token"] for row in made.table("sample_data")
    ]


def test_stamps_are_microseconds(made):
    for table in ("sample", "sample_data", "ego_pose"):
        for row in made.table(table):
            assert type(row["timestamp"]) is int
            assert abs(row["timestamp"] - T0 // 1000) < 5_000_000


def test_a_step_that_fails_is_never_recorded_as_done(store):
    """An error is raised, recorded as a failure under the action, and leaves no artifact."""
    nowhere = Trajectory(np.array([S, 2 * S]), np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), S, 0)
    with pytest.raises(PoseError):
        make_tables(store, key="unlucky", poses=nowhere)
    use = make_tables(store, key="unlucky_not").use
    action = NUSCENES_TABLES.action(replace(use, params=replace(use.params, key="unlucky")), None)
    assert store.lookup(action) is None
    assert "has an ego pose" in (store.failure(action.digest) or "")


def test_readings_without_a_pose_are_dropped_and_counted_not_given_a_wrong_one(store):
    base = trajectory(Drive())
    late = base.stamps_ns > T0 + 2 * S
    cut = Trajectory(
        base.stamps_ns[late],
        base.positions_m[late],
        base.rotations[late],
        base.max_gap_ns,
        base.extrapolate_ns,
    )
    made = make_tables(store, key="late", poses=cut)
    counts = made.facts["counts"]["channels"]["LIDAR_TOP"]
    assert counts["without_pose"] == 20
    assert min(row["timestamp"] for row in made.table("sample")) >= (T0 + 2 * S) // 1000 - 1


def test_a_build_with_a_damaged_recording_exits_with_1_and_records_no_success(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, ["good.bag"])
    (tmp_path / "bags" / "damaged.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe))
    done = CliRunner().invoke(root, ["build", "--recipe", str(recipe), "--select", "ego_poses", "--json"])
    assert done.exit_code == 1
    with DagsterInstance.from_config(str(tmp_path / ".bagassets" / "dagster")) as instance:
        for asset in ("inventory", "ego_poses"):
            made = instance.get_materialized_partitions(AssetKey(asset))
            assert made == {"good.bag"}, asset


class Photos:
    """A recording of colour images, each made when it is decoded."""

    format = "mcap"
    topics = {"/cam": Msg(name="/cam", msgtype="sensor_msgs/msg/Image", count=0)}

    def decode(self, message):
        pixels = np.full((600, 800, 3), message.log_time_ns % 251, np.uint8)
        header = Msg(stamp=Msg(sec=message.log_time_ns, nanosec=0), frame_id="cam")
        return Msg(
            header=header,
            height=600,
            width=800,
            encoding="bgr8",
            is_bigendian=0,
            step=2400,
            data=pixels.reshape(-1),
        )


@pytest.mark.parametrize("workers", [0, 4])
def test_images_are_not_held_in_memory(tmp_path, workers):
    """150 images of 1.4 MB; an exporter that decodes the scene first needs 216 MB."""
    tracemalloc.start()
    with ThreadPoolExecutor(workers) if workers else nullcontext() as pool:
        extractor = FrameExtractor(camera_use(), Photos(), ArtifactWriter(tmp_path / "a"), pool)
        for i in range(1, 151):
            extractor.add(RawMessage("/cam", "sensor_msgs/msg/Image", i, b""))
        extractor.finish()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < (2 * workers + 4) * 2 * 1_440_000


def test_clouds_are_not_held_in_memory(tmp_path):
    """60 clouds of 40,000 points of 16 bytes: 38 MB."""

    def clouds():
        for i in range(60):
            stamp = START_NS + i * PERIOD_NS
            xyz = {axis: np.full(40_000, 1.0 + i, np.float32) for axis in "xyz"}
            yield raw(cloud(stamp, xyz), CLOUD, stamp)

    asked = request(lidar(), CLOUD, count=60)
    tracemalloc.start()
    made = Run(tmp_path, asked, clouds())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(made.index) == 60
    assert peak < 16_000_000


def test_rectification_rotates_neither_images_nor_sensors(tmp_path):
    """R and P describe a stereo pair; with R = identity the image belongs to the extrinsics in TF."""
    half = 0.1
    turned = np.array([[np.cos(half), 0, np.sin(half)], [0, 1, 0], [-np.sin(half), 0, np.cos(half)]])
    image = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    made = []
    for number, changes in enumerate(
        ({}, {"r": turned.reshape(-1), "p": np.array([300.0, 0, 310, -50, 0, 300, 230, 0, 0, 0, 1, 0])})
    ):
        message = camera_info(d=(-0.2, 0.05, 0.001, -0.001, 0.0), **changes)
        entries = [
            ("/cam/camera_info", CAMERA_INFO, T0, message),
            ("/cam/image_raw", IMAGE, T0, Msg(header=message.header)),
            ("/tf_static", TFMESSAGE, T0, tf(transform(0, "base_link", "cam", SE3((0.5, -0.5, 0.5, -0.5), (1, 0, 1))))),
        ]  # fmt: skip
        recorded = Recorded(*entries)
        channel = {"CAM_FRONT": {"modality": "camera", "topic": "/cam/image_raw"}}
        car = Rig.model_validate({"name": "car", "channels": channel, "ego_pose": {"source": "fixed"}})
        asked = use_of(CALIBRATION, car, MadeUpFacts(recorded.inventory()))
        written = Written(tmp_path / str(number), partial(make_calibration, asked.params, recorded))
        calibration = Calibration.from_json(written.artifact.read_json("calibration.json"))
        facts = MadeUpFacts(recorded.inventory(), calibration=calibration)
        output = ImageOutput(use_of(FRAMES, car, facts, "CAM_FRONT").params, None)
        data = bytes(output.make(ImageReading(1, "cam", image, None, "mono8")).data)
        made.append(
            (calibration.channels["CAM_FRONT"].ego_SE3_sensor, data, intrinsic_matrix(output.written))
        )
    assert made[0] == made[1]
    assert made[0][2] == [[400.0, 0.0, 320.0], [0.0, 410.0, 240.0], [0.0, 0.0, 1.0]]
