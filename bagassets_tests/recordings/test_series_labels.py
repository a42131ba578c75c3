"""Label files that are named after the parts of a drive, once it is one recording: every box comes out where it truly is."""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from label_files import (
    CLASSES,
    FRAMES,
    SIZES,
    box_entries,
    box_json,
    kitti_line,
    odom_SE3_box,
    stamp_of,
    write_kitti_tracklets,
    write_nuscenes,
    write_sustechpoints,
)

from bagassets.assets.annotation_frames import between_origins
from bagassets.assets.annotations import ANNOTATIONS, make_annotations
from bagassets.assets.boxes.files import find
from bagassets.assets.boxes.files.find import LabelSet
from bagassets.assets.boxes.files.label import LabelFile
from bagassets.assets.boxes.table import BoxTable
from bagassets.base.errors import DecodeError
from bagassets.engine.execute import BuildFailure
from bagassets.geometry.se3 import SE3
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model import Rig
from bagassets.store.canonical import digest_bytes
from bagassets_tests.assets.test_annotation_files import BOXES, build, load
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of
from bagassets_tests.pose_data import ODOMETRY, Recorded, Written, odometry
from bagassets_tests.posed import Posed, at, truth
from bagassets_tests.series import write_parts
from bagassets_tests.small_drive import START_NS

pytestmark = pytest.mark.once

PARTS = range(3)
PER_PART = 7  # clouds
BY_TOPIC = {"by": "topic", "topic": "/points"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A drive in three parts with seven clouds each, without labels, whose store has what annotations need."""
    folder = tmp_path_factory.mktemp("built")
    write_parts(folder / "bags" / "drive.mcap", (0.7, 1.4), 2.2)
    build(load(folder / "bags"), BOXES, key="drive.mcap")
    return folder


@pytest.fixture
def bags(tmp_path, built):
    shutil.copytree(built, tmp_path, dirs_exist_ok=True)
    return tmp_path / "bags"


def frames_of(part):
    return range(part * PER_PART, min((part + 1) * PER_PART, FRAMES))


def boxes_json(bags):
    for part in PARTS:
        entries = [one for one in box_entries() if one["stamp_ns"] in map(stamp_of, frames_of(part))]
        (bags / f"drive_{part}.json").write_text(box_json(entries))
    return {"format": "boxes", "path": "{stem}.json"}


def sustechpoints(bags):
    whole = write_sustechpoints(bags)
    for part in PARTS:
        folder = bags / f"drive_{part}" / "label"
        folder.mkdir(parents=True)
        for number, frame in enumerate(frames_of(part)):
            shutil.move(bags / "a" / "label" / f"{frame:06d}.json", folder / f"{number:06d}.json")
    return whole


def kitti_tracking(bags, **times):
    for part in PARTS:
        lines = [
            f"{number} {track} {kitti_line(track, stamp_of(frame))}"
            for number, frame in enumerate(frames_of(part))
            for track in SIZES
        ]
        (bags / f"drive_{part}.txt").write_text("\n".join(lines))
    return {"format": "kitti_labels", "path": "{stem}.txt", "frame": "cam", "times": {**BY_TOPIC, **times}}


def kitti_tracking_counted_from_1(bags):
    source = kitti_tracking(bags, first=1)
    for part in PARTS:
        path = bags / f"drive_{part}.txt"
        words = [line.split(" ", 1) for line in path.read_text().splitlines()]
        path.write_text("\n".join(f"{int(frame) + 1} {rest}" for frame, rest in words))
    return source


def kitti_tracking_by_file(bags):
    for part in PARTS:
        (bags / f"drive_{part}.times").write_text(
            "".join(f"{stamp_of(frame)}\n" for frame in frames_of(part))
        )
    source = kitti_tracking(bags)
    return {**source, "times": {"by": "file", "path": "{stem}.times"}}


def kitti_tracklets(bags, monkeypatch):
    for part in PARTS:
        frames = frames_of(part)
        with monkeypatch.context() as patched:
            patched.setattr("label_files.FRAMES", len(frames))
            patched.setattr("label_files.stamp_of", lambda frame, frames=frames: stamp_of(frames[frame]))
            source = write_kitti_tracklets(bags)
        (bags / "tracklet_labels.xml").rename(bags / f"drive_{part}.xml")
    return {**source, "path": "{stem}.xml"}


def tables(folder, part, logfile):
    """Write the tables of a part alone."""
    folder.mkdir()
    source = write_nuscenes(folder)
    version = folder / "v1.0-old"
    samples = json.loads((version / "sample.json").read_text())
    stamps = {stamp_of(frame) // 1000 for frame in frames_of(part)}
    samples = [one for one in samples if one["timestamp"] in stamps]
    kept = {one["token"] for one in samples}
    rows = json.loads((version / "sample_annotation.json").read_text())
    written = {
        "sample": samples,
        "sample_annotation": [row for row in rows if row["sample_token"] in kept],
        "log": [{"token": "log", "logfile": logfile}, {"token": "another", "logfile": "b.mcap"}],
    }
    for name, content in written.items():
        (version / f"{name}.json").write_text(json.dumps(content))
    return source


def nuscenes(bags):
    for part in PARTS:
        source = tables(bags / f"drive_{part}", part, f"drive_{part}.mcap")
    return {**source, "path": "{stem}/v1.0-old"}


def nuscenes_of_all_recordings(bags):
    """One dataset, of which each part is a log."""
    source = write_nuscenes(bags)
    version = bags / "v1.0-old"
    samples = json.loads((version / "sample.json").read_text())
    for one in samples[:FRAMES]:
        one["scene_token"] = f"scene {int(one['token'][1:]) // PER_PART}"
    scenes = [{"token": f"scene {part}", "log_token": f"log {part}"} for part in PARTS]
    logs = [{"token": f"log {part}", "logfile": f"drive_{part}.mcap"} for part in PARTS]
    other = {
        "scene": {"token": "other", "log_token": "another"},
        "log": {"token": "another", "logfile": "b.mcap"},
    }
    for name, content in {
        "sample": samples,
        "scene": [*scenes, other["scene"]],
        "log": [*logs, other["log"]],
    }.items():
        (version / f"{name}.json").write_text(json.dumps(content))
    return source


WRITERS = [
    boxes_json,
    sustechpoints,
    kitti_tracking,
    kitti_tracking_counted_from_1,
    kitti_tracking_by_file,
    kitti_tracklets,
    nuscenes,
    nuscenes_of_all_recordings,
]


def annotated(bags, source):
    artifact = build(load(bags, source), key="drive.mcap")["annotations"].artifact
    counts = artifact.read_json("annotations.json")["counts"][source["path"]]
    return BoxTable.from_arrow(artifact.read_table("annotations.parquet")), counts


@pytest.mark.parametrize("write", WRITERS)
def test_labels_of_parts_place_the_true_boxes_in_the_whole_drive(bags, write, monkeypatch):
    source = write(bags, monkeypatch) if write is kitti_tracklets else write(bags)
    table, counts = annotated(bags, source)
    assert counts["boxes"]["written"] == len(table) == FRAMES * len(SIZES)
    assert not counts["boxes"]["lost"]
    to = 1000 if "nuscenes" in source["format"] else 1
    assert {stamp // to for stamp in table.stamps_ns.tolist()} == {
        stamp_of(frame) // to for frame in range(FRAMES)
    }
    for row in range(len(table)):
        track = next(name for name, size in SIZES.items() if size == tuple(table.sizes_m[row]))
        assert table.categories[row] == CLASSES[track]
        pose = odom_SE3_box(track, int(table.stamps_ns[row]))
        np.testing.assert_allclose(table.centers_m[row], pose.translation, atol=2e-5)
        assert abs(np.dot(table.rotations[row], pose.rotation)) == pytest.approx(1.0, abs=1e-9)
    # Tokens of one dataset name the same object everywhere; otherwise nobody knows.
    assert table.track_count == len(SIZES) * (1 if write is nuscenes_of_all_recordings else len(PARTS))


def test_where_one_part_has_no_labels_the_others_keep_their_frames(bags):
    source = kitti_tracking(bags)
    (bags / "drive_1.txt").unlink()
    table, _ = annotated(bags, source)
    frames = [*frames_of(0), *frames_of(2)]
    assert sorted(set(table.stamps_ns.tolist())) == [stamp_of(frame) for frame in frames]
    assert "drive_1.txt: there are no labels" in refusal(bags, {**source, "missing": "refuse"})


def test_a_frame_that_a_part_does_not_have_is_none_of_the_next(bags):
    source = kitti_tracking(bags)
    with (bags / "drive_0.txt").open("a") as stream:
        stream.write(f"\n{PER_PART} 9 {kitti_line('7', stamp_of(0))}\n-1 9 {kitti_line('7', stamp_of(0))}")
    _, counts = annotated(bags, source)
    assert counts["boxes"]["lost"] == {"its frame has no time": 2}
    assert counts["boxes"]["first"] == {"its frame has no time": "drive_0.mcap/{stem}.txt:15"}


def test_boxes_of_a_part_lie_within_its_time(bags):
    """As for tables of all recordings, of which each part had those of its own time."""
    source = boxes_json(bags)
    (bags / "drive_0.json").write_text(box_json(box_entries()))
    _, counts = annotated(bags, source)
    last_ns = START_NS + 680_000_000  # odometry
    beyond = sum(stamp_of(frame) > last_ns + 1_000_000_000 for frame in range(FRAMES))
    assert counts["boxes"]["lost"] == {"its time is outside the recording": beyond * len(SIZES)}


def test_another_cut_of_the_same_drive_is_another_action(bags, tmp_path):
    source = kitti_tracking(bags)
    first, _ = annotated(bags, source)
    for path in bags.glob("drive_*.mcap"):
        path.unlink()
    write_parts(bags / "drive.mcap", (0.6, 1.4), 2.2)
    second, counts = annotated(bags, source)
    assert counts["boxes"]["lost"] == {"its frame has no time": len(SIZES)}
    assert stamp_of(PER_PART - 1) in second.stamps_ns.tolist()
    assert len(second) == len(first) - len(SIZES)


def test_frames_of_parts_are_refused_where_messages_count_once(bags, monkeypatch):
    monkeypatch.setattr(find, "_counts", lambda path, _: {"/points": 8})
    assert refusal(bags, kitti_tracking(bags)) == (
        f"{bags / 'drive_0.txt'}: frames of a part are counted in messages on /points, but the recorder repeated some of them in "
        f"later parts; write labels for the whole drive to {bags / 'drive.txt'}, or keep its parts apart with bags.series."
    )


def refusal(bags, source):
    with pytest.raises(BuildFailure) as caught:
        build(load(bags, source), key="drive.mcap")
    (error,) = caught.value.errors.values()
    return str(error)


# --- where the global frame begins -------------------------------------------------------

UTM = (448_251.8, 5_411_932.7, 35.2)
CAR = SE3.create((1, 0, 0, 0), (12.0, 5.0, 0.8))


def far_away(folder, files, **entry):
    """Annotate a drive in UTM coordinates with label files of its parts; return the table and the poses."""
    folder = Path(tempfile.mkdtemp(dir=folder))
    shift = SE3.create((1, 0, 0, 0), UTM)
    times = np.arange(0.0, 1.0, 0.02)
    entries = [("/odom", ODOMETRY, at(t), odometry(at(t), shift @ truth(t), frame="map")) for t in times]
    posed = Posed(folder / "poses", {"source": "odometry", "topic": "/odom"}, *entries)
    source = {"path": "{stem}", **entry}
    fields = {
        "channels": {"LIDAR_TOP": {"modality": "lidar", "topic": "/odom"}},
        "ego_pose": {"source": "odometry", "topic": "/odom"},
        "annotation_files": [source],
    }
    rig = Rig.model_validate({"name": "car", **fields})
    found = []
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content))
        found.append(LabelFile(name, folder / name, digest_bytes((folder / name).read_bytes())))
    part = LabelSet("{stem}", folder, tuple(found), is_folder=True, is_series=True, part="drive_1.bag")
    labels = LabelSet("{stem}", folder, (), is_series=True, parts=(part,))
    recorded = Recorded(*entries)
    facts = MadeUpFacts(
        recorded.inventory(), calibrated(), {"ego_poses": posed.artifact}, label_sets={"{stem}": labels}
    )
    use = use_of(ANNOTATIONS, rig, facts)
    made = Written(
        folder / "boxes",
        lambda out: make_annotations(use.params, recorded, out, trajectory=posed.trajectory),
    )
    return made.artifact.read_table("annotations.parquet").to_pylist(), posed


def tables_of_a_log(log, translation):
    """nuScenes tables with one box at half a second."""
    tables = {
        "sample": [{"token": "s", "timestamp": at(0.5) // 1000, "scene_token": "scene"}],
        "sample_annotation": [
            {
                "token": "a", "sample_token": "s", "instance_token": "7", "attribute_tokens": [],
                "translation": translation, "size": [1.0, 1.0, 1.0], "rotation": [1.0, 0.0, 0.0, 0.0],
            }
        ],
        "instance": [{"token": "7", "category_token": "Car"}],
        "category": [{"token": "Car", "name": "Car"}],
        "attribute": [],
        "scene": [{"token": "scene", "log_token": "log"}],
        "log": [{"token": "log", "logfile": "drive_1.bag", **log}],
    }  # fmt: skip
    return {f"{name}.json": rows for name, rows in tables.items()}


def test_tables_of_a_part_are_moved_from_where_its_global_frame_began(tmp_path):
    began = {"kind": "local", "x": UTM[0] + 7.2, "y": UTM[1] - 3.7, "z": UTM[2] + 1.8}
    given = [u + c - began[axis] for u, c, axis in zip(UTM, CAR.translation, "xyz", strict=True)]
    (row,), posed = far_away(tmp_path, tables_of_a_log({"origin": began}, given), format="nuscenes")
    here = [posed.json["origin"][axis] for axis in "xyz"]
    expected = [u + c - o for u, c, o in zip(UTM, CAR.translation, here, strict=True)]
    np.testing.assert_allclose([row[axis] for axis in "xyz"], expected, atol=1e-6)


def test_where_nobody_knows_where_the_global_frame_of_a_part_began_its_boxes_are_refused(tmp_path):
    advice = (
        "give them in the frame of a sensor, label the whole drive, or keep its parts apart with bags.series."
    )
    with pytest.raises(DecodeError, match=rf"log.json: .* begins where drive_1.bag did, .*; {advice}"):
        far_away(tmp_path, tables_of_a_log({}, [0.0, 0.0, 0.0]), format="nuscenes")
    (entry,) = [one for one in box_entries() if one["stamp_ns"] == stamp_of(5) and one["track_id"] == "7"]
    content = json.loads(box_json([{**entry, "stamp_ns": at(0.5)}], frame="@dataset"))
    with pytest.raises(DecodeError, match=rf"1.json: .* begins where drive_1.bag did, .*; {advice}"):
        far_away(tmp_path, {"1.json": content}, format="boxes")
    content["frame"] = "map"  # as recorded
    content["boxes"][0]["center"] = [u + c for u, c in zip(UTM, CAR.translation, strict=True)]
    (row,), posed = far_away(tmp_path, {"1.json": content}, format="boxes")
    assert row["x"] == pytest.approx(UTM[0] + CAR.translation[0] - posed.json["origin"]["x"])


def test_between_two_places_on_earth_a_point_keeps_its_coordinates():
    places = [LocalFrame(48.0775, 11.6405, 552.0), LocalFrame(48.1, 11.7, 510.0)]
    here, there = (
        {"kind": "wgs84", "lat": one.lat_deg, "lon": one.lon_deg, "alt": one.alt_m} for one in places
    )
    points = np.array([[0.0, 0.0, 0.0], [120.0, -40.0, 3.0]])
    expected = places[0].to_local(*places[1].to_geodetic(points))
    np.testing.assert_allclose(between_origins(here, there).transform_points(points), expected, atol=1e-6)
    assert between_origins(here, dict(here)) == SE3()


@pytest.mark.parametrize(
    "other", [{"kind": "local", "x": 0.0, "y": 0.0, "z": 0.0}, None, "x", {"kind": "wgs84"}]
)
def test_between_the_earth_and_elsewhere_there_is_no_way(other):
    assert between_origins({"kind": "wgs84", "lat": 48.0, "lon": 11.0, "alt": 5.0}, other) is None
