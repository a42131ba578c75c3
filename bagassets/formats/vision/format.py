"""The vision format: image sequences in plain folders.

Layout::

    recordings/<key>-<id>/metadata.json, transforms.json, trajectories/…
    recordings/<key>-<id>/CAM_FRONT/0000/000000.jpg …, CAM_FRONT/0000.json
    annotations/train.json, train.manifest.json, val.json, …, dataset.lock.json

The folder of a recording never changes under its name; the folder `annotations` is swapped at once.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import (
    FACTS,
    ByGroups,
    Entry,
    Facts,
    Finished,
    Format,
    Link,
    Member,
    UnitFolders,
)
from bagassets.formats.json_files import TABLE, Frame, framed, framed_row, rows_text
from bagassets.formats.vision.recording_part import FILES, SEQUENCES, VISION_SEQUENCES, why_no_sequence
from bagassets.formats.vision.settings import Vision
from bagassets.recipe.format_settings import section_at
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe

RECORDINGS = "recordings"
ONE_FILE = "all"
_COUNTED = ("sequences", "images")
# What a manifest says of a recording, besides its names.
_TOLD = ("sequences", "images", "duration_s", "daylight", "start")


def _files(settings: Vision, splits: Sequence[str]) -> list[str]:
    merged = [ONE_FILE] if settings.files == "one" else splits
    return [*(f"{name}.json" for name in merged), *map(_manifest, splits)]


def _manifest(split: str) -> str:
    return f"{split}.manifest.json"


def _rows(settings: Vision, file: str, member: Member) -> bytes:
    """Return the sequences of a recording, or what the manifest of its split says of it."""
    if file == f"{ONE_FILE if settings.files == 'one' else member.split}.json":
        return rows_text(member.artifact.path(SEQUENCES))
    if file != _manifest(member.split):
        return b""
    row = {"recording": member.part.key, "rig": member.facts["rig"]}
    row["folder"] = f"{RECORDINGS}/{member.facts['folder']}"
    return framed_row(row | {what: member.facts[what] for what in _TOLD})


def _facts(members: Sequence[Member], settings: Vision) -> JsonObject:
    """Return split -> what it has of some recordings -> number."""
    del settings
    counted: dict[str, dict[str, int]] = {}
    for member in members:
        of_split = counted.setdefault(member.split, dict.fromkeys(_COUNTED, 0))
        for what in _COUNTED:
            of_split[what] += member.facts[what]
    return counted


def _count(facts: Sequence[Facts], split: str, what: str) -> int:
    return sum(group[split][what] for group in facts if split in group)


def _frame(file: str, facts: Sequence[Facts], shares: Sequence[SplitShare]) -> Frame:
    for share in shares:
        if file == _manifest(share.name):
            counts = {what: _count(facts, share.name, what) for what in _COUNTED}
            return framed({"split": share.name, **share.as_json(), **counts})
    return TABLE


def _finish(
    facts: Sequence[Facts], settings: Vision, shares: Sequence[SplitShare], rows: Mapping[str, int]
) -> Finished:
    del settings, rows
    return Finished(
        {}, {what: {share.name: _count(facts, share.name, what) for share in shares} for what in _COUNTED}
    )


def _links(entry: Entry) -> Iterator[Link]:
    folder = f"{RECORDINGS}/{entry.row['folder']}"
    for file in entry.artifact.entries():
        if file.path not in {FACTS, FILES, SEQUENCES}:
            yield Link(f"{folder}/{file.path}", entry.artifact.digest, file.path)
    for image in entry.artifact.read_json(FILES):
        yield Link(f"{folder}/{image['filename']}", image["artifact"], image["file"])


def _why_empty(recordings: Sequence[Facts], recipe: Recipe, recipe_file: Path) -> str:
    """Return why no camera has a sequence, as the end of a sentence."""
    frames = (recipe.settings(Vision) or Vision()).frames
    cameras = (camera for facts in recordings for camera in facts["channels"].items())
    return f"{why_no_sequence(cameras, frames)} ({where_in(recipe_file, section_at(VISION.name))})"


VISION = Format(
    name="vision",
    version=3,
    description=(
        "The vision dataset: image sequences in plain folders, merged annotation files and a manifest for each "
        "split, swapped in atomically."
    ),
    kinds=frozenset({"image", "json"}),
    settings=Vision,
    part=VISION_SEQUENCES.name,
    assets=(VISION_SEQUENCES,),
    join=ByGroups(_files, _rows, _facts, _finish, _frame),
    links=_links,
    counts=lambda facts: {"sequences": facts["sequences"]},
    row=lambda facts: {"folder": facts["folder"]},
    duration_s=lambda facts: float(facts["duration_s"]),
    folder=lambda _: "annotations",
    fills_split=lambda facts: bool(facts["sequences"]),
    why_empty=_why_empty,
    places=UnitFolders(RECORDINGS, lambda entry: str(entry.row["folder"])),
)
