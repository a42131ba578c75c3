"""The clock by which files are stamped."""

import os
from tempfile import TemporaryFile


def next_tick():
    """Wait until it has gone on: on older kernels it does so every 4 or 10 ms, which is enough for many steps of a test.

    Whatever is written or marked from then on is seen to be later than what was before.
    """
    with TemporaryFile() as probe:
        before_ns = os.fstat(probe.fileno()).st_mtime_ns
        while os.fstat(probe.fileno()).st_mtime_ns == before_ns:
            os.utime(probe.fileno())
