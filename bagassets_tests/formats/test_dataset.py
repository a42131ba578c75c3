"""Datasets: the same bytes in whatever way they came about, swapped in whole, nothing left behind."""

import json
import os
import random
import shutil
import threading
from contextlib import suppress

import pytest
from handmade import Drive, make_tables

from bagassets.base import files
from bagassets.base.errors import DatasetError, StoreError
from bagassets.formats import linking
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.dataset_rows import file_sizes
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.schema import TABLES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.formats.nuscenes.table_integrity import check_files
from bagassets.recipe.model_splits import Splits
from bagassets.store.store import Store
from bagassets_tests.nuscenes_checks import check_dataset, check_tables

pytestmark = pytest.mark.once

VERSION = "v1.0-test"
SETTINGS = NuScenes(version=VERSION)
SPLITS = Splits(shares={"train": 0.5, "night": 0.5})


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def parts(store):
    drives = [Drive(seconds=2.0, seed=seed, channels=("CAM_FRONT", "LIDAR_TOP")) for seed in range(4)]
    return [
        Part(f"drive_{i}", f"content-{i}", make_tables(store, drive, key=f"drive_{i}").artifact.digest)
        for i, drive in enumerate(drives)
    ]


def content(root):
    """Every file below a folder, but for guards of processes."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and not path.name.startswith(".bagassets")
    }


def tables(root, version=VERSION):
    return {name: read_table(root / version, name) for name in TABLES}


class TestContent:
    def test_tables_and_files_fit_together(self, store, parts, tmp_path):
        made = assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assert check_tables(tables(tmp_path)) == []
        assert check_files(file_sizes(tmp_path), tables(tmp_path)) == []
        assert check_dataset(tmp_path, VERSION) == []
        assert made.facts["rows"] == {name: len(rows) for name, rows in tables(tmp_path).items()}
        assert made.facts["rows"]["scene"] == 4
        assert {path.name for path in tmp_path.iterdir()} - {".bagassets.lock"} == {
            "samples",
            "sweeps",
            "maps",
            VERSION,
        }

    def test_shared_rows_come_once_from_the_recipe_and_the_recordings(self, store, parts, tmp_path):
        named = [{"name": "animal", "description": "Dogs."}, {"name": "vehicle.car"}]
        assemble(NUSCENES, parts, NuScenes(version=VERSION, categories=named), store, tmp_path)
        categories = [(row["name"], row["description"]) for row in tables(tmp_path)["category"]]
        assert categories == [("animal", "Dogs."), ("vehicle.car", ""), ("human.pedestrian.adult", "")]
        assert [row["level"] for row in tables(tmp_path)["visibility"]] == [
            "v0-40",
            "v40-60",
            "v60-80",
            "v80-100",
        ]
        assert [row["channel"] for row in tables(tmp_path)["sensor"]] == ["CAM_FRONT", "LIDAR_TOP"]

    def test_every_log_is_on_the_one_map(self, store, parts, tmp_path):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        (row,) = tables(tmp_path)["map"]
        assert set(row["log_tokens"]) == {log["token"] for log in tables(tmp_path)["log"]}
        assert (tmp_path / row["filename"]).read_bytes().startswith(b"\x89PNG")

    def test_splits_have_our_names_and_whole_recordings(self, store, parts, tmp_path):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path, splits=SPLITS)
        splits = json.loads((tmp_path / VERSION / "splits.json").read_bytes())
        assert set(splits) == {"custom_train", "night"}
        named = [name for scenes in splits.values() for name in scenes]
        assert sorted(named) == [row["name"] for row in tables(tmp_path)["scene"]]
        lock = read_lock(tmp_path / VERSION).value
        for bag in lock["bags"]:
            name = "custom_train" if bag["split"] == "train" else bag["split"]
            assert f"{bag['key']}_000" in splits[name]

    def test_the_lock_says_what_went_in_and_what_did_not(self, store, parts, tmp_path):
        reasons = {"skipped": {"calib": "no rig matches"}, "failed": {"torn": "torn.bag: is truncated."}}
        assemble(NUSCENES, parts[:2], SETTINGS, store, tmp_path, **reasons)
        lock = read_lock(tmp_path / VERSION).value
        assert [(bag["key"], bag["content"], bag["artifacts"][0]) for bag in lock["bags"]] == [
            (part.key, part.content, part.artifact) for part in parts[:2]
        ]
        assert (lock["skipped"], lock["failed"]) == (reasons["skipped"], reasons["failed"])
        again = [Part(bag["key"], bag["content"], bag["artifacts"][0]) for bag in lock["bags"]]
        settings = NuScenes.model_validate(lock["nuscenes"])
        assert (
            assemble(NUSCENES, again, settings, store, tmp_path / "again").digest
            == assemble(NUSCENES, parts[:2], SETTINGS, store, tmp_path).digest
        )

    def test_equal_content_enters_once_under_the_first_key(self, store, parts, tmp_path):
        copy = Part("a_copy", parts[0].content, parts[0].artifact)
        made = assemble(NUSCENES, [*parts, copy], SETTINGS, store, tmp_path)
        assert made.duplicates == {"drive_0": "a_copy"}
        assert made.facts["rows"]["scene"] == 4
        assert read_lock(tmp_path / VERSION).value["duplicates"] == {"drive_0": "a_copy"}

    def test_without_recordings_it_is_a_dataset_of_empty_tables(self, store, parts, tmp_path):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        made = assemble(NUSCENES, [], SETTINGS, store, tmp_path)
        assert made.facts["rows"]["sample"] == 0
        assert made.facts["rows"]["map"] == 1
        assert check_dataset(tmp_path, VERSION) == []
        assert not list((tmp_path / "samples").iterdir())


class TestDeterminism:
    def test_order_and_folder_make_no_difference(self, store, parts, tmp_path):
        shuffled = random.Random(1).sample(parts, len(parts))
        one = assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "one")
        other = assemble(NUSCENES, shuffled, SETTINGS, store, tmp_path / "deep" / "other")
        assert content(tmp_path / "one") == content(tmp_path / "deep" / "other")
        assert one.digest == other.digest

    def test_history_makes_no_difference(self, store, parts, tmp_path):
        for chosen in (parts[:1], parts[1:], [], parts[2:3], parts):
            assemble(NUSCENES, chosen, SETTINGS, store, tmp_path / "grown")
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "fresh")
        assert content(tmp_path / "grown") == content(tmp_path / "fresh")

    def test_no_table_is_rewritten_for_another_recording(self, store, parts, tmp_path):
        """Rows of a recording are the same lines whatever else is in the dataset."""
        assemble(NUSCENES, parts[:1], SETTINGS, store, tmp_path / "one")
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "all")
        for name in ("scene", "sample", "sample_data", "sample_annotation", "ego_pose", "calibrated_sensor"):
            alone, among = tables(tmp_path / "one")[name], tables(tmp_path / "all")[name]
            assert among[: len(alone)] == alone


class TestIncrement:
    def test_only_new_and_removed_files_are_touched(self, store, parts, tmp_path):
        first = assemble(NUSCENES, parts[:3], SETTINGS, store, tmp_path)
        per_bag = first.files["linked"] // 3
        before = {
            name: (tmp_path / name).stat().st_ctime_ns for name in content(tmp_path) if name.startswith("s")
        }
        more = assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assert (more.files["linked"], more.files["removed"]) == (per_bag, 0)
        assert all((tmp_path / name).stat().st_ctime_ns == ctime for name, ctime in before.items())
        fewer = assemble(NUSCENES, parts[1:], SETTINGS, store, tmp_path)
        assert fewer.files["removed"] == per_bag
        assert check_dataset(tmp_path, VERSION) == []

    def test_files_of_recordings_that_stay_are_not_even_looked_at(self, store, parts, tmp_path, monkeypatch):
        per_bag = assemble(NUSCENES, parts[:3], SETTINGS, store, tmp_path).files["linked"] // 3
        put = []
        monkeypatch.setattr(linking.Linker, "put", lambda _, source, name, **_kind: put.append(name))
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path, suspects=frozenset())
        assert len(put) == per_bag
        assert all("/drive_3-" in name for name in put)

    def test_nothing_new_changes_nothing(self, store, parts, tmp_path):
        assert assemble(NUSCENES, parts, SETTINGS, store, tmp_path).changed
        inode = (tmp_path / VERSION).stat().st_ino
        assert not assemble(NUSCENES, parts, SETTINGS, store, tmp_path).changed
        assert (tmp_path / VERSION).stat().st_ino == inode

    def test_a_file_that_somebody_removed_comes_back(self, store, parts, tmp_path):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        victim = tmp_path / tables(tmp_path)["sample_data"][5]["filename"]
        victim.unlink()
        assert check_dataset(tmp_path, VERSION) != []
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assert check_dataset(tmp_path, VERSION) == []

    def test_changed_content_gets_other_names(self, store, parts, tmp_path):
        """Old tables, still in a reader's memory, must never lead to new content."""
        drive = Drive(seconds=2.0, seed=99, channels=("CAM_FRONT", "LIDAR_TOP"))
        changed = Part("drive_0", "other", make_tables(store, drive, key="drive_0").artifact.digest)
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        old = content(tmp_path / "samples")
        assemble(NUSCENES, [changed, *parts[1:]], SETTINGS, store, tmp_path)
        new = content(tmp_path / "samples")
        assert all(new[name] == old[name] for name in new.keys() & old.keys())
        assert len(new.keys() - old.keys()) == len(old.keys() - new.keys()) == 8
        assert check_dataset(tmp_path, VERSION) == []

    def test_versions_share_a_dataroot_and_its_files(self, store, parts, tmp_path):
        other = SETTINGS.model_copy(update={"version": "v1.0-other"})
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assemble(NUSCENES, parts[:1], other, store, tmp_path)
        assemble(NUSCENES, [], SETTINGS, store, tmp_path)
        assert check_dataset(tmp_path, "v1.0-other") == []
        assert check_dataset(tmp_path, VERSION) == []

    def test_files_of_others_are_left_alone(self, store, parts, tmp_path):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        notes = tmp_path / "samples" / "CAM_FRONT" / "notes.txt"
        notes.write_text("mine")
        assemble(NUSCENES, [], SETTINGS, store, tmp_path)
        assert notes.read_text() == "mine"

    def test_a_version_folder_of_somebody_else_is_never_replaced(self, store, parts, tmp_path):
        (tmp_path / VERSION).mkdir()
        (tmp_path / VERSION / "scene.json").write_text("[]")
        with pytest.raises(DatasetError, match="was not made by bagassets"):
            assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assert (tmp_path / VERSION / "scene.json").read_text() == "[]"


class TestCrashes:
    @pytest.mark.parametrize("moment", ["files", "swap", "cleaning"])
    def test_a_killed_run_leaves_a_dataset_and_the_next_one_clears_up(
        self, store, parts, tmp_path, monkeypatch, moment
    ):
        class KilledError(Exception):
            pass

        calls = []

        def kill(*args, **kwargs):
            calls.append(args)
            if moment != "files" or len(calls) > 20:
                raise KilledError
            return put(*args, **kwargs)

        put = linking.Linker.put
        target = {
            "files": "bagassets.formats.linking.Linker.put",
            "swap": "bagassets.formats.assembly.swap_in",
            "cleaning": "bagassets.formats.assembly.remove_files",
        }[moment]
        assemble(NUSCENES, parts[:2], SETTINGS, store, tmp_path)
        with monkeypatch.context() as patch, suppress(KilledError):
            patch.setattr(target, kill)
            assemble(NUSCENES, parts[2:], SETTINGS, store, tmp_path)
        assert calls
        assert check_tables(tables(tmp_path)) == []
        missing = [
            text for text in check_files(file_sizes(tmp_path), tables(tmp_path)) if "not on disk" in text
        ]
        assert missing == []
        assemble(NUSCENES, parts[1:2], SETTINGS, store, tmp_path)
        assert check_dataset(tmp_path, VERSION) == []
        assemble(NUSCENES, parts[1:2], SETTINGS, store, tmp_path / "fresh")
        fresh = content(tmp_path / "fresh")
        assert {
            name: data for name, data in content(tmp_path).items() if not name.startswith("fresh/")
        } == fresh

    def test_an_artifact_that_is_not_in_the_store_is_named_and_the_old_dataset_stays(
        self, store, parts, tmp_path
    ):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        before = content(tmp_path)
        with pytest.raises(StoreError, match="artifact ffffffffffffffff is not in the store"):
            assemble(NUSCENES, [Part("x", "y", "f" * 64)], SETTINGS, store, tmp_path)
        assert content(tmp_path) == before

    def test_readers_never_see_half_a_dataset(self, store, parts, tmp_path):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        done = threading.Event()
        problems = []

        def read():
            while not done.is_set():
                # One open folder is one state, as the exchange leaves it intact.
                folder = os.open(tmp_path / VERSION, os.O_RDONLY)
                try:
                    with os.fdopen(os.open("scene.json", os.O_RDONLY, dir_fd=folder)) as file:
                        scenes = json.load(file)
                    with os.fdopen(os.open("sample.json", os.O_RDONLY, dir_fd=folder)) as file:
                        samples = json.load(file)
                except FileNotFoundError:
                    continue  # the folder was retired while we held it; the next look finds the new one
                finally:
                    os.close(folder)
                if len(samples) != 4 * len(scenes):
                    problems.append((len(scenes), len(samples)))

        readers = [threading.Thread(target=read) for _ in range(2)]
        for reader in readers:
            reader.start()
        try:
            for number in range(20):
                assemble(NUSCENES, parts[: 1 + number % 4], SETTINGS, store, tmp_path)
                assert (tmp_path / VERSION / "map.json").is_file()
        finally:
            done.set()
            for reader in readers:
                reader.join()
        assert problems == []


class TestChangedByOthers:
    """What somebody else changed is fixed: all of it if nobody says what, else what is said."""

    @pytest.mark.parametrize("which", ["a file", "a table", "a channel", "the lock"])
    def test_what_is_gone_is_made_again(self, store, parts, tmp_path, which):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        whole = content(tmp_path)
        if which == "a file":
            (tmp_path / tables(tmp_path)["sample_data"][0]["filename"]).unlink()
        elif which == "a table":
            (tmp_path / VERSION / "sample.json").unlink()
        elif which == "a channel":
            shutil.rmtree(tmp_path / "samples" / "CAM_FRONT")
        else:
            shutil.rmtree(tmp_path / VERSION)
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assert content(tmp_path) == whole

    @pytest.mark.parametrize("suspects", [None, frozenset()])
    def test_a_table_of_the_same_size_with_other_bytes_is_exchanged(self, store, parts, tmp_path, suspects):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        whole = content(tmp_path)
        path = tmp_path / VERSION / "sample.json"
        path.write_bytes(b"?" * path.stat().st_size)
        assert assemble(NUSCENES, parts, SETTINGS, store, tmp_path, suspects=suspects).changed
        assert content(tmp_path) == whole

    def test_suspects_are_compared_with_what_belongs_there_and_others_left_alone(
        self, store, parts, tmp_path
    ):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        whole = content(tmp_path)
        names = [row["filename"] for row in tables(tmp_path)["sample_data"][:4]]
        spoiled, same, gone, _ = (tmp_path / name for name in names)
        for path, text in ((spoiled, b"?"), (same, same.read_bytes())):
            path.unlink()
            path.write_bytes(text)
        inode = same.stat().st_ino
        gone.unlink()
        beside = tmp_path / "samples" / "CAM_FRONT" / "notes.txt"
        beside.write_text("mine")
        made = assemble(NUSCENES, parts, SETTINGS, store, tmp_path, suspects=frozenset(names[:3]))
        assert (made.files["linked"], made.files["kept"]) == (2, 1)
        assert same.stat().st_ino == inode
        assert beside.read_text() == "mine"
        beside.unlink()
        assert content(tmp_path) == whole


class TestFileSystems:
    def test_files_are_hard_links_into_the_store(self, store, parts, tmp_path):
        made = assemble(NUSCENES, parts[:1], SETTINGS, store, tmp_path)
        assert made.files["linked"] == made.facts["rows"]["sample_data"]
        assert (tmp_path / tables(tmp_path)["sample_data"][0]["filename"]).stat().st_nlink >= 2

    def test_without_hard_links_they_are_copied(self, store, parts, tmp_path, monkeypatch):
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "linked")

        def refuse(*args):
            raise OSError(18, "Invalid cross-device link")

        monkeypatch.setattr(linking.os, "link", refuse)
        made = assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "copied")
        assert made.files.get("copied", 0) + made.files.get("cloned", 0) == made.facts["rows"]["sample_data"]
        assert content(tmp_path / "copied") == content(tmp_path / "linked")
        nothing = frozenset()
        assert assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "copied", suspects=nothing).files == {
            "removed": 0
        }
        os.utime(tmp_path / "copied" / "samples")  # somebody was there: now every file is looked at
        assert (
            assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "copied").files["kept"]
            == made.facts["rows"]["sample_data"]
        )

    def test_without_an_exchange_folders_are_renamed(self, store, parts, tmp_path, monkeypatch):
        monkeypatch.setattr(files, "_rename", lambda *_: False)
        assemble(NUSCENES, parts, SETTINGS, store, tmp_path)
        assemble(NUSCENES, parts[:1], SETTINGS, store, tmp_path)
        assert check_dataset(tmp_path, VERSION) == []
        assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == [
            "maps",
            "samples",
            "sweeps",
            VERSION,
        ]

    def test_a_dataroot_that_cannot_be_written_is_named(self, store, parts, tmp_path):
        (tmp_path / "file").write_text("")
        with pytest.raises(DatasetError, match="file: the dataset cannot be written"):
            assemble(NUSCENES, parts, SETTINGS, store, tmp_path / "file")


class TestChecks:
    """Each check finds the damage that it is for."""

    @pytest.fixture
    def rows(self, store, parts, tmp_path):
        assemble(NUSCENES, parts[:1], SETTINGS, store, tmp_path)
        return tables(tmp_path)

    @pytest.mark.parametrize(
        ("table", "damage", "words"),
        [
            ("sample", lambda rows: rows.append(dict(rows[0])), "sample: 1 token appears more than once: "),
            ("sample_data", lambda rows: rows[0].update(sample_token="x"), "1 value of sample_token is in no row of sample"),
            ("sample_data", lambda rows: rows[3].update(next=""), "links of prev and next are broken"),
            ("sample_data", lambda rows: rows[0].update(is_key_frame="true"), "is_key_frame is not a JSON boolean"),
            ("sample_data", lambda rows: rows[0].update(filename=rows[1]["filename"]), "named by more than one row"),
            ("sample", lambda rows: rows.pop(), "scene: 1 row disagrees with its rows of sample"),
            ("instance", lambda rows: rows[0].update(nbr_annotations=1), "instance: 1 row disagrees"),
            ("map", lambda rows: rows[0].update(log_tokens=[]), "log: 1 is on no map"),
            ("sample_annotation", lambda rows: rows[0].update(visibility_token="9"), "visibility"),
        ],
    )  # fmt: skip
    def test_damage_is_found(self, rows, table, damage, words):
        damage(rows[table])
        assert any(words in problem for problem in check_tables(rows))

    def test_files_that_are_missing_left_over_or_empty_are_found(self, rows, tmp_path):
        named = [row["filename"] for row in rows["sample_data"] if row["fileformat"] == "jpg"]
        (tmp_path / named[0]).unlink()
        (tmp_path / named[1]).unlink()
        (tmp_path / named[1]).write_bytes(b"")
        (tmp_path / "samples" / "stray.jpg").write_bytes(b"x")
        problems = check_files(file_sizes(tmp_path), rows)
        assert problems == [
            f"1 file of the tables is not on disk: {named[0]}.",
            "1 file on disk belongs to no table: samples/stray.jpg.",
            f"1 file is empty: {named[1]}.",
        ]
