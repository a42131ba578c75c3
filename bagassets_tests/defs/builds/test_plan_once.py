"""How often a build decides about a recording: once, and again what its runs have changed."""

import gc
from collections import Counter

import dagster as dg
import pytest
from click.testing import CliRunner

from bagassets.base.garbage import uncollected
from bagassets.cli.main import root
from bagassets.defs.builds import loop, pending_work
from bagassets.defs.records import instance_plan
from bagassets.defs.records.events import Records
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.execution import create_run, execute_run
from bagassets.engine import planner
from bagassets.engine.build_report import remark_lines
from bagassets.engine.plan import BagPlan, KeptPlan
from bagassets.store.store import Store
from bagassets_tests.in_process import QUICK, build, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

KEY = "a.bag"


def find_state(recipe_file):
    with pending_work.open_project(recipe_file) as workspace:
        return pending_work.find_pending_work(workspace)


def planned(recipe_file, monkeypatch):
    """Build; return how often each recording was looked into, and how often everything was."""
    keys, whole = Counter(), Counter()
    plan, begin = planner.plan_recording, instance_plan.planner_of

    def note(graph):
        keys[graph.recording.key] += 1
        return plan(graph)

    def note_whole(*args, **options):
        whole["all"] += len(args) == 1  # else some are kept, and what runs have changed is planned again
        return begin(*args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(planner, "plan_recording", note)
        patch.setattr(instance_plan, "planner_of", note_whole)
        patch.setattr(loop, "planner_of", note_whole)
        report, _ = build(recipe_file, monkeypatch)
    return report, keys, whole["all"]


def test_a_build_plans_once_and_again_what_its_runs_have_changed(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY, "b.mcap"])
    report, keys, whole = planned(recipe, monkeypatch)
    assert report.succeeded
    # Everything is looked at before the build, and by the run of the dataset.
    assert (keys, whole) == ({KEY: 2, "b.mcap": 2}, 2)
    write_drive(tmp_path / "bags" / "b.mcap", "mcap", duration_s=1.5)
    report, keys, whole = planned(recipe, monkeypatch)
    assert report.succeeded
    # What both recordings have alike was made once more, and nobody looks at the other one because of that.
    assert (keys, whole) == ({"b.mcap": 2}, 2)
    assert planned(recipe, monkeypatch)[1:] == ({}, 1)


def test_many_recordings_are_planned_some_at_a_time_and_the_build_says_how_many_have_been(
    tmp_path, monkeypatch
):
    recipe = make_project(tmp_path, [KEY, "b.mcap", "c.bag"])
    assert build(recipe, monkeypatch)[0].succeeded
    with pending_work.open_project(recipe) as workspace:
        whole = instance_plan.plan_instance(workspace)
        fetched, fetch = [], Records.fetch

        def note(records, ids, keys):
            fetched.append(list(keys))
            return fetch(records, ids, fetched[-1])

        monkeypatch.setattr(Records, "fetch", note)
        monkeypatch.setattr(planner, "AT_A_TIME", 2)
        told = []
        for fingerprint in ("other code", None):
            monkeypatch.setattr(instance_plan, "workspace_fingerprint", lambda _, it=fingerprint: it)
            now = instance_plan.planner_of(workspace).plan(lambda done, total: told.append((done, total)))
            assert now == whole
            kept = [isinstance(bag, KeptPlan) for bag in now.bags.values()]
            assert kept == [fingerprint is not None] * 3, (
                "a plan is not held longer than in the form that is kept"
            )
            assert now.recorded == {}, "nobody asks for the records of what is settled"
    assert fetched == [[KEY, "b.mcap"], ["c.bag"]] * 2
    assert told == [(2, 3), (3, 3)] * 2
    monkeypatch.undo()
    monkeypatch.setattr(planner, "AT_A_TIME", 2)
    recipe.write_text(recipe.read_text() + "# another text\n")
    events = []
    build(recipe, monkeypatch, on_event=events.append)
    messages = [event.message for event in events if event.kind == "planning"]
    assert messages == ["Planned 2 of 3 recordings", "Planned 3 of 3 recordings"]


def test_of_what_is_planned_nothing_is_held_but_what_is_kept(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY, "b.mcap"])
    assert build(recipe, monkeypatch)[0].succeeded
    monkeypatch.setattr(instance_plan, "workspace_fingerprint", lambda _: "other code")
    gc.collect()
    former = [one for one in gc.get_objects() if type(one) is BagPlan]  # such as those that were decoded last
    with pending_work.open_project(recipe) as workspace, uncollected():  # as while thousands are planned
        plan = instance_plan.plan_instance(workspace)
        held = [one for one in gc.get_objects() if type(one) is BagPlan]
    assert [type(bag) for bag in plan.bags.values()] == [KeptPlan, KeptPlan]
    # What was held before may be given up at any time.
    assert {id(one) for one in held} <= {id(one) for one in former}


def test_a_build_and_its_run_look_for_recordings_once_each(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY, "b.mcap"])
    build(recipe, monkeypatch)
    _rewrite(tmp_path / "bags" / KEY, 1.5)
    looked, discover = [], Workspace.discover
    monkeypatch.setattr(Workspace, "discover", lambda self: looked.append(1) or discover(self))
    report, runs = build(recipe, monkeypatch)
    assert (report.succeeded, report.dataset, len(runs)) == (True, "updated", 2)
    assert len(looked) == 2


def test_all_datasets_of_a_run_are_made_from_one_plan(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY], text=QUICK + "vision: {{frames: 5}}\n")
    report, keys, whole = planned(recipe, monkeypatch)
    assert report.succeeded
    assert (keys, whole) == ({KEY: 2}, 2)


def test_a_recording_that_failed_is_not_planned_for_each_dataset_again(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY])
    (tmp_path / "bags" / "broken.mcap").write_bytes(b"no recording")
    report, keys, _ = planned(recipe, monkeypatch)
    assert report.outcomes["broken.mcap"].result == "failed"
    assert keys == {KEY: 2, "broken.mcap": 3}


def _rewrite(file, duration_s):
    file.unlink(missing_ok=True)
    write_drive(file, "ros1", duration_s=duration_s)


def _replace(bags, _instance, _workspace):
    _rewrite(bags / "b.bag", 1.5)


def _replace_what_was_built(bags, _instance, _workspace):
    _rewrite(bags / KEY, 2.5)


def _add(bags, _instance, _workspace):
    _rewrite(bags / "c.bag", 1.0)


def _remove(bags, _instance, _workspace):
    (bags / "b.bag").unlink()


def _record(_bags, instance, _workspace):
    tags = {"dagster/data_version": "0" * 64}
    instance.report_runless_asset_event(dg.AssetMaterialization("frames", partition="b.bag", tags=tags))


def _damage(_bags, instance, workspace):
    frames = Records(instance, workspace.names).of("frames", "b.bag")
    workspace.store.artifact(frames.data_version).path("channels.json").unlink()


def _nothing(*_):
    pass


def test_what_others_change_before_a_build_ends_is_seen_as_by_a_look_at_everything(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY, "b.bag"])
    assert build(recipe, monkeypatch)[0].succeeded
    _rewrite(tmp_path / "bags" / KEY, 1.5)
    look_on, look, looked, seen = loop.BuildLoop.look_on, loop.BuildLoop.look, [], {}

    def note_look(self, **options):
        looked.append(1)
        return look(self, **options)

    def change_first(self, *args, everything=True):
        if not everything:
            return look_on(self, *args, everything=False)
        for change in (_nothing, _replace_what_was_built, _damage, _record, _replace, _add, _remove):
            looked.clear()
            change(tmp_path / "bags", self.workspace.instance, self.workspace)
            found = look_on(self, *args)
            seen[change] = len(looked)
            whole = look(self)
            for name in ("todo", "states", "asked", "held"):
                assert getattr(found, name) == getattr(whole, name), change
            assert found.inputs.as_json() == whole.inputs.as_json(), change
            assert dict(found.plan.bags) == dict(whole.plan.bags), change
            assert (found.plan.live, found.plan.removed) == (whole.plan.live, whole.plan.removed), change
        return whole

    monkeypatch.setattr(loop.BuildLoop, "look", note_look)
    monkeypatch.setattr(loop.BuildLoop, "look_on", change_first)
    build(recipe, monkeypatch)
    assert list(seen.values()) == [0, 1, 0, 0, 1, 1, 1]
    monkeypatch.undo()
    build(recipe, monkeypatch)  # what was noted of the one before does not hide anything
    assert find_state(recipe).is_settled


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("add", "c.bag: it came, changed or went while this was built; build again"),
        ("remove", "b.mcap: it came, changed or went while this was built; build again"),
        ("edit", "recipe.yaml was edited while this was built; build again"),
        ("", ""),
    ],
)
def test_a_build_says_what_is_left_to_the_next(tmp_path, monkeypatch, change, told):
    recipe = make_project(tmp_path, [KEY, "b.mcap"])
    build(recipe, monkeypatch)
    _rewrite(tmp_path / "bags" / KEY, 1.5)

    def meanwhile(event):
        if (event.kind, event.key) == ("done", KEY):
            if change == "add":
                write_drive(tmp_path / "bags" / "c.bag", "ros1", duration_s=1.0)
            elif change == "remove":
                (tmp_path / "bags" / "b.mcap").unlink()
            elif change == "edit":
                recipe.write_text(recipe.read_text().replace("min_length_s: 0.5", "min_length_s: 0.4"))

    report, _ = build(recipe, monkeypatch, on_event=meanwhile)
    assert report.succeeded
    lines = [line for line in remark_lines(report.remarks) if "(left_over)" in line]
    assert len(lines) == bool(told)
    assert all(told in line for line in lines)
    report, _ = build(recipe, monkeypatch)
    assert not [one for one in report.remarks if one.check == "left_over"]
    assert find_state(recipe).is_settled


def test_what_a_build_has_made_is_built_although_another_has_recorded_it_since(tmp_path, monkeypatch):
    """As two builds of a new project do that begin at the same time."""
    recipe = make_project(tmp_path, [KEY])

    def meanwhile(event):
        if (event.kind, event.key) == ("done", KEY):
            with pending_work.open_project(recipe) as workspace:
                instance = workspace.instance
                names = [dg.AssetKey(name) for name in ("bag", *workspace.assets.names)]
                execute_run(instance, create_run(instance, names, partition_key=KEY))

    report, _ = build(recipe, monkeypatch, on_event=meanwhile)
    assert report.outcomes[KEY].result == "built"


def test_what_another_run_recorded_meanwhile_is_planned_again(tmp_path, monkeypatch):
    recipe = make_project(tmp_path, [KEY, "b.mcap"])
    build(recipe, monkeypatch)
    with pending_work.open_project(recipe) as workspace:
        instance = workspace.instance
        before = instance_plan.plan_instance(workspace)
        unchanged = instance_plan.replan_instance(workspace, before, [])
        assert unchanged == before
        instance.report_runless_asset_event(
            dg.AssetMaterialization("inventory", partition=KEY, tags={"dagster/data_version": "0" * 64})
        )
        now = instance_plan.replan_instance(workspace, before, [])
        assert now.bags[KEY].assets["inventory"].state == "record-only"
        assert now.bags["b.mcap"] is before.bags["b.mcap"]


def test_planning_makes_nothing(tmp_path, monkeypatch):
    datasets = "vision: {{}}\ndatasets:\n  - {{name: later, min_speed_mps: 1}}\n"
    recipe = make_project(tmp_path, [KEY, "b.mcap"], text=QUICK + datasets)
    build(recipe, monkeypatch)
    text = recipe.read_text().replace("min_speed_mps: 1", "min_speed_mps: 2")
    recipe.write_text(text.replace("topic: /cam/image_raw", "topic: /cam/image_raw, quality: 33"))
    write_drive(tmp_path / "bags" / "b.mcap", "mcap", duration_s=1.5)
    write_drive(tmp_path / "bags" / "c.bag", "ros1", duration_s=1.0)

    ran = []

    def refuse(_store, action, *_):
        ran.append(action.step)
        raise AssertionError(f"a plan ran {action}")

    monkeypatch.setattr(Store, "begin", refuse)
    for command in (
        ["status"],
        ["build", "--dry-run"],
        ["explain", "b.mcap", "nuscenes_tables"],
        ["gc", "--dry-run"],
    ):
        done = CliRunner().invoke(root, [*command, "--recipe", str(recipe)])
        assert (done.exit_code in {0, 3}, ran) == (True, []), (command, done.output)
        assert "b.mcap" in done.stdout or command[0] == "gc", command
