"""`python -m bagassets.defs.dev …`: `dagster dev`, ended together with whoever started it.

Standard input is a pipe that the starter holds: when it is closed, or the starter dies, Dagster
shuts its services down as on Ctrl-C.
"""

import os
import signal
import sys
import threading
import warnings
from pathlib import Path

from bagassets.errors import BagAssetsError

__all__ = ["main"]

_STDIN = 0


def main() -> None:
    """Run `dagster dev` with this process's arguments."""
    # Dagster recommends a tool for developing code locations here; people who open a web UI do not.
    warnings.filterwarnings("ignore", message="Function `dev_command` is superseded")
    from dagster._cli.dev import dev_command  # noqa: PLC0415  (after the filter)

    from bagassets.defs.databases import ready_to_open  # noqa: PLC0415  (imports Dagster as well)

    threading.Thread(target=_follow_starter, daemon=True).start()
    try:
        # Of the processes that Dagster starts, none waits for another that makes the databases.
        with ready_to_open(Path(os.environ["DAGSTER_HOME"])):
            pass
    except BagAssetsError as err:
        sys.exit(f"error: {err}")
    dev_command(sys.argv[1:], prog_name="dagster dev")


def _follow_starter() -> None:
    while os.read(_STDIN, 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    main()
