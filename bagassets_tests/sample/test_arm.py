"""The sample arm in every format: what signals and images are made of its recordings, compared with its truth."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from bagassets.cli.sample import sample
from bagassets.engine.execute import execute
from bagassets.engine.graph import Graph
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.load import load_recipe
from bagassets.recordings.discover import discover, find_one
from bagassets.recordings.open import open_recording
from bagassets.sample.arm import (
    CAMERAS,
    COMMAND_PERIOD_NS,
    COMMANDS,
    ELEMENTS,
    EPISODE,
    JOINTS,
    LEAD_S,
    STATE_PERIOD_NS,
    STATES,
    TASK,
    ArmTruth,
)
from bagassets.sample.arm_oddities import ARM_ODDITIES, CHANGE_AFTER_S, LATE_S, OTHER_TASK
from bagassets.sample.drive import Target, drive_start_ns, write_arm_recordings
from bagassets.sample.recipe import arm_recipe
from bagassets.store.store import Store
from bagassets_tests.sample_drives import number_in

pytestmark = pytest.mark.once

NAMES = {"ros1": "arm.bag", "ros2": "arm", "mcap": "arm.mcap", "foxglove": "arm.mcap"}
DURATION_S = 2.5


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Kind -> the folder with the recording."""
    folder = tmp_path_factory.mktemp("arm")
    write_arm_recordings(
        [Target(folder / kind / "bags" / name, kind) for kind, name in NAMES.items()],
        3,
        duration_s=DURATION_S,
    )
    return folder


def built(folder, kind):
    """Build signals and images of the recordings in a folder: (store, asset -> channel -> artifact)."""
    recipe = yaml.safe_load(arm_recipe(root="bags", foxglove=kind == "foxglove"))
    recipe["bags"]["settle_s"] = 0
    (folder / "recipe.yaml").write_text(yaml.safe_dump(recipe))
    loaded = load_recipe(folder / "recipe.yaml")
    store = Store(loaded.store_path)
    (recording,) = discover(loaded.bags).recordings.values()
    graph = Graph.of(recording_assets(loaded), recording)
    graph.wanted = ("inventory", "calibration", "frames", "signals")
    return {
        one.asset: {name: store.artifact(digest) for name, digest in one.channels.items()}
        for one in execute(graph, threads=1)
    }


def series(artifact):
    """Stamps and (N, M) values of a signal."""
    table = artifact.read_table("signal.parquet")
    values = np.stack([table.column(name).to_numpy() for name in table.column_names[1:]], axis=1)
    return table.column("stamp_ns").to_numpy(), values


@pytest.mark.parametrize("kind", NAMES)
def test_signals_and_images_are_those_of_the_truth(bags, kind):
    truth = ArmTruth(3, drive_start_ns(3), 320, 200)
    made = built(bags / kind, kind)
    for name, period_ns, lead_s, columns in (
        ("arm", STATE_PERIOD_NS, 0.0, slice(0, 7)),
        ("gripper", STATE_PERIOD_NS, 0.0, slice(7, 8)),
        ("arm_command", COMMAND_PERIOD_NS, LEAD_S, slice(0, 7)),
        ("gripper_command", COMMAND_PERIOD_NS, LEAD_S, slice(7, 8)),
    ):
        stamps_ns, values = series(made["signals"][name])
        assert stamps_ns.tolist() == list(
            range(truth.start_ns, truth.start_ns + round(DURATION_S * 1e9) + 1, period_ns)
        )
        expected = truth.positions((stamps_ns - truth.start_ns) / 1e9 + lead_s)[:, columns]
        np.testing.assert_array_equal(values, expected)
        assert made["signals"][name].read_table("signal.parquet").column_names[1:] == list(ELEMENTS[columns])
    for channel in ("CAM_WORKSPACE", "CAM_WRIST"):
        index = made["frames"][channel].read_table("index.parquet").to_pylist()
        assert [row["stamp_ns"] for row in index] == [truth.image_stamp_ns(n) for n in range(75)]
        images = [cv2.imread(str(made["frames"][channel].path(row["file"]))) for row in index]
        assert [number_in(image) for image in images] == list(range(75))
        camera = channel.removeprefix("CAM_").lower()
        errors = [np.abs(image.astype(int) - truth.image(camera, n)).mean() for n, image in enumerate(images)]
        assert max(errors) < 4  # of JPEG


def test_tasks_and_episodes_are_said(bags):
    truth = ArmTruth(3, drive_start_ns(3), 320, 200)
    said = {}
    for kind, name in NAMES.items():
        with open_recording(find_one(bags / kind / "bags" / name)) as recording:
            said[kind] = [
                (message.log_time_ns, message.topic, str(getattr(decoded, "data", "") or decoded.message))
                for message in recording.messages([TASK, EPISODE])
                for decoded in [recording.decode(message)]
            ]
    ((begin_s, end_s, task),) = truth.episodes(DURATION_S)
    times_ns = [truth.start_ns + round(time_s * 1e9) for time_s in (begin_s - 0.05, begin_s, end_s)]
    expected = list(zip(times_ns, (TASK, EPISODE, EPISODE), (task, "start", "end"), strict=True))
    assert all(one == expected for one in said.values())


def odd(folder, name, kind="mcap", duration_s=DURATION_S):
    target = Target(folder / "bags" / NAMES[kind], kind)
    return write_arm_recordings([target], duration_s=duration_s, odd=[name])


@pytest.mark.parametrize("kind", ["mcap", "foxglove"])
def test_joints_that_are_lost_or_reordered(tmp_path, kind):
    truth = odd(tmp_path / "lost", "joint-lost", kind)
    signals = built(tmp_path / "lost", kind)["signals"]
    stamps_ns, values = series(signals["arm"])
    times_s = (stamps_ns - truth.start_ns) / 1e9
    expected = truth.positions(times_s)[:, :7]
    expected[times_s >= CHANGE_AFTER_S, 6] = np.nan
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(series(signals["gripper"])[1], truth.positions(times_s)[:, 7:])
    counts = signals["arm"].summary()["counts"]
    assert (counts["missing"], counts["changes"]) == (51, 1)
    assert signals["arm"].read_json("signal.json")["first_change_ns"] == truth.start_ns + 2 * 10**9

    truth = odd(tmp_path / "reordered", "joints-reordered", kind)
    stamps_ns, values = series(built(tmp_path / "reordered", kind)["signals"]["arm"])
    np.testing.assert_array_equal(values, truth.positions((stamps_ns - truth.start_ns) / 1e9)[:, :7])


def times_on(path, *topics):
    with open_recording(find_one(path)) as recording:
        return [message.log_time_ns for message in recording.messages(topics)]


def test_a_camera_that_stops_an_action_that_is_late_and_a_task_that_changes(tmp_path):
    truth = odd(tmp_path / "stops", "camera-stops", "ros1")
    wrist = times_on(tmp_path / "stops/bags/arm.bag", CAMERAS["wrist"])
    workspace = times_on(tmp_path / "stops/bags/arm.bag", CAMERAS["workspace"])
    assert max(wrist) < truth.start_ns + CHANGE_AFTER_S * 1e9 < max(workspace)
    odd(tmp_path / "late", "action-late", "ros1")
    commands = times_on(tmp_path / "late/bags/arm.bag", COMMANDS)
    assert min(commands) == truth.start_ns + round(LATE_S * 1e9) + 1_000_000
    assert min(times_on(tmp_path / "late/bags/arm.bag", STATES)) == truth.start_ns + 1_000_000
    odd(tmp_path / "tasks", "task-changes", "ros2")
    with open_recording(find_one(tmp_path / "tasks/bags/arm")) as recording:
        messages = list(recording.messages([TASK]))
        texts = [recording.decode(message).data for message in messages]
    assert texts == [truth.episodes(DURATION_S)[0][2], OTHER_TASK]
    assert messages[1].log_time_ns - messages[0].log_time_ns == LATE_S * 1e9


def test_the_command_writes_it(tmp_path):
    run = CliRunner().invoke(
        sample,
        [
            str(tmp_path / "a.mcap"), "--robot", "arm", "--format", "foxglove", "--duration", "0.2",
            "--recipe-out", str(tmp_path / "recipe.yaml"),
        ],
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    with open_recording(find_one(tmp_path / "a.mcap")) as recording:
        assert recording.topics[STATES].msgtype == "foxglove_msgs/msg/JointStates"
    recipe = yaml.safe_load((tmp_path / "recipe.yaml").read_text())
    assert recipe["rigs"][0]["signals"]["arm"]["names"] == list(JOINTS)
    for arguments, error in (
        (["b.mcap", "--robot", "arm", "--profile", "tas"], "there is no arm of the profile tas"),
        (["b.mcap", "--format", "foxglove"], "only recordings of the arm are written without ROS"),
        (["b.mcap", "--robot", "arm", "--odd", "uptime"], "no oddity of the arm is named uptime"),
    ):
        run = CliRunner().invoke(sample, arguments)
        assert run.exit_code == 2
        assert error in run.output


def test_every_oddity_of_the_arm_is_described():
    page = (Path(__file__).parents[2] / "docs" / "tests.md").read_text("utf-8")
    assert [name for name in ARM_ODDITIES if f"| `{name}` |" not in page] == []
