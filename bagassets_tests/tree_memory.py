"""Runs a command and measures the memory of all processes that it starts, also of those that leave its tree."""

import os
import signal
import subprocess
import time
import uuid
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

MARK = "BAGASSETS_TEST_MARK"


@dataclass
class Measured:
    """What a command did.

    Attributes:
        returncode: its exit status; None if it did not end in time.
        output: what it said.
        seconds: how long it took.
        peak_bytes: most memory that its processes held together, shared pages counted once.
    """

    returncode: int | None
    output: str
    seconds: float
    peak_bytes: int


def run_measured(command, *, cwd, timeout_s, env=None):
    """Run a command; whatever it started is stopped afterwards, or when it takes too much time or memory."""
    mark = f"{MARK}={uuid.uuid4().hex}"
    name, _, value = mark.partition("=")
    log = cwd / "measured.log"
    started = time.monotonic()
    with log.open("wb") as out:
        process = subprocess.Popen(
            command,
            cwd=cwd,
            stdout=out,
            stderr=subprocess.STDOUT,
            env={**os.environ, **(env or {}), name: value},
        )
        peak = 0
        try:
            while process.poll() is None and time.monotonic() - started < timeout_s and peak < 4_000_000_000:
                peak = max(peak, sum(_proportional_bytes(pid) for pid in _marked(mark)))
                time.sleep(0.02)
            seconds, returncode = time.monotonic() - started, process.poll()
        finally:
            for pid in _marked(mark):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            process.wait()
    return Measured(returncode, log.read_text(errors="replace"), seconds, peak)


def _marked(mark):
    """Return the processes that have a variable in their environment."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                if mark.encode() in (folder / "environ").read_bytes():
                    found.append(int(folder.name))
    return found


def _proportional_bytes(pid):
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024
    return 0
