"""`python -m bagassets.defs.ui.dev …`: the web server, with the code servers and the daemon that end together with it.

It is `dagster dev` with our own web server, which refuses requests of other sites.
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
from contextlib import contextmanager
from pathlib import Path

import uvicorn
import yaml
from dagster import DagsterInstance, serialize_value

from bagassets.defs.dagster_private import ProxyServerManager, WorkspaceFileTarget, configure_loggers
from bagassets.defs.ui.parent import end_after, end_with_parent
from bagassets.defs.ui.webserver import web_server

_LOG = logging.getLogger("dagster")
_OUR_LOCATION = "load_from: [{python_module: bagassets.definitions}]\n"
_POLL_S = 1.0
_STOP_S = 60.0


def main() -> None:
    """Serve a project until the parent ends."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", required=True, type=int)
    parser.add_argument("--allow-host", action="append", default=[])
    parser.add_argument("--log-level", required=True)
    parser.add_argument("--workspace", help="a workspace.yaml; default: the code location of the project")
    options = parser.parse_args()
    # As `dagster dev` does: code servers report errors without the stack of Dagster itself.
    os.environ |= {"DAGSTER_IS_DEV_CLI": "1", "DAGSTER_verbose": ""}
    configure_loggers(formatter="colored", log_level=options.log_level.upper())
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent_is_gone = end_with_parent()
    with (
        DagsterInstance.get() as instance,
        _code_servers(instance, options.workspace) as workspace,
        _daemon(instance, workspace, options.log_level) as daemon,
        web_server(instance, workspace, options.host, options.port, options.allow_host) as server,
    ):
        threading.Thread(target=_end, args=(server, daemon, parent_is_gone), daemon=True).start()
        server.run()


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


@contextmanager
def _daemon(instance: DagsterInstance, workspace: str, log_level: str) -> Iterator["subprocess.Popen[bytes]"]:
    """Run Dagster's daemon beside the block."""
    if not instance.telemetry_enabled:
        # Otherwise it and the web server make folders for it in the project, even if nothing is sent.
        os.environ["DAGSTER_DISABLE_TELEMETRY"] = "1"
    command = [
        *(sys.executable, "-P", "-m", "bagassets.defs.ui.daemon", "run"),
        *("--log-level", log_level, "--log-format", "colored", "--code-server-log-level", "warning"),
        *("--instance-ref", serialize_value(instance.get_ref()), "--workspace", workspace),
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _end(server: uvicorn.Server, daemon: "subprocess.Popen[bytes]", parent_is_gone: threading.Event) -> None:
    """End the web server when the daemon ends, or the parent."""
    while not parent_is_gone.wait(_POLL_S):
        if daemon.poll() is not None:
            _LOG.error("The daemon ended unexpectedly.")
            break
    server.should_exit = True


if __name__ == "__main__":
    end_after(main)
