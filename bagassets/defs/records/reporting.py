"""Results and errors as the web UI shows them: metadata with tables and pictures, failures of one sentence."""

import json
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dagster as dg

from bagassets.assets.face import Face, Table, counts_table
from bagassets.base.alike import names_text, told_once, without_path
from bagassets.base.errors import BagAssetsError, UnexpectedError
from bagassets.base.escaping import html, markdown, visible
from bagassets.base.json_types import Json
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.defs.records.artifact_files import picture_link
from bagassets.defs.records.events import REASON, STAT
from bagassets.engine.execute import AssetResult, BuildFailure
from bagassets.engine.splits import SplitShare
from bagassets.formats.assembly import DatasetSummary
from bagassets.formats.dataset_build import DatasetInputs
from bagassets.recordings.digest import RecordingDigest, RecordingStat
from bagassets.recordings.model import RecordingFiles
from bagassets.store.artifact import Artifact

Metadata = dict[str, Any]
"""What Dagster shows of a materialization: its `MetadataValue`, or what it makes one of."""

BAG_CODE_VERSION = "1"
_COUNTS = {"read", "written", "merged", "lost"}
_MOST_ROWS = 60
_SHOWN_AT_ONCE = 1000  # characters of Markdown; Dagster shows more on a click
_PACKAGE = Path(__file__).resolve().parents[2]


def bag_metadata(recording: RecordingFiles, stat: RecordingStat, digest: RecordingDigest) -> Metadata:
    """Return what Dagster keeps of a recording: `stat` is its status before it was hashed."""
    return {
        "path": dg.MetadataValue.path(str(recording.path)),
        "format": recording.format,
        "size": readable_bytes(recording.size),
        "size_bytes": recording.size,
        "files": len(recording.files),
        **({"parts": names_text([part.relative for part in recording.parts])} if recording.parts else {}),
        "digest": digest.digest,
        "hashed_bytes": digest.hashed_bytes,
        STAT: dg.MetadataValue.text(json.dumps(stat.as_json())),
    }


def result_metadata(result: AssetResult, face: Face) -> Metadata:
    """Return a result as Dagster metadata: what people look for first, paths and digests last."""
    artifact = result.artifact
    metadata = {
        name: shown for name, value in face.shown(artifact).items() if (shown := _shown(value)) is not None
    }
    # The artifact of an asset of channels only names those of the channels.
    size = metadata.pop("bytes", None) or sum(entry.size for entry in artifact.entries())
    return (
        _pictures(artifact, face)
        | metadata
        | {
            "size": readable_bytes(size),
            "size_bytes": size,
            "seconds": round(result.seconds, 3),
            "cached": result.cached,
            "artifact": dg.MetadataValue.path(str(artifact.folder)),
            "action_digest": result.action_digest,
        }
    )


def skip_metadata(reason: str) -> Metadata:
    """Return what Dagster shows of an asset that was not made, as its recording takes no part."""
    return {"skipped": True, REASON: visible(reason)}


def _pictures(artifact: Artifact, face: Face) -> Metadata:
    """Return the pictures of an artifact as Markdown: what `bagassets ui` serves, each a link to the large one.

    Dagster shows short Markdown at once, and the event log keeps all of it twice: so the pictures themselves stay in the
    store. Other web servers do not serve them: without a text they show nothing there, but a thumbnail inside Markdown.
    """
    metadata: Metadata = {}
    for picture in face.pictures(artifact):
        shown, large = (picture_link(artifact.digest, file) for file in (picture.small, picture.large))
        metadata[f"picture_{picture.name}"] = dg.MetadataValue.md(
            f'[![]({shown})]({large} "{html(picture.title)}")'
        )
    if face.thumbnail is not None:
        data = b64encode(artifact.path(face.thumbnail).read_bytes()).decode()
        metadata["thumbnail"] = dg.MetadataValue.md(f"![Thumbnail](data:image/jpeg;base64,{data})")
    return metadata


def _shown(value: Json | Table) -> Any:
    """Return a fact in readable form, or None if it is empty."""
    if isinstance(value, Table):
        return _table(value.header, value.rows)
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
            return _shown(counts_table({"all": value}, "messages"))
        if all(isinstance(item, int | float | str) for item in value.values()):
            return _table(("", ""), list(value.items()))
    return dg.MetadataValue.json(value)


def inputs_metadata(inputs: DatasetInputs) -> Metadata:
    """Return the number of recordings that enter the dataset, and why others are left out."""
    reasons = {"why_failed": inputs.failed.get(inputs.first, {}), "why_skipped": inputs.skipped}
    return {name: _said_of(why) for name, why in reasons.items() if why} | inputs.as_json()


def dataset_metadata(summary: DatasetSummary, failed: Mapping[str, str]) -> Metadata:
    """Return the summary of a dataset as Dagster metadata.

    Args:
        summary: of the dataset.
        failed: recording that could not enter it -> why.
    """
    metadata: Metadata = {
        # People look for it first, and below twenty rows they would have to scroll.
        **({"failed": _said_of(failed)} if failed else {}),
        "folder": dg.MetadataValue.path(str(summary.folder)),
        "recordings": sum(share.recordings for share in summary.shares),
        **{
            name: _shown(value) if value or not isinstance(value, Mapping) else dg.MetadataValue.json({})
            for name, value in summary.facts.items()
        },
        "split_shares": _split_table(summary.shares),
        "changed": summary.changed,
    }
    if summary.files:
        metadata["files"] = _table(("way", "files"), list(summary.files.items()))
    if summary.moved:
        moved = {key: f"was in {old}, is in {new}" for key, (old, new) in summary.moved.items()}
        metadata["moved"] = _said_of(moved)
    if summary.duplicates:
        same = {key: f"left out: the same content as {first}" for key, first in summary.duplicates.items()}
        metadata["duplicates"] = _said_of(same)
    return metadata


@contextmanager
def errors_explained() -> Iterator[None]:
    """Turn errors of bagassets into Dagster failures that show their message and are not retried."""
    try:
        yield
    except BagAssetsError as err:
        raise dg.Failure(description=str(err), allow_retries=False) from _unexpected_cause(err)


def _unexpected_cause(err: BagAssetsError) -> BaseException | None:
    """Return the cause of an unexpected error, whose traceback is worth showing; None for errors that say it all."""
    inner = err.errors.values() if isinstance(err, BuildFailure) else [err]
    return next((e.__cause__ for e in inner if isinstance(e, UnexpectedError)), None)


def code_link(make: Callable[..., object]) -> Metadata:
    """Return the metadata that names the function which decides what an asset is, or makes it, for "View code" in the web UI."""
    code = getattr(make, "__code__", None)
    if code is None:  # made by `functools.partial`, or not written in Python
        return {}
    file = Path(code.co_filename)
    label = f"{_PACKAGE.name}/{file.relative_to(_PACKAGE)}" if file.is_relative_to(_PACKAGE) else file.name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=dg.BetaWarning)
        reference = dg.LocalFileCodeReference(
            file_path=str(file), line_number=code.co_firstlineno, label=label
        )
        return {"dagster/code_references": dg.CodeReferencesMetadataValue(code_references=[reference])}


# --- lists and tables ----------------------------------------------------------------------


def _said_of(sentences: Mapping[str, str]) -> dg.MarkdownMetadataValue:
    """Return a list of what is said of recordings, equal sentences once.

    Dagster gives a table the width of its longest words, of which a narrow window shows the left; the lines of a list wrap.
    """
    told = told_once(((), key, without_path(key, text)) for key, text in sentences.items())
    lines = [f"- {markdown(one.title)}: {markdown(one.text)}" for one in told]
    shown, rest = len(lines), ""
    while shown > 1 and len("\n".join(lines[:shown])) + len(rest) >= _SHOWN_AT_ONCE:
        shown -= 1
        left = sum(len(one.names) for one in told[shown:])
        rest = f"\n- … and {count_text(left, 'more recording')}; `bagassets status` lists them all"
    return dg.MetadataValue.md("\n".join(lines[:shown]) + rest)


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> dg.MarkdownMetadataValue:
    """Return a Markdown table; columns of numbers are aligned to the right."""
    numeric = [
        bool(rows) and all(isinstance(row[column], int | float) for row in rows)
        for column in range(len(header))
    ]
    lines = [_line(header), _line(["--:" if is_number else "---" for is_number in numeric])]
    lines += [_line([markdown(str(value)) for value in row]) for row in rows[:_MOST_ROWS]]
    if len(rows) > _MOST_ROWS:
        lines.append(_line([f"… and {len(rows) - _MOST_ROWS} more", *[""] * (len(header) - 1)]))
    return dg.MetadataValue.md("\n".join(lines))


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _split_table(shares: Sequence[SplitShare]) -> dg.MarkdownMetadataValue:
    """Return a Markdown table with the share of each split by duration, beside the share asked for."""
    rows = [
        (
            share.name,
            share.recordings,
            f"{share.duration_s:.1f} s",
            f"{share.share:.1%}",
            f"{share.asked:.1%} ({share.deviation:+z.1%})",
        )
        for share in shares
    ]
    return _table(("split", "recordings", "duration", "share", "asked for (deviation)"), rows)
