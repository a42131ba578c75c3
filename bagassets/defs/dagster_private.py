"""All of Dagster that is used outside its documented API: what it is, what it is for, and the first minor version that has it.

Dagster may change these with any minor version, so `pyproject.toml` pins one; CONTRIBUTING.md says what a new one needs.
No other module imports from `dagster._…`, `dagster_shared` or `dagster_webserver.app`. Names are imported when they are asked for: a code
server needs few of them, and all together take a second.

Dagster's inner workings are relied upon in these places, too:

- `sqlite_storage` inherits Dagster's SQLite storages, and opens their files itself;
- `dataset` has a step look up once more what it reads;
- `runs` replaces `tail_to_stream` in `compute_logs` while a run is executed;
- `databases` knows the files and the tables in which Dagster keeps its records, and `bagassets.engine.freshness` reads four of the tables;
- `code_server` starts `dagster api grpc`, with the variables that `dagster dev` sets;
- `daemon` has backfills looked at more often: their loop reads the interval when it begins;
- the project's `dagster.yaml` names classes by the modules that Dagster's documentation gives.
"""

import ast
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

# In the order of what they are for. The version of Dagster is the first that has a name there ("1.7": or one before it).
# isort: off
if TYPE_CHECKING:
    # Runs with the origins that the web server would give them: `runs`, `launcher`.
    from dagster._core.code_pointer import CodePointer, ModuleCodePointer  # 1.7
    from dagster._core.origin import DEFAULT_DAGSTER_ENTRY_POINT, JobPythonOrigin  # 1.7
    from dagster._core.origin import RepositoryPythonOrigin  # 1.7
    from dagster._core.types.loadable_target_origin import LoadableTargetOrigin  # 1.7
    from dagster._core.remote_origin import ManagedGrpcPythonEnvCodeLocationOrigin  # 1.12
    from dagster._core.remote_origin import RemoteRepositoryOrigin  # 1.12
    from dagster._utils.hosted_user_process import recon_job_from_origin, recon_repository_from_origin  # 1.7

    # The user's assets downstream of ours: `own_location`, `own_assets`.
    from dagster._core.definitions.assets.graph.asset_graph import AssetGraph  # 1.9
    from dagster._core.workspace.autodiscovery import loadable_targets_from_python_module  # 1.7
    from dagster._core.workspace.load import location_origins_from_yaml_paths  # 1.7

    # Executing them in this process, and what they report: `runs`.
    from dagster._grpc.impl import core_execute_run  # 1.7
    from dagster._core.execution import compute_logs  # 1.7
    from dagster._core.execution.plan.objects import ErrorSource  # 1.7
    from dagster_shared.error import SerializableErrorInfo  # 1.11
    from dagster._utils.interrupts import capture_interrupts, check_captured_interrupt  # 1.7
    from dagster._core.secrets.env_file import get_env_var_dict  # 1.7; what Dagster reads from `.env`
    from dagster._core.instance import InstanceRef  # 1.7; the instance, handed to another process

    # Run launchers: `launching`, `launchers`; `orphaned_runs` asks whose a run is.
    from dagster._core.launcher import RunLauncher, LaunchRunContext, CheckRunHealthResult  # 1.7
    from dagster._core.launcher import WorkerStatus  # 1.7
    from dagster._core.instance import T_DagsterInstance  # 1.7
    from dagster._serdes import ConfigurableClass, ConfigurableClassData  # 1.7
    from dagster._core.storage.tags import GRPC_INFO_TAG  # 1.7

    # What a run records of what Dagster has no step for: `recorder`.
    from dagster._core.definitions.asset_checks.asset_check_evaluation import (
        AssetCheckEvaluationTargetMaterializationData,  # 1.7
    )
    from dagster._core.events import AssetMaterializationPlannedData, AssetObservationData  # 1.7
    from dagster._core.events import EngineEventData, StepMaterializationData  # 1.7

    # A partition that registers itself when it is asked for: `partitions`.
    from dagster._core.definitions.partitions.context import PartitionLoadingContext  # 1.12

    # Backfills that have not ended, and what they target: `partitions`.
    from dagster._core.execution.backfill import BulkActionStatus  # 1.7
    from dagster._core.execution.backfill import BulkActionsFilter  # 1.9

    # Partitions deleted many at a time: `partitions`.
    from dagster._core.storage.event_log.schema import DynamicPartitionsTable  # 1.7

    # Which events of assets there are: `latest_ids`, `sqlite_storage`.
    from dagster._core.storage.event_log.schema import SqlEventLogStorageTable  # 1.7

    # SQLite databases made whole or not at all, and kept open: `databases`, `sqlite_storage`.
    from dagster._core.storage.sqlite_storage import DagsterSqliteStorage  # 1.7
    from dagster._core.storage.runs.schema import RunStorageSqlMetadata  # 1.7
    from dagster._core.storage.schedules.schema import ScheduleStorageSqlMetadata  # 1.7
    from dagster._core.storage.event_log.schema import SqlEventLogStorageMetadata  # 1.7
    from dagster._core.storage.runs.sqlite.sqlite_run_storage import SqliteRunStorage  # 1.7
    from dagster._core.storage.schedules.sqlite.sqlite_schedule_storage import SqliteScheduleStorage  # 1.7

    # One database for the events of all runs: `sqlite_storage`; checks in it: `recorder`, `old_runs`; wipes: `latest_ids`.
    from dagster._core.events import ASSET_EVENTS  # 1.7
    from dagster._core.storage.event_log.schema import AssetCheckExecutionsTable, AssetKeyTable  # 1.7
    from dagster._core.storage.event_log.sql_event_log import SqlEventLogStorage  # 1.7
    from dagster._core.storage.event_log.sqlite.sqlite_event_log import SqliteEventLogStorage  # 1.7
    from dagster._core.storage.event_log.polling_event_watcher import SqlPollingEventWatcher  # 1.7

    # A code server for launchers that ask for one: `code_server`.
    from dagster._core.workspace.context import BaseWorkspaceRequestContext  # 1.7
    from dagster._core.workspace.context import WorkspaceProcessContext  # 1.7; of `webserver` as well
    from dagster._core.workspace.load_target import GrpcServerTarget  # 1.7
    from dagster._grpc.client import DagsterGrpcClient  # 1.7
    from dagster._core.errors import DagsterUserCodeUnreachableError  # 1.7

    # `bagassets ui`, which does what `dagster dev` does: `dev`, `daemon`, `webserver`.
    from dagster._cli.proxy_server_manager import ProxyServerManager  # 1.11
    from dagster._core.workspace.load_target import WorkspaceFileTarget  # 1.7
    from dagster._utils.log import configure_loggers  # 1.7
    from dagster._daemon import cli  # 1.7; runs the daemon
    from dagster._daemon import controller  # 1.7; how often it looks at backfills
    from dagster_webserver.app import create_app_from_workspace_process_context  # 1.11 or before

RUN_MODULES = (
    "dagster._core.execution.plan.active",
    "dagster._core.execution.plan.execute_plan",
    "dagster._core.executor.in_process",
    "dagster._core.instance.factory",
    "dagster._core.instance.runs.run_domain",
    "dagster._core.launcher",
    "dagster._core.run_coordinator",
    "dagster._core.scheduler",
    "dagster._core.secrets.env_file",
    "dagster._core.storage.local_compute_log_manager",
    "dagster._core.storage.migration.utils",
    "dagster._core.storage.root",
    "dagster._core.storage.sqlite_storage",
    "dagster._core.system_config.composite_descent",
    "dagster._core.utility_ops",
    "dagster._core.workspace.autodiscovery",
    "dagster._utils.test.definitions",
)
"""What Dagster imports while it opens an instance and executes a run; the fork server imports it before it forks."""


@cache
def _places() -> dict[str, str]:
    """Return the module of each name: what the type checker reads above."""
    module = ast.parse(Path(__file__).read_text("utf-8"))
    block = next(node for node in module.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def __getattr__(name: str) -> Any:
    if name not in _places():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # As `from … import` does: some names are modules themselves.
    return getattr(__import__(_places()[name], fromlist=[name]), name)
