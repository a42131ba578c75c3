"""`python -m bagassets.defs.ui.dev …`: web server, daemon and code servers, which end together with their parent process.

It is `dagster dev` with our own web server, which refuses requests of other sites. Standard input is a pipe from the
parent: when that closes the pipe, or dies, all are shut down as on Ctrl-C.
"""

import argparse
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import yaml
from dagster import DagsterInstance, serialize_value

from bagassets.defs.dagster_private import (
    ProxyServerManager,
    WorkspaceFileTarget,
    configure_loggers,
    get_ipc_shutdown_pipe,
    get_possibly_temporary_instance_for_cli,
    open_ipc_subprocess,
    send_ipc_shutdown_message,
    setup_interrupt_handlers,
)
from bagassets.defs.ui.ports import listening_arguments, listening_options

__all__ = ["main"]

_LOG = logging.getLogger("dagster")
_STDIN = 0
_OUR_LOCATION = "load_from: [{python_module: bagassets.definitions}]\n"
_POLL_S = 1.0
_STOP_S = 60.0
_PARENT_IS_GONE = threading.Event()


def main() -> None:
    """Run the services of a project until standard input ends."""
    parser = argparse.ArgumentParser(parents=[listening_options()])
    parser.add_argument("--workspace", help="a workspace.yaml; default: the code location of the project")
    options = parser.parse_args()
    # As `dagster dev` does: code servers report errors without the stack of Dagster itself.
    os.environ |= {"DAGSTER_IS_DEV_CLI": "1", "DAGSTER_verbose": ""}
    configure_loggers(formatter="colored", log_level=options.log_level.upper())
    setup_interrupt_handlers()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with (
        suppress(KeyboardInterrupt),
        get_possibly_temporary_instance_for_cli("bagassets ui", logger=_LOG) as instance,
        _code_servers(instance, options.workspace) as workspace,
    ):
        _serve(instance, options, workspace)


@contextmanager
def _code_servers(instance: DagsterInstance, workspace: str | None) -> Iterator[str]:
    """Start the code servers that web server and daemon share; yield the path of a workspace file that names them."""
    with tempfile.TemporaryDirectory() as folder:
        ours, shared = Path(folder) / "ours.yaml", Path(folder) / "workspace.yaml"
        ours.write_text(_OUR_LOCATION, encoding="utf-8")
        target = WorkspaceFileTarget(paths=[workspace or str(ours)])
        with ProxyServerManager(instance, target, code_server_log_level="warning") as servers:
            shared.write_text(yaml.dump({"load_from": servers.get_code_server_specs()}), encoding="utf-8")
            yield str(shared)


def _serve(instance: DagsterInstance, options: argparse.Namespace, workspace: str) -> None:
    """Run web server and daemon; end both when one of them ends, or this process is interrupted."""
    common = [
        "--instance-ref", serialize_value(instance.get_ref()), "--workspace", workspace,
    ]  # fmt: skip
    listen = listening_arguments(options.host, options.port, options.allow_host, options.log_level)
    if not instance.telemetry_enabled:
        # Otherwise each of them makes folders for it in the project, even if nothing is sent.
        os.environ["DAGSTER_DISABLE_TELEMETRY"] = "1"
    services: dict[str, tuple[subprocess.Popen[bytes], int]] = {}
    try:
        services["web server"] = _start("bagassets.defs.ui.webserver", [*listen, *common])
        services["daemon"] = _start(
            "bagassets.defs.ui.daemon",
            [
                *("run", "--log-level", options.log_level, "--log-format", "colored"),
                *("--code-server-log-level", "warning", *common),
            ],
        )
        while not _PARENT_IS_GONE.wait(_POLL_S):
            if ended := [name for name, (process, _) in services.items() if process.poll() is not None]:
                _LOG.error("The %s ended unexpectedly.", ended[0])
                break
    finally:
        for _, pipe in services.values():
            with suppress(OSError):  # it has ended
                send_ipc_shutdown_message(pipe)
        for process, _ in services.values():
            _wait(process)


def _start(module: str, arguments: list[str]) -> tuple[subprocess.Popen[bytes], int]:
    """Start a module as a process; return it, and the pipe for its shutdown message."""
    read_end, write_end = get_ipc_shutdown_pipe()
    command = [sys.executable, "-P", "-m", module, *arguments, "--shutdown-pipe", str(read_end)]
    return open_ipc_subprocess(command, pass_fds=[read_end]), write_end


def _wait(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _end_with_parent() -> None:
    while os.read(_STDIN, 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)
    # Python drops an interrupt that arrives in a finalizer or in the middle of an import.
    _PARENT_IS_GONE.set()


if __name__ == "__main__":
    main()
