"""By the command: a drive recorded as ROS 1, ROS 2 and MCAP gives the same tables and files but for its name."""

import json

import pytest

from bagassets.formats.nuscenes.schema import RECORDING_TABLES
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets_tests.in_process import QUICK, run_command
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

NAMES = {"ros1": "drive.bag", "ros2": "drive", "mcap": "drive.mcap"}


def build(folder):
    done = run_command("build", "--recipe", folder / "recipe.yaml", "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class Dataset:
    """The rows of a dataset, recording by recording, with what names the recording taken out."""

    def __init__(self, dataroot, version):
        self.root = dataroot
        self.tables = {
            path.stem: json.loads(path.read_bytes()) for path in (dataroot / version).glob("*.json")
        }
        self.shared = {
            row[
                "token"
            ]: f"{name} {row.get('name') or row.get('channel') or row.get('level') or row['filename']}"
            for name in ("sensor", "category", "attribute", "visibility", "map")
            for row in self.tables[name]
        }

    def recording(self, key):
        """Return table -> rows of one recording; tokens are replaced by table and place, the key by KEY."""
        rows = self._rows(key)
        labels = self.shared | {
            row["token"]: f"{table} {number}" for table in rows for number, row in enumerate(rows[table])
        }
        return {table: [self._plain(row, labels, key) for row in rows[table]] for table in rows}

    def _rows(self, key):
        log = [row for row in self.tables["log"] if row["logfile"] == key]
        scenes = self._of("scene", "log_token", log)
        samples = self._of("sample", "scene_token", scenes)
        data, boxes = (
            self._of(name, "sample_token", samples) for name in ("sample_data", "sample_annotation")
        )
        rows = {
            "log": log,
            "scene": scenes,
            "sample": samples,
            "sample_data": data,
            "sample_annotation": boxes,
        }
        for table, owner in (("ego_pose", data), ("calibrated_sensor", data), ("instance", boxes)):
            used = {row[f"{table}_token"] for row in owner}
            rows[table] = [row for row in self.tables[table] if row["token"] in used]
        assert rows.keys() == set(RECORDING_TABLES)
        return rows

    def _of(self, table, column, owners):
        tokens = {row["token"] for row in owners}
        return [row for row in self.tables[table] if row[column] in tokens]

    def _plain(self, value, labels, key):
        if isinstance(value, dict):
            return {name: self._plain(inner, labels, key) for name, inner in value.items()}
        if isinstance(value, list):
            return [self._plain(inner, labels, key) for inner in value]
        if isinstance(value, str):
            # With the separator that follows: `drive` is also the beginning of `drive.bag`.
            for end in ("-", "_"):
                value = value.replace(f"{key}{end}", f"KEY{end}")
            return "KEY" if value == key else labels.get(value, value)
        return value


def assert_equal(dataset, keys):
    first, *others = keys
    expected = dataset.recording(first)
    assert all(expected[table] for table in RECORDING_TABLES)
    for key in others:
        found = dataset.recording(key)
        for table in RECORDING_TABLES:
            assert found[table] == expected[table], (key, table)
        for row, same in zip(
            dataset._rows(key)["sample_data"], dataset._rows(first)["sample_data"], strict=True
        ):
            assert (dataset.root / row["filename"]).read_bytes() == (
                dataset.root / same["filename"]
            ).read_bytes()


def test_the_sample_drive_with_cameras_lidar_radar_and_boxes(tmp_path):
    targets = [Target(tmp_path / "recordings" / name, kind) for kind, name in NAMES.items()]
    write_recordings(targets, 5, "small", 2.4)
    (tmp_path / "recipe.yaml").write_text(
        sample_recipe().replace("settle_s: 2", "settle_s: 0") + "preview: {enabled: false}\n"
    )
    output = build(tmp_path)
    assert {name: one["result"] for name, one in output["recordings"].items()} == dict.fromkeys(
        sorted(NAMES.values()), "built"
    )
    assert_equal(Dataset(tmp_path / "nuscenes", "v1.0-sample"), list(NAMES.values()))


def test_a_drive_from_the_writers_of_each_format(tmp_path):
    for kind, name in NAMES.items():
        write_drive(tmp_path / "bags" / name, kind, duration_s=1.6)
    (tmp_path / "recipe.yaml").write_text(QUICK.format(name="formats", root="bags"))
    build(tmp_path)
    dataset = Dataset(tmp_path / "dataset" / "nuscenes", "v1.0-test")
    found = {name: dataset.recording(name) for name in NAMES.values()}
    assert len(found["drive"]["sample"]) >= 3
    assert found["drive"] == found["drive.bag"] == found["drive.mcap"]
