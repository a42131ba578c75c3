"""Tokens of nuScenes rows: hashes of what identifies a row, never random.

Rows of a recording are identified by rig, partition key, table, channel and stamp. Re-indexing or re-compressing a
recording changes none of these, two recordings never share a token, and merging datasets rewrites none. Rows that all
recordings share are identified by their names.
"""

from dataclasses import dataclass

from blake3 import blake3

from bagassets.store.canonical import canonical_json

__all__ = [
    "RecordingTokens",
    "attribute_token",
    "category_token",
    "sensor_token",
    "token",
    "visibility_token",
]

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


def sensor_token(channel: str, modality: str) -> str:
    """Return the token of a sensor."""
    return token("sensor", channel, modality)


def category_token(name: str) -> str:
    """Return the token of a category."""
    return token("category", name)


def attribute_token(name: str) -> str:
    """Return the token of an attribute."""
    return token("attribute", name)


def visibility_token(level: str) -> str:
    """Return the token of a visibility level: 1 to 4.

    nuScenes itself uses these, and training code converts them to integers.
    """
    return str(VISIBILITY_LEVELS.index(level) + 1)
