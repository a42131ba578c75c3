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

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dagster._cli.proxy_server_manager import ProxyServerManager
    from dagster._core.code_pointer import CodePointer, ModuleCodePointer
    from dagster._core.definitions.asset_checks.asset_check_evaluation import (
        AssetCheckEvaluationTargetMaterializationData,
    )
    from dagster._core.definitions.assets.graph.asset_graph import AssetGraph
    from dagster._core.definitions.partitions.context import PartitionLoadingContext
    from dagster._core.errors import DagsterUserCodeUnreachableError
    from dagster._core.events import (
        ASSET_EVENTS,
        AssetMaterializationPlannedData,
        AssetObservationData,
        EngineEventData,
        StepMaterializationData,
    )
    from dagster._core.execution import compute_logs
    from dagster._core.execution.backfill import BulkActionsFilter, BulkActionStatus
    from dagster._core.execution.plan.objects import ErrorSource
    from dagster._core.instance import InstanceRef, T_DagsterInstance
    from dagster._core.launcher import CheckRunHealthResult, LaunchRunContext, RunLauncher, WorkerStatus
    from dagster._core.origin import (
        DEFAULT_DAGSTER_ENTRY_POINT,
        JobPythonOrigin,
        RepositoryPythonOrigin,
    )
    from dagster._core.remote_origin import ManagedGrpcPythonEnvCodeLocationOrigin, RemoteRepositoryOrigin
    from dagster._core.secrets.env_file import get_env_var_dict
    from dagster._core.storage.event_log.polling_event_watcher import SqlPollingEventWatcher
    from dagster._core.storage.event_log.schema import (
        AssetCheckExecutionsTable,
        SqlEventLogStorageMetadata,
    )
    from dagster._core.storage.event_log.sql_event_log import SqlEventLogStorage
    from dagster._core.storage.event_log.sqlite.sqlite_event_log import SqliteEventLogStorage
    from dagster._core.storage.runs.schema import RunStorageSqlMetadata
    from dagster._core.storage.runs.sqlite.sqlite_run_storage import SqliteRunStorage
    from dagster._core.storage.schedules.schema import ScheduleStorageSqlMetadata
    from dagster._core.storage.schedules.sqlite.sqlite_schedule_storage import SqliteScheduleStorage
    from dagster._core.storage.sqlite_storage import DagsterSqliteStorage
    from dagster._core.storage.tags import GRPC_INFO_TAG
    from dagster._core.types.loadable_target_origin import LoadableTargetOrigin
    from dagster._core.workspace.autodiscovery import loadable_targets_from_python_module
    from dagster._core.workspace.context import BaseWorkspaceRequestContext, WorkspaceProcessContext
    from dagster._core.workspace.load import location_origins_from_yaml_paths
    from dagster._core.workspace.load_target import GrpcServerTarget, WorkspaceFileTarget
    from dagster._daemon import cli, controller
    from dagster._grpc.client import DagsterGrpcClient
    from dagster._grpc.impl import core_execute_run
    from dagster._serdes import ConfigurableClass, ConfigurableClassData
    from dagster._utils.hosted_user_process import recon_job_from_origin, recon_repository_from_origin
    from dagster._utils.interrupts import (
        capture_interrupts,
        check_captured_interrupt,
    )
    from dagster._utils.log import configure_loggers
    from dagster_shared.error import SerializableErrorInfo
    from dagster_webserver.app import create_app_from_workspace_process_context

# Where each lies; the version of Dagster is the first that has it there ("1.7": or one before it).
_PLACES = {
    # Runs with the origins that the web server would give them: `runs`, `launcher`.
    "CodePointer": "dagster._core.code_pointer",  # 1.7
    "ModuleCodePointer": "dagster._core.code_pointer",  # 1.7
    "DEFAULT_DAGSTER_ENTRY_POINT": "dagster._core.origin",  # 1.7
    "JobPythonOrigin": "dagster._core.origin",  # 1.7
    "RepositoryPythonOrigin": "dagster._core.origin",  # 1.7
    "LoadableTargetOrigin": "dagster._core.types.loadable_target_origin",  # 1.7
    "ManagedGrpcPythonEnvCodeLocationOrigin": "dagster._core.remote_origin",  # 1.12
    "RemoteRepositoryOrigin": "dagster._core.remote_origin",  # 1.12
    "recon_job_from_origin": "dagster._utils.hosted_user_process",  # 1.7
    "recon_repository_from_origin": "dagster._utils.hosted_user_process",  # 1.7
    # The user's assets downstream of ours: `own_location`, `own_assets`.
    "AssetGraph": "dagster._core.definitions.assets.graph.asset_graph",  # 1.9
    "loadable_targets_from_python_module": "dagster._core.workspace.autodiscovery",  # 1.7
    "location_origins_from_yaml_paths": "dagster._core.workspace.load",  # 1.7
    # Executing them in this process, and what they report: `runs`.
    "core_execute_run": "dagster._grpc.impl",  # 1.7
    "compute_logs": "dagster._core.execution",  # 1.7
    "ErrorSource": "dagster._core.execution.plan.objects",  # 1.7
    "SerializableErrorInfo": "dagster_shared.error",  # 1.11
    "capture_interrupts": "dagster._utils.interrupts",  # 1.7
    "check_captured_interrupt": "dagster._utils.interrupts",  # 1.7
    "get_env_var_dict": "dagster._core.secrets.env_file",  # 1.7; what Dagster reads from `.env`
    "InstanceRef": "dagster._core.instance",  # 1.7; the instance, handed to another process
    # The run launcher: `launcher`, and `leftovers`, which asks whose a run is.
    "RunLauncher": "dagster._core.launcher",  # 1.7
    "LaunchRunContext": "dagster._core.launcher",  # 1.7
    "CheckRunHealthResult": "dagster._core.launcher",  # 1.7
    "WorkerStatus": "dagster._core.launcher",  # 1.7
    "T_DagsterInstance": "dagster._core.instance",  # 1.7
    "ConfigurableClass": "dagster._serdes",  # 1.7
    "ConfigurableClassData": "dagster._serdes",  # 1.7
    "GRPC_INFO_TAG": "dagster._core.storage.tags",  # 1.7
    # What a run about several recordings records of each: `batches`, `batch_job`.
    "AssetCheckEvaluationTargetMaterializationData": "dagster._core.definitions.asset_checks.asset_check_evaluation",  # 1.7
    "AssetMaterializationPlannedData": "dagster._core.events",  # 1.7
    "AssetObservationData": "dagster._core.events",  # 1.7
    "EngineEventData": "dagster._core.events",  # 1.7
    "StepMaterializationData": "dagster._core.events",  # 1.7
    # A partition that registers itself when it is asked for: `partitions`.
    "PartitionLoadingContext": "dagster._core.definitions.partitions.context",  # 1.12
    # Backfills that have not ended, and what they target: `partitions`.
    "BulkActionStatus": "dagster._core.execution.backfill",  # 1.7
    "BulkActionsFilter": "dagster._core.execution.backfill",  # 1.9
    # SQLite databases made whole or not at all, and kept open: `databases`, `sqlite_storage`.
    "DagsterSqliteStorage": "dagster._core.storage.sqlite_storage",  # 1.7
    "RunStorageSqlMetadata": "dagster._core.storage.runs.schema",  # 1.7
    "ScheduleStorageSqlMetadata": "dagster._core.storage.schedules.schema",  # 1.7
    "SqlEventLogStorageMetadata": "dagster._core.storage.event_log.schema",  # 1.7
    "SqliteRunStorage": "dagster._core.storage.runs.sqlite.sqlite_run_storage",  # 1.7
    "SqliteScheduleStorage": "dagster._core.storage.schedules.sqlite.sqlite_schedule_storage",  # 1.7
    # One database for the events of all runs: `sqlite_storage`; checks in it: `check_records`, `old_runs`.
    "ASSET_EVENTS": "dagster._core.events",  # 1.7
    "AssetCheckExecutionsTable": "dagster._core.storage.event_log.schema",  # 1.7
    "SqlEventLogStorage": "dagster._core.storage.event_log.sql_event_log",  # 1.7
    "SqliteEventLogStorage": "dagster._core.storage.event_log.sqlite.sqlite_event_log",  # 1.7
    "SqlPollingEventWatcher": "dagster._core.storage.event_log.polling_event_watcher",  # 1.7
    # A code server for launchers that ask for one: `code_server`.
    "BaseWorkspaceRequestContext": "dagster._core.workspace.context",  # 1.7
    "WorkspaceProcessContext": "dagster._core.workspace.context",  # 1.7; of `webserver` as well
    "GrpcServerTarget": "dagster._core.workspace.load_target",  # 1.7
    "DagsterGrpcClient": "dagster._grpc.client",  # 1.7
    "DagsterUserCodeUnreachableError": "dagster._core.errors",  # 1.7
    # `bagassets ui`, which does what `dagster dev` does: `dev`, `daemon`, `webserver`.
    "ProxyServerManager": "dagster._cli.proxy_server_manager",  # 1.11
    "WorkspaceFileTarget": "dagster._core.workspace.load_target",  # 1.7
    "configure_loggers": "dagster._utils.log",  # 1.7
    "cli": "dagster._daemon",  # 1.7; runs the daemon
    "controller": "dagster._daemon",  # 1.7; how often it looks at backfills
    "create_app_from_workspace_process_context": "dagster_webserver.app",  # 1.11 or before
}

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


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    place = __import__(
        _PLACES[name], fromlist=[name]
    )  # as `from … import` does: some names are modules themselves
    return getattr(place, name)
