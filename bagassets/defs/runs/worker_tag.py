"""The tag that says which process executes a run.

Re-executing a run copies the tags of its parent. So the tag names its own run as well, and a tag that names another
run is ignored.
"""

import json
import os
from dataclasses import dataclass

import dagster as dg

from bagassets.forkserver.process import ProcessId

# Dagster hides tags with this prefix in its list of runs, where nobody wants to read JSON.
WORKER_TAG = ".dagster/bagassets_worker"
WHERE_TAG = "bagassets/where"
"""Where a run waits or is executed, as text to show; only some launchers set it."""


@dataclass(frozen=True)
class RunWorker:
    """The worker that executes a run.

    Attributes:
        run_id: the run.
        server: the fork server that watches the worker.
        process: the worker; None until it has opened the instance.
    """

    run_id: str
    server: ProcessId
    process: ProcessId | None = None

    @classmethod
    def here(cls, run_id: str) -> "RunWorker":
        """Return this process, a child of its server, as the worker of a run."""
        return cls(run_id, ProcessId.of(os.getppid()), ProcessId.current())

    def tags(self) -> dict[str, str]:
        """Return the tag to put on the run."""
        value = {
            "run_id": self.run_id,
            "server": self.server.as_json(),
            "process": self.process and self.process.as_json(),
        }
        return {WORKER_TAG: json.dumps(value, sort_keys=True)}

    @classmethod
    def of(cls, run: dg.DagsterRun) -> "RunWorker | None":
        """Return the worker that executes `run`, or None if it is not one of ours."""
        try:
            value = json.loads(run.tags[WORKER_TAG])
            process = value["process"]
            worker = cls(
                value["run_id"],
                ProcessId.from_json(value["server"]),
                None if process is None else ProcessId.from_json(process),
            )
        except (KeyError, TypeError, ValueError):
            return None
        return worker if worker.run_id == run.run_id else None

    @property
    def is_on_this_host(self) -> bool:
        """True if this machine can check whether the worker is alive."""
        return (self.process or self.server).is_on_this_host

    def is_alive(self) -> bool:
        """Return whether the worker runs, or is about to be forked."""
        return (self.process or self.server).is_alive()

    def is_watched(self) -> bool:
        """Return whether a server is up that notices when the worker ends."""
        return self.server.is_alive()

    def __str__(self) -> str:
        return str(self.process) if self.process is not None else f"a child of {self.server}"
