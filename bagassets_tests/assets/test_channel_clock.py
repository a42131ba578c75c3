"""A rig or a channel may have a clock of its own; those of the other channels, and all that is made of them, stay as they are."""

import numpy as np
import pytest
from rosbags.rosbag2 import Writer

from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests.sample_drives import build_recordings
from bagassets_tests.small_drive import LATENCY_NS, START_NS, STORE2, messages

pytestmark = pytest.mark.once

CLOUD = "sensor_msgs/msg/PointCloud2"
REVOLUTION_NS = 100_000_000
LIDAR_LATENCY_NS = 120_000_000
RADAR_PERIOD_NS = 50_000_000
RADARS = 40
RECIPE = """
name: clocks
bags: {root: bags, settle_s: 0}
state: STATE
preview: {enabled: false}
limits: {lost_messages: 1.0}
CLOCK
rigs:
  - name: carRIG
    ego_pose: {source: odometry, topic: /odom}
    channels:
      CAM_FRONT: {modality: cameraCAMERA, topic: /cam/image_raw}
      LIDAR_TOP: {modality: lidarLIDAR, topic: /points}
      RADAR_FRONT: {modality: radarRADAR, topic: /radar, extrinsics: {translation: [3.0, 0.0, 0.5], rotation: [1, 0, 0, 0]}}
"""


def cloud(stamp_ns, frame, **columns):
    types = STORE2.types
    values = np.stack(list(columns.values()), axis=1).astype(np.float32)
    fields = [types["sensor_msgs/msg/PointField"](name, 4 * at, 7, 1) for at, name in enumerate(columns)]
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    step = values.shape[1] * 4
    return types[CLOUD](
        types["std_msgs/msg/Header"](stamp, frame), 1, len(values), fields, False, step, step * len(values),
        values.view(np.uint8).reshape(-1), True,
    )  # fmt: skip


def lidar(stamp_ns):
    """A revolution that begins at its stamp, as the times of its points say."""
    times = np.linspace(0.0, REVOLUTION_NS / 1e9, 50)
    y = np.linspace(-3, 3, 50)
    return cloud(stamp_ns, "lidar", x=y + 9, y=y, z=0 * y, intensity=0 * y, time=times)


def radar(stamp_ns):
    x = np.array([10.0, 20.0])
    return cloud(stamp_ns, "radar", x=x, y=0 * x, z=0 * x, vx=0 * x, vy=0 * x, rcs=0 * x)


def entries():
    """(topic, type, log time, message): four radar messages each share a stamp, and clouds are logged late."""
    for topic, msgtype, stamp_ns, message in messages(STORE2, 2.0):
        if topic == "/points":
            yield topic, msgtype, stamp_ns + LIDAR_LATENCY_NS, lidar(stamp_ns)
        else:
            yield topic, msgtype, stamp_ns + LATENCY_NS, message
    for number in range(RADARS):
        logged_ns = START_NS + number * RADAR_PERIOD_NS + LATENCY_NS
        yield "/radar", CLOUD, logged_ns, radar(START_NS + number // 4 * 4 * RADAR_PERIOD_NS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Build the recording with clocks of channels and recipe: -> channel -> its artifact."""
    folder = tmp_path_factory.mktemp("clocks")
    (folder / "bags").mkdir()
    with Writer(folder / "bags" / "drive", version=9) as writer:
        connections = {}
        for topic, msgtype, log_ns, message in sorted(entries(), key=lambda entry: entry[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE2)
            writer.write(connections[topic], log_ns, STORE2.serialize_cdr(message, msgtype))

    def build(top="", rig="", **clocks):
        state = "-".join(["state", top, rig, *(f"{name}_{value}" for name, value in sorted(clocks.items()))])
        text = RECIPE.replace("STATE", state).replace("CLOCK", f"clock: {top}" if top else "")
        text = text.replace("carRIG", f"car\n    clock: {rig}" if rig else "car")
        for word in ("CAMERA", "LIDAR", "RADAR"):
            clock = clocks.get(word.lower())
            text = text.replace(
                f"{word.lower()}{word}", word.lower() + (f", clock: {clock}" if clock else "")
            )
        (folder / "recipe.yaml").write_text(text)
        recipe = load_recipe(folder / "recipe.yaml")
        (assets,) = build_recordings(recipe).values()
        store = Store(recipe.store_path)
        return {
            name: store.artifact(entry["artifact"])
            for asset in ("frames", "sweeps")
            for name, entry in assets[asset].artifact.read_json("channels.json").items()
        }

    return build


def counts(artifact):
    return artifact.read_json("channel.json")["counts"]


def stamps_ns(artifact):
    return artifact.read_table("index.parquet", ["stamp_ns"]).column("stamp_ns").to_pylist()


def test_by_its_own_log_time_a_radar_loses_nothing_and_the_lidar_keeps_its_stamps(made):
    before, after = made(), made(radar="log")
    assert counts(before["RADAR_FRONT"])["lost"] == {"duplicate stamp": RADARS * 3 // 4}
    assert counts(after["RADAR_FRONT"])["lost"] == {}
    assert stamps_ns(after["RADAR_FRONT"]) == [
        START_NS + number * RADAR_PERIOD_NS + LATENCY_NS for number in range(RADARS)
    ]
    for name in ("LIDAR_TOP", "CAM_FRONT"):
        assert stamps_ns(after[name]) == stamps_ns(before[name])
        assert after[name].digest == before[name].digest
        assert list(after[name].entries()) == list(before[name].entries())
        index = [one.path("index.parquet").read_bytes() for one in (before[name], after[name])]
        assert index[0] == index[1]
    assert stamps_ns(before["LIDAR_TOP"])[0] == pytest.approx(
        START_NS + 5_000_000 + REVOLUTION_NS, abs=10_000
    )
    # What the advice was before: the clock of the recipe moves the lidar by its latency.
    all_by_log = made("log")
    assert stamps_ns(all_by_log["LIDAR_TOP"])[0] - stamps_ns(before["LIDAR_TOP"])[0] == LIDAR_LATENCY_NS


def test_the_clock_of_a_rig_is_that_of_all_its_channels_and_poses(made):
    by_log, of_rig, back = made("log"), made(rig="log"), made("log", rig="header")
    assert {name: one.digest for name, one in of_rig.items()} == {
        name: one.digest for name, one in by_log.items()
    }
    assert {name: one.digest for name, one in back.items()} == {
        name: one.digest for name, one in made().items()
    }
    mixed = made(rig="log", radar="header")
    assert mixed["RADAR_FRONT"].digest == made()["RADAR_FRONT"].digest


@pytest.mark.parametrize("modality", ["camera", "lidar", "radar"])
def test_a_channel_of_each_kind_may_keep_its_header_stamps_where_the_recipe_says_log(made, modality):
    name = {"camera": "CAM_FRONT", "lidar": "LIDAR_TOP", "radar": "RADAR_FRONT"}[modality]
    by_header, by_log, mixed = made(), made("log"), made("log", **{modality: "header"})
    for channel in by_header:
        expected = by_header if channel == name else by_log
        assert mixed[channel].digest == expected[channel].digest, channel
    assert mixed[name].digest != by_log[name].digest


def test_the_clock_of_the_recipe_said_again_changes_nothing(made):
    before, after = made(), made(radar="header", lidar="header", camera="header")
    assert {name: one.digest for name, one in after.items()} == {
        name: one.digest for name, one in before.items()
    }
