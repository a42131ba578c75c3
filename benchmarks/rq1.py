"""RQ1: cold, warm and incremental run times beside a plain sequential conversion.

Cold is an empty store, an empty Dagster instance and no server; warm is nothing changed; incremental is a
change in one recording, of metadata (a message that nothing reads) or of content (every image and packet).
A conversion without a store does everything again, whatever changed.
"""

from typing import Any

from benchmarks.common import Options, Project, markdown, median, project, repeated, save, speedup
from benchmarks.figures import bars

__all__ = ["METHODS", "method_times", "rq1"]

METHODS = {"bagassets, client-side hashing": False, "bagassets, stored digests": True}
PLAIN, CONVERTER = "plain sequential", "external converter"


def rq1(options: Options) -> None:
    """Measure, and write `rq1.json`, `rq1.md` and `rq1.png`."""
    size = options.size_gb * 1e9 / options.recordings
    made = project(options.folder / "rq1", [size] * options.recordings, options.trials)
    times, outputs = baselines(made, options)
    for name, stored in METHODS.items():
        times[name] = method_times(made, stored=stored, content=True)
    made.stop_server()
    scenarios = list(times[next(iter(METHODS))])
    rows = []
    for name, by_scenario in times.items():
        for scenario in scenarios:
            taken = by_scenario.get(scenario, by_scenario.get("cold", []))
            ratio, reduction = speedup(times[PLAIN]["cold"], taken)
            rows.append([f"{name}: {scenario}", median(taken), min(taken), max(taken), ratio, reduction])
    table = (
        f"{options.recordings} recordings, {made.size_gb:.2f} GB, {options.trials} trials.\n\n"
        + markdown(["run", "median s", "min s", "max s", "speed-up", "reduction %"], rows)
    )
    figures: dict[str, Any] = {"size_gb": made.size_gb, "recordings": options.recordings}
    save(options, "rq1", {**figures, "times_s": times, "outputs": outputs}, table + told(outputs))
    bars(
        options.results / "rq1.png",
        {name: {s: found.get(s, found["cold"]) for s in scenarios} for name, found in times.items()},
        f"RQ1: {options.recordings} recordings, {made.size_gb:.1f} GB",
    )


def baselines(made: Project, options: Options) -> tuple[dict[str, dict[str, list[float]]], dict[str, Any]]:
    """Return the times of conversions without a store, and what they left."""
    runs = {PLAIN: [made.convert_plainly() for _ in range(options.trials)]}
    if options.converter is not None:
        done = [made.convert_with(options.converter) for _ in range(options.trials)]
        runs[CONVERTER + (" (FAILED on some)" if any(one.failed for one in done) else "")] = done
    times = {name: {"cold": [one.seconds for one in done]} for name, done in runs.items()}
    outputs = {
        name: {"files": done[-1].files, "failed": sorted({key for one in done for key in one.failed})}
        for name, done in runs.items()
    }
    return times, outputs


def method_times(made: Project, *, stored: bool, content: bool) -> dict[str, list[float]]:
    """Return scenario -> times of builds, with digests stored beforehand or hashed by the build."""
    digests = made.store_digests if stored else made.hash_at_client

    def cold() -> None:
        made.start_over()
        digests()

    def metadata() -> None:
        made.change_metadata()
        if stored:
            made.store_digests()

    def changed() -> None:
        made.change_content()
        if stored:
            made.store_digests()

    times = {"cold": repeated(made.times, cold, lambda: made.build("built in"))}
    made.build("nothing to do")
    times["warm"] = repeated(made.times, lambda: None, lambda: made.build("nothing to do"))
    times["incremental, metadata"] = repeated(made.times, metadata, lambda: made.build(" in "))
    if content:
        times["incremental, content"] = repeated(made.times, changed, lambda: made.build(" in "))
    return times


def told(outputs: dict[str, Any]) -> str:
    """Return a line for each conversion: how many files it left, and what failed."""
    lines = [
        f"- {name}: {found['files']} files"
        + (f"; FAILED on {', '.join(found['failed'])}" if found["failed"] else "")
        for name, found in outputs.items()
    ]
    return "\n" + "\n".join(lines) + "\n"
