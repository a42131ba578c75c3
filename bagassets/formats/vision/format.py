"""The vision format: image sequences in plain folders.

Layout::

    recordings/<key>-<id>/metadata.json, transforms.json, trajectories/…
    recordings/<key>-<id>/CAM_FRONT/0000/000000.jpg …, CAM_FRONT/0000.json
    annotations/train.json, train.manifest.json, val.json, …, dataset.lock.json

The folder of a recording never changes under its name; the folder `annotations` is swapped at once.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import FACTS, Entry, Format, Joined, Link, Member, UnitFolders
from bagassets.formats.json_files import json_bytes, rows_text, write_hashed, write_joined
from bagassets.formats.vision.recording_part import FILES, SEQUENCES, VISION_SEQUENCES
from bagassets.formats.vision.settings import Vision

RECORDINGS = "recordings"
ONE_FILE = "all"
# What a manifest says of a recording, besides its names.
_TOLD = ("sequences", "images", "duration_s", "daylight", "start")


def join(members: Sequence[Member], settings: Vision, shares: Sequence[SplitShare], out: Path) -> Joined:
    """Write the merged files, the sequences of all recordings, and a manifest for each split.

    Args:
        members: recordings in the order of their keys.
        settings: the recipe's `vision`.
        shares: each split's share of the recorded time, in order of their names.
        out: empty folder.
    """
    groups = {share.name: [one for one in members if one.split == share.name] for share in shares}
    merged = {ONE_FILE: members} if settings.files == "one" else groups
    digests = {}
    for name, group in merged.items():
        texts = (rows_text(member.artifact.path(SEQUENCES)) for member in group)
        _, digests[f"{name}.json"] = write_joined(out / f"{name}.json", texts)
    for share in shares:
        manifest = json_bytes(_manifest(share, groups[share.name]))
        digests[f"{share.name}.manifest.json"] = write_hashed(out / f"{share.name}.manifest.json", manifest)
    facts = {
        what: {name: sum(member.facts[what] for member in group) for name, group in groups.items()}
        for what in ("sequences", "images")
    }
    return Joined(dict(sorted(digests.items())), facts)


def _manifest(share: SplitShare, members: Sequence[Member]) -> JsonObject:
    return {
        "split": share.name,
        **share.as_json(),
        **{what: sum(member.facts[what] for member in members) for what in ("sequences", "images")},
        "bags": [
            {
                "recording": member.part.key,
                "rig": member.facts["rig"],
                "folder": f"{RECORDINGS}/{member.facts['folder']}",
                **{what: member.facts[what] for what in _TOLD},
            }
            for member in members
        ],
    }


def _links(entry: Entry) -> Iterator[Link]:
    folder = f"{RECORDINGS}/{entry.row['folder']}"
    for file in entry.artifact.entries():
        if file.path not in {FACTS, FILES, SEQUENCES}:
            yield Link(f"{folder}/{file.path}", entry.artifact.digest, file.path)
    for image in entry.artifact.read_json(FILES):
        yield Link(f"{folder}/{image['filename']}", image["artifact"], image["file"])


VISION = Format(
    name="vision",
    version=2,
    description=(
        "The vision dataset: image sequences in plain folders, merged annotation files and a manifest for each "
        "split, swapped in atomically."
    ),
    kinds=frozenset({"image", "json"}),
    settings=Vision,
    part=VISION_SEQUENCES.name,
    assets=(VISION_SEQUENCES,),
    join=join,
    links=_links,
    counts=lambda facts: {"sequences": facts["sequences"]},
    row=lambda facts: {"folder": facts["folder"]},
    duration_s=lambda facts: float(facts["duration_s"]),
    folder=lambda _: "annotations",
    places=UnitFolders(RECORDINGS, lambda entry: str(entry.row["folder"])),
)
