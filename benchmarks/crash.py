"""Every crash replayed, every change of files failed once, and every short history of a project.

The commands of `bagassets_tests/crash_project.py` are recorded, change by change of files. After a crash before each change, with
what may be left then (killed; without power: new files empty, full of zeros, torn in the middle, any of these, and a change
lost; all with and without the last commit of Dagster's database), a build must end well, then `verify` must find nothing and
the dataset be that of a project built from nothing; what leaves the same files, byte for byte, is tried once. The same after
each change failed once, with EIO and with ENOSPC, and after each read failed once, with EIO, where the command must end in a
sentence; and after histories of three steps::

    make crash                                   # all of them: some hours on two quiet cores; interrupted, it goes on later
    python -m benchmarks.crash --share 0.05      # a sample
    python -m benchmarks.crash --only history
    python -m benchmarks.crash --command removal --json benchmarks/results/crash.json   # this one again, into these results

The exit status is 1 if anything went wrong.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, machine, markdown

__all__ = ["crash_table"]

_CODE = "bagassets_tests.crash_project"  # imported when it is needed, as it imports Dagster
_failing_reads: Any = import_module("bagassets_tests.failing_reads")
_NAMES = {
    "crash": "crashes", "failure": "changes of files that fail once", "read": "reads that fail once", "history": "histories",
}  # fmt: skip
_EACH = 25

Answer = dict[str, Any]
"""Of a worker. What was tried: part and command, which one, what was wrong then (an empty text: nothing), and whether it was
equal to one that was tried before; or, once, how many tries there are to do, and how many changes each command made."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--share", type=float, default=1.0, help="share of all that is tried, by chance")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=_NAMES, help="only this part")
    parser.add_argument(
        "--command", help="only crashes and failures of this one; with --json, the other figures there stay"
    )
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument(
        "--folder", type=Path, default=Path("/dev/shm"), help="where to work; default: in memory"
    )
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    if options.only in (None, "read") and not _failing_reads.is_loaded():
        with tempfile.TemporaryDirectory() as name:
            return int(_failing_reads.run_with(Path(name), ["-m", "benchmarks.crash", *sys.argv[1:]]))
    import_module(_CODE)  # workers are forked with it
    kept = ROOT / "build" / f"crash-tried-{_run_digest(options)[:16]}.jsonl"
    before = _tried_before(kept)
    kept.parent.mkdir(exist_ok=True)
    begun = time.monotonic() - max((one["at_s"] for one in before), default=0.0)
    found = _Found()
    with (
        # When it is interrupted, workers may still write.
        tempfile.TemporaryDirectory(
            dir=options.folder if options.folder.is_dir() else None, ignore_cleanup_errors=True
        ) as name,
        kept.open("w", encoding="utf-8") as lines,
    ):
        print(*map(json.dumps, before), sep="\n", end="\n" if before else "", file=lines, flush=True)
        for one in before:
            found.add(one)
        for one in _tried(Path(name), options, {(*one["what"], one["one"]) for one in before}):
            if "what" in one:
                one["at_s"] = round(time.monotonic() - begun, 1)
                print(json.dumps(one), file=lines, flush=True)
            found.add(one)
    rows = [
        [*what, number, found.good[what], found.equal[what]] for what, number in sorted(found.tries.items())
    ]
    results = {
        "machine": machine(), "seed": options.seed, "share": options.share, "commit": _git("rev-parse", "--short", "HEAD"),
        "date": time.strftime("%Y-%m-%d"), "minutes": round((time.monotonic() - begun) / 60), "tried": rows,
        "problems": found.problems,
    }  # fmt: skip
    if options.command and options.json:
        results = _with_again(
            json.loads(options.json.read_text("utf-8")), results, options.command, options.only
        )
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
    print(crash_table(results))
    kept.unlink(missing_ok=True)
    return 1 if found.problems else 0


class _Found:
    """What has been found so far: part and command -> how many were tried, good, and equal to others."""

    def __init__(self) -> None:
        self.tries, self.good, self.equal = (Counter[tuple[str, str]]() for _ in range(3))
        self.problems: list[str] = []
        self._changes: dict[str, int] = {}
        self._to_do, self._done, self._since_s = 0, 0, time.monotonic()

    def add(self, one: Answer) -> None:
        """Add an answer, and say now and then how far this is."""
        if "to_do" in one:
            self._to_do, self._since_s = self._to_do + one["to_do"], time.monotonic()
            for command, number in one["changes"].items():
                if self._changes.setdefault(command, number) != number:
                    self._say(
                        f"worker, {command}: {number} changes were recorded, and elsewhere {self._changes[command]}"
                    )
            return
        what = part, command = tuple(one["what"])
        self._done += bool(self._to_do)
        self.tries[what] += 1
        self.good[what] += not one["problem"]
        self.equal[what] += one["is_equal"]
        if one["problem"]:
            self._say(f"{part}, {command}: {one['one']}: {one['problem']}")
        if self._done % _EACH == 0 < self._to_do:
            left_min = (self._to_do - self._done) * (time.monotonic() - self._since_s) / self._done / 60
            print(
                f"{self.tries.total()} tried, {self.equal.total()} of them equal to others, {len(self.problems)} problems;"
                f" {self._to_do - self._done} more in about {left_min:.0f} minutes: now {part}, {command}",
                flush=True,
            )

    def _say(self, problem: str) -> None:
        self.problems.append(problem)
        print(problem, file=sys.stderr, flush=True)


def _run_digest(options: argparse.Namespace) -> str:
    """Return a digest of what must be the same for a run to go on where another was interrupted."""
    code = hashlib.sha256()
    for folder, pattern in (("bagassets", "**/*.py"), ("bagassets_tests", "*.*"), ("benchmarks", "crash.py")):
        for path in sorted((ROOT / folder).glob(pattern)):
            code.update(path.read_bytes())
    code.update(repr([options.share, options.seed, options.only, options.command]).encode())
    return code.hexdigest()


def _tried_before(kept: Path) -> list[Answer]:
    """Return what an interrupted run had tried."""
    found: list[Answer] = []
    with suppress(FileNotFoundError, json.JSONDecodeError):  # the last line may be half
        found.extend(map(json.loads, kept.read_text("utf-8").splitlines()))
    return found


def _tried(folder: Path, options: argparse.Namespace, tried: Collection[tuple[str, ...]]) -> Iterator[Answer]:
    """Yield what workers tried; each records the commands for itself, and tries every so many of the crashes."""
    context = multiprocessing.get_context("fork")
    answers: Any = context.Queue()
    workers = [
        context.Process(target=_work, args=(folder / str(number), number, options, tried, answers.put))
        for number in range(options.workers)
    ]
    for worker in workers:
        worker.start()
    at_work = len(workers)
    while at_work:
        answer = answers.get()
        if answer is None:
            at_work -= 1
        else:
            yield answer
    for worker in workers:
        worker.join()


def _work(
    folder: Path,
    number: int,
    options: argparse.Namespace,
    tried: Collection[tuple[str, ...]],
    answer: Callable[[Answer | None], None],
) -> None:
    code: Any = import_module(_CODE)

    def mine(what: tuple[str, str], all_of_it: Any) -> list[Any]:
        """Those of all tries that are in the sample, this worker's, and not tried yet."""
        dice = random.Random(options.seed)
        # Those before the same change go to one worker, as they may leave the same.
        return [
            one
            for index, one in enumerate(all_of_it)
            if dice.random() < options.share
            and getattr(one, "number", index) % options.workers == number
            and (*what, str(one)) not in tried
        ]

    try:
        folder.mkdir()
        code.be_quiet()
        code.warm_up(folder / "warm")
        scenarios = []
        for command in code.SCENARIOS if options.only != "history" else ():
            if options.command not in (None, command):
                continue
            project = code.Project(folder / command)
            scenario = code.recorded(project, command)
            code.import_what_was_needed()
            tries = {
                part: mine((part, command), all_of_it())
                for part, all_of_it in (
                    ("crash", partial(code.crashes, scenario, options.seed)),
                    ("failure", partial(code.failures, scenario)),
                    ("read", partial(code.reads, project, scenario)),
                )
                if options.only in (None, part)
            }
            scenarios.append((command, project, scenario, tries))
        steps = []
        if options.only in (None, "history") and options.command is None:
            steps = mine(("history", "three steps"), product(code.STEPS, repeat=3))
        to_do = sum(len(some) for *_, tries in scenarios for some in tries.values()) + len(steps)
        changes = {command: len(scenario.recording.changes) for command, _, scenario, _ in scenarios}
        answer({"to_do": to_do, "changes": changes})
        for command, project, scenario, tries in scenarios:
            project.enter()
            for part, some in tries.items():
                run = {"crash": code.replay, "failure": code.fail, "read": code.fail_read}[part]
                known: dict[Any, str] = {}
                for one in some:
                    state = code.left_state(scenario, one) if part == "crash" else one
                    if not (is_equal := state in known):
                        known[state] = run(project, scenario, one)
                    if known[state] is not None:
                        answer(_answer((part, command), one, known[state], is_equal))
        histories: Any = code.Histories(folder) if steps else None
        for three in steps:
            answer(_answer(("history", "three steps"), three, histories.run(three, options.seed)))
    except BaseException as err:
        answer(_answer(("worker", str(number)), "", repr(err)))
        raise
    finally:
        answer(None)


def _answer(what: tuple[str, str], one: object, problem: str, is_equal: bool = False) -> Answer:
    return {"what": what, "one": str(one), "problem": problem, "is_equal": is_equal}


def _with_again(
    before: dict[str, Any], found: dict[str, Any], command: str, part: str | None
) -> dict[str, Any]:
    """Return results in which those of one command, or of one part of it, are newer than the rest."""
    rows = [row for row in before["tried"] if row[1] != command or part not in (None, row[0])]
    about = f"{part or ''}, {command}: "
    problems = [one for one in before["problems"] if about not in one] + found["problems"]
    name = f"{command} ({_NAMES[part]})" if part else command
    again = {**before.get("again", {}), name: {"date": found["date"], "commit": found["commit"]}}
    return {**before, "tried": sorted(rows + found["tried"]), "problems": problems, "again": again}


def crash_table(found: dict[str, Any]) -> str:
    """Return the results as a table in Markdown, and where they are from."""
    rows = [
        (f"{_NAMES.get(part, part)}: {command}", tried, good, *(equal or [0]))
        for part, command, tried, good, *equal in found["tried"]
    ]
    share = "all there are" if found["share"] == 1 else f"{100 * found['share']:g} % of all, by chance"
    where = f"On {found['date']}, commit {found['commit']}: {share}, with seed {found['seed']}"
    for command, newer in found.get("again", {}).items():
        where += f"; *{command}* once more on {newer['date']}, commit {newer['commit']}"
    where += ".\n\n"
    return where + markdown(("", "all", "good", "of them equal to another, which was tried"), rows)


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("Stopped; run it again to go on, if the code is the same.")
