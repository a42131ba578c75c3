"""How many clicks five tasks take in the web UI, from its front page, in a real Chromium.

Each task has several ways; the shortest that ends with what was asked for on the screen, without scrolling, in windows of
two sizes, counts (of the report, anywhere on the page). With `--before`, the same is done with the `bagassets` of another checkout::

    python -m benchmarks.clicks [--before CHECKOUT/.venv/bin/bagassets] [--json FILE]

The project has three recordings, one of them cut off.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.common import machine, markdown
from benchmarks.web_ui import web_ui

if TYPE_CHECKING:
    from scripts.browser import Browser

__all__ = ["TASKS", "clicks_table"]

_SIZES = ((1500, 1000), (1280, 800))
_SETTLE_S = 2.0
_REACHED_S = 60.0
_GOOD, _CUT, _OTHER = "drive_1.bag", "drive_2.bag", "drive_3.mcap"
_ON_SCREEN = "(e => { const r = e.getBoundingClientRect(); return r.width > 0 && r.top >= 0 && r.bottom <= innerHeight; })"
# Not covered by something else, as texts are that only measure a width.
_CLICKABLE = (
    "(e => { const r = e.getBoundingClientRect();"
    " return e.contains(document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2)); })"
)
_PICTURE = (
    "[...document.images].map(i => [i.naturalWidth, i.getBoundingClientRect().top])"
    ".some(([width, top]) => width >= 300 && top >= 0 && top < innerHeight - 100)"
)


def _said(text: str) -> str:
    """Return a script that is true if an element with this text, and no child with it, begins on the screen."""
    return (
        f"[...document.querySelectorAll('body *')].some(e => e.innerText?.includes({json.dumps(text)})"
        f" && ![...e.children].some(c => c.innerText?.includes({json.dumps(text)}))"
        " && e.getBoundingClientRect().top >= 0 && e.getBoundingClientRect().top < innerHeight - 20)"
    )


@dataclass(frozen=True)
class Task:
    """Something that people do.

    Attributes:
        title: what.
        goal: a script that is true once it is done.
        ways: the texts to click, one after the other.
    """

    title: str
    goal: str
    ways: Sequence[Sequence[str]]


_MARKDOWN = "[Show Markdown]"
_CHOOSE = ("Lineage", "Materialize all…", "Select a partition or create one", _GOOD)
TASKS = (
    Task(
        "build one recording",
        _said("Launched run"),
        [
            [*_CHOOSE, "Launch 1 run"],
            [*_CHOOSE, "Launch runs to materialize 12 assets", "Launch 1 run"],  # the list covers the button
        ],
    ),
    Task(
        "find out why one failed",
        _said("it cannot be read"),
        [
            ["Catalog", "nuscenes_dataset"],
            ["Catalog", "dataset_inputs"],
            ["Catalog", "nuscenes_dataset", _MARKDOWN],
            ["Catalog", "nuscenes_tables", "Partitions", _CUT, "View all historical events"],
            ["Runs", "Failed", "View"],
        ],
    ),
    Task(
        "look at a picture of a recording",
        _PICTURE,
        [["Catalog", "preview"], ["Catalog", "preview", _MARKDOWN]],
    ),
    Task(
        "compare the numbers of all recordings, side by side",
        f"document.title.includes('report') && ['{_GOOD}', '{_OTHER}'].every(n => document.body.innerText.includes(n))",
        [["Catalog", "nuscenes_dataset", "Open the report"]],
    ),
    Task(
        "compare the pictures of two recordings",
        _PICTURE,
        [
            ["Catalog", "preview", "Partitions", _GOOD, _OTHER],
            ["Catalog", "preview", "Partitions", _GOOD, _MARKDOWN, _OTHER, _MARKDOWN],
        ],
    ),
    Task(
        "rebuild the dataset",
        _said("Launched run"),
        [["Catalog", "nuscenes_dataset", "Materialize"]],
    ),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--before", type=Path, help="the command `bagassets` of another version")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    found: dict[str, Any] = {"now": _count(Path(sys.executable).with_name("bagassets"))}
    if options.before is not None:
        found["before"] = _count(options.before.absolute())
    elif options.json is not None and options.json.exists():  # a version that is out does not change
        found |= {"before": json.loads(options.json.read_text("utf-8")).get("before")}
    print(clicks_table(found))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine(), **found}, indent=1) + "\n", "utf-8")


def clicks_table(found: dict[str, Any]) -> str:
    """Return the table of `clicks.json`."""
    now, before = found["now"], found.get("before")
    header = ["", *([before["version"]] if before else []), "now", "by"]
    rows = []
    for title, way in now["ways"].items():
        earlier = [_number(before["ways"][title])] if before else []
        rows.append([title, *earlier, _number(way), ", ".join(way or [])])
    return markdown(header, rows)


def _number(way: list[str] | None) -> str:
    return "no way" if way is None else str(len(way))


def _count(program: Path) -> dict[str, Any]:
    """Return task -> the shortest way with a version of bagassets, in a new project."""
    version = subprocess.run([program, "--version"], check=True, stdout=subprocess.PIPE, text=True).stdout
    ways: dict[str, list[str] | None] = {}
    with tempfile.TemporaryDirectory(prefix="clicks-", ignore_cleanup_errors=True) as folder:
        recipe = _project(program, Path(folder))
        with web_ui([program], recipe) as url:
            for task in TASKS:
                ways[task.title] = next(
                    (list(way) for way in sorted(task.ways, key=len) if _reaches_in_all(url, task, way)), None
                )
                print(f"{program}: {task.title}: {ways[task.title]}", flush=True)
    return {"version": version.split()[-1], "ways": ways}


def _project(program: Path, folder: Path) -> Path:
    """Build a project with a recording that is cut off; return its recipe."""

    def run(*arguments: str | Path, check: bool = True) -> None:
        subprocess.run([program, *arguments], check=check, cwd=folder, stdout=subprocess.DEVNULL)

    (folder / "recordings").mkdir()
    for seed, name in enumerate((_GOOD, _CUT, _OTHER), 1):
        run("sample", f"recordings/{name}", "--seed", str(seed), "--duration", "5")
    run("init", "project", "--bags", "recordings")
    cut = folder / "recordings" / _CUT
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    recipe = folder / "project" / "recipe.yaml"
    run("build", "--recipe", recipe, check=False)  # one recording fails
    return recipe


def _reaches_in_all(url: str, task: Task, way: Sequence[str]) -> bool:
    return all(_reaches(url, task, way, width, height) for width, height in _SIZES)


def _reaches(url: str, task: Task, way: Sequence[str], width: int, height: int) -> bool:
    """Go a way in a new browser; tell whether it leads to the goal."""
    from scripts.browser import Browser

    with Browser(width, height) as browser:
        browser.open(url)
        browser.wait_for_text("Catalog", "Lineage")
        try:
            for text in way:
                _click(browser, text)
        except TimeoutError:
            return False
        deadline = time.monotonic() + _REACHED_S
        while not browser.run(task.goal):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.5)
    return True


def _click(browser: "Browser", text: str) -> None:
    """Click what shows a text, and let the page settle."""
    said = r"(e.innerText || e.placeholder || e.title || '').trim().replace(/ \(\d+\)$/, '')"
    shown = f"{said} === {json.dumps(text)} && {_ON_SCREEN}(e) && {_CLICKABLE}(e)"
    found = " || ".join(
        f"[...document.querySelectorAll('{kinds}')].filter(e => {shown}).at({which})"
        for kinds, which in (("a, button, [role=tab]", 0), ("div, span, input", -1))
    )
    browser.wait_for(f"!!({found})", text)
    time.sleep(_SETTLE_S)
    # A link that would open in a new tab is followed in this one: the browser steers one page.
    browser.run(f"void ({found})?.closest('a')?.removeAttribute('target')")
    browser.click(f"({found})")


if __name__ == "__main__":
    main()
