"""Fuzz everything that reads bytes: `make fuzz`, or `python -m bagassets_tests.fuzz [--minutes M] [TARGET …]`.

Each target runs in a process of its own, with atheris, which follows what is executed in our code; an input may take ten
seconds and two gigabytes. What is found lies in `build/fuzz/TARGET/found`, and corpora are kept beside it for the next time.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from bagassets_tests.fuzz.targets import TARGETS

ROOT = Path(__file__).parents[2]
_MOST_S, _MOST_MB = 10, 2000


def main(arguments):
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__.partition("\n")[0])
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(TARGETS)}; default: all")
    parser.add_argument("--minutes", type=float, default=1.0, help="for all of them together; default: 1")
    parser.add_argument(
        "--seed", type=int, default=0, help="of what is made up; default: another one each time"
    )
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "fuzz")
    options = parser.parse_args(arguments)
    if unknown := set(options.targets) - set(TARGETS):
        parser.error(f"no target {unknown.pop()}; the targets are {', '.join(TARGETS)}")
    chosen = options.targets or list(TARGETS)
    seconds = max(1, round(60 * options.minutes / len(chosen)))
    failed = [name for name in chosen if not _fuzzed(name, options.folder / name, seconds, options.seed)]
    if failed:
        print(f"found: {', '.join(failed)}; the inputs are in {options.folder}/TARGET/found")
    return 1 if failed else 0


def _fuzzed(name, folder, seconds, seed):
    """Fuzz one target; return whether nothing was found."""
    corpus, seeds, found = (folder / one for one in ("corpus", "seeds", "found"))
    for one in (corpus, seeds, found):
        one.mkdir(parents=True, exist_ok=True)
    (scratch := folder / "scratch").mkdir(exist_ok=True)
    if not any(seeds.iterdir()):
        for number, data in enumerate(TARGETS[name].seeds(scratch)):
            (seeds / f"{number:03}").write_bytes(data)
    command = [
        *(sys.executable, "-m", "bagassets_tests.fuzz.one", name, str(corpus), str(seeds)),
        *(f"-seed={seed}", f"-max_total_time={seconds}", f"-timeout={_MOST_S}", f"-rss_limit_mb={_MOST_MB}"),
        *("-max_len=65536", f"-artifact_prefix={found}/", "-print_final_stats=1"),
    ]
    before = set(found.iterdir())
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "BAGASSETS_FUZZ": "1"}, capture_output=True, text=True,
        errors="replace", timeout=2 * seconds + 300, check=False,
    )  # fmt: skip
    lines = (done.stderr + done.stdout).splitlines()  # the traceback is in the latter
    runs = next((line.split()[-1] for line in lines if "number_of_executed_units" in line), "?")
    new = sorted(set(found.iterdir()) - before)
    print(
        f"{name:12} {runs:>8} inputs in {seconds} s: {'nothing' if done.returncode == 0 else 'FOUND'}",
        flush=True,
    )
    if done.returncode:
        print("\n".join(lines[-60:]), *new, sep="\n", flush=True)
    return done.returncode == 0 and not new


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
