"""RQ2: how run times grow with the size of the data: T(D) = a D + b over one, two and four times as much.

Half of the recordings are ROS 1 and half ROS 2, all with different seeds: copies would be cache hits.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.common import Options, markdown, median, project, save
from benchmarks.figures import lines
from benchmarks.rq1 import METHODS, baselines, method_times, output_lines

__all__ = ["fit", "rq2", "rq2_table"]

FACTORS = (1, 2, 4)


def rq2(options: Options) -> None:
    """Measure, and write `rq2.json`, `rq2.md` and `rq2.png`; the largest size is that of RQ1."""
    times: dict[str, dict[float, list[float]]] = {}
    outputs: dict[str, Any] = {}
    for factor in FACTORS:
        number = factor if options.tiny else 2 * factor
        size = options.size_gb * 1e9 / (2 * FACTORS[-1])
        made = project(options.folder / f"rq2-x{factor}", [size] * number, options.trials, first_seed=100)
        size_gb = made.size_gb
        found, outputs = baselines(made, options, {"cold": lambda: None})
        for name, stored in METHODS.items():
            found[name] = method_times(made, stored=stored, content=False)
        made.stop_server()
        for name, by_scenario in found.items():
            for scenario, taken in by_scenario.items():
                times.setdefault(f"{name}: {scenario}", {})[size_gb] = taken
    figures = {
        "times_s": {name: {f"{k:.4f}": v for k, v in by.items()} for name, by in times.items()},
        "outputs": outputs,
    }
    save(options, "rq2", figures, rq2_table(figures))
    lines(options.results / "rq2.png", times, "RQ2: run time over size", "GB of recordings")


def rq2_table(found: dict[str, Any]) -> str:
    """Return the table of `rq2.json`."""
    rows = []
    for name, by_size in found["times_s"].items():
        slope, offset, spread = fit({float(size): taken for size, taken in by_size.items()})
        rows.append([name, *[median(taken) for taken in by_size.values()], slope, spread, offset])
    sizes = [f"{float(size):.2f} GB, s" for size in next(iter(found["times_s"].values()))]
    return markdown(["run", *sizes, "a, s/GB", "± (95 %)", "b, s"], rows) + output_lines(
        found.get("outputs", {})
    )


def fit(by_size: dict[float, list[float]]) -> tuple[float, float, float]:
    """Return slope (s/GB), offset (s) and half the 95 % interval of the slope, by least squares over all trials."""
    sizes = np.array([size for size, taken in by_size.items() for _ in taken])
    seconds = np.array([one for taken in by_size.values() for one in taken])
    if len(set(sizes.tolist())) < 2:
        return 0.0, float(seconds.mean()), float("nan")
    centred = sizes - sizes.mean()
    squares = float((centred * centred).sum())
    slope = float((centred * seconds).sum()) / squares
    offset = float(seconds.mean() - slope * sizes.mean())
    left = seconds - slope * sizes - offset
    freedom = len(sizes) - 2
    if freedom <= 0:
        return slope, offset, float("nan")
    error = float(np.sqrt((left * left).sum() / freedom / squares))
    return slope, offset, _student(freedom) * error


def _student(freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t."""
    table: Sequence[float] = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.20, 2.18)
    return table[freedom - 1] if freedom <= len(table) else 1.96 + 2.4 / freedom
