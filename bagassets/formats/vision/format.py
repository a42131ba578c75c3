"""The vision format: image sequences in plain folders.

Layout::

    recordings/<key>-<id>/metadata.json, transforms.json, trajectories/…
    recordings/<key>-<id>/CAM_FRONT/0000/000000.jpg …, CAM_FRONT/0000.json
    annotations/train.json, train.manifest.json, val.json, …, dataset.lock.json

The folder of a recording never changes under its name; the folder `annotations` is swapped in one step.
"""

from collections.abc import Iterator

from bagassets.formats.format import FACTS, Entry, Format, Link, UnitFolders
from bagassets.formats.vision.join import RECORDINGS, SEQUENCES, join
from bagassets.formats.vision.recording_part import FILES, VISION_SEQUENCES
from bagassets.formats.vision.settings import Vision

__all__ = ["VISION"]


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
