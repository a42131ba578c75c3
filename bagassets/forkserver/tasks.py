"""The jobs that this project submits to its fork server, by name, so that no client imports Dagster.

`instance` is the Dagster home of the recipe, or text from `bagassets.defs.records.instances.pack_instance`.
The label of a run's job is the run id, so the worker's output is in `ServerFiles.job_log(run_id)`.
"""

import hashlib
import os
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.base.lock_files import RUN_LOCKS
from bagassets.engine.freshness.decide import state_folder
from bagassets.forkserver.client import Client
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.spec import IDLE_TIMEOUT_S, ServerSpec

DEFINITIONS = "bagassets.definitions"
_WORKER = "bagassets.defs.launchers.run_worker"
END_WORKER = f"{_WORKER}:end_worker"
_MINUTES = "BAGASSETS_SERVER_MINUTES"
_LEAST_S = 1.0


def server_spec(
    state_folder: Path,
    recipe: Path | None,
    *,
    modules: tuple[str, ...] = (DEFINITIONS,),
    paths: tuple[str, ...] = (),
    idle_timeout_s: float | None = None,
    recipes: tuple[Path, ...] = (),
) -> ServerSpec:
    """Return the spec of a server that has Dagster and the definitions imported.

    For the arguments see `ServerSpec`; `idle_timeout_s` is by default what the variable BAGASSETS_SERVER_MINUTES says.

    Raises:
        BagAssetsError: a module cannot be found, or the variable is no number.
    """
    spec = ServerSpec(state_folder, recipe, modules, paths, f"{_WORKER}:preload", recipes=recipes)
    return spec._replace(
        idle_timeout_s=_idle_timeout_s() if idle_timeout_s is None else idle_timeout_s
    ).located()


def find_server(recipe: Path) -> Client | None:
    """Return a client of the server for a recipe, or None if no such server is up.

    The recipe is not read: the stamp of the server covers its text.
    """
    try:
        spec = server_spec(Path(state_folder(str(recipe))), recipe)
        return Client.connect(
            ServerFiles(spec.state_folder, spec.stamp()), {"BAGASSETS_RECIPE": os.fspath(recipe)}
        )
    except (PlanNeeded, OSError, BagAssetsError):
        return None


def _idle_timeout_s() -> float:
    text = os.environ.get(_MINUTES)
    if not text:
        return IDLE_TIMEOUT_S
    try:
        # One that ends at once would be gone before the first job comes.
        return max(_LEAST_S, float(text) * 60.0)
    except ValueError:
        raise BagAssetsError(
            f"{_MINUTES}={text}: how many minutes the server of a project stays up without work; a number is expected."
        ) from None


def connect(spec: ServerSpec, instance: str) -> Client:
    """Return a client of a server for `spec`, which is started if there is none.

    Each server reports once the runs whose workers died with an earlier server.

    Raises:
        BagAssetsError: the server cannot start.
    """
    client = Client.ensure(spec)
    name = hashlib.sha256(instance.encode()).hexdigest()[:12]
    args = {"instance": instance, "locks": _locks(client)}
    client.submit(f"{_WORKER}:recover", args, label=f"recover-{name}", detached=True, once=True)
    return client


def submit_run(client: Client, instance: str, run_id: str, *, detached: bool = False) -> str:
    """Submit an existing run for execution; return the id of the job.

    The job's result says how the run ended: SUCCESS, FAILURE or CANCELED.

    Args:
        client: client of a server.
        instance: the Dagster instance that has the run.
        run_id: id of the run.
        detached: the run goes on when this client is gone.
    """
    args = {"instance": instance, "run_id": run_id, "locks": _locks(client)}
    return client.submit(
        f"{_WORKER}:execute", args, label=run_id, on_lost=f"{_WORKER}:report_lost", detached=detached
    )


def _locks(client: Client) -> str:
    return str(client.files.state_folder / RUN_LOCKS)
