"""What was published is compared with what is there: replaced, torn and missing files are noticed and fixed."""

import errno
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, signature
from bagassets.engine.freshness import decide
from bagassets.engine.freshness.decide import BuildLog, nothing_to_do
from bagassets.engine.freshness.published import Publication
from bagassets.forkserver.process import ProcessId
from bagassets.formats import after_crash
from bagassets.recipe import load_recipe
from bagassets_tests.file_clock import next_tick
from bagassets_tests.in_process import build, make_project, survey
from bagassets_tests.small_drive import RECIPE

pytestmark = pytest.mark.once

TEXT = RECIPE + "vision: {{output: dataset/vision, frames: 5}}\ndatasets:\n  - {{name: all}}\n"
ASSETS = ["nuscenes_dataset", "vision_dataset", "dataset_all", "trajectory_map"]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("published"), ["a.bag", "b.mcap"], text=TEXT, duration_s=2.0)


@pytest.fixture
def fresh(project, monkeypatch):
    report, _ = build(project, monkeypatch)
    assert report.succeeded, report.as_json()
    assert is_quick(project)
    return project


def forget(recipe_file, asset):
    """Have nothing on record of a dataset."""
    changes = Changes()
    changes.drop("published", asset)
    Cache(load_recipe(recipe_file).state).write(changes)


def is_quick(recipe_file):
    return nothing_to_do(["build", "--recipe", str(recipe_file)]) is not None


def everything(recipe_file):
    """Path -> bytes of all that is published, without what differs between builds."""
    recipe = load_recipe(recipe_file)
    files = [path for path in (recipe_file.parent / "dataset").rglob("*") if path.is_file()]
    return {path: path.read_bytes() for path in [*files, recipe.state / "trajectory_map.html"]}


def first(recipe_file, pattern):
    return next(iter(sorted((recipe_file.parent / "dataset").glob(pattern))))


def empty_list(path):
    path.write_bytes(b"[]")


def same_size(path):
    """Other bytes, with size and time of writing put back."""
    stat = path.stat()
    next_tick()
    path.chmod(0o644)
    path.write_bytes(b"\0" * stat.st_size)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def replaced(path):
    """A file of the same size moved over it."""
    other = path.with_name("other")
    next_tick()
    other.write_bytes(b"?" * path.stat().st_size)
    other.replace(path)


PUBLISHED = [
    ("nuscenes/v1.0-test/sample.json", empty_list),
    ("nuscenes/v1.0-test/sample.json", same_size),
    ("nuscenes/v1.0-test/splits.json", replaced),
    ("nuscenes/v1.0-test/dataset.lock.json", Path.unlink),
    ("nuscenes/v1.0-test/dataset.lock.json", same_size),
    ("nuscenes/v1.0-test/dataset.lock.json", empty_list),
    ("nuscenes/maps/*.png", empty_list),
    ("nuscenes/samples/CAM_FRONT/*", replaced),
    ("nuscenes/samples/LIDAR_TOP/*", Path.unlink),
    ("all/v1.0-test/scene.json", empty_list),
    ("all/sweeps/CAM_FRONT/*", replaced),
    ("vision/annotations/train.json", same_size),
    ("vision/annotations/dataset.lock.json", empty_list),
    ("vision/recordings/*/metadata.json", replaced),
    ("vision/recordings/*/CAM_FRONT/*/*", replaced),
    ("../.bagassets/trajectory_map.html", empty_list),
]


@pytest.mark.parametrize(("pattern", "change"), PUBLISHED)
def test_a_published_file_that_is_not_as_it_was_is_mended(fresh, monkeypatch, pattern, change):
    whole = everything(fresh)
    change(first(fresh, pattern))
    assert everything(fresh) != whole
    assert not is_quick(fresh)
    assert not survey(fresh).dataset_is_current
    report, runs = build(fresh, monkeypatch)
    assert (report.dataset, [key for key, _ in runs]) == ("updated", [None])
    assert everything(fresh) == whole
    assert is_quick(fresh)


@pytest.mark.parametrize(
    "pattern", ["nuscenes/samples/*/*", pytest.param("vision/**/*.jpg", marks=pytest.mark.long)]
)
@pytest.mark.parametrize("change", ["emptied", "other bytes"])
def test_a_link_that_was_written_into_is_made_again_with_the_file_of_the_store(
    fresh, monkeypatch, pattern, change
):
    """Both are one file, so that linking it again would fix nothing."""
    whole = everything(fresh)
    path = first(fresh, pattern)
    assert path.stat().st_nlink > 1
    path.chmod(0o644)
    path.write_bytes(b"" if change == "emptied" else bytes(path.stat().st_size))
    assert not is_quick(fresh)
    report, _ = build(fresh, monkeypatch)
    assert report.succeeded
    assert everything(fresh) == whole
    # It may go by another name: recordings with the same images share their files.
    changed, same = report.remarks
    assert changed.problem.endswith(": was changed in place, so it is made again")
    report, runs = build(fresh, monkeypatch)
    assert not runs
    assert report.remarks == (same,)
    assert same.check == "same_content"


def test_times_alone_cost_one_look_and_no_run(fresh, monkeypatch):
    table = first(fresh, "nuscenes/v1.0-test/sample.json")
    table.touch()
    backup = table.with_name("backup")
    backup.hardlink_to(first(fresh, "vision/annotations/train.json"))  # as `cp -al` does
    assert not is_quick(fresh)
    assert survey(fresh).dataset_is_current
    assert build(fresh, monkeypatch)[1] == []
    assert is_quick(fresh)
    backup.unlink()


def test_files_of_others_beside_ours_are_no_business_of_ours(fresh, monkeypatch):
    folders = [
        "nuscenes",
        "nuscenes/v1.0-test",
        "nuscenes/samples/CAM_FRONT",
        "vision/annotations",
        "all/sweeps",
    ]
    beside = [fresh.parent / "dataset" / folder / "mine.txt" for folder in folders]
    for path in beside:
        path.write_text("mine")
    assert survey(fresh).dataset_is_current
    assert build(fresh, monkeypatch)[1] == []
    assert is_quick(fresh)
    assert [path.read_text() for path in beside] == ["mine"] * len(beside)
    for path in beside:
        path.unlink()


def test_another_name_for_a_file_of_the_store_changes_nothing(fresh, tmp_path):
    link = first(fresh, "nuscenes/samples/CAM_FRONT/*")
    (fresh.parent / "another name").hardlink_to(link)
    assert is_quick(fresh)
    (fresh.parent / "another name").unlink()
    assert is_quick(fresh)


def test_without_the_record_the_datasets_are_put_together_once_more(fresh, monkeypatch):
    whole = everything(fresh)
    for asset in ASSETS:
        forget(fresh, asset)
    report, _ = build(fresh, monkeypatch)
    assert report.dataset == "updated"
    assert everything(fresh) == whole
    assert build(fresh, monkeypatch)[1] == []


@pytest.mark.parametrize("asset", ASSETS)
def test_a_dataset_of_which_nothing_is_on_record_needs_a_plan(fresh, asset):
    forget(fresh, asset)
    assert not is_quick(fresh)
    assert not survey(fresh).dataset_is_current


def test_a_list_of_links_that_is_torn_needs_a_plan(fresh):
    cache = Cache(load_recipe(fresh).state)
    changes = Changes()
    changes.drop_below("links", "nuscenes_dataset")
    cache.write(changes)
    assert not is_quick(fresh)
    assert not survey(fresh).dataset_is_current


# --- after a crash -----------------------------------------------------------------------


def tear(recipe_file, pattern):
    """Leave a file with its size and zeros in it, and nothing that tells, as a power loss does."""
    path = first(recipe_file, pattern)
    stat = path.stat()
    path.chmod(0o644)
    with path.open("r+b") as file:
        file.write(b"\0" * stat.st_size)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    path.chmod(0o444)
    for asset in ASSETS:
        publication = Publication(load_recipe(recipe_file).state, asset)
        head = publication._head()
        files = {name: signature(f"{head['root']}/{name}") for name in head["files"]}
        publication._put_head(head | {"files": files})
    return path


def start_anew(recipe_file, monkeypatch):
    """Have the machine started anew since the last build."""
    monkeypatch.setattr(after_crash, "booted_at_s", lambda now_s=time.time(): now_s)
    changes = Changes()
    changes.put("last", "", json.dumps(["another one", ""]).encode())
    Cache(load_recipe(recipe_file).state).write(changes)


def kill_last_build(recipe_file, _monkeypatch):
    """Have the last build killed before its end."""
    child = subprocess.Popen(["true"])
    process = ProcessId.of(child.pid)
    child.wait()
    BuildLog(load_recipe(recipe_file).state).begin(json.dumps(process.as_json()), recipe_file)


@pytest.mark.parametrize("crash", [start_anew, kill_last_build])
def test_a_crash_needs_a_plan(fresh, monkeypatch, crash):
    crash(fresh, monkeypatch)
    assert not is_quick(fresh)
    assert build(fresh, monkeypatch)[1] == []
    assert is_quick(fresh)


def test_a_build_that_is_at_work_needs_a_plan(fresh):
    with after_crash.noted_build(load_recipe(fresh), fresh):
        assert not is_quick(fresh)
    assert is_quick(fresh)


@pytest.mark.parametrize("crash", [start_anew, kill_last_build])
@pytest.mark.parametrize(
    "pattern",
    [
        "nuscenes/v1.0-test/sample_data.json",
        "nuscenes/v1.0-test/dataset.lock.json",
        "nuscenes/samples/CAM_FRONT/*",  # the store's file as well
        "vision/annotations/train.json",
        "../.bagassets/trajectory_map.html",
    ],
)
def test_what_a_crash_tore_is_read_and_mended(fresh, monkeypatch, crash, pattern):
    whole = everything(fresh)
    tear(fresh, pattern)
    assert everything(fresh) != whole
    crash(fresh, monkeypatch)
    report, _ = build(fresh, monkeypatch)
    assert report.succeeded, report.as_json()
    assert everything(fresh) == whole
    is_of_store = "samples" in pattern
    assert [remark.check for remark in report.remarks if remark.check == "after_crash"] == [
        "after_crash"
    ] * is_of_store
    assert build(fresh, monkeypatch)[1] == []
    assert is_quick(fresh)


@pytest.mark.parametrize("name", ["manifest.json", "files"])
def test_an_artifact_that_a_crash_tore_is_made_again(fresh, monkeypatch, name):
    root = load_recipe(fresh).store_path / "artifacts"
    artifact = next(
        folder for folder in sorted(root.glob("*/*")) if (folder / "files/calibration.json").exists()
    )
    torn = artifact / name if name == "manifest.json" else artifact / "files/calibration.json"
    whole = torn.read_bytes()
    torn.chmod(0o644)
    torn.write_bytes(b"")
    start_anew(fresh, monkeypatch)
    assert build(fresh, monkeypatch)[0].succeeded
    assert torn.read_bytes() == whole


def test_a_copy_that_a_crash_tore_is_mended_and_an_old_one_not_read(fresh, monkeypatch):
    """Where there are no hard links."""
    monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(OSError(errno.EXDEV, "another disk")))
    recipe = load_recipe(fresh)
    shutil.rmtree(recipe.nuscenes.output)
    assert build(fresh, monkeypatch)[0].succeeded
    whole = everything(fresh)
    torn = tear(fresh, "nuscenes/samples/CAM_FRONT/*")
    assert torn.stat().st_nlink == 1
    start_anew(fresh, monkeypatch)
    build(fresh, monkeypatch)
    assert everything(fresh) == whole
    old = first(fresh, "nuscenes/samples/CAM_FRONT/*")
    os.utime(old, (1e9, 1e9))
    forget(fresh, "nuscenes_dataset")
    build(fresh, monkeypatch)
    text = Publication(recipe.state, "nuscenes_dataset")
    text.distrust(1e9 + 1, links=False)
    assert f"samples/CAM_FRONT/{old.name}" not in text.changed_files(recipe.nuscenes.output)
    shutil.rmtree(recipe.nuscenes.output)
    monkeypatch.undo()


def test_another_boot_needs_a_plan(fresh, monkeypatch):
    monkeypatch.setattr(decide, "boot_id", lambda: "another one")
    assert not is_quick(fresh)


def test_what_a_crash_tore_is_found_when_others_have_written_since(fresh, monkeypatch):
    """As runs of the web UI do, and the inventories that are made while the server starts."""
    root = load_recipe(fresh).store_path / "artifacts"
    torn, *others = sorted(root.glob("*/*/files/*.parquet"))
    hour_s = 3600
    for path in root.glob("*/*/manifest.json"):
        os.utime(path, (time.time() - hour_s,) * 2)
    whole = torn.read_bytes()
    torn.chmod(0o644)
    torn.write_bytes(bytes(len(whole)))
    start_anew(fresh, monkeypatch)
    monkeypatch.setattr(after_crash, "booted_at_s", lambda booted_s=time.time() - hour_s / 2: booted_s)
    os.utime(others[-1].parents[1] / "manifest.json")
    report, _ = build(fresh, monkeypatch)
    assert report.succeeded
    assert torn.read_bytes() == whole
    assert [
        str(torn.parents[1]) in remark.problem for remark in report.remarks if remark.check == "after_crash"
    ] == [True]


def test_without_a_crash_nothing_is_read_again(fresh, monkeypatch):
    start_anew(fresh, monkeypatch)
    build(fresh, monkeypatch)
    monkeypatch.setattr(after_crash, "repair_last_writes", pytest.fail)
    build(fresh, monkeypatch)


# --- many links --------------------------------------------------------------------------


@pytest.fixture
def many(tmp_path):
    """A publication of 20,000 links in one folder."""
    root = tmp_path / "root"
    (root / "samples").mkdir(parents=True)
    source = tmp_path / "source"
    source.write_bytes(b"x")
    names = [
        f"samples/{number:06} of a recording with a name of usual length.jpg" for number in range(20_000)
    ]
    for name in names:
        (root / name).hardlink_to(source)
    publication = Publication(tmp_path, "many")
    publication.write(root, {}, {"a": lambda: names[:15_000], "b": lambda: names[15_000:]}, None)
    return publication, root, names


def test_of_many_links_a_look_asks_about_a_few_and_still_sees_one_that_went(many, monkeypatch):
    publication, root, names = many
    asked, stat = [], os.stat
    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", lambda path, **how: asked.append(path) or stat(path, **how))
        publication.check()
    assert 500 < len(asked) < 1500, "one piece of the list of links, of 20,000"
    (root / names[12_345]).unlink()
    with pytest.raises(PlanNeeded, match="changed"):
        publication.check()
    assert publication.changed_files(root) == {names[12_345]}


def test_of_many_links_those_changed_in_place_are_found_within_some_looks(many, monkeypatch):
    publication, root, names = many
    stamp = (root / "samples").stat().st_mtime_ns
    for name in names[
        ::200
    ]:  # as an editor does that writes a whole folder anew, and puts the folder's time back
        (root / name).unlink()
        (root / name).write_bytes(b"other")
    os.utime(root / "samples", ns=(stamp, stamp))
    looks = 0
    while True:
        looks += 1
        try:
            publication.check()
        except PlanNeeded:
            break
        assert looks < 50
    assert publication.changed_files(root)


def test_of_a_publication_only_new_and_suspicious_parts_are_looked_at_anew(many, tmp_path):
    publication, root, names = many
    asked = []

    def part(name, found):
        return {name: lambda: asked.append(name) or found}

    publication.write(root, {}, part("a", names[:15_000]) | part("b", names[15_000:]), frozenset())
    assert asked == []
    publication.write(root, {}, part("b", names[15_000:]) | part("c", names[:10]), frozenset([names[15_000]]))
    assert asked == ["b", "c"]
    assert {key.split("/")[1] for key in Cache(tmp_path).all("links")} == {"b", "c"}
    publication.check()
