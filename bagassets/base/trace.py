"""Spans of time, recorded by every process and thread, for the trace of a build.

A span costs a microsecond unless the environment names a folder to record into
(`bagassets.engine.trace_file` does). Then each process appends its spans, as events of the Chrome
trace format, to a file of its own there: workers are forked, and some of them end by a signal.
"""

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path

VARIABLE = "BAGASSETS_TRACE"

_NOTHING: AbstractContextManager[None] = nullcontext()


def span(name: str, **facts: object) -> AbstractContextManager[None]:
    """Record how long a block takes.

    Args:
        name: kind of the work.
        facts: JSON values that identify what is worked on.
    """
    folder = os.environ.get(VARIABLE)
    return _NOTHING if not folder else _recorded(folder, name, facts)


def name_process(name: str) -> None:
    """Name the track of this process in the trace."""
    event("M", "process_name", args={"name": name})


def event(phase: str, name: str, **fields: object) -> None:
    """Record an event of the Chrome trace format now, with the fields that its phase needs."""
    folder = os.environ.get(VARIABLE)
    if folder:
        _append(folder, {"ph": phase, "name": name, "ts": time.monotonic_ns() / 1000, **fields})


@contextmanager
def _recorded(folder: str, name: str, facts: dict[str, object]) -> Iterator[None]:
    """Record a span, whose begin and end are written as one event when it ends."""
    start_ns = time.monotonic_ns()
    try:
        yield
    except BaseException as err:
        facts["error"] = str(err)
        raise
    finally:
        duration_ns = time.monotonic_ns() - start_ns
        times = {"ts": start_ns / 1000, "dur": duration_ns / 1000}
        _append(folder, {"ph": "X", "name": name, **times, "args": facts})


def _append(folder: str, fields: dict[str, object]) -> None:
    """Append one line; a small append to a file of one's own is complete or missing."""
    line = json.dumps({"pid": os.getpid(), "tid": threading.get_native_id(), **fields}) + "\n"
    with (
        suppress(OSError),  # a trace must not break a build
        (Path(folder) / f"{os.getpid()}.jsonl").open("ab", buffering=0) as file,
    ):
        file.write(line.encode())
