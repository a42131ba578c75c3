"""Mutation testing: does any test fail when a line of the code is wrong?

`make mutants`, or `python -m scripts.mutants --number 320 --seed 12`. What is known of coverage and results is
kept in `build/mutants`; a second call goes on where the first one stopped. About an hour of one processor for
coverage, and some seconds for each mutant.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from scripts.mutants.choose import Covered, choose, line_keys, read_covered, to_covered, write_covered
from scripts.mutants.mutate import PACKAGES, Mutant, all_mutants, difference, sample
from scripts.mutants.workshop import Workshop

ROOT = Path(__file__).resolve().parents[2]
# Digests of bytes see any change of bytes: what they alone see is counted by itself.
PINNED = "bagassets_tests/whole/test_golden.py"
# Nothing in these runs what is mutated, or they need what is not there.
LEFT_OUT = {"test_benchmarks.py", "test_postgres.py", "test_ui.py", "test_checkout.py", "test_layers.py"}
COVERAGE_S = 900
_FIRST = 2


class Worker:
    """A copy of the checkout and the process that runs tests in it."""

    def __init__(self, folder: Path, niceness: int) -> None:
        self.workshop = Workshop(folder, ROOT)
        self._sound: dict[str, bool] = {}
        self._process = subprocess.Popen(
            ["nice", "-n", str(niceness), str(self.workshop.python), "-m", "scripts.mutants.worker"],
            cwd=self.workshop.tree, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={name: value for name, value in os.environ.items() if not name.startswith(("BAGASSETS_RECIPE", "DAGSTER"))},
        )  # fmt: skip

    def warm_up(self) -> None:
        """Collect all tests once, so that they and the package are compiled for all jobs to come."""
        self.do({"files": ["bagassets_tests"], "tests": [], "cpu_s": 600, "wall_s": 3600})

    def do(self, job: dict[str, Any]) -> dict[str, Any]:
        """Do one job."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        given = {"scratch": str(self.workshop.scratch), "tree": str(self.workshop.tree)} | job
        self._process.stdin.write(json.dumps(given) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer

    def passes(self, test: str) -> bool:
        """Tell whether a test, or the collection of a file, passes without a mutant; what does not is left out."""
        if test not in self._sound:
            job = {"files": [test.partition("::")[0]], "tests": [test], "cpu_s": 600, "wall_s": 1200}
            self._sound[test] = self.do(job)["outcome"] == "survived"
        return self._sound[test]

    @property
    def broken(self) -> list[str]:
        """Tests that fail without a mutant, and files that cannot be collected."""
        return [test for test, sound in self._sound.items() if not sound]

    def close(self) -> None:
        """Have the process end."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def main() -> None:
    """Measure coverage, run mutants, print the table."""
    parser = argparse.ArgumentParser(prog="python -m scripts.mutants", description=__doc__)
    parser.add_argument("--number", type=int, default=320, help="of mutants in the sample")
    parser.add_argument("--seed", type=int, default=12, help="of the sample")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--nice", type=int, default=10)
    parser.add_argument("--cap", type=float, default=20.0, help="seconds of tests per mutant")
    parser.add_argument("--only", default="", help="mutants of files that begin so")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "mutants")
    parser.add_argument(
        "--measured", action="store_true", help="take coverage as it was measured; measure nothing"
    )
    parser.add_argument(
        "--cover", nargs="*", metavar="FILE", help="only measure coverage, of these test files or all"
    )
    parser.add_argument("--tests", nargs="*", metavar="FILE", help="ask only these test files")
    parser.add_argument("--again", action="store_true", help="run survivors again: tests may have been added")
    parser.add_argument("--fast", action="store_true", help="without pinned digests, for a first pass")
    parser.add_argument("--table", action="store_true", help="only print what is known")
    given = parser.parse_args()
    given.measured = given.measured or bool(given.tests)
    given.folder.mkdir(parents=True, exist_ok=True)
    results = (
        given.folder / f"seed-{given.seed}{'-' + given.only.replace('/', '.') if given.only else ''}.jsonl"
    )
    if not given.table:
        workers: SimpleQueue[Worker] = SimpleQueue()
        made = [Worker(given.folder / f"w{number}", given.nice) for number in range(given.workers)]
        for worker in made:
            worker.warm_up()
            workers.put(worker)
        try:
            covered = list(_coverage(workers, given))
            if given.cover is None:
                _run(workers, covered, results, given)
        finally:
            for worker in made:
                worker.close()
    if given.cover is None:
        print(_table(_read(results)))


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _coverage(workers: SimpleQueue[Worker], given: argparse.Namespace) -> Iterator[Covered]:
    folder = given.folder / "coverage"
    folder.mkdir(exist_ok=True)
    tests = sorted(
        path for path in (ROOT / "bagassets_tests").rglob("test_*.py") if path.name not in LEFT_OUT
    )
    if given.cover:
        tests = [ROOT / name for name in given.cover]
    if given.measured:
        tests = [path for path in tests if (folder / f"{path.stem}.json").exists()]
    sources = {
        path: line_keys((ROOT / path).read_text("utf-8")) for path in sorted({m.path for m in _everything()})
    }

    if not given.measured:
        (folder / "lines.keys").write_text(json.dumps(sources))

    def measure(path: Path) -> Covered:
        file, kept = path.relative_to(ROOT).as_posix(), folder / f"{path.stem}.json"
        if kept.exists():
            known = read_covered(kept)
            if known.digest == _digest(path) or given.measured:
                return known
        worker = workers.get()
        try:
            job = {
                "files": [file],
                "tests": None,
                "coverage": True,
                "cpu_s": COVERAGE_S,
                "wall_s": 3 * COVERAGE_S,
            }
            answer = worker.do(job)
        finally:
            workers.put(worker)
        if "times" not in answer or "lines" not in answer:
            print(f"{file}: {answer['outcome']} {answer['why']}", file=sys.stderr)
            answer |= {"times": {}, "failed": [], "lines": {}}
        covered = to_covered(file, _digest(worker.workshop.tree / file), answer, sources)
        write_covered(covered, kept)
        print(
            f"{file}: {len(covered.seconds)} tests in {answer['seconds']} s, {len(covered.failed)} fail here",
            covered.failed[:5], flush=True,
        )  # fmt: skip
        return covered

    with ThreadPoolExecutor(given.workers) as pool:
        yield from pool.map(measure, tests)


def _everything() -> list[Mutant]:
    return all_mutants(ROOT)


def _run(
    workers: SimpleQueue[Worker], covered: list[Covered], results: Path, given: argparse.Namespace
) -> None:
    everything = [mutant for mutant in _everything() if mutant.path.startswith(given.only)]
    print(f"{len(everything)} mutants; {given.number} of them, seed {given.seed}", flush=True)
    known = {row["name"]: row for row in _read(results)}
    wanted: set[str] = set()
    groups = [[of for of in covered if of.file != PINNED]]
    if not given.fast:
        groups.append([of for of in covered if of.file == PINNED])
    measured = json.loads((given.folder / "coverage" / "lines.keys").read_text())

    def do(mutant: Mutant, text: str) -> None:
        wanted.add(mutant.name)
        before = known.get(mutant.name)
        if before and not (given.again and before["outcome"] == "survived"):
            return
        worker = workers.get()
        try:
            row = _judge(worker, mutant, text, groups, given, measured)
        finally:
            workers.put(worker)
        row |= {"name": mutant.name, "package": mutant.package, "line": mutant.first_line}
        known[mutant.name] = row
        with results.open("a") as out:
            out.write(json.dumps(row) + "\n")
        line = f"{row['outcome']:9}{row['tests']:5} tests {row['seconds']:6.1f} s  {mutant.path}:{mutant.first_line}"
        print(
            line, row.get("killer", ""), *([row["diff"]] if row["outcome"] == "survived" else []), flush=True
        )

    with ThreadPoolExecutor(given.workers) as pool:
        for done in [pool.submit(do, *drawn) for drawn in sample(everything, given.number, given.seed, ROOT)]:
            done.result()
    (results.with_suffix(".names")).write_text("\n".join(sorted(wanted)))


def _judge(
    worker: Worker,
    mutant: Mutant,
    text: str,
    groups: list[list[Covered]],
    given: argparse.Namespace,
    measured: dict[str, list[str]],
) -> dict[str, Any]:
    """Run tests until one fails that passes without the mutant; pinned digests come last."""
    source = (worker.workshop.tree / mutant.path).read_text("utf-8")
    keys, lines = line_keys(source), range(mutant.first_line, mutant.last_line + 1)
    row: dict[str, Any] = {
        "outcome": "survived",
        "tests": 0,
        "seconds": 0.0,
        "diff": difference(source, text),
    }
    for alone, group in enumerate(groups):
        ran = measured.get(mutant.path, ())
        files, _ = choose(group, mutant.path, keys, lines, given.cap, worker.broken, ran)
        if given.tests and not alone:
            files = {known.file: list(known.seconds) for known in group if known.file in given.tests}
        # The cheapest first by themselves: most mutants die there, and no other file is imported for them.
        names = list(files)
        for some in (names[:_FIRST], names[_FIRST:]):
            verdict = (
                _tried(worker, mutant, text, {name: files[name] for name in some}, group) if some else {}
            )
            row["seconds"] += verdict.get("seconds", 0.0)
            row["tests"] += verdict.get("tests", 0)
            if verdict.get("outcome", "survived") != "survived":
                return (
                    row | verdict | {"seconds": row["seconds"], "tests": row["tests"], "pinned": bool(alone)}
                )
    return row


def _tried(
    worker: Worker, mutant: Mutant, text: str, files: dict[str, list[str]], group: list[Covered]
) -> dict[str, Any]:
    """Run tests until one fails that passes without the mutant."""
    seconds = {test: known.seconds[test] for known in group for test in files.get(known.file, ())}
    spent = 0.0
    while True:
        tests = [test for of in files.values() for test in of if test not in worker.broken]
        expected = sum(seconds[test] for test in tests)
        job = {
            "path": str(worker.workshop.tree / mutant.path), "text": text, "tests": tests,
            "files": [name for name in files if name not in worker.broken],
            "cpu_s": 30 + 8 * expected, "wall_s": 300 + 30 * expected,
        }  # fmt: skip
        answer = worker.do(job)
        spent += answer["seconds"]
        if answer["outcome"] == "survived":
            return {"outcome": "survived", "seconds": spent, "tests": len(tests)}
        if not answer["killer"] or worker.passes(answer["killer"]):
            return {key: answer[key] for key in ("outcome", "killer", "why")} | {"seconds": spent}


def _read(results: Path) -> list[dict[str, Any]]:
    """Return the newest result of each mutant of the sample."""
    if not results.exists():
        return []
    rows = {row["name"]: row for row in map(json.loads, results.read_text().splitlines())}
    names = results.with_suffix(".names")
    wanted = set(names.read_text().splitlines()) if names.exists() else set(rows)
    return [row for name, row in rows.items() if name in wanted]


def _table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| | mutants | killed | of them hung | by pinned digests alone | survived | killed |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name in (*PACKAGES, "all"):
        of = [row for row in rows if name in {row["package"], "all"}]
        if of:
            killed = [row for row in of if row["outcome"] != "survived"]
            hung = sum(row["outcome"] == "hung" for row in killed)
            alone = sum(row.get("pinned", False) for row in killed)
            lines.append(
                f"| {name} | {len(of)} | {len(killed)} | {hung} | {alone} | {len(of) - len(killed)} "
                f"| {100 * len(killed) / len(of):.1f} % |"
            )
    survivors = [
        f"{row['name']} line {row['line']} ({row['tests']} tests)\n{row['diff']}"
        for row in rows
        if row["outcome"] == "survived"
    ]
    return "\n".join([*lines, "", *survivors])


if __name__ == "__main__":
    main()
