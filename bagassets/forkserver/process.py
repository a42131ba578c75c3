"""Ids of processes that are never reused.

A process number alone is not enough: it is used again after a reboot, or by another
container. Together with the machine, its boot and the start time it is unique.
"""

import os
import signal
import socket
from functools import cache
from pathlib import Path
from typing import NamedTuple, Self

from bagassets.base.fingerprints import boot_id
from bagassets.base.json_types import JsonObject

_PROC = Path("/proc")


class ProcessId(NamedTuple):  # importing dataclasses would take a client 10 ms
    """The id of one process.

    Attributes:
        host: name of the machine.
        space: process namespace (container) and boot of that machine.
        pid: process number there.
        started: start time as the system writes it; compared, never computed with.
    """

    host: str
    space: str
    pid: int
    started: str

    @classmethod
    def current(cls) -> Self:
        """Return the id of this process."""
        return cls.of(os.getpid())

    @classmethod
    def of(cls, pid: int) -> Self:
        """Return the id of a process of this machine; for one that is gone, `started` is empty."""
        return cls(socket.gethostname(), _space(), pid, _start_time(pid))

    @classmethod
    def from_json(cls, value: JsonObject) -> Self:
        """Inverse of `as_json`.

        Raises:
            KeyError: a field is missing.
        """
        return cls(str(value["host"]), str(value["space"]), int(value["pid"]), str(value["started"]))

    def as_json(self) -> JsonObject:
        """Return the id as JSON."""
        return self._asdict()

    @property
    def is_on_this_host(self) -> bool:
        """True if this machine can tell whether the process is alive.

        That includes processes of an earlier boot, which are gone for certain, but not those
        of another container with the same host name.
        """
        namespace, ours = self.space.partition("/")[0], _space().partition("/")[0]
        return self.host == socket.gethostname() and namespace == ours

    def is_alive(self) -> bool:
        """Return whether the process runs; only meaningful if it is on this host."""
        return (
            self.is_on_this_host
            and self.space == _space()
            and bool(self.started)
            and _start_time(self.pid) == self.started
        )

    def send(self, signum: signal.Signals) -> bool:
        """Send a signal to this very process; return False if it is gone."""
        try:
            handle = os.pidfd_open(self.pid) if hasattr(os, "pidfd_open") else None
        except OSError:
            return False
        try:
            # With the handle open, the process number cannot be reused from here on.
            if not self.is_alive():
                return False
            if handle is None:
                os.kill(self.pid, signum)
            else:
                signal.pidfd_send_signal(handle, signum)
        except ProcessLookupError:
            return False
        finally:
            if handle is not None:
                os.close(handle)
        return True

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


@cache
def _space() -> str:
    """Process namespace and boot, as `pid:[4026531836]/0f6c…`; empty where there is no /proc."""
    try:
        namespace = str((_PROC / "self" / "ns" / "pid").readlink())
    except OSError:
        namespace = ""
    return f"{namespace}/{boot_id()}"


def _start_time(pid: int) -> str:
    """Start time of a running process; empty if it does not run."""
    if not (_PROC / "self" / "stat").exists():
        return _start_time_from_ps(pid)
    try:
        stat = (_PROC / str(pid) / "stat").read_text("utf-8", "replace")
    except OSError:
        return ""
    fields = stat.rpartition(")")[2].split()  # the name of the command before it may contain anything
    state, started = fields[0], fields[19]
    return "" if state in "ZXx" else started


def _start_time_from_ps(pid: int) -> str:
    import subprocess

    command = ["ps", "-o", "stat=,lstart=", "-p", str(pid)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    state, _, started = answer.stdout.strip().partition(" ")
    return "" if not state or state.startswith("Z") else started.strip()
