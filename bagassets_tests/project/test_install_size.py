"""What an installation holds, and that its size, as the docs have it, is what its script measured."""

import json
import re
import tomllib
from pathlib import Path

from scripts import project_size
from scripts.install_size import OPTIONAL, REASONS, RESULT, SHOWN, size_of, table
from scripts.project_size import RESULT as PROJECT

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "install.md").read_text("utf-8")
MEASURED = json.loads(RESULT.read_text("utf-8"))


def test_the_table_is_the_result():
    shown = PAGE.partition("<!-- size -->\n")[2].partition("\n<!-- end of size -->")[0]
    assert shown == table(MEASURED), "docs/install.md: python -m scripts.install_size --print"
    assert f"({MEASURED['system']}, " in PAGE
    assert f"Python {MEASURED['python'].rpartition('.')[0]})" in PAGE


def test_every_package_that_is_shown_has_a_reason():
    assert [name for name in list(MEASURED["packages"])[:SHOWN] if name not in REASONS] == []
    needed = {name for name, (_, without) in REASONS.items() if without.startswith("needed")}
    assert needed.isdisjoint(OPTIONAL)
    assert needed | set(OPTIONAL) == REASONS.keys()


def test_what_a_project_takes_is_what_was_measured():
    shown = PAGE.partition("<!-- project -->\n")[2].partition("\n<!-- end of project -->")[0]
    result = json.loads(PROJECT.read_text("utf-8"))
    assert shown == project_size.table(result), "docs/install.md: python scripts/project_size.py --print"


def test_files_with_several_names_count_once(tmp_path):
    artifact = tmp_path / ".bagassets" / "store" / "artifacts" / "a"
    artifact.parent.mkdir(parents=True)
    artifact.write_bytes(bytes(7))
    for folder in ("nuscenes", "recordings"):
        (tmp_path / folder).mkdir()
    (tmp_path / "nuscenes" / "a.jpg").hardlink_to(artifact)
    (tmp_path / "nuscenes" / "scene.json").write_bytes(bytes(5))
    (tmp_path / "recordings" / "a.bag").write_bytes(bytes(100))
    (tmp_path / "recordings" / "link.bag").symlink_to("a.bag")
    found = project_size.sizes(tmp_path)
    assert {part: (one["bytes"], one["files"]) for part, one in found.items() if one["files"]} == {
        "recordings": (100, 1), "store/artifacts": (7, 1), "dataset": (5, 1),
    }  # fmt: skip


def test_the_readme_has_the_same_figures():
    readme = (ROOT / "README.md").read_text("utf-8")
    found = re.search(r"(\d+) MB, of which\s+`pip uninstall llvmlite` frees (\d+)", readme)
    llvmlite = MEASURED["packages"]["llvmlite"]["bytes"]
    assert [int(one) for one in found.groups()] == [
        round(MEASURED["total_bytes"] / 1e6),
        round(llvmlite / 1e6),
    ]


def test_links_and_folders_count_nothing(tmp_path):
    (tmp_path / "file").write_bytes(bytes(7))
    (tmp_path / "link").symlink_to("file")
    assert [size_of(str(path)) for path in (tmp_path / "file", tmp_path / "link", tmp_path)] == [7, 0, 0]
    assert size_of(str(tmp_path / "gone")) == 0


def test_only_the_package_is_installed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["bagassets"]
