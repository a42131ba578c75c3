"""RQ3: granularity. The same volume in one, two or eight recordings, one of which gets another date.

The target stays the same, the dataset. A client that hashes reads the recording again to find that its
content did not change, so finer recordings cost less; with stored digests the granularity does not matter.
"""

from functools import partial

from benchmarks.common import Options, markdown, median, project, repeated, save
from benchmarks.figures import bars

__all__ = ["rq3"]

COUNTS = (1, 2, 8)


def rq3(options: Options) -> None:
    """Measure, and write `rq3.json`, `rq3.md` and `rq3.png`."""
    times: dict[str, dict[str, list[float]]] = {"client-side hashing": {}, "stored digests": {}}
    volume = options.size_gb * 1e9
    for count in COUNTS:
        made = project(
            options.folder / f"rq3-{count}", [volume / count] * count, options.trials, first_seed=200
        )
        made.start_over()
        made.build("built in")
        for name, before in (("client-side hashing", made.touch), ("stored digests", made.touch_and_store)):
            times[name][f"{count} files"] = repeated(options.trials, before, partial(made.build, " in "))
        made.stop_server()
    rows = [
        [f"{name}, {count}", median(taken), min(taken), max(taken)]
        for name, by_count in times.items()
        for count, taken in by_count.items()
    ]
    table = f"{options.size_gb:.2f} GB in all, {options.trials} trials.\n\n" + markdown(
        ["run", "median s", "min s", "max s"], rows
    )
    save(options, "rq3", {"volume_gb": options.size_gb, "times_s": times}, table)
    bars(options.results / "rq3.png", times, f"RQ3: {options.size_gb:.1f} GB in 1, 2 and 8 recordings")
