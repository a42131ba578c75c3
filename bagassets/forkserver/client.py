"""What a process that wants jobs done talks to: `Client.ensure(spec)`, then `submit` and `wait`."""

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from bagassets.errors import BagAssetsError
from bagassets.forkserver.places import Places, last_lines
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.protocol import FirstJob, Lines, Message, encode
from bagassets.forkserver.spec import SOURCE_CHANGED, ServerSpec

__all__ = ["Client", "ServerRefusedError"]

_ANSWER_S = 15.0
_GRACE_S = 30.0
_RETRY_S = 0.05


class ServerRefusedError(BagAssetsError):
    """The server has grown old or is gone; `Client.ensure` finds or starts its successor."""


class Client:
    """A connection to one server; as long as it is open, the server does not end for idleness.

    Jobs that were not submitted as detached are cancelled when it is closed, or its process dies.

    Attributes:
        places: files of the server.
        process: the server.
        is_draining: True if it took no more jobs when the connection was made.
    """

    def __init__(self, connection: socket.socket, places: Places, variables: Mapping[str, str]) -> None:
        self.places = places
        self._socket = connection
        self._variables = variables
        self._lines = Lines()
        self._events: deque[Message] = deque()
        hello = self._ask({"op": "hello"})
        self.is_draining: bool = hello["draining"]
        self.process = ProcessId.from_json(hello["process"])

    # --- finding a server ------------------------------------------------------------

    @classmethod
    def ensure(cls, spec: ServerSpec, *, timeout_s: float = 60.0, first_job: FirstJob | None = None) -> Self:
        """Return a client of a server for `spec`, which is started if there is none.

        Args:
            spec: what it must be like.
            timeout_s: how long it may take to start.
            first_job: `module:function` and its arguments, for a server that is started here to work on while
                it imports what other jobs need; nobody is told how it ends.

        Raises:
            BagAssetsError: the server cannot start; the message ends with the last lines of its log.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            places = Places(spec.state_folder, spec.stamp())
            client = cls.connect(places, _recipe_variable(spec))
            if client is not None:
                return client
            if time.monotonic() > deadline:
                raise BagAssetsError(*_cannot_start(places, f"it did not answer within {timeout_s:.0f} s"))
            _start(spec, places, max(1.0, deadline - time.monotonic()), first_job)
            time.sleep(_RETRY_S)

    @classmethod
    def connect(cls, places: Places, variables: Mapping[str, str] | None = None) -> Self | None:
        """Return a client of the server at `places`, or None if there is none that takes jobs.

        Workers get `variables` besides the environment of this process.
        """
        path = places.socket
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
            client = cls(connection, places, variables or {})
            if not client.is_draining:
                return client
        connection.close()
        return None

    @classmethod
    def all_of(cls, state_folder: Path) -> Iterator[Self]:
        """Yield a client of each server that takes jobs in this state folder, and close it afterwards."""
        for places in Places.known(state_folder.expanduser().resolve()):
            client = cls.connect(places)
            if client is not None:
                with client:
                    yield client

    # --- jobs ------------------------------------------------------------------------

    def submit(
        self,
        function: str,
        args: Mapping[str, Any],
        *,
        label: str,
        on_lost: str | None = None,
        detached: bool = False,
        once: bool = False,
        grace_s: float = _GRACE_S,
    ) -> str:
        """Have `function(args)` called in a worker of its own; return the name of the job.

        The worker has this process's environment and current folder.

        Args:
            function: `module:function`; takes one JSON object and returns JSON.
            args: the object.
            label: name of the job for people, and of its log.
            on_lost: `module:function` called in another worker with `args`, `notes` and `reason` if the
                worker was killed or failed; the event that tells of it comes after that.
            detached: the job goes on when this client is gone, and no events tell of it.
            once: do nothing if this server had a job with this label before; the job is then unnamed.
            grace_s: seconds a cancelled worker has before it is killed.

        Raises:
            ServerRefusedError: the server takes no jobs any more.
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

        Events are objects with `event` and `job`: `note` (`note`: facts the worker told), `finished`
        (`exit`: 0 with `result`, else `error`: type, message and traceback) and `killed` (`signal`, `reason`).

        Raises:
            ServerRefusedError: the server is gone.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._events:
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0 and not select.select([self._socket], [], [], 0)[0]:
                return None
            if select.select([self._socket], [], [], left)[0]:
                self._receive()
        return self._events.popleft()

    def fileno(self) -> int:
        """Return the descriptor that is readable when events come, for `select`."""
        return self._socket.fileno()

    def cancel(self, job: str, *, grace_s: float = _GRACE_S) -> bool:
        """Ask a job to stop; it is killed after `grace_s` seconds. Return False if it has ended."""
        return bool(self._ask({"op": "cancel", "job": job, "grace_s": grace_s})["found"])

    def status(self) -> Message:
        """Return the state of the server.

        It is an object with `stamp`, `process`, `draining`, `clients` (the number of connections, this
        one counted) and `jobs` (job, label, function, process, seconds, notes, cancelled).
        """
        return self._ask({"op": "status"})

    # --- the server ------------------------------------------------------------------

    def drain(self) -> int:
        """Let the server end after the jobs it has; return their number."""
        return int(self._ask({"op": "drain"})["jobs"])

    def shutdown(self, *, grace_s: float = _GRACE_S) -> int:
        """Cancel all jobs and end the server; return the number of jobs."""
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
        """Read once; keep events and return answers."""
        messages = self._lines.receive(self._socket)
        if self._lines.is_closed:
            raise ServerRefusedError(f"the fork server is gone; see {self.places.log}.")
        self._events.extend(message for message in messages if "event" in message)
        return [message for message in messages if "reply" in message]


def _recipe_variable(spec: ServerSpec) -> dict[str, str]:
    return {} if spec.recipe is None else {"BAGASSETS_RECIPE": str(spec.recipe)}


def _start(spec: ServerSpec, places: Places, timeout_s: float, first_job: FirstJob | None) -> None:
    """Start a server and return when it, or another with its stamp, answers."""
    with _starter(spec, places, timeout_s, first_job) as starter:
        try:
            code = starter.wait(timeout_s)
        except subprocess.TimeoutExpired as err:
            starter.kill()
            raise BagAssetsError(*_cannot_start(places, f"it took longer than {timeout_s:.0f} s")) from err
        except BaseException:
            starter.kill()
            raise
    if code not in {0, SOURCE_CHANGED}:
        raise BagAssetsError(*_cannot_start(places, f"it ended with exit code {code}"))


def _starter(
    spec: ServerSpec, places: Places, timeout_s: float, first_job: FirstJob | None
) -> "subprocess.Popen[bytes]":
    """Return a process that starts a server and ends when one with its stamp answers."""
    places.make()
    search = [*spec.paths, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = dict(os.environ) | _recipe_variable(spec) | {"PYTHONPATH": os.pathsep.join(search)}
    spec_json = json.dumps(spec.as_json())
    # -P keeps the current folder off the search path, whatever it is.
    command = [sys.executable, "-P", "-m", "bagassets.forkserver", spec_json, places.stamp, str(timeout_s)]
    if first_job is not None:
        command.append(json.dumps(first_job))
    with places.log.open("ab") as log:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
            cwd=spec.recipe.parent if spec.recipe is not None else spec.state_folder,
            start_new_session=True,
        )


def _cannot_start(places: Places, reason: str) -> list[str]:
    lines = last_lines(places.log)
    told = f"the fork server cannot start: {reason}. The last lines of {places.log}:"
    return [told, *(f"  {line}" for line in lines)] if lines else [f"{told} it is empty; is the disk full?"]
