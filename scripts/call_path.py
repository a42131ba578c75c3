"""Follow a recording through the code: at how many of our functions it stops before it is worked on, and how its path climbs.

    python -m scripts.call_path                                          # prints a table
    python -m scripts.call_path --json benchmarks/results/call_path.json  # keeps it as "after" (or --as before)
    python -m scripts.call_path --checkout ../before --like e103f82       # code whose modules had other places

Four cases, each on a project of one recording of a second, with a fork server that is up, as always but the first time:

- fresh: `bagassets build`, after another recording came, since nothing is looked at where nothing has changed;
- stale: `bagassets build`, after the recording was replaced by another;
- damaged: `bagassets build`, after the recording was cut short;
- tick: `dagster sensor preview`, after the recording was replaced.

A *stop* is a function of `defs/` or `engine/` that is called with the recording in its hands before the executor begins, in any
process. *In its hands* means that the key, the path or the `RecordingFiles` of the recording is an argument, a field or an
element of one, or a field or an element of these. A function counts once, however often it is called; properties count as
fields, and lambdas, comprehensions and generated methods as part of what they stand in. *The executor* is
`execute.execute`. What it calls does not count, nor do inventories that are made ahead of the run, nor what comes later.

A *climb* is a stop on a higher floor than the stop before it in the same thread: the way goes up again. Floors are `LAYERS` and
`ROOMS` of `test_layers`. Code from before these is placed where its modules are now, by the renames that git finds.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from functools import cached_property
from inspect import getattr_static
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType
from typing import Any

HERE = Path(__file__).resolve().parents[1]
CASES = ("fresh", "stale", "damaged", "tick")
KEY = "drive.mcap"
ABOVE = ("defs", "engine")  # what a recording passes before it is worked on
EXECUTORS = {("execute.py", "execute"), ("run_action.py", "run_action")}
# Every Python that a traced command starts finds this module, and is traced as well.
SITE = f"import os, runpy\nif os.environ.get('CALL_PATH'):\n    runpy.run_path({__file__!r})['follow']()\n"
BESIDE = ("first_pass.py", "made_ahead.py")  # inventories are made by another process, while the build begins
SETTLED_S = 3  # what changed less long ago is looked at again
MOST = 50  # elements of a collection that are looked at
PART_OF_ANOTHER = ("<", "__")  # `<lambda>`, `__init__`


# --- in each process that is traced -------------------------------------------------------------


def follow() -> None:
    """Write down each function that gets the recording, in a file of this process."""
    folder, package, path = (
        os.environ[name] for name in ("CALL_PATH", "CALL_PATH_PACKAGE", "CALL_PATH_RECORDING")
    )

    def is_ours(value: object) -> bool:
        return type(value).__module__.startswith("bagassets.")

    def is_it(value: object, depth: int = 2) -> bool:
        if isinstance(value, str):
            return value in (KEY, path)
        if isinstance(value, Path):
            return str(value) == path
        if type(value).__name__ == "RecordingFiles":
            return getattr(value, "key", None) == KEY
        return depth > 0 and any(is_it(part, depth - 1) for part in parts_of(value))

    def parts_of(value: object) -> list[object]:
        if type(value) is dict:  # no subclass: classes of Dagster refuse to be looked through
            return [*list(value)[:MOST], *list(value.values())[:MOST]]
        if isinstance(value, (list, tuple, set, frozenset)) and type(value).__module__ == "builtins":
            return list(value)[:MOST]
        return list(vars(value).values()) if is_ours(value) and hasattr(value, "__dict__") else []

    def called(frame: FrameType, event: str, _arg: object) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(package):
            return
        arguments = arguments_of(frame)
        if code.co_name.startswith(PART_OF_ANOTHER) or not any(is_it(one) for one in arguments):
            return
        if isinstance(getattr_static(type(arguments[0]), code.co_name, None), (property, cached_property)):
            return
        above = list(frames_above(frame, package))
        if not any(
            (Path(one.co_filename).name, one.co_name) in EXECUTORS or one.co_filename.endswith(BESIDE)
            for one in (code, *above)[code.co_name == "execute" :]
        ):
            line = {
                "t": time.monotonic_ns(),
                "at": f"{code.co_filename[len(package) :]}:{code.co_qualname}",
                "thread": f"{os.getpid()} {threading.get_ident()}",
            }
            with open(f"{folder}/{os.getpid()}.jsonl", "a", encoding="utf-8") as out:  # noqa: PTH123  (quick)
                out.write(json.dumps(line) + "\n")

    sys.setprofile(called)
    threading.setprofile(called)


def arguments_of(frame: FrameType) -> list[object]:
    """Return the arguments of a call that begins."""
    code = frame.f_code
    names = code.co_varnames[
        : code.co_argcount + code.co_kwonlyargcount + bool(code.co_flags & 4) + bool(code.co_flags & 8)
    ]
    values = frame.f_locals
    return [values[name] for name in names if name in values]


def frames_above(frame: FrameType, package: str) -> Iterator[CodeType]:
    """Yield the code of our functions that are calling, from the nearest."""
    above = frame.f_back
    while above is not None:
        if above.f_code.co_filename.startswith(package):
            yield above.f_code
        above = above.f_back


# --- the four cases -----------------------------------------------------------------------------


def main() -> None:
    """Trace the cases and print, or keep, what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--checkout", type=Path, default=HERE, help="folder whose `bagassets` is traced")
    parser.add_argument("--like", help="commit of that checkout, if its modules had other places")
    parser.add_argument("--json", type=Path, help="file to keep the numbers in")
    parser.add_argument(
        "--as", dest="name", default="after", help="name of the numbers in the file (default: after)"
    )
    parser.add_argument("--path", action="store_true", help="print each stop, and a ^ where the path climbs")
    parser.add_argument("case", nargs="*", default=CASES)
    arguments = parser.parse_args()
    floors = Floors(arguments.like)
    counts = {}
    for case in arguments.case:
        stops = floors.stops(follow_case(case, arguments.checkout.resolve()))
        counts[case] = {"stops": len(stops), "climbs": sum(climbs for _, climbs in stops)}
        print(f"{case:8} {counts[case]['stops']:4} stops, {counts[case]['climbs']:3} climbs")
        if arguments.path:
            print("\n".join(f"  {'^' if climbs else ' '} {where}" for where, climbs in stops))
    if arguments.json is not None:
        kept = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
        arguments.json.write_text(json.dumps(kept | {arguments.name: counts}, indent=1) + "\n")


def call_path_table(found: dict[str, Any]) -> str:
    """Return the numbers before and after as Markdown."""
    names = [name for name in ("before", "after") if name in found]
    return "\n".join(
        [
            f"| stops / climbs | {' | '.join(names)} |",
            f"|---|{'--:|' * len(names)}",
            *(
                f"| {case} | {' | '.join('{stops} / {climbs}'.format(**found[name][case]) for name in names)} |"
                for case in CASES
            ),
        ]
    )


def follow_case(case: str, checkout: Path) -> list[dict[str, Any]]:
    """Return the stops of a case in the order of time, up to the executor."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        recording, project, traced = folder / "bags" / KEY, folder / "project", folder / "traced"
        for one in (recording.parent, traced, folder / "site"):
            one.mkdir(parents=True)
        (folder / "site" / "sitecustomize.py").write_text(SITE)
        quiet = {**os.environ, "PYTHONPATH": str(checkout)}
        tracing = quiet | {
            "PYTHONPATH": os.pathsep.join(map(str, (folder / "site", checkout, HERE))),
            "CALL_PATH": str(traced), "CALL_PATH_PACKAGE": f"{checkout}/bagassets/", "CALL_PATH_RECORDING": str(recording),
        }  # fmt: skip

        def python(*words: str, env: dict[str, str]) -> None:
            done = subprocess.run(
                [sys.executable, *words],
                cwd=project if project.exists() else folder,
                env=env,
                text=True,
                check=False,
                capture_output=True,
            )
            if done.returncode not in (0, 1):
                raise SystemExit(f"{words}: {done.stderr}")

        def write(seconds: float, recording: Path = recording) -> None:
            recording.unlink(missing_ok=True)
            python("-m", "bagassets", "sample", str(recording), "--duration", str(seconds), env=quiet)

        write(1)
        python("-m", "bagassets", "init", str(project), "--bags", str(recording.parent), env=quiet)
        recipe = project / "recipe.yaml"
        recipe.write_text(
            re.sub(r"^bags:$", "bags:\n  settle_s: 0", recipe.read_text(), count=1, flags=re.MULTILINE)
        )
        try:
            # The server that this starts is traced, too: it runs the build of the case.
            for _ in range(2):
                python("-m", "bagassets", "build", env=tracing)
                time.sleep(SETTLED_S)
            if case in ("stale", "tick"):
                write(1.5)
            elif case == "fresh":
                write(1, recording.with_name("other.mcap"))
            elif case == "damaged":
                os.truncate(recording, recording.stat().st_size // 2)
            begun = time.monotonic_ns()
            if case == "tick":
                python(
                    "-m",
                    "dagster",
                    "sensor",
                    "preview",
                    "recordings",
                    "-m",
                    "bagassets.definitions",
                    env=tracing,
                )
            else:
                python("-m", "bagassets", "build", env=tracing)
        finally:
            stop = "from pathlib import Path; from bagassets.forkserver.client import Client"
            python(
                "-c",
                f"{stop}\nfor client in Client.all_of(Path('.bagassets')): client.shutdown(grace_s=0.0)",
                env=quiet,
            )
        lines = [
            json.loads(line) for file in traced.glob("*.jsonl") for line in file.read_text().splitlines()
        ]
        return cut(sorted((line for line in lines if line["t"] >= begun), key=lambda line: line["t"]))


def cut(lines: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the lines up to the executor."""
    kept = []
    for line in lines:
        kept.append(line)
        file, function = line["at"].split(":")
        if (Path(file).name, function) in EXECUTORS:
            break
    return kept


class Floors:
    """The floor of each module: its layer, and its room in `defs/`.

    Args:
        like: commit of the code, if its modules had other places.
    """

    def __init__(self, like: str | None) -> None:
        from bagassets_tests.project.test_layers import LEVEL, ROOMS  # not in each process that is traced

        self.level, self.rooms = LEVEL, ROOMS
        self.now: dict[str, str] = {}
        if like is not None:
            call = ["git", "diff", "-M", "--name-status", "--diff-filter=R", like, "--", "bagassets"]
            renames = subprocess.run(call, cwd=HERE, check=True, capture_output=True, text=True).stdout
            for line in renames.splitlines():
                _, before, now = line.split("\t")
                self.now[before.removeprefix("bagassets/")] = now.removeprefix("bagassets/")

    def floor(self, module: str) -> tuple[int, int]:
        """Return how high a module is, where it is now."""
        first, *rest = module.removesuffix(".py").split("/")
        room = self.rooms.index(rest[0]) if first == "defs" and rest and rest[0] in self.rooms else -1
        return self.level.get(first, 0), room

    def stops(self, lines: Iterable[dict[str, Any]]) -> list[tuple[str, bool]]:
        """Return the stops in the order of time, each with whether the path climbs to it."""
        seen: set[tuple[str, str]] = set()
        last: dict[str, tuple[int, int]] = {}
        found = []
        for line in lines:
            module, _, function = line["at"].partition(":")
            module = self.now.get(module, module)
            if module.split("/")[0] not in ABOVE or (module, function) in seen:
                continue
            seen.add((module, function))
            floor = self.floor(module)
            found.append((f"{module}:{function}", floor > last.get(line["thread"], floor)))
            last[line["thread"]] = floor
        return found


if __name__ == "__main__":
    main()
