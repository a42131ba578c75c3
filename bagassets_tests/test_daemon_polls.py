"""The daemon of `bagassets ui` looks at backfills more often than Dagster's own does."""

import logging
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
    daemon.main()
    assert started == ["daemon"]
    [ours] = pauses()
    assert 0 < ours <= daemon.BACKFILL_POLL_S < plain


def test_the_web_ui_starts_it(monkeypatch):
    started, ended = [], SimpleNamespace(poll=lambda: 0, wait=lambda _seconds: 0)

    def start(module, _arguments):
        started.append(module)
        return ended, -1

    monkeypatch.setattr(dev, "_start", start)
    monkeypatch.setattr(dev, "_POLL_S", 0)
    monkeypatch.setenv("DAGSTER_DISABLE_TELEMETRY", "1")
    options = SimpleNamespace(host="127.0.0.1", port=1, allow_host=[], log_level="error")
    with dg.instance_for_test() as instance:
        dev._serve(instance, options, "workspace.yaml")
    assert started == ["bagassets.defs.ui.webserver", daemon.__name__]
