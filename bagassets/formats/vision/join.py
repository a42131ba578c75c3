"""The merged files of the vision dataset: the sequences of all recordings, and a manifest for each split."""

from collections.abc import Sequence
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import Joined, Member
from bagassets.formats.json_files import json_bytes, rows_text, write_hashed, write_joined
from bagassets.formats.vision.settings import Vision

__all__ = ["RECORDINGS", "SEQUENCES", "join"]

RECORDINGS = "recordings"
# File of a `vision_sequences` artifact with the rows of all its sequences.
SEQUENCES = "sequences.json"
ONE_FILE = "all"
# What a manifest says of a recording, besides its names.
_TOLD = ("sequences", "images", "duration_s", "daylight", "start")


def join(members: Sequence[Member], settings: Vision, shares: Sequence[SplitShare], out: Path) -> Joined:
    """Write the merged files and a manifest for each split.

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
