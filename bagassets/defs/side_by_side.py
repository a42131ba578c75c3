"""Runs on the workers of a server, a limited number at a time."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from bagassets.engine.build_report import Event
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.tasks import submit_build

__all__ = ["Ended", "Listener", "Runs"]

SUCCESS = "SUCCESS"
_CANCEL_GRACE_S = 20.0
_POLL_S = 0.5

Listener = Callable[[Event], None]


@dataclass(frozen=True)
class Ended:
    """How one run ended: its id, why it failed (None if it did not), whether it was stopped."""

    run_id: str
    problem: str | None
    stopped: bool
    seconds: float


@dataclass
class Runs:
    """Runs on the workers of a server, a limited number at a time."""

    connect: Callable[[], Client]
    home: str
    jobs: int
    on_event: Listener
    ended: dict[str, Ended] = field(default_factory=dict)
    interrupted: bool = False
    _running: dict[str, tuple[str, str, float]] = field(default_factory=dict)
    _client: Client | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._client is not None:
            self._client.close()

    def work(self, todo: Mapping[str, tuple[str, ...]]) -> None:
        """Run the assets of each recording; the key of unpartitioned assets is empty.

        On an interrupt the runs are cancelled and their end is awaited; a second one does not wait.
        """
        waiting = list(todo.items())[::-1]
        try:
            while waiting or self._running:
                while waiting and len(self._running) < self.jobs and self._start(*waiting[-1]):
                    waiting.pop()
                self._take(None)
        except KeyboardInterrupt:
            self.interrupted = True
            self._stop()
            for key, _ in waiting:
                self.ended.setdefault(key, Ended("", None, stopped=True, seconds=0.0))

    def _start(self, key: str, assets: tuple[str, ...]) -> bool:
        """Start a run; return False if it has to wait for the others.

        A server whose code or recipe was edited meanwhile ends the runs it has and takes no more; those
        that follow go to its successor.
        """
        self._client = self._client or self.connect()
        try:
            job, run_id = submit_build(self._client, self.home, assets, partition_key=key or None)
        except ServerRefusedError:
            if self._running:
                return False
            self._client.close()
            self._client = self.connect()
            job, run_id = submit_build(self._client, self.home, assets, partition_key=key or None)
        self._running[job] = (key, run_id, time.monotonic())
        self.on_event(Event("started", key))
        return True

    def _stop(self) -> None:
        if self._client is None:
            return
        for job in self._running:
            self._client.cancel(job, grace_s=_CANCEL_GRACE_S)
        deadline = time.monotonic() + _CANCEL_GRACE_S + 5.0
        while self._running and time.monotonic() < deadline:
            self._take(_POLL_S)

    def _take(self, timeout_s: float | None) -> None:
        """Wait for one event and note the end of a run."""
        event = None if self._client is None else self._client.wait(timeout_s)
        if event is None or event["event"] not in {"finished", "killed"} or event["job"] not in self._running:
            return
        key, run_id, since = self._running.pop(event["job"])
        problem = _problem(event)
        stopped = problem is not None and self.interrupted
        self.ended[key] = Ended(run_id, problem, stopped, time.monotonic() - since)
        if stopped:
            self.on_event(Event("stopped", key))
        elif problem is not None:
            self.on_event(Event("failed", key, problem))
        else:
            self.on_event(Event("done", key))


def _problem(event: dict[str, Any]) -> str | None:
    """Return why a run failed, in words, or None if it succeeded."""
    if event["event"] == "killed":
        return str(event["reason"])
    if event["exit"] != 0:
        return str(event["error"]["message"])
    result = event["result"]
    if result["status"] == SUCCESS:
        return None
    messages = [failure["message"] for failure in result["failures"] if failure["message"]]
    return messages[0] if messages else f"run {result['run_id']} ended {result['status']}"
