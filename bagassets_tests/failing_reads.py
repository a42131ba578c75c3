"""Reads that fail: a library in C that a process is started with, since half of the readers are not Python."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

_NAME = "failing_reads.so"


def is_loaded():
    """Tell whether this process was started with the library."""
    return _NAME in os.environ.get("LD_PRELOAD", "")


def compiled(folder):
    """Compile the library in a folder; return its path."""
    library = folder / _NAME
    source = Path(__file__).with_suffix(".c")
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return library


def with_library(library):
    """Return the environment of a process that is to have it."""
    return {**os.environ, "LD_PRELOAD": str(library)}


def run_with(folder, command):
    """Run a command with the library, which is compiled in a folder; return its exit status."""
    return subprocess.run(
        [sys.executable, *command], env=with_library(compiled(folder)), check=False
    ).returncode


def begin(folder, fails_at=0):
    """Count the reads of files below a folder from now on, of which one fails; none if it is 0."""
    ctypes.CDLL(None).begin_reads(os.fsencode(folder), ctypes.c_long(fails_at))


def number():
    """Return how many there were."""
    function = ctypes.CDLL(None).reads_so_far
    function.restype = ctypes.c_long
    return function()


def failed():
    """Return what failed, and of which file; empty if nothing did."""
    function = ctypes.CDLL(None).failed_read
    function.restype = ctypes.c_char_p
    return os.fsdecode(function())
