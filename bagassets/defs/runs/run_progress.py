"""How far a run is with its recordings, as its log says: so it does not matter where it is executed, or by whom."""

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

import dagster as dg

from bagassets.defs.dagster_private import EngineEventData
from bagassets.defs.records.run_step import RunStep
from bagassets.engine.source import Progress, progress_told

_RECORDING, _STATE, _PROBLEM, _SHARE, _MADE = "recording", "state", "problem", "share", "made"
_DATASETS = "datasets"  # whose key is empty
_BEGUN, _DONE, _FAILED, _READING = "begun", "done", "failed", "reading"


@dataclass
class RunProgress:
    """How far a run is with its recordings.

    Attributes:
        begun: partition key -> when it was begun (seconds since the epoch), in a run about several.
        ended: partition key -> why it failed (None if it did not), the seconds it took, whether anything was made; likewise.
        reading: partition key -> what is being done and how far, and as a share; the latest that was noted since these
            were taken out.
    """

    begun: dict[str, float] = field(default_factory=dict)
    ended: dict[str, tuple[str | None, float, bool | None]] = field(default_factory=dict)
    reading: dict[str, tuple[str, float]] = field(default_factory=dict)
    _cursor: str | None = None

    def read(self, instance: dg.DagsterInstance, run_id: str) -> Iterator[tuple[str, bool]]:
        """Read what is new, and yield each recording that was begun (False) or has ended (True)."""
        found = instance.get_records_for_run(run_id, self._cursor, dg.DagsterEventType.ENGINE_EVENT)
        self._cursor = found.cursor
        for record in found.records:
            entry = record.event_log_entry
            event = entry.get_dagster_event()
            said = {name: value.value for name, value in event.engine_event_data.metadata.items()}
            key, state = str(said.get(_RECORDING)), said.get(_STATE)
            if state == _BEGUN:
                self.begun[key] = entry.timestamp
                yield key, False
            elif state == _READING:
                self.reading[key] = str(event.message), float(str(said[_SHARE]))
            elif state in {_DONE, _FAILED}:
                problem = str(said[_PROBLEM]) if state == _FAILED else None
                seconds = entry.timestamp - self.begun.get(key, entry.timestamp)
                self.ended[key] = problem, seconds, bool(said[_MADE]) if _MADE in said else None
                yield key, True


def note_begun(step: RunStep, key: str) -> None:
    """Note in the log of a run about several recordings that it has begun with one."""
    _note(step, f"{key or _DATASETS}: {_BEGUN}.", {_RECORDING: key, _STATE: _BEGUN})


def note_ended(step: RunStep, key: str, problem: str | None, *, has_made: bool) -> None:
    """Note in the log of a run about several recordings that it is done with one, or that this failed."""
    state, said = (_DONE, "") if problem is None else (_FAILED, f" {problem}")
    known = {_MADE: has_made} if problem is None else {_PROBLEM: problem}
    _note(step, f"{key or _DATASETS}: {state}.{said}", {_RECORDING: key, _STATE: state, **known})


def readings_noted(step: RunStep, key: str) -> AbstractContextManager[None]:
    """Note in the log of a run now and then how far it has come with reading a large recording, in this block."""

    def note(reading: Progress) -> None:
        share = round(reading.share, 3)
        _note(step, str(reading), {_RECORDING: key, _STATE: _READING, _SHARE: share})

    return progress_told(note)


def _note(step: RunStep, message: str, metadata: Mapping[str, str | float]) -> None:
    data = EngineEventData(metadata)
    step.instance.report_engine_event(
        message, engine_event_data=data, run_id=step.run_id, job_name=step.job_name
    )
