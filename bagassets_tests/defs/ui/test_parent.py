"""Processes of the web UI end at once, with what they have printed and their exit status."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("main", "status", "said"),
    [
        ("print('served')", 0, "served"),
        ("print('asked'); sys.exit(3)", 3, "asked"),
        ("sys.exit('no')", 1, ""),
        ("raise KeyboardInterrupt", 0, ""),  # from `end_with_parent`, wherever `main` is
    ],
)
def test_the_status_is_that_of_the_process_and_nothing_printed_is_lost(main, status, said):
    # A thread that is not a daemon, as gRPC's, would keep it for as long as it likes.
    code = f"""
import sys, threading, time
from bagassets.defs.ui.parent import end_after
def main():
    threading.Thread(target=time.sleep, args=(600,)).start()
    {main}
end_after(main)
"""
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert (ended.returncode, ended.stdout.strip(), ended.stderr) == (status, said, "")
