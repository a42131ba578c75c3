"""Which tests may see a mutant, cheapest first: what every test ran, kept by function and text of the line.

Kept so, what is known outlives changes elsewhere in the file.
"""

import ast
import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["Covered", "line_keys", "read_covered", "to_covered"]

Keys = Mapping[str, list[str]]
"""File -> a key for each of its lines: digest of the function's name, colon, digest of the text."""


def line_keys(source: str) -> list[str]:
    """Return a key for each line."""
    lines = source.splitlines()
    owner = [""] * len(lines)

    def own(node: ast.AST, name: str) -> None:
        for child in ast.iter_child_nodes(node):
            inner = name
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                inner = f"{name}.{child.name}"
                if not isinstance(child, ast.ClassDef):
                    # The head of a function runs with what is around it.
                    for number in range(child.body[0].lineno - 1, child.end_lineno or child.lineno):
                        owner[number] = inner
            own(child, inner)

    own(ast.parse(source), "")
    return [
        f"{_short(name) if name else ''}:{_short(text.strip())}"
        for name, text in zip(owner, lines, strict=True)
    ]


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:10]


@dataclass(frozen=True, slots=True)
class Covered:
    """What the tests of one file ran."""

    file: str
    digest: str
    seconds: dict[str, float]
    failed: tuple[str, ...]
    whole: dict[str, set[str]]
    """File of the package -> keys of lines that a fixture, or a process that a test started, ran."""
    tests: dict[str, dict[str, set[str]]]
    """File of the package -> test -> keys of lines."""
    functions: dict[str, set[str]] = field(default_factory=dict)

    def who(self, path: str, keys: set[str]) -> list[str]:
        """Return the tests that ran one of the lines, in the order of the file."""
        if keys & self.whole.get(path, set()):
            return self._good(self.seconds)
        return self._good(test for test, lines in self.tests.get(path, {}).items() if lines & keys)

    def _good(self, tests: Iterable[str]) -> list[str]:
        chosen = set(tests) - set(self.failed)
        return [test for test in self.seconds if test in chosen]


def to_covered(file: str, digest: str, answer: Mapping[str, Any], keys: Keys) -> Covered:
    """Sort what a worker measured: lines of one test, lines of all."""
    whole: dict[str, set[str]] = {}
    tests: dict[str, dict[str, set[str]]] = {}
    for path, contexts in answer["lines"].items():
        of = keys.get(path)
        if of is None:
            continue
        set_up: dict[int, list[str]] = {}
        for context, lines in contexts.items():
            phase, _, test = context.partition("|")
            if phase == "setup":
                for line in lines:
                    set_up.setdefault(line, []).append(test)
            elif phase == "process":
                whole.setdefault(path, set()).update(of[line - 1] for line in lines)
            elif phase == "call":
                tests.setdefault(path, {}).setdefault(test, set()).update(of[line - 1] for line in lines)
        for line, who in set_up.items():
            # What one test alone had set up may serve the others, too.
            if len(who) == 1:
                whole.setdefault(path, set()).add(of[line - 1])
            for test in who:
                tests.setdefault(path, {}).setdefault(test, set()).add(of[line - 1])
    return Covered(file, digest, answer["times"], tuple(answer["failed"]), whole, tests)


def write_covered(covered: Covered, path: Path) -> None:
    """Write it as JSON, keys by number."""
    index: dict[str, int] = {}

    def numbers(keys: set[str]) -> list[int]:
        return sorted(index.setdefault(key, len(index)) for key in sorted(keys))

    content = {
        "file": covered.file, "digest": covered.digest, "seconds": covered.seconds, "failed": covered.failed,
        "whole": {path: numbers(keys) for path, keys in covered.whole.items()},
        "tests": {
            path: {test: numbers(keys) for test, keys in tests.items()} for path, tests in covered.tests.items()
        },
    }  # fmt: skip
    path.write_text(json.dumps(content | {"keys": list(index)}))


def read_covered(path: Path) -> Covered:
    """Read what was written."""
    content = json.loads(path.read_text())
    keys = content["keys"]
    return Covered(
        content["file"], content["digest"], content["seconds"], tuple(content["failed"]),
        {path: {keys[n] for n in of} for path, of in content["whole"].items()},
        {
            path: {test: {keys[n] for n in of} for test, of in tests.items()}
            for path, tests in content["tests"].items()
        },
    )  # fmt: skip


def choose(
    covered: Iterable[Covered],
    path: str,
    keys: list[str],
    lines: range,
    cap_s: float,
    broken: Collection[str],
    measured: Collection[str],
) -> tuple[dict[str, list[str]], float]:
    """Return file -> tests for a mutant in some lines of a file, and the seconds that they take.

    Files are in the order of what they cost. Of a line that only importing runs, the tests that run any function
    of its module; of one that is new since coverage was measured, those that run its function; of one that no test
    ran, none.
    """
    mine = {keys[line - 1] for line in lines}
    covered = [known for known in covered if known.file not in broken]
    functions = {key.partition(":")[0] for key in mine} - {""}
    groups = [(known, known.who(path, {key for key in mine if not key.startswith(":")})) for known in covered]
    if not any(tests for _, tests in groups) and not (functions and mine <= set(measured)):
        same = {
            key
            for known, _ in groups
            for of in (known.whole.get(path, set()), *known.tests.get(path, {}).values())
            for key in of
            if (key.partition(":")[0] in functions if functions else not key.startswith(":"))
        }
        groups = [(known, known.who(path, same)) for known, _ in groups]
    groups = [(known, [test for test in tests if test not in broken]) for known, tests in groups]
    priced = sorted(
        (
            (sum(known.seconds[test] for test in tests), known.file, known, tests)
            for known, tests in groups
            if tests
        ),
        key=lambda group: group[:2],
    )
    chosen: dict[str, list[str]] = {}
    total = 0.0
    for cost, file, known, tests in priced:
        if total + cost <= cap_s or not chosen:
            chosen[file] = tests
            total += cost
        else:
            for test in sorted(tests, key=lambda name: known.seconds[name]):
                if total + known.seconds[test] > cap_s:
                    break
                chosen.setdefault(file, []).append(test)
                total += known.seconds[test]
    return chosen, total
