"""Recording what was made, and why something was not: in one way, wherever the event goes.

Dagster takes some as the result of a step, and records that itself. Of an asset without a step of its own, as in a run about
several recordings, it is an event of the run; and of one that needs no run, an event without one.
"""

import json
import logging
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import dagster as dg
from dagster import AssetRecordsFilter
from sqlalchemy.exc import IntegrityError

from bagassets.base.errors import BagAssetsError, RunEndedError, StoreError, UnexpectedError
from bagassets.defs.dagster_private import (
    AssetCheckEvaluationTargetMaterializationData,
    AssetCheckExecutionsTable,
    AssetMaterializationPlannedData,
    AssetObservationData,
    SqlEventLogStorage,
    StepMaterializationData,
)
from bagassets.defs.records.events import CACHED, CODE_VERSION, DATA_VERSION, NOT_MADE
from bagassets.defs.records.fence import Fence
from bagassets.defs.records.reporting import Metadata
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.execute import BuildFailure
from bagassets.engine.plan import is_skip, version_as_input
from bagassets.store.artifact import Artifact

# What Dagster itself records of an input that was never materialized.
_NO_VERSION, _NO_RECORD = "INITIAL", "NULL"
_SUCCEEDED, _PLANNED = "SUCCEEDED", "PLANNED"  # as Dagster's `AssetCheckExecutionRecordStatus` has it
_PARTS = ("dagster_event", "event_specific_data")  # of an event, one in the other


@dataclass(frozen=True)
class Made:
    """An asset to be recorded as materialized, which it is if it was skipped, too.

    Without a materialization Dagster would take it as failed in a backfill, and request nothing below it.

    Attributes:
        asset: its name.
        data_version: digest of the recording or of the artifact; see `skip_version` for one that was skipped.
        code_version: of the code that made it.
        metadata: what Dagster shows of it.
        inputs: upstream asset -> the data version that it was made from, as Dagster writes it; None: the one on record.
        about: what is said of the event.
        parts: digests of the artifacts of its channels.
    """

    asset: str
    data_version: str
    code_version: str
    metadata: Metadata
    inputs: Mapping[str, str | None]
    about: str | None = None
    parts: Collection[str] = ()


class Recorder:
    """Records what is made of a recording, or of the datasets.

    Args:
        workspace: recipe, store, and the instance where it is recorded.
        key: partition key of the recording; `DATASET` for what exists once.
        context: of the step that makes it, or the step itself if it is about several recordings; None if there is no run.
        wanted: names of the assets that the run is to make of it.

    Attributes:
        step: of the run.
        made: names of the assets that were recorded.
        skipped: those of them that were skipped.
        has_made: any of them was made, rather than found in the store.
        artifacts: digests of what was made, or found, with that of channels.
    """

    def __init__(
        self,
        workspace: Workspace,
        key: str,
        context: dg.AssetExecutionContext | RunStep | None = None,
        wanted: Collection[str] = (),
    ) -> None:
        self.instance, self.workspace, self.key, self.wanted = workspace.instance, workspace, key, wanted
        self.made: set[str] = set()
        self.skipped: set[str] = set()
        self.has_made, self.artifacts = False, set[str]()
        if context is None or isinstance(context, RunStep):
            self.step = context or RunStep(workspace.instance)
        else:
            self.step = RunStep.of(context, is_planned=True)
        self._fence = Fence(self.instance, self.step.run_id) if context is not None else None
        self._context, self._names, self._of = context, workspace.names, f" of {key}" if key else ""
        self._latest: dict[str, dg.EventLogRecord] = {}

    def record(self, made: Made) -> list[dg.MaterializeResult[None]]:
        """Record an asset.

        Returns:
            What the step is to yield if it is about this asset: Dagster then records it, with the tags that are written
            here otherwise.

        Raises:
            RunEndedError: the run was given up while its worker was at work.
        """
        if self._fence is not None:
            self._fence.check()
        asset, context, results = self._names.key(made.asset), self._context, []
        if isinstance(context, dg.AssetExecutionContext) and asset in context.selected_asset_keys:
            # Not in the result, where it would be recorded twice: with the output of the step, too.
            context.add_asset_metadata(made.metadata, asset, self.key or None)
            version = dg.DataVersion(made.data_version)
            results.append(dg.MaterializeResult[None](asset_key=asset, data_version=version))
        else:
            event = dg.AssetMaterialization(
                asset, made.about, made.metadata, self.key or None, tags=self._tags(made)
            )
            verb = "Skipped" if is_skip(made.data_version) else "Materialized"
            kind = dg.DagsterEventType.ASSET_MATERIALIZATION
            message = f"{verb} {made.asset}{self._of}."
            entry = self._entry(kind, StepMaterializationData(event), message)
            self.instance.handle_new_event(entry)
            self._latest.pop(made.asset, None)
            storage_id = getattr(self.instance.event_log_storage, "last_asset_event_id", None)
            if storage_id is not None:  # other storages do not say it, and are asked
                self._latest[made.asset] = dg.EventLogRecord(storage_id, entry)
        self.made.add(made.asset)
        self.has_made |= made.metadata.get(CACHED) is False
        self.artifacts |= {made.data_version, *made.parts} if made.asset != "bag" else set()
        if is_skip(made.data_version):
            self.skipped.add(made.asset)
        return results

    def is_recorded(self, made: Made) -> bool:
        """Return whether the latest record says the same: of the versions, and of what it was made from."""
        latest = self._find_latest(made.asset)
        return latest is not None and self._tags(made).items() <= _tags_of(latest).items()

    def artifact(self, asset: str) -> Artifact:
        """Return the artifact of an asset that is recorded.

        Raises:
            StoreError: it is not, or the store has lost it.
        """
        return self.workspace.store.artifact(_tags_of(self._latest_of(asset)).get(DATA_VERSION, ""))

    def record_checks(self, results: Iterable[dg.AssetCheckResult]) -> None:
        """Record checks: those that did not pass in the log of the run, and the others together at the end."""
        kind = dg.DagsterEventType.ASSET_CHECK_EVALUATION
        storage = self.instance.event_log_storage
        passed = []
        if self.skipped:  # so that those before are seen
            self._forget_planned_checks()
        try:
            for result in results:
                evaluation = self._evaluation(result)
                if evaluation.passed and isinstance(storage, SqlEventLogStorage):
                    # Without a message: it is in no log.
                    passed.append(self._entry(kind, evaluation))
                    continue
                outcome = "passed" if evaluation.passed else f"did not pass: {evaluation.description}"
                asset = self._names.asset_of(evaluation.asset_key)
                message = f"Check {evaluation.check_name} of {asset}{self._of} {outcome}."
                self.instance.handle_new_event(self._entry(kind, evaluation, message))
            self._forget_planned_checks()
        finally:  # also those before one that cannot be made
            if isinstance(storage, SqlEventLogStorage):
                record_passed(storage, passed)

    def _forget_planned_checks(self) -> None:
        """Drop what Dagster has noted of checks that the run is to make: if another recording fails, what is without result is red."""
        storage, table = self.instance.event_log_storage, AssetCheckExecutionsTable
        is_range = isinstance(self._context, RunStep) and self.step.is_planned
        if is_range and isinstance(storage, SqlEventLogStorage):
            ours = table.c.run_id == self.step.run_id, table.c.partition == self.key
            with storage.index_connection() as connection:
                connection.execute(table.delete().where(*ours, table.c.execution_status == _PLANNED))

    @contextmanager
    def giving_up(self, begun: Collection[str]) -> Iterator[None]:
        """Record why assets are not made if this block fails: the page of a partition shows it, and a log has it among tracebacks.

        An asset that failed itself has its own sentence, and one that reads it says which one failed.

        Args:
            begun: what is to be made in this block. What else the run was to make and reads what is missing, it will not
                even begin.
        """
        try:
            yield
        except RunEndedError:
            raise  # Whoever ended the run has said why, and a later one may have made them.
        except Exception as err:
            problem = str(err) if isinstance(err, BagAssetsError) else f"{type(err).__name__}: {err}"
            errors = err.errors if isinstance(err, BuildFailure) else {}
            above = {name: self.workspace.assets.with_upstream([name]) for name in {*begun, *self.wanted}}
            missing = {*begun, *errors} - self.made
            missing |= {name for name in above.keys() - self.made if not missing.isdisjoint(above[name])}
            for asset in sorted(missing):
                failed = [f"{name} failed: {errors[name]}" for name in above.get(asset, ()) if name in errors]
                why = str(errors[asset]) if asset in errors else "\n".join(failed) or problem
                self._give_up(asset, why)
            raise

    def _give_up(self, asset: str, why: str) -> None:
        key, partition, kinds = self._names.key(asset), self.key or None, dg.DagsterEventType
        message = f"{asset}{self._of} was not made"
        if not self.step.is_planned:
            # By the end of the run, it has failed. Dagster records it beforehand of each asset of a step; here it would be a
            # tenth of what is kept of a recording.
            planned = AssetMaterializationPlannedData(key, partition=partition)
            entry = self._entry(kinds.ASSET_MATERIALIZATION_PLANNED, planned, f"{message}.")
            self.instance.handle_new_event(entry)
        metadata = {NOT_MADE: dg.MetadataValue.text(why)}
        observed = dg.AssetObservation(key, description=why, partition=partition, metadata=metadata)
        entry = self._entry(kinds.ASSET_OBSERVATION, AssetObservationData(observed), f"{message}: {why}")
        self.instance.handle_new_event(entry)

    def _entry(self, kind: dg.DagsterEventType, data: object, message: str | None = None) -> dg.EventLogEntry:
        """Return an event of the run, as its log has it; without one, it is in no log.

        Not through the step, which would add to each what it is and where it stands: a third of the event.
        """
        event = dg.DagsterEvent(
            event_type_value=kind.value,
            job_name=self.step.job_name,
            step_key=self.step.step,
            event_specific_data=data,  # type: ignore[arg-type]  # a union of all kinds
            message=message,
        )
        return dg.EventLogEntry(  # type: ignore[no-untyped-call]  # Dagster's class has no annotations
            error_info=None,
            level=logging.DEBUG,
            user_message="",
            run_id=self.step.run_id,
            timestamp=time.time(),
            step_key=self.step.step,
            job_name=self.step.job_name,
            dagster_event=event,
        )

    def _tags(self, made: Made) -> dict[str, str]:
        """Return the tags that Dagster would write itself: the versions of an asset, and what it was made from."""
        tags = {CODE_VERSION: made.code_version, DATA_VERSION: made.data_version}
        if self._context is not None:
            tags["dagster/data_version_is_user_provided"] = "true"
        for name, version in made.inputs.items():
            # One that failed may not matter to an asset that reads it: only clouds that are deskewed need poses.
            latest = self._find_latest(name)
            on_record = (
                _NO_VERSION if latest is None else version_as_input(_tags_of(latest).get(DATA_VERSION, ""))
            )
            tags[self._names.input_tag(name)] = on_record if version is None else version
            tags[self._names.pointer_tag(name)] = _NO_RECORD if latest is None else str(latest.storage_id)
        return tags

    def _find_latest(self, asset: str) -> dg.EventLogRecord | None:
        """Return the latest materialization of an asset, of this recording if there is one of each."""
        if asset not in self._latest:
            partitions = [self.key] if self.key else None
            about = AssetRecordsFilter(asset_key=self._names.key(asset), asset_partitions=partitions)
            records = self.instance.fetch_materializations(about, limit=1).records
            if not records:
                return None
            (self._latest[asset],) = records
        return self._latest[asset]

    def _latest_of(self, asset: str) -> dg.EventLogRecord:
        latest = self._find_latest(asset)
        if latest is None:
            raise StoreError(
                f"{self.key}: {asset} is not materialized for this recording; materialize it first."
            )
        return latest

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


def _tags_of(record: dg.EventLogRecord) -> Mapping[str, str]:
    materialization = record.asset_materialization
    return (materialization.tags if materialization else None) or {}


def record_passed(storage: SqlEventLogStorage, entries: Sequence[dg.EventLogEntry]) -> None:
    """Record evaluations of checks that passed where Dagster looks them up.

    There are a dozen of each recording. Dagster would update and insert one at a time, which takes seven times as long, and
    spell out what is empty: here they are one statement, and take a quarter less room; they are not in the log of their
    run, too.

    Args:
        storage: where to.
        entries: events with an `AssetCheckEvaluation` of a run each; they get no place in its log.
    """
    if not entries:
        return
    # Dagster finds by the id of its event what is new, and ignores a check that has none; these have the latest one.
    latest_id = storage.get_maximum_record_id()
    # For the database, no partition differs from no partition, so it would not refuse the same check twice.
    rows = [_row(entry, latest_id) for entry in entries]
    together = [row for row in rows if row["partition"] is not None]
    one_by_one = [entry for entry, row in zip(entries, rows, strict=True) if row["partition"] is None]
    try:
        if together:
            with storage.index_connection() as connection:
                connection.execute(AssetCheckExecutionsTable.insert(), together)
    except IntegrityError:  # the run has recorded one of them before
        one_by_one = [*entries]
    for entry in one_by_one:
        storage.store_asset_check_event(entry, latest_id)


def _row(entry: dg.EventLogEntry, latest_id: int | None) -> dict[str, Any]:
    evaluation: Any = entry.asset_check_evaluation
    target = evaluation.target_materialization_data
    return {
        "asset_key": evaluation.asset_key.to_string(),
        "check_name": evaluation.check_name,
        "partition": evaluation.partition,
        "run_id": entry.run_id,
        "execution_status": _SUCCEEDED,
        "evaluation_event": _compact(dg.serialize_value(entry)),
        # Dagster has times in UTC without saying so, as PostgreSQL wants them.
        "evaluation_event_timestamp": datetime.fromtimestamp(entry.timestamp, UTC).replace(tzinfo=None),
        "evaluation_event_storage_id": latest_id,
        "materialization_event_storage_id": None if target is None else target.storage_id,
    }


def _compact(serialized: str) -> str:
    """Return an event so that Dagster reads the same from it: what is absent is null by default."""
    event = json.loads(serialized)
    part = event
    for name in _PARTS:
        part[name] = {field: value for field, value in part[name].items() if value is not None}
        part = part[name]
    return json.dumps(event, separators=(",", ":"))
