"""`bagassets convert`: one recording, no project, nothing left behind but what was asked for."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

from bagassets.cli.main import main
from bagassets.defs.runs.exclusive import exclusive
from bagassets.recipe import load_recipe
from bagassets.recordings.digest_record import read_attribute
from bagassets_tests.in_process import building_here
from bagassets_tests.series import write_parts
from bagassets_tests.services import eventually
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder for temporary files, which is empty before and must be so after."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    yield folder
    assert list(folder.iterdir()) == []


@pytest.fixture
def here():
    """No fork server, which other tests of this file start and find gone."""
    with building_here():
        yield


@pytest.fixture
def drive(tmp_path):
    return write_drive(tmp_path / "bags" / "drive.bag", "ros1", 2.0)


def convert(*arguments):
    return main(["convert", *map(str, arguments)])


def servers_below(folder):
    """Return the processes that name a folder in their command line."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.fsencode(folder) in (process / "cmdline").read_bytes() and process.name != str(os.getpid()):
                found.append(process.name)
    return found


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_recording_becomes_a_dataset_of_its_own(tmp_path, temporary, drive, capsys):
    status = drive.stat()
    assert convert(drive, tmp_path / "out") == 0
    assert "1 scene, 4 samples, 19 images, 19 sweeps" in capsys.readouterr().out
    out = tmp_path / "out"
    assert names(out) == ["maps", "recipe.yaml", "samples", "sweeps", "v1.0-drive"]
    files = [path for path in out.rglob("*") if path.is_file()]
    assert {path.stat().st_nlink for path in files} == {1}
    assert all(path.stat().st_mode & 0o200 for path in files)
    data = json.loads((out / "v1.0-drive" / "sample_data.json").read_text())
    assert len(data) == 38
    assert all((out / row["filename"]).is_file() for row in data)
    assert names(tmp_path) == ["bags", "out", "tmp"]
    assert read_attribute(drive) is None
    assert drive.stat().st_ctime_ns == status.st_ctime_ns
    assert servers_below(tmp_path) == []
    recipe = load_recipe(out / "recipe.yaml")
    assert (recipe.bags.root, recipe.bags.include) == (drive.parent, ("drive.bag",))

    # The recipe of one recording does for another of the same robot, whatever its name.
    other = write_drive(tmp_path / "bags" / "ros2", "ros2", 2.0)
    with building_here():
        assert convert(other, tmp_path / "again", "--recipe", out / "recipe.yaml") == 0
    text = (tmp_path / "again" / "recipe.yaml").read_text()
    assert text.startswith(f"# Copied by `bagassets convert` from {out / 'recipe.yaml'};")
    assert text.endswith((out / "recipe.yaml").read_text())


def test_another_format(tmp_path, temporary, here, capsys):
    drive = write_drive(tmp_path / "long.bag", "ros1", 4.0)
    assert convert(drive, tmp_path / "out", "--format", "vision") == 0
    assert "1 sequence, " in capsys.readouterr().out
    assert len(list((tmp_path / "out").rglob("*.jpg"))) == 25
    assert not (tmp_path / "out" / "samples").exists()
    assert "\nvision: {}\n" in (tmp_path / "out" / "recipe.yaml").read_text()


@pytest.mark.parametrize("options", [(), ("--format", "lerobot")])
def test_an_arm_becomes_a_lerobot_dataset(tmp_path, temporary, here, capsys, options):
    arm = tmp_path / "arm.mcap"
    assert main(["sample", str(arm), "--robot", "arm", "--duration", "2"]) == 0
    assert convert(arm, tmp_path / "out", *options) == 0, capsys.readouterr().err
    assert names(tmp_path / "out") == ["recipe.yaml", "v3.0"]
    (tmp_path / "out" / "recipe.yaml").rename(tmp_path / "recipe.yaml")
    again = tmp_path / "again"
    assert convert(arm, again, "--recipe", tmp_path / "recipe.yaml") == 0, capsys.readouterr().err
    assert names(again) == ["recipe.yaml", "v3.0"]


def test_an_empty_dataset_is_none(tmp_path, temporary, here, drive, capsys):
    assert convert(drive, tmp_path / "out", "--format", "vision") == 1  # 19 images make no sequence of 25
    assert "drive.bag: its dataset would be empty" in capsys.readouterr().err
    assert names(tmp_path) == ["bags", "out.recipe.yaml", "tmp"]


def test_an_unknown_format_is_named(tmp_path, drive, capsys):
    assert convert(drive, tmp_path / "out", "--format", "kitty") == 2
    assert "there is no format kitty; the formats are nuscenes, vision" in capsys.readouterr().err


def test_open_questions_are_listed_and_written_beside(tmp_path, temporary, here, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bag = write_drive(tmp_path / "still.bag", "ros1", 2.0, keep=lambda topic, _: topic != "/odom")
    assert convert("still.bag", "out") == 2
    out = capsys.readouterr().out
    beside = tmp_path / "out.recipe.yaml"
    assert f"To be decided in {beside}, the guessed recipe:\n  " in out
    assert out.endswith("When that is done:\n  bagassets convert still.bag out --recipe out.recipe.yaml\n")
    assert names(tmp_path) == ["out.recipe.yaml", "still.bag", "tmp"]
    text = beside.read_text()
    line = int(out.split("(line ")[1].split(")")[0])
    assert text.splitlines()[line - 1] == "    ego_pose:"
    assert "to be decided: " in text.splitlines()[line]

    assert convert(bag, "out") == 2  # the same again: nothing is edited
    capsys.readouterr()
    edited = text.replace("      # source: fixed", "      source: fixed", 1)
    assert edited != text
    beside.write_text(edited)
    assert convert(bag, "out") == 1
    assert "exists already; convert with --recipe out.recipe.yaml if you edited it" in capsys.readouterr().err
    assert beside.read_text() == edited
    assert convert(bag, "out", "--recipe", beside) == 0
    assert (tmp_path / "out" / "v1.0-still").is_dir()


def test_what_is_to_be_decided_for_the_rig_of_the_recording_is_refused(tmp_path, drive, capsys):
    channels = "channels: {CAM_FRONT: {modality: camera, topic: /cam/image_raw}}"
    (tmp_path / "recipe.yaml").write_text(
        f"name: two\nbags: {{root: bags}}\nrigs:\n  - name: van\n    match: ['van/**']\n    ego_pose: {{source: fixed}}\n"
        f"    {channels}\n  - name: car\n    ego_pose:\n    {channels}\n"
    )
    assert convert(drive, tmp_path / "out", "--recipe", tmp_path / "recipe.yaml") == 1
    assert "recipe.yaml:9: rigs[car].ego_pose: needs a value" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_one_part_of_a_drive_is_said_to_be_one(tmp_path, capsys):
    parts = write_parts(tmp_path / "drive.bag", [0.5], 1.0, keep=lambda topic, _: topic == "/odom")
    sentence = "drive_0.bag is part of drive.bag; for the whole drive, name all its parts.\n"
    assert convert(parts[0], tmp_path / "out") == 1
    assert sentence in capsys.readouterr().err
    assert convert(*parts, tmp_path / "out") == 1
    assert "is part of" not in capsys.readouterr().err


def test_a_recording_without_sensors_asks_nothing(tmp_path, capsys):
    bag = write_drive(tmp_path / "poses.bag", "ros1", 1.0, keep=lambda topic, _: topic == "/odom")
    assert convert(bag, tmp_path / "out") == 1
    assert "poses.bag: nothing to convert: it has no camera, lidar or radar." in capsys.readouterr().err
    assert names(tmp_path) == ["poses.bag"]


def test_what_gives_no_scene_gives_no_dataset(tmp_path, temporary, here, drive, capsys):
    recipe = tmp_path / "long.yaml"
    recipe.write_text(
        "name: long\nbags: {root: nowhere}\nscenes: {min_length_s: 100, length_s: 100}\nrigs:\n  - name: car\n"
        "    match: [other.bag]\n    ego_pose: {source: odometry, topic: /odom}\n    channels:\n"
        "      LIDAR_TOP: {modality: lidar, topic: /points}\n"
    )
    assert convert(drive, tmp_path / "out", "--recipe", recipe) == 1
    printed = capsys.readouterr()
    assert "drive.bag: it has no scene" in printed.err
    assert "min_length_s" in printed.out
    assert names(tmp_path) == ["bags", "long.yaml", "tmp"]


def test_what_is_there_is_never_replaced(tmp_path, drive, capsys):
    (tmp_path / "out").mkdir()
    assert convert(drive, tmp_path / "out") == 1
    assert "out exists already" in capsys.readouterr().err
    assert convert(drive, tmp_path / "no" / "out", "--recipe", tmp_path / "none.yaml") == 1


def test_a_recipe_without_the_dataset_is_refused(tmp_path, drive, capsys):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(
        "name: a\nbags: {root: .}\nrigs:\n  - name: car\n    ego_pose: {source: fixed}\n    channels:\n"
        "      LIDAR_TOP: {modality: lidar, topic: /points}\n"
    )
    assert convert(drive, tmp_path / "out", "--recipe", recipe, "--format", "vision") == 1
    assert "asks for no vision dataset; add `vision: {}`" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("number", "moment"),
    [(signal.SIGINT, "starting"), pytest.param(signal.SIGTERM, "start    drive.bag", marks=pytest.mark.long)],
)
def test_an_interrupt_leaves_nothing_behind(tmp_path, temporary, number, moment):
    """While the server starts, and while it builds."""
    drive = write_drive(tmp_path / "bags" / "drive.bag", "ros1", 200.0)
    process = subprocess.Popen(
        [sys.executable, "-m", "bagassets", "convert", str(drive), str(tmp_path / "out")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # Whatever starts tests in the background may have it ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )
    lock, *_ = eventually(lambda: list(temporary.glob("*/forkserver/*.lock")), "a server that starts", 300)
    # While this process holds the recording, its run cannot end, however late the signal comes.
    locks = lock.parents[1] / "locks"
    with exclusive(locks, "drive.bag", keep_waiting=lambda _asked: True) as held:
        assert held
        assert moment == "starting" or any(moment in line for line in process.stderr)
        process.send_signal(number)
        _, said = process.communicate(timeout=90)
    assert process.returncode == 130, said
    assert names(tmp_path) == ["bags", "tmp"]
    eventually(lambda: not servers_below(temporary), "the end of all processes")
