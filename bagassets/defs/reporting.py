"""From results to what people see in Dagster: metadata, and failures without tracebacks."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import dagster as dg

from bagassets.engine.recording_build import AssetResult
from bagassets.errors import BagAssetsError
from bagassets.splits import SplitShare
from bagassets.steps.nuscenes_dataset import DatasetSummary

CHANNEL_ASSETS = ("frames", "sweeps")

__all__ = ["dataset_metadata", "failures_in_words", "result_metadata"]


def result_metadata(result: AssetResult) -> dict[str, Any]:
    """Return counts, sizes, digests and durations of a result as Dagster metadata."""
    files = result.artifact.entries()
    metadata: dict[str, Any] = {
        "cached": result.cached,
        "action_digest": result.action_digest,
        "artifact": dg.MetadataValue.path(str(result.artifact.folder)),
        "files": len(files),
        "size_bytes": sum(entry.size for entry in files),
        "seconds": round(result.seconds, 3),
    }
    for name, value in result.artifact.summary().items():
        if name == "channels" and result.asset in CHANNEL_ASSETS:
            metadata["channels"] = dg.MetadataValue.md(channel_table(value))
        elif isinstance(value, bool | int | float | str):
            metadata[name] = value
        elif value is not None:
            metadata[name] = dg.MetadataValue.json(value)
    return metadata


def dataset_metadata(made: DatasetSummary) -> dict[str, Any]:
    """Return rows, splits and files of a dataset as Dagster metadata."""
    return {
        "dataroot": dg.MetadataValue.path(str(made.folder.parent)),
        "version": made.folder.name,
        "scenes": made.rows.get("scene", 0),
        "keyframes": made.rows.get("sample", 0),
        "rows": dg.MetadataValue.json(dict(made.rows)),
        "splits": dg.MetadataValue.json(dict(made.splits)),
        "split_shares": dg.MetadataValue.md(split_table(made.shares)),
        "files": dg.MetadataValue.json(dict(made.files)),
        "duplicates": dg.MetadataValue.json(dict(made.duplicates)),
        "changed": made.changed,
    }


def channel_table(channels: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a Markdown table of where the messages of each channel went."""
    lines = ["| channel | read | written | merged | lost |", "|---|--:|--:|--:|---|"]
    for name, counts in sorted(channels.items()):
        lost = (
            ", ".join(f"{number} {reason}" for reason, number in sorted(counts.get("lost", {}).items()))
            or "0"
        )
        lines.append(
            f"| {name} | {counts['read']} | {counts['written']} | {counts.get('merged', 0)} | {lost} |"
        )
    return "\n".join(lines)


def split_table(shares: Sequence[SplitShare]) -> str:
    """Return a Markdown table of what each split got, by time, against what was asked for."""
    lines = ["| split | recordings | seconds | share | asked | deviation |", "|---|--:|--:|--:|--:|--:|"]
    lines += [
        f"| {share.name} | {share.recordings} | {share.duration_s:.1f} | {share.share:.1%} | {share.asked:.1%} "
        f"| {share.deviation:+.1%} |"
        for share in shares
    ]
    return "\n".join(lines)


@contextmanager
def failures_in_words() -> Iterator[None]:
    """Turn our errors into Dagster failures that show the sentence and are not retried."""
    try:
        yield
    except BagAssetsError as err:
        raise dg.Failure(description=str(err), allow_retries=False) from None
