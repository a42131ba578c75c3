"""The build driver as a job of the fork server: a worker plans and has the runs made.

The command line then imports no Dagster at all, which would take longer than many a build.
"""

import signal
from pathlib import Path
from typing import Any

from bagassets.cli.summary import summary_rows
from bagassets.defs import driver
from bagassets.engine.build_report import BuildOptions, Event
from bagassets.forkserver.worker import note
from bagassets.recipe import load_recipe

__all__ = ["build"]


def build(args: dict[str, Any]) -> dict[str, Any]:
    """Build; return the report as JSON, with the rows of its table as `summary`.

    Events are told as notes with the single entry `build`. A cancelled build stops its runs, waits for
    their end and reports what was done.

    Args:
        args: `recipe` (file), `options` (`BuildOptions.as_json`), `most` (rows of the table; None = all).
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    recipe_file = Path(args["recipe"])

    def tell(event: Event) -> None:
        note({"build": event.as_json()})

    report = driver.build(recipe_file, BuildOptions.from_json(args["options"]), tell)
    rows = summary_rows(report, load_recipe(recipe_file).store_path, most=args["most"])
    return {**report.as_json(), "summary": [row.as_json() for row in rows]}
