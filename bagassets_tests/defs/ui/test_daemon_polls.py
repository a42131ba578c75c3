"""The daemon of `bagassets ui` looks at backfills more often than Dagster's own does."""

import logging
import subprocess
import sys
from types import SimpleNamespace

import dagster as dg
from dagster._daemon import cli, controller
from dagster._daemon.backfill import execute_backfill_iteration_loop

from bagassets.defs.ui import daemon, dev


def pauses(number=1):
    """Run the loop of the backfill daemon; return how long it waits between its looks."""
    waited = []
    with dg.DagsterInstance.ephemeral() as instance:
        loop = execute_backfill_iteration_loop(
            SimpleNamespace(instance=instance), logging.getLogger("test"), SimpleNamespace(wait=waited.append)
        )
        while len(waited) < number:
            next(loop)
    return waited


def test_backfills_are_looked_at_as_often_as_sensors(monkeypatch):
    monkeypatch.setattr(controller, "DEFAULT_DAEMON_INTERVAL_SECONDS", 30)
    [plain] = pauses()
    assert 20 < plain <= 30
    started = []
    monkeypatch.setattr(cli, "main", lambda: started.append("daemon"))
    monkeypatch.setattr(daemon, "end_with_parent", lambda: started.append("with its parent"))
    daemon.main()
    assert started == ["with its parent", "daemon"]
    [ours] = pauses()
    assert 0 < ours <= daemon.BACKFILL_POLL_S < plain


def test_the_web_ui_starts_it_and_ends_it(monkeypatch):
    monkeypatch.setenv("DAGSTER_DISABLE_TELEMETRY", "1")
    waits = [sys.executable, "-c", "import sys; sys.stdin.read()"]
    started, start = [], subprocess.Popen
    monkeypatch.setattr(
        subprocess, "Popen", lambda command, **kw: started.append(command) or start(waits, **kw)
    )
    with dg.instance_for_test() as instance:
        with dev._daemon(instance, "workspace.yaml", "error") as process:
            assert process.poll() is None
        assert process.returncode == 0
    assert daemon.__name__ in started[0]
