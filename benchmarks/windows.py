"""What the pages of the web UI cut off at the right of a window, and how long the report takes to open, in a real Chromium.

The project has twelve short recordings, one of them cut off and one too short; the report that is timed has all that this one
has of them, over and over, until it has 300::

    python -m benchmarks.windows [--recordings 300] [--pictures FOLDER] [--json FILE]

An element counts as cut off if its content is wider than itself, and only scrolling shows the rest.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.formats.report_data import report_data
from bagassets.propose.project import write_project
from bagassets.report.page import report_page
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from benchmarks.common import machine
from benchmarks.web_ui import web_ui

if TYPE_CHECKING:
    from scripts.browser import Browser

__all__ = ["PAGES", "SIZES", "cut_off", "look", "project", "report_opened", "seconds_to_open"]

SIZES = ((1500, 1000), (1280, 800))
REPORT = "/bagassets/pages/report"
# Of one that is not skipped; the overview shows whichever recording came last.
_PARTITION = "/assets/{}?view=partitions&partition=2026-11-28_ring_road_north_0000.bag"
PAGES = {
    "nuscenes_dataset": ("/assets/nuscenes_dataset?view=overview", "cannot be read"),
    "dataset_inputs": ("/assets/dataset_inputs?view=overview", "cannot be read"),
    "trajectory_map": ("/assets/trajectory_map?view=overview", "trajectory_map.html"),
    "inventory": ("/assets/inventory?view=overview", "contents"),
    "calibration": (_PARTITION.format("calibration"), "mounting"),
    "frames": ("/assets/frames?view=events", "content_digest"),
    "preview": (_PARTITION.format("preview"), "picture_timeline"),
    "report": (REPORT, "Left out"),
    "map": ("/bagassets/pages/map", "train"),
}
"""Page -> its address below that of the web server, and a text that it shows once it is complete."""

_CUT_OFF = """[document.documentElement, ...document.querySelectorAll('body *')].filter(e =>
  e.clientWidth > 0 && e.scrollWidth > e.clientWidth + 1
  && (e === document.documentElement || ['auto', 'scroll'].includes(getComputedStyle(e).overflowX))
).map(e => `${e.tagName.toLowerCase()}.${e.className}: ${e.scrollWidth} of ${e.clientWidth} pixels`)"""
_OPEN_S = "(() => { const t = performance.getEntriesByType('navigation')[0]; return t && t.loadEventEnd / 1000; })()"
_SETTLE_S = 1.0
_TIMES = 5
_BUILT = 12


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=300, help="in the report that is timed")
    parser.add_argument("--pictures", type=Path, help="write a picture of each page here")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="windows-", ignore_cleanup_errors=True) as folder:
        recipe = project(Path(folder), _BUILT)
        with web_ui([Path(sys.executable).with_name("bagassets")], recipe) as url:
            found = look(url, options.pictures)
            # In place of the report, so that it comes from the web server.
            page = recipe.parent / ".bagassets" / "report.html"
            page.write_text(_long_report(recipe, options.recordings), "utf-8")
            seconds = [seconds_to_open(f"{url}{REPORT}") for _ in range(_TIMES)]
        report = {"recordings": options.recordings, "bytes": page.stat().st_size, "seconds": seconds}
    print(json.dumps({"cut_off": found, "report": report}, indent=1))
    if options.json is not None:
        figures = {"machine": machine(), "cut_off": found, "report": report}
        options.json.write_text(json.dumps(figures, indent=1) + "\n", "utf-8")


def report_opened(found: dict[str, Any]) -> str:
    """Return what `windows.json` says about the report."""
    report = found["report"]
    seconds = statistics.median(report["seconds"])
    return f"{report['recordings']} recordings it has {report['bytes'] / 1e6:.1f} MB and opens in {seconds:.1f} s"


def look(url: str, pictures: Path | None = None) -> dict[str, list[str]]:
    """Open all pages in windows of all sizes; return what is cut off: page and size -> elements.

    Args:
        url: address of the web server.
        pictures: folder for a picture of each.
    """
    from scripts.browser import Browser

    found = {}
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
    with Browser(*SIZES[0]) as browser:
        for name, (address, text) in PAGES.items():
            browser.open(f"{url}{address}")
            browser.wait_for_text(text)
            time.sleep(_SETTLE_S)
            for width, height in SIZES:
                browser.resize(width, height)
                time.sleep(_SETTLE_S)
                if cut := cut_off(browser):
                    found[f"{name} at {width} x {height}"] = cut
                if pictures is not None:
                    browser.picture(pictures / f"{name}_{width}x{height}.png")
    return found


def cut_off(browser: "Browser") -> list[str]:
    """Return the elements of a page whose content is wider than they are."""
    found: list[str] = browser.run(_CUT_OFF)
    return found


def seconds_to_open(url: str) -> float:
    """Return how long a page takes until it is loaded, in a new browser."""
    from scripts.browser import Browser

    with Browser(*SIZES[0]) as browser:
        browser.open(url)
        return float(browser.wait_for(_OPEN_S))


def _long_report(recipe: Path, number: int) -> str:
    """Return the report of a project as if it had so many recordings."""
    with open_project(recipe) as workspace:
        plan = plan_instance(workspace)
        data = report_data(workspace.assets, plan, "all")
    built = data.recordings
    recordings = [
        replace(built[n % len(built)], key=f"{n:04}_{built[n % len(built)].key}") for n in range(number)
    ]
    return report_page(replace(data, recordings=recordings))


def project(folder: Path, number: int) -> Path:
    """Build a project of so many recordings; return its recipe."""
    recordings = folder / "recordings"
    paths = [recordings / f"2026-11-28_ring_road_north_{seed:04}.bag" for seed in range(number)]
    with ProcessPoolExecutor() as pool:
        list(pool.map(_write, paths, range(number)))
    recipe = folder / "recipe.yaml"
    text = sample_recipe(root=str(recordings))
    text = text.replace("bags:\n", "bags:\n  min_duration_s: 0.5\n", 1)
    write_project(folder, text.replace("\nscenes:\n", "\nscenes:\n  min_length_s: 0.5\n", 1))
    subprocess.run(
        [Path(sys.executable).with_name("bagassets"), "build", "--recipe", recipe],
        check=False,  # some recordings fail
        stdout=subprocess.DEVNULL,
    )
    return recipe


def _write(path: Path, seed: int) -> None:
    write_recordings([Target(path, "ros1")], seed, "small", 0.3 if seed == 2 else 1.0)
    if seed == 1:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


if __name__ == "__main__":
    main()
