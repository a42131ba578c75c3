"""The output of `bagassets build --dry-run` and `--check`: what would run, what may run, and why."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from bagassets.build.build_report import Remark
from bagassets.build.plan import State
from bagassets.escaping import visible
from bagassets.quantities import count_text

if TYPE_CHECKING:
    from bagassets.defs.pending_work import PendingWork

__all__ = ["dry_run_json", "dry_run_lines", "verdict"]

_VERBS: dict[State, str] = {
    "missing": "run",
    "stale": "run",
    "unknown": "may run",
    "record-only": "record",
    "failed": "failed",
}


def dry_run_lines(pending: "PendingWork") -> Iterator[str]:
    """Yield what a build would do to recordings and datasets, as lines of text."""
    for key, assets in pending.todo.items():
        yield key
        for name in assets:
            state = pending.plan.bags[key].assets[name]
            if state.state in _VERBS:
                yield f"  {_VERBS[state.state]:<8} {name:<17} {visible(state.reason)}"
    for key, reason in pending.failed.items():
        if key not in pending.todo:
            yield f"{key}\n  failed before and is not retried without --retry-failed: {reason}"
    for key in pending.plan.removed:
        yield f"{key}\n  is gone: its partition and scenes would be removed"
    if pending.datasets:
        yield f"dataset\n  {_dataset(pending)}"


def verdict(pending: "PendingWork") -> str:
    """Return whether there is something to do, and what, as one line."""
    if pending.is_settled:
        fresh = len(pending.chosen) - len(pending.failed)
        failed = f", {len(pending.failed)} failed before" if pending.failed else ""
        return f"nothing to do: {count_text(fresh, 'recording')} up to date{failed}."
    parts = [f"build {count_text(len(pending.todo), 'recording')}"] if pending.todo else []
    parts += [f"remove {count_text(len(pending.plan.removed), 'recording')}"] if pending.plan.removed else []
    parts += ["update the dataset"] if pending.datasets and (parts or not pending.dataset_is_current) else []
    return f"to do: {', '.join(parts)}."


def dry_run_json(
    pending: "PendingWork", moved: Mapping[str, tuple[str, str]], remarks: Sequence[Remark]
) -> str:
    """Return what a build would do, as JSON.

    Args:
        pending: the work to be done.
        moved: recording that would move to another split -> the old split and the new one.
        remarks: losses and dropped keyframes of recordings that are built.
    """
    value = {
        "settled": pending.is_settled,
        "recordings": {
            key: {
                "run": list(assets),
                "assets": {name: pending.plan.bags[key].assets[name].as_json() for name in assets},
            }
            for key, assets in pending.todo.items()
        },
        "failed": pending.failed,
        "removed": list(pending.plan.removed),
        "moved": {key: list(splits) for key, splits in moved.items()},
        "remarks": [remark.as_json() for remark in remarks],
        "datasets": {name: _dataset_state(pending) for name in pending.datasets},
    }
    return json.dumps(value, indent=1)


def _dataset(pending: "PendingWork") -> str:
    state = _dataset_state(pending)
    if state == "fresh":
        return "up to date"
    if state == "unknown":
        return "may be updated, once the recordings above are done"
    return "would be updated: its recordings, the recipe or the version changed"


def _dataset_state(pending: "PendingWork") -> str:
    if pending.todo:
        return "unknown"
    return "fresh" if pending.dataset_is_current and not pending.plan.removed else "stale"
