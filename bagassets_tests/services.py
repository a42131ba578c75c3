"""Programs that run beside a test: started in a session of their own, and known to be gone in the end."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from bagassets.forkserver.client import Client
from bagassets.propose.project import write_project
from bagassets_tests.small_drive import RECIPE

BIN = Path(sys.executable).parent
WAIT_S = 90


def make_project(folder, *, settle_s=1.0):
    """Write a project whose recordings are in `folder/bags`; return its folder."""
    project = folder / "project"
    text = RECIPE.format(name="test", root=folder / "bags")
    write_project(project, text.replace("settle_s: 0", f"settle_s: {settle_s}"))
    return project


def free_port():
    """Return a port that was free just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def bare_environment():
    """Return an environment in which nothing says where a project or Dagster's home is."""
    ours = ("DAGSTER_", "BAGASSETS_RECIPE", "PYTHONPATH")
    return {name: value for name, value in os.environ.items() if not name.startswith(ours)}


@contextmanager
def running(command, cwd, log, environment=None):
    """Run a program, its output in `log`; whatever of it is left in the end is killed.

    Its environment is a bare one, with what `environment` adds.
    """
    with log.open("wb") as output:
        process = subprocess.Popen(
            [str(part) for part in command],
            cwd=cwd,
            env=bare_environment() | (environment or {}),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            # A shell has what it starts in the background ignore Ctrl-C, and children inherit that.
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509  (no threads here)
        )
    try:
        yield process
    finally:
        for pid in processes_of(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.wait()
        for client in Client.all_of(cwd / ".bagassets"):
            client.shutdown(grace_s=0.0)


def processes_of(session):
    """Return the processes of a session, and of those that its members started, that still run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def eventually(condition, what, seconds=WAIT_S):
    """Wait until `condition` returns something, and return that."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited {seconds} s until {what}"
        time.sleep(0.1)
    return found


def complaints(log):
    """Return what a Dagster log says above INFO, but that Dagster would like `dg dev` better."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", log.read_text("utf-8", "replace"))
    lines = [line for line in text.splitlines() if line.strip()]
    return [
        line
        for number, line in enumerate(lines)
        if " - INFO - " not in line
        # A race for a new SQLite file has Dagster say so with `logging.info`, and from then on everything twice.
        and not line.startswith("INFO:")
        and "SupersessionWarning: Function `dev_command`" not in line
        and not (number and "SupersessionWarning" in lines[number - 1])
    ]
