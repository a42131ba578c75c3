"""What an installation holds, and that its size, as the docs have it, is what its script measured."""

import json
import re
import tomllib
from pathlib import Path

from scripts.install_size import REASONS, RESULT, SHOWN, size_of, table

ROOT = Path(__file__).parents[1]
MEASURED = json.loads(RESULT.read_text("utf-8"))


def test_the_table_is_the_result():
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    shown = page.partition("<!-- size -->\n")[2].partition("\n<!-- end of size -->")[0]
    assert shown == table(MEASURED), "docs/install.md: python scripts/install_size.py --print"
    assert f"({MEASURED['system']}, " in page
    assert f"Python {MEASURED['python'].rpartition('.')[0]})" in page


def test_every_package_that_is_shown_has_a_reason():
    assert [name for name in list(MEASURED["packages"])[:SHOWN] if name not in REASONS] == []


def test_the_readme_has_the_same_figures():
    readme = (ROOT / "README.md").read_text("utf-8")
    found = re.search(r"It takes (\d+) MB; `pip uninstall llvmlite` frees (\d+) of\s+them", readme)
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
