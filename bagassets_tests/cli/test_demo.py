"""`bagassets demo`, as `make demo` calls it."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bagassets import open_dataset
from bagassets.sample.arm import LEAD_S, ArmTruth
from bagassets.sample.drive import drive_start_ns
from bagassets_tests.sample_drives import number_in
from bagassets_tests.services import WAIT_S, eventually, processes_of, running

pytestmark = [pytest.mark.xdist_group("demo"), pytest.mark.once]

NAMES = ["drive_1.bag", "drive_2.bag", "drive_3", "drive_4", "drive_5.mcap", "drive_6.mcap"]


def run_demo(folder, *options):
    done = subprocess.run(
        [sys.executable, "-m", "bagassets", "demo", str(folder), *(options or ("--seconds", "1.5"))],
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
    assert re.findall(r"^wrote +(\d)/6 (\S+) \(\d+ (?:s|min)\b.*\)$", output, re.MULTILINE) == [
        (str(number), name) for number, name in enumerate(NAMES, 1)
    ]
    assert f"bagassets ui --recipe {folder}/recipe.yaml" in output


def test_the_dataset_has_a_scene_of_each_drive(demo):
    folder, _ = demo
    scenes = json.loads((folder / "nuscenes" / "v1.0-demo" / "scene.json").read_text())
    assert len(scenes) == len(NAMES)


@pytest.mark.parametrize("moment", ["importing", "writing"])
def test_an_interrupt_ends_it_at_once_and_in_a_word(tmp_path, moment):
    """A terminal sends it to the processes that write the drives, too."""

    def is_importing(pid):
        try:
            return "numpy" in Path("/proc", str(pid), "maps").read_text()
        except OSError:  # it has just ended
            return False

    command = [sys.executable, "-m", "bagassets", "demo", tmp_path / "demo", "--seconds", "600"]
    with running(command, tmp_path, tmp_path / "log") as process:
        if moment == "importing":
            eventually(lambda: sum(map(is_importing, processes_of(process.pid))) > 1, "they import")
        else:
            eventually(lambda: list((tmp_path / "demo").glob(".writing/*")), "they write")
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(WAIT_S) == 130
        eventually(lambda: not processes_of(process.pid), "the others have ended")
    said = (tmp_path / "log").read_text().splitlines()
    assert [line for line in said if line and "Writing 6 sample drives" not in line] == ["Interrupted."]


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


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    return folder, run_demo(folder, "--robot", "arm", "--seconds", "2.2")


@pytest.mark.long
def test_the_arm_ends_in_a_lerobot_dataset_of_the_truth(arm):
    folder, output = arm
    assert f"dataset: {folder}/lerobot" in output
    dataset = open_dataset(folder / "lerobot")
    truths = [ArmTruth(seed, drive_start_ns(seed), 640, 400) for seed in (1, 2, 3)]
    by_task = {truth.episodes(2.2)[0][2]: truth for truth in truths}
    assert sorted(scene.description for scene in dataset.scenes) == sorted(by_task)
    for scene in dataset.scenes:
        truth = by_task[scene.description]
        shown = [[number_in(frame.image(name)) for name in dataset.channels] for frame in scene]
        first = shown[0][0]
        assert shown == [[first + number] * 2 for number in range(len(scene))]
        # Each image is the latest one at its frame, and so are state and action: at most a period old.
        times_s = np.array(
            [truth.seconds(truth.image_stamp_ns(first + number)) for number in range(len(scene))]
        )
        for name, lead_s, period_s in (("observation.state", 0.0, 0.01), ("action", LEAD_S, 0.02)):
            values = np.stack([frame.values[name] for frame in scene])
            candidates = np.stack(
                [truth.positions(np.round((times_s + late_s) / period_s) * period_s + lead_s)
                 for late_s in np.arange(-period_s, 1 / 30, 0.005)]
            )  # fmt: skip
            assert np.abs(candidates - values).max(axis=2).min(axis=0).max() < 0.005


@pytest.mark.long
def test_the_demos_of_two_robots_do_not_mix(arm):
    folder, _ = arm
    done = subprocess.run(
        [sys.executable, "-m", "bagassets", "demo", str(folder)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "holds another project" in done.stderr
