"""`bagassets demo`, as `make demo` calls it."""

import json
import os
import re
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.xdist_group("demo"), pytest.mark.once]

NAMES = ["drive_1.bag", "drive_2.bag", "drive_3", "drive_4", "drive_5.mcap", "drive_6.mcap"]


def run_demo(folder):
    done = subprocess.run(
        [sys.executable, "-m", "bagassets", "demo", str(folder), "--seconds", "1.5"],
        capture_output=True, text=True, timeout=300, check=False, env={**os.environ, "COLUMNS": "120"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    return folder, run_demo(folder)


def test_it_prints_a_row_per_recording_the_dataset_and_the_ui(demo):
    folder, output = demo
    rows = [line.split() for line in output.splitlines() if line.strip().startswith("drive_")]
    assert [row[0] for row in rows] == NAMES
    assert [row[1] for row in rows] == ["ros1"] * 2 + ["ros2"] * 2 + ["mcap"] * 2
    assert {row[-1] for row in rows} == {"built"}
    assert f"dataset: {folder}/nuscenes" in output
    assert "Writing 6 sample drives, once, which takes" in output
    assert re.findall(r"^wrote +(\d)/6 (\S+) \(\d+ s\)$", output, re.MULTILINE) == [
        (str(number), name) for number, name in enumerate(NAMES, 1)
    ]
    assert f"bagassets ui --recipe {folder}/recipe.yaml" in output


def test_the_dataset_has_a_scene_of_each_drive(demo):
    folder, _ = demo
    scenes = json.loads((folder / "nuscenes" / "v1.0-demo" / "scene.json").read_text())
    assert len(scenes) == len(NAMES)


def test_again_does_nothing_and_a_lost_drive_comes_back(demo):
    folder, _ = demo
    (folder / ".writing").mkdir()
    (folder / ".writing" / "drive_1.bag").write_text("half a drive, from an interrupted call")
    written = (folder / "recordings" / "drive_5.mcap").read_bytes()
    (folder / "recordings" / "drive_5.mcap").unlink()
    output = run_demo(folder)
    assert (folder / "recordings" / "drive_5.mcap").read_bytes() == written
    assert not (folder / ".writing").exists()
    assert "6 fresh" in output or "1 hit" in output
    assert "built" not in output
