"""When Python's collector of reference cycles should stay away."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def uncollected() -> Iterator[None]:
    """Pause the collector while many objects without cycles are made, as it would scan them again and again.

    Only around such code, never for a whole process: connections to databases that libraries leave behind in cycles
    return to their pool when they are collected, and a run that waits for one waits for ever (dagster-postgres 0.29.0).
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
