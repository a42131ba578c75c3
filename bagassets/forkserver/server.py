"""The server: one thread, one loop, a fork per job; and how it notices that its own sources were edited."""

import gc
import logging
import os
import selectors
import signal
import socket
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import BagAssetsError
from bagassets.base.fingerprints import Signature, signature
from bagassets.base.lock_files import LockFile
from bagassets.forkserver.connection import Connection
from bagassets.forkserver.job import Job
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.protocol import FirstJob, Message
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.spec import ServerSpec
from bagassets.forkserver.worker import load_function

_LOG = logging.getLogger(__name__)
_TICK_S = 0.5
_AGE_CHECK_S = 5.0
_QUIET_S = 0.3
_END_GRACE_S = 10.0
_LOST_GRACE_S = 60.0  # time for reporting the loss of a worker


class Server:
    """Serves one spec until it has been idle for long, is outdated, or is asked to end."""

    def __init__(self, spec: ServerSpec, files: ServerFiles, lock: LockFile) -> None:
        self._spec = spec
        self._files = files
        self._lock = lock
        self._process = ProcessId.current()
        self._selector = selectors.DefaultSelector()
        self._listener: socket.socket | None = None
        self._wakeup: tuple[socket.socket, socket.socket] = socket.socketpair()
        self._connections: set[Connection] = set()
        self._jobs: dict[str, Job] = {}
        self._owners: dict[str, Connection] = {}
        self._held_back: dict[str, Message] = {}  # reporting job -> event of the lost one
        self._done_once: set[str] = set()
        self._count = 0
        self._last_use = self._last_job = self._last_age_check = time.monotonic()
        self._loaded: dict[Path, Signature] = {}
        self._later: Iterator[object] | None = None
        self._can_wait = False
        self._end_requested = False

    # --- life ------------------------------------------------------------------------

    def prepare(self, first_job: FirstJob | None = None) -> None:
        """Import everything that workers share.

        Args:
            first_job: started as soon as its own module is imported, in the environment of the server. Its
                arguments get `state` and `stamp`, by which it can see when the server takes other jobs.

        Raises:
            BagAssetsError: a thread was started, which makes forking unsafe; or there is a first job, and the recipe is wrong.
        """
        gc.disable()  # imports leave nothing to collect, and collecting takes a quarter of their time
        if first_job is not None:
            function, args = first_job
            load_function(function)
            if self._spec.recipe is not None:  # whoever waits hears of a mistake before Dagster is imported
                load_function("bagassets.recipe.load:load_recipe")(self._spec.recipe)
            self._start(
                {
                    "function": function,
                    "args": {**args, "state": str(self._spec.state_folder), "stamp": self._files.stamp},
                    "label": function.rpartition(":")[2],
                    "on_lost": None,
                    "detached": True,
                    "env": dict(os.environ),
                    "cwd": str(Path.cwd()),
                }
            )
        if self._spec.preload:
            self._later = load_function(self._spec.preload)(list(self._spec.modules)) or iter(())
        others = [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()]
        if others:
            raise BagAssetsError(
                f"importing {', '.join(self._spec.modules)} started threads ({', '.join(sorted(others))}), and a "
                "process with threads cannot be forked safely; start them inside assets or resources instead."
            )
        self._loaded = _loaded_sources(self._spec.sources)
        gc.freeze()  # keeps a worker's garbage collector from copying shared pages
        gc.enable()

    def serve(self, on_ready: Callable[[], None]) -> None:
        """Answer clients until the server ends; `on_ready` is called once they can connect.

        Raises:
            BagAssetsError: the socket cannot be created.
        """
        self._listen()
        # Nobody could use it while it was prepared, which may take long.
        self._last_use = self._last_job = time.monotonic()
        on_ready()
        _LOG.info("serving %s, stamp %s", ", ".join(self._spec.modules) or "nothing ahead", self._files.stamp)
        try:
            while self._listener is not None or self._jobs:
                # What can wait does while a job is at work, or was a moment ago.
                is_at_work = bool(self._jobs) or time.monotonic() - self._last_job < _QUIET_S
                due = None if self._can_wait and is_at_work else self._later
                ready = self._selector.select(0.0 if due is not None else _TICK_S)
                for key, _ in ready:
                    key.data()
                if due is not None and not ready:
                    self._prepare_more(due)
                self._collect()
                self._tick()
        finally:
            self._stop_listening()
        _LOG.info("ended")

    def _prepare_more(self, later: Iterator[object]) -> None:
        """Do a piece of the deferred preparation, while there is no request."""
        try:
            self._can_wait = bool(next(later))
        except StopIteration:
            self._later = None
        except Exception:  # noqa: BLE001  (modules of users may raise anything)
            _LOG.exception("%s: its deferred preparation failed; workers do without", self._spec.preload)
            self._later = None
        if self._later is None or self._can_wait:
            gc.freeze()

    def _listen(self) -> None:
        path = self._files.choose_socket()
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        mask = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)  # left by a server that was killed; we hold the lock
            listener.bind(str(path))
            listener.listen(64)
            self._lock.write(str(path))
        except OSError as err:
            listener.close()
            path.unlink(missing_ok=True)
            raise BagAssetsError(
                f"{path}: the fork server cannot create its socket, or note it in {self._files.lock} ({err.strerror}); "
                f"{disk_advice(err)}."
            ) from err
        finally:
            os.umask(mask)
        listener.setblocking(False)
        self._listener = listener
        self._selector.register(listener, selectors.EVENT_READ, self._accept)
        for end in self._wakeup:
            end.setblocking(False)
        self._selector.register(self._wakeup[0], selectors.EVENT_READ, self._on_signal)
        signal.set_wakeup_fd(self._wakeup[1].fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGTERM, self._on_sigterm)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def _stop_listening(self) -> None:
        if self._listener is not None:
            self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
            if self._is_displaced:
                self._lock.close()  # whatever is there now belongs to another server
            else:
                self._files.remove_socket()
                self._lock.remove()

    @property
    def _is_displaced(self) -> bool:
        """True if somebody removed the state folder, so that nobody can find this server."""
        try:
            return not self._lock.is_in_place
        except OSError:
            return False  # a file server that does not answer for a while

    def _on_sigterm(self, *_: object) -> None:
        self._end_requested = True  # for the loop, which may be anywhere now

    def _on_signal(self) -> None:
        with suppress(BlockingIOError):
            self._wakeup[0].recv(4096)

    def _tick(self) -> None:
        now = time.monotonic()
        if self._end_requested:
            self._end_requested = False
            self._shutdown(_END_GRACE_S)
        for job in self._jobs.values():
            if job.kill_at is not None and now >= job.kill_at:
                job.kill()
        if self._jobs:
            self._last_job = now
        if self._jobs or self._connections:
            self._last_use = now
        elif now - self._last_use > self._spec.idle_timeout_s:
            _LOG.info("idle for %.0f s", now - self._last_use)
            self._stop_listening()
        if now - self._last_age_check > _AGE_CHECK_S:
            self._drain_if_old()

    def _drain_if_old(self) -> bool:
        """Stop taking jobs if this server is outdated; return whether."""
        self._last_age_check = time.monotonic()
        if self._listener is None:
            return True
        reason = self._why_outdated()
        if reason is None:
            return False
        _LOG.info("outdated (%s); draining", reason)
        self._stop_listening()
        return True

    def _why_outdated(self) -> str | None:
        """Return why nobody should use this server any more: code, recipe or environment changed since they were imported."""
        if self._is_displaced:
            return "its state folder was removed"
        if changed := [file for file, seen in self._loaded.items() if signature(file)[:2] != seen]:
            return str(min(changed))
        return None if self._spec.stamp() == self._files.stamp else "another stamp"

    # --- clients ---------------------------------------------------------------------

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            accepted, _ = self._listener.accept()
        except OSError:
            return  # the client has given up
        connection = Connection(accepted, self._selector, self._on_message, self._on_close)
        self._connections.add(connection)

    def _on_message(self, connection: Connection, message: Message) -> None:
        match message.get("op"):
            case "submit":
                answer = self._submit(connection, message["job"])
            case "cancel":
                job = self._jobs.get(message["job"])
                found = job is not None and not job.is_done
                if job is not None and found:
                    job.cancel(message["grace_s"])
                answer = {"reply": "cancelled", "found": found}
            case "hello" | "status":
                answer = self._status()
            case "drain":
                self._stop_listening()
                answer = {"reply": "draining", "jobs": len(self._jobs)}
            case "shutdown":
                self._shutdown(message["grace_s"])
                answer = {"reply": "ending", "jobs": len(self._jobs)}
            case op:
                answer = {"reply": "error", "message": f"no such request: {op}"}
        connection.send(answer)

    def _on_close(self, connection: Connection) -> None:
        self._connections.discard(connection)
        for job_id in [job_id for job_id, owner in self._owners.items() if owner is connection]:
            del self._owners[job_id]
            job = self._jobs.get(job_id)
            if job is not None:
                _LOG.info("job %s: its client is gone; cancelled", job.label)
                job.cancel(job.request["grace_s"])

    def _submit(self, connection: Connection, request: Message) -> Message:
        if self._listener is None or self._drain_if_old():
            return {"reply": "refused", "message": "the server is outdated and takes no more jobs"}
        if request["once"]:
            if request["label"] in self._done_once:
                return {"reply": "submitted", "job": ""}
            self._done_once.add(request["label"])
        job = self._start(request)
        if not job.request["detached"]:
            self._owners[job.id] = connection
        return {"reply": "submitted", "job": job.id}

    def _status(self) -> Message:
        jobs = [
            {
                "job": job.id,
                "label": job.label,
                "function": job.request["function"],
                "process": job.process.as_json(),
            }
            for job in self._jobs.values()
            if not job.is_done
        ]
        return {
            "reply": "status",
            "process": self._process.as_json(),
            "draining": self._drain_if_old(),
            "clients": len(self._connections),
            "jobs": jobs,
        }

    def _shutdown(self, grace_s: float) -> None:
        self._stop_listening()
        for job in self._jobs.values():
            job.cancel(grace_s)

    # --- jobs ------------------------------------------------------------------------

    def _start(self, request: Message) -> Job:
        self._count += 1
        job = Job.start(
            f"{self._process.pid}-{self._count}",
            request,
            self._files.job_log(request["label"]),
            self._close_inherited,
        )
        self._jobs[job.id] = job
        self._selector.register(job.channel, selectors.EVENT_READ, lambda: self._on_note(job))
        _LOG.info("job %s: %s in process %d", job.label, request["function"], job.process.pid)
        return job

    def _close_inherited(self) -> None:
        """Run in a worker: close the server's files, so that they close when the server does."""
        signal.set_wakeup_fd(-1)
        self._selector.close()
        for end in self._wakeup:
            end.close()
        if self._listener is not None:
            self._listener.close()
        for connection in self._connections:
            connection.close_file()
        for job in self._jobs.values():
            job.channel.close()
        self._lock.close()

    def _on_note(self, job: Job) -> None:
        for note in job.listen():
            if job.id in self._owners:
                self._owners[job.id].send({"event": "note", "job": job.id, "note": note})
        if job.is_done:  # nobody has to wait for the end of its process
            self._send_end(job.describe_end(0))
        if job.lines.is_closed:
            self._selector.unregister(job.channel)

    def _collect(self) -> None:
        for job in list(self._jobs.values()):
            status = job.collect()
            if status is None:
                continue
            job.lines.is_drained = False
            while not (job.lines.is_closed or job.lines.is_drained):
                self._on_note(job)
            if not job.lines.is_closed:
                self._selector.unregister(job.channel)
            job.channel.close()
            self._on_end(job, job.describe_end(status))

    def _on_end(self, job: Job, event: Message) -> None:
        lost = event["event"] == "killed" or event["exit"] != 0
        _LOG.info("job %s: %s", job.label, event.get("reason") or f"exit code {event['exit']}")
        reporter = job.request.get("on_lost")
        if lost and reporter:
            # The event waits until the loss is reported, so that whoever receives it finds the report.
            reason = event.get("reason") or event["error"]["message"]
            args = {"args": job.request["args"], "notes": job.notes, "reason": reason}
            request = {**job.request, "function": reporter, "args": args, "on_lost": None, "detached": True}
            reporting = self._start(request)
            reporting.kill_at = time.monotonic() + _LOST_GRACE_S
            self._held_back[reporting.id] = event
        else:
            self._send_end(event)
        if job.id in self._held_back:
            self._send_end(self._held_back.pop(job.id))
        del self._jobs[job.id]

    def _send_end(self, event: Message) -> None:
        """Send the last event of a job, unless it has been sent; a client that goes meanwhile has nothing to cancel."""
        owner = self._owners.pop(event["job"], None)
        if owner is not None:
            owner.send(event)


def _loaded_sources(others: Sequence[str]) -> dict[Path, Signature]:
    """Return size and time of the source files of all loaded modules, except those of Python and installed packages.

    Args:
        others: files and folders that are watched in another way.
    """
    installed = {Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "purelib", "platlib")}
    ignored = installed | set(map(Path, others))
    files = {Path(name) for m in list(sys.modules.values()) if (name := getattr(m, "__file__", None))}
    return {file: signature(file)[:2] for file in files if ignored.isdisjoint({file, *file.parents})}
