"""One more recording, one less: what is encoded, joined and linked again, and that history leaves no trace."""

import json
import os
from pathlib import Path

import pytest

from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import load_lock
from bagassets.formats.dataset_restore import restore_dataset
from bagassets.formats.lerobot import join as joining
from bagassets.formats.lerobot import recording_part, video
from bagassets.formats.lerobot.format import LEROBOT
from bagassets.recipe.model_splits import Splits
from bagassets.store.store import Store
from bagassets_tests.arm_recordings import RECIPE, join, make_project, parts_of, write_arm

pytestmark = pytest.mark.once

NAMES = [f"r{n:02d}" for n in range(8)]


def files_of(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(Path(root).rglob("*"))
        if path.is_file()
    }


def inodes(root, kind):
    return {path.stat().st_ino for path in Path(root).rglob(kind)}


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.setattr(joining, "_USUAL_S", 2)
    monkeypatch.setattr(joining, "_USUAL_DATA", 3000)
    for number, name in enumerate(NAMES):
        write_arm(tmp_path, name, seconds=1.0, first=100 * number)
    return make_project(tmp_path)


@pytest.fixture
def root(project):
    return project.lerobot.output / "v3.0"


def test_adding_one_encodes_one_and_joins_one_file_of_each_camera(project, root, monkeypatch):
    encoded = []
    monkeypatch.setattr(recording_part, "encode", lambda *a: encoded.append(1) or video.encode(*a))
    parts, _ = parts_of(project)
    assert len(encoded) == len(NAMES)
    join(project, parts)
    before = inodes(root, "*.mp4")
    assert len(before) > 2
    write_arm(root.parents[2], "r03b", seconds=1.0, first=5000)
    parts, _ = parts_of(project)
    assert len(encoded) == len(NAMES) + 1
    summary = join(project, parts, suspects=frozenset())
    new = inodes(root, "*.mp4") - before
    assert 1 <= len(new) <= 2
    assert summary.facts["episodes"] == len(NAMES) + 1
    assert summary.facts["renumbered"]["r04.mcap"] == "episodes 4..4 are 5..5 now"
    assert "r03.mcap" not in summary.facts["renumbered"]


def test_nothing_shows_in_which_order_recordings_came_and_went(project, root, tmp_path):
    parts, _ = parts_of(project)
    join(project, parts)
    whole = files_of(root)
    for some in (parts[:3], parts[2:], parts[::2], parts):
        summary = join(project, some, suspects=frozenset())
    assert files_of(root) == whole
    assert summary.changed
    fresh = project.model_copy(
        update={"lerobot": project.lerobot.model_copy(update={"output": tmp_path / "fresh"})}
    )
    join(fresh, list(reversed(parts)))
    assert files_of(tmp_path / "fresh/v3.0") == whole


def test_removing_one_leaves_numbers_dense_and_says_which_moved(project, root):
    parts, _ = parts_of(project)
    join(project, parts)
    summary = join(project, [parts[0], *parts[2:]], suspects=frozenset())
    assert summary.facts["episodes"] == 7
    assert summary.facts["renumbered"] == {
        f"{name}.mcap": f"episodes {n}..{n} are {n - 1}..{n - 1} now" for n, name in enumerate(NAMES) if n > 1
    }
    assert len(json.loads((root / "meta/bagassets.json").read_text())["episodes"]) == 7


@pytest.mark.parametrize("gone", range(3))
def test_what_is_linked_is_what_would_be_written(project, root, tmp_path, gone):
    """Where numbers moved, rows of the same episodes are others."""
    parts, _ = parts_of(project)
    join(project, parts)
    join(project, parts[:gone] + parts[gone + 1 :], suspects=frozenset())
    fresh = project.lerobot.model_copy(update={"output": tmp_path / "fresh"})
    join(project.model_copy(update={"lerobot": fresh}), parts[:gone] + parts[gone + 1 :])
    assert files_of(root) == files_of(tmp_path / "fresh/v3.0")


def test_one_at_the_end_leaves_rows_alone_too(project, root):
    parts, _ = parts_of(project)
    join(project, parts[:-1])
    before = inodes(root, "*.parquet")
    join(project, parts, suspects=frozenset())
    assert len(inodes(root / "data", "*.parquet") - before) == 1
    assert len(inodes(root / "data", "*.parquet")) > 2


def test_a_file_that_somebody_changed_is_joined_again(project, root):
    parts, _ = parts_of(project)
    join(project, parts)
    whole = files_of(root)
    name = next(name for name in whole if name.endswith(".mp4"))
    (root / name).unlink()
    (root / name).write_bytes(b"not a video")
    join(project, parts, suspects=frozenset({f"v3.0/{name}"}))
    assert files_of(root) == whole


def test_what_is_kept_is_a_link_and_the_old_folder_is_gone(project, root):
    parts, _ = parts_of(project)
    join(project, parts)
    join(project, parts[:-1], suspects=frozenset())
    assert all(os.stat(path).st_nlink == 1 for path in root.rglob("*.mp4"))
    assert not list(root.parent.glob("*.tmp-*"))


def test_a_lock_restores_the_dataset_byte_for_byte(project, root, tmp_path):
    parts, _ = parts_of(project)
    join(project, parts)
    lock = load_lock(root)
    restored = restore_dataset(lock, Store(project.store_path), tmp_path / "restored")
    assert files_of(restored) == files_of(root)


def test_recordings_that_do_not_fit_are_left_out_with_the_reason(tmp_path):
    for number, (name, size) in enumerate((("a", (64, 64)), ("b", (64, 96)), ("c", (64, 64)))):
        write_arm(tmp_path, name, seconds=1.0, first=100 * number, size=size)
    recipe = make_project(tmp_path)
    parts, _ = parts_of(recipe)
    join(recipe, parts)
    lock = load_lock(recipe.lerobot.output / "v3.0")
    assert list(lock.bags) == ["a.mcap", "c.mcap"]
    assert lock.value["skipped"] == {
        "b.mcap": "observation.images.wrist has the shape 64, 96, 3 from its first frame on, but 64, 64, 3 in most recordings, such as "
        "a.mcap; a LeRobot dataset has one. Give its rig a dataset of its own, or correct the recipe."
    }


def test_splits_are_ranges_of_episodes(project, root):
    parts, _ = parts_of(project)
    dealt = {part.key: "val" if n in {2, 5} else "train" for n, part in enumerate(parts)}
    splits = Splits(shares={"train": 0.8, "val": 0.2})
    assemble(
        LEROBOT,
        parts,
        project.lerobot,
        Store(project.store_path),
        project.lerobot.output,
        splits=splits,
        dealt=dealt,
    )
    assert json.loads((root / "meta/info.json").read_text())["splits"] == {"train": "0:6", "val": "6:8"}
    order = [one["recording"] for one in json.loads((root / "meta/bagassets.json").read_text())["episodes"]]
    assert order[6:] == ["r02.mcap", "r05.mcap"]


def test_changing_the_task_in_the_recipe_encodes_nothing(project, root, monkeypatch):
    parts, _ = parts_of(project)
    monkeypatch.setattr(recording_part, "encode", None)
    other = make_project(root.parents[2], RECIPE.replace("Lift the cube.", "Drop it."))
    again, _ = parts_of(other)
    assert again == parts


def test_no_recording_makes_an_empty_dataset(project, root):
    join(project, [])
    assert json.loads((root / "meta/info.json").read_text())["total_episodes"] == 0
