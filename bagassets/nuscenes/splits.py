"""Splits: which part of the dataset a recording belongs to, decided by a hash and never revised."""

from collections.abc import Mapping

from blake3 import blake3

from bagassets.store.canonical import canonical_json

__all__ = ["DEVKIT_SPLITS", "devkit_split_name", "split_of"]

# Names that nuscenes-devkit answers itself, with the scenes of nuScenes.
DEVKIT_SPLITS = frozenset({"train", "val", "test", "mini_train", "mini_val", "train_detect", "train_track"})


def split_of(key: str, shares: Mapping[str, float], seed: int) -> str:
    """Return the split of a recording.

    A hash of seed and key is held against the shares, laid end to end in order of their names: other
    recordings have no say, so adding one never moves another. Shares are met approximately.

    Args:
        key: partition key of the recording.
        shares: split -> share; they add up to 1.
        seed: another seed deals all recordings anew.
    """
    position = int.from_bytes(blake3(canonical_json([seed, key])).digest(length=8), "big") / 2.0**64
    bound = 0.0
    names = sorted(name for name, share in shares.items() if share > 0)
    for name in names[:-1]:
        bound += shares[name]
        if position < bound:
            return name
    return names[-1]


def devkit_split_name(name: str) -> str:
    """Return the name of a split in `splits.json`.

    The devkit never looks up its own names there, so these get a prefix: `train` becomes `custom_train`.
    """
    return f"custom_{name}" if name in DEVKIT_SPLITS else name
