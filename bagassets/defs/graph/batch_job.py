"""The job that brings a batch of recordings up to date, one after the other, and then the datasets if asked to.

Each recording is recorded as its own partition, as a run of its own would.
"""

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import dagster as dg
from dagster import AssetRecordsFilter

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import BagAssetsError, RunEndedError, StoreError, UnexpectedError
from bagassets.base.quantities import count_text
from bagassets.defs.dagster_private import (
    AssetCheckEvaluationTargetMaterializationData,
    AssetMaterializationPlannedData,
    AssetObservationData,
    SqlEventLogStorage,
    StepMaterializationData,
)
from bagassets.defs.graph.check_records import record_passed
from bagassets.defs.graph.checks import check_groups, run_checks, run_dataset_checks
from bagassets.defs.graph.dataset import dataset_is_current, make_dataset, record_inputs
from bagassets.defs.graph.making import MadeAsset, Source, dependencies, make_assets, read_bag, recorded_bag
from bagassets.defs.records.batches import Batch
from bagassets.defs.records.events import CODE_VERSION, DATA_VERSION
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import DATASET_INPUTS, Naming
from bagassets.defs.records.not_made import observations_of
from bagassets.defs.records.partitions import DATASET
from bagassets.defs.records.reporting import BAG_CODE_VERSION
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.defs.runs.run_progress import note_begun, note_ended
from bagassets.engine.plan import is_skip, version_as_input
from bagassets.engine.unsettled import Unsettled
from bagassets.formats.dataset_build import dataset_code_versions, datasets_of
from bagassets.recordings.model import RecordingFiles

__all__ = ["batch_job", "make_not_begun"]

_MOST_NAMED = 3
# What Dagster itself records of an input that was never materialized.
_NO_VERSION, _NO_RECORD = "INITIAL", "NULL"


def batch_job(names: Naming) -> dg.JobDefinition:
    """Return the job that makes assets of several recordings."""

    @dg.op(
        name=names.batch_op,
        required_resource_keys={names.workspace, names.lock},
        config_schema={
            "recordings": dg.Field(
                dict,
                description="Partition key: names of the assets to make; with an empty key, names of datasets.",
            )
        },
        out=dg.Out(dg.Nothing),
        description=__doc__,
    )
    def build_each(context: dg.OpExecutionContext) -> None:
        workspace: Workspace = getattr(context.resources, names.workspace)
        recording_lock: RecordingLock = getattr(context.resources, names.lock)
        failed: dict[str, str] = {}
        batch: Batch = context.op_config["recordings"]
        try:
            found = workspace.discover().recordings
        except BagAssetsError as err:
            raise dg.Failure(str(err), allow_retries=False) from None
        parts: list[_Part] = [
            _Recording(context, workspace, key, assets, recording_lock, found.get(key))
            for key, assets in batch.items()
            if key != DATASET
        ]
        if DATASET in batch:
            parts.append(_Datasets(context, workspace, DATASET, batch[DATASET]))
        for part in parts:
            problem = part.build()
            if problem is not None:
                failed[part.key] = problem
        if failed:
            total = len(batch.keys() - {DATASET})
            raise dg.Failure(_describe(failed, total), allow_retries=False)

    @dg.job(
        name=names.batch_job,
        description="Brings recordings up to date, and the datasets made from them; `bagassets build` launches it.",
        executor_def=dg.in_process_executor,
    )
    def job() -> None:
        build_each()

    return job


def make_not_begun(
    context: dg.AssetExecutionContext,
    workspace: Workspace,
    source: Source,
    assets: Collection[str],
    lock: RecordingLock,
) -> None:
    """Make the assets of a run that Dagster does not begin after a step that failed, though they do not read what failed.

    Raises:
        BagAssetsError: some could not be made.
    """
    key, recording = source.recording.key, source.recording
    part = _Recording(context.op_execution_context, workspace, key, [*assets], lock, recording)
    part.make_from(source, assets)


def _describe(failed: Mapping[str, str], total: int) -> str:
    recordings = [f"{key}: {problem}" for key, problem in failed.items() if key != DATASET]
    said = []
    if recordings and total > 1:
        said.append(f"{len(recordings)} of {count_text(total, 'recording')} failed; the others are recorded.")
    said += recordings[:_MOST_NAMED]
    if len(recordings) > _MOST_NAMED:
        said.append(f"(and {len(recordings) - _MOST_NAMED} more)")
    if DATASET in failed:
        said.append(f"The datasets could not be made: {failed[DATASET]}")
    return " ".join(said)


@dataclass(frozen=True)
class _Latest:
    """The latest materialization of an asset, of one recording if there is one of each."""

    storage_id: int
    run_id: str
    timestamp: float
    data_version: str


class _Part(ABC):
    """What a run brings up to date one after the other: a recording, or the datasets.

    Attributes:
        key: partition key of the recording; `DATASET` for the datasets.
    """

    def __init__(
        self, context: dg.OpExecutionContext, workspace: Workspace, key: str, assets: Sequence[str]
    ) -> None:
        self.key = key
        self._context, self._instance, self._workspace = context, context.instance, workspace
        self._names = workspace.names
        self._wanted = tuple(assets)
        self._made: set[str] = set()
        self._latest: dict[str, _Latest] = {}

    def build(self) -> str | None:
        """Make and record everything; return why something failed, or None.

        Raises:
            RunEndedError: the run was given up while this worker was at work.
        """
        note_begun(self._instance, self._context.run_id, self._names.batch_job, self.key)
        problem: BagAssetsError | str | None = None
        try:
            self._make()
        except RunEndedError:
            raise
        except BagAssetsError as err:
            problem = err
        except Exception as err:
            problem = f"{type(err).__name__}: {err}"
            self._context.log.exception("%s: an unexpected error", self.name)
        text = None if problem is None else str(problem)
        if problem is not None:
            self._give_up({*self._wanted} - self._made, problem)
        note_ended(self._instance, self._context.run_id, self._names.batch_job, self.key, text)
        return text

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.key or "the datasets"

    @abstractmethod
    def _make(self) -> None:
        """Make and record everything.

        Raises:
            BagAssetsError: something could not be made.
        """

    @property
    def _of_key(self) -> str:
        return f" of {self.key}" if self.key else ""

    def _give_up(self, assets: Collection[str], problem: BagAssetsError | str) -> None:
        """Record that assets were to be made, and why they are not: by the end of the run, they have failed.

        Dagster records it beforehand of each asset of a run; here it would be a tenth of what is kept of a recording.
        """
        for asset in sorted(assets):
            planned = AssetMaterializationPlannedData(self._names.key(asset), partition=self.key or None)
            message = f"{asset}{self._of_key} was not made."
            self._log(dg.DagsterEventType.ASSET_MATERIALIZATION_PLANNED, planned, message)
        for observed in observations_of(self._workspace.assets, self._names, self.key, assets, problem):
            message = (
                f"{observed.asset_key.to_user_string()}{self._of_key} was not made: {observed.description}"
            )
            self._log(dg.DagsterEventType.ASSET_OBSERVATION, AssetObservationData(observed), message)

    def _log(self, kind: dg.DagsterEventType, data: object, message: str) -> float:
        """Record an event of the run; return when it happened, in seconds since the epoch."""
        entry = self._entry(kind, data, message)
        self._instance.handle_new_event(entry)
        return entry.timestamp

    def _entry(self, kind: dg.DagsterEventType, data: object, message: str | None = None) -> dg.EventLogEntry:
        """Return an event of the run, as its log has it.

        Not through the step, which would add to each what it is and where it stands: a third of the event.
        """
        event = dg.DagsterEvent(
            event_type_value=kind.value,
            job_name=self._context.job_name,
            step_key=self._context.op.name,
            event_specific_data=data,  # type: ignore[arg-type]  # a union of all kinds
            message=message,
        )
        return dg.EventLogEntry(  # type: ignore[no-untyped-call]  # Dagster's class has no annotations
            error_info=None,
            level=logging.DEBUG,
            user_message="",
            run_id=self._context.run_id,
            timestamp=time.time(),
            step_key=self._context.op.name,
            job_name=self._context.job_name,
            dagster_event=event,
        )

    def _record(self, made: MadeAsset, code_version: str, inputs: Mapping[str, str]) -> None:
        """Record an asset as materialized, with the tags that Dagster would write itself.

        Args:
            made: the asset.
            code_version: its code version.
            inputs: what it was made from -> data version, as Dagster writes it.
        """
        tags = {
            CODE_VERSION: code_version,
            DATA_VERSION: made.data_version,
            "dagster/data_version_is_user_provided": "true",
        }
        for name, version in inputs.items():
            tags[self._names.input_tag(name)] = version
            pointer = _NO_RECORD if version == _NO_VERSION else str(self._latest_of(name).storage_id)
            tags[self._names.pointer_tag(name)] = pointer
        recorded = dg.AssetMaterialization(
            self._names.key(made.asset), partition=self.key or None, metadata=made.metadata, tags=tags
        )
        kind = dg.DagsterEventType.ASSET_MATERIALIZATION
        verb = "Skipped" if is_skip(made.data_version) else "Materialized"
        message = f"{verb} {made.asset}{self._of_key}."
        timestamp = self._log(kind, StepMaterializationData(recorded), message)
        self._made.add(made.asset)
        self._latest.pop(made.asset, None)
        storage_id = getattr(self._instance.event_log_storage, "last_asset_event_id", None)
        if storage_id is not None:  # other storages do not say it, and are asked
            self._latest[made.asset] = _Latest(storage_id, self._context.run_id, timestamp, made.data_version)

    def _latest_of(self, asset: str) -> _Latest:
        latest = self._find_latest(asset)
        if latest is None:
            raise StoreError(
                f"{self.key}: {asset} is not materialized for this recording; materialize it first."
            )
        return latest

    def _find_latest(self, asset: str) -> _Latest | None:
        if asset not in self._latest:
            partitions = [self.key] if self.key else None
            records = self._instance.fetch_materializations(
                AssetRecordsFilter(asset_key=self._names.key(asset), asset_partitions=partitions), limit=1
            ).records
            if not records:
                return None
            (record,) = records
            tags = (record.asset_materialization and record.asset_materialization.tags) or {}
            self._latest[asset] = _Latest(
                record.storage_id, record.run_id, record.timestamp, tags.get(DATA_VERSION, "")
            )
        return self._latest[asset]

    def _record_checks(self, results: Iterable[dg.AssetCheckResult]) -> None:
        """Record checks: those that did not pass in the log of the run, and the others together at the end."""
        kind = dg.DagsterEventType.ASSET_CHECK_EVALUATION
        storage = self._instance.event_log_storage
        passed = []
        try:
            for result in results:
                evaluation = self._evaluation(result)
                if evaluation.passed and isinstance(storage, SqlEventLogStorage):
                    # Without a message: it is in no log.
                    passed.append(self._entry(kind, evaluation))
                    continue
                outcome = "passed" if evaluation.passed else f"did not pass: {evaluation.description}"
                asset = self._names.asset_of(evaluation.asset_key)
                message = f"Check {evaluation.check_name} of {asset}{self._of_key} {outcome}."
                self._log(kind, evaluation, message)
        finally:  # also those before one that cannot be made
            if isinstance(storage, SqlEventLogStorage):
                record_passed(storage, passed)

    def _evaluation(self, result: dg.AssetCheckResult) -> dg.AssetCheckEvaluation:
        """Return a check as Dagster records it, with the materialization that it is about."""
        if result.asset_key is None or (asset := self._names.asset_of(result.asset_key)) is None:
            raise UnexpectedError(f"check {result.check_name}: of no asset of this project")
        target = self._latest_of(asset)
        return dg.AssetCheckEvaluation(
            asset_key=result.asset_key,
            check_name=str(result.check_name),
            passed=result.passed,
            metadata=result.metadata,
            severity=result.severity,
            description=result.description,
            partition=self.key or None,
            target_materialization_data=AssetCheckEvaluationTargetMaterializationData(
                storage_id=target.storage_id, run_id=target.run_id, timestamp=target.timestamp
            ),
        )


class _Recording(_Part):
    """One recording of a run; `recording` is None if it is gone."""

    def __init__(
        self,
        context: dg.OpExecutionContext,
        workspace: Workspace,
        key: str,
        assets: Sequence[str],
        lock: RecordingLock,
        recording: RecordingFiles | None,
    ) -> None:
        super().__init__(context, workspace, key, assets)
        self._lock = lock
        self._recording = recording

    def _make(self) -> None:
        unsettled = Unsettled(self._workspace.recipe.state)
        # Not before it is held: a worker whose run was given up meanwhile has nothing to do with what its successor made.
        with self._lock.hold(self._context, self.key):
            unsettled.add(self.key)
            self._make_held()
            unsettled.discard(self.key)

    def _make_held(self) -> None:
        # Asked for once more, a recording that is gone says what to do.
        recording = self._recording or self._workspace.recording(self.key)
        rest = {*self._wanted} - {"bag"}
        run_id = self._context.run_id
        if "bag" in self._wanted:
            source, bag = read_bag(
                self._instance, self._workspace, recording, run_id, makes_inventory=INVENTORY.name in rest
            )
            self._lock.check()
            self._record(bag, BAG_CODE_VERSION, {})
        else:
            source = recorded_bag(self._instance, self._names, recording, run_id)
        self.make_from(source, rest)

    def make_from(self, source: Source, assets: Collection[str]) -> None:
        """Make and record assets of a recording that is locked, and their checks.

        Raises:
            BagAssetsError: something could not be made.
        """
        run_id = self._context.run_id
        for result in (
            make_assets(self._instance, self._workspace, source, {*assets}, run_id) if assets else ()
        ):
            self._lock.check()
            version = self._workspace.assets.versions[result.asset]
            self._record(result, version, self._inputs_of(result.asset))
        self._record_checks(self._run_checks(source.recording))

    def _inputs_of(self, asset: str) -> dict[str, str]:
        """Return upstream asset -> what Dagster compares: a digest over the versions of the partitions read, here one.

        One that failed may not matter to an asset that reads it: only clouds that are deskewed need poses.
        """
        latest = {name: self._find_latest(name) for name in dependencies(self._workspace.assets, asset)}
        return {
            name: _NO_VERSION if found is None else version_as_input(found.data_version)
            for name, found in latest.items()
        }

    def _run_checks(self, recording: RecordingFiles) -> Iterator[dg.AssetCheckResult]:
        store = self._workspace.store
        for group in check_groups(self._workspace.recipe).values():
            chosen = {asset: checks for asset, checks in group.items() if asset in self._made}
            yield from run_checks(
                self._workspace,
                recording,
                chosen,
                lambda name: store.artifact(self._latest_of(name).data_version),
            )


class _Datasets(_Part):
    """The datasets, made from what is recorded; nothing is done if they are as they should be."""

    def build(self) -> str | None:
        self._planned = plan_instance(self._instance, self._workspace)
        record_inputs(self._instance, self._workspace, self._planned.inputs)
        if dataset_is_current(self._instance, self._workspace, self._planned.inputs):
            return None
        return super().build()

    def _make(self) -> None:
        recipe, planned = self._workspace.recipe, self._planned
        problems = []
        for asset, version in dataset_code_versions(recipe).items():
            if asset not in self._wanted:
                continue
            try:
                made = make_dataset(self._instance, self._workspace, planned, asset, self._context.run_id)
                self._record(made, version, {DATASET_INPUTS: planned.inputs.digest})
                if asset in datasets_of(recipe):
                    self._record_checks(run_dataset_checks(self._workspace, asset))
            except RunEndedError:
                raise
            except BagAssetsError as err:  # the others may well succeed
                problems.append(str(err))
        if problems:
            raise BagAssetsError(" ".join(problems))
