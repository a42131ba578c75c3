"""Comparing datasets, making one again from its lock, and updating one of many recordings."""

import dataclasses
import errno
import json
import os
import shutil
from pathlib import Path

import dagster as dg
import pytest
from click.testing import CliRunner
from handmade import Drive, make_tables, true_boxes

from bagassets.base.errors import DatasetError
from bagassets.cli.main import root
from bagassets.defs.graph.dataset import dataset_is_current, record_inputs
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.events import STAT
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.workspace import Workspace
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_build import select_inputs
from bagassets.formats.dataset_diff import diff_datasets
from bagassets.formats.dataset_lock import load_lock, locked_artifacts, read_lock
from bagassets.formats.dataset_restore import restore_dataset
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.tokens import recording_of
from bagassets.formats.vision.format import VISION
from bagassets.recipe.model_splits import Splits
from bagassets.store.store import Store
from bagassets_tests.formats.test_dataset import content
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.small_drive import RECIPE
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.whole.test_end_to_end import build_all, build_of, make_project

pytestmark = pytest.mark.once

VERSION = "v1.0-test"
SETTINGS = NuScenes(version=VERSION)
CHANNELS = ("CAM_FRONT", "LIDAR_TOP")


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


def part(store, key, *, seed=0, content=None, drive=None, **options):
    drive = drive or Drive(seconds=3.0, seed=seed, channels=CHANNELS)
    tables = make_tables(store, drive, key=key, **options).artifact.digest
    return Part(key, content or f"content-{key}-{seed}", tables)


def lock_of(store, folder, parts, **options):
    assemble(NUSCENES, parts, SETTINGS, store, folder, **options)
    return load_lock(folder)


def diff_of(store, tmp_path, before, after, **options):
    one = lock_of(store, tmp_path / "one", before)
    other = lock_of(store, tmp_path / "other", after, **options)
    return diff_datasets(one, other, store)


class TestDiff:
    def test_a_dataset_does_not_differ_from_itself(self, store, tmp_path):
        parts = [part(store, "a"), part(store, "b", seed=1)]
        found = diff_of(store, tmp_path, parts, parts)
        assert found.is_empty
        assert (found.bags, found.files, found.settings) == ((), (), {})

    def test_added_and_removed_recordings_with_their_scenes_and_samples(self, store, tmp_path):
        a, b, c = part(store, "a"), part(store, "b", seed=1), part(store, "c", seed=2)
        # Else b would be in train once and in val once.
        stays = lock_of(store, tmp_path / "one", [a, b]).bags["b"].split
        found = diff_of(store, tmp_path, [a, b], [b, c], dealt={"b": stays, "c": "train"})
        assert [(bag.key, bag.change) for bag in found.bags] == [("a", "removed"), ("c", "added")]
        (removed,), (added,) = found.bags[0].scenes, found.bags[1].scenes
        assert (removed.name, removed.change, len(removed.removed)) == ("a_000", "removed", 6)
        assert (added.name, added.change, len(added.added)) == ("c_000", "added", 6)
        assert "sample.json" in found.files
        assert "visibility.json" not in found.files

    def test_a_renamed_recording_is_not_a_new_one(self, store, tmp_path):
        found = diff_of(store, tmp_path, [part(store, "a", content="x")], [part(store, "z", content="x")])
        (bag,) = found.bags
        assert (bag.change, bag.before.key, bag.after.key) == ("renamed", "a", "z")

    def test_other_boxes_change_just_the_samples_that_have_them(self, store, tmp_path):
        drive = Drive(seconds=3.0, channels=CHANNELS)
        table = true_boxes(drive)
        centers_m = table.centers_m.copy()
        centers_m[len(table) // 2, 0] += 0.5
        moved = dataclasses.replace(table, centers_m=centers_m)
        found = diff_of(store, tmp_path, [part(store, "a", table=table)], [part(store, "a", table=moved)])
        (scene,) = found.bags[0].scenes
        assert set(scene.changed.values()) == {("boxes",)}
        assert 0 < len(scene.changed) < 6

    def test_other_images_change_readings_and_nothing_else(self, store, tmp_path):
        found = diff_of(store, tmp_path, [part(store, "a", seed=1)], [part(store, "a", seed=2)])
        (scene,) = found.bags[0].scenes
        assert scene.change == "changed"
        assert {p for parts in scene.changed.values() for p in parts} >= {"readings"}
        assert "calibration" not in {p for parts in scene.changed.values() for p in parts}

    def test_another_keyframe_rate_adds_samples(self, store, tmp_path):
        found = diff_of(store, tmp_path, [part(store, "a")], [part(store, "a", keyframe_hz=4.0)])
        (scene,) = found.bags[0].scenes
        assert len(scene.added) >= 5
        assert scene.removed == ()

    def test_settings_splits_and_what_is_left_out(self, store, tmp_path):
        parts = [part(store, "a")]
        was = lock_of(store, tmp_path / "one", parts).bags["a"].split
        splits = Splits(pinned={"a": "val" if was == "train" else "train"})
        found = diff_of(store, tmp_path, parts, parts, splits=splits, skipped={"x": "too short"})
        assert list(found.settings) == ["splits.pinned", "splits.pinned.a"]
        assert found.left_out["skipped"] == {"x": (None, "too short")}
        assert [(bag.key, bag.change, bag.scenes) for bag in found.bags] == [("a", "changed", ())]
        assert found.files == ("splits.json",)

    def test_without_the_artifacts_the_scenes_are_not_known(self, store, tmp_path):
        one = lock_of(store, tmp_path / "one", [part(store, "a", seed=1)])
        other = lock_of(store, tmp_path / "other", [part(store, "a", seed=2)])
        (bag,) = diff_datasets(one, other, Store(tmp_path / "empty")).bags
        assert bag.scenes is None


class TestLocks:
    def test_a_lock_is_found_in_its_folder_and_in_its_dataset(self, store, tmp_path):
        assemble(NUSCENES, [part(store, "a")], SETTINGS, store, tmp_path)
        path = tmp_path / VERSION / "dataset.lock.json"
        assert {load_lock(place).path for place in (path, path.parent, tmp_path)} == {path}

    def test_one_of_several_has_to_be_named(self, store, tmp_path):
        for version in ("v1.0-a", "v1.0-b"):
            assemble(NUSCENES, [part(store, "a")], NuScenes(version=version), store, tmp_path)
        with pytest.raises(DatasetError, match=r"has several \(v1.0-a, v1.0-b\)"):
            load_lock(tmp_path)

    @pytest.mark.parametrize("text", ["", "{}", "[]", '{"format": 2, "bags": [{}], "files": {}}'])
    def test_what_is_no_lock_is_refused(self, tmp_path, text):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(DatasetError, match="expected the lock file of a dataset"):
            load_lock(tmp_path / "x.json")

    @pytest.mark.parametrize("read", [load_lock, locked_artifacts, read_lock])
    def test_words_and_advice_are_for_what_is_wrong(self, tmp_path, monkeypatch, read):
        path = tmp_path / "dataset.lock.json"

        def said():
            with pytest.raises(DatasetError) as caught:
                read(tmp_path if read is read_lock else path)
            return str(caught.value)

        path.write_text("[]")
        assert "(its entries are not those of a lock)" in said()
        path.write_text("{")
        assert "(Expecting property name enclosed in double quotes: line 1" in said()

        def fails(self):
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(self))

        monkeypatch.setattr(Path, "read_bytes", fails)
        assert said().endswith(
            "cannot be read (Input/output error); check the disk or file server, and try again."
        )

    def test_a_folder_without_one(self, tmp_path):
        with pytest.raises(DatasetError, match=r"has no dataset\.lock\.json"):
            load_lock(tmp_path)

    @pytest.mark.parametrize(
        "artifacts", ["", ', "artifacts": []', ', "artifacts": "a"', ', "artifacts": [1]']
    )
    def test_a_lock_that_does_not_say_what_its_dataset_needs_is_refused(self, tmp_path, artifacts):
        row = '{"key": "a", "content": "c", "split": "train", "counts": {}' + artifacts + "}"
        text = '{"format": 2, "dataset": "x", "x": {}, "files": {}, "bags": [' + row + "]}"
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(DatasetError, match=r"x\.json: expected the lock file of a dataset"):
            load_lock(tmp_path / "x.json")
        with pytest.raises(DatasetError, match=r"x\.json: expected the lock file .*names its artifacts"):
            locked_artifacts(tmp_path / "x.json")

    def test_what_a_lock_of_any_format_needs_is_known(self, tmp_path):
        """Also of formats that are not installed, and of later ones that have it at the same place."""
        for version in (2, 3):
            value = {
                "format": version,
                "dataset": "unheard-of",
                "bags": [{"artifacts": ["a", "b"]}, {"artifacts": ["c"]}],
            }
            (tmp_path / "x.json").write_text(json.dumps(value))
            assert locked_artifacts(tmp_path / "x.json") == {"a", "b", "c"}

    def test_a_lock_needs_the_artifacts_that_files_are_linked_from(self, store, tmp_path):
        parts = [part(store, "a"), part(store, "b", seed=1)]
        lock = lock_of(store, tmp_path, parts)
        needs = {a for p in parts for a in [p.artifact, *linked(store, p)]}
        assert locked_artifacts(lock.path) == needs > {p.artifact for p in parts}
        again = lock_of(store, tmp_path, parts, suspects=frozenset())  # from what is on record
        assert again.text == lock.text

    def test_a_later_format_is_reported(self, tmp_path):
        (tmp_path / "x.json").write_text('{"format": 3}')
        with pytest.raises(DatasetError, match="format 3, this version of bagassets knows 2"):
            load_lock(tmp_path / "x.json")


def linked(store, of):
    return {file["artifact"] for file in store.artifact(of.artifact).read_json("files.json")}


class TestRestore:
    @pytest.fixture
    def old(self, store, tmp_path):
        """A dataset with all that a lock can tell, which has changed since its lock was copied."""
        parts = [part(store, "a"), part(store, "b", seed=1), part(store, "copy", content="content-a-0")]
        folder = tmp_path / "dataset"
        splits = Splits(shares={"train": 0.5, "val": 0.5}, seed=3, pinned={"b": "val"})
        left_out = {"skipped": {"calib": "no rig"}, "failed": {"torn": "torn.bag: is truncated."}}
        assemble(NUSCENES, parts, SETTINGS, store, folder, splits=splits, **left_out)
        before = content(folder)
        lock = tmp_path / "old.lock.json"
        shutil.copy(folder / VERSION / "dataset.lock.json", lock)
        assemble(NUSCENES, [part(store, "a", seed=5)], SETTINGS, store, folder)
        return folder, lock, before

    def test_byte_for_byte_elsewhere(self, store, old, tmp_path):
        _, lock, before = old
        made = restore_dataset(load_lock(lock), store, tmp_path / "again")
        assert made == tmp_path / "again" / VERSION
        assert content(tmp_path / "again") == before
        assert check_dataset(tmp_path / "again", VERSION) == []

    def test_byte_for_byte_in_place(self, store, old):
        folder, lock, before = old
        assert content(folder) != before
        restore_dataset(load_lock(lock), store, folder)
        assert content(folder) == before

    def test_a_missing_artifact_is_reported_and_nothing_is_made(self, old, tmp_path):
        _, lock, _ = old
        with pytest.raises(DatasetError, match="artifacts of a, b are not in the store"):
            restore_dataset(load_lock(lock), Store(tmp_path / "empty"), tmp_path / "again")
        assert not (tmp_path / "again").exists()

    def test_other_tables_than_the_lock_says_are_refused(self, store, old, tmp_path):
        folder, lock, _ = old
        value = json.loads(lock.read_bytes())
        value["files"]["sample.json"] = "0" * 64
        lock.write_text(json.dumps(value))
        before = content(folder)
        with pytest.raises(DatasetError, match=r"sample\.json would differ"):
            restore_dataset(load_lock(lock), store, folder)
        assert content(folder) == before

    def test_settings_of_another_version_are_reported(self, store, old, tmp_path):
        _, lock, _ = old
        value = json.loads(lock.read_bytes())
        value["nuscenes"]["novelty"] = 1
        lock.write_text(json.dumps(value))
        with pytest.raises(DatasetError, match="settings are invalid here"):
            restore_dataset(load_lock(lock), store, tmp_path / "again")


class TestCommand:
    @pytest.fixture(scope="class")
    @classmethod
    def project(cls, tmp_path_factory):
        text = RECIPE + "vision: {{output: dataset/vision}}\n"
        recipe = make_project(tmp_path_factory.mktemp("project"), text=text, ros1="a.bag", mcap="c.mcap")
        made = build_all(recipe)
        store = Store(recipe.store_path)
        parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
        assemble(NUSCENES, parts, recipe.nuscenes, store, recipe.nuscenes.output)
        return recipe, parts, made

    def run(self, recipe, *args, status=0):
        command = [
            "dataset",
            args[0],
            "--recipe",
            str(recipe.state.parent / "recipe.yaml"),
            *map(str, args[1:]),
        ]
        result = CliRunner().invoke(root, command, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        assert (result.return_value or 0) == status, result.output
        return result.stdout

    def test_diff_as_text_and_as_json(self, project, tmp_path):
        recipe, parts, _ = project
        assemble(NUSCENES, parts[:1], recipe.nuscenes, Store(recipe.store_path), tmp_path)
        text = self.run(recipe, "diff", tmp_path, recipe.nuscenes.output, status=3)
        assert "1 recording, 1 scene, 6 samples" in text
        assert "+ c.mcap: 1 scene, 6 samples, split " in text
        found = json.loads(self.run(recipe, "diff", tmp_path, recipe.nuscenes.output, "--json", status=3))
        assert (found["same"], found["a"]["samples"], found["b"]["samples"]) == (False, 6, 12)
        (bag,) = found["bags"]
        assert (bag["key"], bag["change"], bag["before"]) == ("c.mcap", "added", None)
        assert len(bag["scenes"][0]["samples_added"]) == 6
        same = self.run(recipe, "diff", recipe.nuscenes.output, recipe.nuscenes.output)
        assert same.endswith("The datasets are the same.\n")

    def test_restore_beside_the_dataset_by_default_and_in_place_if_the_lock_is_there(self, project, tmp_path):
        recipe, _, _ = project
        dataset = recipe.nuscenes.output
        lock = tmp_path / "may.json"
        shutil.copy(dataset / VERSION / "dataset.lock.json", lock)
        text = self.run(recipe, "restore", lock)
        made = next(path for path in dataset.parent.iterdir() if path.name.startswith("nuscenes-"))
        assert str(made) in text
        assert content(made) == content(dataset)
        before = content(dataset)
        next((dataset / "samples" / "CAM_FRONT").iterdir()).unlink()
        reported = json.loads(self.run(recipe, "restore", dataset, "--json"))
        assert (reported["folder"], reported["lock"]["samples"]) == (str(dataset / VERSION), 12)
        assert content(dataset) == before

    def test_a_vision_dataset(self, project, tmp_path):

        recipe, _, made = project
        store = Store(recipe.store_path)
        parts = [Part(k, k, assets["vision_sequences"].artifact.digest) for k, assets in made.items()]
        assemble(VISION, parts, recipe.vision, store, recipe.vision.output, splits=recipe.splits)
        lock = recipe.vision.output / "annotations" / "dataset.lock.json"
        self.run(recipe, "restore", lock, "--output", tmp_path / "again")
        assert content(tmp_path / "again") == content(recipe.vision.output)
        assemble(
            VISION,
            parts[:1],
            recipe.vision.model_copy(update={"output": tmp_path / "one"}),
            store,
            recipe.vision.model_copy(update={"output": tmp_path / "one"}).output,
            splits=recipe.splits,
        )
        assert "+ c.mcap: " in self.run(recipe, "diff", tmp_path / "one", lock, status=3)
        with pytest.raises(DatasetError, match="name two of one kind"):
            self.run(recipe, "diff", recipe.nuscenes.output, lock)


NUMBER = 104


class TestMoreThanAHundredRecordings:
    """Dagster does not look at data versions across so many partitions; `dataset_inputs` does."""

    @pytest.fixture
    def project(self, tmp_path):
        (tmp_path / "bags").mkdir()
        for i in range(NUMBER):
            write_tiny(tmp_path / "bags" / f"{i:03d}.mcap", str(i))
        recipe = make_project(tmp_path, text=RECIPE + "preview: {{enabled: false}}\n")
        recipe_file = tmp_path / "recipe.yaml"
        with dg.DagsterInstance.ephemeral() as instance:  # in memory: hundreds of events take no time
            keys = [f"{i:03d}.mcap" for i in range(NUMBER)]
            instance.add_dynamic_partitions(Naming(recipe.name).partitions, keys)
            for key in keys:
                self.materialize(instance, recipe, key)
            yield instance, Workspace(recipe_file=str(recipe_file))

    def materialize(self, instance, recipe, key):
        """Build a recording, and record what the dataset is made from as a run would."""
        build = build_of(recipe, key)
        made = {result.asset: result.artifact.digest for result in build.build()}
        _, digest, stat = build.facts
        for asset, version, metadata in (
            ("bag", digest, {STAT: dg.MetadataValue.text(json.dumps(stat.as_json()))}),
            ("nuscenes_tables", made["nuscenes_tables"], {}),
        ):
            tags = {"dagster/data_version": version}
            instance.report_runless_asset_event(
                dg.AssetMaterialization(asset, partition=key, tags=tags, metadata=metadata)
            )

    def update(self, instance, workspace):
        """Do what the build does at its end."""
        inputs = select_inputs(plan_instance(workspace.on(instance)))
        record_inputs(workspace.on(instance), inputs)
        job = build_definitions(Path(workspace.recipe_file)).resolve_implicit_global_asset_job_def()
        result = job.execute_in_process(instance=instance, asset_selection=[dg.AssetKey("nuscenes_dataset")])
        assert result.success

    def files(self, output):
        """Every file of a recording: name -> inode."""
        return {
            path.relative_to(output).as_posix(): path.stat().st_ino
            for folder in ("samples", "sweeps")
            for path in (output / folder).rglob("*.*")
        }

    def is_current(self, instance, workspace):
        return dataset_is_current(
            workspace.on(instance), select_inputs(plan_instance(workspace.on(instance)))
        )

    def test_a_change_and_a_removal_are_noticed_and_only_they_cost_anything(self, project):
        instance, workspace = project
        recipe = workspace.recipe
        assert not self.is_current(instance, workspace)
        self.update(instance, workspace)
        output = recipe.nuscenes.output
        assert len(read_lock(output / VERSION).value["bags"]) == NUMBER
        assert self.is_current(instance, workspace)
        files = self.files(output)
        assert {recording_of(name) for name in files} == {f"{i:03d}.mcap" for i in range(NUMBER)}

        # One recording changes, its messages do not: no file is linked anew.
        write_tiny(recipe.bags.root / "042.mcap", "changed")
        self.materialize(instance, recipe, "042.mcap")
        assert not self.is_current(instance, workspace)
        self.update(instance, workspace)
        assert self.files(output) == files
        assert self.is_current(instance, workspace)

        # One is removed: its scenes and files go, all others stay as they are.
        (recipe.bags.root / "017.mcap").unlink()
        instance.delete_dynamic_partition(Naming(recipe.name).partitions, "017.mcap")
        assert not self.is_current(instance, workspace)
        self.update(instance, workspace)
        assert self.files(output) == {n: i for n, i in files.items() if recording_of(n) != "017.mcap"}
        assert len(read_lock(output / VERSION).value["bags"]) == NUMBER - 1
        assert check_dataset(output, VERSION) == []
        assert self.is_current(instance, workspace)
