"""The defects seen in other exporters, each with a test that would catch it.

These run on the tables of a drive made by hand, and on the writers. Those about frames, whole
recordings and the command line are tested with them; see `test_end_to_end`.
"""

import json

import numpy as np
import pytest
from handmade import T0, Drive, S, ego_pose, make_tables, regular, trajectory

from bagassets.errors import PoseError
from bagassets.geometry.trajectory import Trajectory
from bagassets.nuscenes.dataset import BagPart, assemble
from bagassets.nuscenes.lidar_file import lidar_bytes, read_lidar_file
from bagassets.recipe.model import NuScenes
from bagassets.steps import nuscenes_tables
from bagassets.store.store import Store


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def made(store):
    return make_tables(store)


@pytest.fixture(scope="module")
def dataset(store, made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    return assemble([BagPart("drive_1", "c", made.artifact.digest)], NuScenes(), store, folder).folder


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
    parts = [BagPart("drive_1", "c", made.artifact.digest), BagPart("drive_2", "d", other.artifact.digest)]
    merged = assemble(parts, NuScenes(), store, tmp_path).folder
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
    params = make_tables(store, key="unlucky_not").request
    action = nuscenes_tables.STEP.action({**params.params, "key": "unlucky"}, params.inputs)
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
