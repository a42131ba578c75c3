"""Tuning a process for builds: threads that encode images, and an allocator that keeps freed memory."""

import ctypes
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress

# One thread reads and converts lidar clouds; more encoders than this would wait for it.
_MOST_ENCODERS = 8
# An encoder that returns from OpenCV waits this long for a thread that computes in Python. With Python's
# default of 5 ms, and some ten returns per image, encoders would wait longer than they work.
_SWITCH_S = 0.0005

# malloc.h of glibc
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGEST_REUSED_BYTES = 32 << 20  # the most that glibc takes
_KEPT_BYTES = 256 << 20


def encoder_threads() -> int:
    """Return how many threads encode the images of one recording: one per processor this process may use.

    Recordings built side by side share the processors; the last one to finish has them all.
    """
    return min(
        len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1, _MOST_ENCODERS
    )


@contextmanager
def encoders(threads: int) -> Iterator[ThreadPoolExecutor | None]:
    """Provide a pool of encoder threads; None for a single thread, which would only add overhead."""
    if threads <= 1:
        yield None
        return
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    pool = ThreadPoolExecutor(threads, "encode")
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
        sys.setswitchinterval(before)


def keep_freed_memory() -> None:
    """Have the allocator reuse freed memory; with a C library other than glibc, do nothing.

    Each image takes several buffers of megabytes. By default glibc returns them to the system, which
    zeroes them again for the next image: a fifth of a build's processor time.
    """
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_REUSED_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
