"""The table at the end of a build: what each recording contains, and its result."""

from bagassets.assets.asset import AnyAsset
from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.engine.build_report import BagOutcome, BuildReport, SummaryRow
from bagassets.engine.plan import BagPlan
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.store.store import Store


def summary_rows(
    report: BuildReport, assets: RecordingAssets, *, most: int | None = None
) -> list[SummaryRow]:
    """Return a row per recording, from the summaries of its current artifacts.

    Args:
        report: the report of the build.
        assets: the assets of recordings.
        most: with more recordings than this, return only those that were built, failed or stopped.
    """
    outcomes, plan = report.outcomes, report.plan
    if plan is None:
        return []
    if most is not None and len(outcomes) > most:
        outcomes = report.having("built", "failed", "stopped")
    return [_row(key, plan.bags.get(key), outcome, assets) for key, outcome in outcomes.items()]


def _row(key: str, bag: BagPlan | None, outcome: BagOutcome, assets: RecordingAssets) -> SummaryRow:
    counts: dict[str, int | None] = dict.fromkeys(assets.counted)
    if bag is None:
        reason = outcome.reason or "it was removed meanwhile, so the dataset is without it"
        return SummaryRow(key, None, None, counts, outcome.result, reason)
    lost: dict[str, dict[str, int]] = {}
    for asset in assets.by_channels:
        summary = _summary(assets.store, bag, asset)
        counts |= {name: count(summary) for name, count in asset.face.counts.items()}
        for one in asset.face.losses(summary):
            reasons = lost.setdefault(one.source, {})
            reasons[one.reason] = reasons.get(one.reason, 0) + one.number
    span_s = _summary(assets.store, bag, INVENTORY).get("duration_s")
    return SummaryRow(key, bag.format, span_s, counts, outcome.result, outcome.reason, lost)


def _summary(store: Store, bag: BagPlan, asset: AnyAsset) -> JsonObject:
    """Return the summary of an artifact; empty if there is none."""
    state = bag.assets.get(asset.name)
    if state is None or state.data_version is None:
        return {}
    try:
        return store.artifact(state.data_version).summary()
    except BagAssetsError:
        return {}
