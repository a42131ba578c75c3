"""The step `nuscenes_dataset`: all recordings' tables and files become one dataset.

It writes a dataroot, not an artifact, so it has no action: the lock file in the version folder says
what the dataset was made from.
"""

from bagassets.nuscenes.dataset import BagPart, DatasetSummary, assemble, read_lock

__all__ = ["VERSION", "BagPart", "DatasetSummary", "assemble", "read_lock"]

# Raised whenever the bytes of a dataset change for the same recordings.
VERSION = 3
