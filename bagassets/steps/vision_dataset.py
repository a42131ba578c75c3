"""The step `vision_dataset`: all recordings' sequences and images become one dataset.

Like `nuscenes_dataset` it writes a folder, not an artifact: its lock file says what it was made from.
"""

from bagassets.vision.dataset import (
    VisionPart,
    VisionSummary,
    assemble_vision,
    read_vision_lock,
)

__all__ = [
    "VERSION",
    "VisionPart",
    "VisionSummary",
    "assemble_vision",
    "read_vision_lock",
]

# Raised whenever the bytes of a dataset change for the same recordings.
VERSION = 2
