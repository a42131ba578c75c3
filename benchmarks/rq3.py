"""RQ3: granularity. A fixed volume V in one, two or eight recordings, beside a constant target R of V/8.

Only R changes, and only in what nothing reads: it gets another message on a topic that nothing reads (*metadata*), or
just another date (*touched*). Without stored digests the build hashes R to find out; with them it reads one. Into how
many recordings the rest is cut should not matter. All recordings have different seeds: equal content is one to us.
"""

from typing import Any

from benchmarks.common import Options, Project, markdown, median, project, repeated, save, write_drives
from benchmarks.figures import bars

__all__ = ["rq3", "rq3_table"]

COUNTS, TINY_COUNTS = (1, 2, 8), (1, 2)
_R_SEED, _V_SEED = 200, 300


def rq3(options: Options) -> None:
    """Measure, and write `rq3.json`, `rq3.md` and `rq3.png`."""
    volume = options.size_gb * 1e9
    times: dict[str, dict[str, list[float]]] = {}
    for count in TINY_COUNTS if options.tiny else COUNTS:
        made = project(options.folder / f"rq3-{count}", [volume / 8], options.trials, first_seed=_R_SEED)
        # R is `drive000.bag`, the recording that changes; those of V come after it.
        write_drives(made.bags, [volume / count] * count, first_seed=_V_SEED, prefix="v")
        made.start_over()
        made.build("built in")
        for change in ("metadata", "touched"):
            for digests in ("client-side hashing", "stored digests"):
                taken = _times(made, change, stored=digests == "stored digests")
                times.setdefault(f"{change}, {digests}", {})[f"{count} + 1 files"] = taken
        made.stop_server()
    figures = {"volume_gb": options.size_gb, "target_gb": options.size_gb / 8, "times_s": times}
    save(options, "rq3", figures, rq3_table({"trials": options.trials, **figures}))
    title = f"RQ3: {options.size_gb:.1f} GB in 1, 2 and 8 recordings, a change in another one"
    bars(options.results / "rq3.png", times, title)


def rq3_table(found: dict[str, Any]) -> str:
    """Return the table of `rq3.json`."""
    rows = [
        [f"{name}: {count}", median(taken), min(taken), max(taken)]
        for name, by_count in found["times_s"].items()
        for count, taken in by_count.items()
    ]
    about = (
        f"V = {found['volume_gb']:.2f} GB in 1, 2 or 8 recordings, R = {found['target_gb']:.3g} GB in one more; "
        f"{found['trials']} trials.\n\n"
    )
    return about + markdown(["run", "median s", "min s", "max s"], rows)


def _times(made: Project, change: str, *, stored: bool) -> list[float]:
    def before() -> None:
        made.change_metadata() if change == "metadata" else made.touch()
        made.store_digests() if stored else made.hash_at_client()

    before()
    made.build(" in ")  # the server is up from here on
    return repeated(made.times, before, lambda: made.build(" in "))
