"""Radars of the sample car, through whole builds: what they write of each target is what its world knows.

Velocities in the datasets are over ground, whichever way the radar sends them; where the recipe is wrong, the check says so,
and what it says mends it.
"""

import heapq
import shutil
from contextlib import ExitStack

import numpy as np
import pytest
from sample_drives import build_recordings

from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.radar_file import read_radar_file
from bagassets.base.errors import RecipeError
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import load_recipe, parse_recipe
from bagassets.recordings.open import open_recording
from bagassets.sample.oddities import EGO_SE3_TURNED_RADAR, ODDITIES
from bagassets.sample.recorder import open_recorder
from bagassets.sample.render import radar_targets
from bagassets.sample.schedule import LATENCY_NS, Event, motion_events
from bagassets.sample.truth import Truth
from bagassets.sample.world import World
from bagassets.store.store import Store
from bagassets_tests.checks import RECORDING_CHECKS

START_NS, PERIOD_NS = 1_750_000_000_000_000_000, 77_000_000
TOPIC = "/radar_front/points"


def record(path, odd, seconds=1.6, seed=3):
    """Write a drive with a radar and nothing else to see with."""
    truth = Truth(World(seed), START_NS, {})
    end_ns = START_NS + round(seconds * 1e9)
    stamps = range(START_NS, end_ns, PERIOD_NS)
    readings = (Event(stamp + LATENCY_NS, TOPIC, "sensor_msgs/msg/PointCloud2", None) for stamp in stamps)
    events = heapq.merge(motion_events(truth, end_ns), readings, key=lambda one: one.log_time_ns)
    with ExitStack() as stack:
        recorder = open_recorder(path, "mcap", "none", stack)
        for one in ODDITIES[odd](events, truth):
            recorder.write(one.topic, one.msgtype, one.log_time_ns, one.make(recorder.messages))
    return truth


# Recording -> what is odd about it, and what the recipe says.
CASES = {
    "relative": ("radar-relative", ", velocities: relative"),
    "scan": ("radar-scan", ""),
    "ground": ("radar-over-ground", ", velocities: over_ground"),
    "undecided": ("radar-relative", ""),
    "denied": ("radar-scan", ", velocities: over_ground"),
    "twice": ("radar-over-ground", ", velocities: relative"),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Recording -> (truth, its files by stamp, what the check finds)."""
    folder = tmp_path_factory.mktemp("radars")
    (folder / "recordings").mkdir()
    truths = {odd: record(folder / f"{odd}.mcap", odd) for odd in {odd for odd, _ in CASES.values()}}
    rigs = []
    for name, (odd, setting) in CASES.items():
        shutil.copy(folder / f"{odd}.mcap", folder / "recordings" / f"{name}.mcap")
        rigs.append(
            f"  - name: {name}\n    match: [{name}.mcap]\n    ego_pose: {{source: odometry, topic: /odom}}\n"
            f"    channels: {{RADAR_FRONT: {{modality: radar, topic: {TOPIC}{setting}}}}}\n"
        )
    (folder / "recipe.yaml").write_text(
        "name: radars\nbags: {root: recordings}\nscenes: {reference: RADAR_FRONT}\npreview: {enabled: false}\n"
        f"rigs:\n{''.join(rigs)}"
    )
    recipe = load_recipe(folder / "recipe.yaml")
    store = Store(recipe.store_path)
    (check,) = (check for check in RECORDING_CHECKS if check.name == "radar_velocities")
    results = {}
    for key, made in build_recordings(recipe).items():
        name = key.removesuffix(".mcap")
        entry = made["sweeps"].artifact.read_json("channels.json")["RADAR_FRONT"]
        sweeps = store.artifact(entry["artifact"])
        index = sweeps.read_table("index.parquet").to_pylist()
        tables = {row["stamp_ns"]: read_radar_file(sweeps.path(row["file"])) for row in index}
        evidence = Evidence(
            recipe, recipe.rig_named(name), store, lambda asset, made=made: made[asset].artifact
        )
        results[name] = truths[CASES[name][0]], tables, check.rule(evidence)
    return results


def known(truth, stamp_ns):
    """Field -> (N,) of what the radar sees at a time."""
    targets = radar_targets(truth.world, truth.seconds(stamp_ns), EGO_SE3_TURNED_RADAR, buildings=True)
    return {name: np.array([one[name] for one in targets]) for name in targets[0]}


@pytest.mark.parametrize("name", ["relative", "scan", "ground"])
def test_targets_have_their_true_velocities_over_ground(built, name):
    truth, tables, _ = built[name]
    still = moving = 0
    for stamp_ns, table in tables.items():
        told = known(truth, stamp_ns)
        assert np.allclose([table[axis] for axis in "xyz"], [told[axis] for axis in "xyz"], atol=1e-3)
        velocity = np.stack([told["vx_comp"], told["vy_comp"]])
        if name == "scan":  # the part along the ray, laid along it
            rays = np.stack([told[axis] for axis in "xyz"])
            rays = rays / np.sqrt((rays * rays).sum(axis=0))
            velocity = (velocity * rays[:2]).sum(axis=0) * rays[:2]
        error = np.stack([table["vx_comp"], table["vy_comp"]]) - velocity
        assert np.abs(error).max() < 0.02
        stands = np.hypot(told["vx_comp"], told["vy_comp"]) < 1e-6
        assert np.hypot(table["vx_comp"], table["vy_comp"])[stands].max() < 0.02
        still, moving = still + stands.sum(), moving + (~stands).sum()
    assert len(tables) == 21
    assert (still > 100, moving > 60) == (True, True)


def test_measured_velocities_stay_beside_them(built):
    truth, tables, _ = built["relative"]
    for stamp_ns, table in tables.items():
        told = known(truth, stamp_ns)
        assert np.allclose([table["vx"], table["vy"]], [told["vx"], told["vy"]], atol=1e-4)
        assert np.hypot(table["vx"], table["vy"]).max() > 6.0


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_setting_is_found_and_a_right_one_is_not(built, name):
    finding = built[name][2]
    wrong = {"undecided": "relative", "denied": "relative", "twice": "over_ground"}.get(name)
    assert [problem.rpartition("write ")[2] for problem in finding.problems] == (
        [f"velocities: {wrong}"] if wrong else []
    )


# --- what `init` proposes -----------------------------------------------------------------


def proposed(tmp_path, name, odd, seconds):
    record(tmp_path / name, odd, seconds)
    with open_recording(tmp_path / name) as recording:
        summary = scan_recording(recording)
    return summary, propose_recipe({name: summary}, name="yard", root=tmp_path)


@pytest.mark.parametrize(
    ("odd", "velocities"),
    [("radar-relative", "relative"), ("radar-over-ground", "over_ground"), ("radar-scan", None)],
)
def test_what_stands_still_tells_what_velocities_are(tmp_path, odd, velocities):
    summary, proposal = proposed(tmp_path, "a.mcap", odd, 3.2)
    assert summary.topics[TOPIC].velocities == {velocities} - {None}
    (rig,) = parse_recipe(proposal.text, tmp_path / "recipe.yaml").rigs
    assert rig.channels["RADAR_FRONT"].velocities == velocities
    assert not proposal.questions


def test_too_short_a_drive_is_a_question(tmp_path):
    summary, proposal = proposed(tmp_path, "a.mcap", "radar-relative", 1.0)
    assert summary.topics[TOPIC].velocities == {"undecided"}
    (question,) = proposal.questions
    assert "relative to the radar" in question.text
    with pytest.raises(RecipeError, match=rf"recipe.yaml:{question.line}: .*velocities: needs a value"):
        parse_recipe(proposal.text, tmp_path / "recipe.yaml")
    for answer in ("relative", "over_ground"):
        text = proposal.text.replace("velocities:", f"velocities: {answer}")
        assert (
            parse_recipe(text, tmp_path / "recipe.yaml").rigs[0].channels["RADAR_FRONT"].velocities == answer
        )
