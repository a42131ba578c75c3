"""Processor time and memory of a command and of all that it starts, servers and their workers included.

They are known by a variable in the environment that they were started with. Memory is the proportional set
size: pages that processes share count once.
"""

import os
import resource
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

__all__ = ["Used", "cpu_s_so_far", "mark_children", "run_watched"]

_MARK = "BAGASSETS_BENCH"
_PERIOD_S = 0.1
_MEMORY_EVERY = 3
_SHOWN_BYTES = 3000
_TICK_S = 1 / os.sysconf("SC_CLK_TCK")


@dataclass
class Used:
    """What a command used.

    Attributes:
        seconds: wall time.
        cpu_s: processor time of all its processes.
        peak_mb: most memory of all of them together, at one time.
        busy: share of the processors' time that it used, from its start to its end.
        code: exit status.
    """

    seconds: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    busy: float = 0.0
    code: int = 0


@dataclass
class _Watch:
    mark: bytes
    cpu_s: dict[int, float] = field(default_factory=dict)
    peak_kb: int = 0
    known: dict[int, bool] = field(default_factory=dict)

    def look(self, *, memory: bool) -> None:
        """Note the processor time and the memory of each process that carries the mark."""
        total = 0
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            pid = int(entry.name)
            with suppress(OSError, ValueError, IndexError):
                if pid not in self.known:
                    self.known[pid] = self.mark in Path(f"/proc/{pid}/environ").read_bytes()
                if not self.known[pid]:
                    continue
                self.cpu_s[pid] = _own_cpu_s(pid)
                if memory:
                    total += _pss_kb(pid)
        self.peak_kb = max(self.peak_kb, total)


def run_watched(
    command: Sequence[str], *, cwd: Path, env: Mapping[str, str] | None = None, memory: bool = True
) -> Used:
    """Run a command to its end; what it says in the end is shown if it fails.

    Adding up `memory` takes a few hundredths of the processors' time. Without it, `peak_mb` is 0.
    """
    mark = uuid4().hex
    watch, stop = _Watch(f"{_MARK}={mark}".encode()), threading.Event()

    def look_often() -> None:
        count = 0
        while not stop.is_set():
            watch.look(memory=memory and count % _MEMORY_EVERY == 0)
            count += 1
            stop.wait(_PERIOD_S)

    thread = threading.Thread(target=look_often)
    with tempfile.TemporaryFile() as log:
        began = time.perf_counter()
        with subprocess.Popen(
            command,
            cwd=cwd,
            env={**os.environ, **(env or {}), _MARK: mark},
            stdout=log,
            stderr=log,
        ) as process:
            thread.start()
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - began
        stop.set()
        thread.join()
        if process.returncode:
            log.seek(0)
            print(log.read()[-_SHOWN_BYTES:].decode("utf-8", "replace"), flush=True)
    watch.look(memory=False)  # workers that ended count with the server that waited for them
    watch.cpu_s[process.pid] = usage.ru_utime + usage.ru_stime
    cpu_s = sum(watch.cpu_s.values())
    return Used(
        seconds,
        cpu_s,
        watch.peak_kb * 1024 / 1e6,
        cpu_s / seconds / len(os.sched_getaffinity(0)),
        process.returncode,
    )


def mark_children() -> None:
    """Have all that this process starts from now on be known by a variable in its environment."""
    os.environ[_MARK] = uuid4().hex


def cpu_s_so_far() -> float:
    """Return the processor time of all that this process has started since `mark_children`, of servers and ended processes, too."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    total, mark = ended.ru_utime + ended.ru_stime, f"{_MARK}={os.environ[_MARK]}".encode()
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            # What this process got later is not among what the kernel shows of it.
            if entry.name.isdigit() and mark in (entry / "environ").read_bytes():
                total += _own_cpu_s(int(entry.name), with_waited_for=True)
    return total


def _own_cpu_s(pid: int, *, with_waited_for: bool = False) -> float:
    """Return the time of a process itself; what it waited for was counted while it ran, or is wanted, too."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii", "replace").rpartition(")")[2].split()
    return sum(map(int, fields[11 : 15 if with_waited_for else 13])) * _TICK_S


def _pss_kb(pid: int) -> int:
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text("ascii").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1])
    return 0
