"""From recordings of every format to a dataset that the real devkit loads."""

import json
import shutil

import numpy as np
import pytest

from bagassets.assets.ego_poses import load_trajectory
from bagassets.engine.execute import BuildFailure, Skipped
from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.devkit import run_devkit
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.recording_build import RecordingBuild
from bagassets_tests.small_drive import RECIPE, SPEED_MPS, START_NS, write_drive

NAMES = {"ros1": "a.bag", "ros2": "b", "mcap": "c.mcap"}


def make_project(folder, *, text=RECIPE, **drives):
    for file_format, name in drives.items():
        write_drive(folder / "bags" / name, file_format)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recipe.yaml").write_text(text.format(name="test", root="bags"))
    return load_recipe(folder / "recipe.yaml")


def build_of(recipe, key, **options):
    recording = discover(recipe.bags).recordings[key]
    digest = recording_digest(recording)
    return RecordingBuild(
        recipe, Store(recipe.store_path), recording, digest.digest, recording_stat(recording), **options
    )


def build_all(recipe, **options):
    return {
        key: {made.asset: made for made in build_of(recipe, key, **options).build()}
        for key in discover(recipe.bags).recordings
    }


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    recipe = make_project(tmp_path_factory.mktemp("project"), **NAMES)
    return recipe, build_all(recipe)


@pytest.mark.devkit
def test_the_devkit_loads_and_walks_the_dataset_of_every_format(project):
    recipe, made = project
    store = Store(recipe.store_path)
    parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
    summary = assemble(NUSCENES, parts, recipe.nuscenes, store, recipe.nuscenes.output)
    assert summary.facts["rows"]["scene"] == len(NAMES)
    assert check_dataset(recipe.nuscenes.output, "v1.0-test") == []
    walked = run_devkit("devkit_walk.py", recipe.nuscenes.output, "v1.0-test")
    assert [scene["samples"] for scene in walked["scenes"].values()] == [6] * len(NAMES)


@pytest.mark.parametrize("asset", ["ego_poses", "calibration", "annotations"])
def test_formats_give_the_same_artifacts(project, asset):
    _, made = project
    assert len({assets[asset].artifact.digest for assets in made.values()}) == 1


@pytest.mark.parametrize("asset", ["frames", "sweeps"])
def test_formats_give_the_same_files(project, asset):
    recipe, made = project
    store = Store(recipe.store_path)
    files = set()
    for assets in made.values():
        for entry in assets[asset].artifact.read_json("channels.json").values():
            index = store.artifact(entry["artifact"]).read_table("index.parquet")
            files.add((tuple(index["stamp_ns"].to_pylist()), tuple(index["digest"].to_pylist())))
    assert len(files) == 1


def test_poses_match_the_truth_to_a_millimetre_between_messages(project):
    _, made = project
    for assets in made.values():
        trajectory = load_trajectory(assets["ego_poses"].artifact)
        stamps = START_NS + np.arange(7_000_000, 2_900_000_000, 13_000_001)
        positions, _, valid = trajectory.at(stamps)
        assert valid.all()
        truth = SPEED_MPS * (stamps - START_NS) / 1e9
        assert np.abs(positions[:, 0] - truth).max() < 1e-3


def test_a_second_build_runs_nothing(project):
    recipe, made = project
    again = build_all(recipe, dry=True)
    for key, assets in again.items():
        assert all(result.cached for result in assets.values())
        assert {name: r.artifact.digest for name, r in assets.items()} == {
            name: r.artifact.digest for name, r in made[key].items()
        }


def test_bytes_depend_on_neither_folder_nor_workers(project, tmp_path):
    recipe, made = project
    moved = make_project(tmp_path / "elsewhere")
    shutil.copytree(recipe.bags.root, moved.bags.root)
    for key, assets in build_all(moved, workers=3).items():
        for name, result in assets.items():
            assert result.artifact.digest == made[key][name].artifact.digest, (key, name)


def test_counts_in_are_counts_out(project):
    _, made = project
    for assets in made.values():
        for asset in ("frames", "sweeps"):
            for counts in assets[asset].artifact.summary()["channels"].values():
                assert counts["read"] == counts["written"] + counts["merged"] + sum(counts["lost"].values())
                assert counts["written"] == 29


def test_a_changed_quality_re_encodes_and_re_reads_nothing_else(project, tmp_path):
    recipe, _ = project
    text = RECIPE.replace("topic: /cam/image_raw", "topic: /cam/image_raw, quality: 50")
    changed = make_project(tmp_path / "p", text=text)
    shutil.copytree(recipe.bags.root, changed.bags.root)
    shutil.copytree(recipe.store_path, changed.store_path)
    ran = {
        key: {name for name, made in assets.items() if not made.cached}
        for key, assets in build_all(changed).items()
    }
    # The MCAP has the very messages of the ROS 2 bag: its frames are a hit of theirs. Pictures of all
    # three are the same.
    assert ran == {
        "a.bag": {"frames", "nuscenes_tables", "preview"},
        "b": {"frames", "nuscenes_tables"},
        "c.mcap": {"nuscenes_tables"},
    }


def test_a_recording_without_the_required_channel_is_skipped_with_a_reason(tmp_path):
    text = RECIPE.replace("    ego_pose:", "    required: [CAM_BACK]\n    ego_pose:").replace(
        "      LIDAR_TOP:", "      CAM_BACK: {{modality: camera, topic: /back}}\n      LIDAR_TOP:"
    )
    recipe = make_project(tmp_path, text=text, ros1="a.bag")
    results = list(build_of(recipe, "a.bag").build())
    assert isinstance(results[-1], Skipped)
    assert "CAM_BACK (/back)" in results[-1].reason


def test_missing_poses_fail_with_a_sentence_and_leave_frames_standing(tmp_path):
    recipe = make_project(tmp_path, text=RECIPE.replace("/odom}}", "/pose}}"), ros1="a.bag")
    made = []
    with pytest.raises(BuildFailure) as caught:
        made.extend(r.asset for r in iter_results(build_of(recipe, "a.bag"), made))
    assert set(caught.value.errors) == {"ego_poses"}
    assert "/pose" in str(caught.value)
    assert "/odom" in str(caught.value)
    assert "frames" in made


def iter_results(build, made):
    for result in build.build():
        made.append(result.asset)
        yield result


def test_a_recording_that_changes_while_it_is_read_records_nothing(tmp_path):
    recipe = make_project(tmp_path, ros1="a.bag")
    build = build_of(recipe, "a.bag")
    with (tmp_path / "bags" / "a.bag").open("ab") as stream:
        stream.write(b"more")
    with pytest.raises(BuildFailure, match="changed while it was read"):
        list(build.build())
    assert not list((recipe.store_path / "actions").rglob("*.json")) or all(
        path.name.endswith(".failed.json") for path in (recipe.store_path / "actions").rglob("*.json")
    )


def test_inventory_has_the_offset_of_the_clocks(project):
    _, made = project
    for assets in made.values():
        value = json.loads(assets["inventory"].artifact.path("inventory.json").read_text())
        offsets = {t["name"]: t["header_offset_s"]["median"] for t in value["topics"]}
        assert offsets["/odom"] == pytest.approx(0.003, abs=1e-6)
