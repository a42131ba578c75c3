"""`bagassets ui`: the web UI of a project, in the foreground."""

import os
import signal
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import click

from bagassets.base.errors import BagAssetsError
from bagassets.base.interrupts import signals_handled
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo

_POLL_S = 0.2
_DEFAULT_PORT = 3000


@click.command(
    epilog="""\b
Examples:
  bagassets ui
  bagassets ui --recipe build/demo/recipe.yaml --port 3001
  bagassets ui --host 0.0.0.0 --no-browser    # for other machines; there is no password"""
)
@recipe_option
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    default=_DEFAULT_PORT,
    show_default=True,
    metavar="N",
    help="Port to listen on.",
)
@click.option("--host", default="127.0.0.1", show_default=True, metavar="H", help="Address to listen on.")
@click.option(
    "--allow-host",
    "allow_hosts",
    multiple=True,
    metavar="NAME",
    help="A further name by which browsers reach the UI, such as that of a proxy.",
)
@click.option("--no-browser", is_flag=True, help="Open no browser window.")
@click.option("--verbose", is_flag=True, help="Show Dagster's log, not just warnings and errors.")
def ui(
    recipe: Path, port: int, host: str, allow_hosts: tuple[str, ...], no_browser: bool, verbose: bool
) -> int:
    """Open the web UI of a project.

    Runs Dagster's web server and daemon with the state of the project until Ctrl-C; the sensor notices new, changed and
    removed recordings. Ctrl-C waits for active runs; another Ctrl-C cancels them.

    There is no password. Requests that other sites make with your browser are refused: those to a host name that is
    not the UI's own, and those from their pages.
    """
    if find_spec("dagster_webserver") is None or find_spec("uvicorn") is None:
        from importlib.metadata import version

        raise BagAssetsError(
            "the web UI needs dagster-webserver, which is not installed here, or not with all that it requires: "
            f"`pip install dagster-webserver=={version('dagster')}`. Builds, the sensor and all other commands do without."
        )
    from bagassets.defs.ui.services import Services

    received: list[int] = []  # from now on no signal ends the process by itself
    noted = signals_handled(lambda n, _: received.append(n), signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with noted, Services(recipe, host, port, verbose=verbose, allow_hosts=allow_hosts) as services:
        services.wait_until_ready(lambda: bool(received))
        if not received:
            services.warm_up()
            echo(f"{services.url}  (web UI of {recipe.resolve().parent.name}; Ctrl-C ends it)")
            if not no_browser and _has_display():
                click.launch(services.url)
        while services.is_running and not received:
            time.sleep(_POLL_S)
        has_failed = not services.is_running
        services.stop()
        seen = len(received)
        # After SIGTERM, or when the terminal was closed, nobody will send a second signal.
        services.end_runs(
            lambda runs: echo(
                f"Waiting for {'a run' if runs == 1 else f'{runs} runs'} to end; Ctrl-C again cancels.",
                err=True,
            ),
            cancel=lambda: len(received) > max(seen, 1) or not {signal.SIGINT}.issuperset(received),
        )
    return 1 if has_failed else 0


def _has_display() -> bool:
    """Return whether a browser can open a window, rather than take over the terminal."""
    return sys.stdout.isatty() and (
        sys.platform in {"darwin", "win32"}
        or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    )
