"""What the web UI shows of an asset: numbers that it can plot, what matters first, columns, and links to pages."""

from dataclasses import astuple, replace
from pathlib import Path

import dagster as dg
import pyarrow.parquet as pq
import pytest

from bagassets.assets.quality.evidence import Evidence
from bagassets.base.errors import StoreError
from bagassets.defs.builds import pending_work
from bagassets.defs.builds.report import remarks_of_runs
from bagassets.defs.graph import dataset
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.artifact_files import page_file
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.reporting import dataset_metadata, inputs_metadata
from bagassets.formats import checking, report_data
from bagassets.formats.assembly import DatasetSummary
from bagassets.formats.checking import check_bag
from bagassets.formats.dataset_build import DatasetInputs
from bagassets.formats.report_data import report_path
from bagassets.report.page import report_page
from bagassets_tests.in_process import build, make_project
from bagassets_tests.small_drive import write_drive

KEY = "a.bag"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("web")
    project = make_project(folder, (KEY,), duration_s=3.0)
    write_drive(folder / "bags" / "short.bag", "ros1", duration_s=0.4)
    project.write_text(project.read_text().replace("settle_s: 0", "settle_s: 0, min_duration_s: 0.8"))
    with project.open("a") as recipe:
        recipe.write("checks: {poses_cover_sensors: {max_speed_mps: 0.5}}\n")
    with pytest.MonkeyPatch.context() as patch:
        build(project, patch, jobs=1)
        with pending_work.open_project(project) as workspace:
            instance = workspace.instance
            yield project, instance, workspace


def metadata(instance, asset, key=None):
    records = instance.fetch_materializations(
        dg.AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=[key] if key else None), limit=1
    ).records
    return records[0].asset_materialization.metadata


@pytest.mark.parametrize(
    ("asset", "names"),
    [
        ("frames", ("written", "lost")),
        ("sweeps", ("written", "lost")),
        ("annotations", ("boxes",)),
        ("nuscenes_tables", ("scenes", "keyframes", "boxes")),
    ],
)
def test_what_people_count_is_a_number_and_stands_first(made, asset, names):
    found = metadata(made[1], asset, KEY)
    assert tuple(found)[: len(names)] == names
    assert all(isinstance(found[name], dg.IntMetadataValue) for name in names)
    assert list(found)[-2:] == ["action_digest", "content_digest"]


def test_the_numbers_are_those_of_the_artifacts(made):
    _, instance, workspace = made
    frames = metadata(instance, "frames", KEY)
    artifact = workspace.store.artifact(Path(frames["artifact"].value).name)
    channels = artifact.summary()["channels"]
    assert frames["written"].value == sum(channel["written"] for channel in channels.values()) > 0
    dataset = metadata(instance, "nuscenes_dataset")
    tables = metadata(instance, "nuscenes_tables", KEY)
    assert all(tables[name].value == dataset[name].value for name in ("scenes", "keyframes", "boxes"))


def test_counts_say_what_is_counted(made):
    assert "| CAM_FRONT (messages) | " in metadata(made[1], "frames", KEY)["channels"].value
    assert metadata(made[1], "ego_poses", KEY)["counts"].value.startswith("| messages | read | ")


def test_a_skipped_recording_says_why_above_all_else(made):
    found = metadata(made[1], "inventory", "short.bag")
    assert next(iter(found)) == "skipped"
    assert "min_duration_s" in found["skipped"].value


def test_a_dataset_says_which_recordings_failed_before_its_numbers():
    summary = DatasetSummary("0" * 64, Path("/data"), {"scenes": 2}, ())
    found = dataset_metadata(summary, {"cut.bag": "it cannot be read"})
    assert next(iter(found)) == "failed"
    assert found["failed"].value == "- cut.bag: it cannot be read"
    assert next(iter(dataset_metadata(summary, {}))) == "folder"


def test_the_report_is_there_as_soon_as_its_link_is(made, monkeypatch):
    project, instance, _ = made
    found = metadata(instance, "nuscenes_dataset")
    assert next(iter(found)) == "report"
    monkeypatch.setenv("BAGASSETS_RECIPE", str(project))
    page = page_file("report").read_text()
    assert page_file("report").parent == project.parent / ".bagassets"
    for words in (KEY, "short.bag", "bags.min_duration_s asks for 0.8 s", "<h2>Checks</h2>"):
        assert words in page, words


def test_the_report_has_what_checks_find_and_dagster_shows(made):
    _, instance, workspace = made
    planned = plan_instance(workspace.on(instance))
    verdicts = list(check_bag(workspace.assets, planned.discovery, planned.bags[KEY]))
    found = report_data.report_data(workspace.assets, planned, "recordings").recordings[0]
    failed = [one for one in verdicts if not one.finding.passed]
    assert found.checks_passed == len(verdicts) - len(failed) > 5
    assert sorted(map(astuple, found.problems)) == sorted(
        (one.check, one.weight, one.finding.sentences[0], len(one.finding.sentences) - 1) for one in failed
    )
    assert found.problems, "or the comparison is empty"
    assert found.problems[0].sentence in report_path(workspace.recipe).read_text()
    runs = [run.run_id for run in instance.get_runs()]
    shown = [one.check for one in remarks_of_runs(instance, runs) if one.key == KEY]
    assert sorted(shown) == sorted(one.check for one in failed)


@pytest.fixture
def asked(monkeypatch):
    """Record what is made or checked of recordings for the report."""
    asked, facts, check = [], report_data._facts, checking.check_bag

    def make(assets, bag, split):
        asked.append(("facts", bag.key))
        return facts(assets, bag, split)

    def check_bag(assets, discovery, bag):
        asked.append(("checks", bag.key))
        return check(assets, discovery, bag)

    monkeypatch.setattr(report_data, "_facts", make)
    monkeypatch.setattr(checking, "check_bag", check_bag)
    return asked


def test_of_recordings_that_have_not_changed_the_report_has_the_facts_that_were_kept(made, asked):
    _, _, workspace = made
    planned = plan_instance(workspace)

    def page(plan, checked="recordings"):
        return report_page(report_data.report_data(workspace.assets, plan, checked))

    fresh, unchecked = page(replace(planned, project=None)), page(replace(planned, project=None), "nothing")
    page(planned)
    asked.clear()
    assert page(planned) == fresh
    assert page(planned, "nothing") == unchecked != fresh
    assert asked == []
    another = replace(planned, project="another")
    page(another, "nothing")
    assert asked == [("facts", key) for key in ("a.bag", "short.bag")]
    asked.clear()
    page(another)
    assert asked == [(what, key) for key in ("a.bag", "short.bag") for what in ("facts", "checks")]
    kept = report_data._KeptFacts(workspace.assets, "another")
    bag = planned.bags[KEY]
    assert kept.known([bag], {KEY: "elsewhere"}) == {}
    splits = [split for split in ("train", "val") if kept.known([bag], {KEY: split})]
    assert len(splits) == 1, "that of the recording"
    assert kept.known([bag], {KEY: splits[0]})[KEY].split == splits[0]


def test_a_check_that_could_not_read_is_made_again_for_the_next_report(made, asked, monkeypatch):
    workspace = made[2]
    plan = replace(plan_instance(workspace), project="unread")

    def refuse(*_):
        raise StoreError("the disk refuses")

    with monkeypatch.context() as refusing:
        refusing.setattr(Evidence, "channels", refuse)
        found = report_data.report_data(workspace.assets, plan, "recordings").recordings[0]
        assert "the disk refuses" in str(found.problems)
    found = report_data.report_data(workspace.assets, plan, "recordings").recordings[0]
    assert "the disk refuses" not in str(found.problems)
    asked.clear()
    report_data.report_data(workspace.assets, plan, "recordings")
    assert asked == []


def test_where_there_is_no_report_there_is_no_link(made, monkeypatch):
    _, instance, workspace = made
    planned = plan_instance(workspace.on(instance))
    with monkeypatch.context() as patch:
        patch.setattr(dataset, "MOST_REPORTED", 1)
        said = dataset.write_report(workspace.on(instance), planned).value
        assert said == "`bagassets report` writes it (more than 1 recordings)"
    place = report_path(workspace.recipe)
    content = place.read_text()
    place.unlink()
    place.mkdir()
    said = dataset.write_report(workspace.on(instance), planned).value
    assert "could not be written" in said
    assert "](" not in said
    place.rmdir()
    place.write_text(content)


PATH = "/data/drives of 2026/monday/cut.bag"


def test_reasons_are_a_list_whose_lines_wrap_and_not_a_table():
    why = {
        "monday__cut.bag": f"{PATH}: its index is damaged; copy it again.",
        "other.bag": f"{PATH}: its index is damaged; copy it again.",
    }
    skipped = {"short.bag": "1.0 s long, bags.min_duration_s asks for 2 s"}
    inputs = DatasetInputs({"nuscenes": ()}, skipped, {"nuscenes": why})
    found = inputs_metadata(inputs)
    assert list(found) == ["why_failed", "why_skipped", "recordings", "skipped", "failed"]
    assert found["why_failed"].value.splitlines() == [
        r"- monday\_\_cut.bag: its index is damaged; copy it again.",
        f"- other.bag: {PATH}: its index is damaged; copy it again.",
    ]
    assert found["why_skipped"].value == "- short.bag: 1.0 s long, bags.min_duration_s asks for 2 s"


def test_equal_reasons_are_told_once_and_many_stay_short_enough_to_be_shown_without_a_click():
    equal = {f"a{number}.bag": "no /tf_static" for number in range(300)}
    (line,) = inputs_metadata(DatasetInputs({}, equal))["why_skipped"].value.splitlines()
    assert line == "- 300 recordings (a0.bag, a1.bag, a2.bag and 297 more): no /tf_static"
    different = {f"b{number}.bag": f"reason {'x' * number}" for number in range(50)}
    said = inputs_metadata(DatasetInputs({}, different))["why_skipped"].value
    *lines, rest = said.splitlines()
    assert 700 < len(said) < 1000
    assert rest == f"- … and {50 - len(lines)} more recordings; `bagassets status` lists them all"


def test_recordings_that_moved_or_are_there_twice_are_lists_as_well():
    summary = DatasetSummary(
        "0" * 64, Path("/data"), {}, (), duplicates={"copy.bag": "a.bag"}, moved={"b.bag": ("val", "train")}
    )
    found = dataset_metadata(summary, {})
    assert found["duplicates"].value == "- copy.bag: left out: the same content as a.bag"
    assert found["moved"].value == "- b.bag: was in val, is in train"


@pytest.mark.parametrize(
    ("asset", "file"),
    [
        ("inventory", "messages.parquet"),
        ("ego_poses", "ego_poses.parquet"),
        ("annotations", "annotations.parquet"),
        ("frames", "index.parquet"),
        ("sweeps", "index.parquet"),
    ],
)
def test_the_columns_of_tables_are_those_of_the_files(made, asset, file):
    project, instance, workspace = made
    node = build_definitions(project).get_repository_def().asset_graph.get(dg.AssetKey(asset))
    columns = {column.name: column.type for column in node.metadata["dagster/column_schema"].value.columns}
    materialization = (
        instance.fetch_materializations(
            dg.AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=[KEY]), limit=1
        )
        .records[0]
        .asset_materialization
    )
    artifact = workspace.store.artifact(materialization.tags["dagster/data_version"])
    if asset in {"frames", "sweeps"}:
        channel = next(iter(artifact.read_json("channels.json").values()))
        artifact = workspace.store.artifact(channel["artifact"])
    written = pq.read_schema(artifact.path(file))
    assert columns == {field.name: str(field.type).replace("element: ", "") for field in written}
    assert "dagster/column_schema" not in materialization.metadata


def test_every_asset_says_where_its_code_is(made):
    graph = build_definitions(made[0]).get_repository_def().asset_graph
    found = {}
    for key in graph.get_all_asset_keys():
        (reference,) = graph.get(key).metadata["dagster/code_references"].code_references
        lines = Path(reference.file_path).read_text().splitlines()
        found[key.to_user_string()] = (reference.label, lines[reference.line_number - 1].partition("(")[0])
    assert found["ego_poses"] == ("bagassets/assets/ego_poses.py", "def _make")
    assert all(text.startswith(("def ", "@")) for _, text in found.values())


def test_the_report_is_a_file_everywhere_and_a_link_where_it_is_served(made):
    """With a text the link would be seen in `dagster dev`, too, which does not serve it."""
    link, _, path = metadata(made[1], "nuscenes_dataset")["report"].value.rpartition(" ")
    assert link == '[](/bagassets/pages/report "Open the report")'
    assert Path(path.replace("\\", "")) == made[0].parent / ".bagassets" / "report.html"


def test_owners_tags_and_groups_that_a_user_adds_stay(made):
    def mine(spec):
        return spec.replace_attributes(
            owners=["team:perception"], tags={**spec.tags, "tier": "gold"}, group_name="drives"
        )

    graph = build_definitions(made[0]).map_asset_specs(func=mine).get_repository_def().asset_graph
    for asset in ("bag", "frames", "annotations", "nuscenes_tables", "dataset_inputs", "nuscenes_dataset"):
        node = graph.get(dg.AssetKey(asset))
        assert (node.owners, node.group_name, node.tags["tier"]) == (["team:perception"], "drives", "gold")
