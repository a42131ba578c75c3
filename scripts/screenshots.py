"""Take the pictures of the web UI that docs/first-steps.md and docs/ui.md show.

    python scripts/screenshots.py                          # of build/demo, which `make demo` makes
    python scripts/screenshots.py --recipe my/recipe.yaml --output /tmp/pictures --only asset_graph

`failed`, `skipped` and `materialized_all` are of a small project of its own, with one recording that is cut off and one that is too short.
Starts the web UI itself, waits until the sensor has nothing to do, and looks at the pages with a headless Chromium
(Debian: apt-get install chromium).
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import cv2
import numpy as np
from browser import Browser

from bagassets.defs.ui.ports import free_port
from bagassets.defs.ui.services import Services
from bagassets.propose.project import write_project
from bagassets.sample.demo import missing_drives, write_drives
from bagassets.sample.recipe import sample_recipe

HOST = "127.0.0.1"
WIDTH, HEIGHT = 1400, 780
LOCATION = "/locations/__repository__@bagassets.definitions"
GROUPS = "global%40global%3Adataset%2Cglobal%40global%3Arecording"
WAIT_S = 120.0
SETTLE_S = 2.0  # until the page has stopped moving
BUTTONS = "[...document.querySelectorAll('[aria-label=panel_show_right]')]"
BACKFILLS = """{
  partitionBackfillsOrError(limit: 1) { ... on PartitionBackfills { results { status } } }
}"""
QUIET = """{
  runsOrError(filter: {statuses: [QUEUED, NOT_STARTED, STARTING, STARTED, CANCELING]}, limit: 1) {
    ... on Runs { results { runId } }
  }
  sensorOrError(sensorSelector: {
    repositoryName: "__repository__", repositoryLocationName: "bagassets.definitions", sensorName: "recordings"
  }) { ... on Sensor { sensorState { ticks(limit: 2) { status } } } }
}"""


def main() -> None:
    """Take all pictures, or those asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--recipe", type=Path, default=Path("build/demo/recipe.yaml"))
    parser.add_argument("--output", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--only", choices=sorted(PICTURES | FAILURES), action="append")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    wanted = arguments.only or [*PICTURES, *FAILURES]
    if ordinary := [name for name in wanted if name in PICTURES]:
        take(arguments.recipe, ordinary, arguments.output)
    if failures := [name for name in wanted if name in FAILURES]:
        with tempfile.TemporaryDirectory(prefix="screenshots-", ignore_cleanup_errors=True) as folder:
            take(broken_project(Path(folder)), failures, arguments.output)


def take(recipe: Path, names: Iterable[str], output: Path) -> None:
    """Take pictures of a project."""
    with Services(recipe, HOST, free_port(HOST, 3100)) as services:
        services.wait_until_ready(lambda: False)
        wait_until_quiet(services.url)
        for name in names:
            file = output / f"{name}.png"
            with Browser(WIDTH, HEIGHT) as browser:
                fold_navigation(browser, services.url)
                (PICTURES | FAILURES)[name](browser, services.url, file)
            squeeze(file)
            print(f"{file}  {file.stat().st_size / 1000:.0f} kB")
        services.stop()
        services.end_runs(lambda _runs: None, cancel=lambda: True)


def broken_project(folder: Path) -> Path:
    """Build a project of a good recording, one that is cut off and one that is too short; return its recipe."""
    recordings = folder / "recordings"
    good, cut, short = missing_drives(recordings)[:3]
    for drive, seconds in ((good, 5.0), (cut, 5.0), (short, 1.0)):
        list(write_drives(recordings, [drive], seconds))
    place = recordings / cut.path
    [file] = [place] if place.is_file() else place.glob("*.db3")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    recipe = folder / "recipe.yaml"
    text = sample_recipe(name="demo", version="v1.0-demo")
    write_project(folder, text.replace("bags:\n", "bags:\n  min_duration_s: 2\n", 1))
    subprocess.run(
        [Path(sys.executable).with_name("bagassets"), "build", "--recipe", recipe],
        check=False,
        stdout=subprocess.DEVNULL,
    )
    return recipe


def ask(url: str, query: str) -> Any:
    """Return the answer to a GraphQL query."""
    request = Request(
        f"{url}/graphql", json.dumps({"query": query}).encode(), {"Content-Type": "application/json"}
    )
    with urlopen(request) as answer:
        return json.load(answer)["data"]


def wait_until_quiet(url: str) -> None:
    """Wait until no run is active and the sensor had nothing to ask for twice."""
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        data = ask(url, QUIET)
        ticks = [tick["status"] for tick in data["sensorOrError"]["sensorState"]["ticks"]]
        if not data["runsOrError"]["results"] and len(ticks) > 1 and set(ticks) == {"SKIPPED"}:
            return
        time.sleep(1)
    raise SystemExit("the sensor still has something to do; build the dataset first")


def fold_navigation(browser: Browser, url: str) -> None:
    """Fold the navigation to its icons, and have the graph's list of assets folded too."""
    browser.open(f"{url}/asset-groups?expanded={GROUPS}")
    browser.wait_for_text("Materialize all")
    time.sleep(SETTLE_S)
    browser.click(f"{BUTTONS}.find(e => e.getBoundingClientRect().y < 200)")
    browser.click(f"{BUTTONS}.find(e => e.getBoundingClientRect().y > 200)")
    time.sleep(0.5)


def show(browser: Browser, url: str, *texts: str) -> None:
    """Open a page and wait until it shows `texts` and stands still."""
    browser.open(url)
    browser.wait_for_text(*texts)
    time.sleep(SETTLE_S)


def top(height: int) -> dict[str, float]:
    """Return the upper part of a page, which is the one that matters."""
    return {"x": 0, "y": 0, "width": WIDTH, "height": height}


def asset_graph(browser: Browser, url: str, file: Path) -> None:
    """Both groups with all assets."""
    browser.resize(1500, 860)
    show(browser, f"{url}/asset-groups?expanded={GROUPS}", "Materialize all", "nuscenes_dataset")
    browser.click(f"{BUTTONS}.find(e => e.getBoundingClientRect().y < 200)")
    time.sleep(SETTLE_S)
    right = browser.run(
        "Math.max(...[...document.querySelectorAll('foreignObject, svg rect')]"
        ".map(e => e.getBoundingClientRect().right).filter(x => x < innerWidth))"
    )
    browser.resize(int(right) + 130, 860)
    time.sleep(SETTLE_S)
    browser.picture(file)


def asset(browser: Browser, url: str, file: Path) -> None:
    """What one asset says about itself."""
    show(browser, f"{url}/assets/frames?view=overview", "Description", "size_bytes")
    browser.picture(file)


def partitions(browser: Browser, url: str, file: Path) -> None:
    """One recording's materialization among all recordings."""
    show(browser, f"{url}/assets/sweeps?view=partitions", "Partitions Selected", "drive_3")
    browser.click("[...document.querySelectorAll('div')].filter(e => /^drive_3$/.test(e.innerText)).pop()")
    browser.wait_for_text("size_bytes")
    time.sleep(SETTLE_S)
    browser.picture(file, top(600))


def checks(browser: Browser, url: str, file: Path) -> None:
    """The checks of the tables, recording by recording."""
    show(browser, f"{url}/assets/nuscenes_tables?view=checks", "Execute all", "Latest execution")
    browser.picture(file, top(620))


def runs(browser: Browser, url: str, file: Path) -> None:
    """The runs that made all this."""
    show(browser, f"{url}/runs", "Launched by", "Success")
    browser.picture(file)


def sensor(browser: Browser, url: str, file: Path) -> None:
    """The sensor and its last looks."""
    show(browser, f"{url}{LOCATION}/sensors/recordings", "Latest tick")
    browser.picture(file)


def preview(browser: Browser, url: str, file: Path) -> None:
    """The pictures of a recording on its materialization."""
    show(browser, f"{url}/assets/preview?view=overview", "picture_lidar_over_camera")
    served = "[...document.images].find(i => i.src.includes('/bagassets/artifacts/'))"
    browser.wait_for(f"{served}?.naturalWidth > 300")
    browser.picture(file)


def choose(browser: Browser, url: str, asset: str, status: str) -> None:
    """Open the only partition of an asset that has a status: FAILED, MISSING, …."""
    show(browser, f"{url}/assets/{asset}?view=partitions&status={status}", "Partitions Selected")
    browser.click(
        "[...document.querySelectorAll('div')].filter(e => /^drive_\\d\\S*$/.test(e.innerText)).pop()"
    )


def failed(browser: Browser, url: str, file: Path) -> None:
    """Why an asset of a recording was not made."""
    choose(browser, url, "nuscenes_tables", "FAILED")
    browser.wait_for_text("did not materialize this asset")
    browser.click("[...document.querySelectorAll('button')].find(e => e.innerText.includes('historical'))")
    browser.wait_for_text("Historical events for")
    browser.click("[...document.querySelectorAll('button')].find(e => e.className.includes('isclosure'))")
    browser.wait_for_text("not_made")
    time.sleep(SETTLE_S)
    browser.picture(file)


def skipped(browser: Browser, url: str, file: Path) -> None:
    """Why a recording takes no part."""
    show(browser, f"{url}/assets/inventory?view=partitions", "Partitions Selected")
    browser.click(
        "[...document.querySelectorAll('div')].filter(e => /^drive_3\\S*$/.test(e.innerText)).pop()"
    )
    browser.wait_for_text("min_duration_s")
    time.sleep(SETTLE_S)
    browser.picture(file, top(600))


def materialized_all(browser: Browser, url: str, file: Path) -> None:
    """All assets after *Materialize all* of all partitions, one of which cannot be made."""
    browser.resize(1500, 860)
    show(browser, f"{url}/asset-groups?expanded={GROUPS}", "Materialize all", "nuscenes_dataset")
    for text in ("Materialize all…", "All", "Launch backfill"):
        browser.click_text(text)
        time.sleep(SETTLE_S)
    deadline = time.monotonic() + WAIT_S
    while ask(url, BACKFILLS)["partitionBackfillsOrError"]["results"][0]["status"] in {
        "REQUESTED",
        "FAILING",
    }:
        if time.monotonic() > deadline:
            raise SystemExit("the backfill does not end")
        time.sleep(1)
    wait_until_quiet(url)
    asset_graph(browser, url, file)


PICTURES: dict[str, Callable[[Browser, str, Path], None]] = {
    function.__name__: function
    for function in (asset_graph, asset, partitions, checks, runs, sensor, preview)
}
FAILURES: dict[str, Callable[[Browser, str, Path], None]] = {
    function.__name__: function for function in (failed, skipped, materialized_all)
}


def squeeze(file: Path) -> None:
    """Write a PNG anew, as small as it gets."""
    cv2.imwrite(str(file), np.asarray(cv2.imread(str(file))), [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
