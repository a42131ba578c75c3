"""A project of small drives whose recordings and recipe change by chance: what `chaos` and `soak` build."""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

from benchmarks.common import machine

__all__ = ["ChangingProject", "measure_changes"]

_MARK = "BAGASSETS_CHANGING"
_COMMAND = (sys.executable, "-m", "bagassets")
SLOTS = ("a.bag", "b.mcap", "c.bag")
_WIDTHS = (640, 720, 800)
_FINISH_S = 300.0


class ChangingProject:
    """Three recordings, each a copy of one of several drives; everything follows from the seed.

    Args:
        folder: an empty folder.
        drives: number of drives of each format to choose from.
        seed: of all choices.
    """

    def __init__(self, folder: Path, drives: int, seed: int) -> None:
        self.dice = random.Random(seed)
        self.project, self.bags = folder / "project", folder / "bags"
        self._mark = str(uuid4())
        self._pool = folder / "pool"
        for number in range(drives):
            for suffix in (".bag", ".mcap"):
                name = self._pool / f"{number}{suffix}"
                self._run("sample", str(name), "--duration", "1.5", "--seed", str(number))
        self.bags.mkdir()
        for slot in SLOTS:
            self._fill(slot)
        self._run("init", str(self.project), "--bags", str(self.bags))
        self.recipe = self.project / "recipe.yaml"
        self._text = self.recipe.read_text("utf-8")

    def change(self) -> str:
        """Change something; return what."""
        kind = self.dice.choice(("replace", "touch", "remove or add", "recipe"))
        slot = self.bags / self.dice.choice(SLOTS)
        if kind == "recipe":
            width = self.dice.choice(_WIDTHS)
            self.recipe.write_text(f"{self._text}\npreview: {{width: {width}}}\n", "utf-8")
        elif kind == "touch" and slot.exists():
            os.utime(slot)
        elif kind == "remove or add" and slot.exists() and len(list(self.bags.iterdir())) > 1:
            slot.unlink()
        else:
            self._fill(slot.name)
        return kind

    def replace(self, number: int) -> None:
        """Replace one recording, in turns, by another drive."""
        self._fill(SLOTS[number % len(SLOTS)])

    def start(self, *arguments: str) -> "subprocess.Popen[str]":
        """Start a command of bagassets in the project."""
        return subprocess.Popen(
            [*_COMMAND, *arguments],
            cwd=self.project,
            env={**os.environ, _MARK: self._mark},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def call(self, *arguments: str) -> tuple[int, str, float]:
        """Run a command in the project; return exit status, output and seconds. One that hangs has the status 124."""
        began = time.monotonic()
        process = self.start(*arguments)
        try:
            output, _ = process.communicate(timeout=_FINISH_S)
        except subprocess.TimeoutExpired:
            self.kill_all()
            output, _ = process.communicate()
            return 124, output, time.monotonic() - began
        return process.returncode, output, time.monotonic() - began

    def build_afresh(self) -> Path:
        """Build what there is now in a project of its own, from nothing; return its folder."""
        other = self.project.with_name("afresh")
        self._run("init", str(other), "--bags", str(self.bags))
        # The recipe names the dataset after the project's folder, so the names are made the same.
        text = self.recipe.read_text("utf-8").replace(str(self.project), str(other))
        (other / "recipe.yaml").write_text(text, "utf-8")
        subprocess.run(
            [*_COMMAND, "build"],
            cwd=other,
            env={**os.environ, _MARK: self._mark},
            check=True,
            stdout=subprocess.DEVNULL,
        )
        return other

    def processes(self) -> list[int]:
        """Return the ids of all processes that this project's commands have started, servers included."""
        mark = f"{_MARK}={self._mark}".encode()
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit() and int(entry.name) != os.getpid():
                with suppress(OSError):
                    if mark in (entry / "environ").read_bytes().split(b"\0"):
                        found.append(int(entry.name))
        return found

    def kill_all(self) -> None:
        """Kill them all, stopped first, so that none tidies up after another."""
        while pids := [pid for pid in self.processes() if not _is_zombie(pid)]:
            for number in (signal.SIGSTOP, signal.SIGKILL):
                for pid in pids:
                    with suppress(ProcessLookupError):
                        os.kill(pid, number)

    def _fill(self, slot: str) -> None:
        suffix = Path(slot).suffix
        drive = self.dice.choice(sorted(self._pool.glob(f"*{suffix}")))
        copy = self.bags / f"{slot}.part"
        shutil.copy(drive, copy)
        copy.replace(self.bags / slot)

    def _run(self, *arguments: str) -> None:
        done = subprocess.run([*_COMMAND, *arguments], capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{' '.join(arguments)}\n{done.stdout}{done.stderr}")


def measure_changes(
    parser: argparse.ArgumentParser,
    drives: int,
    measure: Callable[[ChangingProject, argparse.Namespace], dict[str, Any]],
    table: Callable[[dict[str, Any]], str],
) -> int:
    """Do what the command line asks for: make a project, measure, write and print; return the exit status.

    Args:
        parser: parser with the options of this measurement.
        drives: number of drives of each format to choose from.
        measure: returns what was found; its "problems" are sentences.
        table: returns what was found as a table in Markdown.
    """
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True) as name:
        project = ChangingProject(Path(name), drives, options.seed)
        try:
            found = measure(project, options)
        finally:
            project.kill_all()
    found = {"machine": machine(), "seed": options.seed, **found}
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(table(found))
    for problem in found["problems"]:
        print(problem, file=sys.stderr)
    return 1 if found["problems"] else 0


def _is_zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
