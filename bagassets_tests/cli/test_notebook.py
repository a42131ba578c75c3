"""`bagassets.build` in the ways of a notebook: recipes as files, text and mappings, progress, interrupts, a running loop."""

import asyncio
import os
import re
import signal
import subprocess
import sys
import threading
from dataclasses import FrozenInstanceError
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

import bagassets
from bagassets.base.errors import BagAssetsError, RecipeError, RecordingError
from bagassets.cli.remote import end_servers
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.runs.exclusive import exclusive
from bagassets.recipe import load_recipe
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets_tests.arm_recordings import make_project, write_arm
from bagassets_tests.services import eventually

pytestmark = [pytest.mark.xdist_group("notebook"), pytest.mark.once]

CODE = """
import bagassets, sys
report = bagassets.build(sys.argv[1])
"""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebook") / "recordings"
    write_recordings([Target(folder / "one.bag", "ros1")], seed=1, duration_s=1.2)
    write_recordings([Target(folder / "two.mcap", "mcap")], seed=2, duration_s=1.2)
    return folder


@pytest.fixture
def folder(tmp_path, recordings, monkeypatch):
    """An empty current folder beside the recordings; its servers are ended."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recordings").mkdir()
    for one in recordings.iterdir():
        os.link(one, tmp_path / "recordings" / one.name)
    yield tmp_path
    for state in (".bagassets", "state"):
        end_servers(tmp_path / state)


def text():
    return sample_recipe()


def test_a_recipe_file_is_built_as_by_the_command(folder, capfd):
    (folder / "recipe.yaml").write_text(text())
    report = bagassets.build("recipe.yaml", jobs=2)
    assert set(report.built) == {"one.bag", "two.mcap"}
    assert (report.failed, report.skipped, report.lost, report.fresh) == ({}, {}, {}, ())
    assert report.succeeded
    assert report.recordings["one.bag"].images > 10
    assert report.dataset_state == "updated"
    assert "2 built in" in repr(report)
    printed = capfd.readouterr()
    assert "2 recordings need a run." in printed.out
    assert "start    one.bag" in printed.out
    assert printed.err == ""
    with pytest.raises(FrozenInstanceError):
        report.seconds = 0.0
    assert len(bagassets.open_dataset(report.dataset)) == sum(
        row.keyframes for row in report.recordings.values()
    )
    again = bagassets.build(Path("recipe.yaml"), progress=False)
    assert (again.built, again.fresh, again.dataset_state) == ((), ("one.bag", "two.mcap"), "fresh")
    assert capfd.readouterr().out == ""
    command = subprocess.run(
        [sys.executable, "-m", "bagassets", "build"], check=True, capture_output=True, text=True
    )
    assert "2 fresh: nothing to do" in command.stdout


@pytest.mark.long
def test_without_a_project_only_the_dataset_is_left(folder):
    events = []
    report = bagassets.build(text(), progress=events.append, bags=["one.bag"])
    assert list(report.recordings) == ["one.bag"]
    kinds = [(event.kind, event.key) for event in events]
    assert ("started", "one.bag") in kinds
    assert ("done", "one.bag") in kinds
    assert kinds[-1] == ("done", "")
    assert sorted(path.name for path in folder.iterdir()) == ["nuscenes", "recordings"]
    sample = bagassets.open_dataset(report.dataset)[0]
    assert sample.image("CAM_FRONT").any()


@pytest.mark.long
def test_with_a_state_folder_the_next_build_goes_on(folder):
    first = bagassets.build(text(), state="state", progress=False, bags=["one.bag"])
    assert first.built == ("one.bag",)
    second = bagassets.build(yaml.safe_load(text()), state=folder / "state", progress=False)
    assert (second.built, second.fresh) == (("two.mcap",), ("one.bag",))
    assert len(bagassets.open_dataset(second.dataset).scenes) == 2


def test_failed_and_lost_are_told_with_the_reasons(folder):
    (folder / "recordings" / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    report = bagassets.build(text(), state="state", progress=False)
    assert list(report.failed) == ["broken.bag"]
    assert "broken.bag" in report.failed["broken.bag"]
    assert not report.succeeded
    assert set(report.built) == {"one.bag", "two.mcap"}
    assert len(bagassets.open_dataset(report.dataset).scenes) == 2


def test_errors_are_those_of_bagassets(folder):
    with pytest.raises(RecipeError, match=r"nothing.yaml: no recipe here"):
        bagassets.build("nothing.yaml")
    with pytest.raises(RecipeError, match=r"<recipe>:1: rigs: this field is required"):
        bagassets.build({"name": "x", "bags": {"root": "recordings"}})
    with pytest.raises(RecordingError, match=r"^<recipe>: bags.root: there is no folder .*/nowhere"):
        bagassets.build(text().replace("root: recordings", "root: nowhere"), progress=False)
    with pytest.raises(BagAssetsError, match="zzz: no such recording"):
        bagassets.build(text(), state="state", progress=False, bags=["zzz"])
    (folder / "recipe.yaml").write_text(text())
    with pytest.raises(RecipeError, match="`state` is for recipes without a file"):
        bagassets.build("recipe.yaml", state="state")
    assert not (folder / "nuscenes").exists()


@pytest.mark.long
def test_an_interrupt_ends_the_runs_and_the_next_build_goes_on(folder):
    write_recordings([Target(folder / "recordings" / "long.bag", "ros1")], seed=1, duration_s=20.0)
    (folder / "recipe.yaml").write_text(text())
    log, locks = folder / "log", load_recipe(folder / "recipe.yaml").state / "locks"
    # While this process holds the recording, its run cannot end.
    with log.open("w") as file, exclusive(locks, "long.bag", keep_waiting=lambda _asked: True) as held:
        assert held
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", CODE, "recipe.yaml"],
            stdout=file,
            stderr=file,
            # A shell that starts the tests in the background has them ignore it.
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509  (no threads here)
        )
        eventually(lambda: "start    long.bag" in log.read_text(), "it is at work", 120)
        process.send_signal(signal.SIGINT)
        assert process.wait(120) != 0
    assert "KeyboardInterrupt: " in log.read_text()
    with open_project(folder / "recipe.yaml") as workspace:
        instance = workspace.instance
        ended = {run.status.value for run in instance.get_runs()}
    assert "CANCELED" in ended
    assert ended <= {"CANCELED", "SUCCESS"}
    report = bagassets.build("recipe.yaml", progress=False)
    assert "long.bag" in report.built
    assert report.succeeded


@pytest.mark.long
def test_an_error_in_the_progress_function_ends_the_build(folder):
    def progress(event):
        if event.kind == "started":
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        bagassets.build(text(), state="state", progress=progress)
    assert bagassets.build(text(), state="state", progress=False).succeeded


@pytest.mark.long
def test_it_builds_under_a_running_loop_and_in_a_thread(folder):
    """As in Jupyter, where a cell runs in the main thread, under the loop of the kernel."""

    async def cell():
        return bagassets.build(text(), state="state", progress=False)

    assert len(asyncio.run(cell()).built) == 2
    found = []
    thread = threading.Thread(
        target=lambda: found.append(bagassets.build(text(), state="state", progress=False))
    )
    thread.start()
    thread.join(120)
    assert len(found[0].fresh) == 2


@pytest.mark.long
def test_the_page_about_notebooks_runs(folder):
    (folder / "recipe.yaml").write_text(text().replace("output: nuscenes", "output: dataset/nuscenes"))
    page = (Path(__file__).parents[2] / "docs" / "notebook.md").read_text("utf-8")
    reading, before, episodes, building, inline = re.findall(
        r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
    )
    names = {"bagassets": bagassets, "np": np}
    for block in (building, reading, before, inline.replace("/tmp/my-state", "state")):
        exec(block, names)
    assert names["report"].succeeded
    assert names["image"].dtype == np.uint8
    assert names["points_global"].shape == names["points"].shape
    assert names["global_SE3_cam"].shape == (4, 4)
    assert len(names["dense"]) > len(names["points"])
    assert len(names["visible"]) <= len(names["sample"].boxes)

    recipe = make_project(folder / "arm")
    write_arm(folder / "arm", "a")
    assert bagassets.build(folder / "arm" / "recipe.yaml", progress=False).succeeded
    dataset = bagassets.open_dataset(recipe.lerobot.output)
    (episode,) = dataset.scenes
    names = {"dataset": dataset}
    exec(episodes.replace("episode_000003", episode.name), names)
    assert names["frame"].image("observation.images.wrist").dtype == np.uint8


def test_neither_dagster_nor_the_devkit_is_imported(folder):
    code = (
        "import sys, bagassets, bagassets.engine.plan; from bagassets import build; bagassets.build(sys.argv[1], progress=False); "
        "print([name for name in sys.modules if name.startswith(('dagster', 'nuscenes'))])"
    )
    (folder / "recipe.yaml").write_text(text())
    done = subprocess.run(
        [sys.executable, "-c", code, "recipe.yaml"], check=True, capture_output=True, text=True
    )
    assert done.stdout == "[]\n"
