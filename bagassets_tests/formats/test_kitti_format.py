"""The example of a dataset format in a package of its own: it has all that our formats have, and pykitti loads it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pykitti
import pytest
import yaml
from click.testing import CliRunner

from bagassets.base.errors import DatasetError
from bagassets.cli.main import root as command_line
from bagassets.defs.graph.location import build_definitions
from bagassets.formats.catalogue import catalogue, installed_format, recording_assets
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.formats.dataset_lock import load_lock, locked_artifacts
from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests import in_process
from bagassets_tests.plugin_install import Site, wheel_of
from bagassets_tests.small_drive import OPTICAL_XYZW, SPEED_MPS

pytestmark = pytest.mark.once

EXAMPLE = Path(__file__).parents[2] / "examples" / "kitti_odometry"
TEXT = in_process.QUICK.replace("topic: /cam/image_raw", "topic: /cam/image_raw, output: png") + (
    "formats:\n  kitti: {{output: dataset/kitti}}\n"
)
FRAMES = {"a.bag": 9, "b.mcap": 9}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as monkeypatch:
        site = Site(monkeypatch, folder / "site")
        site.unpack(wheel_of(EXAMPLE, folder / "wheels"))
        site.restart()
        yield site
        site.close()


@pytest.fixture(scope="module")
def template(site, tmp_path_factory):
    recipe_file = in_process.make_project(tmp_path_factory.mktemp("kitti"), ["a.bag", "b.mcap"], text=TEXT)
    with pytest.MonkeyPatch.context() as monkeypatch:
        report, runs = in_process.build(recipe_file, monkeypatch)
    assert report.succeeded, report.as_json()
    return recipe_file, report, runs


@pytest.fixture
def project(template):
    """The project, for tests that leave it as they found it."""
    return template[0]


def run(recipe_file, *arguments, status=0):
    command = [*arguments[:1], *map(str, arguments[1:])]
    at = 2 if arguments[0] == "dataset" else 1
    command[at:at] = ["--recipe", str(recipe_file)]
    result = CliRunner().invoke(command_line, command, standalone_mode=False)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    code = result.exception.code if isinstance(result.exception, SystemExit) else result.return_value
    assert (code or 0) == status, result.output
    return result.stdout


def dataset_of(recipe_file):
    return load_recipe(recipe_file).formats["kitti"].output / "dataset"


def content(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- what the format makes ---------------------------------------------------------------


def test_the_package_adds_a_format_and_its_asset(site):
    assert catalogue().problems == ()
    kind = installed_format("kitti")
    assert (kind.distribution, kind.part) == ("kitti-odometry-format 1.0", "kitti_sequence")
    assert set(catalogue().assets) == {"kitti_sequence"}


@pytest.mark.parametrize(("number", "key"), [(0, "a.bag"), (1, "b.mcap")])
def test_pykitti_loads_it_and_it_is_true(template, number, key):
    found = pykitti.odometry(str(dataset_of(template[0])), f"{number:02d}")
    frames = FRAMES[key]
    assert [len(each) for each in (found.timestamps, found.poses, found.cam2_files, found.velo_files)] == [
        frames
    ] * 4
    # Ten images a second, and the vehicle goes straight ahead: along z of the camera.
    assert [stamp.total_seconds() for stamp in found.timestamps] == pytest.approx(
        [i / 10 for i in range(frames)]
    )
    for i, pose in enumerate(found.poses):
        expected = np.eye(4)
        expected[2, 3] = SPEED_MPS * i / 10
        np.testing.assert_allclose(pose, expected, atol=1e-6)
    np.testing.assert_allclose(found.calib.K_cam2, [[30, 0, 16], [0, 30, 12], [0, 0, 1]])
    # Lidar 1 m behind the camera and 0.6 m above it, whose axes are right, down, ahead.
    np.testing.assert_allclose(found.calib.T_cam2_velo[:3, 3], [0, -0.6, -1.0], atol=1e-6)
    x, y, z, w = OPTICAL_XYZW
    assert abs(w) == abs(x) == abs(y) == abs(z) == 0.5
    np.testing.assert_allclose(
        found.calib.T_cam2_velo[:3, :3], [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-9
    )
    image = np.asarray(found.get_cam2(3))
    assert image.shape == (24, 32, 3)
    assert image[2, 5].tolist() == [40, 20, 60]
    points = found.get_velo(3)
    assert points.shape[1] == 4
    recorded = Store(load_recipe(template[0]).store_path)
    lock = load_lock(dataset_of(template[0]))
    assert len(recorded.artifact(lock.bags[key].artifact).read_json("files.json")) == frames


def test_files_are_links_to_the_store(template):
    links = [
        path
        for name in ("image_2", "velodyne")
        for path in dataset_of(template[0]).glob(f"sequences/*/{name}/*")
    ]
    assert len(links) == 2 * sum(FRAMES.values())
    assert all(path.stat().st_nlink >= 2 for path in links)


def test_the_lock_names_what_the_dataset_needs(template):
    recipe_file, _, _ = template
    lock = load_lock(dataset_of(recipe_file))
    assert (lock.kind, list(lock.bags), list(lock.files)) == (
        "kitti",
        ["a.bag", "b.mcap"],
        ["sequences.json"],
    )
    store = Store(load_recipe(recipe_file).store_path)
    images = {
        image["artifact"]
        for bag in lock.bags.values()
        for image in store.artifact(bag.artifact).read_json("files.json")
    }
    assert locked_artifacts(lock.path) == {bag.artifact for bag in lock.bags.values()} | images
    assert lock.splits == load_lock(load_recipe(recipe_file).nuscenes.output).splits


# --- what it has for being a format ------------------------------------------------------


def test_it_is_in_the_graph_with_its_checks(template):
    graph = build_definitions(template[0]).resolve_asset_graph()
    names = {key.to_user_string() for key in graph.get_all_asset_keys()}
    assert {"kitti_sequence", "kitti_dataset"} <= names
    parents = {
        key.to_user_string()
        for key in graph.get(
            next(k for k in graph.get_all_asset_keys() if k.to_user_string() == "kitti_sequence")
        ).parent_keys
    }
    assert parents == {"calibration", "ego_poses", "frames", "sweeps"}
    checks = {(key.asset_key.to_user_string(), key.name) for key in graph.asset_check_keys}
    assert ("kitti_dataset", "kitti_frames_whole") in checks


def test_the_build_made_it_and_the_next_finds_nothing_to_do(template, monkeypatch):
    recipe_file, _, runs = template
    assert {key for key, _ in runs} == {"a.bag", "b.mcap", None}
    assert all("kitti_sequence" in assets for key, assets in runs if key is not None)
    assert "kitti_dataset" in next(assets for key, assets in runs if key is None)
    again, more = in_process.build(recipe_file, monkeypatch)
    assert (again.succeeded, more) == (True, [])
    assert "nothing to do" in run(recipe_file, "build", "--check")


def test_plan_and_status_know_it(template):
    recipe_file, _, _ = template
    reported = json.loads(run(recipe_file, "status", "--json"))
    assert reported["datasets"]["kitti_dataset"] == "fresh"
    assert reported["recordings"]["a.bag"]["assets"]["kitti_sequence"]["state"] == "fresh"
    assert "problems" not in reported
    assert "kitti sequence" in run(recipe_file, "status", "--all")


def test_explain_names_what_it_is_made_from(template):
    reported = json.loads(run(template[0], "explain", "a.bag", "kitti_sequence", "--json"))
    text = json.dumps(reported)
    assert all(word in text for word in ("tolerance_s", "ego_poses", "kitti-odometry-format"))
    assert "kitti_sequence" in run(template[0], "explain", "a.bag", "kitti_sequence")


def test_a_changed_option_makes_stale_just_what_reads_it(project, monkeypatch):
    text = project.read_text()
    project.write_text(text.replace("dataset/kitti}", "dataset/kitti, tolerance_s: 0.001}"))
    pending = in_process.survey(project)
    states = in_process.states(pending, "a.bag")
    assert states.pop("kitti_sequence") == "stale"
    assert set(states.values()) == {"fresh"}
    assert "tolerance_s" in pending.plan.bags["a.bag"].assets["kitti_sequence"].reason
    before = content(load_recipe(project).nuscenes.output)
    report, _ = in_process.build(project, monkeypatch)
    line = project.read_text().splitlines().index("  kitti: {output: dataset/kitti, tolerance_s: 0.001}") + 1
    assert report.dataset_problem == (
        f"kitti: 0 frames from 2 recordings: its settings leave nothing of them ({project}:{line}: formats.kitti)."
    )
    assert len(pykitti.odometry(str(dataset_of(project)), "00")) == 0  # no sweep is as near as that
    assert content(load_recipe(project).nuscenes.output) == before
    project.write_text(text)
    report, _ = in_process.build(project, monkeypatch)
    assert report.succeeded
    assert len(pykitti.odometry(str(dataset_of(project)), "00")) == 9


def test_its_check_finds_a_frame_without_a_cloud(project, monkeypatch):
    verdicts = {each["check"]: each for each in json.loads(run(project, "check", "--json"))}
    assert verdicts["kitti_frames_whole"]["passed"] is True
    assert verdicts["kitti_frames_whole"]["facts"] == {"frames": sum(FRAMES.values())}
    next((dataset_of(project) / "sequences" / "01" / "velodyne").iterdir()).unlink()
    verdicts = {each["check"]: each for each in json.loads(run(project, "check", "--json", status=3))}
    (problem,) = verdicts["kitti_frames_whole"]["problems"]
    assert "sequence 01" in problem
    report, runs = in_process.build(project, monkeypatch)
    assert (report.succeeded, [key for key, _ in runs]) == (True, [None])
    assert len(list((dataset_of(project) / "sequences" / "01" / "velodyne").iterdir())) == 9


def test_verify_finds_damage_and_the_next_build_mends_it(project, monkeypatch):
    whole = content(dataset_of(project))
    assert "are intact" in run(project, "verify")
    folder = dataset_of(project) / "sequences" / "00"
    image, cloud = sorted((folder / "image_2").iterdir())[2], sorted((folder / "velodyne").iterdir())[4]
    image.unlink()
    cloud.unlink()
    cloud.write_bytes(b"something else")
    (dataset_of(project) / "sequences.json").write_text("{}")
    spoiled = json.loads(run(project, "verify", "--json", status=3))["datasets"]
    assert {Path(each["path"]).name for each in spoiled} == {image.name, cloud.name, "sequences.json"}
    report, _ = in_process.build(project, monkeypatch)
    assert report.succeeded
    assert content(dataset_of(project)) == whole
    assert "are intact" in run(project, "verify")


def test_verify_finds_damage_in_the_store_and_the_next_build_mends_both(project, monkeypatch):
    whole = content(dataset_of(project))
    cloud = next((dataset_of(project) / "sequences" / "00" / "velodyne").iterdir())
    cloud.chmod(0o644)
    cloud.write_bytes(b"other bytes")  # the file of the store itself
    reported = json.loads(run(project, "verify", "--json", status=3))
    assert [each["step"] for each in reported["damaged"]] == ["kitti_sequence"]
    assert cloud in [Path(each["path"]) for each in reported["datasets"]]
    report, _ = in_process.build(project, monkeypatch)
    assert report.succeeded
    assert content(dataset_of(project)) == whole


def test_diff_and_restore(project, monkeypatch, tmp_path):
    lock = shutil.copy(dataset_of(project) / "dataset.lock.json", tmp_path / "may.json")
    whole = content(dataset_of(project))
    assert "The datasets are the same" in run(project, "dataset", "diff", lock, dataset_of(project))
    away = (project.parent / "bags" / "a.bag").rename(tmp_path / "a.bag")
    report, _ = in_process.build(project, monkeypatch)
    assert report.removed == ("a.bag",)
    assert len(list((dataset_of(project) / "sequences").iterdir())) == 1
    text = run(project, "dataset", "diff", lock, dataset_of(project), status=3)
    assert "2 recordings, 18 frames" in text
    assert "- a.bag: 9 frames, split " in text
    text = run(project, "dataset", "restore", lock, "--output", tmp_path / "again")
    assert text.startswith(f"{tmp_path}/again/dataset: 2 recordings, 18 frames")
    assert content(tmp_path / "again" / "dataset") == whole
    away.rename(project.parent / "bags" / "a.bag")
    report, _ = in_process.build(project, monkeypatch)
    assert report.succeeded
    assert content(dataset_of(project)) == whole


def test_gc_spares_what_its_lock_names(project, tmp_path):
    """Also where the package is not installed any more: then nothing but the lock says so."""
    needed = locked_artifacts(dataset_of(project) / "dataset.lock.json")
    found = json.loads(run(project, "gc", "--json", "--dry-run", "--keep-days", "0"))
    assert not needed & {each["artifact"] for each in found["artifacts"]}
    assert str(dataset_of(project) / "dataset.lock.json") in found["locks"]
    text = project.read_text()
    lock = tmp_path / "may.json"
    value = json.loads((dataset_of(project) / "dataset.lock.json").read_text())
    value["dataset"] = "unheard-of"
    lock.write_text(json.dumps(value))
    found = json.loads(run(project, "gc", "--json", "--dry-run", "--keep-days", "0", "--lock", lock))
    assert not needed & {each["artifact"] for each in found["artifacts"]}
    del value["bags"][0]["artifacts"]
    lock.write_text(json.dumps(value))
    with pytest.raises(DatasetError, match=r"may\.json: expected the lock file .*names its artifacts"):
        run(project, "gc", "--dry-run", "--lock", lock)
    assert project.read_text() == text


def test_an_upgrade_of_the_package_makes_its_assets_stale_and_no_others(site, project, tmp_path):
    def reported():
        recipe = load_recipe(project)
        assets = recording_assets(recipe)
        action = assets["kitti_sequence"].step.action({}, {}).digest
        return {**assets.versions, **dataset_code_versions(recipe)}, action

    (before, old), (same, _) = reported(), reported()
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels", version="1.1"))
    site.restart()
    try:
        after, new = reported()
    finally:
        site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
        site.restart()
    assert (before == same, old == new) == (True, False)
    assert {name for name in before if before[name] != after[name]} == {"kitti_sequence", "kitti_dataset"}


def test_a_recording_that_lacks_the_lidar_fails_there_alone(site, tmp_path, monkeypatch):
    text = TEXT.replace("      LIDAR_TOP: {{modality: lidar, topic: /points}}\n", "")
    recipe_file = in_process.make_project(tmp_path, ["a.bag"], text=text)
    report, _ = in_process.build(recipe_file, monkeypatch)
    assert "a KITTI sequence needs a camera and a lidar" in report.outcomes["a.bag"].reason
    lock = load_lock(load_recipe(recipe_file).nuscenes.output)
    assert list(lock.bags) == ["a.bag"]
    mine = load_lock(dataset_of(recipe_file))
    assert list(mine.bags) == []
    assert "needs a camera and a lidar" in mine.value["failed"]["a.bag"]


def test_the_page_shows_the_example(template):
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    example = (EXAMPLE / "kitti_odometry.py").read_text()
    shown = [block.split("```")[0] for block in page.split("```python\n")[1:]]
    assert shown
    assert all(block in example for block in shown)
    sections = [yaml.safe_load(block.split("```")[0]) for block in page.split("```yaml\n")[1:]]
    assert all("kitti" in section["formats"] for section in sections)
