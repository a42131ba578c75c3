"""The web UI, the report and the map in a real Chromium, in a large window and in a small one."""

import json
import shutil
import sys
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from bagassets.report.map_shell import map_shell
from bagassets.report.model import Problem, RecordingFacts, ReportData
from bagassets.report.page import report_page
from bagassets.report.trajectory_map import MapRoute, trajectory_map_page
from bagassets_tests.services import BIN, free_port, running
from benchmarks.web_ui import wait_until, web_ui
from benchmarks.windows import PAGES, SIZES, cut_off, look, project, seconds_to_open
from scripts.browser import Browser

pytestmark = [
    pytest.mark.long,
    pytest.mark.once,
    pytest.mark.xdist_group("ui"),
    pytest.mark.skipif(shutil.which("chromium") is None, reason="Debian: apt-get install chromium"),
]

NAME = "2026-11-28_a_drive_with_a_long_name_in_the_north"


@pytest.fixture(scope="module")
def browser():
    with Browser(*SIZES[0]) as opened:
        yield opened


def disconnect(browser, *, offline):
    browser.call("Network.enable")
    speed = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    browser.call("Network.emulateNetworkConditions", offline=offline, **speed)


def test_no_page_is_cut_off_and_the_link_opens_the_report(tmp_path, browser):
    recipe = project(tmp_path, 3)  # the second one is cut off, the third one too short
    with web_ui([Path(sys.executable).with_name("bagassets")], recipe) as url:
        assert look(url) == {}
        for width, height in SIZES:
            browser.resize(width, height)
            browser.open(f"{url}/assets/nuscenes_dataset?view=overview")
            browser.wait_for_text("its index is damaged", "`bagassets doctor` shows what is lost.")
            browser.run("document.querySelector('a[href$=\"/pages/report\"]').removeAttribute('target')")
            browser.click_text("Open the report")
            browser.wait_for_text("Left out", "bags.min_duration_s asks for 0.5 s")


def test_dagsters_own_web_server_shows_no_link_that_leads_nowhere(tmp_path, browser):
    project(tmp_path, 3)
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    with running([BIN / "dagster", "dev", "-p", port], tmp_path, tmp_path / "dev.log"):
        wait_until(lambda: urlopen(f"{url}/server_info", timeout=5).status == 200, "`dagster dev` answers")
        for width, height in SIZES:
            browser.resize(width, height)
            for name, text, ours in (
                ("nuscenes_dataset", str(tmp_path / ".bagassets" / "report.html"), 1),
                ("trajectory_map", str(tmp_path / ".bagassets" / "trajectory_map.html"), 1),
                ("preview", "picture_timeline", 5),
            ):
                browser.open(f"{url}{PAGES[name][0]}")
                browser.wait_for_text(text)
                links = "[...document.querySelectorAll('a[href^=\"/bagassets/\"]')]"
                browser.wait_for(f"{links}.length === {ours}")
                assert browser.run(f"{links}.filter(e => e.getBoundingClientRect().width).length") == 0, name
            browser.open(f"{url}{PAGES['dataset_inputs'][0]}")
            browser.wait_for_text("its index is damaged", "bags.min_duration_s asks for 0.5 s")
            assert cut_off(browser) == []


def test_a_report_of_300_recordings_opens_in_two_seconds(tmp_path, browser):
    picture = tmp_path / "thumbnail.jpg"
    noise = np.random.default_rng(1).integers(0, 255, (90, 160, 3), dtype=np.uint8)
    cv2.imwrite(str(picture), noise)
    slow = Problem("topic_rates", "warn", "/cam/image_raw: a pause of 2.5 s; at most 1 s expected")
    recordings = [
        RecordingFacts(
            f"{NAME}_{number:03}.bag", "ready", "", "ros1", 5 * 10**9, 1_700_000_000 * 10**9, 3600.0, 3600.0, "car", "train",
            "twilight", 45_600.0, {"images": 144_000, "sweeps": 36_000, "poses": 180_000, "boxes": 720_000}, {"car": 9},
            problems=[slow], checks_passed=14, points=[(48.0, 11.0), (48.0 + number / 300, 11.1)],
            pictures={"Lidar over camera": picture}, thumbnail=picture, full_pictures=tmp_path,
        )
        for number in range(300)
    ]  # fmt: skip
    page = tmp_path / "report.html"
    page.write_text(report_page(ReportData("yard", tmp_path / "nuscenes", recordings)))
    assert min(seconds_to_open(page.as_uri()) for _ in range(3)) <= 2.0
    for width, height in SIZES:
        browser.resize(width, height)
        browser.open(page.as_uri())
        browser.wait_for_text("300 recordings", "a pause of 2.5 s; at most 1 s expected")
        assert cut_off(browser) == []
    assert browser.run("document.body.innerText.split('a pause of 2.5 s').length") == 2, "told once"
    assert browser.run("document.querySelectorAll('#recordings tbody tr').length") == 300


def test_without_a_network_the_map_has_names_and_a_legend(tmp_path, browser):
    routes = [
        MapRoute(f"{NAME}_{number}.bag", split, colour, "20 s", [(48.0 + number / 500, 11.0), (48.0 + number / 500, 11.02)])
        for number, (split, colour) in enumerate([("train", "#2f7ed8"), ("val", "#d9822b"), ("train", "#2f7ed8")])
    ]  # fmt: skip
    page = tmp_path / "map.html"
    page.write_text(trajectory_map_page(routes, map_shell()))
    disconnect(browser, offline=True)
    for width, height in SIZES:
        browser.resize(width, height)
        browser.open(page.as_uri())
        browser.wait_for("document.getElementById('nomap')?.style.display === 'block'")
        assert cut_off(browser) == []
        for route in routes:
            texts = (
                f"[...document.querySelectorAll('#nomap text')].filter(e => e.textContent === '{route.key}')"
            )
            x, y, right, bottom = browser.run(
                f"(r => [r.x, r.y, r.right, r.bottom])({texts}[0].getBoundingClientRect())"
            )
            assert 0 <= x < right <= width
            assert 0 <= y < bottom <= height
        browser.wait_for_text("train (2)", "val (1)")
    name = "[...document.querySelectorAll('#nomap .legend [data-way]')][0]"
    box = browser.box(name)
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=box["x"] + 5, y=box["y"] + 5)
    pointed_at = f"[{name}.dataset.way, document.querySelector('polyline.on')?.dataset.way]"
    browser.wait_for(f"{pointed_at}.every(way => way === {json.dumps(routes[0].key)})")
    disconnect(browser, offline=False)
