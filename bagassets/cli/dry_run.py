"""The output of `bagassets build --dry-run` and `--check`: what would run, what may run, and why."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from bagassets.base.alike import names_text, told_once
from bagassets.base.escaping import visible
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.cli.status import names_by_reason
from bagassets.engine.build_report import Remark

if TYPE_CHECKING:
    from bagassets.defs.builds.own_states import OwnProject
    from bagassets.defs.builds.pending_work import PendingWork

_VERBS: dict[str, str] = {
    "missing": "run",
    "stale": "run",
    "unknown": "may run",
    "record-only": "record",
    "skipped": "skip",
    "blocked": "waits",
    "failed": "failed",
}
_TO_DO = {"missing", "stale", "unknown"}


def dry_run_lines(pending: "PendingWork", own: "OwnProject") -> Iterator[str]:
    """Yield what a build would do to recordings, datasets and the user's own assets, as lines of text."""
    found = []
    for key, assets in pending.todo.items():
        planned = {name: pending.plan.bags[key].assets[name] for name in assets}
        lines = [
            f"  {_VERBS[state]:<8} {', '.join(names)}  {visible(reason)}"
            for (state, reason), names in names_by_reason(planned).items()
        ]
        found.append(((), key, "\n".join(lines)))
    for key, reason in pending.failed.items():
        if key not in pending.todo:
            can_be_retried = pending.plan.bags[key].can_be_retried
            said = "failed before and is not retried without --retry-failed" if can_be_retried else "fails"
            found.append(((), key, f"  {said}: {reason}"))
    yield from (f"{told.title}\n{told.text}" for told in told_once(found))
    for whole, keys in pending.plan.joined.items():
        yield f"{names_text(keys)}\n  would be joined into {whole}, as its parts"
    only = "" if pending.plan.bags else " with --allow-empty only"
    for key in pending.plan.gone:
        then = pending.held.get(key, f"its partition and scenes would be removed{only}")
        yield f"{key}\n  is gone: {then}"
    for question in pending.plan.asked.values():
        yield f"to be decided: {visible(question)}"
    if own.problem:
        yield f"error: {visible(own.problem)}"
    for name, states in own.targets.items():
        told = [(key, one) for key, one in states.items() if one.state != "fresh"]
        yield from [name] if told else [f"{name}\n  up to date"] if "" in states else []
        for key, one in told:
            yield f"  {_VERBS[one.state]:<8} {f'{key}: ' if key else ''}{visible(one.reason)}"
    for name, why in own.left_out.items():
        yield f"{name}\n  not made: {why}"


def verdict(pending: "PendingWork", own: "OwnProject") -> str:
    """Return whether there is something to do, and what, as one line."""
    to_do = [
        name for name, states in own.targets.items() if any(one.state in _TO_DO for one in states.values())
    ]
    behind, to_make = (
        [one for one in to_do if (one in pending.asked.datasets) == is_ours] for is_ours in (True, False)
    )
    if pending.is_settled and not to_make:
        fresh = len(pending.asked.chosen) - len(pending.failed)
        failed = f", {len(pending.failed)} failed" if pending.failed else ""
        return f"nothing to do: {count_text(fresh, 'recording')} up to date{failed}."
    skipped = sum(pending.plan.bags[key].skipped is not None for key in pending.todo)
    built = len(pending.todo) - skipped
    parts = [f"build {count_text(built, 'recording')}"] if built else []
    parts += [f"record {count_text(skipped, 'skipped recording')}"] if skipped else []
    gone, joined = pending.plan.gone, len(pending.plan.removed) - len(pending.plan.gone)
    parts += [f"join {count_text(joined, 'part')}"] if joined else []
    parts += [f"remove {count_text(len(gone), 'recording')}"] if gone else []
    parts += [f"update {', '.join(behind)}"] if behind else []
    parts += [f"make {', '.join(to_make)}"] if to_make else []
    return f"to do: {', '.join(parts)}."


def dry_run_json(
    pending: "PendingWork",
    own: "OwnProject",
    moved: Mapping[str, tuple[str, str]],
    remarks: Sequence[Remark],
) -> JsonObject:
    """Return what a build would do, as JSON.

    Args:
        pending: the work to be done.
        own: that on the user's own assets.
        moved: recording that would move to another split -> the old split and the new one.
        remarks: losses and dropped keyframes of recordings that are built.
    """
    return {
        "settled": pending.is_settled and own.is_settled,
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
        "remarks": [asdict(remark) for remark in remarks],
        **own.as_json(),
    }
