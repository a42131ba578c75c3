"""Which files beside a recording are its labels."""

import pytest

from bagassets.assets.boxes.files.find import expand, find_labels, label_paths
from bagassets.recipe.model import Rig
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_bytes

pytestmark = pytest.mark.once


@pytest.fixture
def recording(tmp_path):
    (tmp_path / "day").mkdir()
    path = tmp_path / "day" / "run.1.bag"
    return RecordingFiles("day__run.1.bag", "day/run.1.bag", path, "ros1", (path,), 1, 1)


def rig(**source):
    channels = {"LIDAR_TOP": {"modality": "lidar", "topic": "/points"}}
    return Rig.model_validate(
        {"name": "car", "channels": channels, "ego_pose": {"source": "fixed"}, "annotation_files": [source]}
    )


@pytest.mark.parametrize(
    ("template", "name"),
    [("{stem}.json", "run.1.json"), ("labels/{name}", "labels/run.1.bag"), ("{key}/a", "day__run.1.bag/a")],
)
def test_names_of_the_recording_are_filled_in(recording, template, name):
    assert expand(template, recording) == name


def test_the_name_of_a_folder_has_no_ending(tmp_path):
    folder = tmp_path / "run.1"
    assert (
        expand("{stem}", RecordingFiles("k", "run.1", folder, "ros2", (folder / "run.1_0.db3",), 1, 1))
        == "run.1"
    )


TIMES = {"times": {"by": "file", "path": "{stem}.times.txt"}}
ENDINGS = {
    "boxes": ({}, {".json", ".parquet"}),
    "sustechpoints": (TIMES, {".json"}),
    "kitti_tracklets": (TIMES, {".xml"}),
    "kitti_labels": (TIMES, {".txt"}),
}


@pytest.mark.parametrize("kind", ENDINGS)
def test_of_a_folder_the_files_of_the_format_count(recording, kind):
    fields, endings = ENDINGS[kind]
    folder = recording.path.parent / "labels"
    folder.mkdir()
    for name in ("b.json", "A.JSON", "c.parquet", "d.xml", "e.txt", "f"):
        (folder / name).write_bytes(name.encode())
    (folder / "g.json").mkdir()
    labels = find_labels(rig(format=kind, path="labels", **fields).annotation_files, recording)["labels"]
    names = {file.name for file in labels.files}
    assert names == {
        name for name in ("b.json", "A.JSON", "c.parquet", "d.xml", "e.txt") if name[1:].lower() in endings
    }
    assert labels.is_folder
    assert labels.inputs == {f"labels:labels/{name}": digest_bytes(name.encode()) for name in names}
    assert set(label_paths(rig(format=kind, path="labels", **fields), recording)) == {
        folder,
        *(folder / name for name in names),
        *([recording.path.parent / "run.1.times.txt"] if fields else []),
    }


def test_a_file_keeps_its_name_in_the_recipe(recording):
    (recording.path.parent / "run.1.json").write_bytes(b"{}")
    labels = find_labels(rig(format="boxes", path="{stem}.json").annotation_files, recording)["{stem}.json"]
    assert labels.inputs == {"labels:{stem}.json": digest_bytes(b"{}")}
    assert not labels.is_folder


def test_without_files_there_are_none(recording):
    labels = find_labels(rig(format="boxes", path="{stem}.json").annotation_files, recording)["{stem}.json"]
    assert (labels.files, labels.inputs, labels.is_folder) == ((), {}, False)
    assert label_paths(rig(format="boxes", path="{stem}.json"), recording) == [
        recording.path.parent / "run.1.json"
    ]


def test_a_file_of_times_is_one_of_them(recording):
    source = {"format": "kitti_labels", "path": "{stem}.txt"} | TIMES
    assert find_labels(rig(**source).annotation_files, recording)["{stem}.txt"].times is None
    (recording.path.parent / "run.1.times.txt").write_bytes(b"1")
    labels = find_labels(rig(**source).annotation_files, recording)["{stem}.txt"]
    assert labels.inputs == {"labels:times of {stem}.txt": digest_bytes(b"1")}
