"""The jobs that this project gives to its fork server, named so that no client imports Dagster.

`instance` is the Dagster home of the recipe, or what `bagassets.defs.runs.pack_instance` wrote.
A run's id is its job's label, so the worker's output is in `Places.job_log(run_id)`.
"""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4

from bagassets.forkserver.client import Client
from bagassets.forkserver.spec import IDLE_TIMEOUT_S, ServerSpec

__all__ = ["DEFINITIONS", "END_WORKER", "connect", "server_spec", "submit_build", "submit_run"]

DEFINITIONS = "bagassets.definitions"
_WORKER = "bagassets.defs.run_worker"
END_WORKER = f"{_WORKER}:end_worker"


def server_spec(
    state_folder: Path,
    recipe: Path | None,
    *,
    modules: tuple[str, ...] = (DEFINITIONS,),
    paths: tuple[str, ...] = (),
    idle_timeout_s: float = IDLE_TIMEOUT_S,
) -> ServerSpec:
    """Return the spec of a server that has Dagster and the definitions imported.

    Raises:
        BagAssetsError: a module cannot be found.
    """
    return ServerSpec.of(
        state_folder,
        recipe,
        modules=modules,
        paths=paths,
        preload=f"{_WORKER}:preload",
        idle_timeout_s=idle_timeout_s,
    )


def connect(spec: ServerSpec, instance: str, *, timeout_s: float = 60.0) -> Client:
    """Return a client of a server for `spec`, started if need be.

    Once in its life a server reports the runs whose workers died with a former server.

    Raises:
        BagAssetsError: the server cannot start.
    """
    client = Client.ensure(spec, timeout_s=timeout_s)
    name = hashlib.sha256(instance.encode()).hexdigest()[:12]
    args = {"instance": instance, "locks": _locks(client)}
    client.submit(f"{_WORKER}:recover", args, label=f"recover-{name}", detached=True, once=True)
    return client


def submit_build(
    client: Client,
    instance: str,
    assets: Iterable[str],
    *,
    partition_key: str | None = None,
    tags: Mapping[str, str] | None = None,
    location: Mapping[str, str] | None = None,
) -> tuple[str, str]:
    """Have a run of `assets` created and executed at once; return the job and the run's id.

    The job's result is `{"run_id", "status", "failures": [{"step", "error", "message"}]}`. The run does
    not exist before the worker created it, nor if it could not (no such asset or partition).

    Args:
        client: a server's.
        instance: where runs are kept.
        assets: asset keys.
        partition_key: partition of those assets that have partitions.
        tags: tags of the run.
        location: `module`, `attribute`, `name` and `working_directory` of the code location, if not ours.
    """
    run_id = str(uuid4())
    args: dict[str, Any] = {
        "instance": instance,
        "run_id": run_id,
        "assets": list(assets),
        "partition_key": partition_key,
        "tags": dict(tags or {}),
        "location": dict(location or {}),
        "locks": _locks(client),
    }
    job = client.submit(f"{_WORKER}:build", args, label=run_id, on_lost=f"{_WORKER}:report_lost")
    return job, run_id


def submit_run(client: Client, instance: str, run_id: str, *, detached: bool = False) -> str:
    """Have a run executed that exists; return the job, whose result is that of `submit_build`."""
    args = {"instance": instance, "run_id": run_id, "locks": _locks(client)}
    return client.submit(
        f"{_WORKER}:execute", args, label=run_id, on_lost=f"{_WORKER}:report_lost", detached=detached
    )


def _locks(client: Client) -> str:
    return str(client.places.folder / "locks")
