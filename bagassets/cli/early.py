"""Handing a build over to its server, or starting one, before the command line is imported, which takes a tenth of a second."""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bagassets.base.errors import BagAssetsError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.base.json_types import Json
from bagassets.engine.freshness.decide import state_folder
from bagassets.forkserver.client import Client, ServerStart
from bagassets.forkserver.tasks import find_server, server_spec
from bagassets.store.writable import require_writable

# Twice the processors keeps them busy while some workers wait for the disk; more only costs memory.
JOBS_PER_PROCESSOR = 2
# Of the table that a build prints; beyond this number, only recordings where something happened are shown.
MOST_ROWS = 60
_JOB = "bagassets.defs.builds.project_build:build_project_in_worker"
_FIRST_JOB = "bagassets.defs.builds.made_ahead:make_first"
# A build that is cancelled waits this long for its runs, which have less time to end.
GRACE_S = 40.0


class HandedOver(NamedTuple):
    """What has begun before the command line is imported: the build on its server, or that server.

    Attributes:
        began_s: when the command began, by `time.monotonic`.
        client: of the server, if it is up.
        job: the build there.
        starting: the server, if it was not up.
    """

    began_s: float
    client: Client | None = None
    job: str | None = None
    starting: ServerStart | None = None


def hand_over(recipe: str, jobs: int | None) -> HandedOver | None:
    """Have the server of a recipe begin a build of everything, or start one; None if the command line has to.

    Args:
        recipe: recipe file.
        jobs: as given in the command; None for one per processor. The command line comments on too many.
    """
    began_s = time.monotonic()
    processors = os.cpu_count() or 1
    jobs = processors if jobs is None else jobs
    if jobs > JOBS_PER_PROCESSOR * processors:
        return None
    client = None
    try:
        file = Path(recipe).absolute()
        client = find_server(file)
        if client is not None:
            return HandedOver(began_s, client, submit_build(client, file, {"jobs": jobs}, MOST_ROWS))
        return HandedOver(began_s, starting=begin_server(file, Path(state_folder(str(file)))))
    except (PlanNeeded, BagAssetsError, OSError):  # the command line meets it again, and reports it
        if client is not None:
            client.close()
    return None


def begin_server(
    recipe: Path, state: Path, bags: Sequence[str] = (), select: Sequence[str] = ()
) -> ServerStart:
    """Start the server of a recipe; it makes the first recordings of a build while it imports Dagster.

    Args:
        recipe: recipe file.
        state: its state folder.
        bags: the recordings to build (`BuildOptions.bags`).
        select: likewise, what is to be made of them.

    Raises:
        BagAssetsError: the state folder cannot be written.
    """
    require_writable(state)
    first_job = {"recipe": str(recipe), "bags": list(bags), "select": list(select)}
    return ServerStart(server_spec(state, recipe), first_job=(_FIRST_JOB, first_job))


def submit_build(client: Client, recipe: Path, options: Mapping[str, Json], most: int | None) -> str:
    """Have a server begin a build, and return the id of the job.

    Args:
        client: of the server.
        recipe: recipe file.
        options: fields of `BuildOptions` that differ from the defaults.
        most: most rows of the table in the report; None for all.

    Raises:
        ServerRefusedError: it is shutting down.
    """
    args = {"recipe": str(recipe), "options": options, "most": most}
    return client.submit(_JOB, args, label=f"build-{os.urandom(16).hex()}", grace_s=GRACE_S)
