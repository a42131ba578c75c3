"""From results to what people see in Dagster: metadata, and failures without tracebacks."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import dagster as dg

from bagassets.build.execute import AssetResult, BuildFailure
from bagassets.defs.markdown import (
    calibration_table,
    counts_table,
    human_size,
    record_table,
    table,
    topics_table,
)
from bagassets.errors import BagAssetsError, UnexpectedError
from bagassets.escaping import visible
from bagassets.formats.assembly import DatasetSummary
from bagassets.formats.catalogue import MAIN
from bagassets.formats.dataset_build import DatasetInputs
from bagassets.splits import SplitShare

__all__ = [
    "dataset_metadata",
    "failures_in_words",
    "inputs_metadata",
    "moved_table",
    "result_metadata",
    "split_table",
]

CHANNEL_ASSETS = ("frames", "sweeps")
_COUNTS = {"read", "written", "merged", "lost"}


def result_metadata(result: AssetResult) -> dict[str, Any]:
    """Return a result as Dagster metadata: what people look for first, digests and paths last."""
    summary = dict(result.artifact.summary())
    metadata: dict[str, Any] = {}
    if result.asset == "inventory":
        metadata["contents"] = dg.MetadataValue.md(topics_table(result.artifact))
    elif result.asset == "calibration":
        metadata["mounting"] = dg.MetadataValue.md(calibration_table(result.artifact))
    elif result.asset in CHANNEL_ASSETS:
        metadata["channels"] = dg.MetadataValue.md(counts_table(summary.pop("channels")))
    metadata |= {name: shown for name, value in summary.items() if (shown := _shown(value)) is not None}
    # The artifact of frames or sweeps just names those of the channels.
    size = metadata.pop("bytes", None) or sum(entry.size for entry in result.artifact.entries())
    return metadata | {
        "size": human_size(size),
        "size_bytes": size,
        "seconds": round(result.seconds, 3),
        "cached": result.cached,
        "artifact": dg.MetadataValue.path(str(result.artifact.folder)),
        "action_digest": result.action_digest,
    }


def _shown(value: Any) -> Any:
    """Return a fact as people like to read it, or None if there is nothing to tell."""
    if isinstance(value, str):
        return visible(value)
    if isinstance(value, bool | int | float):
        return value
    if not value:
        return None
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return ", ".join(map(visible, value))
    if isinstance(value, dict):
        if set(value) == _COUNTS and isinstance(value["read"], int):
            return dg.MetadataValue.md(counts_table({"all": value}, "messages"))
        if all(isinstance(item, int | float | str) for item in value.values()):
            return dg.MetadataValue.md(record_table(value, ("", "")))
    return dg.MetadataValue.json(value)


def inputs_metadata(inputs: DatasetInputs) -> dict[str, Any]:
    """Return how many recordings enter the dataset, and why others do not."""
    metadata: dict[str, Any] = dict(inputs.as_json())
    failed = inputs.failed.get(MAIN.name, {})
    for name, reasons in (("why_failed", failed), ("why_skipped", inputs.skipped)):
        if reasons:
            metadata[name] = dg.MetadataValue.md(record_table(reasons, ("recording", "reason")))
    return metadata


def dataset_metadata(made: DatasetSummary, failed: Mapping[str, str]) -> dict[str, Any]:
    """Return what a dataset came to as Dagster metadata.

    Args:
        made: the dataset.
        failed: recordings that could not enter it -> why.
    """
    metadata: dict[str, Any] = {
        "folder": dg.MetadataValue.path(str(made.folder)),
        "recordings": sum(share.recordings for share in made.shares),
        **{
            name: _shown(value) if value or not isinstance(value, Mapping) else dg.MetadataValue.json({})
            for name, value in made.facts.items()
        },
        "split_shares": dg.MetadataValue.md(split_table(made.shares)),
        "changed": made.changed,
    }
    if made.files:
        metadata["files"] = dg.MetadataValue.md(record_table(made.files, ("way", "files")))
    if made.moved:
        metadata["moved"] = dg.MetadataValue.md(moved_table(made.moved))
    if made.duplicates:
        metadata["duplicates"] = dg.MetadataValue.md(
            record_table(made.duplicates, ("left out", "same content as"))
        )
    if failed:
        metadata["failed"] = dg.MetadataValue.md(record_table(failed, ("recording", "reason")))
    return metadata


def split_table(shares: Sequence[SplitShare]) -> str:
    """Return a Markdown table of what each split got, by time, against what was asked for."""
    rows = [
        (
            share.name,
            share.recordings,
            f"{share.duration_s:.1f} s",
            f"{share.share:.1%}",
            f"{share.asked:.1%}",
            f"{share.deviation:+.1%}",
        )
        for share in shares
    ]
    return table(("split", "recordings", "duration", "share", "asked for", "deviation"), rows)


def moved_table(moved: Mapping[str, tuple[str, str]]) -> str:
    """Return a Markdown table of the recordings that changed their split."""
    return table(("recording", "was in", "is in"), [(key, *splits) for key, splits in moved.items()])


@contextmanager
def failures_in_words() -> Iterator[None]:
    """Turn our errors into Dagster failures that show the sentence and are not retried."""
    try:
        yield
    except BagAssetsError as err:
        raise dg.Failure(description=str(err), allow_retries=False) from _surprise(err)


def _surprise(err: BagAssetsError) -> BaseException | None:
    """Return what nobody thought of, whose traceback is worth showing; None for errors that say it all."""
    inner = err.errors.values() if isinstance(err, BuildFailure) else [err]
    return next((e.__cause__ for e in inner if isinstance(e, UnexpectedError)), None)
