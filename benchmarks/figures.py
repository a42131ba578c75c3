"""Figures of the benchmarks: medians with bars from the shortest to the longest time; logarithmic if they differ much."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import median

__all__ = ["bars", "lines"]

_MUCH = 20.0


def bars(file: Path, times: Mapping[str, Mapping[str, Sequence[float]]], title: str) -> None:
    """Draw groups of bars: method -> scenario -> times."""
    import matplotlib.pyplot as plt

    scenarios = list(next(iter(times.values())))
    figure, axes = plt.subplots(figsize=(1.6 + 1.9 * len(scenarios), 4.5), layout="constrained")
    width = 0.8 / len(times)
    for number, (name, by_scenario) in enumerate(times.items()):
        places = [index + (number - (len(times) - 1) / 2) * width for index in range(len(scenarios))]
        taken = [by_scenario[scenario] for scenario in scenarios]
        middle = [median(one) for one in taken]
        axes.bar(places, middle, width, yerr=_whiskers(taken, middle), capsize=3, label=name)
    axes.set_xticks(range(len(scenarios)), scenarios)
    _finish(figure, axes, file, times, title)


def lines(file: Path, times: Mapping[str, Mapping[float, Sequence[float]]], title: str, across: str) -> None:
    """Draw a line per run: run -> size -> times."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 6), layout="constrained")
    for name, by_size in times.items():
        taken = list(by_size.values())
        middle = [median(one) for one in taken]
        axes.errorbar(list(by_size), middle, yerr=_whiskers(taken, middle), marker="o", capsize=3, label=name)
    axes.set_xlabel(across)
    _finish(figure, axes, file, times, title)


def _whiskers(taken: Sequence[Sequence[float]], middle: Sequence[float]) -> list[list[float]]:
    pairs = list(zip(taken, middle, strict=True))
    return [[m - min(one) for one, m in pairs], [max(one) - m for one, m in pairs]]


def _finish(
    figure: Any,  # matplotlib's
    axes: Any,
    file: Path,
    times: Mapping[str, Mapping[Any, Sequence[float]]],
    title: str,
) -> None:
    middle = [median(taken) for by_scenario in times.values() for taken in by_scenario.values()]
    if max(middle) > _MUCH * min(middle):
        axes.set_yscale("log")
    axes.set_ylabel("s (median, min to max)")
    axes.set_title(title)
    axes.grid(axis="y", alpha=0.4)
    figure.legend(*axes.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=2)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
