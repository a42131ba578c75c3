"""Projects of older versions: recipe, state folder, store and lock are used on, or refused in one sentence."""

import json
import re
import shutil
import sqlite3
import subprocess
import tarfile
from contextlib import closing
from pathlib import Path

import pytest

from bagassets.base.cache import _FORMAT
from bagassets.forkserver.client import Client
from bagassets.formats.catalogue import known_assets
from bagassets.recipe import load_recipe
from bagassets_tests.services import BIN, bare_environment, eventually, free_port, running
from bagassets_tests.small_drive import write_drive

OLD = sorted((Path(__file__).parents[1] / "upgrade").glob("*.tar.xz"))
LOCK = Path("dataset/nuscenes/v1.0-test/dataset.lock.json")

pytestmark = [
    pytest.mark.parametrize(
        "old",
        OLD,
        ids=lambda path: path.name.removesuffix(".tar.xz"),
        scope="module",
    ),
    pytest.mark.xdist_group("upgrade"),
]


def run(project, *arguments, status=0):
    done = subprocess.run(
        [BIN / "bagassets", *map(str, arguments)],
        cwd=project, env=bare_environment(), capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode in (status if isinstance(status, set) else {status}), done.stdout + done.stderr
    return done.stdout + done.stderr


def unpack(old, folder):
    """Unpack a project, and have its absolute paths lead to where it lies now."""
    with tarfile.open(old) as archive:
        archive.extractall(folder, filter="data")
    project = folder / "old" / "project"
    [place] = re.findall(r"^DAGSTER_HOME='(.+)'$", (project / ".env").read_text(), re.MULTILINE)
    for name in (".env", "dagster.yaml", "workspace.yaml"):
        file = project / name
        file.write_text(file.read_text().replace(place, str(project)))
    return project


@pytest.fixture(scope="module")
def project(old, tmp_path_factory):
    """The project as it was left: nothing of it was read yet."""
    return unpack(old, tmp_path_factory.mktemp("untouched"))


@pytest.fixture(scope="module")
def built(old, tmp_path_factory):
    """The project after a build of now."""
    project = unpack(old, tmp_path_factory.mktemp("built"))
    (project / "said.txt").write_text(run(project, "build"))
    yield project
    for client in Client.all_of(project / ".bagassets"):
        client.shutdown(grace_s=0.0)


def test_recipes_are_read(project):
    for recipe in (project / "recipe.yaml", project.parent / "proposed" / "recipe.yaml"):
        assert load_recipe(recipe).rigs


@pytest.mark.once
def test_the_store_is_intact(project):
    run(project, "verify")  # exit status 1 if anything is damaged


def test_a_build_takes_the_state_over(built):
    project = built
    assert "nothing to do" in run(project, "build")
    assert re.search(r"1 recording: \d+ fresh\.", run(project, "status"))


def test_the_build_says_what_this_version_makes_again(built):
    recorded = {}
    for path in (built / ".bagassets" / "store" / "actions").glob("*/*.json"):
        action = json.loads(path.read_text())["action"]
        recorded.setdefault(action["step"], set()).add(action["version"])
    # The inventory of a recording that has to be read again, as here, is made before the build plans.
    raised = [
        asset.name
        for asset in known_assets()
        if asset.name != "inventory" and min(recorded.get(asset.name, {asset.version})) < asset.version
    ]
    # Of what the build has made again, the store has the actions of both versions.
    assert {name for name, versions in recorded.items() if len(versions) > 1} <= {*raised, "inventory"}
    lines = [line for line in (built / "said.txt").read_text().splitlines() if "made again" in line]
    expected = f"made again: {', '.join(raised)} of a.mcap, as far as this version of bagassets makes them differently"
    assert [line.partition(" (see")[0] for line in lines] == ([expected] if raised else [])
    assert all(re.search(r"; about \d+ s, going by what they took before$", line) for line in lines)
    differences = re.findall(r"^  (\w+) [a-z]+ ", (built / "said.txt").read_text(), re.MULTILINE)
    assert set(differences) == {*raised}


def test_the_dataset_is_the_same(project, built):
    for name in ("scene", "sample"):
        table = LOCK.with_name(f"{name}.json")
        assert (built / table).read_bytes() == (project / table).read_bytes()


@pytest.mark.once
def test_a_lock_is_compared_with_one_of_now(project, built):
    # All artifacts may be made anew, others that hold the same; only ego poses have other tokens.
    said = run(built, "dataset", "diff", project / LOCK, built / LOCK, status={0, 3})
    assert "1 recording, 1 scene, 3 samples" in said
    changes = [line for line in said.splitlines() if line.startswith(("+", "-", "~", "files"))]
    assert changes == ["~ a.mcap: the same samples", "files that differ: ego_pose.json, sample_data.json"]


@pytest.mark.once
def test_a_dataset_is_made_again_from_its_lock(old, tmp_path):
    project = unpack(old, tmp_path)
    lock = shutil.copy(project / LOCK, tmp_path / "kept.lock.json")
    before = (project / LOCK).with_name("scene.json").read_bytes()
    run(project, "dataset", "restore", lock, "--output", tmp_path / "again")
    assert next((tmp_path / "again").rglob("scene.json")).read_bytes() == before


@pytest.mark.once
def test_the_lock_keeps_its_artifacts_in_the_store(project):
    assert "0 artifacts" in run(project, "gc", "--dry-run", "--keep-days", "0")


@pytest.mark.once
def test_a_lock_of_a_later_version_is_refused(project, tmp_path):
    later = tmp_path / "later.lock.json"
    later.write_text(json.dumps({**json.loads((project / LOCK).read_text()), "format": 99}))
    said = run(project, "dataset", "diff", later, project / LOCK, status=1)
    assert said.splitlines() == [
        f"error: {later}: this lock has format 99, this version of bagassets knows 2; use the version that wrote it."
    ]


@pytest.mark.once
def test_what_a_later_version_noted_about_changes_is_not_believed(old, tmp_path):
    project = unpack(old, tmp_path)
    noted = project / ".bagassets" / "freshness.sqlite"
    with closing(sqlite3.connect(noted)) as connection:
        connection.execute(f"PRAGMA user_version = {_FORMAT + 1}")
        connection.execute("DROP TABLE IF EXISTS entries")
        connection.execute("CREATE TABLE entries (something TEXT)")
        connection.commit()
    run(project, "build")
    assert "nothing to do" in run(project, "build")
    with closing(sqlite3.connect(noted)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (_FORMAT,)
    for client in Client.all_of(project / ".bagassets"):
        client.shutdown(grace_s=0.0)


@pytest.mark.once
def test_a_recipe_of_a_later_version_is_refused(project, tmp_path):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text((project / "recipe.yaml").read_text() + "field_of_tomorrow: 1\n")
    [line] = run(tmp_path, "status", status=1).splitlines()
    assert "field_of_tomorrow" in line


@pytest.mark.long
def test_daemon_and_sensor_build_what_is_copied_in(old, tmp_path):
    """`dagster.yaml` of then names modules by the places that they had: those of launcher and storage."""
    project = unpack(old, tmp_path)
    bags = project.parent / "bags"
    log = project / "ui.log"
    call = [BIN / "bagassets", "ui", "--no-browser", "--port", free_port()]
    with running(call, project, log):
        eventually(lambda: "http" in log.read_text(), "it prints its address", 180)
        write_drive(bags / "new.mcap", "mcap", duration_s=1.0)

        def is_built():
            return run(project, "build", "--check", status={0, 3}).endswith("2 recordings up to date.\n")

        eventually(is_built, f"sensor and daemon build it: {log}", 300)
