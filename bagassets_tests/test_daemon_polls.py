"""The daemon of `bagassets ui` looks at backfills more often than Dagster's own does."""

import logging
from types import SimpleNamespace

import dagster as dg
from dagster._daemon import cli, controller
from dagster._daemon.backfill import execute_backfill_iteration_loop

from bagassets.defs import daemon


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
