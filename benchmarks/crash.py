"""Every crash replayed, every change of files failed once, and every short history of a project.

The commands of `bagassets_tests/crash_project.py` are recorded, change by change of files. After a crash before each change, with
what may be left then (killed; without power: new files empty, full of zeros, torn in the middle, any of these, and a change
lost; all with and without the last commit of Dagster's database), a build must end well, then `verify` must find nothing and
the dataset be that of a project built from nothing. The same after each change failed once, with EIO and with ENOSPC, and after
each read failed once, with EIO, where the command must end in a sentence; and after histories of three steps::

    make crash                                   # all of them: some hours on two quiet cores
    python -m benchmarks.crash --share 0.05      # a sample
    python -m benchmarks.crash --only history
    python -m benchmarks.crash --command removal --json benchmarks/results/crash.json   # this one again, into these results

The exit status is 1 if anything went wrong.
"""

import argparse
import json
import multiprocessing
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, machine, markdown

__all__ = ["crash_table"]

_CODE = "bagassets_tests.crash_project"  # imported when it is needed, as it imports Dagster
_failing_reads: Any = import_module("bagassets_tests.failing_reads")
_PARTS = ("crash", "failure", "read", "history")
_EACH = 25

Try = tuple[str, str, str]
"""What was tried: part, command, and what was wrong then (an empty text: nothing)."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--share", type=float, default=1.0, help="share of all that is tried, by chance")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=_PARTS, help="only this part")
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
    begun, tries, problems = time.monotonic(), Counter[tuple[str, str]](), list[str]()
    good = Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory(dir=options.folder if options.folder.is_dir() else None) as name:
        for part, command, problem in _tried(Path(name), options):
            tries[part, command] += 1
            good[part, command] += not problem
            if problem:
                problems.append(f"{part}, {command}: {problem}")
                print(problems[-1], file=sys.stderr, flush=True)
            if tries.total() % _EACH == 0:
                print(f"{tries.total()} tried, {len(problems)} problems: now {part}, {command}", flush=True)
    rows = [[part, command, number, good[part, command]] for (part, command), number in sorted(tries.items())]
    found = {
        "machine": machine(), "seed": options.seed, "share": options.share, "commit": _git("rev-parse", "--short", "HEAD"),
        "date": time.strftime("%Y-%m-%d"), "minutes": round((time.monotonic() - begun) / 60), "tried": rows,
        "problems": problems,
    }  # fmt: skip
    if options.command and options.json:
        found = _with_again(json.loads(options.json.read_text("utf-8")), found, options.command)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(crash_table(found))
    return 1 if problems else 0


def _tried(folder: Path, options: argparse.Namespace) -> Iterator[Try]:
    """Yield what workers tried; each records the commands for itself, and tries every so many of the crashes."""
    context = multiprocessing.get_context("fork")
    answers: Any = context.Queue()
    workers = [
        context.Process(target=_work, args=(folder / str(number), number, options, answers.put))
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
    folder: Path, number: int, options: argparse.Namespace, answer: Callable[[Try | None], None]
) -> None:
    code: Any = import_module(_CODE)

    def mine(all_of_it: Any) -> Iterator[Any]:
        """Those of all tries that are in the sample, and this worker's."""
        dice = random.Random(options.seed)
        for index, one in enumerate(all_of_it):
            if dice.random() < options.share and index % options.workers == number:
                yield one

    try:
        folder.mkdir()
        project = code.Project(folder)
        for command in code.SCENARIOS if options.only != "history" else ():
            if options.command not in (None, command):
                continue
            scenario = code.recorded(project, command)
            code.import_what_was_needed()
            tried = {
                "crash": (code.crashes(scenario, options.seed), code.replay),
                "failure": (code.failures(scenario), code.fail),
                "read": (code.reads(project, scenario), code.fail_read),
            }
            for part, (all_of_it, run) in tried.items():
                for one in mine(all_of_it) if options.only in (None, part) else ():
                    problem = run(project, scenario, one)
                    if problem is not None:
                        answer((part, command, problem and f"{one}: {problem}"))
        if options.only in (None, "history") and options.command is None:
            histories = code.Histories(folder)
            for steps in mine(product(code.STEPS, repeat=3)):
                problem = histories.run(steps, options.seed)
                answer(("history", "three steps", problem and f"{', '.join(steps)}: {problem}"))
    except BaseException as err:
        answer(("worker", str(number), repr(err)))
        raise
    finally:
        answer(None)


def _with_again(before: dict[str, Any], found: dict[str, Any], command: str) -> dict[str, Any]:
    """Return results in which those of one command are newer than the rest."""
    rows = [row for row in before["tried"] if row[1] != command] + found["tried"]
    problems = [one for one in before["problems"] if f", {command}: " not in one] + found["problems"]
    again = {**before.get("again", {}), command: {"date": found["date"], "commit": found["commit"]}}
    return {**before, "tried": sorted(rows), "problems": problems, "again": again}


def crash_table(found: dict[str, Any]) -> str:
    """Return the results as a table in Markdown, and where they are from."""
    names = {
        "crash": "crashes", "failure": "changes of files that fail once", "read": "reads that fail once", "history": "histories",
    }  # fmt: skip
    rows = [(f"{names.get(part, part)}: {command}", *numbers) for part, command, *numbers in found["tried"]]
    share = "all there are" if found["share"] == 1 else f"{100 * found['share']:g} % of all, by chance"
    where = f"On {found['date']}, commit {found['commit']}: {share}, with seed {found['seed']}"
    for command, newer in found.get("again", {}).items():
        where += f"; *{command}* once more on {newer['date']}, commit {newer['commit']}"
    where += ".\n\n"
    return where + markdown(("", "tried", "good"), rows)


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    sys.exit(main())
