"""Tokens of nuScenes rows, which are hashes of what identifies a row, never random; names of the files of a dataset.

Rows of a recording are identified by rig, partition key, table, channel and stamp. Re-indexing or re-compressing a
recording changes none of these, two recordings never share a token, and merging datasets rewrites none. Rows that all
recordings share are identified by their names.

As in nuScenes, the name of a file contains recording, channel and time:
`samples/CAM_FRONT/drive-1f3a90cc__CAM_FRONT__1700000000123456.jpg`. The hex digits after the recording's key are the first
of the content's digest, so old tables never refer to new content.
"""

from dataclasses import dataclass
from functools import partial
from urllib.parse import quote, unquote

from blake3 import blake3

from bagassets.store.canonical import canonical_json

HEX_DIGITS = 32  # as in nuScenes
VISIBILITY_LEVELS = ("v0-40", "v40-60", "v60-80", "v80-100")


def token(*parts: str | int) -> str:
    """Return the token of a tuple of names and numbers: 32 hex digits of its BLAKE3 digest."""
    return blake3(canonical_json(parts)).hexdigest(length=HEX_DIGITS // 2)


@dataclass(frozen=True)
class RecordingTokens:
    """Tokens of the rows of one recording.

    Attributes:
        rig: name of the rig.
        key: partition key of the recording.
    """

    rig: str
    key: str

    def row(self, table: str, channel: str = "", stamp_ns: int = 0) -> str:
        """Return the token of a row identified by channel and time."""
        return token(self.rig, self.key, table, channel, stamp_ns)

    def track(self, table: str, source: str, track_id: str, stamp_ns: int) -> str:
        """Return the token of a row about a track: an instance of a scene, or one of its boxes."""
        return token(self.rig, self.key, table, source, track_id, stamp_ns)


# Of a sensor, given its channel and modality; of a category and of an attribute, given their names.
sensor_token = partial(token, "sensor")
category_token = partial(token, "category")
attribute_token = partial(token, "attribute")


def visibility_token(level: str) -> str:
    """Return the token of a visibility level: 1 to 4.

    nuScenes itself uses these, and training code converts them to integers.
    """
    return str(VISIBILITY_LEVELS.index(level) + 1)


DIGITS = 8


def filename(key: str, channel: str, stamp_us: int, digest: str, extension: str, *, is_keyframe: bool) -> str:
    """Return the path of a file below the dataroot.

    Args:
        key: partition key of the recording.
        channel: canonical channel.
        stamp_us: time of the reading.
        digest: digest of the content.
        extension: without the leading dot, as in `pcd.bin`.
        is_keyframe: keyframes are in `samples`, other readings in `sweeps`.
    """
    folder = "samples" if is_keyframe else "sweeps"
    recording = f"{quote(key, safe='')}-{digest[:DIGITS]}"
    return f"{folder}/{channel}/{recording}__{channel}__{stamp_us}.{extension}"


def recording_of(name: str) -> str | None:
    """Return the partition key in a path made by `filename`, or None for any other path."""
    parts = name.split("/")
    if len(parts) != 3:
        return None
    recording, separator, _ = parts[2].rpartition(f"__{parts[1]}__")
    return unquote(recording[: -DIGITS - 1]) if separator else None
