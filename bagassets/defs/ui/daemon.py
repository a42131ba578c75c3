"""`python -m bagassets.defs.ui.daemon …`: Dagster's daemon, which looks at backfills as often as at sensors; started by `bagassets.defs.ui.dev`.

Dagster's own looks every 30 seconds, twice for a *Materialize all*: before its runs, and before those of the datasets.
"""

from bagassets.defs.dagster_private import cli, controller
from bagassets.defs.ui.parent import end_after, end_with_parent

BACKFILL_POLL_S = 2
_INTERVAL = "DEFAULT_DAEMON_INTERVAL_SECONDS"


def main() -> None:
    """Run Dagster's daemon with the arguments of this process, until its parent ends."""
    end_with_parent()
    setattr(controller, _INTERVAL, BACKFILL_POLL_S)
    cli.main()


if __name__ == "__main__":
    end_after(main)
