"""Creating and executing runs, which takes more of Dagster than its documented API has.

`dagster.materialize` and its kin create runs without a code location, which the web UI can neither re-execute nor
trace. Here a run gets the origins that the web server would give it, never enters a queue, and is executed in this
process.

Each use of `dagster_private` has a test in `test_runs.py`.
"""

import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import dagster as dg

from bagassets.base.errors import BagAssetsError, RunEndedError
from bagassets.base.json_types import JsonMapping
from bagassets.defs.dagster_private import (
    DEFAULT_DAGSTER_ENTRY_POINT,
    CodePointer,
    ErrorSource,
    JobPythonOrigin,
    LoadableTargetOrigin,
    ManagedGrpcPythonEnvCodeLocationOrigin,
    RemoteRepositoryOrigin,
    RepositoryPythonOrigin,
    SerializableErrorInfo,
    WorkerStatus,
    capture_interrupts,
    compute_logs,
    core_execute_run,
    recon_job_from_origin,
    recon_repository_from_origin,
)
from bagassets.defs.records.fence import Fence

_TAIL = "tail_to_stream"  # what `compute_logs` starts the processes with
_WRAPPERS = ("Dagster", "RetryRequested")
_BAD_ENDS = {dg.DagsterEventType.PIPELINE_FAILURE, dg.DagsterEventType.PIPELINE_CANCELED}
_ENDS = {*_BAD_ENDS, dg.DagsterEventType.PIPELINE_SUCCESS}
_FAILED_FROM_OUTSIDE = "This run has been marked as failed from outside the execution context."
_INTERRUPTS = {dg.DagsterExecutionInterruptedError.__name__, KeyboardInterrupt.__name__}


@dataclass(frozen=True)
class CodeLocation:
    """A code location as `workspace.yaml` names it.

    Attributes:
        module: Python module (`python_module.module_name`).
        attribute: its `Definitions`.
        name: the location's name; default: as Dagster names it, like the module.
        working_directory: folder put on the module search path; default: the current one.
    """

    module: str = "bagassets.definitions"
    attribute: str = "defs"
    name: str | None = None
    working_directory: str | None = None

    def python_origin(self) -> RepositoryPythonOrigin:
        """Return where a process finds the definitions."""
        folder = self.working_directory or str(Path.cwd())
        pointer = CodePointer.from_module(self.module, self.attribute, folder)
        return RepositoryPythonOrigin(
            executable_path=sys.executable, code_pointer=pointer, entry_point=DEFAULT_DAGSTER_ENTRY_POINT
        )

    def remote_origin(self, repository_name: str) -> RemoteRepositoryOrigin:
        """Return how the web UI finds the definitions: by the name of the location."""
        target = LoadableTargetOrigin(
            executable_path=sys.executable,
            module_name=self.module,
            working_directory=self.working_directory or str(Path.cwd()),
        )
        location = ManagedGrpcPythonEnvCodeLocationOrigin(target, self.name or self.module)
        return RemoteRepositoryOrigin(location, repository_name)


def failure_of(instance: dg.DagsterInstance, run: dg.DagsterRun) -> str | None:
    """Return why a run failed or was cancelled: the error of its first failed step, or the reason why it was ended."""
    for entry in instance.all_logs(run.run_id, of_type=dg.DagsterEventType.STEP_FAILURE):
        event = entry.get_dagster_event()
        if not _is_interrupt(event):
            return _message_of(event)
    message = None
    for entry in instance.all_logs(run.run_id, of_type=_BAD_ENDS):
        message = entry.get_dagster_event().message
    if message in {None, "", _FAILED_FROM_OUTSIDE}:  # the reason is in an engine event
        for entry in instance.all_logs(run.run_id, of_type=dg.DagsterEventType.ENGINE_EVENT):
            message = entry.get_dagster_event().message or message
    return message


def fail_if_lost(instance: dg.DagsterInstance, run: dg.DagsterRun) -> None:
    """Fail an active run whose launcher reports that its worker is gone.

    The daemon does so, too (`run_monitoring`), but a build needs no daemon.
    """
    launcher = instance.run_launcher
    if run.status != dg.DagsterRunStatus.STARTED or not launcher.supports_check_run_worker_health:
        return
    health = launcher.check_run_worker_health(run)
    if health.status in {WorkerStatus.FAILED, WorkerStatus.NOT_FOUND}:
        current = instance.get_run_by_id(run.run_id)
        if current is not None and not current.is_finished:
            instance.report_run_failed(current, health.msg or "The worker of the run is gone.")


def preload_definitions(module: str) -> None:
    """Import a module of definitions and build what all runs of it share, but open nothing."""
    for value in vars(import_module(module)).values():
        if isinstance(value, dg.Definitions):
            repository = value.get_repository_def()
            if repository.asset_graph.executable_asset_keys:
                repository.get_implicit_job_def_for_assets(repository.asset_graph.executable_asset_keys)


def create_run(
    instance: dg.DagsterInstance,
    assets: Iterable[str | dg.AssetKey] | dg.AssetSelection,
    *,
    partition_key: str | None = None,
    tags: Mapping[str, str] | None = None,
    location: CodeLocation | None = None,
    run_id: str | None = None,
) -> str:
    """Create a run that looks as if the web UI had launched it, and return its id.

    It includes the asset checks of the selected assets. It is NOT_STARTED until `execute_run` takes it, so create it
    only then.

    Raises:
        BagAssetsError: no such asset or partition, the assets cannot share a run, or they need configuration.
    """
    location = location or CodeLocation()
    origin = location.python_origin()
    repository = recon_repository_from_origin(origin).get_definition()
    selection = (
        assets
        if isinstance(assets, dg.AssetSelection)
        else dg.AssetSelection.assets(*(dg.AssetKey.from_coercible(key) for key in assets))
    )
    try:
        keys = selection.resolve(repository.asset_graph)
    except dg.DagsterInvalidSubsetError as err:
        raise BagAssetsError(f"{location.module}: no such assets ({err}).") from err
    job = repository.get_implicit_job_def_for_assets(keys) if keys else None
    if job is None:
        names = ", ".join(sorted(key.to_user_string() for key in keys)) or "none"
        raise BagAssetsError(
            f"{location.module}: these assets cannot share a run: {names}; select assets with the same partitions."
        )
    run_tags = dict(tags or {})
    if partition_key is not None:
        with dg.partition_loading_context(dynamic_partitions_store=instance) as context:
            try:
                job.validate_partition_key(partition_key, selected_asset_keys=keys, context=context)
            except dg.DagsterUnknownPartitionError as err:
                raise BagAssetsError(
                    f"{partition_key}: no such partition; it was removed, or never registered."
                ) from err
            run_tags |= job.get_tags_for_partition_key(partition_key, selected_asset_keys=keys)
    try:
        run = instance.create_run_for_job(
            job_def=job,
            run_id=run_id,
            asset_selection=frozenset(keys),
            tags=run_tags,
            remote_job_origin=location.remote_origin(repository.name).get_job_origin(job.name),
            job_code_origin=JobPythonOrigin(job.name, origin),
        )
    except dg.DagsterInvalidConfigError as err:
        names = ", ".join(sorted(key.to_user_string() for key in keys))
        raise BagAssetsError(
            f"{location.module}: {names} cannot be made without configuration ({err.errors[0].message}); give the "
            "fields of its configuration defaults, or materialize it in the web UI."
        ) from err
    return run.run_id


def create_job_run(
    instance: dg.DagsterInstance,
    job_name: str,
    run_config: JsonMapping,
    *,
    location: CodeLocation,
    run_id: str,
) -> None:
    """Create a run of a job with a config, as `create_run` does for assets."""
    origin = location.python_origin()
    repository = recon_repository_from_origin(origin).get_definition()
    instance.create_run_for_job(
        job_def=repository.get_job(job_name),
        run_id=run_id,
        run_config=run_config,
        remote_job_origin=location.remote_origin(repository.name).get_job_origin(job_name),
        job_code_origin=JobPythonOrigin(job_name, origin),
    )


def mark_canceling(instance: dg.DagsterInstance, run: dg.DagsterRun) -> bool:
    """Mark a run as CANCELING, which its worker reads; return False if it has ended meanwhile.

    Dagster writes that event first and the state of the run afterwards. A worker that reads the event at once may have
    ended the run in between, which would then stay CANCELING for ever.
    """
    instance.report_run_canceling(run)
    ended = instance.all_logs(run.run_id, of_type=_ENDS)
    for entry in ended[-1:]:
        instance.run_storage.handle_run_event(run.run_id, entry.get_dagster_event())
    return not ended


def execute_run(
    instance: dg.DagsterInstance,
    run_id: str,
    *,
    cancel_requested: Callable[[], bool] = lambda: False,
) -> str:
    """Execute a run in this process and return how it ended (SUCCESS, FAILURE or CANCELED); a failed step is no error here.

    An interrupt (SIGTERM, SIGINT) stops it. The run is then CANCELED if somebody asked for that (it is marked CANCELING,
    or `cancel_requested` returns True), else failed. Unlike in Dagster, no retry policy revives it.

    Args:
        instance: the instance that holds the run.
        run_id: a run in state NOT_STARTED or STARTING.
        cancel_requested: called when an interrupt arrived.

    Raises:
        BagAssetsError: there is no such run, or it has no code location.
    """
    run = instance.get_run_by_id(run_id)
    if run is None or run.job_code_origin is None:
        raise BagAssetsError(f"run {run_id}: not in this Dagster instance, or it has no code location.")
    follower = _Follower(instance, run_id, cancel_requested)
    with capture_interrupts(), _compute_logs_without_tails():
        if follower.is_cancel_wanted():
            instance.report_run_canceled(run, "The run was cancelled before it started.")
        elif not run.is_finished:
            events = core_execute_run(
                recon_job_from_origin(run.job_code_origin), run, instance, inject_env_vars=True
            )
            follower.follow(events)
            follower.settle()
    ended = instance.get_run_by_id(run_id)
    return (ended.status if ended is not None else dg.DagsterRunStatus.FAILURE).value


@dataclass
class _Follower:
    """Follows the events of a run and corrects how Dagster handles interrupts."""

    instance: dg.DagsterInstance
    run_id: str
    cancel_requested: Callable[[], bool]

    def __post_init__(self) -> None:
        self._fence = Fence(self.instance, self.run_id)

    def is_cancel_wanted(self) -> bool:
        """Return whether somebody has asked to cancel the run.

        The log is read, too, since the start of a run overwrites the state CANCELING if that was set just before.
        """
        run = self.instance.get_run_by_id(self.run_id)
        return (
            (run is not None and run.status == dg.DagsterRunStatus.CANCELING)
            or self.cancel_requested()
            or bool(self.instance.all_logs(self.run_id, of_type=dg.DagsterEventType.RUN_CANCELING))
        )

    def follow(self, events: Generator[dg.DagsterEvent, None, None]) -> None:
        """Execute the run, by taking its events, and steer the generator on the way."""
        has_started = False
        # Dagster has recorded the interrupt by the time it raises it.
        with suppress(dg.DagsterExecutionInterruptedError, KeyboardInterrupt):
            event = next(events, None)
            while event is not None:
                kind = event.event_type
                has_started = has_started or kind == dg.DagsterEventType.PIPELINE_START
                if not has_started and self.is_cancel_wanted():
                    # Dagster would mistake the state CANCELING for a second start, and fail the run.
                    events.close()
                    break
                if kind == dg.DagsterEventType.STEP_SUCCESS and self._is_given_up():
                    # What comes next is that the run has succeeded.
                    events.close()
                    break
                if kind == dg.DagsterEventType.STEP_FAILURE and _is_interrupt(event):
                    self._mark_cancelling()
                if self._is_retry_of_interrupt(event):
                    self._mark_cancelling()
                    event = events.throw(dg.DagsterExecutionInterruptedError("The run was interrupted."))
                else:
                    event = next(events, None)

    def _is_given_up(self) -> bool:
        try:
            self._fence.check()
        except RunEndedError:
            return True
        return False

    def settle(self) -> None:
        """Record a run as CANCELED that somebody asked to cancel and that did not succeed."""
        run = self.instance.get_run_by_id(self.run_id)
        good = {dg.DagsterRunStatus.CANCELED, dg.DagsterRunStatus.SUCCESS}
        if run is not None and run.status not in good and self.is_cancel_wanted():
            self.instance.report_run_canceled(run, "The run was cancelled.")

    def _mark_cancelling(self) -> None:
        """Mark the run as CANCELING: Dagster reads this next to tell a cancelled run from a failed one."""
        run = self.instance.get_run_by_id(self.run_id)
        if run is not None and run.status == dg.DagsterRunStatus.STARTED and self.is_cancel_wanted():
            self.instance.report_run_canceling(run)

    def _is_retry_of_interrupt(self, event: dg.DagsterEvent) -> bool:
        if event.event_type != dg.DagsterEventType.STEP_UP_FOR_RETRY:
            return False
        error: SerializableErrorInfo | None = event.step_retry_data.error
        while error is not None:
            if error.cls_name in _INTERRUPTS:
                return True
            error = error.cause
        return self.is_cancel_wanted()


def _is_interrupt(failed: dg.DagsterEvent) -> bool:
    return failed.step_failure_data.error_source == ErrorSource.INTERRUPT


def _message_of(failed: dg.DagsterEvent) -> str:
    """Return the text of the error that the step's own code raised, without Dagster's wrappers."""
    raised = failed.step_failure_data.error
    if raised is None:
        return "The step failed and gave no error."
    while (cause := raised.cause) is not None and str(raised.cls_name).startswith(_WRAPPERS):
        raised = cause
    name = raised.cls_name or ""
    header, _, text = raised.message.partition(f"{name}: ")
    has_header = bool(name and text) and " " not in header
    return (text if has_header else raised.message).strip()


@contextmanager
def _compute_logs_without_tails() -> Iterator[None]:
    """Keep compute logs from starting two `tail` and two Python processes per run.

    These also copy what steps print to the output of the process, which nobody sees here.
    """

    @contextmanager
    def no_tail(_path: object, _stream: object) -> Iterator[tuple[None, None]]:
        yield None, None

    original = compute_logs.tail_to_stream
    setattr(compute_logs, _TAIL, no_tail)
    try:
        yield
    finally:
        setattr(compute_logs, _TAIL, original)
