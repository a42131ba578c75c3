"""Robots that were recorded together: what is proposed for them, and whose poses a dataset then has."""

import numpy as np
import pytest

from bagassets.assets.ego_poses import load_trajectory
from bagassets.assets.quality.topic_rules import channels_present
from bagassets.geometry.se3 import SE3
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import parse_recipe
from bagassets.recipe.model_checks import ChannelsCheck
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.oddities import APART_M
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild

pytestmark = pytest.mark.once

MADE = {"bag", "inventory", "calibration", "ego_poses", "annotations"}


def written(folder, odd):
    """Write a drive; return its truth, and what is proposed for it."""
    path = folder / "bags" / "a.mcap"
    truth = write_recordings([Target(path, "mcap")], seed=3, duration_s=0.6, odd=(odd,))
    with open_recording(path) as recording:
        summary = scan_recording(recording)
    return truth, propose_recipe({"a.mcap": summary}, name="test", root="bags")


def decided(proposal):
    """The proposed recipe with its pose source uncommented."""
    return proposal.text.replace("      # source:", "      source:").replace("      # topic:", "      topic:")


def build(text, folder):
    recipe = parse_recipe(text, folder / "recipe.yaml")
    (recording,) = discover(recipe.bags).recordings.values()
    facts = Store(recipe.store_path), recording, recording_digest(recording).digest, recording_stat(recording)
    return {made.asset: made.artifact for made in RecordingBuild(recipe, *facts).build(MADE)}


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    folder = tmp_path_factory.mktemp("two")
    return folder, *written(folder, "two-robots")


def test_of_two_robots_one_is_proposed_and_a_question_asked(two):
    _, _, proposal = two
    (rig,) = proposal.rigs
    assert rig.name == "robot1"
    assert all(name.startswith("/robot1/") for name in rig.summary.topics)
    (question,) = proposal.questions
    assert proposal.text.splitlines()[question.line - 1].strip() == "ego_pose:"
    assert "2 robots were recorded together (/robot1, /robot2), and a recording has one rig" in question.text
    assert "# left out: all below /robot2 (another robot)" in proposal.text


@pytest.mark.parametrize(("robot", "offset_m"), [("/robot1", 0.0), ("/robot2", APART_M)])
def test_the_rig_of_a_robot_has_its_poses_and_boxes(two, robot, offset_m):
    folder, truth, proposal = two
    text = decided(proposal).replace("/robot1/", f"{robot}/")
    made = build(text, folder)
    trajectory = load_trajectory(made["ego_poses"])
    moved = SE3(translation=(offset_m, 0.0, 0.0))
    times = trajectory.stamps_ns[::7]
    true = [moved @ truth.odom_SE3_ego(int(stamp)) for stamp in times]
    np.testing.assert_allclose(trajectory.at(times)[0], [pose.translation for pose in true], atol=1e-6)
    boxes = made["annotations"].read_table("annotations.parquet").to_pylist()
    assert boxes
    for box in boxes:
        tracks = {str(one.track_id): one for one in truth.boxes(box["stamp_ns"])}
        center = (moved @ tracks[box["track_id"]].odom_SE3_box).translation
        np.testing.assert_allclose([box["x"], box["y"], box["z"]], center, atol=1e-6)
    inventory = Inventory.from_json(made["inventory"].read_json("inventory.json"))
    (rig,) = parse_recipe(text, folder / "recipe.yaml").rigs
    assert channels_present(rig, inventory, ChannelsCheck()).passed
    other = {"/robot1": "/robot2", "/robot2": "/robot1"}[robot]
    (mixed,) = parse_recipe(text.replace(f"{robot}/odom", f"{other}/odom"), folder / "recipe.yaml").rigs
    (problem,) = channels_present(mixed, inventory, ChannelsCheck()).problems
    assert f"ego_pose of {other}" in problem


def test_one_robot_in_a_namespace_with_two_odometries_is_proposed_whole(tmp_path):
    truth, proposal = written(tmp_path, "one-robot")
    (rig,) = proposal.rigs
    assert (rig.name, proposal.questions) == ("rig", [])
    assert {"/robot1/wheels/odom", "/robot1/cameras/odom", "/robot1/tf"} <= rig.summary.topics.keys()
    trajectory = load_trajectory(build(proposal.text, tmp_path)["ego_poses"])
    true = [truth.odom_SE3_ego(int(stamp)).translation for stamp in trajectory.stamps_ns]
    np.testing.assert_allclose(trajectory.positions_m, true, atol=1e-6)
