"""One job of the server: a forked worker, its notes and its end."""

import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from bagassets.base.json_types import JsonObject
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.protocol import Lines, Message, encode
from bagassets.forkserver.worker import run_job

_VMSTAT = Path("/proc/vmstat")


def _oom_kills() -> int:
    """Return how many processes the system has killed for lack of memory since boot; 0 if it does not count them."""
    with suppress(OSError):
        for line in _VMSTAT.read_text("ascii").splitlines():
            if line.startswith("oom_kill "):
                return int(line.split()[1])
    return 0


@dataclass(eq=False)
class Job:
    """A worker and its record.

    Attributes:
        id: id of the job on this server.
        request: what the client asked for: `function`, `args`, `label`, `env`, `cwd`, `on_lost`, `detached`.
        process: the worker.
        channel: the server's end of the socket to the worker.
        notes: what the worker has noted so far.
        end: `result` or `error`, once the worker has sent it.
        is_cancelled: True once somebody cancelled it.
        kill_at: monotonic time at which a cancelled worker is killed.
    """

    id: str
    request: Message
    process: ProcessId
    channel: socket.socket
    lines: Lines = field(default_factory=Lines)
    notes: JsonObject = field(default_factory=dict)
    end: Message = field(default_factory=dict)
    is_cancelled: bool = False
    kill_at: float | None = None
    started: float = field(default_factory=time.monotonic)
    oom_kills: int = field(default_factory=_oom_kills)

    @classmethod
    def start(cls, job_id: str, request: Message, log: Path, close_inherited: Callable[[], None]) -> Self:
        """Fork the worker of a job; in it, `close_inherited` closes the server's own files."""
        ours, theirs = socket.socketpair()
        # A signal for the server must not run the server's handler in the child.
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT, signal.SIGCHLD})
        pid = os.fork()
        if pid == 0:
            os.setsid()
            ours.close()
            close_inherited()
            run_job(theirs, request, log)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        theirs.close()
        ours.setblocking(False)
        return cls(job_id, request, ProcessId.of(pid), ours)

    @property
    def label(self) -> str:
        """Name given by the client, such as a run id."""
        return str(self.request["label"])

    @property
    def is_done(self) -> bool:
        """True once its result is known; its process may take a while to give its memory back."""
        return "result" in self.end

    def listen(self) -> list[Message]:
        """Read what the worker sent; return its new notes."""
        notes = []
        for message in self.lines.receive(self.channel):
            if "note" in message:
                notes.append(message["note"])
                self.notes.update(message["note"])
            else:
                self.end = message
        return notes

    def cancel(self, grace_s: float, signum: signal.Signals = signal.SIGTERM) -> None:
        """Ask the worker to stop, by a message and a signal, and have it killed after `grace_s` seconds."""
        self.kill_at = min(self.kill_at or float("inf"), time.monotonic() + grace_s)
        if self.is_cancelled:
            return
        self.is_cancelled = True
        with suppress(OSError):  # it has just ended
            self.channel.send(encode({"op": "cancel"}))
            os.kill(self.process.pid, signum)

    def kill(self) -> None:
        """Kill the worker and all processes that it started; only valid before it is collected."""
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:  # it has not yet made its group
            os.kill(self.process.pid, signal.SIGKILL)

    def collect(self) -> int | None:
        """Return the wait status of a worker that has ended, or None.

        Processes that the worker left behind are killed while the zombie still holds
        the id of the group.
        """
        if os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            return None
        self.kill()
        return os.waitpid(self.process.pid, 0)[1]

    def describe_end(self, status: int) -> Message:
        """Return the event that says how the worker ended."""
        if os.WIFSIGNALED(status) and not self.is_done:
            name = signal.Signals(os.WTERMSIG(status)).name
            return {"event": "killed", "job": self.id, "signal": name, "reason": self._why(name)}
        code = 0 if self.is_done else os.waitstatus_to_exitcode(status)
        end = self.end
        if not end:
            message = f"The worker ended with exit code {code} and sent no result."
            end = {"error": {"type": "ExitError", "message": message, "is_for_users": False}}
            code = code or 1
        return {"event": "finished", "job": self.id, "exit": code, **end}

    def _why(self, name: str) -> str:
        if self.is_cancelled:
            return f"The worker was cancelled and was ended by {name}."
        text = f"The worker ({self.process}) was killed by {name}"
        if name != "SIGKILL":
            return f"{text}."
        if _oom_kills() > self.oom_kills:
            return f"{text}; the system ran out of memory meanwhile and killed processes."
        return f"{text}, maybe because the system ran out of memory."
