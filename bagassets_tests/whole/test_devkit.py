"""The real nuscenes-devkit loads, walks, renders and evaluates what we write."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from devkit import run_devkit
from handmade import IMAGE, SIZES, T0, Drive, S, make_tables, object_pose

from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.recipe.model_splits import Splits
from bagassets.store.store import Store

pytestmark = [pytest.mark.devkit, pytest.mark.xdist_group("devkit"), pytest.mark.once]

VERSION = "v1.0-test"
PAGE = (Path(__file__).parents[2] / "docs" / "devkit.md").read_text("utf-8")
SPLITS = Splits(shares={"train": 0.5, "val": 0.5})


@pytest.fixture(scope="module")
def dataroot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("devkit")
    store = Store(folder / "store")
    drives = {"drive_1": Drive(seconds=4.2), "drive_2": Drive(seconds=5.5, seed=1, box_phase_s=0.031)}
    parts = [
        Part(key, key, make_tables(store, drive, key=key, length_s=3.0).artifact.digest)
        for key, drive in drives.items()
    ]
    assemble(NUSCENES, parts, NuScenes(version=VERSION), store, folder / "nuscenes", splits=SPLITS)
    return folder / "nuscenes"


@pytest.fixture(scope="module")
def facts(dataroot):
    return run_devkit("devkit_walk.py", dataroot, VERSION, "custom_train", "custom_val")


def test_all_tables_load_and_all_chains_can_be_walked(facts):
    assert facts["tables"]["scene"] == 4
    assert facts["tables"]["sample"] == sum(scene["samples"] for scene in facts["scenes"].values())
    assert sum(facts["readings"].values()) == facts["tables"]["sample_data"]
    assert {scene["location"] for scene in facts["scenes"].values()} == {"yard"}


def test_lidar_is_drawn_into_the_images(facts):
    assert set(facts["rendered"]) == {"CAM_FRONT", "CAM_BACK"}
    for points, size in facts["rendered"].values():
        assert points > 20
        assert size == list(IMAGE)
    assert min(facts["depths"]) > 0.5


def test_sweeps_are_aggregated_over_time(facts):
    points, nearest_s, farthest_s = facts["sweeps"]
    assert points > 5 * 300
    assert nearest_s == 0.0
    assert farthest_s == pytest.approx(0.4, abs=1e-3)


def test_radar_files_are_read_with_all_their_targets(facts):
    files, targets = facts["radar"]["RADAR_FRONT"]
    assert targets == files * 12


def test_the_devkit_counts_the_points_that_we_counted(facts):
    assert len(facts["points"]) == facts["tables"]["sample_annotation"]
    for _, counted, written in facts["points"]:
        # The devkit goes through float32 and its own order of operations: points on a face may differ.
        assert abs(counted - written) <= 1
        assert written == 60


def test_static_boxes_stand_still_in_the_global_frame(facts):
    assert facts["static_spread_m"] < 1e-5


def test_velocities_are_those_of_the_objects(facts):
    cars = [np.array(track) for track in facts["velocities"]["vehicle.car"]]
    speeds = sorted(round(float(np.linalg.norm(track, axis=1).mean()), 2) for track in cars)
    assert speeds == [0.0] * 4 + [4.0] * 4
    for track in facts["velocities"]["human.pedestrian.adult"]:
        np.testing.assert_allclose(track, np.tile([0.0, -1.0, 0.0], (len(track), 1)), atol=1e-3)


def test_splits_are_found_under_names_of_our_own(facts):
    assert sorted(name for scenes in facts["splits"].values() for name in scenes) == sorted(facts["scenes"])


# What the drive is made of, in the words of the devkit: velocities in m/s over ground, and attributes.
TRUTH = {
    "parked": ("car", [0.0, 0.0], "vehicle.parked"),
    "moving": ("car", [4.0, 0.0], "vehicle.moving"),
    "walker": ("pedestrian", [0.0, -1.0], "pedestrian.moving"),
}


def true_results(dataroot):
    """The objects of the drive at the time of each sample, by their closed forms; all have points and are in range."""
    rows = json.loads((dataroot / VERSION / "sample.json").read_text())
    results = {}
    for row in rows:
        poses = {name: object_pose(name, (row["timestamp"] * 1000 - T0) / S) for name in SIZES}
        results[row["token"]] = [
            {
                "sample_token": row["token"], "translation": list(pose.translation), "size": list(SIZES[name]),
                "rotation": list(pose.rotation), "velocity": TRUTH[name][1], "detection_name": TRUTH[name][0],
                "detection_score": 0.9, "attribute_name": TRUTH[name][2],
            }
            for name, pose in poses.items()
        ]  # fmt: skip
    return results


def test_what_the_drive_is_made_of_scores_perfectly_in_the_detection_evaluation(dataroot, facts, tmp_path):
    (split, *_) = [name for name, scenes in facts["splits"].items() if scenes]
    given = tmp_path / "given.json"
    given.write_text(json.dumps(true_results(dataroot)))
    scores = run_devkit("devkit_eval.py", dataroot, VERSION, split, tmp_path, given)
    assert scores["samples"] > 0
    for name in ("car", "pedestrian"):
        assert scores["aps"][name] == pytest.approx(1.0)
        errors = scores["errors"][name]
        assert all(errors[kind] < 1e-5 for kind in ("trans_err", "scale_err", "orient_err", "vel_err")), (
            errors
        )
        assert errors["attr_err"] == 0.0


def test_what_docs_devkit_says_of_it_is_so(dataroot, tmp_path):
    """If a line fails, the devkit has changed: change docs/devkit.md, and perhaps what we write."""
    seen = run_devkit("devkit_facts.py", dataroot, VERSION, tmp_path)
    assert f"nuscenes-devkit {seen['version']}" in PAGE
    splits = seen["splits"]
    assert "this function cannot map to the correct NuScenes version" in splits["load_gt"]
    assert splits["by_tokens"] == splits["samples"] > 0
    assert splits["val"] == [150, 0]
    assert "Requested split val which is not compatible with NuScenes version" in splits["val_refused"]
    scenes, together = seen["listed"]
    assert len(scenes) == 4
    assert all(listed == boxes - last < boxes for listed, boxes, last in scenes)
    assert together == "TypeError: '<' not supported between instances of 'dict' and 'dict'"
    assert seen["tracking"] == "SkipTest: Skipping test as pandas was not found!"
    assert seen["map_expansion"] == "AssertionError: Error: Unknown map name yard!"
    assert seen["can_bus"].startswith("Exception: Error: CAN bus directory not found")
    assert "The function is not implemented" in seen["video"]
    assert seen["maps"]["log_in_no_map"].startswith("KeyError: ")
    assert re.match(r"AssertionError: map mask .*gone\.png does not exist", seen["maps"]["no_picture"])
    assert seen["radar"] == {
        "valid": 2, "without_a_byte_more": "AssertionError", "no_target": "AssertionError",
        "valid_by_its_docstring": 1, "nan_in_the_first": 0,
    }  # fmt: skip
    exported = seen["exported"]
    assert (
        exported["kitti"][0]
        == "AssertionError: Requested split custom_val which is not a known nuScenes split."
    )
    assert exported["kitti"][1].startswith("AssertionError: Requested split train which is not compatible")
    assert exported["poses"] == exported["readings"] > 0
    assert exported["begins"] == ""
    assert (
        exported["coordinates"]
        == "AssertionError: Error: The given location: yard, has no available reference."
    )
    assert re.fullmatch(r"KeyError: 'CAM_\w+'", exported["points"])
    assert exported["futures"] > 0
    assert (
        exported["prediction"]
        == "ValueError: split must be one of (mini_train, mini_val, train, train_val, val)"
    )
    assert seen["evaluated"]["one_without_points"] == seen["evaluated"]["before"] - 1
    assert seen["evaluated"]["without_lidar"] == "KeyError: 'LIDAR_TOP'"
    assert seen["without_velocity"] == [0, len(boxes_of(dataroot)), len(boxes_of(dataroot))]
    for words in (
        together,
        "this function cannot map",
        "SkipTest",
        "Unknown map name",
        "map mask",
        "KeyError: 'LIDAR_TOP'",
    ):
        assert words in PAGE, words


def boxes_of(dataroot):
    return json.loads((dataroot / VERSION / "sample_annotation.json").read_text())


def test_a_dataset_without_recordings_loads_too(tmp_path):
    assemble(NUSCENES, [], NuScenes(version=VERSION), Store(tmp_path / "store"), tmp_path / "empty")
    facts = run_devkit("devkit_walk.py", tmp_path / "empty", VERSION)
    assert facts["tables"]["sample"] == 0
