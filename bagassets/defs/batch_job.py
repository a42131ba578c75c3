"""The job that brings a batch of recordings up to date, one after the other.

Each recording is recorded as its own partition, as a run of its own would.
"""

import logging
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

import dagster as dg
from dagster import AssetRecordsFilter

from bagassets.build.execute import Skipped
from bagassets.defs.batches import BATCH_JOB, BATCH_OP, Batch
from bagassets.defs.checks import check_groups, run_checks
from bagassets.defs.dagster_private import (
    AssetCheckEvaluationTargetMaterializationData,
    AssetMaterializationPlannedData,
    AssetObservationData,
    SqlEventLogStorage,
    StepMaterializationData,
)
from bagassets.defs.events import CODE_VERSION, DATA_VERSION, INPUT_PREFIX
from bagassets.defs.exclusive import RecordingLock
from bagassets.defs.making import MadeAsset, dependencies, make_assets, read_bag, recorded_bag
from bagassets.defs.not_made import observations_of
from bagassets.defs.reporting import BAG_CODE_VERSION
from bagassets.defs.run_progress import note_begun, note_ended
from bagassets.defs.workspace import Workspace
from bagassets.errors import BagAssetsError, RunEndedError, StoreError
from bagassets.escaping import visible
from bagassets.quantities import count_text
from bagassets.recordings.model import RecordingFiles

__all__ = ["batch_job"]

_POINTER_PREFIX = "dagster/input_event_pointer/"
_MOST_NAMED = 3


def batch_job() -> dg.JobDefinition:
    """Return the job that makes assets of several recordings."""

    @dg.op(
        name=BATCH_OP,
        config_schema={
            "recordings": dg.Field(dict, description="Partition key: names of the assets to make.")
        },
        out=dg.Out(dg.Nothing),
        description=__doc__,
    )
    def build_each(
        context: dg.OpExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> None:
        failed: dict[str, str] = {}
        batch: Batch = context.op_config["recordings"]
        try:
            found = workspace.discover().recordings
        except BagAssetsError as err:
            raise dg.Failure(str(err), allow_retries=False) from None
        for key, assets in batch.items():
            problem = _Recording(context, workspace, recording_lock, key, assets).build(found.get(key))
            if problem is not None:
                failed[key] = problem
        if failed:
            raise dg.Failure(_describe(failed, len(batch)), allow_retries=False)

    @dg.job(
        name=BATCH_JOB,
        description="Brings several small recordings up to date; `bagassets build` launches it.",
        executor_def=dg.in_process_executor,
    )
    def job() -> None:
        build_each()

    return job


def _describe(failed: Mapping[str, str], total: int) -> str:
    sentences = [f"{key}: {problem}" for key, problem in list(failed.items())[:_MOST_NAMED]]
    more = f" (and {len(failed) - _MOST_NAMED} more)" if len(failed) > _MOST_NAMED else ""
    return (
        f"{len(failed)} of {count_text(total, 'recording')} failed; the others are recorded. "
        + " ".join(sentences)
        + more
    )


@dataclass(frozen=True)
class _Latest:
    """The latest materialization of an asset of the recording."""

    storage_id: int
    run_id: str
    timestamp: float
    data_version: str


class _Recording:
    """One recording of a batch."""

    def __init__(
        self,
        context: dg.OpExecutionContext,
        workspace: Workspace,
        lock: RecordingLock,
        key: str,
        assets: Sequence[str],
    ) -> None:
        self._context, self._instance, self._workspace = context, context.instance, workspace
        self._lock = lock
        self._key = key
        self._wanted = set(assets)
        self._made: set[str] = set()
        self._latest: dict[str, _Latest] = {}

    def build(self, recording: RecordingFiles | None) -> str | None:
        """Make and record everything; return why something failed, or None.

        Raises:
            RunEndedError: the run was given up while this worker was at work.
        """
        note_begun(self._instance, self._context.run_id, BATCH_JOB, self._key)
        problem: BagAssetsError | str | None = None
        try:
            with self._lock.hold(self._context, self._key):
                # Asked for once more, a recording that is gone says what to do.
                self._make(recording or self._workspace.recording(self._key))
        except RunEndedError:
            raise
        except BagAssetsError as err:
            problem = err
        except Exception as err:
            problem = f"{type(err).__name__}: {err}"
            self._context.log.exception("%s: an unexpected error", self._key)
        text = None if problem is None else str(problem)
        if problem is not None:
            self._give_up(self._wanted - self._made, problem)
        note_ended(self._instance, self._context.run_id, BATCH_JOB, self._key, text)
        return text

    def _make(self, recording: RecordingFiles) -> None:
        rest = self._wanted - {"bag"}
        if "bag" in self._wanted:
            source, bag = read_bag(
                self._instance,
                self._workspace,
                recording,
                self._context.run_id,
                makes_inventory="inventory" in rest,
            )
            self._record(bag)
        else:
            source = recorded_bag(self._instance, recording)
        results = (
            make_assets(self._instance, self._workspace, source, rest, self._context.run_id) if rest else ()
        )
        for result in results:
            if isinstance(result, Skipped):
                self._context.log.info("%s is skipped: %s.", self._key, visible(result.reason))
                return
            self._record(result)
        self._check(recording)

    def _give_up(self, assets: Collection[str], problem: BagAssetsError | str) -> None:
        """Record that assets were to be made, and why they are not: by the end of the run, they have failed.

        Dagster records it beforehand of each asset of a run; here it would be a tenth of what is kept of a recording.
        """
        for asset in sorted(assets):
            planned = AssetMaterializationPlannedData(dg.AssetKey(asset), partition=self._key)
            message = f"{asset} of {self._key} was not made."
            self._log(dg.DagsterEventType.ASSET_MATERIALIZATION_PLANNED, planned, message)
        for observed in observations_of(self._workspace.assets, self._key, assets, problem):
            message = (
                f"{observed.asset_key.to_user_string()} of {self._key} was not made: {observed.description}"
            )
            self._log(dg.DagsterEventType.ASSET_OBSERVATION, AssetObservationData(observed), message)

    def _log(self, kind: dg.DagsterEventType, data: object, message: str) -> None:
        """Record an event of the run."""
        self._instance.report_dagster_event(
            self._event(kind, data, message), self._context.run_id, logging.DEBUG
        )

    def _event(self, kind: dg.DagsterEventType, data: object, message: str) -> dg.DagsterEvent:
        """Return an event of the run.

        Not through the step, which would add to each what it is and where it stands: a third of the event.
        """
        return dg.DagsterEvent(
            event_type_value=kind.value,
            job_name=BATCH_JOB,
            step_key=BATCH_OP,
            event_specific_data=data,  # type: ignore[arg-type]  # a union of all kinds
            message=message,
        )

    def _record(self, made: MadeAsset) -> None:
        """Record an asset as materialized, with the tags that Dagster would write itself."""
        self._lock.check()
        assets = self._workspace.assets
        is_bag = made.asset == "bag"
        tags = {
            CODE_VERSION: BAG_CODE_VERSION if is_bag else assets.versions[made.asset],
            DATA_VERSION: made.data_version,
            "dagster/data_version_is_user_provided": "true",
        }
        for name in () if is_bag else dependencies(assets, made.asset):
            latest = self._latest_of(name)
            # As of any partitioned input: a digest over the versions of the partitions that are read, here one.
            tags[INPUT_PREFIX + name] = sha256(latest.data_version.encode()).hexdigest()
            tags[_POINTER_PREFIX + name] = str(latest.storage_id)
        self._latest.pop(made.asset, None)
        recorded = dg.AssetMaterialization(made.asset, partition=self._key, metadata=made.metadata, tags=tags)
        kind = dg.DagsterEventType.ASSET_MATERIALIZATION
        self._log(kind, StepMaterializationData(recorded), f"Materialized {made.asset} of {self._key}.")
        self._made.add(made.asset)

    def _latest_of(self, asset: str) -> _Latest:
        if asset not in self._latest:
            records = self._instance.fetch_materializations(
                AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=[self._key]), limit=1
            ).records
            if not records:
                raise StoreError(
                    f"{self._key}: {asset} is not materialized for this recording; materialize it first."
                )
            (record,) = records
            tags = (record.asset_materialization and record.asset_materialization.tags) or {}
            self._latest[asset] = _Latest(
                record.storage_id, record.run_id, record.timestamp, tags.get(DATA_VERSION, "")
            )
        return self._latest[asset]

    def _check(self, recording: RecordingFiles) -> None:
        store = self._workspace.store
        for group in check_groups(self._workspace.recipe).values():
            chosen = {asset: checks for asset, checks in group.items() if asset in self._made}
            for result in run_checks(
                self._workspace,
                recording,
                chosen,
                lambda name: store.artifact(self._latest_of(name).data_version),
            ):
                asset = str(result.asset_key and result.asset_key.to_user_string())
                target = self._latest_of(asset)
                evaluation = dg.AssetCheckEvaluation(
                    asset_key=dg.AssetKey(asset),
                    check_name=str(result.check_name),
                    passed=result.passed,
                    metadata=result.metadata,
                    severity=result.severity,
                    description=result.description,
                    partition=self._key,
                    target_materialization_data=AssetCheckEvaluationTargetMaterializationData(
                        storage_id=target.storage_id, run_id=target.run_id, timestamp=target.timestamp
                    ),
                )
                self._record_check(evaluation)

    def _record_check(self, evaluation: dg.AssetCheckEvaluation) -> None:
        """Record a check; one that passed where Dagster looks checks up, and not in the run's log, too.

        There are a dozen of each recording, and each takes as much room in either place.
        """
        what = f"Check {evaluation.check_name} of {evaluation.asset_key.to_user_string()} of {self._key}"
        kind = dg.DagsterEventType.ASSET_CHECK_EVALUATION
        storage = self._instance.event_log_storage
        if not evaluation.passed or not isinstance(storage, SqlEventLogStorage):
            outcome = "passed" if evaluation.passed else f"did not pass: {evaluation.description}"
            self._log(kind, evaluation, f"{what} {outcome}.")
            return
        entry = dg.EventLogEntry(  # type: ignore[no-untyped-call]
            error_info=None,
            level=logging.DEBUG,
            user_message="",
            run_id=self._context.run_id,
            timestamp=time.time(),
            step_key=BATCH_OP,
            job_name=BATCH_JOB,
            dagster_event=self._event(kind, evaluation, f"{what} passed."),
        )
        storage.store_asset_check_event(entry, None)
