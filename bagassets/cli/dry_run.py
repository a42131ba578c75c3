"""What `bagassets build --dry-run` and `--check` say: what would run, what may run, and why."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from bagassets.build.build_report import Remark
from bagassets.build.plan_model import State
from bagassets.escaping import visible

if TYPE_CHECKING:
    from bagassets.defs.situation import Situation

__all__ = ["dry_run_json", "dry_run_lines", "verdict"]

_WORDS: dict[State, str] = {
    "missing": "run",
    "stale": "run",
    "unknown": "may run",
    "record-only": "record",
    "failed": "failed",
}


def dry_run_lines(situation: "Situation") -> Iterator[str]:
    """Yield what a build would do to recordings and datasets, for people."""
    for key, assets in situation.todo.items():
        yield key
        for name in assets:
            state = situation.plan.bags[key].assets[name]
            if state.state in _WORDS:
                yield f"  {_WORDS[state.state]:<8} {name:<17} {visible(state.reason)}"
    for key, reason in situation.failed.items():
        if key not in situation.todo:
            yield f"{key}\n  failed before and is not tried again without --retry-failed: {reason}"
    for key in situation.plan.removed:
        yield f"{key}\n  is gone: its partition and scenes would be removed"
    if situation.datasets:
        yield f"dataset\n  {_dataset(situation)}"


def verdict(situation: "Situation") -> str:
    """Return one line on whether there is something to do."""
    if situation.is_settled:
        fresh = len(situation.chosen) - len(situation.failed)
        failed = f", {len(situation.failed)} failed before" if situation.failed else ""
        return f"nothing to do: {_recordings(fresh)} up to date{failed}."
    parts = [f"build {_recordings(len(situation.todo))}"] if situation.todo else []
    parts += [f"remove {_recordings(len(situation.plan.removed))}"] if situation.plan.removed else []
    parts += (
        ["update the dataset"] if situation.datasets and (parts or not situation.dataset_is_current) else []
    )
    return f"to do: {', '.join(parts)}."


def dry_run_json(
    situation: "Situation", moved: Mapping[str, tuple[str, str]], remarks: Sequence[Remark]
) -> str:
    """Return what a build would do, as JSON.

    Args:
        situation: how things are.
        moved: recording that would change its split -> the old one and the new one.
        remarks: losses and dropped keyframes of recordings that are built.
    """
    value = {
        "settled": situation.is_settled,
        "recordings": {
            key: {
                "run": list(assets),
                "assets": {name: situation.plan.bags[key].assets[name].as_json() for name in assets},
            }
            for key, assets in situation.todo.items()
        },
        "failed": situation.failed,
        "removed": list(situation.plan.removed),
        "moved": {key: list(splits) for key, splits in moved.items()},
        "remarks": [remark.as_json() for remark in remarks],
        "datasets": {name: _dataset_state(situation) for name in situation.datasets},
    }
    return json.dumps(value, indent=1)


def _dataset(situation: "Situation") -> str:
    state = _dataset_state(situation)
    if state == "fresh":
        return "up to date"
    if state == "unknown":
        return "may be updated, once the recordings above are done"
    return "would be updated: it was made from other recordings, or by another recipe or version"


def _dataset_state(situation: "Situation") -> str:
    if situation.todo:
        return "unknown"
    return "fresh" if situation.dataset_is_current and not situation.plan.removed else "stale"


def _recordings(number: int) -> str:
    return f"{number} recording{'' if number == 1 else 's'}"
