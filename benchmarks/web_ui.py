"""The web UI of a project, for benchmarks that click in it."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from bagassets.defs.ui.ports import free_port

__all__ = ["wait_until", "web_ui"]

_DEADLINE_S = 300
_HOST, _FIRST_PORT = "127.0.0.1", 3200


@contextlib.contextmanager
def web_ui(command: Sequence[str | Path], recipe: Path) -> Iterator[str]:
    """Run `bagassets ui` until the end of the block; yield its address.

    Args:
        command: how `bagassets` is called.
        recipe: of the project.
    """
    port = free_port(_HOST, _FIRST_PORT)
    url = f"http://{_HOST}:{port}"
    ours = ("DAGSTER_", "BAGASSETS_RECIPE")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    log = recipe.with_name("ui.log")
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*command, "ui", "--recipe", recipe, "--port", str(port), "--no-browser"],
            cwd=Path(__file__).parents[1],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            # A shell has what it starts in the background ignore Ctrl-C, and children inherit that.
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509  (no threads here)
        )
    try:
        wait_until(
            lambda: process.poll() is not None or url in log.read_text("utf-8", "replace"),
            f"`bagassets ui` tells its address ({log})",
        )
        if process.poll() is not None:
            raise SystemExit(f"`bagassets ui` ended: {log.read_text('utf-8', 'replace')[-1000:]}")
        yield url
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def wait_until(condition: Any, what: str, pause_s: float = 0.1) -> Any:
    """Return what `condition` returns, once that is true; an OSError means not yet."""
    deadline = time.time() + _DEADLINE_S
    while time.time() < deadline:
        with contextlib.suppress(OSError):
            if found := condition():
                return found
        time.sleep(pause_s)
    raise SystemExit(f"waited {_DEADLINE_S} s until {what}")
