"""Projects that are built in this process: with a run launcher that executes runs at once."""

import io
import json
import signal
import subprocess
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from threading import RLock

import dagster as dg
import pytest
from dagster._core.definitions.reconstruct import ReconstructableJob
from dagster._core.launcher import RunLauncher

from bagassets.__main__ import main
from bagassets.cli import early, remote
from bagassets.defs.builds import pending_work, project_build
from bagassets.defs.records.batches import batch_of
from bagassets.defs.runs import run_pool
from bagassets.defs.runs.execution import create_job_run, create_run, execute_run
from bagassets.defs.runs.launching import Launching
from bagassets.engine.batches import DATASET
from bagassets.engine.build_report import BuildOptions, Event
from bagassets.propose.project import write_project
from bagassets_tests.small_drive import RECIPE, write_drive


class InProcessLauncher(Launching, RunLauncher):
    """Executes runs when they are launched."""

    names_workers = True  # stands in for ours
    # Dagster configures logging for each run, which waits for ever for another thread's run that logs.
    _one_at_a_time = RLock()

    def launch_run(self, context):
        with self._one_at_a_time:
            execute_run(self._instance, context.dagster_run.run_id)

    def terminate(self, run_id):
        return True


def load_definitions(recipe_file):
    """The definitions read the recipe when they are imported; a new worker would import them."""
    loaded = sys.modules.get("bagassets.definitions")
    if getattr(loaded, "read_from", None) != (recipe_file, recipe_file.read_text()):
        sys.modules.pop("bagassets.definitions", None)
        # They keep the last job, even if it is that of another project.
        ReconstructableJob.get_definition.cache_clear()
        ReconstructableJob.get_repository_definition.cache_clear()
        import_module("bagassets.definitions").read_from = (recipe_file, recipe_file.read_text())


# Without pictures, which take longer than all the rest.
QUICK = RECIPE + "preview: {{enabled: false}}\n"


def make_project(folder, drives=("a.bag",), *, text=QUICK, duration_s=1.0):
    """Write recordings and a project; return its recipe file."""
    for name in drives:
        kind = {".bag": "ros1", ".mcap": "mcap"}.get(Path(name).suffix, "ros2")
        write_drive(folder / "bags" / name, kind, duration_s=duration_s)
    write_project(folder, text.format(name="test", root="bags"))
    return folder / "recipe.yaml"


def execute_here(recipe_file, monkeypatch):
    """Have builds execute their runs in this process; return what there are runs for, as `build` does."""
    runs = []

    def created(instance, assets, *, partition_key, **options):
        runs.append((partition_key, tuple(key.to_user_string() for key in assets)))
        return create_run(instance, assets, partition_key=partition_key, **options)

    def created_job(instance, name, run_config, **options):
        (operation,) = run_config["ops"].values()
        recordings = operation["config"]["recordings"]
        runs.extend((key or None, tuple(assets)) for key, assets in recordings.items())
        return create_job_run(instance, name, run_config, **options)

    def launcher(instance):
        found = InProcessLauncher()
        found.register_instance(instance)
        return found

    monkeypatch.setattr(run_pool, "create_run", created)
    monkeypatch.setattr(run_pool, "create_job_run", created_job)
    monkeypatch.setattr(dg.DagsterInstance, "run_launcher", property(launcher))
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe_file))
    load_definitions(recipe_file)
    return runs


def build(recipe_file, monkeypatch, *, on_event=lambda _event: None, **options):
    """Build; return the report and what there were runs for: (partition key, assets), in any number of runs."""
    runs = execute_here(recipe_file, monkeypatch)
    report = project_build.build_project(recipe_file, BuildOptions(**options), on_event)
    return report, runs


@contextmanager
def building_here():
    """Have commands build in this process, and on no fork server.

    A server is seconds of imports for each new project; tests of servers, processes and signals start real ones.
    """
    with pytest.MonkeyPatch.context() as patch:

        def built_here(recipe, options, on_event, most, _handed_over=None):
            def note(content):
                on_event(Event(**content["build"]))

            if recipe.is_file():
                execute_here(recipe, patch)
            patch.setattr(project_build, "note", note)
            args = {"recipe": str(recipe), "options": asdict(options), "most": most}
            # As it comes from a worker.
            return json.loads(json.dumps(project_build.build_project_in_worker(args)))

        patch.setattr(remote, "report_of_build", built_here)
        patch.setattr(early, "hand_over", lambda *_: None)
        before = signal.getsignal(signal.SIGTERM)
        try:
            yield
        finally:
            signal.signal(signal.SIGTERM, before)


def run_command(*arguments):
    """Run `bagassets` as its process would, but `building_here`; return what `subprocess.run` does."""
    argv = ["bagassets", *map(str, arguments)]
    out, err = io.StringIO(), io.StringIO()
    with building_here(), pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", argv)
        try:
            status = main()
        except SystemExit as end:  # of a command
            status = end.code
    return subprocess.CompletedProcess(argv, status, out.getvalue(), err.getvalue())


def keys_of(run):
    """Return what a run is about: partition keys, and `DATASET` for datasets."""
    return set(batch_of(run)) or {run.tags.get("dagster/partition", DATASET)}


def survey(recipe_file, **options):
    """Return the state of everything."""
    with pending_work.open_project(recipe_file) as workspace:
        return pending_work.find_pending_work(workspace, BuildOptions(**options))


def states(pending, key):
    """Return asset -> state of one recording."""
    return {name: asset.state for name, asset in pending.plan.bags[key].assets.items()}
