"""Having a build made by the fork server, which has imported what a build needs.

A server that is to be started imports Dagster once, for all builds until it ends; were the driver in
this process, both would.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from uuid import uuid4

from bagassets.build.build_report import BuildOptions, Event
from bagassets.errors import BagAssetsError
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.tasks import server_spec
from bagassets.json_types import JsonObject
from bagassets.store.writable import require_writable

__all__ = ["InterruptedBuildError", "build_on_server", "find_server", "server_for"]

_JOB = "bagassets.defs.project_build:build_project_in_worker"
_AHEAD = "bagassets.defs.early_inventories:make_inventories"
# A driver that was asked to stop waits this long for its runs; they have less.
_GRACE_S = 40.0


class InterruptedBuildError(BagAssetsError):
    """A build was interrupted before it could tell what it did."""


def find_server(recipe: Path) -> Client | None:
    """Return a client of the server that fits a recipe, if one is up; none is started.

    The recipe is not read: a server with its stamp has read this very text.
    """
    from bagassets.freshness.decide import state_folder
    from bagassets.freshness.fingerprints import PlanNeeded

    try:
        spec = server_spec(Path(state_folder(str(recipe))), recipe)
        return Client.connect(
            ServerFiles(spec.state_folder, spec.stamp()), {"BAGASSETS_RECIPE": os.fspath(recipe)}
        )
    except (PlanNeeded, OSError, BagAssetsError):
        return None


def server_for(recipe: Path, bags: Sequence[str]) -> Client:
    """Return a client of the server that fits a recipe; one is started if there is none.

    Args:
        recipe: recipe file.
        bags: which recordings are going to be built (`BuildOptions.bags`): a server that starts reads the first
            of them meanwhile.

    Raises:
        RecipeError: the recipe is missing or wrong.
        BagAssetsError: the server cannot start.
    """
    found = find_server(recipe)
    if found is not None:
        return found
    from bagassets.recipe import load_recipe

    state = load_recipe(recipe).state
    require_writable(state)
    ahead = {"recipe": str(recipe), "bags": list(bags)}
    return Client.ensure(server_spec(state, recipe), first_job=(_AHEAD, ahead))


def build_on_server(
    client: Client, recipe: Path, options: BuildOptions, on_event: Callable[[Event], None], most: int | None
) -> JsonObject | None:
    """Have a build made; return its report and the rows of its table as JSON.

    An interrupt (Ctrl-C) stops it cleanly and returns what was done; a second one does not wait.

    Returns:
        The report, or None if the server is just going and was never asked.

    Raises:
        BagAssetsError: what the driver raises, in its words.
    """
    args = {"recipe": str(recipe), "options": options.as_json(), "most": most}
    try:
        job = client.submit(_JOB, args, label=f"build-{uuid4()}", grace_s=_GRACE_S)
    except ServerRefusedError:
        return None
    try:
        import rich.console
        import rich.table  # noqa: F401

        event = _follow(client, job, on_event)
    except KeyboardInterrupt:
        client.cancel(job, grace_s=_GRACE_S)
        event = _follow(client, job, on_event)
    if event["event"] == "killed":
        raise BagAssetsError(*str(event["reason"]).split("\n"))
    if event["exit"] != 0:
        raise _raised(event["error"])
    report: JsonObject = event["result"]
    return report


def _follow(client: Client, job: str, on_event: Callable[[Event], None]) -> JsonObject:
    """Hand on what the driver tells, and return how it ended."""
    while True:
        event = client.wait()
        if event is None or event["job"] != job:
            continue
        if event["event"] == "note":
            told = event["note"].get("build")
            if told is not None:
                on_event(Event(**told))
        elif event["event"] in {"finished", "killed"}:
            return event


def _raised(error: dict[str, str]) -> BagAssetsError:
    from bagassets import errors
    from bagassets.build.choose import SelectionError

    kind, message = error["type"], error["message"]
    if kind == "KeyboardInterrupt":
        return InterruptedBuildError("interrupted.")
    if kind == SelectionError.__name__:
        return SelectionError(*message.split("\n"))
    if kind in errors.__all__:
        return BagAssetsError(*message.split("\n"))
    return BagAssetsError(f"the build failed in a worker ({kind}: {message}); please report this.")
