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
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

__all__ = ["Used", "cpu_s_so_far", "mark_children", "run_watched"]

_MARK = "BAGASSETS_BENCH"
_PERIOD_S = 0.1
_MEMORY_EVERY = 3
_QUIET_S, _QUIET_CPU_S = 1.0, 0.02  # nothing is at work if less is used in that time
_SHOWN_BYTES = 3000
_TICK_S = 1 / os.sysconf("SC_CLK_TCK")


@dataclass
class Used:
    """What a command used.

    Attributes:
        seconds: wall time.
        cpu_s: processor time of all its processes, of a server from its start until it has nothing to do.
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
    """Processes that carry a mark.

    Attributes:
        mark: the variable in their environment.
        alive: process id -> its processor time, with that of its children that have ended and were waited for.
        orphans_cpu_s: likewise, of those that have ended and whose parent does not carry the mark.
        peak_kb: most memory of all of them at one time.
        known: process id -> whether it carries the mark.
    """

    mark: bytes
    alive: dict[int, float] = field(default_factory=dict)
    orphans_cpu_s: dict[int, float] = field(default_factory=dict)
    peak_kb: int = 0
    known: dict[int, bool] = field(default_factory=dict)

    def look(self, *, memory: bool) -> None:
        """Note the processor time and the memory of each process that carries the mark."""
        total, alive = 0, dict[int, float]()
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            pid = int(entry.name)
            with suppress(OSError, ValueError, IndexError):
                if pid not in self.known:
                    self.known[pid] = self.mark in Path(f"/proc/{pid}/environ").read_bytes()
                if not self.known[pid]:
                    continue
                parent, alive[pid] = _parent_and_cpu_s(pid)
                self.orphans_cpu_s.pop(pid, None)
                if not self.known.get(parent):
                    self.orphans_cpu_s[pid] = alive[pid]
                if memory:
                    total += _pss_kb(pid)
        self.alive = alive
        self.peak_kb = max(self.peak_kb, total)

    def cpu_s(self, command: int, command_s: float) -> float:
        """Return the time of all of them, of the command (with its children) as `wait4` says."""
        return command_s + sum(
            seconds for pid, seconds in (self.orphans_cpu_s | self.alive).items() if pid != command
        )


def run_watched(
    command: Sequence[str],
    *,
    cwd: Path,
    env: Mapping[str, str] | None = None,
    memory: bool = True,
    until: Callable[[], None] = lambda: None,
) -> Used:
    """Run a command to its end; what it says in the end is shown if it fails.

    Its processor time is that until nothing that it has started is at work: a server that stays up may have put work off.

    Args:
        command: the command.
        cwd: where it runs.
        env: further variables.
        memory: add up memory, which takes a few hundredths of the processors' time; without it, `peak_mb` is 0.
        until: called when it has ended; its seconds end when this returns.
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
        until()
        seconds = time.perf_counter() - began
        stop.set()
        thread.join()
        if process.returncode:
            log.seek(0)
            print(log.read()[-_SHOWN_BYTES:].decode("utf-8", "replace"), flush=True)
    command_s = usage.ru_utime + usage.ru_stime
    watch.look(memory=False)
    cpu_s = at_end_s = watch.cpu_s(process.pid, command_s)
    while True:  # a server that stays up may have put work off
        time.sleep(_QUIET_S)
        watch.look(memory=False)
        before_s, cpu_s = cpu_s, watch.cpu_s(process.pid, command_s)
        if cpu_s - before_s < _QUIET_CPU_S:
            break
    return Used(
        seconds,
        cpu_s,
        watch.peak_kb * 1024 / 1e6,
        at_end_s / seconds / len(os.sched_getaffinity(0)),
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
                total += _parent_and_cpu_s(int(entry.name))[1]
    return total


def _parent_and_cpu_s(pid: int) -> tuple[int, float]:
    """Return the parent of a process, and the time of the process with its children that were waited for."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii", "replace").rpartition(")")[2].split()
    return int(fields[1]), sum(map(int, fields[11:15])) * _TICK_S


def _pss_kb(pid: int) -> int:
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text("ascii").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1])
    return 0
