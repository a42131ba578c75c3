"""The web server and the daemon of a project, as child processes.

Only these processes import Dagster; this module does not.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

from bagassets.base.errors import BagAssetsError
from bagassets.base.lock_files import LockFile
from bagassets.defs.ui.ports import answers, reachable, refuse_taken_port, url_of
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.tasks import connect, server_spec
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe

_POLL_S = 0.2
_START_S = 120.0
_STOP_S = 60.0
_GRACE_S = 10.0
_LEAVE_S = 2.0
_CODE_SERVER_S = 0.5  # it has nothing to lose
_LOCK = "ui.lock"


class Services:
    """Web server and daemon of a recipe, started by the constructor.

    The fork servers started for its runs belong to it as well. Servers that were up before belong to somebody else, and
    are left running.

    Args:
        recipe_file: the recipe.
        host: address to listen on.
        port: port to listen on.
        verbose: have Dagster log what it does, not just warnings and errors.
        allow_hosts: further names by which browsers reach the web server.

    Raises:
        BagAssetsError: the recipe is wrong, its UI is open already, or the port is taken.
    """

    def __init__(
        self,
        recipe_file: Path,
        host: str,
        port: int,
        *,
        verbose: bool = False,
        allow_hosts: Sequence[str] = (),
    ) -> None:
        recipe_file = recipe_file.resolve()
        recipe = load_recipe(recipe_file)
        home = dagster_home(recipe_file, recipe).resolve()
        self.url = url_of(host, port)
        self._lock = _lock(recipe.state, self.url)
        try:
            refuse_taken_port(host, port)
        except BagAssetsError:
            self._lock.close()
            raise
        self._address = (reachable(host), port)
        self._state = recipe.state
        self._servers_before = {files.stamp for files in _alive(recipe.state)}
        self._recipe_file, self._home = recipe_file, home
        self._client: Client | None = None
        self._warming = threading.Thread(target=self._warm, daemon=True)
        workspace = home / "workspace.yaml"
        options = [f"--allow-host={name}" for name in allow_hosts]
        options += ["--workspace", str(workspace)] if workspace.is_file() else []
        # A session of its own: Ctrl-C in the terminal reaches only us, and we end it in order.
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-P", "-m", "bagassets.defs.ui.dev", "--host", host, "--port", str(port)),
                *("--log-level", "info" if verbose else "warning", *options),
            ],
            stdin=subprocess.PIPE,
            cwd=home,
            # gRPC notes on the terminal now and then that the other end of a connection has ended.
            env={"GRPC_VERBOSITY": "ERROR"}
            | os.environ
            | {"DAGSTER_HOME": str(home), "BAGASSETS_RECIPE": str(recipe_file)},
            start_new_session=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def is_running(self) -> bool:
        """True until the processes have ended."""
        return self._process.poll() is None

    def wait_until_ready(self, give_up: Callable[[], bool]) -> None:
        """Return when the web server answers, or `give_up` returns True.

        Raises:
            BagAssetsError: it ended, or did not answer for two minutes.
        """
        deadline = time.monotonic() + _START_S
        while not (give_up() or answers(*self._address)):
            if not self.is_running:
                raise BagAssetsError(
                    "the web UI ended before it answered; its messages above say why (more of them with --verbose)."
                )
            if time.monotonic() > deadline:
                raise BagAssetsError(
                    f"the web UI did not answer at {self.url} within {_START_S:.0f} s; try again with --verbose."
                )
            time.sleep(_POLL_S)

    def warm_up(self) -> None:
        """Start a fork server for the first run and keep it up until the end; returns at once."""
        self._warming.start()

    def _warm(self) -> None:
        # If no server can start, each run reports that itself.
        with suppress(BagAssetsError):
            self._client = connect(server_spec(self._state, self._recipe_file), str(self._home))

    def stop(self) -> None:
        """End web server, daemon and code server; active runs continue."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        end_group(self._process.pid)
        self._lock.close()

    def end_runs(self, on_wait: Callable[[int], None], *, cancel: Callable[[], bool]) -> None:
        """End the fork servers started meanwhile, once the runs they execute have ended.

        Args:
            on_wait: called once, with the number of active runs, if there are any.
            cancel: called five times a second; True cancels the runs.
        """
        if self._warming.is_alive():
            self._warming.join()
        if self._client is not None:
            self._client.close()
        ours = [files for files in _alive(self._state) if files.stamp not in self._servers_before]
        end_servers(ours, on_wait, cancel=cancel)


def end_group(group: int) -> None:
    """End the remaining processes of a group; Dagster's code server would take up to a minute by itself.

    They were told to end already. A signal that they handle would interrupt that, and have them print a traceback.
    """
    deadline = time.monotonic() + _CODE_SERVER_S
    with suppress(ProcessLookupError):  # no process is left
        while time.monotonic() < deadline:
            os.killpg(group, 0)
            time.sleep(_POLL_S / 4)
        os.killpg(group, signal.SIGKILL)


def end_servers(
    servers: Iterable[ServerFiles], on_wait: Callable[[int], None], *, cancel: Callable[[], bool]
) -> None:
    """End fork servers without other clients, once their jobs are done.

    Args:
        servers: files of the servers.
        on_wait: called once, with the number of jobs that are still running, if there are any.
        cancel: called five times a second; True cancels the jobs.
    """
    has_reported = False
    for files in servers:
        client = Client.connect(files)
        if client is None:
            continue
        with client, suppress(ServerRefusedError):  # it has ended
            if not _is_left_alone(client):
                continue  # a build uses it, too
            is_cancelled = False
            running = client.drain()
            while running:
                if not has_reported:
                    on_wait(running)
                    has_reported = True
                if not is_cancelled and cancel():
                    is_cancelled = True
                    client.shutdown(grace_s=_GRACE_S)
                time.sleep(_POLL_S)
                running = len(client.status()["jobs"])


def _is_left_alone(client: Client) -> bool:
    """Return whether no other client is connected; waits a little, since those that just ended may still be counted."""
    deadline = time.monotonic() + _LEAVE_S
    while client.status()["clients"] > 1:
        if time.monotonic() > deadline:
            return False
        time.sleep(_POLL_S)
    return True


def _lock(state: Path, url: str) -> LockFile:
    """Lock the state folder against a second daemon; the lock file holds the URL of this one."""
    try:
        lock = LockFile.open(state / _LOCK)
    except OSError as err:
        raise BagAssetsError(f"{state}: the state folder cannot be written ({err.strerror}).") from err
    if not lock.try_lock():
        with lock:
            raise BagAssetsError(
                f"the web UI of this project is running already at {lock.read().strip()}; use that one, or end it first (Ctrl-C "
                "where it runs)."
            )
    lock.write(url)
    return lock


def _alive(state: Path) -> list[ServerFiles]:
    return [client.files for client in Client.all_of(state)]
