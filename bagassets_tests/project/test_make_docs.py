"""`make docs` writes all that pages show of the code, and it has been run."""

import json
import re
from pathlib import Path

import pytest

from scripts import docs
from scripts.call_path import call_path_table, cut
from scripts.code_size import ROOT, code_size_table, count
from scripts.wrap import WIDTH, wrapped

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def generated():
    return docs.generated()


def test_everything_is_up_to_date(generated):
    stale = [path.name for path, text in generated.items() if path.read_text("utf-8") != text]
    assert stale == [], "make docs"


def test_each_part_has_its_place(generated):
    text = "".join(text for path, text in generated.items() if path.suffix == ".md")
    for name in docs.PARTS:
        assert len(re.findall(f"<!-- (?:end of )?{name} -->", text)) == 2, name


def test_a_stale_part_is_written_anew(tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- graph -->\nold\n<!-- end of graph -->\nafter\n")
    monkeypatch.setattr(docs, "ROOT", tmp_path)
    monkeypatch.setattr(docs, "DOCS", tmp_path)
    monkeypatch.setattr(docs, "PICTURES", tmp_path)
    monkeypatch.setattr(docs, "pages", lambda: [page])
    docs.write()
    assert page.read_text() == (
        f"before\n<!-- graph -->\n\n```mermaid\n{docs.graph()}\n```\n\n<!-- end of graph -->\nafter\n"
    )
    names = ["page.md", "recipe.md", "assets.md", "architecture.svg", "architecture-dark.svg"]
    assert capsys.readouterr().out.splitlines() == [f"{name}: written anew" for name in names]
    docs.write()
    assert capsys.readouterr().out == ""


def test_make_runs_it():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert re.search(r"^docs: .*\n\t\$\(BIN\)/python -m scripts\.docs$", makefile, re.MULTILINE)


def test_the_product_is_counted(tmp_path):
    package = tmp_path / "bagassets"
    for name in ("defs/graph", "store/__pycache__"):
        (package / name).mkdir(parents=True)
    (package / "defs" / "dagster_private.py").write_text(
        '"""One.\n\n- `a` replaces\n  b;\n- c.\n"""\nif True:\n    from a import x, y\n'
    )
    (package / "defs" / "graph" / "assets.py").write_text("if True:\n    x = 1\n")
    (package / "store" / "store.py").write_text('"""Store."""\n')
    found = count(package)
    assert found == {
        "lines": 11, "statements": 6, "modules": 3, "folders": 2, "private": 2, "relied": 2, "patches": 1,
        "rooms": {"defs": 8, "defs/graph": 2, "store": 1},
    }  # fmt: skip
    assert "| lines, with docstrings and blank ones | 11 |" in code_size_table({"after": found})


def test_a_path_ends_at_the_executor():
    names = [
        "defs/graph/making.py:make_recording",
        "engine/execute.py:execute",
        "defs/records/touched.py:touch",
    ]
    assert cut({"at": name} for name in names) == [{"at": name} for name in names[:2]]


def test_stops_and_climbs_are_shown_before_and_after():
    counts = json.loads((Path(docs.ROOT) / "benchmarks" / "results" / "call_path.json").read_text("utf-8"))
    header, _, *rows = call_path_table(counts).splitlines()
    assert header == f"| stops / climbs | {' | '.join(counts)} |"
    assert len(rows) == 4


def test_prose_is_wrapped_and_nothing_else():
    words = " ".join(["word"] * 30)
    page = f"""# {words}

{words} `{words}`
more
- {words}
  {words}

| {words} |
|---|

```
{words}
```
<!-- {words} -->
1. {words}
> {words}
<!-- graph -->
{words} {words}
<!-- end of graph -->
"""
    new = wrapped(page)
    assert wrapped(new) == new
    assert new.split() == page.split()
    whole = [line for line in new.splitlines() if len(line) > WIDTH]
    assert whole == [
        f"# {words}",
        f"`{words}`",
        f"| {words} |",
        words,
        f"<!-- {words} -->",
        f"> {words}",
        f"{words} {words}",
    ]
    of_items = [line for line in new.splitlines() if line.startswith(("- ", "1. ", " "))]
    assert [line[:3].count(" ") for line in of_items] == [1, 2, 2, 1, 3]
