"""Steps of one's own beside ours: the worked example, and the helpers it stands on."""

import csv
import importlib
import re
import shutil
import sys
from pathlib import Path

import dagster as dg
import pytest
import yaml
from dagster._core.definitions.data_version import CachingStaleStatusResolver, StaleStatus
from dagster._core.loader import LoadingContextForTest
from dagster._core.workspace.load import location_origins_from_yaml_paths

from bagassets import defs
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions, remove_partitions
from bagassets.propose.project import dagster_files, write_project
from bagassets.recipe import load_recipe
from bagassets_tests.small_drive import write_drive

EXAMPLE = Path(__file__).parents[3] / "examples" / "step_plugin"
OURS = ["bag", "inventory", "calibration", "ego_poses", "frames"]


class Project:
    """A copy of the example with recordings, its definitions and an instance."""

    def __init__(self, folder, instance, monkeypatch):
        shutil.copytree(EXAMPLE, folder)
        self.folder, self.instance = folder, instance
        self.recordings = folder / "recordings"
        monkeypatch.chdir(folder)
        monkeypatch.syspath_prepend(folder)
        self.reload()

    def reload(self):
        sys.modules.pop("definitions", None)
        importlib.invalidate_caches()
        self.definitions = importlib.import_module("definitions").defs
        self.recipe = load_recipe(self.folder / "recipe.yaml")

    def add(self, key, duration_s=1.0):
        write_drive(self.recordings / key, "ros1", duration_s=duration_s)
        add_partitions(Records(self.instance, Naming(self.recipe.name)), [key])

    def run(self, assets, key=None, ok=True):
        result = self.definitions.resolve_implicit_global_asset_job_def().execute_in_process(
            partition_key=key,
            instance=self.instance,
            asset_selection=[dg.AssetKey(name) for name in assets],
            raise_on_error=False,
        )
        assert result.success is ok
        return result

    def status(self, asset, key=None):
        resolver = CachingStaleStatusResolver(
            self.instance, self.definitions.resolve_asset_graph(), LoadingContextForTest(self.instance)
        )
        return resolver.get_status(dg.AssetKey(asset), key)

    def version(self, asset, key=None):
        records = self.instance.fetch_materializations(
            dg.AssetRecordsFilter(
                asset_key=dg.AssetKey(asset), asset_partitions=None if key is None else [key]
            ),
            limit=1,
        ).records
        return records[0].asset_materialization.tags["dagster/data_version"]


@pytest.fixture
def project(tmp_path, monkeypatch):
    with dg.DagsterInstance.ephemeral() as instance:
        yield Project(tmp_path / "project", instance, monkeypatch)
    sys.modules.pop("definitions", None)


def metadata(result, asset):
    (event,) = [
        e for e in result.all_events if e.is_step_materialization and e.asset_key == dg.AssetKey(asset)
    ]
    return {name: value.value for name, value in event.event_specific_data.materialization.metadata.items()}


def failure(result):
    (event,) = [e for e in result.all_events if e.is_step_failure]
    return event.event_specific_data.user_failure_data.description


# --- the worked example ------------------------------------------------------------------


def test_the_workspace_of_the_example_loads_it_under_the_name_that_projects_use(project):
    (origin,) = location_origins_from_yaml_paths([str(project.folder / "workspace.yaml")])
    assert origin.location_name == "bagassets.definitions"
    target = origin.loadable_target_origin
    assert (target.module_name, target.working_directory) == ("definitions", ".")
    # `.env` and the launcher of a project refer to its location by that name.
    files = dagster_files(project.folder, project.recipe.state)
    named = yaml.safe_load(files["dagster.yaml"])["secrets"]["custom"]["config"]["location_paths"]
    assert list(named) == [origin.location_name]
    (ours,) = yaml.safe_load(files["workspace.yaml"])["load_from"]
    assert ours == {"python_module": origin.location_name}


def test_a_project_that_is_written_again_keeps_its_workspace(project):
    shown = (project.folder / "workspace.yaml").read_text()
    write_project(project.folder, None, project.recipe.state)
    assert (project.folder / "workspace.yaml").read_text() == shown
    assert (project.folder / "dagster.yaml").is_file()
    (project.folder / "workspace.yaml").unlink()
    write_project(project.folder, None, project.recipe.state)
    assert "python_module: bagassets.definitions" in (project.folder / "workspace.yaml").read_text()


def test_the_example_is_downstream_of_ours_in_one_graph(project):
    graph = project.definitions.resolve_asset_graph()
    quality = graph.get(dg.AssetKey("image_quality"))
    assert quality.parent_keys == {dg.AssetKey("frames")}
    assert quality.partitions_def == graph.get(dg.AssetKey("frames")).partitions_def
    assert graph.get(dg.AssetKey("quality_report")).parent_keys == {dg.AssetKey("image_quality")}
    assert dg.AssetKey("nuscenes_dataset") in graph.get_all_asset_keys()
    assert project.definitions.resolve_sensor_def("recordings")


def test_the_example_materializes_per_recording_and_over_the_dataset(project):
    project.add("a.bag")
    project.add("b.bag", duration_s=1.5)
    for key in ("a.bag", "b.bag"):
        output = metadata(project.run([*OURS, "image_quality"], key), "image_quality")
        assert output["images"] == {"a.bag": 9, "b.bag": 14}[key]
        assert output["sharpness_CAM_FRONT"] > 0
        assert output["cached"] is False
    output = metadata(project.run(["quality_report"]), "quality_report")
    assert (output["recordings"], output["cameras"]) == (2, 2)
    with (Path(output["artifact"]) / "files" / "report.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["recording"], row["camera"], row["images"]) for row in rows] == [
        ("a.bag", "CAM_FRONT", "9"),
        ("b.bag", "CAM_FRONT", "14"),
    ]


def test_staleness_follows_our_data_versions_and_unchanged_inputs_are_hits(project):
    project.add("a.bag")
    project.add("b.bag")
    for key in ("a.bag", "b.bag"):
        project.run([*OURS, "image_quality"], key)
    project.run(["quality_report"])
    assert {project.status("image_quality", key) for key in ("a.bag", "b.bag")} == {StaleStatus.FRESH}
    assert project.status("quality_report") == StaleStatus.FRESH

    # The same again: nothing runs, and the data version stays.
    before = project.version("image_quality", "a.bag")
    assert metadata(project.run(["image_quality"], "a.bag"), "image_quality")["cached"] is True
    assert project.version("image_quality", "a.bag") == before

    # Other images of one recording: its partition alone is stale.
    recipe = project.folder / "recipe.yaml"
    recipe.write_text(
        recipe.read_text().replace("topic: /cam/image_raw", "topic: /cam/image_raw, quality: 20")
    )
    project.reload()
    project.run(OURS, "a.bag")
    assert project.status("image_quality", "a.bag") == StaleStatus.STALE
    assert project.status("image_quality", "b.bag") == StaleStatus.FRESH
    assert metadata(project.run(["image_quality"], "a.bag"), "image_quality")["cached"] is False
    assert project.status("image_quality", "a.bag") == StaleStatus.FRESH
    assert project.status("quality_report") == StaleStatus.STALE
    report = project.version("quality_report")
    project.run(["quality_report"])
    assert project.status("quality_report") == StaleStatus.FRESH
    assert project.version("quality_report") != report


@pytest.mark.once
@pytest.mark.filterwarnings("ignore::dagster.BetaWarning")
def test_automation_asks_for_the_recordings_whose_images_are_new(project):
    def asked(cursor):
        result = dg.evaluate_automation_conditions(project.definitions, project.instance, cursor=cursor)
        return result.cursor, result.get_requested_partitions(dg.AssetKey("image_quality"))

    for key in ("a.bag", "b.bag", "skipped.bag"):
        project.add(key)
    cursor, requested = asked(None)
    assert requested == set()
    project.run(OURS, "a.bag")
    cursor, requested = asked(cursor)
    assert requested == {"a.bag"}
    project.run(["image_quality"], "a.bag")
    project.run(OURS, "b.bag")
    _, requested = asked(cursor)
    assert requested == {"b.bag"}


@pytest.mark.once
def test_the_report_follows_recordings_that_change_come_and_go(project):
    sensor = project.definitions.resolve_sensor_def("quality_report_follows_recordings")
    assert sensor.default_status == dg.DefaultSensorStatus.RUNNING

    def tick(cursor):
        context = dg.build_sensor_context(
            instance=project.instance,
            cursor=cursor,
            definitions=project.definitions,
            resources={"workspace": defs.Workspace(recipe_file=str(project.folder / "recipe.yaml"))},
        )
        result = sensor(context)
        asked = [request.asset_selection for request in result.run_requests or []]
        assert asked in ([], [[dg.AssetKey("quality_report")]])
        return result.cursor or cursor, len(asked)

    cursor, asked = tick(None)
    project.add("a.bag")
    project.add("b.bag")
    assert tick(cursor) == (cursor, 0)  # registered, not materialized
    project.run([*OURS, "image_quality"], "a.bag")
    cursor, asked = tick(cursor)
    assert asked == 1
    # While the report runs, another recording lands: the next look asks again.
    project.run([*OURS, "image_quality"], "b.bag")
    project.run(["quality_report"])
    cursor, asked = tick(cursor)
    assert asked == 1
    assert tick(cursor) == (cursor, 0)
    remove_partitions(Records(project.instance, Naming(project.recipe.name)), ["b.bag"])
    cursor, asked = tick(cursor)
    assert asked == 1
    active = project.instance.create_run_for_job(
        project.definitions.resolve_implicit_global_asset_job_def(),
        asset_selection=frozenset({dg.AssetKey("quality_report")}),
    )
    add_partitions(Records(project.instance, Naming(project.recipe.name)), ["b.bag"])
    assert tick(cursor) == (cursor, 0)  # it runs already
    project.instance.report_run_canceled(active)
    assert tick(cursor)[1] == 1


@pytest.mark.once
def test_a_recording_that_was_removed_leaves_the_report(project):
    project.add("a.bag")
    project.add("b.bag")
    for key in ("a.bag", "b.bag"):
        project.run([*OURS, "image_quality"], key)
    assert metadata(project.run(["quality_report"]), "quality_report")["recordings"] == 2
    remove_partitions(Records(project.instance, Naming(project.recipe.name)), ["b.bag"])
    assert metadata(project.run(["quality_report"]), "quality_report")["recordings"] == 1


def test_without_our_asset_the_step_says_what_to_materialize(project):
    project.add("a.bag")
    result = project.run(["image_quality"], "a.bag", ok=False)
    assert failure(result) == "a.bag: frames is not materialized for this recording; materialize it first."


# --- the helpers -------------------------------------------------------------------------


def own_asset(project, make, **options):
    """Definitions with an unpartitioned asset that publishes."""

    @dg.asset(**options)
    def own(context: dg.AssetExecutionContext, workspace: defs.Workspace):
        return defs.publish(context, workspace, make, {}, params={"limit": project.limit})

    resources = {"workspace": defs.Workspace(recipe_file=str(project.folder / "recipe.yaml"))}
    project.definitions = dg.Definitions(assets=[own], resources=resources, executor=dg.in_process_executor)


def test_what_is_published_is_keyed_by_parameters_and_code_version(project):
    runs = []

    def make(out):
        runs.append(project.limit)
        out.write_json("limit.json", project.limit)
        return {"limit": project.limit}

    project.limit = 1
    own_asset(project, make, code_version="1")
    one = project.run(["own"])
    project.run(["own"])
    assert runs == [1]
    project.limit = 2
    two = metadata(project.run(["own"]), "own")
    assert (runs, two["limit"]) == ([1, 2], 2)
    project.limit = 1
    assert metadata(project.run(["own"]), "own")["action_digest"] == metadata(one, "own")["action_digest"]
    own_asset(project, make, code_version="2")
    project.run(["own"])
    assert runs == [1, 2, 1]


def test_an_asset_without_code_version_is_refused(project):
    project.limit = 1
    own_asset(project, lambda _out: {})
    assert "own: give this asset a code_version" in failure(project.run(["own"], ok=False))


def test_errors_of_a_step_are_reported_in_sentences_and_leave_nothing_behind(project):
    from bagassets.base.errors import DecodeError

    def make(out):
        out.write("half.txt", b"half")
        raise DecodeError("own: the third image is broken; leave it out.")

    project.limit = 1
    own_asset(project, make, code_version="1")
    assert failure(project.run(["own"], ok=False)) == "own: the third image is broken; leave it out."
    assert not list(project.recipe.store_path.rglob("half.txt"))


def test_the_names_are_there_and_no_others():
    assert set(defs.__all__) == defs._MODULES.keys()
    for name in defs.__all__:
        assert getattr(defs, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        defs.nothing_of_this_name  # noqa: B018


def test_the_page_about_steps_lists_the_names_and_shows_the_workspace_of_the_example():
    page = (Path(__file__).parents[3] / "docs" / "steps.md").read_text()
    table = page.split("## What `bagassets.defs` offers")[1].split("\n\n")[1]
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    assert sorted(line.split("`")[1].partition("(")[0] for line in rows) == sorted(defs.__all__)
    shown = re.findall(r"```yaml\n(.*?)```", page, flags=re.DOTALL)
    assert [yaml.safe_load(text) for text in shown] == [
        yaml.safe_load((EXAMPLE / "workspace.yaml").read_text())
    ]
    example = (EXAMPLE / "definitions.py").read_text()
    assert all(text in example for text in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL))
