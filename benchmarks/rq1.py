"""RQ1: cold, warm and incremental run times beside a plain sequential conversion.

Cold is an empty store, an empty Dagster instance and no server; warm is nothing changed; incremental is a
change in one recording, of metadata (a message that nothing reads) or of content (every image and packet).
A conversion without a store does everything again, whatever changed; it is measured after each change all the same.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarks.common import (
    Converted,
    Options,
    Project,
    markdown,
    median,
    project,
    repeated,
    save,
    speedup,
)
from benchmarks.figures import bars

__all__ = ["CONVERTER", "METHODS", "PLAIN", "baselines", "method_times", "output_lines", "rq1", "rq1_table"]

METHODS = {"bagassets, client-side hashing": False, "bagassets, stored digests": True}
PLAIN, CONVERTER = "plain sequential", "external converter"
COLD, WARM = "cold", "warm"
METADATA, CONTENT = "incremental, metadata", "incremental, content"


def rq1(options: Options) -> None:
    """Measure, and write `rq1.json`, `rq1.md` and `rq1.png`."""
    size = options.size_gb * 1e9 / options.recordings
    made = project(options.folder / "rq1", [size] * options.recordings, options.trials)
    times, outputs = baselines(made, options, {
        COLD: _nothing,
        WARM: _nothing,
        METADATA: made.change_metadata,
        CONTENT: made.change_content,
    })  # fmt: skip
    for name, stored in METHODS.items():
        times[name] = method_times(made, stored=stored, content=True)
    made.stop_server()
    figures = {
        "size_gb": made.size_gb,
        "recordings": options.recordings,
        "times_s": times,
        "outputs": outputs,
    }
    save(options, "rq1", figures, rq1_table({"trials": options.trials, **figures}))
    bars(options.results / "rq1.png", times, f"RQ1: {options.recordings} recordings, {made.size_gb:.1f} GB")


def rq1_table(found: dict[str, Any]) -> str:
    """Return the table of `rq1.json`."""
    times = found["times_s"]
    rows = []
    for name, by_scenario in times.items():
        for scenario, taken in by_scenario.items():
            ratio, reduction = speedup(times[PLAIN][scenario], taken)
            rows.append([f"{name}: {scenario}", median(taken), min(taken), max(taken), ratio, reduction])
    header = ["run", "median s", "min s", "max s", "speed-up", "reduction %"]
    about = f"{found['recordings']} recordings, {found['size_gb']:.2f} GB, {found['trials']} trials.\n\n"
    return about + markdown(header, rows) + output_lines(found["outputs"])


def baselines(
    made: Project, options: Options, changes: dict[str, Callable[[], None]]
) -> tuple[dict[str, dict[str, list[float]]], dict[str, Any]]:
    """Return method -> scenario -> times of conversions without a store, and what each method left.

    Args:
        made: the recordings.
        options: how often, and another converter.
        changes: scenario -> what happens before each conversion.
    """
    methods: dict[str, Callable[[], Converted]] = {PLAIN: made.convert_plainly}
    if options.converter is not None:
        methods[CONVERTER] = partial(made.convert_with, options.converter)
    times: dict[str, dict[str, list[float]]] = {}
    outputs: dict[str, Any] = {}
    for name, convert in methods.items():
        done: list[Converted] = []
        by_scenario = {}
        for scenario, change in changes.items():
            taken = []
            for _ in range(options.trials):
                change()
                taken.append(convert())
            by_scenario[scenario] = [one.seconds for one in taken]
            done += taken
        failed = sorted({key for one in done for key in one.failed})
        title = name + (" (FAILED on some)" if failed else "")
        times[title] = by_scenario
        outputs[title] = {"files": done[-1].files, "failed": failed}
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

    times = {COLD: repeated(made.times, cold, lambda: made.build("built in"))}
    made.build("nothing to do")
    times[WARM] = repeated(made.times, _nothing, lambda: made.build("nothing to do"))
    times[METADATA] = repeated(made.times, metadata, lambda: made.build(" in "))
    if content:
        times[CONTENT] = repeated(made.times, changed, lambda: made.build(" in "))
    return times


def output_lines(outputs: dict[str, Any]) -> str:
    """Return a line for each conversion: how many files it left, and what failed."""
    lines = [
        f"- {name}: {found['files']} files"
        + (f"; FAILED on {', '.join(found['failed'])}" if found["failed"] else "")
        for name, found in outputs.items()
    ]
    return "\n" + "\n".join(lines) + "\n"


def _nothing() -> None:
    pass
