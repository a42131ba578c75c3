"""The user's own assets downstream of ours: which a build makes, when, and what it says about the others."""

import json
import os
import sys
from contextlib import suppress
from itertools import count

import dagster as dg
import pytest
import yaml

from bagassets.base.errors import RecipeError, SelectionError
from bagassets.cli.main import main
from bagassets.defs.graph import own_location
from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.execution import create_run
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets_tests.in_process import build, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

MODULE = """
from pathlib import Path
import dagster as dg
from bagassets.defs import Workspace, build_definitions, channels, follow_recordings, per_recording, recipe_beside

RECIPE = recipe_beside(__file__)
HERE = Path(__file__).parent
BY_ITSELF = dg.AutomationCondition.eager()

@dg.asset(partitions_def=per_recording(RECIPE), deps=["frames"], automation_condition=BY_ITSELF, code_version="1")
def blur(context, workspace: Workspace):
    if (HERE / "dirty").exists() and context.partition_key == "a.bag":
        raise ValueError("the lens is dirty")
    found = channels(context, workspace, "frames")
    return dg.MaterializeResult(data_version=dg.DataVersion(found["CAM_FRONT"].digest[:8]))

@dg.asset(partitions_def=per_recording(RECIPE), deps=["blur"], automation_condition=BY_ITSELF)
def sharp(): ...

@dg.asset(partitions_def=per_recording(RECIPE), deps=["sharp"])
def train(): ...

@dg.asset(deps=[dg.AssetDep("sharp", partition_mapping=dg.AllPartitionMapping())])
def table(): ...

@dg.asset(deps=["nuscenes_dataset"], automation_condition=BY_ITSELF)
def upload(): ...

@dg.asset(partitions_def=dg.StaticPartitionsDefinition(["x"]), deps=["upload"], automation_condition=BY_ITSELF)
def folds(): ...

@dg.asset(automation_condition=BY_ITSELF)
def stranger(): ...

defs = dg.Definitions.merge(
    build_definitions(RECIPE_FILE := HERE / "recipe.yaml"),
    dg.Definitions(
        assets=[blur, sharp, train, table, upload, folds, stranger],
        sensors=[follow_recordings("table", upstream=dg.AssetKey("sharp"))],
    ),
)
"""
# Modules stay imported, so each project has one of its own.
_numbers = count()


class Project:
    """A project with assets of the user's, built in this process."""

    def __init__(self, folder, monkeypatch):
        self.monkeypatch, self.folder = monkeypatch, folder
        self.recipe = make_project(folder, ("a.bag",))
        self.add("b.bag", 1.3)
        self.name = f"own_assets_{next(_numbers)}"
        self.module = folder / f"{self.name}.py"
        self.write(MODULE)
        location = {
            "module_name": self.name,
            "working_directory": ".",
            "location_name": "bagassets.definitions",
        }
        self.workspace = folder / "workspace.yaml"
        self.workspace.write_text(yaml.safe_dump({"load_from": [{"python_module": location}]}))

    def add(self, name, duration_s):
        (self.folder / "bags" / name).unlink(missing_ok=True)
        write_drive(self.folder / "bags" / name, "ros1", duration_s=duration_s)

    def write(self, text):
        self.module.write_text(text)
        sys.modules.pop(self.name, None)

    def edit(self, before, after):
        text = self.module.read_text()
        assert before in text
        self.write(text.replace(before, after))

    def build(self, **options):
        """Build; return the report, and the runs of the user's assets as (assets, partition key or "")."""
        self.report, runs = build(self.recipe, self.monkeypatch, **options)
        ours = {"bag", "frames", "nuscenes_dataset", "trajectory_map"}
        return [(",".join(sorted(names)), key or "") for key, names in runs if not ours & set(names)]

    @property
    def results(self):
        return {name: dict(one.results) for name, one in self.report.own.items()}

    def reasons(self, name):
        return {key: tuple(one) for key, one in self.report.own[name].reasons.items()}


@pytest.fixture
def project(tmp_path, monkeypatch):
    yield Project(tmp_path, monkeypatch)
    sys.modules.pop("bagassets.definitions", None)


FIRST = [
    ("blur", "a.bag"), ("blur", "b.bag"), ("upload", ""), ("sharp", "a.bag"), ("sharp", "b.bag"), ("table", ""),
]  # fmt: skip


def test_what_would_run_by_itself_is_made_in_the_order_of_the_graph_and_once(project):
    runs = project.build()
    assert sorted(runs[:3]) == sorted(FIRST[:3])
    assert runs[3:] == FIRST[3:]
    assert project.report.succeeded
    assert project.results == {
        "blur": {"made": 2},
        "sharp": {"made": 2},
        "table": {"made": 1},
        "upload": {"made": 1},
    }
    assert project.report.own_left_out == {
        "folds": "its partitions are not the recordings",
        "train": "only with --select",
    }
    assert (
        nothing_to_do(["build", "--recipe", str(project.recipe)])[-1]
        == "blur, upload, sharp, table: up to date"
    )
    assert project.build() == []
    assert project.results == {
        "blur": {"fresh": 2},
        "sharp": {"fresh": 2},
        "table": {"fresh": 1},
        "upload": {"fresh": 1},
    }


@pytest.mark.long
def test_only_what_reads_something_new_is_made_again(project):
    project.build()
    project.add("b.bag", 1.6)
    assert sorted(project.build()) == [("blur", "b.bag"), ("sharp", "b.bag"), ("table", ""), ("upload", "")]
    # Made again with the same version: nothing downstream changes.
    project.edit('code_version="1"', 'code_version="2"')
    assert sorted(project.build()) == [("blur", "a.bag"), ("blur", "b.bag")]
    (project.folder / "bags" / "b.bag").unlink()
    assert project.build() == [("table,upload", "")]
    assert project.build() == []


@pytest.mark.long
def test_what_failed_is_not_repeated_until_it_is_asked_for_or_the_code_changed(project):
    dirty = project.folder / "dirty"
    dirty.touch()
    runs = project.build()
    assert ("sharp", "b.bag") in runs
    assert ("sharp", "a.bag") not in runs
    assert runs[-1] == ("table", "")
    assert project.results["blur"] == {"failed": 1, "made": 1}
    assert project.reasons("blur")["a.bag"] == ("failed", "the lens is dirty")
    assert project.reasons("sharp") == {"a.bag": ("not made", "blur failed")}
    assert not project.report.succeeded
    assert nothing_to_do(["build", "--recipe", str(project.recipe)]) is None
    assert project.build() == []
    assert project.reasons("blur")["a.bag"][1].endswith("(failed before; --retry-failed tries again)")
    assert project.build(retry_failed=True) == [("blur", "a.bag")]
    assert project.build() == []
    dirty.unlink()
    project.edit("the lens is dirty", "dust")
    assert project.build() == [("blur", "a.bag"), ("sharp", "a.bag"), ("table", "")]
    assert project.report.succeeded


def test_a_recording_that_fails_holds_up_only_what_reads_it(project):
    (project.folder / "bags" / "c.bag").write_bytes((project.folder / "bags" / "a.bag").read_bytes()[:20_000])
    assert sorted(project.build()) == sorted(FIRST)
    assert project.reasons("blur") == {"c.bag": ("not made", "frames is not there, as its recording failed")}
    assert project.reasons("sharp") == {"c.bag": ("not made", "frames is not there, as its recording failed")}
    assert project.build() == []


def test_a_skipped_recording_is_skipped_here_too(project):
    project.recipe.write_text(
        project.recipe.read_text().replace("settle_s: 0", "settle_s: 0, min_duration_s: 1.2")
    )
    assert sorted(project.build()) == [("blur", "b.bag"), ("sharp", "b.bag"), ("table", ""), ("upload", "")]
    assert project.results["blur"] == {"skipped": 1, "made": 1}
    assert project.report.succeeded


@pytest.mark.long
def test_selected_assets_are_made_with_what_they_read_and_others_are_not(project):
    assert project.build(select=("frames",)) == []
    assert project.report.own == {}
    assert sorted(project.build(select=("train",), bags=("a.bag",))) == [
        ("blur", "a.bag"), ("sharp", "a.bag"), ("train", "a.bag"),
    ]  # fmt: skip
    assert project.report.own_left_out == {}
    assert sorted(project.build()) == [("blur", "b.bag"), ("sharp", "b.bag"), ("table", ""), ("upload", "")]
    with pytest.raises(SelectionError, match="folds: its partitions are not the recordings"):
        project.build(select=("folds",))
    with pytest.raises(SelectionError, match=r"trian: no such asset; did you mean train\?"):
        project.build(select=("trian",))
    with pytest.raises(SelectionError, match="stranger: no such asset"):
        project.build(select=("stranger",))


@pytest.mark.long
def test_what_was_made_by_hand_counts_unless_nobody_knows_what_it_read(project):
    project.build()
    definitions = sys.modules[project.name].defs
    with open_instance(str(project.folder)) as instance:
        job = definitions.resolve_implicit_global_asset_job_def()
        for name, key in (("blur", "a.bag"), ("upload", None), ("table", None)):
            selection = [dg.AssetKey(name)]
            assert job.execute_in_process(
                partition_key=key, instance=instance, asset_selection=selection
            ).success
    assert project.build() == [("table", "")]
    assert project.build() == []


@pytest.mark.long
def test_the_sensor_that_follows_recordings_and_the_build_know_of_each_other(project):
    project.build()

    def tick(cursor=None):
        definitions = sys.modules[project.name].defs
        sensor = definitions.resolve_sensor_def("table_follows_recordings")
        with open_instance(str(project.folder)) as instance:
            context = dg.build_sensor_context(
                instance=instance,
                cursor=cursor,
                repository_def=definitions.get_repository_def(),
                resources={"workspace": definitions.resources["workspace"]},
            )
            found = sensor(context)
            for request in found.run_requests or ():
                job = definitions.resolve_implicit_global_asset_job_def()
                assert job.execute_in_process(
                    instance=instance, asset_selection=request.asset_selection, tags=dict(request.tags)
                ).success
            return len(found.run_requests or ()), found.cursor

    requested, cursor = tick()
    assert requested == 0, "the build has made it"
    project.add("a.bag", 1.8)
    assert ("table", "") in project.build()
    assert tick(cursor)[0] == 0
    (project.folder / "bags" / "b.bag").unlink()
    project.build(select=("frames",))
    assert tick(cursor)[0] == 1
    assert ("table", "") not in project.build(), "the sensor has made it"


def test_a_module_that_cannot_be_imported_holds_up_nothing_of_ours(project):
    project.write(MODULE + "\n1 / 0\n")
    assert project.build() == []
    assert project.report.counts()["built"] == 2
    sentence = f"{project.workspace}: {project.name} cannot be loaded (ZeroDivisionError: division by zero), so nothing"
    assert project.report.own_problem.startswith(sentence)
    assert not project.report.succeeded
    assert nothing_to_do(["build", "--recipe", str(project.recipe)]) is None
    with pytest.raises(RecipeError, match="division by zero"):
        project.build(select=("blur",))
    assert project.build(select=("frames",)) == []
    project.write(MODULE)
    assert len(project.build()) == len(FIRST)


def test_a_workspace_that_is_no_yaml_is_said_to_be_none(project):
    project.workspace.write_text("load_from: [")
    project.build()
    assert project.report.own_problem.startswith(
        f"{project.workspace}: this cannot be read as a workspace of Dagster ("
    )


@pytest.mark.long
def test_what_nobody_makes_is_compared_as_it_was_observed(project):
    project.write("""
import dagster as dg
from bagassets.defs import per_recording, recipe_beside

BY_ITSELF = dg.AutomationCondition.eager()
weather = dg.AssetSpec("weather")
price = dg.AssetSpec("price")

@dg.asset(
    partitions_def=per_recording(recipe_beside(__file__)), deps=["frames", weather, price], automation_condition=BY_ITSELF
)
def label(): ...

@dg.asset(deps=[dg.AssetDep("label", partition_mapping=dg.AllPartitionMapping()), weather], automation_condition=BY_ITSELF)
def labels(): ...

defs = dg.Definitions(assets=[weather, price, label, labels])
""")

    def observe(version):
        with open_instance(str(project.folder)) as instance:
            tags = {"dagster/data_version": version}
            instance.report_runless_asset_event(dg.AssetObservation("weather", tags=tags))

    everything = [("label", "a.bag"), ("label", "b.bag"), ("labels", "")]
    assert project.build() == everything
    assert project.build() == []
    observe("rain")
    assert project.build() == everything
    assert project.build() == []
    observe("rain")
    assert project.build() == []
    observe("sun")
    assert project.build() == everything


def test_code_locations_may_read_each_others_assets(project):
    """The first is named first, and reads what the second makes."""
    other = project.folder / f"{project.name}_other.py"
    project.write("""
import dagster as dg

@dg.asset(deps=["first"], automation_condition=dg.AutomationCondition.eager())
def second(): ...

defs = dg.Definitions(assets=[second])
""")
    other.write_text("""
import dagster as dg

@dg.asset(deps=["nuscenes_dataset"], automation_condition=dg.AutomationCondition.eager())
def first(): ...

defs = dg.Definitions(assets=[first])
""")
    locations = yaml.safe_load(project.workspace.read_text())
    locations["load_from"].append({"python_module": {"module_name": other.stem, "working_directory": "."}})
    project.workspace.write_text(yaml.safe_dump(locations))
    assert project.build() == [("first", ""), ("second", "")]
    assert project.build() == []
    sys.modules.pop(other.stem)


def test_an_asset_that_needs_configuration_says_so_and_holds_up_no_other(project):
    project.edit("def upload(): ...", "def upload(config: Settings): ...")
    project.edit("RECIPE = ", "class Settings(dg.Config):\n    bucket: str\n\nRECIPE = ")
    assert ("table", "") in project.build()
    result, reason = project.reasons("upload")[""]
    assert (result, not project.report.succeeded) == ("failed", True)
    assert reason.startswith(
        f"{project.name}: upload cannot be made without configuration (Missing required config entry"
    )
    assert len(reason.splitlines()) == 1


@pytest.mark.long
def test_what_another_run_is_about_to_make_is_left_to_it(project):
    project.build(select=("frames",))
    with open_instance(str(project.folder)) as instance:
        run_id = create_run(
            instance,
            ["blur"],
            partition_key="a.bag",
            location=next(iter(own_location.load_locations(project.folder))),
        )
    assert sorted(project.build()) == [("blur", "b.bag"), ("sharp", "b.bag"), ("upload", "")]
    assert project.reasons("blur") == {"a.bag": ("not made", "another run is about to make it")}
    assert project.reasons("table") == {"": ("not made", "sharp comes first")}
    with open_instance(str(project.folder)) as instance:
        instance.delete_run(run_id)
    assert project.build() == [("blur", "a.bag"), ("sharp", "a.bag"), ("table", "")]


@pytest.mark.long
def test_a_module_finds_the_variables_of_the_project(project, monkeypatch):
    monkeypatch.setenv("BUCKET", "")  # runs in this process set it; it is removed again
    monkeypatch.delenv("BUCKET")
    env = project.folder / ".env"
    env.write_text(env.read_text() + "BUCKET=of-the-lab\n")
    project.edit("HERE = ", "import os\nBUCKET = os.environ['BUCKET']\nHERE = ")
    own_location.load_locations(project.folder)
    assert sys.modules[project.name].BUCKET == "of-the-lab"
    assert "BUCKET" not in os.environ
    assert len(project.build()) == len(FIRST)
    ask = ["build", "--recipe", str(project.recipe)]
    assert nothing_to_do(ask)
    env.write_text(env.read_text() + "BUCKET=of-the-team\n")
    assert nothing_to_do(ask) is None


def test_the_fast_path_sees_changes_of_the_users_modules_and_of_the_workspace(project):
    ask = ["build", "--recipe", str(project.recipe)]
    helper = project.folder / f"{project.name}_helper.py"
    helper.write_text("VERSION = '1'\n")
    project.edit("import dagster as dg", f"import {helper.stem}\nimport dagster as dg")
    project.build()
    assert nothing_to_do(ask)
    helper.write_text("VERSION = '2'\n")
    assert nothing_to_do(ask) is None
    assert project.build() == []
    assert nothing_to_do(ask)
    shown = project.workspace.read_text()
    project.workspace.write_text("load_from: [{python_module: bagassets.definitions}]")
    assert nothing_to_do(ask) is None
    assert project.build() == []
    assert project.report.own == {}
    assert nothing_to_do(ask)
    project.workspace.write_text(shown)
    assert nothing_to_do(ask) is None
    sys.modules.pop(helper.stem)


@pytest.mark.parametrize("how", ["python_file", "python_package", "no_attribute"])
def test_the_ways_in_which_a_workspace_names_a_location(project, how):
    name = project.name
    spelled = {
        "python_file": {"python_file": {"relative_path": f"{name}.py"}},
        "python_package": {"python_package": {"package_name": name, "working_directory": "."}},
        "no_attribute": {
            "python_module": {"module_name": name, "attribute": "defs", "working_directory": "."}
        },
    }
    others = [{"grpc_server": {"host": "localhost", "port": 4266, "location_name": "far"}}]
    project.workspace.write_text(yaml.safe_dump({"load_from": [spelled[how], *others]}))
    ((location, repository),) = own_location.load_locations(project.folder).items()
    assert (location.module, location.attribute) == (name, "defs")
    assert dg.AssetKey("blur") in repository.asset_graph.get_all_asset_keys()


def test_status_dry_run_and_explain_tell_of_them(project, capsys):
    arguments = ["--recipe", str(project.recipe)]

    def printed(*command):
        try:
            status = main([*command, *arguments])
        except SystemExit as err:
            status = err.code
        return status or 0, capsys.readouterr().out

    status, out = printed("build", "--dry-run")
    assert status == 0
    assert "blur\n  may run  a.bag: frames comes first\n  may run  b.bag: frames comes first\n" in out
    assert "upload\n  may run  nuscenes_dataset comes first\n" in out
    assert "to do: build 2 recordings, update nuscenes_dataset, make blur, upload, sharp, table." in out
    project.build()
    assert printed("build", "--check") == (0, "nothing to do: 2 recordings up to date.\n")
    recipe = project.recipe.read_text()
    project.recipe.write_text(recipe.replace("preview: {enabled: false}", ""))
    out = printed("build", "--dry-run")[1]
    assert "nuscenes_dataset\n  up to date\ntrajectory_map\n  run      never made\n" in out
    assert "upload\n  up to date\n" in out, "it reads the dataset, which needs no pictures, and not the map"
    project.recipe.write_text(recipe)
    project.edit('code_version="1"', 'code_version="2"')
    assert printed("build", "--check") == (3, "to do: make blur, sharp, table.\n")
    status, out = printed("status")
    assert status == 3
    assert "blur: 2 stale\nupload: fresh\nsharp: 2 unknown\ntable unknown: sharp comes first\n" in out
    assert "a.bag: blur stale: its code version is 2, was 1\n" in out
    assert "train: not made by a build (only with --select)\n" in out
    told = json.loads(printed("status", "--json")[1])
    assert not told["settled"]
    upload = told["own"]["assets"]["upload"][""]
    assert (upload["state"], upload["reason"]) == ("fresh", "what it reads is as it was when it was made")
    assert upload["data_version"]
    told = json.loads(printed("build", "--dry-run", "--json")[1])
    assert (told["settled"], told["own"]["assets"]["blur"]["a.bag"]["state"]) == (False, "stale")
    status, out = printed("explain", "a.bag", "blur")
    assert status == 0
    assert out.startswith("blur of a.bag is stale: its code version is 2, was 1\n    reads frames: ")
    assert printed("explain", "a.bag", "table")[1].startswith("table is unknown: sharp comes first\n")


def test_a_recording_that_is_gone_leaves_nothing_up_to_date_that_was_made_from_all(project, capsys):
    project.build()
    (project.folder / "bags" / "b.bag").unlink()
    for command in (["build", "--dry-run"], ["status"]):
        with suppress(SystemExit):
            main([*command, "--recipe", str(project.recipe)])
    dry_run, status = capsys.readouterr().out.split("to do: ")
    assert "table\n  run      a recording was added, changed or removed\n" in dry_run
    assert status.startswith("remove 1 recording, update nuscenes_dataset, make upload, table.\n")
    assert "table stale: a recording was added, changed or removed\n" in status
    assert project.build() == [("table,upload", "")]
    assert project.build() == []


def test_what_is_printed_at_the_end(project, capsys):
    (project.folder / "dirty").touch()
    project.build()
    from bagassets.cli.summary import print_summary, summary_console

    print_summary(project.report, [], project.recipe, summary_console())
    out = capsys.readouterr().out
    assert "blur: 1 failed, 1 made\nfailed blur of a.bag: the lens is dirty\n" in out
    assert "table: made\n" in out
    assert "folds: not made (its partitions are not the recordings)\n" in out
