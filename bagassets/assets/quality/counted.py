"""What the counts of channels and poses are of: messages, or what one message has many of."""

from bagassets.base.json_types import JsonMapping

__all__ = ["counted_in_channel", "counted_in_poses"]

_OF_PACKETS = {"incomplete revolution", "position packet"}


def counted_in_channel(counts: JsonMapping) -> str:
    """Return `message` or, by counts (merged, lost), `packet` where revolutions are made of packets: only those are merged."""
    return "packet" if counts.get("merged") or _OF_PACKETS & counts.get("lost", {}).keys() else "message"


def counted_in_poses(source: str) -> str:
    """Return what a `source` of ego poses is counted by: `message`, `packet` or `transform`."""
    return {"ncom": "packet", "tf": "transform"}.get(source, "message")
