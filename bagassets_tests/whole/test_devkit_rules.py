"""What the devkit needs of a dataset: each rule passes ours, and names the first offender of one that is broken."""

import copy
import json

import pytest
from handmade import Drive, make_tables

from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.dataset_rows import DatasetRows, read_dataset
from bagassets.formats.nuscenes.devkit_rules import devkit_ready
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.store.store import Store

VERSION = "v1.0-test"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    store = Store(folder / "store")
    tables = make_tables(store, Drive(seconds=3.0)).artifact
    assemble(
        NUSCENES, [Part("drive_1", "c", tables.digest)], NuScenes(version=VERSION), store, folder / "nuscenes"
    )
    return folder / "nuscenes", read_dataset(folder / "nuscenes", VERSION).tables


def find_in(root, tables):
    scenes = frozenset(row["name"] for row in tables["scene"])
    return devkit_ready(DatasetRows(root, VERSION, tables, scenes, 1, 1))


class TestDevkit:
    def test_our_datasets_pass(self, dataset):
        root, tables = dataset
        finding = find_in(root, tables)
        assert finding.problems == []
        assert finding.facts == {
            "scenes": 1,
            "samples_without_LIDAR_TOP": 0,
            "samples_lacking_a_channel": 0,
        }

    def test_the_clock_of_a_simulator_may_start_at_zero(self, dataset):
        root, tables = dataset
        early = copy.deepcopy(tables)
        rows = [row for name in ("sample", "sample_data", "ego_pose") for row in early[name]]
        first = min(row["timestamp"] for row in rows)
        for row in rows:
            row["timestamp"] += 1_200_000 - first
        assert find_in(root, early).problems == []

    def test_samples_that_lack_a_channel_of_their_rig_are_a_warning(self, dataset):
        root, tables = dataset
        cameras = {row["token"] for row in tables["sensor"] if row["channel"] == "CAM_FRONT"}
        mounted = {r["token"] for r in tables["calibrated_sensor"] if r["sensor_token"] in cameras}
        late = {row["token"] for row in tables["sample"][:2]}
        rest = [
            row
            for row in tables["sample_data"]
            if row["calibrated_sensor_token"] not in mounted or row["sample_token"] not in late
        ]
        finding = find_in(root, {**tables, "sample_data": rest})
        (sentence,) = finding.warnings
        samples = len(tables["sample"])
        assert sentence.startswith(
            f"2 of {samples} samples lack a channel that other samples of the same rig have"
        )
        assert f"CAM_FRONT in 2; the first is sample {tables['sample'][0]['token']}" in sentence
        assert finding.facts["samples_lacking_a_channel"] == 2
        assert (finding.problems, finding.passed, finding.weight("error")) == ([], False, "warn")

    @pytest.mark.parametrize(
        ("table", "column", "value", "words"),
        [
            ("sample_data", "fileformat", ".jpg", "fileformat is not jpg, png or pcd"),
            (
                "sample_data",
                "filename",
                "samples/CAM_FRONT/a.gif",
                "does not end as the devkit's readers expect",
            ),
            (
                "sample",
                "timestamp",
                1_700_000_000_000_000_000,
                "sample.timestamp is not an integer in microseconds",
            ),
            ("ego_pose", "timestamp", 1.7e15, "ego_pose.timestamp is not an integer in microseconds"),
            ("ego_pose", "rotation", [1.0, 1.0, 0.0, 0.0], "ego_pose.rotation is not a unit quaternion"),
            ("ego_pose", "translation", [690_000.0, 5_330_000.0, 500.0], "too far from the origin"),
            (
                "calibrated_sensor",
                "camera_intrinsic",
                [[1.0, 0.0], [0.0, 1.0]],
                "camera_intrinsic is not 3x3",
            ),
            ("sample_annotation", "size", [2.0, 0.0, 1.5], "sample_annotation.size is not positive"),
            ("sample_annotation", "attribute_tokens", ["a", "b"], "more than one attribute"),
        ],
    )
    def test_what_the_devkit_trips_over_is_named(self, dataset, table, column, value, words):
        root, tables = dataset
        broken = copy.deepcopy(tables)
        row = broken[table][1]
        row[column] = value
        problems = find_in(root, broken).problems
        assert any(words in problem for problem in problems)
        assert any(str(row["token"]) in problem or str(value) in problem for problem in problems)

    def test_samples_that_the_evaluation_cannot_use_are_counted(self, dataset):
        root, tables = dataset
        broken = copy.deepcopy(tables)
        gone = next(
            row
            for row in broken["sample_data"]
            if row["is_key_frame"] and row["filename"].endswith(".pcd.bin")
        )
        broken["sample_data"].remove(gone)
        assert find_in(root, broken).facts["samples_without_LIDAR_TOP"] == 1

    def test_a_map_that_is_no_png_or_missing_is_named(self, dataset, tmp_path):
        root, tables = dataset
        assert any("no row" in text for text in find_in(root, {**tables, "map": []}).problems)
        other = tmp_path / "map.png"
        row = {**tables["map"][0], "filename": str(other)}
        assert any("cannot be read" in t for t in find_in(root, {**tables, "map": [row]}).problems)
        other.write_bytes(b"GIF89a")
        assert any("is not a PNG" in t for t in find_in(root, {**tables, "map": [row]}).problems)

    @pytest.mark.parametrize(
        ("splits", "words"),
        [
            ({"custom_train": ["nowhere"]}, "names scene nowhere, which does not exist"),
            ({"train": ["drive_1_000"]}, "answers split train with the scenes of nuScenes"),
            ({"a": ["drive_1_000"], "b": ["drive_1_000"]}, "scene drive_1_000 is in the splits a and b"),
        ],
    )
    def test_splits_must_name_scenes_once(self, dataset, splits, words):
        root, tables = dataset
        path = root / VERSION / "splits.json"
        before = path.read_bytes()
        try:
            path.write_text(json.dumps(splits))
            assert any(words in problem for problem in find_in(root, tables).problems)
        finally:
            path.write_bytes(before)

    def test_point_files_of_another_layout_are_named(self, dataset):
        root, tables = dataset
        lidar = next(row["filename"] for row in tables["sample_data"] if row["filename"].endswith(".pcd.bin"))
        radar = next(row["filename"] for row in tables["sample_data"] if row["filename"].endswith(".pcd"))
        for name, damage, words in (
            (lidar, lambda data: data + b"1234", "does not hold points of 5 float32"),
            (radar, lambda data: data[:-1], "the devkit's reader requires more"),
            (radar, lambda data: data.replace(b"DATA binary", b"DATA ascii!"), "is not a binary PCD file"),
            (radar, lambda data: data.replace(b" vy_rms\n", b"\n"), "has 17 fields"),
            (radar, lambda data: data.replace(b"WIDTH 12", b"WIDTH 0"), "has no points at all"),
        ):
            before = (root / name).read_bytes()
            try:
                # A new file: the old one is a hard link into the store.
                (root / name).unlink()
                (root / name).write_bytes(damage(before))
                problems = find_in(root, tables).problems
                assert any(words in problem and name in problem for problem in problems), words
            finally:
                (root / name).unlink()
                (root / name).write_bytes(before)
