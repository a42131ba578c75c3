"""The rule about signals: their elements have values, without gaps, in their ranges."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from bagassets.assets.quality.finding import Finding, clock
from bagassets.base.json_types import JsonObject
from bagassets.recipe.model_checks import SignalLimits, SignalsCheck
from bagassets.recipe.model_signals import STAMP
from bagassets.store.artifact import Artifact


def signal_values(signals: Mapping[str, Artifact], check: SignalsCheck) -> Finding:
    """Check gaps, empty values and ranges of signals.

    Args:
        signals: signal -> its artifact.
        check: thresholds.
    """
    problems: list[str] = []
    rates: dict[str, float] = {}
    for name, artifact in sorted(signals.items()):
        limits = check.limits.get(name, SignalLimits())
        table, facts = artifact.read_table("signal.parquet"), artifact.read_json("signal.json")
        stamps_ns = table.column(STAMP).to_numpy()
        if len(stamps_ns) > 1:
            rates[name] = round((len(stamps_ns) - 1) * 1e9 / float(stamps_ns[-1] - stamps_ns[0]), 3)
        max_gap_s = check.max_gap_s if limits.max_gap_s is None else limits.max_gap_s
        problems += _gap_problems(name, table, max_gap_s)
        for element in facts["elements"]:
            problems += _element_problems(name, element, len(table), check.max_empty, limits)
        if facts["most_backward_s"] > check.max_backward_s:
            problems.append(
                f"{name}: stamps go back in time by up to {facts['most_backward_s']:g} s, at most {check.max_backward_s:g} s "
                "expected; its values are sorted by stamp"
            )
    return Finding(problems, {"rates_hz": rates})


def _gap_problems(name: str, table: pa.Table, max_gap_s: float) -> list[str]:
    """Return the longest gap of a signal; of elements with the same gap the first."""
    longest: tuple[int, int, str] = (0, 0, "")
    for element in table.column_names:
        if element != STAMP:
            stamps_ns = table.filter(table.column(element).is_valid()).column(STAMP).to_numpy()
            steps_ns = np.diff(stamps_ns)
            if len(steps_ns) and (most := int(steps_ns.argmax())) >= 0 and steps_ns[most] > longest[0]:
                longest = int(steps_ns[most]), int(stamps_ns[most]), element
    gap_ns, start_ns, element = longest
    if gap_ns <= max_gap_s * 1e9:
        return []
    return [
        f"{name}: {element} has no value for {gap_ns / 1e9:g} s after {clock(start_ns)}, at most {max_gap_s:g} s expected"
    ]


def _element_problems(
    name: str, element: JsonObject, rows: int, max_empty: float, limits: SignalLimits
) -> list[str]:
    problems = []
    empty = element["missing"] + element["not_finite"]
    if empty > max_empty * rows:
        problems.append(
            f"{name}: {element['name']} has no value in {empty} of {rows} messages ({element['missing']} lack it, "
            f"{element['not_finite']} hold a value that is not finite)"
        )
    low, high = element["min"], element["max"]
    if limits.min is not None and low is not None and low < limits.min:
        problems.append(f"{name}: {element['name']} goes down to {low:g}, at least {limits.min:g} expected")
    if limits.max is not None and high is not None and high > limits.max:
        problems.append(f"{name}: {element['name']} goes up to {high:g}, at most {limits.max:g} expected")
    return problems
