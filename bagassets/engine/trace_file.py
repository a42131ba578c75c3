"""The trace of a build: when recordings, steps and workers were busy, and how busy the processors were.

The file is in Chrome's trace event format (JSON), for https://ui.perfetto.dev or chrome://tracing.
"""

import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.base.trace import VARIABLE, event, name_process
from bagassets.engine.build_report import Event

_PERIOD_S = 0.1
_STAT = Path("/proc/stat")


@contextmanager
def recorded_trace(file: Path, state: Path) -> Iterator[None]:
    """Record the spans of this process and its workers, and write them to `file`.

    The file is written even if the build fails.

    Args:
        file: the trace; an existing one is replaced.
        state: state folder of the recipe, where workers can write.

    Raises:
        BagAssetsError: the trace cannot be written.
    """
    target = file.absolute().parent
    # Before the build, not after it.
    if file.is_dir() or not target.is_dir() or not os.access(target, os.W_OK):
        raise BagAssetsError(f"{file}: the trace cannot be written there; name a file in a writable folder.")
    state.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="trace-", dir=state))
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = str(folder.absolute())
    stop = threading.Event()
    sampler = threading.Thread(target=_sample_processors, args=(stop,), name="processors", daemon=True)
    try:
        name_process("bagassets build")
        sampler.start()
        yield
    finally:
        stop.set()
        sampler.join()
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before
        _write(file, _events(folder))
        shutil.rmtree(folder, ignore_errors=True)


def trace_recordings(progress: Event) -> None:
    """Record when the run of a recording was requested and when it ended; a listener of builds."""
    if progress.is_preparation or progress.kind in {"planned", "own", "where"}:
        return
    phase = "b" if progress.kind == "started" else "e"
    facts = {} if progress.kind == "started" else {"result": progress.kind}
    name = progress.key or "dataset"
    event(phase, name, cat="bag", id=name, args=facts)


def _events(folder: Path) -> list[JsonObject]:
    """Return the events of all processes in order of time, which counts from the first one."""
    events = []
    for path in sorted(folder.glob("*.jsonl")):
        for line in path.read_text("utf-8").splitlines():
            try:
                events.append(json.loads(line))
            except ValueError:
                continue  # its process was killed while it wrote
    events.sort(key=lambda one: (one["ts"], one["pid"], one["tid"]))
    origin = events[0]["ts"] if events else 0.0
    return [{**one, "ts": round(one["ts"] - origin, 3)} for one in events]


def _write(file: Path, events: list[JsonObject]) -> None:
    content = {"traceEvents": events, "displayTimeUnit": "ms"}
    try:
        file.write_text(json.dumps(content, separators=(",", ":")) + "\n", "utf-8")
    except OSError as err:
        raise BagAssetsError(f"{file}: the trace cannot be written ({err.strerror}).") from err


def _sample_processors(stop: threading.Event) -> None:
    """Record the load of each processor, by all processes of the machine, ten times a second."""
    before, since = _busy_ticks(), time.monotonic()
    ticks_per_second = os.sysconf("SC_CLK_TCK") if before else 1
    while before and not stop.wait(_PERIOD_S):
        now, busy = time.monotonic(), _busy_ticks()
        possible = max((now - since) * ticks_per_second, 1.0)
        shares = {
            name: round(100 * min((busy[name] - ticks) / possible, 1.0))
            for name, ticks in before.items()
            if name in busy
        }
        event("C", "processors busy, %", args=shares)
        before, since = busy, now


def _busy_ticks() -> Mapping[str, int]:
    """Return processor -> busy ticks since boot; empty where the system does not report them."""
    try:
        lines = _STAT.read_text("ascii").splitlines()
    except OSError:
        return {}
    busy = {}
    for line in lines:
        name, *ticks = line.split()
        if name.startswith("cpu") and name != "cpu":
            user, nice, system, _idle, _iowait, irq, softirq = map(int, ticks[:7])
            busy[name] = user + nice + system + irq + softirq
    return busy
