"""Building on the fork server, which has imported what a build needs.

A new server imports Dagster once, for all builds until it ends; if the build ran in this process, both would import it.
"""

import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from bagassets.base import errors
from bagassets.base.errors import BagAssetsError, DatasetError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.base.interrupts import deferred_interrupts, signals_handled
from bagassets.base.json_types import JsonObject
from bagassets.base.lock_files import is_locked
from bagassets.base.trace import span
from bagassets.cli.early import GRACE_S, HandedOver, begin_server, submit_build
from bagassets.engine.build_report import BuildOptions, Event
from bagassets.engine.freshness.decide import state_folder
from bagassets.forkserver.client import Client, ServerRefusedError, ServerStart
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.tasks import find_server, server_spec

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe

# How long the jobs of a server that is ended have to stop; the server, which may be importing Dagster, has longer.
_END_GRACE_S = 5.0
_END_S = 60.0
_POLL_S = 0.02
_CARRIED_ON = "what is finished is kept, and the next build carries on."
_INTERRUPT_POLL_S = 0.2  # the longest time in which an interrupt goes unnoticed


class InterruptedBuildError(BagAssetsError):
    """A build was interrupted before it could report what it did."""


def report_of_build(
    recipe: Path,
    options: BuildOptions,
    on_event: Callable[[Event], None],
    most: int | None,
    handed_over: HandedOver | None = None,
) -> JsonObject:
    """Build on the server of a recipe, which is started if it is not up; return the report as JSON.

    Its `seconds` are what the user has waited, for the server, too. Arguments and errors are those of `server_for` and
    `build_on_server`.

    Args:
        recipe: recipe file.
        options: what to build.
        on_event: called with each event of the build.
        most: most rows of the table; None for all.
        handed_over: what has begun before.
    """
    began_s, server, job, starting = handed_over or HandedOver(time.monotonic())
    while True:
        if server is None:
            with span("find or start the server"):
                server = server_for(recipe, options, starting)
        with server:
            report = build_on_server(server, recipe, options, on_event, most, job)
        if report is not None:
            report["seconds"] = round(time.monotonic() - began_s, 3)
            return report
        server = job = starting = None


def server_for(recipe: Path, options: BuildOptions, begun: ServerStart | None = None) -> Client:
    """Return a client of the server for a recipe, which is started if it is not up.

    Args:
        recipe: recipe file.
        options: what to build; the first recordings are made while the server starts.
        begun: the server, if it is being started.

    Raises:
        RecipeError: the recipe is missing or wrong.
        BagAssetsError: the server cannot start.
    """
    if begun is None and (found := find_server(recipe)) is not None:
        return found
    try:
        state = Path(state_folder(str(recipe.absolute())))
    except (PlanNeeded, OSError):  # which `load_recipe` explains
        state = _loaded(recipe).state
    try:
        (begun or begin_server(recipe, state, options.bags, options.select)).wait()
    except BagAssetsError:
        from bagassets.propose.project import dagster_home

        dagster_home(recipe.absolute(), _loaded(recipe))  # what is wrong with these says more
        raise
    return Client.ensure(server_spec(state, recipe))


def _loaded(recipe: Path) -> "Recipe":
    """Load a recipe; importing what does takes a quarter of a second, and the server does it anyway."""
    from bagassets.recipe import load_recipe

    return load_recipe(recipe)


def end_servers(state: Path) -> None:
    """End the servers of a state folder that nobody else uses, and return when they and their jobs are gone.

    One that is still starting cannot be asked; it is as soon as it answers.
    """
    deadline = time.monotonic() + _END_S
    asked: set[str] = set()
    while running := [files for files in ServerFiles.known(state) if _is_up(files)]:
        for files in running:
            client = None if files.stamp in asked else Client.connect(files)
            if client is not None:
                with client, suppress(ServerRefusedError):
                    client.shutdown(grace_s=_END_GRACE_S)
                asked.add(files.stamp)
        if time.monotonic() > deadline:
            return
        time.sleep(_POLL_S)


@contextmanager
def scratch_folders(output: Path, *, parents: bool = False) -> Iterator[tuple[Path, Path]]:
    """Make a state folder, and one beside an output, with links into it; remove both in the end, with the server.

    Args:
        output: where the dataset goes.
        parents: make the folders that it lies in, which stay.

    Raises:
        DatasetError: nothing can be written beside the output.
    """
    try:
        if parents:
            output.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{output.name[:100]}.", dir=output.parent))
    except OSError as err:
        raise DatasetError(
            f"{output.parent}: the dataset cannot be written here ({err.strerror or err}); make the folder, fix its "
            "permissions, or name another place."
        ) from err
    # Databases and sockets work in the temporary folder, whatever file system the dataset goes to.
    state = Path(tempfile.mkdtemp(prefix="bagassets-")).resolve()
    try:
        yield state, beside
    finally:
        # A second Ctrl-C must not keep them from being removed.
        with signals_handled(signal.SIG_IGN, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            end_servers(state)
            shutil.rmtree(state, ignore_errors=True)
            shutil.rmtree(beside, ignore_errors=True)


def _is_up(files: ServerFiles) -> bool:
    try:
        return is_locked(files.lock)
    except OSError:
        return False  # it removed its lock file as it ended


def build_on_server(
    client: Client,
    recipe: Path,
    options: BuildOptions,
    on_event: Callable[[Event], None],
    most: int | None,
    job: str | None = None,
) -> JsonObject | None:
    """Build on the server; return the report, with the rows of its table, as JSON.

    An interrupt (Ctrl-C) stops the build cleanly, and the report says what was done; a second interrupt does not wait.

    Args:
        client: of the server.
        recipe: recipe file.
        options: what to build.
        on_event: called with each event of the build.
        most: most rows of the table; None for all.
        job: the build, if the server has begun it.

    Returns:
        The report, or None if the server was shutting down and refused the job.

    Raises:
        BagAssetsError: an error of the build, with its message.
    """
    if job is None:
        try:
            job = submit_build(client, recipe, asdict(options), most)
        except ServerRefusedError:
            return None
    with deferred_interrupts() as interrupt:
        import rich.console
        import rich.table  # noqa: F401

        is_cancelled = False
        try:
            while (event := _end_of(client, job, on_event)) is None:
                if interrupt.asked and not is_cancelled:
                    client.cancel(job, grace_s=GRACE_S)
                    is_cancelled = True
        except ServerRefusedError as err:
            raise BagAssetsError(
                "the server of this build was killed; workers that survived it go on, maybe to the end of the build, "
                f"{_CARRIED_ON} Its log is {client.files.log}."
            ) from err
    if event["event"] == "killed":
        raise BagAssetsError(*str(event["reason"]).split("\n"), f"Its runs end within seconds, {_CARRIED_ON}")
    if event["exit"] != 0:
        raise _raised(event["error"])
    report: JsonObject = event["result"]
    return report


def _end_of(client: Client, job: str, on_event: Callable[[Event], None]) -> JsonObject | None:
    """Pass on the next event of the build, if one comes soon; return it if its job ended with it."""
    event = client.wait(_INTERRUPT_POLL_S)
    if event is None or event["job"] != job:
        return None
    if event["event"] == "note":
        fields = event["note"].get("build")
        if fields is not None:
            on_event(Event(**fields))
    return event if event["event"] in {"finished", "killed"} else None


def _raised(error: JsonObject) -> BagAssetsError:
    kind, message = error["type"], error["message"]
    if kind == "KeyboardInterrupt":
        return InterruptedBuildError("interrupted.")
    if error["is_for_users"]:
        known: type[BagAssetsError] = getattr(errors, kind, BagAssetsError)
        return known(*message.split("\n"))
    return BagAssetsError(f"the build failed in a worker ({kind}: {message}); please report this.")
