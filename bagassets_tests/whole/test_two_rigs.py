"""By the command: recordings of two rigs with other sensors, frames and rates make one dataset that the devkit loads."""

import json

import pytest
from devkit import run_devkit

from bagassets.sample.drive import Target, write_recordings
from bagassets_tests.in_process import run_command
from bagassets_tests.small_drive import write_drive

pytestmark = [pytest.mark.devkit, pytest.mark.xdist_group("two_rigs"), pytest.mark.once]

VERSION = "v1.0-rigs"
RECIPE = f"""
name: rigs
bags: {{root: recordings, settle_s: 0}}
nuscenes: {{version: {VERSION}}}
preview: {{enabled: false}}
rigs:
  - name: van
    match: ["van/**"]
    vehicle: van_1
    location: yard
    ego_pose: {{source: odometry, topic: /odom}}
    annotations: [{{topic: /annotations}}]
    channels:
      CAM_FRONT: {{modality: camera, topic: /cam_front/image_raw}}
      CAM_FRONT_LEFT: {{modality: camera, topic: /cam_front_left/image_raw}}
      LIDAR_TOP: {{modality: lidar, topic: /lidar_top/points}}
      RADAR_FRONT: {{modality: radar, topic: /radar_front/points}}
  - name: cart
    vehicle: cart_7
    ego_pose: {{source: odometry, topic: /odom}}
    channels:
      CAM_FRONT: {{modality: camera, topic: /cam/image_raw}}
      LIDAR_TOP: {{modality: lidar, topic: /points}}
"""
CHANNELS = {
    "van": {"CAM_FRONT", "CAM_FRONT_LEFT", "LIDAR_TOP", "RADAR_FRONT"},
    "cart": {"CAM_FRONT", "LIDAR_TOP"},
}


def run(folder, command, *args):
    done = run_command(command, "--recipe", folder / "recipe.yaml", *args)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rigs")
    (folder / "recordings" / "van").mkdir(parents=True)
    for seed, (name, kind) in enumerate((("one.bag", "ros1"), ("two.mcap", "mcap"))):
        write_recordings([Target(folder / "recordings" / "van" / name, kind)], seed, "small", 2.4)
    write_drive(folder / "recordings" / "cart" / "three", "ros2", duration_s=2.5)
    (folder / "recipe.yaml").write_text(RECIPE)
    return folder, json.loads(run(folder, "build", "--json"))


@pytest.fixture(scope="module")
def tables(project):
    folder = project[0] / "dataset" / "nuscenes" / VERSION
    return {path.stem: json.loads(path.read_bytes()) for path in folder.glob("*.json")}


def test_every_recording_is_built_by_its_rig(project, tables):
    _, output = project
    assert {one["result"] for one in output["recordings"].values()} == {"built"}
    assert len(output["recordings"]) == 3
    assert sorted(row["vehicle"] for row in tables["log"]) == ["cart_7", "van_1", "van_1"]


def test_the_devkit_loads_and_walks_it(project, tables):
    facts = run_devkit(
        "devkit_walk.py", project[0] / "dataset" / "nuscenes", VERSION, "custom_train", "custom_val"
    )
    assert len(facts["scenes"]) == 3
    assert set(facts["readings"]) == CHANNELS["van"]
    assert sum(facts["readings"].values()) == facts["tables"]["sample_data"] == len(tables["sample_data"])
    assert sorted(name for names in facts["splits"].values() for name in names) == sorted(facts["scenes"])
    assert all(facts["splits"].values())


def test_each_sample_has_all_channels_of_its_rig_and_the_sensors_sit_where_that_rig_has_them(tables):
    vehicles = {row["token"]: row["vehicle"].partition("_")[0] for row in tables["log"]}
    rig_of_scene = {row["token"]: vehicles[row["log_token"]] for row in tables["scene"]}
    rig_of = {row["token"]: rig_of_scene[row["scene_token"]] for row in tables["sample"]}
    sensors = {row["token"]: row["channel"] for row in tables["sensor"]}
    mounts = {row["token"]: row for row in tables["calibrated_sensor"]}
    held, mounted = {}, {}
    for row in tables["sample_data"]:
        channel = sensors[mounts[row["calibrated_sensor_token"]]["sensor_token"]]
        if row["is_key_frame"]:
            held.setdefault(row["sample_token"], []).append(channel)
        rig = rig_of[row["sample_token"]]
        mounted.setdefault((rig, channel), set()).add(
            tuple(mounts[row["calibrated_sensor_token"]]["translation"])
        )
    assert held.keys() == rig_of.keys()
    assert set(rig_of.values()) == {"van", "cart"}
    for sample, channels in held.items():
        assert sorted(channels) == sorted(CHANNELS[rig_of[sample]])
    # One sensor of a name in the dataset, but each rig has it somewhere else; recordings of one rig agree.
    assert len(tables["sensor"]) == 4
    assert len(tables["calibrated_sensor"]) == 4 + 4 + 2
    assert all(len(places) == 1 for places in mounted.values())
    assert mounted["cart", "LIDAR_TOP"] == {(0.5, 0.0, 1.8)}
    assert mounted["van", "LIDAR_TOP"] != mounted["cart", "LIDAR_TOP"]


def test_checks_pass_and_a_rig_with_fewer_sensors_is_no_finding(project):
    verdicts = json.loads(run(project[0], "check", "--json"))
    of_dataset = {one["check"]: one for one in verdicts if one["recording"] is None}
    assert of_dataset["devkit_ready"]["passed"] is True
    assert of_dataset["devkit_ready"]["facts"]["samples_lacking_a_channel"] == 0
    assert of_dataset["dataset_references_intact"]["passed"] is True
    assert all(one["passed"] for one in verdicts if one["check"] == "keyframes_complete")
