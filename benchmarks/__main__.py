"""The evaluation of the paper on generated data: `python -m benchmarks [floor] [cold] [rq1] [rq2] [rq3]`.

Tables and figures go to `benchmarks/results/`, with machine, versions and sizes::

    make bench                                      # all, about 15 minutes on two quiet processors
    python -m benchmarks rq1 --size 4 --trials 5
    python -m benchmarks rq1 --converter 'python convert.py --bag {bag} --out {out}'
    python -m benchmarks --full                     # the paper's 20.4 GB
    python -m benchmarks --tiny rq1                 # does it run? its figures say nothing
"""

import argparse
import sys
import tempfile
from pathlib import Path

# Those that are run as files find the package beside them.
sys.path.insert(0, str(Path(__file__).parents[1]))

PARTS = ("floor", "cold", "rq1", "rq2", "rq3")
FULL_GB, FULL_RECORDINGS = 20.4, 40
TINY_GB = 0.06


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--size", type=float, default=1.0, metavar="GB", help="recordings of RQ1 (default 1)")
    parser.add_argument("--recordings", type=int, default=4, help="their number (default 4)")
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--tiny", action="store_true", help="small recordings, one trial; needs --results")
    parser.add_argument("--full", action="store_true", help=f"{FULL_GB} GB in {FULL_RECORDINGS} recordings")
    parser.add_argument("--converter", metavar="CMD", help="another converter, with {bag} and {out}")
    parser.add_argument("--folder", type=Path, help="where to work; what is there is used again")
    parser.add_argument(
        "--results", type=Path, help="where tables and figures go; default: benchmarks/results"
    )
    chosen = parser.parse_args()
    unknown = set(chosen.parts) - set(PARTS)
    if unknown:
        parser.error(f"no such part: {', '.join(sorted(unknown))}; the parts are {', '.join(PARTS)}")
    if chosen.size <= 0 or chosen.trials < 1 or chosen.recordings < 1:
        parser.error("--size, --trials and --recordings must be positive")
    if chosen.converter and not ("{bag}" in chosen.converter and "{out}" in chosen.converter):
        parser.error("--converter must say where {bag} and {out} go")

    results = chosen.results
    if chosen.tiny:
        if results is None:
            parser.error("--tiny needs --results: its figures say nothing, and must not replace others")
        chosen.size, chosen.recordings, chosen.trials, chosen.full = TINY_GB, 2, 1, False

    from benchmarks.cold import cold
    from benchmarks.common import Options
    from benchmarks.floor import floor
    from benchmarks.rq1 import rq1
    from benchmarks.rq2 import rq2
    from benchmarks.rq3 import rq3

    size, number = (FULL_GB, FULL_RECORDINGS) if chosen.full else (chosen.size, chosen.recordings)
    with tempfile.TemporaryDirectory(prefix="bagassets-bench-", ignore_cleanup_errors=True) as temporary:
        folder = (chosen.folder or Path(temporary)).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        results = results or Path(__file__).parent / "results"
        options = Options(folder, results, chosen.trials, size, number, chosen.converter, chosen.tiny)
        run = {"floor": floor, "cold": cold, "rq1": rq1, "rq2": rq2, "rq3": rq3}
        for part in chosen.parts or PARTS:
            print(f"## {part}\n", flush=True)
            run[part](options)


if __name__ == "__main__":
    main()
