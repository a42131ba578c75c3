"""Functions that the tests of the fork server have called in workers."""

import io
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.worker import cancel_requested, note


def slow_preload(modules):
    time.sleep(1.0)


def preload(modules):
    for module in modules:
        __import__(module)


def killed(_modules):
    os.kill(os.getpid(), signal.SIGKILL)


STEPS_DONE = []


def preload_in_steps(modules):
    preload(modules)

    def steps():
        for number in range(3):
            STEPS_DONE.append(number)
            yield
        raise ValueError("the fourth step")

    return steps()


def preload_with_a_pause(modules):
    preload(modules)

    def steps():
        STEPS_DONE.append("at once")
        yield True
        STEPS_DONE.append("when no job is at work")
        yield

    return steps()


def steps_done(_args):
    return STEPS_DONE


def add(args):
    note({"half": args["x"]})
    print("adding")
    return args["x"] + args["y"]


def surroundings(args):
    return {
        "env": os.environ.get("SURROUNDING"),
        "cwd": str(Path.cwd()),
        "leader": os.getsid(0) == os.getpid(),
    }


def open_files(args):
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # the one that lists the folder
            found.append(str(entry.readlink()))
    return found


def fail(args):
    raise ValueError("no such luck")


def leave(args):
    os._exit(3)


def end_slowly(_args):
    """Return a result, after which the process takes a minute to end."""

    class Slow(io.StringIO):
        flushed = False

        def flush(self):
            if self.flushed:
                time.sleep(60.0)
            self.flushed = True

    sys.stdout = Slow()
    return os.getpid()


def wait(args):
    """Say so when started, and wait until the file appears."""
    note({"started": True})
    while not Path(args["until"]).exists():
        time.sleep(0.02)
    return "waited"


class _Interrupting:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)


def be_interrupted_in_a_finalizer(args):
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    _Interrupting()
    time.sleep(600)


def sleep(args):
    note({"started": True})
    time.sleep(600)


def stop_politely(args):
    interrupted = []
    signal.signal(signal.SIGTERM, lambda *_: interrupted.append(cancel_requested()))
    note({"started": True})
    while not interrupted:
        time.sleep(0.02)
    return interrupted


def be_stubborn(args):
    """Ignore SIGTERM, with a child that does so too and writes its number."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    child = subprocess.Popen(["sleep", "600"])
    note({"child": child.pid})
    time.sleep(600)


def write_down(args):
    """Reporter of lost jobs: writes what it gets where the job's `report` says."""
    Path(args["args"]["report"]).write_text(f"{args['notes']} {args['reason']}", "utf-8")


def touch(args):
    with Path(args["file"]).open("a", encoding="utf-8") as file:
        file.write("x")


def watch_for_server(args):
    """As first job: write down whether the server served when this began, wait until it does, and write that down, too."""
    files = ServerFiles(Path(args["state"]), args["stamp"])
    began = "after" if files.socket is not None else "before"
    Path(args["file"]).write_text(f"began {began} it served", "utf-8")
    while files.socket is None:
        time.sleep(0.02)
    Path(args["file"]).write_text(f"began {began} it served, ended after", "utf-8")


def tell_surroundings(args):
    Path(args["file"]).write_text(os.environ["SURROUNDING"], "utf-8")
