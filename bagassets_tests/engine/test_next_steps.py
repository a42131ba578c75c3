"""What is done next: the policy of builds and of the sensor, case by case."""

import math
import time
from dataclasses import replace
from itertools import pairwise

import pytest

from bagassets.defs.graph.sensor_scan import RULES as SENSOR
from bagassets.engine.batches import DATASET, SMALL_BYTES, WORTH_STEPS_BYTES
from bagassets.engine.next_steps import Rules, State, Work, next_steps

pytestmark = pytest.mark.once

BUILD = Rules(jobs=2)
ALL = ("bag", "inventory", "frames")
SETS = ("nuscenes_dataset", "trajectory_map")
NOW_S = 1_800_000_000.0
LARGE = Work(ALL, SMALL_BYTES + 1)
SMALL = Work(ALL, 1000)
HUGE = Work(ALL, WORTH_STEPS_BYTES + 1)
BEHIND = {DATASET: Work(SETS)}


def state(**known):
    return State(**({"now_s": NOW_S, "found": 3} | known))


def of_runs(steps):
    """What the runs are about, and what those about a single recording make of it."""
    return [tuple(run) if len(run) > 1 else (*run, *next(iter(run.values()))) for run in steps.runs]


@pytest.mark.parametrize("rules", [BUILD, SENSOR], ids=["build", "sensor"])
class TestBoth:
    def test_nothing_is_done_if_nothing_changed(self, rules):
        steps = next_steps(state(joined=SETS), rules)
        assert (steps.runs, steps.register, steps.remove, steps.doubted_s) == ((), (), (), None)
        assert steps.is_over

    def test_new_recordings_are_registered_in_order_and_those_that_are_gone_removed(self, rules):
        steps = next_steps(state(new={"b", "a"}, gone=("d", "c")), rules)
        assert (steps.register, steps.remove) == (("a", "b"), ("c", "d"))

    def test_what_a_backfill_targets_is_not_removed(self, rules):
        assert next_steps(state(gone=("c", "d"), held={"c": "why"}), rules).remove == ("d",)

    def test_recordings_come_before_the_datasets(self, rules):
        steps = next_steps(state(todo={"a": LARGE, **BEHIND}), rules)
        assert of_runs(steps) == [("a", *ALL)]
        assert not steps.is_over

    def test_the_datasets_have_a_run_when_the_recordings_are_done(self, rules):
        assert of_runs(next_steps(state(todo=BEHIND), rules)) == [(DATASET, *SETS)]

    def test_what_a_run_is_about_is_left_to_it_and_the_datasets_wait(self, rules):
        steps = next_steps(state(todo={"a": LARGE, "b": LARGE, **BEHIND}, active={"a"}, runs=1), rules)
        assert of_runs(steps) == [("b", *ALL)]
        assert next_steps(state(todo=BEHIND, active={"x"}, runs=1), rules).runs == ()
        assert next_steps(state(todo=BEHIND, active={DATASET}, runs=1), rules).runs == ()

    def test_large_recordings_have_runs_of_their_own_the_largest_first_and_small_ones_share(self, rules):
        todo = {"a": LARGE, "b": HUGE} | {f"s{number}": SMALL for number in range(8)}
        first, second, *others = (set(run) for run in next_steps(state(todo=todo), rules).runs)
        assert (first, second) == ({"b"}, {"a"})
        assert sum(len(keys) for keys in others) == 8
        assert len(others) == (rules.jobs if rules is BUILD else 1)


# --- a build ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("todo", "known", "runs"),
    [
        pytest.param({"a": SMALL}, {}, [("a", DATASET)], id="a single run makes the datasets, too"),
        pytest.param({"a": HUGE}, {}, [("a", DATASET)], id="so does that of a huge one made before"),
        pytest.param(
            {"a": HUGE._replace(is_new=True)}, {}, [("a", *ALL)], id="not so if that is new: steps show more"
        ),
        pytest.param({"a": SMALL, "b": SMALL}, {}, [("a", *ALL), ("b", *ALL)], id="nor if there are two"),
        pytest.param(
            {"a": SMALL}, {"joined": ()}, [("a", *ALL)], id="nor if they were tried, or not asked for"
        ),
        pytest.param(
            {"a": SMALL}, {"active": {"b"}, "runs": 1}, [("a", *ALL)], id="nor beside runs of earlier builds"
        ),
        pytest.param({"a": SMALL._replace(tries=1)}, {}, [], id="what was tried is not tried again"),
        pytest.param({DATASET: Work(SETS, tries=1)}, {}, [], id="nor are the datasets"),
        pytest.param(
            {"a": SMALL._replace(is_touched=True)}, {"joined": ()}, [("a", *ALL)], id="touched: all"
        ),
    ],
)
def test_a_build(todo, known, runs):
    assert of_runs(next_steps(state(**({"todo": todo, "joined": SETS} | known)), BUILD)) == runs


@pytest.mark.parametrize("gone", [("a",), ("a", "b")])
def test_a_build_doubts_that_all_recordings_are_gone_unless_it_is_told_so(gone):
    steps = next_steps(state(found=0, gone=gone, new={"c"}, todo=BEHIND), BUILD)
    assert (steps.doubted_s, steps.remove, steps.register, steps.runs) == (math.inf, (), (), ())
    told = next_steps(state(found=0, gone=gone), replace(BUILD, patience_s=0.0))
    assert (told.doubted_s, told.remove) == (None, gone)


def test_dealing_many_recordings_takes_no_time():
    todo = {f"{number:06}": SMALL for number in range(40_000)}
    began_s = time.process_time()
    steps = next_steps(state(todo={**todo, "large": LARGE}), BUILD)
    assert time.process_time() - began_s < 5  # and 40 if each is sought among all
    assert sorted(key for run in steps.runs for key in run) == sorted([*todo, "large"])


def test_where_there_are_many_recordings_they_do_without_steps():
    todo = {f"m{number}": LARGE for number in range(8)} | {"huge": HUGE}
    assert next_steps(state(todo=todo), BUILD).without_steps == todo.keys() - {"huge"}
    assert next_steps(state(todo={"a": LARGE}), BUILD).without_steps == frozenset()


def test_where_runs_wait_in_a_queue_it_says_how_many_recordings_share_one():
    todo = {f"s{number}": SMALL for number in range(10)}
    sizes = [len(run) for run in next_steps(state(todo=todo), Rules(1000, most_per_run=5)).runs]
    assert sizes == [5, 5]


# --- the sensor --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("todo", "known", "runs"),
    [
        pytest.param({"a": SMALL._replace(is_touched=True)}, {}, [("a", "bag")], id="touched: bag alone"),
        pytest.param(
            {"a": SMALL._replace(tries=1, tried_s=NOW_S - SENSOR.retry_s + 1)}, {}, [], id="asked just now"
        ),
        pytest.param(
            {"a": SMALL._replace(tries=1, tried_s=NOW_S - SENSOR.retry_s)}, {}, [("a", *ALL)], id="again"
        ),
        pytest.param(
            {"a": SMALL._replace(tries=2, tried_s=NOW_S - SENSOR.retry_s)}, {}, [], id="later the next time"
        ),
        pytest.param({"a": SMALL._replace(tries=SENSOR.most_tries)}, {}, [], id="too often, or cancelled"),
        pytest.param(
            {"a": LARGE, "b": LARGE},
            {"active": {"c"}, "runs": SENSOR.most_runs - 1},
            [("a", *ALL)],
            id="no more runs than are worked off",
        ),
        pytest.param({"a": LARGE}, {"active": {"c"}, "runs": 99}, [], id="none if there are more already"),
        pytest.param(
            BEHIND,
            {"active": {"a"}, "runs": 1, "busy_since_s": NOW_S - SENSOR.patience_s},
            [],
            id="the datasets wait for runs",
        ),
        pytest.param(
            {"b": LARGE, **BEHIND},
            {"active": {"a"}, "runs": 1, "busy_since_s": NOW_S - SENSOR.patience_s - 1},
            [("b", *ALL), (DATASET, *SETS)],
            id="but not for ever",
        ),
        pytest.param(
            BEHIND,
            {"active": {"a", DATASET}, "runs": 2, "busy_since_s": NOW_S - 1000},
            [],
            id="one run of them at a time",
        ),
        pytest.param(
            {DATASET: Work(SETS, tries=1, tried_s=NOW_S - 1)},
            {},
            [],
            id="the datasets are asked for just now",
        ),
    ],
)
def test_the_sensor(todo, known, runs):
    assert of_runs(next_steps(state(todo=todo, **known), SENSOR)) == runs


def test_the_sensor_asks_for_the_same_again_with_pauses_and_not_for_ever():
    work, asked = SMALL, []
    for second in range(0, 5000, 5):
        if next_steps(state(now_s=NOW_S + second, todo={"a": work}), SENSOR).runs:
            asked.append(NOW_S + second)
            work = work._replace(tries=work.tries + 1, tried_s=NOW_S + second)
    assert len(asked) == SENSOR.most_tries
    assert [later - sooner for sooner, later in pairwise(asked)] == [SENSOR.retry_s, 2 * SENSOR.retry_s]


def test_the_sensor_counts_from_when_it_was_last_idle():
    begun = next_steps(state(todo={"a": LARGE}), SENSOR)
    assert begun.busy_since_s == NOW_S
    later = state(now_s=NOW_S + 30, active={"a"}, runs=1, busy_since_s=begun.busy_since_s)
    assert next_steps(later, SENSOR).busy_since_s == NOW_S
    assert next_steps(replace(later, now_s=NOW_S + 61), SENSOR).busy_since_s is None
    assert next_steps(state(busy_since_s=NOW_S - 30), SENSOR).busy_since_s is None


def test_the_sensor_waits_for_a_disk_that_seems_gone_and_then_believes_it():
    at_first = next_steps(state(found=0, gone=("a", "b")), SENSOR)
    assert (at_first.doubted_s, at_first.remove) == (SENSOR.patience_s, ())
    since_s = at_first.empty_since_s
    later = state(found=0, gone=("a", "b"), now_s=NOW_S + 59, empty_since_s=since_s)
    assert next_steps(later, SENSOR).doubted_s == 1
    last = next_steps(replace(later, now_s=NOW_S + 60, held={"b": "why"}), SENSOR)
    assert (last.doubted_s, last.remove, last.empty_since_s) == (None, ("a",), NOW_S)
    assert next_steps(state(found=2, empty_since_s=since_s), SENSOR).empty_since_s is None


def test_the_last_recording_goes_at_once():
    assert next_steps(state(found=0, gone=("a",)), SENSOR).remove == ("a",)
