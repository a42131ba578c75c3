"""The real lerobot, in an environment of its own (`make test-lerobot`): it loads what we write, and finds every frame."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bagassets.formats.lerobot import join as joining
from bagassets.store.store import Store
from bagassets_tests.arm_recordings import RECIPE, join, joints_at, make_project, parts_of, write_arm
from bagassets_tests.sample_drives import build_recordings

pytestmark = [pytest.mark.lerobot, pytest.mark.long]

ROOT = Path(__file__).resolve().parents[3]
LOSSLESS = RECIPE.replace("undistort: false", "undistort: false, output: png")
FPS = 30
SECONDS = {"a": 2.0, "b": 3.0, "c": 1.5, "d": 2.0}


def real(command, *arguments):
    """Run a command of `lerobot_real.py` there; a missing environment is a failure, never a skipped test."""
    python = Path(os.environ.get("BAGASSETS_LEROBOT_PYTHON", ROOT / ".lerobot-venv" / "bin" / "python"))
    assert python.is_file(), f"{python} does not exist: `make test-lerobot` makes it"
    done = subprocess.run(
        [str(python), str(ROOT / "bagassets_tests" / "lerobot_real.py"), command, *map(str, arguments)],
        capture_output=True, text=True, timeout=1800, check=False, env={**os.environ, "HF_HUB_OFFLINE": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    return json.loads(done.stdout.strip().splitlines()[-1])


def made(folder, seconds=SECONDS, *, recipe=LOSSLESS, first=0, usual_s=3, **options):
    """Write recordings and their dataset; return recipe, parts and root."""
    for number, (name, length) in enumerate(seconds.items()):
        write_arm(folder, name, seconds=length, first=first + 1000 * number, **options)
    settings = make_project(folder, recipe)
    parts, _ = parts_of(settings)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(joining, "_USUAL_S", usual_s)  # several files
        patched.setattr(joining, "_USUAL_DATA", 3000)
        join(settings, parts)
    return settings, parts, settings.lerobot.output / "v3.0"


def shown(seconds=SECONDS, first=0):
    """The number that each frame shows, by episodes."""
    return [
        [first + 1000 * number + frame for frame in range(int(length * FPS) - 1)]
        for number, length in enumerate(seconds.values())
    ]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return made(tmp_path_factory.mktemp("real"))


def test_every_item_is_what_was_recorded(dataset):
    found, truth = real("read", dataset[2]), shown()
    assert found["files"] >= 2
    assert found["numbers"] == [number for episode in truth for number in episode]
    assert found["before"] == [before for episode in truth for before in (None, *episode[:-1])]
    assert found["episodes"] == [index for index, episode in enumerate(truth) for _ in episode]
    assert set(found["tasks"]) == {"Lift the cube."}
    times = [frame / FPS for episode in truth for frame in range(len(episode))]
    assert np.array(found["states"]) == pytest.approx(np.stack([joints_at(time) for time in times]), abs=2e-4)
    before = [np.floor(time * 100 + 1e-6) / 100 for time in times]
    assert np.array(found["actions"]) == pytest.approx(
        np.stack([joints_at(time) for time in before]) + 0.25, abs=1e-6
    )
    assert found["most_off"] <= 3  # levels: it converts with another version of FFmpeg


def test_statistics_are_those_that_it_computes_itself(dataset, tmp_path):
    settings, parts, root = dataset
    store = Store(settings.store_path)
    built = build_recordings(settings)
    files = [
        image_files(store, built[part.key]["frames"].artifact, episode["length"])
        for part in parts
        for episode in store.artifact(part.artifact).read_json("episodes.json")
    ]
    (tmp_path / "images.json").write_text(json.dumps(files))
    found = real("stats", root, tmp_path / "images.json")
    assert found["rows"] == sum(map(len, shown()))
    assert max(found["numeric"].values()) < 1e-6
    assert found["images"] < 1e-9
    assert found["our_std_of_images"] > 0.1


def image_files(store, frames, number):
    """The first images of the camera, as they were before they were encoded."""
    artifact = store.artifact(frames.read_json("channels.json")["CAM_WRIST"]["artifact"])
    names = artifact.read_table("index.parquet").column("file").to_pylist()
    return [str(artifact.path(name)) for name in names[:number]]


def test_its_own_tools_merge_and_delete(dataset, tmp_path):
    two = {"e": 1.0, "f": 2.0}
    _, _, other = made(tmp_path / "other", two, first=20_000)
    found, truth = real("tools", dataset[2], other, tmp_path), shown()
    assert found["merged"] == [n for episode in [*truth, *shown(two, 20_000)] for n in episode]
    assert found["fewer"] == [n for index in (1, 3) for n in truth[index]]


def test_a_policy_learns_from_it(dataset):
    losses = real("train", dataset[2])["losses"]
    assert np.mean(losses[-3:]) < losses[0]


def test_none_of_ten_thousand_frames_is_off_by_one(tmp_path):
    """Over more than 2,048 s, in several files: in none, float32 stamps stop telling frames apart."""
    seconds = dict.fromkeys([f"r{n}" for n in range(8)], 260.0)
    recipe = RECIPE.replace("fps: 30", "fps: 5")
    _, _, root = made(tmp_path, seconds, recipe=recipe, usual_s=400, camera_hz=5, joint_hz=20)
    found = real("read", root)
    assert len(found["numbers"]) > 10_000
    truth = [[1000 * number % 65_536 + frame for frame in range(1300)] for number in range(8)]
    lengths = np.bincount(found["episodes"])
    assert (lengths >= 1299).all()
    kept = [episode[:length] for episode, length in zip(truth, lengths, strict=True)]
    assert found["files"] >= 3
    assert (
        sum(one != other for one, other in zip(found["numbers"], (n for e in kept for n in e), strict=True))
        == 0
    )
