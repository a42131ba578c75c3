"""A code server for launchers that need one: Dagster's default launcher does, most others do not.

The web server and the daemon have code servers of their own; a build starts one only when its launcher first asks for
it. It runs in a session of its own, so that it survives Ctrl-C and the death of the build: it then ends by itself, once
heartbeats stay away and the runs that it executes are done.
"""

import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.defs.dagster_private import (
    BaseWorkspaceRequestContext,
    DagsterGrpcClient,
    DagsterUserCodeUnreachableError,
    GrpcServerTarget,
    WorkspaceProcessContext,
)
from bagassets.defs.records.instances import pack_instance
from bagassets.defs.runs.execution import CodeLocation
from bagassets.forkserver.server_files import last_lines

_START_S = 120.0
_POLL_S = 0.05
_HEARTBEAT_S = 5.0
_SURVIVES_S = 30  # without a heartbeat
_STOP_S = 10.0


@dataclass
class LaunchWorkspace:
    """The workspace that a run launcher is handed; its code server is started on first use.

    Attributes:
        instance: instance whose runs are launched.
        location: their code location.
        log: log file of the code server.
    """

    instance: dg.DagsterInstance
    location: CodeLocation
    log: Path
    _mutex: threading.Lock = field(default_factory=threading.Lock)
    _stack: ExitStack = field(default_factory=ExitStack)
    _context: "BaseWorkspaceRequestContext | None" = None

    def close(self) -> None:
        """End the code server, if there is one."""
        self._stack.close()

    def for_launcher(self) -> BaseWorkspaceRequestContext:
        """Return the workspace for `DagsterInstance.launch_run`; using it starts the code server."""
        return cast("BaseWorkspaceRequestContext", _Deferred(self._started))

    def _started(self) -> BaseWorkspaceRequestContext:
        with self._mutex:
            if self._context is None:
                self._context = self._start()
            return self._context

    def _start(self) -> BaseWorkspaceRequestContext:
        folder = Path(tempfile.mkdtemp(prefix="bagassets-"))  # short: a socket's path may have 100 bytes
        self._stack.callback(shutil.rmtree, folder, ignore_errors=True)
        socket = str(folder / "code.sock")
        module, name = self.location.module, self.location.name or self.location.module
        command = [
            *(sys.executable, "-m", "dagster", "api", "grpc", "--socket", socket, "--log-level", "warning"),
            *("--heartbeat", "--heartbeat-timeout", str(_SURVIVES_S), "--location-name", name),
            *("--instance-ref", pack_instance(self.instance)),
            *("-m", module, "-a", self.location.attribute),
            *("-d", self.location.working_directory or str(Path.cwd())),
        ]
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("wb") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        self._stack.callback(_end, process)
        client = DagsterGrpcClient(socket=socket)
        self._wait_for(client, process)
        ended = threading.Event()
        self._stack.callback(ended.set)
        threading.Thread(target=_send_heartbeats, args=(client, ended), daemon=True).start()
        target = GrpcServerTarget(host="localhost", port=None, socket=socket, location_name=name)
        return self._stack.enter_context(
            WorkspaceProcessContext(self.instance, target)
        ).create_request_context()

    def _wait_for(self, client: DagsterGrpcClient, process: "subprocess.Popen[bytes]") -> None:
        deadline = time.monotonic() + _START_S
        while True:
            with suppress(DagsterUserCodeUnreachableError):
                client.ping("")
                return
            if process.poll() is not None or time.monotonic() > deadline:
                tail = "".join(f"\n  {line}" for line in last_lines(self.log)) or " it is empty"
                raise BagAssetsError(
                    f"the code server that this run launcher needs did not start; the last lines of {self.log}:{tail}"
                )
            time.sleep(_POLL_S)


class _Deferred:
    """Stands for an object that is made when one of its attributes is first read."""

    def __init__(self, make: Callable[[], object]) -> None:
        self._make = make

    def __getattr__(self, name: str) -> Any:
        return getattr(self._make(), name)


def _send_heartbeats(client: DagsterGrpcClient, ended: threading.Event) -> None:
    while not ended.wait(_HEARTBEAT_S):
        with suppress(DagsterUserCodeUnreachableError):
            client.heartbeat("")


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
