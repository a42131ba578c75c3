"""The client of a server: `Client.ensure(spec)`, then `submit` and `wait`."""

import json
import os
import select
import socket
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonMapping
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.protocol import FirstJob, Lines, Message, encode
from bagassets.forkserver.server_files import ServerFiles, last_lines
from bagassets.forkserver.spec import SOURCE_CHANGED, ServerSpec

_ANSWER_S = 15.0
_GRACE_S = 30.0
_RETRY_S = 0.05
_START_S = 60.0


class ServerRefusedError(BagAssetsError):
    """The server is outdated or gone; `Client.ensure` finds or starts its successor."""


class Client:
    """A connection to one server; while it is open, the server does not end because it is idle.

    When the connection is closed, or its process dies, its jobs are cancelled unless they are detached.

    Attributes:
        files: files of the server.
        process: process of the server.
        is_draining: True if the server had stopped taking jobs when the connection was made.
    """

    def __init__(self, connection: socket.socket, files: ServerFiles, variables: Mapping[str, str]) -> None:
        self.files = files
        self._socket = connection
        self._variables = variables
        self._lines = Lines()
        self._events: deque[Message] = deque()
        hello = self._ask({"op": "hello"})
        self.is_draining: bool = hello["draining"]
        self.process = ProcessId.from_json(hello["process"])

    # --- finding a server ------------------------------------------------------------

    @classmethod
    def ensure(cls, spec: ServerSpec, *, timeout_s: float = _START_S) -> Self:
        """Return a client of a server for `spec`, which is started if there is none.

        Args:
            spec: the spec of the server.
            timeout_s: how long it may take to start.

        Raises:
            BagAssetsError: the server cannot start; the message ends with the last lines of its log.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            files = ServerFiles(spec.state_folder, spec.stamp())
            client = cls.connect(files, _recipe_variable(spec))
            if client is not None:
                return client
            if time.monotonic() > deadline:
                raise BagAssetsError(*_cannot_start(files, f"it did not answer within {timeout_s:.0f} s"))
            ServerStart(spec, max(1.0, deadline - time.monotonic())).wait()
            time.sleep(_RETRY_S)

    @classmethod
    def connect(cls, files: ServerFiles, variables: Mapping[str, str] | None = None) -> Self | None:
        """Return a client of the server with these files, or None if no such server takes jobs.

        Workers get `variables` in addition to the environment of this process.
        """
        path = files.socket
        if path is None:
            return None
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(_ANSWER_S)
        try:
            connection.connect(str(path))
        except OSError:
            connection.close()
            return None
        with suppress(ServerRefusedError):
            client = cls(connection, files, variables or {})
            if not client.is_draining:
                return client
        connection.close()
        return None

    @classmethod
    def all_of(cls, state_folder: Path) -> Iterator[Self]:
        """Yield a client of each server that takes jobs in this state folder, and close it afterwards."""
        for files in ServerFiles.known(state_folder.expanduser().resolve()):
            client = cls.connect(files)
            if client is not None:
                with client:
                    yield client

    # --- jobs ------------------------------------------------------------------------

    def submit(
        self,
        function: str,
        args: JsonMapping,
        *,
        label: str,
        on_lost: str | None = None,
        detached: bool = False,
        once: bool = False,
        grace_s: float = _GRACE_S,
    ) -> str:
        """Run `function(args)` in a worker of its own; return the id of the job.

        The worker has this process's environment and current folder.

        Args:
            function: `module:function`; takes one JSON object and returns JSON.
            args: the object.
            label: name of the job for people, and of its log.
            on_lost: `module:function` called in another worker with `args`, `notes` and `reason` if the
                worker was killed or failed; the event of the loss is sent after that.
            detached: the job goes on when this client is gone, and sends no events.
            once: do nothing if this server had a job with this label before; the returned id is then empty.
            grace_s: seconds before a cancelled worker is killed.

        Raises:
            ServerRefusedError: the server has stopped taking jobs.
        """
        job = {
            "function": function,
            "args": dict(args),
            "label": label,
            "on_lost": on_lost,
            "detached": detached,
            "once": once,
            "grace_s": grace_s,
            "env": {**os.environ, **self._variables},
            "cwd": str(Path.cwd()),
        }
        return str(self._ask({"op": "submit", "job": job})["job"])

    def wait(self, timeout_s: float | None = None) -> Message | None:
        """Return the next event of a job submitted here, or None after `timeout_s` seconds.

        Events are objects with `event` and `job`: `note` (`note`: what the worker noted), `finished`
        (`exit`: 0 with `result`, else `error`: type and message) and `killed` (`signal`, `reason`).

        Raises:
            ServerRefusedError: the server is gone.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._events:
            left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            if select.select([self._socket], [], [], left)[0]:
                self._receive()
            elif left == 0.0:
                return None
        return self._events.popleft()

    def cancel(self, job: str, *, grace_s: float = _GRACE_S) -> bool:
        """Ask a job to stop; it is killed after `grace_s` seconds. Return False if it has ended."""
        return bool(self._ask({"op": "cancel", "job": job, "grace_s": grace_s})["found"])

    def status(self) -> Message:
        """Return the state of the server.

        It is an object with `process`, `draining`, `clients` (the number of connections, this one counted) and `jobs`
        (job, label, function, process).
        """
        return self._ask({"op": "status"})

    # --- the server ------------------------------------------------------------------

    def drain(self) -> int:
        """Have the server end after its current jobs; return their number."""
        return int(self._ask({"op": "drain"})["jobs"])

    def shutdown(self, *, grace_s: float = _GRACE_S) -> int:
        """Have the server cancel all jobs and end; return the number of jobs."""
        return int(self._ask({"op": "shutdown", "grace_s": grace_s})["jobs"])

    def close(self) -> None:
        """End the connection; jobs that are not detached are cancelled."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, request: Message) -> Message:
        try:
            self._socket.sendall(encode(request))
        except OSError as err:
            raise ServerRefusedError(f"the fork server is gone ({err}).") from err
        while True:
            for message in self._receive():
                if message["reply"] in {"refused", "error"}:
                    raise ServerRefusedError(f"the fork server refused: {message['message']}.")
                return message

    def _receive(self) -> list[Message]:
        """Read once; keep events and return replies."""
        messages = self._lines.receive(self._socket)
        if self._lines.is_closed:
            raise ServerRefusedError(f"the fork server is gone; see {self.files.log}.")
        self._events.extend(message for message in messages if "event" in message)
        return [message for message in messages if "reply" in message]


def _recipe_variable(spec: ServerSpec) -> dict[str, str]:
    return {} if spec.recipe is None else {"BAGASSETS_RECIPE": str(spec.recipe)}


class ServerStart:
    """A server that is being started: by a process that ends when one with its stamp answers, be it this or another.

    Args:
        spec: the spec of the server.
        timeout_s: how long it may take, once it is waited for.
        first_job: `module:function` and its arguments; a server that is started here runs it while it imports what other
            jobs need. Its result is not reported.
    """

    def __init__(
        self, spec: ServerSpec, timeout_s: float = _START_S, first_job: FirstJob | None = None
    ) -> None:
        import subprocess

        self._files = files = ServerFiles(spec.state_folder, spec.stamp())
        self._timeout_s = timeout_s
        files.make()
        search = [*spec.paths, *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = dict(os.environ) | _recipe_variable(spec) | {"PYTHONPATH": os.pathsep.join(search)}
        spec_json = json.dumps(spec._asdict(), default=os.fspath)
        # -P keeps the current folder off the search path, whatever it is.
        command = [sys.executable, "-P", "-m", "bagassets.forkserver", spec_json, files.stamp, str(timeout_s)]
        if first_job is not None:
            command.append(json.dumps(first_job))
        with files.log.open("ab") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
                cwd=spec.recipe.parent if spec.recipe is not None else spec.state_folder,
                start_new_session=True,
            )

    def wait(self) -> None:
        """Return when the server answers.

        Raises:
            BagAssetsError: it cannot start.
        """
        from subprocess import TimeoutExpired

        with self._process as starter:
            try:
                code = starter.wait(self._timeout_s)
            except BaseException as err:
                starter.kill()
                if not isinstance(err, TimeoutExpired):
                    raise
                reason = f"it took longer than {self._timeout_s:.0f} s, as on a busy machine; try again"
                raise BagAssetsError(*_cannot_start(self._files, reason)) from err
        if code not in {0, SOURCE_CHANGED}:
            # Of a killed server, its starter returns what fits into a byte.
            reason = _how_it_ended(code - 256 if code > 128 else code)
            raise BagAssetsError(*_cannot_start(self._files, reason))


def _how_it_ended(code: int) -> str:
    """Return a clause about an exit code, which is negative if a signal ended the process."""
    from signal import SIGKILL, strsignal

    if code == -SIGKILL:
        return "it was killed by SIGKILL, maybe because the system ran out of memory"
    return f"it was ended by a signal ({strsignal(-code)})" if code < 0 else f"it ended with exit code {code}"


def _cannot_start(files: ServerFiles, reason: str) -> list[str]:
    title, lines = f"the fork server cannot start: {reason}", last_lines(files.log)
    if not lines:
        return [f"{title}; it wrote nothing to {files.log}. Is memory or disk space short?"]
    return [f"{title}. The last lines of {files.log}:", *(f"  {line}" for line in lines)]
