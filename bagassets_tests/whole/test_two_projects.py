"""Two projects in one code location, beside assets of the user's own, as in a Dagster that was there before."""

import json
from pathlib import Path

import dagster as dg
import pytest
from dagster._core.definitions.data_version import CachingStaleStatusResolver, StaleStatus
from dagster._core.launcher import LaunchRunContext
from dagster._core.loader import LoadingContextForTest
from dagster._core.origin import JobPythonOrigin

from bagassets.base.errors import RecipeError, StoreError
from bagassets.defs import Workspace, build_definitions, follow_recordings, per_recording
from bagassets.defs.builds.garbage import find_roots
from bagassets.defs.launchers.slurm.launcher import SlurmRunLauncher
from bagassets.defs.launchers.slurm.spool import Spool
from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import active_runs, add_partitions, remove_partitions
from bagassets.defs.records.projects import note_project, recipes_of
from bagassets.defs.runs.execution import CodeLocation
from bagassets.defs.runs.run_pool import RunPool
from bagassets.defs.runs.worker_tag import RunWorker
from bagassets.forkserver.client import Client
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests.in_process import QUICK, load_definitions
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

KEY = "a.bag"
NORTH, SOUTH = Naming("drives", ("north",)), Naming("drives", ("south",))


@dg.asset
def frames() -> int:
    """An asset that has the name of one of ours."""
    return 1


class Place:
    """Recordings of the same name in two projects with recipes of the same name, and one code location for both."""

    def __init__(self, folder: Path, instance: dg.DagsterInstance) -> None:
        self.instance = instance
        self.recipes = {}
        for number, name in enumerate(("north", "south")):
            write_drive(folder / name / "bags" / KEY, "ros1", duration_s=1.0 + number)
            self.recipes[name] = folder / name / "recipe.yaml"
            self.recipes[name].write_text(QUICK.format(name="drives", root="bags"))
        recipe = load_recipe(self.recipes["north"])

        @dg.asset(partitions_def=per_recording(recipe, key_prefix="north"), deps=[NORTH.key("frames")])
        def pictures(context: dg.AssetExecutionContext, north__workspace: Workspace) -> int:
            return len(north__workspace.artifact(context, "frames").read_json("channels.json"))

        @dg.asset(deps=[pictures])
        def summary() -> None: ...

        self.definitions = dg.Definitions.merge(
            *(build_definitions(recipe, key_prefix=name) for name, recipe in self.recipes.items()),
            dg.Definitions(
                assets=[frames, pictures, summary],
                sensors=[
                    follow_recordings(
                        "summary", upstream=dg.AssetKey("pictures"), resource_key="north__workspace"
                    )
                ],
            ),
        )

    def run(self, keys, partition=None, job=None, config=None):
        found = job or self.definitions.resolve_implicit_global_asset_job_def()
        result = found.execute_in_process(
            partition_key=partition,
            instance=self.instance,
            asset_selection=list(keys) if keys is not None else None,
            run_config=config,
        )
        assert result.success

    def tick(self, naming, cursor=None):
        """Run a sensor, and what it requests, until it has nothing to request; return the requests."""
        requests = []
        for _ in range(6):
            context = dg.build_sensor_context(
                self.instance,
                cursor,
                resources={
                    naming.workspace: Workspace(
                        recipe_file=str(self.recipes[naming.prefix[0]]), key_prefix=list(naming.prefix)
                    )
                },
            )
            result = self.definitions.resolve_sensor_def(naming.sensor)(context)
            cursor = result.cursor
            if not result.run_requests:
                return requests
            requests += result.run_requests
            for request in result.run_requests:
                job = self.definitions.resolve_job_def(request.job_name)
                self.run(request.asset_selection, request.partition_key, job, request.run_config)
        raise AssertionError("the sensor never came to rest")

    def statuses(self, naming):
        resolver = CachingStaleStatusResolver(
            self.instance, self.definitions.resolve_asset_graph(), LoadingContextForTest(self.instance)
        )
        graph = self.definitions.resolve_asset_graph()
        return {
            naming.asset_of(key): resolver.get_status(key, KEY if graph.get(key).is_partitioned else None)
            for key in graph.get_all_asset_keys()
            if naming.asset_of(key) is not None
        }

    def materialized(self):
        return {key.to_user_string() for key in self.instance.event_log_storage.all_asset_keys()}


@pytest.fixture
def place(tmp_path):
    with dg.DagsterInstance.ephemeral() as instance:
        yield Place(tmp_path, instance)


def test_without_a_prefix_everything_is_called_as_in_the_projects_that_exist():
    plain = Naming("drives")
    assert plain.key("frames") == dg.AssetKey("frames")
    assert (plain.asset_of(dg.AssetKey("frames")), plain.asset_of(dg.AssetKey(["a", "frames"]))) == (
        "frames",
        None,
    )
    assert plain.input_tag("bag") == "dagster/input_data_version/bag"
    assert plain.input_of("dagster/input_data_version/bag") == "bag"
    assert plain.partitions == "drives_recordings"
    names = plain.assets_job, plain.batch_job, plain.batch_op, plain.sensor, plain.workspace, plain.lock
    assert names == (
        "recordings_and_datasets",
        "build_recordings",
        "build_each",
        "recordings",
        "workspace",
        "recording_lock",
    )
    assert (plain.recording_group, plain.dataset_group) == ("recording", "dataset")


def test_each_has_its_own_assets_partitions_jobs_sensors_checks_and_groups(place):
    repository = place.definitions.get_repository_def()
    repository.load_all_definitions()
    graph = repository.asset_graph
    for naming in (NORTH, SOUTH):
        node = graph.get(naming.key("frames"))
        assert node.partitions_def.name == naming.partitions
        assert node.group_name == naming.recording_group
        assert node.parent_keys == {naming.key("inventory"), naming.key("calibration")}
        assert graph.get(naming.key("nuscenes_dataset")).group_name == naming.dataset_group
        assert {naming.assets_job, naming.batch_job} <= set(repository.job_names)
        assert repository.has_sensor_def(naming.sensor)
        assert [key for key in graph.asset_check_keys if key.asset_key == naming.key("frames")]
        keys = repository.get_job(naming.assets_job).asset_layer.selected_asset_keys
        assert {naming.asset_of(key) for key in keys} >= {"bag", "frames", "nuscenes_dataset"}
        assert all(naming.asset_of(key) for key in keys)
    assert NORTH.partitions != SOUTH.partitions
    assert graph.get(dg.AssetKey("frames")).partitions_def is None


def test_one_is_built_by_its_sensor_and_the_other_stays_as_it_was(place):
    requests = place.tick(NORTH)
    assert {request.partition_key for request in requests} == {KEY, None}
    assert set(place.statuses(NORTH).values()) == {StaleStatus.FRESH}
    assert all(one.startswith("north/") for one in place.materialized())
    assert Records(place.instance, SOUTH).live() == frozenset()
    assert place.tick(NORTH) == []

    place.tick(SOUTH)
    assert set(place.statuses(SOUTH).values()) == {StaleStatus.FRESH}
    assert set(place.statuses(NORTH).values()) == {StaleStatus.FRESH}
    scenes = {
        naming.prefix: place.instance.get_latest_materialization_event(
            naming.key("bag")
        ).asset_materialization.tags["dagster/data_version"]
        for naming in (NORTH, SOUTH)
    }
    assert len(set(scenes.values())) == 2


def test_a_batch_records_below_the_prefix_as_runs_of_one_recording_do(place):
    for number, key in enumerate(("b.bag", "c.bag", "d.bag")):
        write_drive(place.recipes["north"].parent / "bags" / key, "ros1", duration_s=1.2 + number / 10)
    (batch, *_) = place.tick(NORTH)
    assert batch.job_name == "north__build_recordings"
    assert set(place.statuses(NORTH).values()) == {StaleStatus.FRESH}
    assert all(one.startswith("north/") for one in place.materialized())
    checks = place.instance.event_log_storage.get_asset_check_summary_records
    keys = place.definitions.resolve_asset_graph().asset_check_keys
    made = [key for key in keys if key.asset_key == NORTH.key("frames")]
    assert made
    assert all(one.last_check_execution_record is not None for one in checks(made).values())


def test_an_asset_of_the_users_own_reads_ours_by_name(place):
    place.tick(NORTH)
    place.run([dg.AssetKey("pictures")], KEY)
    place.run([dg.AssetKey("frames")])
    resources = {"north__workspace": Workspace(recipe_file=str(place.recipes["north"]), key_prefix=["north"])}
    context = dg.build_sensor_context(place.instance, resources=resources)
    (request,) = place.definitions.resolve_sensor_def("summary_follows_recordings")(context).run_requests
    assert request.asset_selection == [dg.AssetKey("summary")]


def test_a_removed_recording_cancels_runs_of_its_own_project_only(place, monkeypatch):
    cancelled, runs = [], {}
    monkeypatch.setattr(
        type(place.instance.run_launcher), "terminate", lambda _, run_id: cancelled.append(run_id)
    )
    for naming in (NORTH, SOUTH):
        add_partitions(Records(place.instance, naming), [KEY])
        runs[naming] = place.instance.create_run_for_job(
            place.definitions.resolve_implicit_global_asset_job_def(),
            asset_selection=frozenset([naming.key("frames")]),
            tags={"dagster/partition": KEY},
            status=dg.DagsterRunStatus.STARTED,
        )
    assert active_runs(Records(place.instance, NORTH), ()) == {runs[NORTH].run_id: (KEY,)}
    remove_partitions(Records(place.instance, NORTH), [KEY])
    assert cancelled == [runs[NORTH].run_id]
    assert (Records(place.instance, NORTH).live(), Records(place.instance, SOUTH).live()) == (
        frozenset(),
        frozenset([KEY]),
    )


def test_group_and_resource_are_called_as_asked_for(place):
    definitions = build_definitions(
        place.recipes["north"], key_prefix=["lab", "north"], group_name="drives", resource_key="robots"
    )
    graph = definitions.resolve_asset_graph()
    assert {graph.get(key).group_name for key in graph.get_all_asset_keys()} == {"drives"}
    assert dg.AssetKey(["lab", "north", "frames"]) in graph.get_all_asset_keys()
    assert set(definitions.resources) == {"robots", "robots_lock"}


@pytest.mark.parametrize("prefix", ["no/slash", "", "a b", ["north", ""]])
def test_a_prefix_that_names_cannot_have_is_refused(place, prefix):
    with pytest.raises(RecipeError, match="letters, digits and underscores were expected"):
        build_definitions(place.recipes["north"], key_prefix=prefix)


def test_a_second_project_with_the_same_keys_is_refused_in_a_sentence(place, tmp_path):
    place.tick(NORTH)
    other = tmp_path / "other" / "recipe.yaml"
    other.parent.mkdir()
    other.write_text(place.recipes["north"].read_text())
    context = dg.build_sensor_context(
        place.instance,
        resources={"north__workspace": Workspace(recipe_file=str(other), key_prefix=["north"])},
    )
    sensor = build_definitions(other, key_prefix="north").resolve_sensor_def("north__recordings")
    way_out = "keep each recipe in a folder of its own, name another `state` .* another prefix"
    with pytest.raises(dg.Failure, match=rf"same asset keys \(key_prefix 'north'\).*{way_out}"):
        sensor(context)
    assert recipes_of(place.instance) == [place.recipes["north"]]


def test_a_project_that_is_gone_or_has_another_instance_keeps_no_keys(place, tmp_path):
    north, south = place.recipes["north"], place.recipes["south"]
    assert note_project(place.instance, (), north) is None
    assert note_project(place.instance, (), south) == north
    moved = north.with_name("moved.yaml")
    north.rename(moved)
    assert note_project(place.instance, (), moved) is None
    noted = place.instance.daemon_cursor_storage.get_cursor_values({"bagassets/projects"})
    with dg.DagsterInstance.ephemeral(tempdir=str(tmp_path)) as copy:
        copy.daemon_cursor_storage.set_cursor_values(noted)
        assert note_project(copy, (), south) is None
        assert recipes_of(copy) == [south]


def test_runs_note_the_recipes_of_their_projects(place):
    assert recipes_of(place.instance) == []
    for naming in (NORTH, SOUTH):
        add_partitions(Records(place.instance, naming), [KEY])
        place.run([naming.key("bag")], KEY)
    assert recipes_of(place.instance) == sorted(place.recipes.values())


# --- our launcher ------------------------------------------------------------------------

BOTH = """
from pathlib import Path

import dagster as dg

from bagassets.defs import build_definitions

HERE = Path(__file__).parent
defs = dg.Definitions.merge(
    *(build_definitions(HERE / name / "recipe.yaml", key_prefix=name) for name in ("north", "south"))
)
"""


@pytest.fixture
def launched(place, tmp_path, monkeypatch):
    """A Dagster instance with our launcher, whose configuration names no recipe."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    monkeypatch.delenv("BAGASSETS_RECIPE", raising=False)
    home, state = tmp_path / "home", tmp_path / "state"
    home.mkdir()
    config = {
        "telemetry": {"enabled": False},
        "secrets": {
            "custom": {
                "module": "dagster._core.secrets.env_file",
                "class": "PerProjectEnvFileLoader",
                "config": {"location_paths": {name: str(tmp_path / name) for name in place.recipes}},
            }
        },
        "run_launcher": {
            "module": "bagassets.defs.launcher",
            "class": "BagAssetsRunLauncher",
            "config": {"state_folder": str(state)},
        },
    }
    (home / "dagster.yaml").write_text(json.dumps(config))
    for recipe in place.recipes.values():
        recipe.with_name(".env").write_text(f"BAGASSETS_RECIPE='{recipe}'\n")
    with open_instance(str(home)) as instance:
        yield instance
    for client in Client.all_of(state):
        client.shutdown(grace_s=0.0)


def launch(instance, naming, location, *assets):
    add_partitions(Records(instance, naming), [KEY])
    log = Path(instance.root_directory) / "code-server.log"
    with RunPool(Records(instance, naming), 1, lambda _event: None, log, location) as runs:
        runs.work([{KEY: assets}])
    assert runs.ended[KEY].problem is None
    run = instance.get_run_by_id(runs.ended[KEY].run_id)
    assert RunWorker.of(run) is not None, "a worker of our server executed it"


@pytest.mark.long
def test_the_launcher_serves_both_and_notices_that_one_recipe_changed(place, launched, tmp_path):
    (tmp_path / "both_drives.py").write_text(BOTH)
    location = CodeLocation("both_drives", working_directory=str(tmp_path))
    for naming in (NORTH, SOUTH):
        launch(launched, naming, location, "bag", "inventory")
    for _ in range(2):
        launch(launched, SOUTH, location, "calibration")
        version = recording_assets(load_recipe(place.recipes["south"])).versions["calibration"]
        assert Records(launched, SOUTH).of("calibration", KEY).code_version == version
        assert Records(launched, NORTH).of("calibration", KEY) is None
        text = place.recipes["south"].read_text()
        place.recipes["south"].write_text(
            text.replace("      LIDAR_TOP: {modality: lidar, topic: /points}\n", "")
        )


def test_code_locations_of_the_same_module_have_the_recipes_of_their_own_env(place, launched, monkeypatch):
    """Whatever recipe the process has that launches the run: a web server has one environment for all locations."""
    monkeypatch.setenv("BAGASSETS_RECIPE", str(place.recipes["north"]))
    load_definitions(place.recipes["north"])
    plain, found = Naming("drives"), {}
    for name in place.recipes:
        launch(launched, plain, CodeLocation(name=name), "bag")
        found[name] = Records(launched, plain).of("bag", KEY).data_version
    assert len(set(found.values())) == 2, "each run hashed the recording of its own project"


def test_jobs_of_slurm_know_the_recipe_of_each_project(place, launched, tmp_path, monkeypatch):
    launcher = SlurmRunLauncher(folder=str(tmp_path / "slurm"), recipe=str(place.recipes["south"]))
    launcher.register_instance(launched)
    monkeypatch.setattr(launcher, "_care", lambda: None)  # which would submit them
    code = JobPythonOrigin("__ASSET_JOB", CodeLocation().python_origin())
    for naming, name in ((NORTH, "north"), (SOUTH, "south")):
        note_project(launched, naming.prefix, place.recipes[name])
        run = dg.DagsterRun(
            "__ASSET_JOB",
            run_id=name,
            asset_selection=frozenset({naming.key("frames")}),
            tags={"dagster/partition": KEY},
            job_code_origin=code,
        )
        launcher.launch_run(LaunchRunContext(run, workspace=None))
    waiting = {one.run_id: one for one in Spool(tmp_path / "slurm").waiting()}
    for name, recipe in place.recipes.items():
        one, recording = waiting[name], recipe.parent / "bags" / KEY
        assert one.spec.environment == {"BAGASSETS_RECIPE": str(recipe)}
        assert {str(recipe), str(recipe.parent / "bags")} <= set(one.spec.needs)
        assert one.sizes == {str(recording): recording.stat().st_size}
    assert waiting["north"].seconds < waiting["south"].seconds, "it is shorter"


def test_gc_keeps_what_another_instance_than_the_projects_own_refers_to(place, launched, tmp_path):
    (tmp_path / "kept_drives.py").write_text(BOTH)
    location = CodeLocation("kept_drives", working_directory=str(tmp_path))
    launch(launched, NORTH, location, "bag", "inventory")
    recipe = place.recipes["north"]
    store = Store(load_recipe(recipe).store_path)
    version = Records(launched, NORTH).of("inventory", KEY).data_version
    assert version in find_roots(store, recipe).artifacts
    (note,) = (load_recipe(recipe).state / "instances").glob("*.json")
    assert note.stat().st_mode & 0o777 == 0o600
    note.write_text("{")
    with pytest.raises(StoreError, match="nothing was removed"):
        find_roots(store, recipe)
    note.unlink()
    assert version not in find_roots(store, recipe).artifacts
