"""What a build makes again because this version of bagassets makes it differently, and about how long that takes."""

from collections.abc import Iterable

from bagassets.base.alike import told_once
from bagassets.base.quantities import readable_time
from bagassets.engine.batches import Batch, batches
from bagassets.engine.plan import Plan, Recorded
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.store.store import Store

# What the others took is estimated from these, by their size.
_MOST_COMPARED = 20
_RUN_S = 1.0  # what a run takes beside its work


def made_again(assets: RecordingAssets, plan: Plan, todo: Batch, jobs: int) -> str:
    """Return a line about the assets whose version was raised since they were recorded, then one about each; "" without any.

    Args:
        assets: the assets of a recording, with their versions; the store has the time that actions took.
        plan: states of all recordings.
        todo: recording that needs a run -> the assets that the run is about.
        jobs: recordings built at the same time.
    """
    recorded = plan.recorded
    found: dict[str, list[str]] = {}
    since: dict[str, int] = {}
    told: list[tuple[tuple[str, ...], str, str]] = []
    for key, names in todo.items():
        states, before = plan.bags[key].assets, recorded.get(key, {})
        changed = [name for name in names if states[name].state in {"stale", "unknown"} and name in before]
        versions = {name: _version(before[name]) for name in changed if name != "bag"}
        raised = {name: was for name, was in versions.items() if was not in {None, assets[name].version}}
        if raised:
            since |= {name: min(was, since.get(name, was)) for name, was in raised.items()}
            found[key] = [
                name for name in changed if not raised.keys().isdisjoint(assets.with_upstream([name]))
            ]
            told.append(((), key, ", ".join(name for name in names if name in raised)))
    if not found:
        return ""
    what = "; ".join(f"{one.text} of {one.title}" for one in told_once(told, fewest=2))
    compared = list(found)[:: max(1, len(found) // _MOST_COMPARED)]
    took_s = sum(_took_s(assets.store, [recorded[key][name] for name in found[key]]) for key in compared)
    sizes = {key: plan.discovery.recordings[key].size for key in todo}
    share = sum(1 + sizes[key] for key in compared) / sum(1 + sizes[key] for key in found)
    all_s = (took_s / share + len(batches(todo, sizes, jobs)) * _RUN_S) / jobs
    time = f"; about {readable_time(all_s)}, going by what they took before" if took_s else ""
    line = f"made again: {what}, as far as this version of bagassets makes them differently (see its changelog){time}"
    differences = [
        f"  {asset.name} {text}"
        for asset in assets
        for version, text in asset.changes.items()
        if since.get(asset.name, asset.version) < version
    ]
    return "\n".join([line, *differences])


def _version(record: Recorded) -> int | None:
    """Return the version of the step that an asset was recorded with, which its code version begins with."""
    version = ("" if record.is_skip else record.code_version or "").partition("-")[0]
    return int(version) if version.isdecimal() else None


def _took_s(store: Store, records: Iterable[Recorded]) -> float:
    """Return the seconds that assets of a recording took when they were made; all channels shared one pass."""
    pass_s = others_s = 0.0
    for record in records:
        action = None if record.action is None else store.action(record.action)
        channels = (action or {"params": {}})["params"].get("actions", {}).values()
        pass_s = max([pass_s, *map(store.seconds, channels)])
        others_s += store.seconds(record.action) if record.action is not None and not channels else 0.0
    return pass_s + others_s
