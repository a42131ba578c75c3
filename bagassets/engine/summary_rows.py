"""The table at the end of a build: what each recording contains, and its result."""

from bagassets.base.errors import StoreError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.build_report import BagOutcome, BuildReport, SummaryRow
from bagassets.engine.plan import BagPlan
from bagassets.store.store import Store

__all__ = ["losses", "summary_rows"]


def summary_rows(report: BuildReport, store: Store, *, most: int | None = None) -> list[SummaryRow]:
    """Return a row per recording, from the summaries of its current artifacts.

    Args:
        report: the report of the build.
        store: the artifact store.
        most: with more recordings than this, return only those that were built, failed or stopped.
    """
    outcomes, plan = report.outcomes, report.plan
    if plan is None:
        return []
    if most is not None and len(outcomes) > most:
        outcomes = report.having("built", "failed", "stopped")
    return [
        _row(store, plan.bags[key], outcome) if key in plan.bags else _row_of_removed(key, outcome)
        for key, outcome in outcomes.items()
    ]


def _row(store: Store, bag: BagPlan, outcome: BagOutcome) -> SummaryRow:
    inventory, poses = _summary(store, bag, "inventory"), _summary(store, bag, "ego_poses")
    boxes, tables = _summary(store, bag, "annotations"), _summary(store, bag, "nuscenes_tables")
    frames, sweeps = _summary(store, bag, "frames"), _summary(store, bag, "sweeps")
    counts = tables.get("counts", {})
    return SummaryRow(
        recording=bag.key,
        format=bag.format,
        span_s=inventory.get("duration_s"),
        images=_written(frames),
        sweeps=_written(sweeps),
        poses=poses.get("count"),
        boxes=boxes.get("boxes"),
        scenes=counts.get("scenes"),
        keyframes=counts.get("samples"),
        result=outcome.result,
        reason=outcome.reason,
        lost=losses(frames, sweeps, poses, boxes),
    )


def losses(
    frames: JsonMapping, sweeps: JsonMapping, poses: JsonMapping, boxes: JsonMapping
) -> dict[str, dict[str, int]]:
    """Return channel or topic -> reason -> number, of what was lost."""
    counted = {**frames.get("channels", {}), **sweeps.get("channels", {})}
    counted["ego_poses"] = poses.get("counts", {})
    for topic, counts in boxes.get("counts", {}).items():
        parts = [counts.get(what, {}).get("lost", {}) for what in ("messages", "boxes")]
        counted[topic] = {"lost": {reason: number for part in parts for reason, number in part.items()}}
    return {name: dict(counts["lost"]) for name, counts in counted.items() if counts.get("lost")}


def _row_of_removed(key: str, outcome: BagOutcome) -> SummaryRow:
    """Return the row of a recording that was removed during the build."""
    empty: JsonObject = dict.fromkeys(("format", "span_s", *SummaryRow.NUMBERS))
    reason = outcome.reason or "it was removed meanwhile, so the dataset is without it"
    return SummaryRow(recording=key, **empty, result=outcome.result, reason=reason)


def _summary(store: Store, bag: BagPlan, asset: str) -> JsonObject:
    state = bag.assets.get(asset)
    digest = None if state is None else state.data_version
    if digest is None:
        return {}
    try:
        return store.artifact(digest).summary()
    except StoreError:
        return {}


def _written(summary: JsonMapping) -> int | None:
    channels = summary.get("channels")
    return None if channels is None else sum(counts["written"] for counts in channels.values())
