"""The engine stands without Dagster: an example of 23 lines builds a recording where Dagster cannot be imported."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import bagassets
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.load import load_recipe
from bagassets_tests.services import bare_environment, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "one_recording.py"

# What a Python without Dagster does when it is asked for Dagster.
NOT_INSTALLED = """
import json, runpy, sys

class NotInstalled:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0].startswith("dagster"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NotInstalled)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
print(json.dumps(sorted(name for name in sys.modules if name.startswith(("dagster", "bagassets.defs")))))
"""


def build_without_dagster(project):
    """Run the example; return asset -> "made" or "found", and asset -> the folder of its files."""
    done = subprocess.run(
        [sys.executable, "-c", NOT_INSTALLED, EXAMPLE, "recipe.yaml", "drive.mcap"],
        cwd=project, env={**bare_environment(), "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    *lines, loaded = done.stdout.splitlines()
    assert json.loads(loaded) == []
    told = {asset: words.split(", ") for asset, words in (line.split(": ") for line in lines)}
    assert tuple(told) == recording_assets(load_recipe(project / "recipe.yaml")).names
    return {asset: state for asset, (state, _) in told.items()}, {
        asset: Path(folder) for asset, (_, folder) in told.items()
    }


@pytest.fixture
def project(tmp_path):
    (tmp_path / "bags").mkdir()
    write_drive(tmp_path / "bags" / "drive.mcap", "mcap", duration_s=1.0)
    return make_project(tmp_path, settle_s=0)


def test_a_recording_is_built_where_dagster_is_not_installed(project):
    states, folders = build_without_dagster(project)
    assert set(states.values()) == {"made"}
    assert all(any(folder.iterdir()) for folder in folders.values())
    again, same = build_without_dagster(project)
    assert set(again.values()) == {"found"}
    assert same == folders


def test_what_a_build_under_dagster_made_is_found(project):
    report = bagassets.build(project / "recipe.yaml")
    assert report.succeeded, report.summary
    assert set(build_without_dagster(project)[0].values()) == {"found"}


def test_the_page_shows_the_example():
    assert f"```python\n{EXAMPLE.read_text('utf-8')}```" in (ROOT / "docs" / "code.md").read_text("utf-8")


def test_it_is_short():
    assert len(EXAMPLE.read_text("utf-8").splitlines()) <= 30
