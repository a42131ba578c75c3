"""What launchers say of how they deal with runs: strangers nothing, ours and yours in one place."""

from dataclasses import dataclass

import dagster as dg
import pytest

from bagassets.defs.records.databases import read_settings
from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.runs.launching import (
    ConfiguredLauncher,
    LauncherSettings,
    Launching,
    launching_of,
)
from bagassets.defs.runs.run_pool import RunPool


@dataclass(frozen=True, kw_only=True)
class OwnSettings(LauncherSettings):
    nodes: int = 1


class OwnLauncher(ConfiguredLauncher):
    """A launcher as a package of its own might have one: no file of ours names it."""

    settings_type = OwnSettings
    recordings_per_run = 1

    @property
    def most_at_once(self):
        return 2 * self.settings.nodes

    def launch_run(self, context):
        self._instance.report_run_failed(context.dagster_run, "The node that was to execute it is down.")

    def terminate(self, run_id):
        return self._refuse_to_cancel(self._instance.get_run_by_id(run_id), "no node has it")

    def end_lost_runs(self):
        return ["lost"]


def write_home(folder, launcher):
    module, _, name = launcher.rpartition(".")
    config = ", config: {nodes: 8}" if name == "OwnLauncher" else ""
    (folder / "dagster.yaml").write_text(f"run_launcher: {{module: {module}, class: {name}{config}}}\n")
    return folder


@pytest.mark.parametrize(
    ("launcher", "said"),
    [
        ("dagster.DefaultRunLauncher", (None, None, False, False)),
        ("bagassets_tests.defs.runs.test_run_pool.RefusingLauncher", (None, None, False, False)),
        ("bagassets.defs.launcher.BagAssetsRunLauncher", (None, None, True, True)),
        ("bagassets.defs.slurm.launcher.SlurmRunLauncher", (1000, 10, False, False)),
        ("bagassets_tests.defs.runs.test_launching.OwnLauncher", (16, 1, False, False)),
    ],
)
def test_one_that_says_nothing_gets_the_defaults(tmp_path, launcher, said):
    home = write_home(tmp_path, launcher)
    with open_instance(str(home)) as instance:
        for one in (launching_of(instance), launching_of(read_settings(home))):
            found = (one.most_at_once, one.recordings_per_run, one.executes_here, one.names_workers)
            assert found == said
        assert isinstance(launching_of(instance), type(instance.run_launcher) if any(said) else Launching)
        assert list(launching_of(instance).waiting_runs()) == []


@pytest.mark.parametrize(
    ("launcher", "jobs"),
    [("dagster.DefaultRunLauncher", 3), ("bagassets_tests.defs.runs.test_launching.OwnLauncher", 16)],
)
def test_a_pool_of_runs_asks_it(tmp_path, launcher, jobs):
    with (
        open_instance(str(write_home(tmp_path, launcher))) as instance,
        RunPool(Records(instance, Naming("test")), 3, lambda _: None, tmp_path / "log") as runs,
    ):
        assert runs.jobs == jobs


def test_a_run_that_it_cannot_cancel_says_why(tmp_path):
    with open_instance(
        str(write_home(tmp_path, "bagassets_tests.defs.runs.test_launching.OwnLauncher"))
    ) as instance:
        run = instance.create_run_for_job(_job)
        assert not instance.run_launcher.terminate(run.run_id)
        (entry,) = instance.all_logs(run.run_id)
        said = "The run cannot be cancelled from here, because no node has it."
        assert entry.get_dagster_event().message == f"[OwnLauncher] {said}"
        assert instance.run_launcher.supports_check_run_worker_health


@dg.job
def _job():
    pass
