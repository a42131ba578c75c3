"""Projects that two versions open in turn: what the other one wrote is used, or refused in one sentence."""

import json
import re
import subprocess
import sys
import tarfile
from io import BytesIO
from pathlib import Path

import pytest

from bagassets.base.errors import BagAssetsError
from bagassets.defs.records.databases import read_settings
from bagassets.forkserver.client import Client
from bagassets_tests.services import BIN, bare_environment, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]
RELEASE = "0.1.0"
# The drives here are bare MCAPs, which the inventory's version 10 spares.
OF_MCAPS = 9


def test_settings_of_another_version_are_refused_in_one_sentence(tmp_path):
    project = make_project(tmp_path)
    settings = project / "dagster.yaml"
    assert read_settings(project).run_launcher_data.module_name == "bagassets.defs.launcher"
    for module in ("bagassets.defs.of_tomorrow", "bagassets.tomorrow.launcher"):
        settings.write_text(settings.read_text().replace("bagassets.defs.launcher", module))
        with pytest.raises(BagAssetsError) as caught:
            read_settings(project)
        assert str(caught.value) == (
            f"{settings}: there is no {module} in this version of bagassets, so another one wrote the file; use that, "
            f"or have this one write it anew: `bagassets init {project}`. Recipe and records stay."
        )
        settings.write_text(settings.read_text().replace(module, "bagassets.defs.launcher"))


def test_settings_with_classes_of_others_are_read(tmp_path):
    project = make_project(tmp_path)
    settings = project / "dagster.yaml"
    settings.write_text(settings.read_text().replace("bagassets.defs.launcher", "of_others.launcher"))
    assert read_settings(project).run_launcher_data.module_name == "of_others.launcher"


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    """The code of the release, from the history of the checkout."""
    if not (ROOT / ".git").exists():
        pytest.skip("there is no history")
    git = ("git", "-C", str(ROOT))
    found = subprocess.run(
        [*git, "log", "-1", "--format=%H", f"--grep=^Release {re.escape(RELEASE)}$"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    if not found.stdout:
        pytest.skip(f"the history does not reach back to {RELEASE}")
    code = subprocess.run(
        [*git, "archive", found.stdout.strip(), "bagassets"], check=True, capture_output=True
    )
    folder = tmp_path_factory.mktemp("released")
    with tarfile.open(fileobj=BytesIO(code.stdout)) as archive:
        archive.extractall(folder, filter="data")
    return folder


@pytest.fixture
def versions(released, tmp_path):
    """The commands of this version and of the release, run in the project folder of `tmp_path`."""
    project = tmp_path / "project"

    def run(command, *arguments, status=0, **environment):
        done = subprocess.run(
            [*command, *arguments],
            cwd=project, env=bare_environment() | environment, capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout + done.stderr

    def now(*arguments, **options):
        return run([BIN / "bagassets"], *arguments, **options)

    def then(*arguments, **options):
        return run([sys.executable, "-m", "bagassets"], *arguments, PYTHONPATH=str(released), **options)

    yield now, then
    for client in Client.all_of(project / ".bagassets"):
        client.shutdown(grace_s=0.0)


def tables(project):
    return {path.name: path.read_bytes() for path in project.glob("dataset/nuscenes/v1.0-*/*.json")}


def steps(project):
    """Step -> versions of it that the store has actions of."""
    found = {}
    for path in (project / ".bagassets" / "store" / "actions").glob("*/*.json"):
        action = json.loads(path.read_text())["action"]
        found.setdefault(action["step"], set()).add(action["version"])
    return found


@pytest.mark.long
@pytest.mark.once
class TestBothWays:
    def test_a_project_of_the_release_goes_forward_back_and_forward(self, versions, tmp_path):
        now, then = versions
        project = make_project(tmp_path, settle_s=0)
        write_drive(tmp_path / "bags" / "a.mcap", "mcap", duration_s=3.0)
        then("init", str(project))  # which writes its own dagster.yaml
        then("build")
        before = tables(project)
        only_then = steps(project)
        assert before
        assert only_then["inventory"] == {6}, "it is the code of the release that has run"

        said = now("build", "--dry-run")
        assert re.search(
            r"made again: inventory, .* of a\.mcap, .*; about \d+ s, going by what they took", said
        )
        assert [
            line
            for line in said.splitlines()
            if line.startswith("  inventory lists topics that metadata.yaml")
        ]
        now("build")
        assert "nothing to do" in now("build")
        after = tables(project)
        both = steps(project)
        assert both["inventory"] == {6, OF_MCAPS}

        said = then("build")
        assert re.search(r"a\.mcap +mcap .* hit", said), "what the release had made, it finds in the store"
        assert "nothing to do" in then("build")
        assert tables(project) == before
        assert "intact" in then("verify")
        now("build")
        assert tables(project) == after
        assert steps(project) == both, "nothing was made again on the way back and forth"
        assert "intact" in now("verify")

    def test_a_project_of_now_is_taken_over_by_the_release_after_init(self, versions, tmp_path):
        now, then = versions
        project = make_project(tmp_path, settle_s=0)
        write_drive(tmp_path / "bags" / "a.mcap", "mcap", duration_s=3.0)
        now("build")
        after = tables(project)
        [line] = then("status", status=70).splitlines()
        assert "Couldn't import module bagassets.defs.sqlite_storage" in line
        then("init", str(project))
        then("build")
        assert "nothing to do" in then("build")
        assert steps(project)["inventory"] == {6, OF_MCAPS}
        now("build")
        assert tables(project) == after

    def test_a_recipe_with_a_field_of_now_is_refused_by_the_release(self, versions, tmp_path):
        _, then = versions
        project = make_project(tmp_path)
        recipe = project / "recipe.yaml"
        recipe.write_text(recipe.read_text().replace("settle_s", "series: {}, settle_s"))
        [line] = then("status", status=1).splitlines()
        assert re.search(r"recipe\.yaml:\d+: bags\.series: no such field here; the fields are ", line)
