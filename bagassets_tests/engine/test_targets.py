"""The state of datasets, the map and users' own assets: a table of cases."""

import pytest

from bagassets.engine.plan import AssetState, BagPlan, Recorded, version_as_input
from bagassets.engine.targets import (
    Evidence,
    Read,
    Target,
    inputs_digest,
    read_before,
    state_as_read,
    target_state,
)

pytestmark = pytest.mark.once

INPUTS = (Read("inputs", "whole"),)
DATASET = Target("dataset", INPUTS, "2", code_changed="its settings changed")
STEP = Target("step", (Read("frames", "same"),), None, is_partitioned=True)
TABLE = Target("table", (Read("step", "all"), Read("weather", "whole")), "1")
NOW = {"inputs": "v1", "frames": "v1", "step": "s1", "weather": "sun"}
FRESH = "what it reads is as it was when it was made"
MADE = Recorded("d1", "2")
UNRECORDED = "made by hand, so what it has read is not on record"


def found(target, recorded, **known):
    now = {read.name: NOW[read.name] for read in target.reads}
    return Evidence(now, recorded, **{"before": now, "told": lambda: inputs_digest(target, now), **known})


@pytest.mark.parametrize(
    ("target", "recorded", "known", "state", "reason"),
    [
        (DATASET, MADE, {}, "fresh", FRESH),
        (DATASET, None, {}, "missing", "never made"),
        (DATASET, None, {"is_due": False}, "blocked", "never made, as no recording can be part of it yet"),
        (DATASET, None, {"waits_for": "tables of a"}, "missing", "never made; waits for tables of a"),
        (DATASET, None, {"is_due": False, "waits_for": "tables of a"}, "unknown", "waits for tables of a"),
        (DATASET, MADE, {"waits_for": "tables of a"}, "unknown", "waits for tables of a"),
        (DATASET, Recorded("d1", "1"), {}, "stale", "its settings changed"),
        (
            DATASET,
            MADE,
            {"before": {"inputs": "v0"}, "told": lambda: None, "changed": lambda: "recordings came"},
            "stale",
            "recordings came",
        ),
        (DATASET, MADE, {"is_whole": lambda: False}, "stale", "its files are gone or were changed"),
        (DATASET, MADE, {"failure": lambda: "no"}, "fresh", FRESH),
        (STEP, Recorded("d1", "any"), {}, "fresh", FRESH),
        (STEP, MADE, {"before": {"frames": version_as_input("v1")}}, "fresh", FRESH),
        (STEP, MADE, {"before": {"frames": "v0"}, "told": lambda: ""}, "stale", "frames changed"),
        (STEP, MADE, {"before": {"frames": "v0"}}, "fresh", FRESH),
        (STEP, MADE, {"before": {}, "told": lambda: None}, "stale", "frames changed"),
        (STEP, MADE, {"before": {}, "told": lambda: "", "failure": lambda: "dust"}, "failed", "dust"),
        (STEP, None, {"failure": lambda: "dust"}, "failed", "dust"),
        (TABLE, Recorded("d1", "1"), {}, "fresh", FRESH),
        (TABLE, MADE, {}, "stale", "its code version is 1, was 2"),
        (TABLE, Recorded("d1", "1"), {"told": lambda: ""}, "stale", UNRECORDED),
        (TABLE, Recorded("d1", "1"), {"told": lambda: None}, "fresh", FRESH),
        (
            TABLE,
            Recorded("d1", "1"),
            {"told": lambda: "x"},
            "stale",
            "a recording was added, changed or removed",
        ),
        (
            TABLE,
            Recorded("d1", "1"),
            {"told": lambda: "x", "before": {"weather": "rain"}},
            "stale",
            "weather changed",
        ),
    ],
)
def test_a_target_is_compared_with_its_record(target, recorded, known, state, reason):
    one = target_state(target, found(target, recorded, **known))
    assert (one.state, one.reason) == (state, reason)
    assert one.data_version == ("d1" if state == "fresh" and recorded else None)


@pytest.mark.parametrize(
    ("how", "above", "state", "reason"),
    [
        ("same", "fresh", "missing", "never made"),
        ("same", "missing", "unknown", "x comes first"),
        ("same", "stale", "unknown", "x comes first"),
        ("same", "unknown", "unknown", "x comes first"),
        ("same", "record-only", "unknown", "x comes first"),
        ("same", "failed", "blocked", "x failed"),
        ("same", "blocked", "blocked", "the first cause"),
        ("whole", "skipped", "skipped", "the first cause"),
        ("all", "stale", "unknown", "x comes first"),
        ("all", "failed", "missing", "never made"),
        ("all", "blocked", "missing", "never made"),
        ("all", "skipped", "missing", "never made"),
    ],
)
def test_a_target_waits_for_what_it_reads_or_is_blocked_by_it(how, above, state, reason):
    read = Read("x", how)
    states = [(read, AssetState("fresh", "")), (read, AssetState(above, "the first cause"))]
    one = target_state(Target("one", (read,), None), Evidence({"x": "v1"}, None), states)
    assert (one.state, one.reason) == (state, reason)


@pytest.mark.parametrize(
    ("frames", "below", "state", "reason"),
    [
        ("fresh", "unknown", "fresh", "why"),
        ("skipped", "skipped", "skipped", "why"),
        ("stale", "unknown", "stale", "why"),
        ("failed", "unknown", "blocked", "lab/frames failed, as its recording failed"),
        ("unknown", "failed", "blocked", "lab/frames is not there, as its recording failed"),
        ("fresh", "failed", "fresh", "why"),
    ],
)
def test_what_is_read_of_a_recording_that_failed_is_not_to_come(frames, below, state, reason):
    bag = BagPlan("a", {"frames": AssetState(frames, "why"), "tables": AssetState(below, "why")})
    one = state_as_read(bag, "frames", "lab/frames")
    assert (one.state, one.reason) == (state, reason)


def test_what_was_read_is_spelled_as_that_of_now_where_it_is_the_same():
    before = {"weather": version_as_input("sun"), "step": ""}
    assert read_before(TABLE, found(TABLE, MADE, before=before)) == {"step": "s1", "weather": "sun"}
    told = found(TABLE, MADE, before={"weather": "rain"}, told=lambda: "x")
    assert read_before(TABLE, told) == {"step": "", "weather": "rain"}
    assert read_before(TABLE, found(TABLE, None)) is None
