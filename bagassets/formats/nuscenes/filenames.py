"""Names of the files of a dataset.

As in nuScenes, a name contains recording, channel and time:
`samples/CAM_FRONT/drive-1f3a90cc__CAM_FRONT__1700000000123456.jpg`. The hex digits after the recording's key are the first
of the content's digest, so old tables never refer to new content.
"""

from urllib.parse import quote, unquote

__all__ = ["filename", "recording_of"]

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
